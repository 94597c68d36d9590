"""Promises of a stream of blocks: the same samples however they are asked for, from score time 0 on."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


@pytest.fixture(scope="module")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


#: stops, a pluck on a ringing string, bends and an end within 0.3 s: every kind of switch the engine knows
BUSY = tw.Score(
    [
        tw.Note(0.0, 0.11, note=45, force=1.0),
        tw.Note(0.0917, 0.05, note=50.3, force=2.0, from_bridge=0.2, angle_deg=40.0),
        tw.Note(0.1602, 0.1, note=45, force=1.5),
    ],
    [tw.Control(0.03, "bend", 60.0), tw.Control(0.1, "bend", -120.0), tw.Control(0.2, "bend", 0.0)],
)
CHORD = tw.Score(
    [
        tw.Note(0.0, 0.04, note=40, force=1.0),
        tw.Note(0.0, 0.04, note=59, force=1.0),
        tw.Note(0.05, 0.1, note=43, force=2.0),
    ],
    [tw.Control(0.02, "bend", 30.0)],
)


def whole(renderer: tw.Renderer, block: int = 4096) -> Floats:
    return np.concatenate(list(renderer.blocks(block)))


def test_samples_do_not_depend_on_the_block_size(monochord: tw.Instrument) -> None:
    def run(block: int) -> Floats:
        return whole(tw.Renderer(BUSY, monochord, max_duration=0.3), block)

    reference = run(1 << 20)
    assert len(reference) == round(0.3 * 48000)
    for block in (1, 7, 64, 511, 4096):
        assert np.array_equal(run(block), reference)


def test_blocks_are_as_long_as_asked_but_for_the_last(monochord: tw.Instrument) -> None:
    sizes = [len(b) for b in tw.Renderer(BUSY, monochord, max_duration=0.1).blocks(1000)]
    assert sizes == [1000] * 4 + [800]


def test_strings_of_a_guitar_do_not_see_the_block_size(guitar: tw.Instrument) -> None:
    runs = [whole(tw.Renderer(CHORD, guitar, max_duration=0.15), block) for block in (1 << 20, 7, 511)]
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])


def test_a_restored_snapshot_goes_on_bit_for_bit(monochord: tw.Instrument) -> None:
    renderer = tw.Renderer(BUSY, monochord, max_duration=0.3)
    stream = renderer.blocks(500)
    list(itertools.islice(stream, 9))  # in the middle of the second pluck's ramp
    checkpoint = renderer.snapshot()
    rest = np.concatenate(list(stream))
    renderer.restore(checkpoint)
    assert np.array_equal(whole(renderer, 777), rest)
    other = tw.Renderer(BUSY, monochord, max_duration=0.3)
    other.restore(checkpoint)
    assert np.array_equal(whole(other, 64), rest)
    assert other.summary().frames == round(0.3 * 48000)


def test_a_snapshot_is_a_copy(guitar: tw.Instrument) -> None:
    renderer = tw.Renderer(CHORD, guitar, max_duration=0.12)
    stream = renderer.blocks(480)
    list(itertools.islice(stream, 5))
    checkpoint = renderer.snapshot()
    rest = [np.concatenate(list(stream))]
    for _ in range(2):
        renderer.restore(checkpoint)
        rest.append(whole(renderer))
    assert np.array_equal(rest[0], rest[1])
    assert np.array_equal(rest[0], rest[2])


def test_frame_0_is_score_time_0(monochord: tw.Instrument) -> None:
    """The same note later gives the same samples later, but for 5 ms in which the step at the first frame fades."""
    later = 64 * 30
    at_once = tw.Score([tw.Note(0.0, 0.5, note=45, force=1.0)])
    delayed = tw.Score([tw.Note(later / 48000, 0.5, note=45, force=1.0)])
    first = whole(tw.Renderer(at_once, monochord, max_duration=0.1))
    second = whole(tw.Renderer(delayed, monochord, max_duration=0.1 + later / 48000))
    smoothed = round(5e-3 * 48000)
    assert np.abs(second[later:] - first)[smoothed:].max() < 1e-11 * np.abs(first).max()
    # and the release of a pluck is heard within its first milliseconds, not a ramp later
    loud = np.flatnonzero(np.abs(first[:, 0]) > 0.3 * np.abs(first[: round(0.01 * 48000)]).max())
    assert loud[0] < 0.004 * 48000


def test_twice_the_force_is_twice_the_sound(guitar: tw.Instrument) -> None:
    ramp = guitar.replace({"exciters.pluck": {"plugin": "pluck_ramp"}})  # a finger's release depends on the force

    def run(factor: float) -> Floats:
        notes = [tw.Note(n.time, n.duration, note=n.note, force=(n.force or 0.0) * factor) for n in CHORD.notes]
        return whole(tw.Renderer(tw.Score(notes, CHORD.controls), ramp, max_duration=0.15))

    single, double = run(1.0), run(2.0)
    assert np.abs(double - 2 * single).max() < 1e-12 * np.abs(double).max()


def test_two_strings_together_are_the_sum_of_each(guitar: tw.Instrument) -> None:
    """Superposition, sympathetic strings included; the fingers that hold strings make it a different system."""
    free = guitar.replace({"exciters.pluck.hold_dashpot": 0.0})
    notes = [tw.Note(0.0, 1.0, string="E2", stop=0, force=1.0), tw.Note(0.01, 1.0, string="B3", stop=0, force=1.0)]
    both, one, other = (
        whole(tw.Renderer(tw.Score(part), free, max_duration=0.1)) for part in (notes, notes[:1], notes[1:])
    )
    assert np.abs(both - one - other).max() < 1e-12 * np.abs(both).max()


def test_time_between_two_samples_is_kept(monochord: tw.Instrument) -> None:
    """A note 0.37 samples later: the partials' phases turn back by omega 0.37 / fs."""
    fs, shift, n = 48000, 0.37, 24000
    start = 64 * 20
    free = monochord.replace({"exciters.pluck.hold_dashpot": 0.0})

    def run(sample: float) -> Floats:
        score = tw.Score([tw.Note(sample / fs, 5.0, note=45, force=1.0)])
        return whole(tw.Renderer(score, free, fs, max_duration=(start + n + 1) / fs))[start : start + n, 0]

    window = np.hanning(n)
    spectra = [np.fft.rfft(run(start + s) * window) for s in (0.0, shift)]
    for partial in (1, 5, 20):
        k = round(partial * 110.0 * n / fs)
        k = int(np.argmax(np.abs(spectra[0][k - 40 : k + 41]))) + k - 40
        turned = np.angle(spectra[1][k] / spectra[0][k])
        assert turned == pytest.approx(-2 * np.pi * k / n * shift, abs=2e-4)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_piece(monochord: tw.Instrument) -> None:
    def peak(n_notes: int) -> int:
        notes = [tw.Note(0.2 * i, 0.15, note=45 + i % 5, force=1.0) for i in range(n_notes)]
        renderer = tw.Renderer(tw.Score(notes), monochord, tail=0.1)
        tracemalloc.start()
        for block in renderer.blocks(4096):
            assert np.isfinite(block).all()
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    peak(6)
    assert peak(40) < peak(6) + 300_000  # the samples of the longer one alone would be 2.6 MB


