"""Costs of fingerings, lengths of notation and numbers of files, each worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from smf_bytes import event, smf
from tablatures import GPIF, gpif, guitar_pro, musicxml, note

import tonewood as tw
from tonewood.performance.score import gpif as gpif_module
from tonewood.performance.score.assignment import Assigned, PlayableString, assign
from tonewood.performance.score.bend_curves import Curve
from tonewood.performance.score.fingering import Chord, FingeringCosts, Option, Sounding, finger, hand_after
from tonewood.performance.score.musicxml_words import bend_of, passes_of, velocity_of
from tonewood.performance.score.note import Beats
from tonewood.performance.score.tablature import Tablature, _grid, tablature, text
from tonewood.performance.score.tablature import musicxml as written

F = Fraction
GUITAR = [
    PlayableString.fretted(name, pitch, 19)
    for name, pitch in {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64}.items()
]


def struck(time: float, *notes: tuple[int, float, float]) -> Chord:
    """Chord of (string, stop, duration), each with one place."""
    ends, durations = tuple(time + d for *_, d in notes), tuple(d for *_, d in notes)
    return Chord(time, ends, durations, tuple((Option(s, stop),) for s, stop, _ in notes))


@pytest.mark.parametrize(
    ("chords", "sounding", "cost"),
    [
        # a tenth of the stops, a shift by one each, from stop 1
        ([struck(0, (0, 1.0, 1))], {}, 0.1),
        ([struck(0, (0, 5.0, 1))], {}, 0.5 + 1.0),
        ([struck(0, (0, 0.0, 1), (1, 0.0, 1))], {}, 0.0),
        # a span of five is two too many; the hand stays at 1, as the lower finger has it
        ([struck(0, (0, 1.0, 1), (1, 6.0, 1))], {}, 0.7 + 4.0),
        ([struck(0, (0, 1.0, 1), (1, 4.0, 1))], {}, 0.5),
        # a finger at stop 1 that the hand leaves behind, half of its note before the end; an open string rings on
        ([struck(0, (0, 1.0, 2)), struck(1, (1, 8.0, 1))], {}, 0.9 + 4.0 + 6.0 / 2),
        ([struck(0, (0, 0.0, 2)), struck(1, (1, 8.0, 1))], {}, 0.8 + 4.0),
        # a hand that moves down, to four stops below a finger that holds its note, and to five
        ([struck(0, (0, 9.0, 4)), struck(1, (1, 5.0, 1))], {}, 1.4 + 6.0),
        ([struck(0, (0, 9.0, 4)), struck(1, (1, 4.0, 1))], {}, 1.3 + 7.0 + 6.0 * 3 / 4),
        # the same of a note two chords ago, and of an open string
        ([struck(0, (0, 1.0, 4)), struck(1, (1, 1.0, 1)), struck(2, (1, 8.0, 1))], {}, 1.0 + 4.0 + 6.0 * 2 / 4),
        ([struck(0, (0, 0.0, 4)), struck(1, (1, 1.0, 1)), struck(2, (1, 8.0, 1))], {}, 0.9 + 4.0),
        # a finger that has left its note does not cost again; the string rings on, and is cut by another stop
        ([struck(0, (0, 1.0, 4)), struck(1, (1, 8.0, 1)), struck(2, (1, 9.0, 1))], {}, 1.8 + 5.0 + 6.0 * 3 / 4),
        (
            [struck(0, (0, 1.0, 4)), struck(1, (1, 8.0, 1)), struck(2, (0, 9.0, 1))],
            {},
            1.8 + 5.0 + 6.0 * (3 / 4 + 2 / 4),
        ),
        # a note that is ended by another stop, or by the same one; within a millisecond of its end neither costs
        ([struck(0, (0, 2.0, 4)), struck(1, (0, 3.0, 1))], {}, 0.5 + 6.0 * 3 / 4),
        ([struck(0, (0, 2.0, 4)), struck(1, (0, 2.0, 1))], {}, 0.4),
        ([struck(0, (0, 2.0, 1.0009)), struck(1, (0, 3.0, 1))], {}, 0.5),
        ([struck(0, (0, 2.0, 1.0011)), struck(1, (0, 3.0, 1))], {}, 0.5 + 6.0 * 0.0011 / 1.0011),
        # what sounds before weighs as it is held
        ([struck(0, (1, 8.0, 1))], {0: Sounding(1.0, 0.5)}, 0.8 + 4.0 + 6.0 / 2),
        ([struck(0, (1, 8.0, 1))], {0: Sounding(0.0, 1.0)}, 0.8 + 4.0),
        ([struck(0, (0, 2.0, 1))], {0: Sounding(0.0, 1.0)}, 0.2 + 6.0),
        ([struck(0, (0, 2.0, 1))], {0: Sounding(3.0, 0.0)}, 0.2),
    ],
)
def test_costs_of_fingerings_with_the_usual_weights(
    chords: list[Chord], sounding: dict[int, Sounding], cost: float
) -> None:
    assert finger(chords, 2, FingeringCosts(), sounding=sounding)[1] == pytest.approx(cost, abs=1e-12)
    assert hand_after(5.0, [Option(0, 1.0), Option(1, 0.0)]) == 1.0


@pytest.mark.parametrize(("apart", "together"), [(0.0, True), (0.001, True), (0.00101, False)])
def test_a_moment_is_a_millisecond(apart: float, together: bool) -> None:
    """Voices share a pluck in it, one string has one note in it, and a note that ends in it is not cut."""
    two = [tw.Note(0.0, 1.0, note=60, channel=0), tw.Note(apart, 1.0, note=60, channel=1)]
    assert len(assign(two, GUITAR).doubled) == together
    low = [tw.Note(0.0, 1.0, note=40), tw.Note(apart, 1.0, note=41)]
    assert len(assign(low, GUITAR).dropped) == together
    long = [tw.Note(1.0, 1.0, note=40), tw.Note(2.0 - apart, 1.0, note=41)]
    assert assign(long, GUITAR).n_cut == (not together)


@pytest.mark.parametrize(("apart", "string"), [(0.03, "G3"), (0.0301, "B3")])
def test_a_chord_begins_within_thirty_milliseconds(apart: float, string: str) -> None:
    notes = [tw.Note(0.0, 0.01, note=59), tw.Note(apart, 0.01, note=60)]
    assert assign(notes, GUITAR).notes[0].string == string


@pytest.mark.parametrize(
    ("notes", "kept"),
    [
        # of three notes on two strings: named ones first, then the loudest, then the outer ones
        ([(60, 80, None), (61, 80, None), (62, 80, None)], {60, 62}),
        ([(60, 80, None), (61, 81, None), (62, 80, None)], {60, 61}),
        ([(60, 80, None), (61, 1, "b"), (62, 90, None)], {61, 62}),
        ([(62, 80, None), (61, 80, None), (60, 80, None)], {60, 62}),
    ],
)
def test_the_most_important_notes_get_the_strings(notes: list[tuple[int, int, str | None]], kept: set[int]) -> None:
    strings = [PlayableString.fretted(name, 60, 5) for name in "ab"]
    chord = [tw.Note(0.0, note=n, velocity_midi=v, string=s, channel=0) for n, v, s in notes]
    result = assign(chord, strings)
    assert {a.note.note for a in result.notes} == kept
    assert [d.reason for d in result.dropped] == ["no string is free beside the other 2 notes at its moment"]


def tab_of(*rows: tuple[float, str]) -> Tablature:
    """Tablature of (quarter note, string) at one quarter a second."""
    notes = [Assigned(tw.Note(at, 0.5, note=60), string, 0.0, 0.0, at + 0.5) for at, string in rows]
    return tablature(notes, GUITAR, Beats([(0.0, 0.0, 60.0)]))


def lengths(tab: Tablature) -> list[tuple[str, str, int, str, str]]:
    """Duration, type, dots, notes in the time of others, edges of the bracket: one of each length that is written."""
    out = []
    for n in ET.fromstring(written(tab)).iter("note"):
        change = n.find("time-modification")
        ratio = "" if change is None else f"{change.findtext('actual-notes')}:{change.findtext('normal-notes')}"
        edges = " ".join(t.get("type", "") for t in n.iter("tuplet"))
        out.append((n.findtext("duration", ""), n.findtext("type", ""), len(n.findall("dot")), ratio, edges))
    return out


@pytest.mark.parametrize(
    ("onsets", "first"),
    [
        ([0, 1 / 3, 2 / 3, 1], [("8", "eighth", 0, "3:2", "start"), ("8", "eighth", 0, "3:2", ""),
                                ("8", "eighth", 0, "3:2", "stop")]),
        ([0, 2 / 3, 1], [("16", "quarter", 0, "3:2", "start"), ("8", "eighth", 0, "3:2", "stop")]),
        ([0, 1 / 6, 1], [("4", "16th", 0, "3:2", "start"), ("16", "quarter", 0, "3:2", ""),
                         ("4", "16th", 0, "3:2", "stop")]),
        ([0, 1 / 2, 2 / 3, 1], [("12", "eighth", 1, "3:2", "start"), ("4", "16th", 0, "3:2", ""),
                                ("8", "eighth", 0, "3:2", "stop")]),
        # a length before a triplet ends with its quarter note
        ([0, 1 + 1 / 3, 2], [("24", "quarter", 0, "", ""), ("8", "eighth", 0, "3:2", "start"),
                             ("16", "quarter", 0, "3:2", "stop")]),
        ([0, 1 + 2 / 3, 2], [("24", "quarter", 0, "", ""), ("16", "quarter", 0, "3:2", "start")]),
        ([0, 3 / 8, 1], [("9", "16th", 1, "", ""), ("12", "eighth", 0, "", ""), ("3", "32nd", 0, "", "")]),
        ([0, 3 / 4, 1], [("18", "eighth", 1, "", ""), ("6", "16th", 0, "", "")]),
    ],
)  # fmt: skip
def test_lengths_of_notation(onsets: list[float], first: list[tuple[str, str, int, str, str]]) -> None:
    assert lengths(tab_of(*((at, "E2") for at in onsets)))[: len(first)] == first


def test_a_whole_quarter_note_is_no_triplet() -> None:
    tab = replace(tab_of((0, "E2"), (1, "E2")), triplets=frozenset({0}))
    assert lengths(tab)[0] == ("24", "quarter", 0, "", "")


@pytest.mark.parametrize(
    ("onsets", "ticks", "triplets"),
    [
        # from 1/3 and from 1/4: 0.0373 and 0.046, of which 0.8 are 0.0368; then 0.0363 and 0.0376
        ([0.296], [6], set()),
        ([0.297], [8], {0}),
        # from 1/3, and from 3/8 with 1/96 more: 0.0227 and 0.8 of 0.0294, then 0.0237 and 0.8 of 0.0284
        ([0.356], [8], {0}),
        ([0.357], [9], set()),
        # 0.015 before a quarter note is within 1/64 of it, and counts there
        ([0.98, 1.297], [24, 32], {1}),
        ([0.985, 1.297], [24, 30], set()),
    ],
)
def test_the_grid_of_a_quarter_note(onsets: list[float], ticks: list[int], triplets: set[int]) -> None:
    assert _grid(onsets) == (ticks, triplets)


def test_fingers_columns_and_a_name() -> None:
    """A quarter tone lower than the third fret is the second finger's; seven frets are four fingers; 10 takes two."""
    stops = [(0.0, "A2", 2.5), (0.0, "E4", 4.0), (0.0, "B3", 0.0), (1.0, "A2", 1.0), (1.0, "E4", 7.0)]
    chord = [Assigned(tw.Note(time, 0.5, note=60), string, stop, 0.0, time + 0.5) for time, string, stop in stops]
    tab = tablature(chord, GUITAR, Beats())
    assert [[(p.row, p.fret, p.finger, p.hand) for p in chord] for _, chord in tab.chords] == [
        [(5, 2, 2, 1), (1, 4, 4, 1), (2, 0, 0, 1)],
        [(5, 1, 1, 1), (1, 7, 4, 1)],
    ]
    tens = [replace(c, stop=10.0 if c.string == "A2" else 9.0) for c in chord if c.string != "B3"]
    rows = text(tablature(tens, GUITAR, Beats())).splitlines()
    assert rows[0] == "Tablature"
    assert (rows[4], rows[8]) == ("E4 |-9----------9---------|", "A2 |-10---------10--------|")
    assert ET.fromstring(written(tab)).findtext("work/work-title") == "Tablature"


