"""Scores nobody would write, on a whole guitar: the sound is finite, as loud as its plucks, and dies away."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
from midi_bytes import Event, bend, bend_range, control, note, off, on, write
from tonewood.errors import ScoreError
from tonewood.sound.render.renderer import Summary

Floats = NDArray[np.float64]
FS = 16000


def _flat(parts: object) -> list[Event]:
    return list(chain.from_iterable(parts))  # type: ignore[arg-type]  # lists of events


def zero_length() -> list[Event]:
    return _flat(note(0.1 * i, 0.0, 45 + i) for i in range(6))


def scale_faster_than_a_finger() -> list[Event]:
    return _flat(note(0.0104 * i, 0.0, 40 + i) for i in range(30))


def cluster() -> list[Event]:
    return _flat(note(0.0, 0.3, n) for n in range(40, 70))


def one_key_on_all_channels() -> list[Event]:
    return _flat(note(0.0, 0.3, 60, channel=c) for c in range(16))


def pedal_chatter() -> list[Event]:
    return _flat(note(0.1 * i, 0.05, 52 + i) for i in range(5)) + [
        control(0.004 * i, 64, 127 * (i % 2)) for i in range(140)
    ]


def bends_of_two_octaves_at_once() -> list[Event]:
    steps = [bend(0.1 + 0.05 * i, (8191, -8192, 0)[i % 3]) for i in range(9)]
    return [*bend_range(24), *note(0.0, 0.6, 52, 120), *steps]


def bend_chatter() -> list[Event]:
    return [*bend_range(2), *note(0.0, 0.5, 45, 120), *(bend(0.001 * i, (-1) ** i * 8000) for i in range(500))]


def all_notes_off() -> list[Event]:
    return [on(0.0, 50), on(0.02, 57), on(0.04, 62), control(0.25, 123, 0), on(0.3, 45), control(0.4, 120, 0)]


def never_released() -> list[Event]:
    return [on(0.05 * i, 40 + 3 * i) for i in range(8)]


def released_twice_and_before() -> list[Event]:
    return [off(0.0, 60), *note(0.1, 0.1, 60), off(0.25, 60), off(0.26, 60)]


def trill_faster_than_a_finger() -> list[Event]:
    return _flat(note(0.012 * i, 0.01, 64 + i % 2, 110) for i in range(24))


def same_key_again_and_again() -> list[Event]:
    return _flat(note(0.007 * i, 0.007, 59, 127) for i in range(30))


def everything_at_once_and_loud() -> list[Event]:
    return _flat(note(0.2 * k, 0.2, n, 127) for k in range(3) for n in (40, 45, 50, 55, 59, 64))


def silent_volume() -> list[Event]:
    return [control(0.0, 7, 0), *note(0.0, 0.3, 52), control(0.31, 7, 127), *note(0.35, 0.1, 52, 1)]


def plucking_place_to_and_fro() -> list[Event]:
    return _flat([control(0.1 * i, 74, 127 * (i % 2)), *note(0.1 * i, 0.1, 83 - i % 2)] for i in range(6))


def out_of_range() -> list[Event]:
    return _flat(note(0.05 * i, 0.1, n) for i, n in enumerate((0, 10, 39, 40, 83, 84, 100, 127)))


ODDITIES: list[Callable[[], list[Event]]] = [
    zero_length,
    scale_faster_than_a_finger,
    cluster,
    one_key_on_all_channels,
    pedal_chatter,
    bends_of_two_octaves_at_once,
    bend_chatter,
    all_notes_off,
    never_released,
    released_twice_and_before,
    trill_faster_than_a_finger,
    same_key_again_and_again,
    everything_at_once_and_loud,
    silent_volume,
    plucking_place_to_and_fro,
    out_of_range,
]


@pytest.fixture(scope="module")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


def played(score: tw.Score, instrument: tw.Instrument, duration: float = 1.0) -> tuple[Floats, tw.Renderer]:
    renderer = tw.Renderer(score, instrument, FS, max_duration=duration)
    return np.concatenate(list(renderer.blocks(4096))), renderer


@pytest.mark.parametrize("oddity", ODDITIES, ids=lambda f: f.__name__)
def test_it_sounds_sane(oddity: Callable[[], list[Event]], tmp_path: Path, guitar: tw.Instrument) -> None:
    score = tw.read_midi(write(tmp_path / "odd.mid", oddity()))
    samples, renderer = played(score, guitar)
    summary = renderer.summary()
    assert FS // 2 < len(samples) <= FS
    assert np.isfinite(samples).all()
    # each note of the file was played or is listed
    asked = len(score.notes)
    assert summary.notes + len(summary.notes_dropped) + len(_shared(summary)) >= asked
    # six strings at the greatest force stay within full scale; a lone pluck is heard
    peak = np.abs(samples).max()
    assert 1e-4 < peak < 1.0
    assert np.abs(samples.mean(axis=0)).max() < 0.01 * peak


def _shared(summary: Summary) -> range:
    line = next((w for w in summary.warnings if "share another voice's pluck" in w), "0 ")
    return range(int(line.split()[0]))


@pytest.mark.parametrize(
    "oddity", [bends_of_two_octaves_at_once, bend_chatter, trill_faster_than_a_finger, pedal_chatter],
    ids=lambda f: f.__name__,
)  # fmt: skip
def test_it_dies_away_afterwards(oddity: Callable[[], list[Event]], tmp_path: Path, guitar: tw.Instrument) -> None:
    """Whatever was done to the strings, nothing goes on ringing by itself, at Nyquist least of all."""
    score = tw.read_midi(write(tmp_path / "odd.mid", oddity()))
    samples, _ = played(score, guitar, 3.0)
    mono = samples.mean(axis=1)
    levels = [np.sqrt(np.mean(mono[i * FS // 2 : (i + 1) * FS // 2] ** 2)) for i in range(6)]
    assert levels[2] > levels[3] > levels[4] > levels[5]
    assert levels[5] < 0.1 * max(levels)
    late = np.abs(np.fft.rfft(mono[2 * FS :] * np.hanning(FS)))
    assert late[-FS // 20 :].max() < 1e-3 * late.max()


def test_silence_for_a_note_without_force(guitar: tw.Instrument) -> None:
    samples, renderer = played(tw.Score([tw.Note(0.0, 0.2, note=52, force=0.0)]), guitar, 0.3)
    assert renderer.summary().notes == 1
    assert not samples.any()


def test_an_empty_score_is_refused(guitar: tw.Instrument) -> None:
    with pytest.raises(ScoreError, match="no notes"):
        tw.Renderer(tw.Score([]), guitar)
