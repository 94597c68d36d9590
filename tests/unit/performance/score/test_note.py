"""Notes refuse numbers that cannot be; controllers act on the notes after them."""

from __future__ import annotations

import math
from collections import UserList

import numpy as np
import pytest

from tonewood.errors import ScoreError
from tonewood.performance.score.controllers import Controllers, loudness
from tonewood.performance.score.note import Beats, Control, Note, Score


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("time", -0.1),
        ("time", float("nan")),
        ("duration", float("inf")),
        ("note", float("nan")),
        ("note", 256.5),
        ("note", -128.5),
        ("freq", 0.0),
        ("force", -1.0),
        ("velocity_midi", 128),
        ("channel", 16),
        ("stop", -1),
        ("freq", "C4"),
        ("angle_deg", float("inf")),
    ],
)
def test_impossible_numbers_are_refused_by_name(field, value):
    with pytest.raises(ScoreError, match=f"^{field} of a note is {value!r}"):
        Note(**{"time": 0.0, field: value})


@pytest.mark.parametrize("notes", ["E4", b"E4", 64, {64}, iter([64])])
def test_notes_of_a_score_are_a_list(notes: object) -> None:
    with pytest.raises(ScoreError, match=r"^notes of a score are .*: a list of notes is allowed"):
        Score(notes)


def test_numpy_numbers_are_numbers():
    assert Note(time=np.float64(1.0), note=np.int64(60)).time == 1.0


def test_duration_of_a_score_is_its_last_notes_end():
    assert Score([Note(0.0, 5.0), Note(1.0, 1.0)]).duration == 5.0
    assert Score([]).duration == 0.0


def test_factors_follow_channel_time_and_order_of_notes():
    controls = [Control(1.0, "cc7", 0.5, 0), Control(2.0, "cc11", 0.5, 0), Control(2.0, "cc7", 1.0, 0)]
    notes = [Note(2.5, channel=0), Note(0.9, channel=0), Note(1.0, channel=0), Note(1.5, channel=1)]
    latest = Controllers(controls).of
    assert [loudness(latest(note)) for note in notes] == [0.25, 1.0, 0.25, 1.0]


def test_a_volume_without_a_channel_holds_for_all():
    controls = [Control(1.0, "cc7", 0.5), Control(0.5, "cc11", 0.5, 1)]
    latest = Controllers(controls).of
    notes = [Note(0.5, channel=0), Note(1.5, channel=0), Note(1.5, channel=1), Note(1.5)]
    assert [loudness(latest(note)) for note in notes] == [1.0, 0.25, 0.0625, 0.25]


@pytest.mark.parametrize(
    ("time", "kind", "value", "said"),
    [
        (0.0, "cc1", 1.01, "cc1 of 1.01 at 0.0 s: 0 to 1 are allowed"),
        (0.0, "cc1", -0.5, "0 to 1 are allowed"),
        (0.0, "bend", math.nan, "bend of nan at 0.0 s: finite cents are allowed"),
        (-1.0, "bend", 5.0, "times from 0 are allowed"),
        (math.inf, "cc64", 0.5, "times from 0 are allowed"),
    ],
)
def test_controls_out_of_range(time: float, kind: str, value: float, said: str) -> None:
    with pytest.raises(ScoreError, match=said):
        Control(time, kind, value)


@pytest.mark.parametrize("glide", [(math.nan, 1.0), (-0.1, 1.0), (math.inf, 1.0), (0.1, math.nan), (0.1, 400.0)])
def test_a_glide_that_is_no_place_in_time_and_pitch_is_refused(glide: tuple[float, float]) -> None:
    Note(0.0, note=45, glides=((0.0, 0.0), (0.1, -384.0)))
    with pytest.raises(ScoreError, match=r"a glide of a note is .*: times from 0 and up to 384 semitones are allowed"):
        Note(0.0, note=45, glides=((0.0, 0.0), glide))


def test_quarter_notes_of_a_time_are_found_among_many_tempos_in_few_steps():
    looked: list[int] = []

    class Counted(UserList[tuple[float, float, float]]):
        def __getitem__(self, i):
            looked.append(i)
            return super().__getitem__(i)

    beats = Beats(Counted([(0.5 * i, float(i), 120.0) for i in range(4096)] + [(2048.0, 4096.0, 60.0)]))
    times = (-1.0, 0.0, 0.25, 100.1, 2048.0, 2050.0)
    assert [beats.quarter(time) for time in times] == pytest.approx([-2, 0, 0.5, 200.2, 4096, 4098])
    assert len(looked) < 20 * len(times)