def test_one_note_of_a_chord_has_the_bracket() -> None:
    tab = tab_of((0, "E2"), (0, "A2"), (1 / 3, "E2"), (1, "E2"))
    assert [edges for *_, edges in lengths(tab)][:3] == ["start", "", "stop"]


def direction(inside: str) -> str:
    return f"<direction><direction-type>{inside}</direction-type></direction>"


A = note("A", 3, 4)


def test_velocities_of_dynamics(tmp_path: Path) -> None:
    names = ["pppp", "ppp", "pp", "p", "mp", "mf", "f", "ff", "fff", "ffff"]
    notes = "".join(direction(f"<dynamics><{name}/></dynamics>") + A for name in names)
    (tmp_path / "a.musicxml").write_text(musicxml(notes).replace('<repeat direction="backward"/>', ""))
    velocities = [n.velocity_midi for n in tw.read_score(tmp_path / "a.musicxml").notes]
    assert velocities == [8, 20, 33, 49, 64, 80, 96, 112, 126, 127]


def test_dynamics_in_percent_and_passes_of_endings() -> None:
    assert [velocity_of(share) for share in (0.0, 1.0, 50.0, 100.0, 141.0, 200.0)] == [1, 1, 45, 90, 127, 127]
    passes = {"1": {1}, "2-4": {2, 3, 4}, "3-3": {3}, "4-2": set(), "x": set(), "1-": set(), "0": set()}
    assert {word: set(passes_of(word)) for word in passes} == passes
    assert passes_of("9999") == {9999}
    assert passes_of("10000") == frozenset()
    assert passes_of("5-99") == set(range(5, 38))


