"""Sound before score time 0: kept as a lead-in, or cut off without a step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw

Floats = NDArray[np.float64]
FS = 48000
AT_ONCE = tw.Score([tw.Note(0.0, 0.2, note=45, velocity_midi=127)])
#: note that each can play; pressures, accelerations and string velocities are read
INSTRUMENTS = {"monochord": 45, "classical_guitar": 45, "electric_bass": 43, "tanpura": 48, "african_harp": 59}


def _sound(name: str, note: float, time: float = 0.0, **options: object) -> tuple[Floats, tw.Renderer]:
    score = tw.Score([tw.Note(time, 0.2, note=note, velocity_midi=127)])
    renderer = tw.Renderer(score, tw.load_instrument(name), FS, max_duration=time + 0.05, effects="all", **options)  # type: ignore[arg-type]  # keywords of Renderer
    return np.concatenate(list(renderer.blocks())), renderer


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_a_note_at_zero_begins_without_a_step(name: str) -> None:
    sound, renderer = _sound(name, INSTRUMENTS[name])
    step = renderer.summary().onset_step_dbfs
    assert 20 * math.log10(max(np.abs(sound[0]).max(), 1e-12)) < -100.0
    # it would have been a click, except where all that can be heard is at rest until the release
    assert step is not None
    assert step > -100.0
    largest = np.abs(np.diff(sound[: FS // 200], axis=0)).max()
    assert largest <= np.abs(np.diff(_sound(name, INSTRUMENTS[name], lead_in="auto")[0], axis=0)).max() * 1.01


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_a_lead_in_keeps_what_comes_before(name: str) -> None:
    """With it the sound is that of the same note later in a score; time 0 is where it is said to be."""
    whole, renderer = _sound(name, INSTRUMENTS[name], lead_in="auto")
    zero = renderer.zero_frame
    assert zero == math.ceil(-renderer.performance.timeline.start * FS)
    assert renderer.summary().onset_step_dbfs is None
    assert len(whole) == zero + round(0.05 * FS)
    later, _ = _sound(name, INSTRUMENTS[name], time=64 * 120 / FS)  # on the control grid, so that samples compare
    shift = 64 * 120 - zero
    assert np.abs(whole[:zero]).max() > 0
    np.testing.assert_allclose(whole, later[shift : shift + len(whole)], rtol=0, atol=1e-9 * np.abs(later).max())


def test_smoothing_changes_the_first_five_milliseconds_by_the_step_alone() -> None:
    """Raw sound minus the cut-off value times (1 + cos(pi t / 5 ms)) / 2; the same samples whatever the blocks."""
    raw, renderer = _sound("classical_guitar", 45, lead_in=0.1)
    zero = renderer.zero_frame
    assert zero == round(0.1 * FS)
    expected = raw[zero:].copy()
    n = round(5e-3 * FS)
    expected[:n] -= (0.5 + 0.5 * np.cos(np.pi * np.arange(n) / n))[:, None] * raw[zero]
    guitar = tw.load_instrument("classical_guitar")
    for size in (1, 37, 4096):
        streamed = tw.Renderer(AT_ONCE, guitar, FS, max_duration=0.05, effects="all")
        np.testing.assert_array_equal(np.concatenate(list(streamed.blocks(size))), expected)


def test_a_short_lead_in_is_smoothed_where_it_begins() -> None:
    sound, renderer = _sound("tanpura", 48, lead_in=0.01)
    assert renderer.zero_frame == 480
    assert renderer.summary().onset_step_dbfs is not None
    assert np.abs(sound[0]).max() < 1e-5


def test_nothing_is_smoothed_where_nothing_is_cut() -> None:
    _, renderer = _sound("classical_guitar", 45, time=0.2)
    assert renderer.summary().onset_step_dbfs is None
    tap = tw.Score([tw.Note(0.0, technique="tap", force=5.0)])
    renderer = tw.Renderer(tap, tw.load_instrument("classical_guitar"), FS, max_duration=0.02)
    list(renderer.blocks())
    assert renderer.summary().onset_step_dbfs is None


def test_a_snapshot_within_the_smoothing_goes_on_alike() -> None:
    guitar = tw.load_instrument("classical_guitar")
    first = tw.Renderer(AT_ONCE, guitar, FS, max_duration=0.05)
    blocks = first.blocks(50)
    next(blocks)
    kept = first.snapshot()
    rest = np.concatenate(list(blocks))
    second = tw.Renderer(AT_ONCE, guitar, FS, max_duration=0.05)
    second.restore(kept)
    np.testing.assert_array_equal(np.concatenate(list(second.blocks(50))), rest)


@pytest.mark.parametrize("lead_in", [-0.1, math.nan, 61.0, "often"])
def test_other_lead_ins_are_refused(lead_in: float | str) -> None:
    with pytest.raises(tw.TonewoodError, match=r"lead_in: is .*; auto or 0 to 60 s are allowed"):
        tw.Renderer(AT_ONCE, tw.load_instrument("monochord"), FS, lead_in=lead_in)


def test_the_expected_duration_is_the_last_event_the_tail_and_the_lead_in_or_the_limit() -> None:
    score = tw.Score([tw.Note(1.0, 0.5, note=45)])
    free = tw.Renderer(score, "monochord", FS, tail=2.0)
    assert free.expected_duration == pytest.approx(3.0, abs=0.01)  # it rings on: its end is no event
    assert tw.Renderer(score, "monochord", FS, tail=2.0, max_duration=0.7).expected_duration == pytest.approx(0.7)
    assert tw.Renderer(score, "monochord", FS, tail=2.0, max_duration=9.0).expected_duration == free.expected_duration
    led = tw.Renderer(score, "monochord", FS, tail=2.0, max_duration=0.7, lead_in=0.25)
    assert led.expected_duration == pytest.approx(0.95)