def test_it_ends_when_it_has_decayed(monochord: tw.Instrument) -> None:
    """From 60 dB of the loudest on; sigma of the fundamental says when that is."""
    short = monochord.replace({"strings.A2.loss.sigma0": 20.0})
    renderer = tw.Renderer(tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)]), short, tail=20.0, tail_level_db=-60.0)
    samples = whole(renderer)
    assert renderer.summary().end == "decayed"
    loudest = np.abs(samples).max()
    assert np.abs(samples[-round(0.15 * 48000) :]).max() < 1e-3 * loudest
    assert len(samples) / 48000 < 0.2 + 0.3 + np.log(1000) / 20.0


def test_where_it_ends_does_not_depend_on_the_block_size(monochord: tw.Instrument) -> None:
    """A tail is looked at every 512 samples, however far a large block lets it be stepped at once before."""
    short = monochord.replace({"strings.A2.loss.sigma0": 40.0})
    score = tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0), tw.Note(0.31, 0.05, note=50, force=0.2)])
    ends = []
    for block in (64, 1000, 1 << 20):
        renderer = tw.Renderer(score, short, tail=20.0, tail_level_db=-60.0)
        samples = whole(renderer, block)
        ends.append((len(samples), renderer.engine.state.sample, float(np.abs(samples).sum())))
        assert renderer.summary().end == "decayed"
    assert ends[0] == ends[1] == ends[2]


def test_it_ends_at_the_cap_or_the_maximum_duration(monochord: tw.Instrument) -> None:
    score = tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)])
    capped = tw.Renderer(score, monochord, tail=0.5, tail_level_db=-200.0)
    n = len(whole(capped))
    assert capped.summary().end == "tail cap"
    assert n / 48000 == pytest.approx(0.5, abs=0.02)
    cut = tw.Renderer(score, monochord, max_duration=0.12345)
    assert len(whole(cut)) == round(0.12345 * 48000)
    assert cut.summary().end == "maximum duration"
    assert cut.summary().duration_s == pytest.approx(0.12345, abs=1 / 48000)