@pytest.mark.parametrize(
    ("bends", "curve"),
    [
        ([], ()),
        (["<bend-alter>2</bend-alter>"], ((0, 0), (0.5, 200), (1, 200))),
        (["<bend-alter>1</bend-alter><pre-bend/>"], ((0, 100), (0.5, 100), (1, 100))),
        (["<bend-alter>2</bend-alter>", "<bend-alter>-2</bend-alter><release/>"],
         ((0, 0), (0.25, 200), (0.5, 200), (0.75, 0), (1, 0))),
    ],
)  # fmt: skip
def test_bends_of_musicxml_share_their_note(bends: list[str], curve: Curve) -> None:
    assert bend_of(ET.fromstring("<technical>" + "".join(f"<bend>{b}</bend>" for b in bends) + "</technical>")) == curve
    assert bend_of(None) == ()


@pytest.mark.parametrize(
    ("values", "curve"),
    [
        ({}, ()),
        ({"DestinationValue": "100"}, ((0, 0), (1, 200))),
        ({"OriginValue": "50"}, ((0, 100), (1, 0))),
        ({"MiddleValue": "100"}, ((0, 0), (0.5, 200), (0.5, 200), (1, 0))),
        ({"OriginOffset": "10", "OriginValue": "25", "MiddleOffset1": "40", "MiddleOffset2": "60", "MiddleValue": "-50",
          "DestinationOffset": "80", "DestinationValue": "5"}, ((0.1, 50), (0.4, -100), (0.6, -100), (0.8, 10))),
        ({"OriginValue": "4800", "DestinationValue": "-4800"}, ((0, 9600), (1, -9600))),
        ({"OriginValue": "4801", "MiddleValue": "-4801", "DestinationValue": "1"}, ((0, 0), (1, 2))),
    ],
)  # fmt: skip
def test_bends_of_guitar_pro_7(values: dict[str, str], curve: Curve) -> None:
    assert gpif_module._curve(lambda name: values.get(name, "")) == curve


