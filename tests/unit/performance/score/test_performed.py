"""Written music played: times, lengths, velocities, strokes, bends and pedals, worked out by hand."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.performance.score.bend_curves import bend_curve
from tonewood.performance.score.harmonics import antinode_near, interval, middle_node, partial_at, touched
from tonewood.performance.score.limits import Allowance, number, whole
from tonewood.performance.score.note import Beats
from tonewood.performance.score.score_clock import ScoreClock, near
from tonewood.performance.score.unfolding import Measure, lost_jumps, number_endings, order
from tonewood.performance.score.written import WrittenMusic, WrittenNote, WrittenPart, performed

F = Fraction


def w(at: float, length: float, pitch: float = 60.0, **more: Any) -> WrittenNote:
    return WrittenNote(F(at), F(length), pitch, **more)


def play(*notes: WrittenNote, measures: Sequence[Measure] = (), tablature: bool = False, **part: Any) -> tw.Score:
    """One part, a measure long where no others are given, one quarter note a second."""
    listed = list(measures) or [Measure(F(100), tempos=[(F(0), 60.0)])]
    return performed(WrittenMusic(Path("t"), listed, [WrittenPart("p", [list(notes)], **part)], tablature=tablature))


def spans(score: tw.Score) -> list[tuple[float, float, float]]:
    return [(round(n.time, 9), round(n.duration, 9), float(n.note or 0)) for n in score.notes]


@pytest.mark.parametrize(
    ("velocity", "signs", "played"),
    [
        (80, (), 80), (80, ("accent",), 96), (80, ("marcato",), 108), (80, ("ghost",), 56), (120, ("accent",), 127),
        (111, ("accent",), 127), (110, ("accent",), 126), (20, ("ghost",), 1), (26, ("ghost",), 2),
        (60, ("accent", "marcato"), 104),
    ],
)  # fmt: skip
def test_accents_change_the_velocity_within_1_to_127(velocity: int, signs: tuple[str, ...], played: int) -> None:
    (one,) = play(w(0, 1, velocity=velocity, signs=signs)).notes
    assert (one.velocity_midi, one.marks) == (played, ())


@pytest.mark.parametrize(
    ("more", "begin", "duration", "marks"),
    [
        ({}, 2.0, 2.0, ()),
        ({"signs": ("staccato",)}, 2.0, 1.0, ()),
        ({"signs": ("dead",)}, 2.0, 0.05, ("dead_note",)),
        ({"signs": ("dead", "staccato", "palm_mute")}, 2.0, 0.05, ("palm_mute", "dead_note")),
        ({"signs": ("let_ring",)}, 2.0, 8.0, ()),
        ({"signs": ("let_ring",), "string": 3}, 2.0, 10.0, ()),
        ({"delay": F(1, 2)}, 2.5, 1.5, ()),
        ({"delay": F(3)}, 3.0, 1.0, ()),
        ({"strum": 2}, 2.024, 1.976, ()),
        ({"length": F(1, 100)}, 2.0, 0.02, ()),
        ({"fret": 3, "string": 2}, 2.0, 2.0, ("tablature",)),
    ],
)  # fmt: skip
def test_length_of_a_note_by_its_signs(
    more: dict[str, Any], begin: float, duration: float, marks: tuple[str, ...]
) -> None:
    (one,) = play(replace(w(2, 2), **more)).notes
    assert (one.time, one.duration) == (pytest.approx(begin, abs=1e-12), pytest.approx(duration, abs=1e-12))
    assert one.marks == marks


def test_a_note_that_rings_ends_where_its_string_is_struck_again() -> None:
    ring = {"signs": ("let_ring",)}
    score = play(w(0, 1, string=3, **ring), w(5, 1, 62, string=3), w(6, 1, 64, string=2), w(7, 1, 65, string=2, **ring))
    assert spans(score) == [(0.0, 5.0, 60.0), (5.0, 1.0, 62.0), (6.0, 1.0, 64.0), (7.0, 9.0, 65.0)]
    assert [n.channel for n in score.notes] == [0, 0, 1, 1]


def test_a_string_that_rings_stays_bent_until_it_is_struck_again_or_silent() -> None:
    bent = w(0, 1, string=3, bend=((0.0, 200.0),), signs=("let_ring",))
    assert bends(play(bent)) == [(0.0, 200.0), (9.0, 0.0)]
    assert bends(play(bent, w(5, 1, 62, string=3))) == [(0.0, 200.0), (5.0, 0.0)]
    pedals = [(0, F(0), 0.0, "cc64", 1.0), (0, F(4), 0.0, "cc64", 0.0)]
    assert bends(play(replace(bent, signs=()), w(0, 6, 65, string=2), pedals=pedals)) == [(0.0, 200.0), (4.0, 0.0)]
    # another voice strikes the string while it is still written
    assert bends(play(w(0, 4, string=3, bend=((0.0, 0.0), (0.5, 0.0), (0.5, 100.0))), w(1, 1, 62, string=3))) == [
        (0.0, 0.0),
        (1.0, 0.0),
    ]
    # without a string the channel is that of the part's other notes
    assert bends(play(replace(bent, string=None))) == [(0.0, 200.0), (1.0, 0.0)]


def test_stops_count_from_the_nut_and_programs_from_the_part() -> None:
    (one,) = play(w(0, 1, string=2, fret=3), capo=2, program=25, n_drums=4).notes
    assert (one.stop, one.program, one.partial) == (5.0, 25, None)
    score = play(w(0, 1, partial=3), program=25, n_drums=4)
    assert (score.notes[0].stop, score.notes[0].partial) == (None, 3)
    (part,) = score.parts
    assert (part.number, part.name, part.programs, part.n_drums) == (1, "p", {25: 1}, 4)
    assert play(program=25).parts[0].programs == {}


@pytest.mark.parametrize(
    ("note", "notes"),
    [
        # strokes of a quarter; a rest of less than 1/96 belongs to the last one
        (w(1, 1, tremolo=F(1, 4)), [(1 + i / 4, 0.25, 60.0, ()) for i in range(4)]),
        (w(1, 0.625, tremolo=F(1, 4)), [(1, 0.25, 60, ()), (1.25, 0.25, 60, ()), (1.5, 0.125, 60, ())]),
        (WrittenNote(F(1), F(1, 2) + F(1, 96), 60.0, tremolo=F(1, 4)), [(1, 0.25, 60, ()), (1.25, 0.25, 60, ())]),
        (
            WrittenNote(F(1), F(1, 2) + F(1, 95), 60.0, tremolo=F(1, 4)),
            [(1, 0.25, 60, ()), (1.25, 0.25, 60, ()), (1.5, 0.02, 60, ())],
        ),
        # a trill alternates in eighths of a quarter where no tremolo says otherwise
        (
            w(0, 0.5, trill=62.0),
            [(0, 0.125, 60, ()), (0.125, 0.125, 62, ("hammer_on",)), (0.25, 0.125, 60, ("pull_off",)),
             (0.375, 0.125, 62, ("hammer_on",))],
        ),
        (
            w(0, 0.75, trill=59.0, tremolo=F(1, 4)),
            [(0, 0.25, 60, ()), (0.25, 0.25, 59, ("pull_off",)), (0.5, 0.25, 60, ("hammer_on",))],
        ),
        # turns have three notes of 1/12 of a quarter, mordents two of 1/8, of notes below a quarter as shares of them
        (
            w(0, 2, signs=("turn",)),
            [(0, 1 / 12, 62, ()), (1 / 12, 1 / 12, 60, ()), (1 / 6, 1 / 12, 59, ()), (0.25, 1.75, 60, ())],
        ),
        (
            w(0, 0.5, 64, signs=("inverted_turn",)),
            [(0, 1 / 24, 63, ()), (1 / 24, 1 / 24, 64, ()), (1 / 12, 1 / 24, 65, ()), (0.125, 0.375, 64, ())],
        ),
        (w(0, 1, 65, signs=("mordent",)), [(0, 0.125, 65, ()), (0.125, 0.125, 64, ()), (0.25, 0.75, 65, ())]),
        (
            w(0, 1, 65, signs=("inverted_mordent",), steps=(3, 1)),
            [(0, 0.125, 65, ()), (0.125, 0.125, 66, ()), (0.25, 0.75, 65, ())],
        ),
        (
            w(0, 1, 65, signs=("mordent",), steps=(3, 1)),
            [(0, 0.125, 65, ()), (0.125, 0.125, 62, ()), (0.25, 0.75, 65, ())],
        ),
    ],
)  # fmt: skip
def test_notes_that_a_sign_is_played_as(note: WrittenNote, notes: list[tuple[float, float, float, Any]]) -> None:
    played = [(n.time, n.duration, n.note, n.marks) for n in play(note).notes]
    assert [(p, m) for _, _, p, m in played] == [(p, m) for _, _, p, m in notes]
    assert [x for t, d, _, _ in played for x in (t, d)] == pytest.approx([x for t, d, _, _ in notes for x in (t, d)])


def test_later_strokes_keep_marks_but_not_the_arrival_and_move_the_stop() -> None:
    signs = ("hammer_on", "palm_mute", "slide")
    notes = play(w(0, 0.5, 60, trill=59.0, signs=signs, tremolo=F(1, 4), fret=0, string=2)).notes
    assert [n.marks for n in notes] == [
        ("hammer_on", "palm_mute", "slide", "tablature"), ("palm_mute", "tablature", "pull_off"),
    ]  # fmt: skip
    assert [n.stop for n in notes] == [0.0, None]  # there is no stop below the open string
    high = play(w(0, 0.5, 60, trill=63.0, tremolo=F(1, 4), fret=1, string=2), capo=1).notes
    assert [n.stop for n in high] == [2.0, 5.0]


def test_grace_notes_take_an_eighth_of_a_quarter_or_a_quarter_of_the_next_note() -> None:
    assert spans(play(w(1, 0, 59), w(1, 1))) == [(1.0, 0.125, 59.0), (1.125, 0.875, 60.0)]
    assert spans(play(w(1, 0, 59), w(1, 0.25))) == [(1.0, 0.0625, 59.0), (1.0625, 0.1875, 60.0)]
    assert spans(play(w(1, 0, 59))) == [(1.0, 0.125, 59.0)]
    # two in a row; on strings only the note of the same string comes later, or all where it has none
    two = [(0.0, 0.03125, 57.0), (0.03125, 0.09375, 58.0), (0.125, 0.875, 60.0)]
    assert spans(play(w(0, 0, 57), w(0, 0, 58), w(0, 1))) == two
    other = play(w(0, 0, 59, string=1), w(0, 1, 60, string=1), w(0, 1, 50, string=2))
    assert spans(other) == [(0.0, 0.125, 59.0), (0.0, 1.0, 50.0), (0.125, 0.875, 60.0)]
    every = play(w(0, 0, 59, string=3), w(0, 1, 60, string=1), w(0, 1, 50, string=2))
    assert [t for t, _, _ in spans(every)] == [0.0, 0.125, 0.125]


def test_notes_that_are_out_of_range_are_counted() -> None:
    score = play(w(0, 1, -0.5), w(0, 1, 0), w(0, 1, 140), w(0, 1, 140.5), w(0, 1, trill=141.0), w(0, 1, trill=140.0))
    assert score.ignored == {"note whose pitch is out of range": 3}
    long = [Measure(F(1), tempos=[(F(0), 4.0)])]
    assert play(w(0, 1440, 60), w(0, 1441, 60), measures=long).ignored == {
        "note that begins or ends beyond 6 hours": 1
    }  # 1440 quarters at four a minute are six hours


@pytest.mark.parametrize(
    ("tablature", "rest", "measure", "struck"),
    [
        (False, F(1, 64), 0, 1),
        (False, F(1, 63), 0, 2),
        (True, F(1), 0, 1),
        (True, F(1), 3, 1),
        (True, F(1), 4, 2),
    ],
)
def test_ties_reach_over_a_64th_or_three_measures_of_a_tablature(
    tablature: bool, rest: Fraction, measure: int, struck: int
) -> None:
    measures = [Measure(F(4), tempos=[(F(0), 60.0)] if i == 0 else []) for i in range(5)]
    part: list[list[WrittenNote]] = [[w(0, 1, string=1)], *([] for _ in range(4))]
    part[measure].append(WrittenNote(1 + rest if measure == 0 else F(0), F(1), 60.0, string=1, tied=True))
    score = performed(WrittenMusic(Path("t"), measures, [WrittenPart("p", part)], tablature=tablature))
    assert len(score.notes) == struck
    if struck == 1:
        assert score.notes[0].duration == pytest.approx(float(4 * measure + (2 + rest if measure == 0 else 1)))


def test_a_tie_of_a_tablature_keeps_to_its_string() -> None:
    notes = [w(0, 1, 60, string=1), w(1, 1, 67, string=1, tied=True), w(1, 1, 60, string=2, tied=True)]
    assert spans(play(*notes, tablature=True)) == [(0.0, 2.0, 60.0), (1.0, 1.0, 60.0)]
    assert len(play(*notes).notes) == 3  # elsewhere it needs the pitch


def test_slides_arrive_with_or_without_a_stroke() -> None:
    for arrives, n_notes, duration in (("legato", 1, 2.0), ("shift", 2, 1.0)):
        notes = play(w(0, 1, 60, string=1, fret=5), w(1, 1, 62, string=1, fret=7, arrives=arrives)).notes
        assert (len(notes), notes[0].duration, notes[0].glides) == (n_notes, duration, ((1.0, 2.0),))
    # a note that is struck for another reason is struck
    for more in ({"tremolo": F(1)}, {"trill": 63.0}, {"partial": 2}, {"signs": ("dead",)}, {"signs": ("turn",)}):
        second = w(1, 1, 62, string=1, arrives="legato", **more)  # type: ignore[arg-type]
        assert len([n for n in play(w(0, 1, 60, string=1), second).notes if n.time >= 1.0]) >= 1


@pytest.mark.parametrize(
    ("slides", "fret", "length", "glides"),
    [
        (("into_from_below",), None, 1, ((0.0, -2.0), (0.15, 0.0))),
        (("into_from_below",), 1, 1, ((0.0, -1.0), (0.15, 0.0))),
        (("into_from_above",), 1, 1, ((0.0, 2.0), (0.15, 0.0))),
        (("into_from_above",), None, 0.25, ((0.0, 2.0), (0.1, 0.0))),
        (("out_down",), None, 1, ((1.0, -2.0),)),
        (("out_down",), 1, 1, ((1.0, -1.0),)),
        (("out_up",), 1, 1, ((1.0, 2.0),)),
        (("into_from_below", "out_up"), None, 1, ((0.0, -2.0), (0.15, 0.0), (1.0, 2.0))),
    ],
)
def test_slides_into_and_out_of_a_note(
    slides: tuple[str, ...], fret: int | None, length: float, glides: tuple[tuple[float, float], ...]
) -> None:
    (one,) = play(w(3, length, slides=slides, fret=fret, string=1)).notes
    assert one.glides == tuple(pytest.approx(g) for g in glides)


def test_a_slide_out_starts_where_the_stop_has_arrived() -> None:
    notes = (w(0, 1, 60, string=1, fret=1), w(1, 1, 59, string=1, fret=0, arrives="legato", slides=("out_down",)))
    assert play(*notes).notes[0].glides == ((1.0, -1.0), (2.0, -1.0))  # no fret is left below
    up = (w(0, 1, 60, string=1, fret=1), w(1, 1, 62, string=1, fret=3, arrives="legato", slides=("out_up",)))
    assert play(*up).notes[0].glides == ((1.0, 2.0), (2.0, 4.0))


def bends(score: tw.Score) -> list[tuple[float, float]]:
    return [(round(c.time, 6), c.value) for c in score.controls if c.kind == "bend"]


def test_a_bend_follows_its_curve_every_20_ms_and_returns() -> None:
    """Up by 100 cents in the first half of 1 s, held; changes alone are kept."""
    score = play(w(2, 1, bend=bend_curve([(0.5, 100.0), (0.0, 0.0), (1.0, 100.0)])))
    rows = bends(score)
    assert rows == [(round(2.0 + k / 50, 6), 4.0 * k) for k in range(26)] + [(3.0, 0.0)]
    both = play(w(0, 1, bend=((0.0, 50.0),), whammy=((0.0, -20.0), (1.0, -20.0))))
    assert bends(both) == [(0.0, 30.0), (1.0, 0.0)]
    step = play(w(0, 1, bend=((0.0, 0.0), (0.5, 0.0), (0.5, 100.0), (1.0, 100.0))))
    assert [v for _, v in bends(step)] == [0.0, 100.0, 0.0]
    late = bends(play(w(0, 1, bend=((0.4, 30.0), (0.6, 50.0)))))
    assert late[0] == (0.0, 30.0)
    assert late[-2] == (0.6, 50.0)


@pytest.mark.parametrize(("sign", "depth"), [("vibrato", 35.0), ("wide_vibrato", 80.0)])
def test_a_vibrato_is_a_squared_sine_of_5_5_hz(sign: str, depth: float) -> None:
    rows = bends(play(w(1, 0.5, signs=(sign,))))
    heard, value = [], math.nan
    for k in range(25):
        cents = round(depth * math.sin(math.pi * 5.5 * 0.02 * k) ** 2)
        if cents != value:
            heard.append((round(1 + 0.02 * k, 6), float(cents)))
        value = cents
    assert rows == [*heard, (1.5, 0.0)]


@pytest.mark.parametrize("bent", [{"bend": ((0.0, 200.0),)}, {"whammy": ((0.0, 200.0),)}, {"signs": ("vibrato",)}])
def test_a_bent_note_without_a_string_bends_no_other_note(bent: dict[str, Any]) -> None:
    score = play(w(0, 2, 64, **bent), w(0, 2, 67), w(1, 1, 71))
    by_pitch = {note.note: note.channel for note in score.notes}
    assert by_pitch[67.0] == by_pitch[71.0] != by_pitch[64.0]
    assert {c.channel for c in score.controls} == {by_pitch[64.0]}
    # a melody keeps its channel
    alone = play(w(0, 1, 64, **bent), w(1, 1, 67), w(2, 1, 64, **bent))
    assert {n.channel for n in alone.notes} | {c.channel for c in alone.controls} == {0}
    tied = play(w(0, 1, 64), w(0, 2, 67), w(1, 1, 64, tied=True, **bent))
    assert {c.channel for c in tied.controls}.isdisjoint({n.channel for n in tied.notes if n.note == 67.0})


def test_a_tie_goes_on_where_its_own_note_ends_beside_another_voice_of_its_pitch() -> None:
    # of a half note tied to a quarter, beside a shorter and a longer one of another voice
    shorter = [w(0, 2), w(1, 0.5), w(2, 1, tied=True), w(3, 1, tied=True)]
    assert spans(play(*shorter)) == [(0.0, 4.0, 60.0), (1.0, 0.5, 60.0)]
    longer = [w(0, 2), w(1, 5), w(2, 1, tied=True), w(3, 1, tied=True)]
    assert spans(play(*longer)) == [(0.0, 4.0, 60.0), (1.0, 5.0, 60.0)]


def test_a_tied_note_keeps_the_bend_of_the_first_or_has_its_own() -> None:
    first = w(0, 1, bend=((0.0, 100.0),))
    assert bends(play(first, w(1, 1, tied=True))) == [(0.0, 100.0), (2.0, 0.0)]
    assert bends(play(replace(first, whammy=((0.0, -30.0),)), w(1, 1, tied=True))) == [(0.0, 70.0), (2.0, 0.0)]
    moved = play(first, w(1, 1, tied=True, whammy=((0.0, 0.0), (1.0, -50.0))), w(2, 1, tied=True))
    assert [v for t, v in bends(moved) if t >= 2] == [50.0, 0.0]
    released = w(0, 1, bend=((0.0, 100.0), (1.0, 0.0)))
    assert bends(play(released, w(1, 1, tied=True)))[-2:] == [(1.0, 0.0), (2.0, 0.0)]
    trembling = [v for _, v in bends(play(first, w(1, 1, tied=True, signs=("vibrato",))))]
    assert (min(trembling[:-1]), max(trembling)) == (100.0, 135.0)
    slid = play(replace(first, string=2), w(1, 1, 62.0, string=2, arrives="legato"))
    assert bends(slid) == [(0.0, 100.0), (1.0, 0.0), (2.0, 0.0)]
    second = w(1, 1, tied=True, bend=((0.0, 40.0),))
    assert bends(play(first, second)) == [(0.0, 100.0), (1.0, 40.0), (2.0, 0.0)]
    assert bends(play(w(0, 1), second)) == [(1.0, 40.0), (2.0, 0.0)]
    assert bends(play(w(0, 1))) == []


@pytest.mark.parametrize(
    ("points", "curve"),
    [
        ([(0.5, 0.0), (0.0, 0.0)], ()),
        ([], ()),
        ([(1.5, 10.0), (-0.5, 5.0)], ((0.0, 5.0), (1.0, 10.0))),
        ([(0.5, 0.0), (0.25, 20.0)], ((0.25, 20.0), (0.5, 0.0))),
    ],
)
def test_bend_curves_are_in_order_and_within_the_note(points: list[tuple[float, float]], curve: Any) -> None:
    assert bend_curve(points) == curve


def test_notes_under_a_pedal_last_until_it_comes_up() -> None:
    """Down at 1 s, up at 4 s: a note that ends before is left, one within lasts, one after ends as written."""
    pedals = [
        (0, F(1), 0.0, "cc64", 1.0),
        (0, F(4), 0.5, "cc64", 0.0),
        (0, F(5), 0.0, "cc67", 1.0),
    ]
    score = play(w(0, 0.5, 60), w(0, 2, 62), w(1, 1, 64, string=2), w(4, 2, 65), pedals=pedals)
    assert [(n.note, n.duration, n.held) for n in score.notes] == [
        (60.0, 0.5, None), (62.0, 4.5, 2.0), (64.0, 3.5, 1.0), (65.0, 2.0, None),
    ]  # fmt: skip
    moves = [(c.time, c.kind, c.value, c.channel) for c in score.controls]
    kinds = [(1.0, "cc64", 1.0), (4.5, "cc64", 0.0), (5.0, "cc67", 1.0)]
    assert moves == [(*row, channel) for row in kinds for channel in (0, 1)]
    # one that stays down lasts until the last note ends; halfway counts as down
    for value, durations in ((0.5, [3.0, 2.0]), (0.49, [1.0, 2.0])):
        down = play(w(0, 1, 60), w(1, 2, 62), pedals=[(0, F(0), 0.0, "cc64", value)])
        assert [n.duration for n in down.notes] == durations


def test_more_than_sixteen_strings_share_channels_and_bends_are_warned_of() -> None:
    bent = {"bend": ((0.0, 100.0),)}
    many = [w(0, 1, 60 + i, string=i + 1, **(bent if i == 0 else {})) for i in range(17)]
    score = play(*many)
    assert sorted(n.channel or 0 for n in score.notes) == [0, 0, *range(1, 16)]
    assert score.warnings == ["more than 16 strings: bends of some are those of others, too; choose fewer --tracks"]
    assert play(*many[:16]).warnings == []
    assert play(*(w(0, 1, 60 + i, string=i + 1) for i in range(17))).warnings == []


@pytest.mark.parametrize(
    ("at", "length", "begin", "end"),
    [
        (0.0, 0.5, 0.0, 2 / 3), (0.5, 0.5, 2 / 3, 1.0), (1.0, 0.5, 1.0, 5 / 3), (0.5, 1.0, 0.5, 1.5),
        (0.25, 0.5, 0.25, 0.75), (0.5, 0.25, 0.5, 0.75),
    ],
)  # fmt: skip
def test_swing_moves_the_middle_of_two_eighths_to_two_thirds(
    at: float, length: float, begin: float, end: float
) -> None:
    measure = Measure(F(4), tempos=[(F(0), 60.0)], feel=(F(1, 2), F(2, 3)))
    (one,) = play(w(at, length), measures=[measure]).notes
    assert (one.time, one.time + one.duration) == (pytest.approx(begin), pytest.approx(end))


def test_parts_are_chosen_by_number() -> None:
    parts = [WrittenPart(name, [[w(0, 1, pitch)]]) for name, pitch in (("low", 40.0), ("", 60.0), ("high", 80.0))]
    music = WrittenMusic(Path("t"), [Measure()], parts)
    assert [n.note for n in performed(music, [3, 1]).notes] == [80.0, 40.0]
    assert [p.number for p in performed(music, [3, 1]).parts] == [3, 1]
    for number_, line in ((0, "there is no part 0; there are 1 low, 2, 3 high"), (4, "there is no part 4")):
        with pytest.raises(ScoreError, match=line):
            performed(music, [number_])


def test_tempos_out_of_range_are_counted_and_others_taken() -> None:
    music = WrittenMusic(Path("t"), [], [])
    measure = Measure()
    for bpm in (3.9, 4.0, 2000.0, 2000.1):
        music.tempo(measure, F(0), bpm)
    assert [bpm for _, bpm in measure.tempos] == [4.0, 2000.0]
    assert music.ignored == {"tempo outside 4 to 2000": 2}


def clock(*measures: Measure) -> ScoreClock:
    return ScoreClock(measures, range(len(measures)), Path("t"))


def test_seconds_of_quarters_by_hand() -> None:
    """120 a minute before the first mark, 60 from the second quarter on, a fermata of one quarter at half of that."""
    one = clock(
        Measure(F(4), tempos=[(F(2), 60.0)], holds={(F(3), F(4))}),
        Measure(F(3), tempos=[(F(0), 90.0)]),
    )
    assert [one.seconds(F(q)) for q in (0, 1, 2, 3, 4, 7)] == pytest.approx([0.0, 0.5, 1.0, 2.0, 3.5, 5.5])
    assert one.seconds(F(-1)) == -0.5
    beats = one.beats([Measure(F(4)), Measure(F(3))], [0, 1])
    assert list(beats.meters) == [(0.0, 4.0), (4.0, 3.0)]
    expected = [(0.0, 0.0, 120.0), (1.0, 2.0, 60.0), (2.0, 3.0, 40.0), (3.5, 4.0, 60.0), (3.5, 4.0, 90.0)]
    assert [tuple(map(float, t)) for t in beats.tempos] == [pytest.approx(t) for t in expected]
    assert [beats.quarter(t) for t in (0.25, 1.5, 3.5, 5.5)] == pytest.approx([0.5, 2.5, 4.0, 7.0])
    assert list(clock(Measure(F(0))).beats([Measure(F(0))], [0]).meters) == [(0.0, 4.0)]


def test_two_fermatas_at_once_hold_as_long_as_one_and_adjacent_ones_both() -> None:
    holds = {(F(0), F(2)), (F(1), F(2)), (F(2), F(3))}
    assert clock(Measure(F(4), tempos=[(F(0), 60.0)], holds=holds)).seconds(F(4)) == pytest.approx(1.5 * 3 + 1)


@pytest.mark.parametrize(("early", "late"), [([-1], 0.5), ([-1, -2], 1.0), ([-4], 2.0), ([-5], 0.0), ([], 0.0)])
def test_notes_before_the_first_measure_delay_all_by_at_most_two_seconds(early: list[int], late: float) -> None:
    one = clock(Measure(F(4)))
    one.begin_before(F(q) for q in early)
    assert one.seconds(F(0)) == late


def test_music_of_more_than_six_hours_is_refused() -> None:
    slow = Measure(F(1440), tempos=[(F(0), 4.0)])
    assert clock(slow).seconds(F(1440)) == 21600.0
    with pytest.raises(ScoreError, match="21601 s of music, repeats unfolded: 21600 s are allowed"):
        clock(Measure(F(1440) + F(1, 15), tempos=[(F(0), 4.0)]))


def test_times_are_rounded_where_their_denominators_are_no_musics() -> None:
    assert near(F(1, 10**9)) == F(1, 10**9)
    assert near(F(10**9 + 1, 2 * 10**9 + 1)).denominator <= 10**9


def test_beats_without_tempos_are_120_in_common_time() -> None:
    assert Beats().quarter(3.0) == 6.0
    assert Beats().measures(4.0) == [0.0, 4.0]
    assert Beats().measures(4.1) == [0.0, 4.0, 8.0]
    assert Beats().measures(0.0) == [0.0]
    assert Beats([(1.0, 2.0, 60.0)]).quarter(0.0) == 1.0  # before the first tempo, at its speed


@pytest.mark.parametrize(
    ("signs", "tablature", "lost"),
    [
        (["da_capo", "fine"], False, {}),
        (["dal_segno"], False, {"dal segno without a segno": 1}),
        (["dal_segno", "segno"], False, {"dal segno without a segno": 1}),
        (["dal_segno", "segno"], True, {}),
        (["dal_segno_segno_al_coda"], True, {"dal segno segno without a segno segno": 1}),
        (["to_coda"], True, {"to coda without a coda": 1}),
        (["coda", "to_coda"], False, {"to coda without a coda": 1}),
        (["coda", "to_coda"], True, {}),
        (["to_double_coda", "to_double_coda"], False, {"to double coda without a double coda": 2}),
    ],
)
def test_jumps_that_lead_nowhere(signs: list[str], tablature: bool, lost: dict[str, int]) -> None:
    assert lost_jumps([Measure(signs={sign}) for sign in signs], tablature=tablature) == Counter(lost)


@pytest.mark.parametrize(
    ("measures", "tablature", "played"),
    [
        # after a jump no repeat is played, from the coda on they are
        ([Measure(closes=2), Measure(signs={"to_coda"}), Measure(signs={"da_capo"}), Measure(signs={"coda"}, closes=2)],
         False, [0, 0, 1, 2, 0, 1, 3, 3]),
        # each jump is taken once; after one of them no other is
        ([Measure(signs={"segno"}), Measure(signs={"dal_segno"}), Measure(signs={"da_capo"})],
         False, [0, 1, 0, 1, 2]),
        # a tablature's jump without a name obeys nothing, one with a name that alone
        ([Measure(signs={"fine"}), Measure(signs={"da_capo"})], True, [0, 1, 0, 1]),
        ([Measure(signs={"fine"}), Measure(signs={"da_capo_al_fine"})], True, [0, 1, 0]),
        ([Measure(signs={"fine"}), Measure(signs={"da_capo"})], False, [0, 1, 0]),
        # its nearest segno before the jump, in a score the first one
        ([Measure(signs={"segno"}), Measure(signs={"segno"}), Measure(signs={"dal_segno"})], True, [0, 1, 2, 1, 2]),
        ([Measure(signs={"segno"}), Measure(signs={"segno"}), Measure(signs={"dal_segno"})], False, [0, 1, 2, 0, 1, 2]),
        ([], False, []),
        ([Measure(closes=1), Measure()], False, [0, 1]),
    ],
)  # fmt: skip
def test_order_by_hand(measures: list[Measure], tablature: bool, played: list[int]) -> None:
    assert order(measures, tablature=tablature) == played


@pytest.mark.parametrize(
    ("endings", "closes", "numbered"),
    [
        ([{1, 2}, {3}], [2, 0], [3, 0]),
        ([{1}, {2}], [2, 0], [2, 0]),
        ([{1}, {2}], [0, 0], [0, 0]),
        ([set(), {4}], [0, 2], [0, 4]),
        ([set(), {1}], [0, 3], [0, 3]),
        ([{3}, {1}], [0, 2], [0, 3]),
    ],
)
def test_a_repeat_is_played_for_each_pass_that_its_endings_name(
    endings: list[set[int]], closes: list[int], numbered: list[int]
) -> None:
    measures = [Measure(endings=frozenset(e), closes=c) for e, c in zip(endings, closes, strict=True)]
    number_endings(measures)
    assert [m.closes for m in measures] == numbered


@pytest.mark.parametrize(
    ("said", "value", "cut"),
    [
        ("3.5", 3.5, 3), ("-2", -2.0, -2), ("10", 10.0, 10), ("10.1", None, None), ("-2.1", None, None),
        ("x", None, None),
        ("", None, None), ("1" + "0" * 39, None, None), ("0" * 39 + "5", 5.0, 5), ("0" * 40 + "5", None, None),
        (7, 7.0, 7), (10**400, None, None), (None, None, None), ([1], None, None), (float("nan"), None, None),
    ],
)  # fmt: skip
def test_numbers_of_files_within_bounds(said: object, value: float | None, cut: int | None) -> None:
    assert (number(said, -2.0, 10.0), whole(said, -2, 10)) == (value, cut)


def test_an_allowance_counts_down_to_its_limit() -> None:
    allowed = Allowance(3, "things", "f")
    allowed.take()
    allowed.take(2)
    assert allowed.left == 0
    with pytest.raises(ScoreError, match="f: more than 3 things"):
        allowed.take()


@pytest.mark.parametrize(
    ("fret", "partial", "semitones"),
    [(12, 2, 12), (7, 3, 19), (19, 3, 19), (5, 4, 24), (24, 4, 24), (4, 5, 28), (9, 5, 28), (16, 5, 28), (1, None, 0)],
)
def test_a_touch_leaves_a_partial(fret: int, partial: int | None, semitones: int) -> None:
    assert partial_at(fret) == partial
    ignored: Counter[str] = Counter()
    stop, pitch = (0, 40.0 + semitones) if partial else (fret, 40.0 + fret)
    assert touched(fret, 40.0 + fret, float(fret), True, ignored) == (stop, pitch, partial or 0)
    assert touched(3, 43.0, float(fret), False, ignored) == (3, 43.0 + semitones, partial or 0)
    assert sum(ignored.values()) == (0 if partial else 2)
    if partial:
        assert interval(partial) == semitones


@pytest.mark.parametrize(
    ("partial", "middle", "near_quarter"),
    [
        (2, 1 / 2, 1 / 4),
        (3, 1 / 3, 1 / 6),
        (4, 1 / 4, 1 / 8),
        (5, 2 / 5, 3 / 10),
        (6, 1 / 6, 1 / 4),
        (7, 3 / 7, 3 / 14),
    ],
)
def test_nodes_and_antinodes_of_partials(partial: int, middle: float, near_quarter: float) -> None:
    """|sin(n pi x)| is 0 at the node and 1 at the antinode; of these the one at most half a spacing away."""
    assert middle_node(partial) == pytest.approx(middle)
    place = antinode_near(partial, 0.25)
    assert abs(math.sin(partial * math.pi * place)) == pytest.approx(1.0)
    assert abs(place - 0.25) <= 0.5 / partial + 1e-12
    if partial not in (4,):
        assert place == pytest.approx(near_quarter)
    assert antinode_near(partial, 0.0) == pytest.approx(0.5 / partial)
    assert antinode_near(partial, 1.0) == pytest.approx(1 - 0.5 / partial)