RHYTHM = "<NoteValue>Quarter</NoteValue>"


@pytest.mark.parametrize(
    ("old", "new", "quarters"),
    [
        *((RHYTHM, f"<NoteValue>{name}</NoteValue>", value) for name, value in (
            ("Whole", 4), ("Half", 2), ("Quarter", 1), ("Eighth", F(1, 2)), ("16th", F(1, 4)),
            ("32nd", F(1, 8)), ("64th", F(1, 16)), ("x", F(1, 2)))),
        *((RHYTHM, f'<NoteValue>Half</NoteValue><AugmentationDot count="{n}"/>', 4 - F(2, 2**d)) for n, d in (
            (0, 0), (1, 1), (2, 2), (4, 4), (5, 4))),
        (RHYTHM, '<NoteValue>Quarter</NoteValue><PrimaryTuplet num="3" den="2"/>', F(2, 3)),
        (RHYTHM, "<NoteValue>Half</NoteValue><PrimaryTuplet><Num>5</Num><Den>4</Den></PrimaryTuplet>", F(8, 5)),
        (RHYTHM, '<NoteValue>Quarter</NoteValue><PrimaryTuplet num="0" den="2"/>', 1),
        # a tempo of 60 of its unit: eighth, quarter, dotted quarter, half, dotted half
        *(("60 2", f"60 {unit}", F(2, n)) for unit, n in (("1", 1), ("2", 2), ("3", 3), ("4", 4), ("5", 6), ("", 2))),
    ],
)  # fmt: skip
def test_note_values_and_tempos_of_guitar_pro(
    tmp_path: Path, old: str, new: str, quarters: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert old in GPIF
    monkeypatch.setattr("tablatures.GPIF", GPIF.replace(old, new))
    (one, two) = tw.read_score(gpif(tmp_path / "a.gp", [(0, 1, "", ""), (1, 2, "", "")])).notes
    assert (one.duration, two.time) == (pytest.approx(float(quarters)), pytest.approx(float(quarters)))


def test_numbers_of_guitar_pro_within_their_limits() -> None:
    programs = {"0": 1, "24": 25, "127": 128, "128": None, "-1": None, "": None}
    assert {text: gpif_module._program(text) for text in programs} == programs


def test_beats_of_a_midi_file_follow_tempos_and_meters(tmp_path: Path) -> None:
    """480 ticks a quarter: 60 a minute from the second quarter, 3/4 at once, 6/8 from the fourth quarter on."""
    events = (
        b"\0\xff\x58\4\3\2\x18\x08" + event(0, 0x90, 60, 80) + event(480, 0x80, 60, 0)
        + b"\0\xff\x51\3" + (1_000_000).to_bytes(3, "big") + event(960, 0x90, 62, 80)
        + b"\0\xff\x58\4\6\3\x18\x08" + event(480, 0x80, 62, 0)
    )  # fmt: skip
    (tmp_path / "a.mid").write_bytes(smf(events))
    score = tw.read_midi(tmp_path / "a.mid")
    assert score.beats is not None
    assert [tuple(t) for t in score.beats.tempos] == [pytest.approx(t) for t in ((0, 0, 120), (0.5, 1, 60))]
    assert list(score.beats.meters) == [(0.0, 3.0), (3.0, 3.0)]
    assert [n.time for n in score.notes] == pytest.approx([0.0, 2.5])
    assert score.beats.measures(6.5) == [0.0, 3.0, 6.0, 9.0]
    assert score.beats.quarter(2.5) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("suffix", "fret", "kind", "more", "played"),
    [
        ("gp5", 12, "NaturalHarmonic", {}, (45 + 12, 0.0, 2)),
        ("gp5", 7, "NaturalHarmonic", {}, (45 + 19, 0.0, 3)),
        ("gp5", 2, "PinchHarmonic", {}, (47 + 12, 2.0, 2)),
        ("gp5", 2, "TappedHarmonic", {"fret": 9}, (47 + 19, 2.0, 3)),
        ("gp5", 2, "TappedHarmonic", {"fret": 3}, (47 + 12, 2.0, 2)),  # no node lies there
        # B2 is heard as a B or F sharp, in octaves above it, the first where none is said
        ("gp5", 2, "ArtificialHarmonic", {"pitch": 11, "octave": 0}, (47 + 12, 2.0, 2)),
        ("gp5", 2, "ArtificialHarmonic", {"pitch": 11, "octave": 1}, (47 + 12, 2.0, 2)),
        ("gp5", 2, "ArtificialHarmonic", {"pitch": 11, "octave": 2}, (47 + 24, 2.0, 4)),
        ("gp5", 2, "ArtificialHarmonic", {"pitch": 6, "octave": 1}, (47 + 19, 2.0, 3)),
        ("gp3", 7, "ArtificialHarmonic", {}, (52 + 19, 7.0, 3)),
        ("gp3", 1, "ArtificialHarmonic", {}, (46 + 12, 1.0, 2)),
    ],
)
def test_harmonics_of_guitar_pro_3_to_5(
    tmp_path: Path, suffix: str, fret: int, kind: str, more: dict[str, int], played: tuple[float, float, int]
) -> None:
    import guitarpro as gp

    values = {k: gp.PitchClass(v) if k == "pitch" else gp.Octave(v) if k == "octave" else v for k, v in more.items()}

    def change(song: object, beats: list[gp.Beat]) -> None:
        beats[1].notes[0].value = fret
        beats[1].notes[0].effect.harmonic = getattr(gp, kind)(**values)

    one = tw.read_score(guitar_pro(tmp_path / f"a.{suffix}", change)).notes[1]
    assert (one.note, one.stop, one.partial) == played
