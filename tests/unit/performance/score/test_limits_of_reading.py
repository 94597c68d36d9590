"""Scores read, cut, moved and written: values at their limits and on both sides of them, worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from smf_bytes import event, smf
from tablatures import gpif

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.performance.score import xml_files
from tonewood.performance.score.assignment import Assigned, PlayableString, StringChooser, StringMatching, assign
from tonewood.performance.score.controllers import Controllers, History
from tonewood.performance.score.fingering import Option, Sounding, hand_after
from tonewood.performance.score.guitar_pro import FEELS
from tonewood.performance.score.note import Beats, Control, ScorePart, ignored_name
from tonewood.performance.score.reading import _channels, _excerpt, _moved
from tonewood.performance.score.smf import Findings
from tonewood.performance.score.tablature import TICKS, Tablature, musicxml, tablature, text

GUITAR = [
    PlayableString.fretted(name, pitch, 19)
    for name, pitch in {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64}.items()
]


def midi(path: Path, events: bytes, **how: Any) -> tw.Score:
    """Score of a track of 480 ticks a quarter, half a second each."""
    path.write_bytes(smf(events))
    return tw.read_midi(path, **how)


def span(path: Path, begin: int, length: int) -> tw.Score:
    return midi(path, event(begin, 0x90, 60, 80) + event(length, 0x80, 60, 0))


@pytest.mark.parametrize(
    ("ticks", "duration", "said"),
    [
        (0, 0.02, "note shorter than 0.02 s, lengthened to it"), (19, 0.02, "note shorter than 0.02 s"),
        (20, 20 / 960, ""), (576_000, 600.0, ""), (576_001, 600.0, "note longer than 600 s, shortened to it"),
    ],
)  # fmt: skip
def test_notes_last_from_20_ms_to_ten_minutes(tmp_path: Path, ticks: int, duration: float, said: str) -> None:
    score = span(tmp_path / "a.mid", 0, ticks)
    assert score.notes[0].duration == pytest.approx(duration)
    assert [line[: len(said)] for line in score.warnings if said] == ([said] if said else [])
    assert bool(score.warnings) == bool(said)


def test_silence_is_told_from_one_minute_on_and_refused_from_a_quarter_of_an_hour_on(tmp_path: Path) -> None:
    assert span(tmp_path / "a.mid", 60 * 960, 960).warnings == ()
    assert span(tmp_path / "a.mid", 60 * 960 + 1, 960).warnings == ("long silence: 60 s before the note at 60 s",)
    assert len(span(tmp_path / "a.mid", 900 * 960, 960).notes) == 1
    with pytest.raises(ScoreError, match="too much silence, 900 s before the note at 900 s: 900 s in all are allowed"):
        span(tmp_path / "a.mid", 900 * 960 + 1, 960)
    # two gaps of 500 s are 1000 s; the end of the longest note so far counts, not that of the last
    pause = event(0, 0x90, 60, 80) + event(960, 0x80, 60, 0)
    again = event(500 * 960, 0x90, 60, 80) + event(960, 0x80, 60, 0)
    assert len(midi(tmp_path / "a.mid", pause + again).notes) == 2
    with pytest.raises(ScoreError, match="too much silence"):
        midi(tmp_path / "a.mid", pause + again + again)


def test_an_excerpt_keeps_what_begins_in_it(tmp_path: Path) -> None:
    """Notes at 0, 1, 2 and 3 s of 1.5 s each, a controller at 0.5 and 2.5 s."""
    events = b"".join(
        (
            event(0, 0x90, 60, 80), event(480, 0xB0, 1, 127), event(480, 0x90, 61, 80), event(480, 0x80, 60, 0),
            event(480, 0x90, 62, 80), event(480, 0xB0, 1, 0), event(0, 0x80, 61, 0), event(480, 0x90, 63, 80),
            event(480, 0x80, 62, 0), event(480, 0x80, 63, 0),
        )
    )  # fmt: skip
    score = midi(tmp_path / "a.mid", events, start=1.0, stop=3.0)
    assert [(n.note, n.time, n.duration, n.held) for n in score.notes] == [(61, 0.0, 1.5, None), (62, 1.0, 1.0, None)]
    assert [(c.kind, c.time, c.value) for c in score.controls] == [("cc1", 0.0, 1.0), ("cc1", 1.5, 0.0)]
    assert score.warnings == ("note begun before the excerpt, left out: channel 1, note 60 at 0.000 s",)
    assert score.beats is None
    assert len(midi(tmp_path / "a.mid", events, stop=3.0).notes) == 3
    for start, stop in ((1.0, 1.0), (-0.1, 1.0), (2.0, 1.0)):
        with pytest.raises(ScoreError, match="0 <= start < stop is needed"):
            tw.read_midi(tmp_path / "a.mid", start=start, stop=stop)
    assert len(tw.read_midi(tmp_path / "a.mid", start=0.0, stop=1e-9).notes) == 1


def test_the_pedal_leaves_the_time_of_the_key(tmp_path: Path) -> None:
    events = event(0, 0xB0, 64, 127) + event(0, 0x90, 60, 80) + event(480, 0x80, 60, 0) + event(480, 0xB0, 64, 0)
    (note,) = midi(tmp_path / "a.mid", events).notes
    assert (note.duration, note.held, note.key_up) == (1.0, 0.5, 0.5)
    assert midi(tmp_path / "a.mid", events, stop=0.4).notes[0].held is None


def test_findings_are_lines_in_order_with_counts() -> None:
    findings = Findings()
    for kind, where in (("b", "here"), ("a", ""), ("b", "there"), ("b", ""), ("a", "x")):
        findings.add(kind, where)
    assert findings.lines() == ("b: here (and 2 more)", "a (and 1 more)")


def test_written_files_have_ranges_wide_enough_for_their_bends(tmp_path: Path) -> None:
    """A range of whole semitones from 2 on: 350 cents need 4, 12700 need 127 and 12701 are too wide."""
    for widest, semitones in ((150.0, 2), (-200.0, 2), (201.0, 3), (350.0, 4), (12700.0, 127)):
        score = tw.Score([tw.Note(0.0, 1.0, note=60, channel=3)], [Control(0.25, "bend", widest, 3)])
        tw.write_midi(score, tmp_path / "a.mid")
        again = tw.read_midi(tmp_path / "a.mid")
        (bend,) = again.controls
        # a bend to the very top is one of 8192 steps short
        step = 100 * semitones / 8192
        assert bend.value == pytest.approx(widest, abs=1.01 * step)
        assert (bend.time, bend.channel) == (0.25, 3)
        data = (tmp_path / "a.mid").read_bytes()
        assert bytes((0xB3, 6, semitones)) in data or bytes((6, semitones)) in data
    with pytest.raises(ScoreError, match=r"control bend = 12701\.0: MIDI has no message for it"):
        tw.write_midi(tw.Score([], [Control(0.0, "bend", 12701.0)]), tmp_path / "a.mid")


def test_controllers_and_defaults_are_written(tmp_path: Path) -> None:
    controls = [Control(0.5, "cc7", 0.5, 2), Control(0.25, "channel_pressure", 1.0), Control(0.75, "cc119", 1.0, 2)]
    tw.write_midi(tw.Score([tw.Note(0.0, 1.0, note=60), tw.Note(0.0, 1.0, note=0, velocity_midi=0.2)], controls),
                  tmp_path / "a.mid")  # fmt: skip
    score = tw.read_midi(tmp_path / "a.mid")
    assert sorted((n.note, n.velocity_midi, n.channel) for n in score.notes) == [(0, 1, 0), (60, 80, 0)]
    assert sorted((c.time, c.kind, round(c.value * 127), c.channel) for c in score.controls) == [
        (0.25, "channel_pressure", 127, 0), (0.5, "cc7", 64, 2), (0.75, "cc119", 127, 2),
    ]  # fmt: skip
    for note in (128, -1, 60.5):
        with pytest.raises(ScoreError, match="MIDI needs a whole number from 0 to 127"):
            tw.write_midi(tw.Score([tw.Note(0.0, note=note)]), tmp_path / "a.mid")
    for kind in ("cc120", "ccx", "breath"):
        with pytest.raises(ScoreError, match=f"control {kind} = 0.5: MIDI has no message for it"):
            tw.write_midi(tw.Score([], [Control(0.0, kind, 0.5)]), tmp_path / "a.mid")


SCORE = tw.Score(
    [
        tw.Note(0.0, 2.0, note=60, stop=5, string="a", held=1.0, channel=0),
        tw.Note(1.0, 3.0, note=62, stop=0, glides=((0.5, 1.0),), channel=1),
        tw.Note(2.0, 1.0, freq=100.0, stop=3, held=0.5, channel=2),
        tw.Note(4.0, 1.0, note=64),
    ],
    [Control(0.0, "cc1", 0.1, 0), Control(1.0, "cc1", 0.2, 0), Control(1.0, "bend", 30.0, 1), Control(4.0, "cc1", 0.3)],
    warnings=["note of channel 10, percussion by General MIDI, left out (--tracks 10 plucks them)", "other"],
    parts=[ScorePart(1, channels=(2,), programs={None: 1}), ScorePart(3, programs={None: 1}), ScorePart(10, n_drums=2)],
    beats=Beats([(0.0, 0.0, 120.0), (2.0, 4.0, 60.0)], [(0.0, 4.0)]),
)


def test_an_excerpt_of_any_score() -> None:
    part = _excerpt(SCORE, 1.0, 4.0)
    assert [(n.time, n.duration, n.held) for n in part.notes] == [(0.0, 3.0, None), (1.0, 1.0, 0.5)]
    assert [(c.time, c.kind, c.value) for c in part.controls] == [
        (0.0, "cc1", 0.1), (0.0, "cc1", 0.2), (0.0, "bend", 30.0),
    ]  # fmt: skip
    cut = _excerpt(SCORE, 0.0, 0.75)
    assert [(n.duration, n.held) for n in cut.notes] == [(0.75, 0.75)]
    assert [n.time for n in _excerpt(SCORE, 2.0, None).notes] == [0.0, 2.0]


def test_a_score_moved_in_pitch_and_time() -> None:
    moved = _moved(SCORE, 2.0, 4.0)
    assert [(n.time, n.duration, n.note, n.stop, n.held) for n in moved.notes] == [
        (0.0, 0.5, 62.0, 7.0, 0.25), (0.25, 0.75, 64.0, 2.0, None), (0.5, 0.25, None, 3.0, 0.125),
        (1.0, 0.25, 66.0, None, None),
    ]  # fmt: skip
    assert moved.notes[1].glides == ((0.125, 1.0),)
    assert [c.time for c in moved.controls] == [0.0, 0.25, 0.25, 1.0]
    assert moved.beats is not None
    assert list(moved.beats.tempos) == [(0.0, 0.0, 480.0), (0.5, 4.0, 240.0)]
    # a stop below the nut, or between two frets, is left to the assignment
    assert [n.stop for n in _moved(SCORE, -1.0, 1.0).notes] == [4.0, None, 3.0, None]
    assert [n.stop for n in _moved(SCORE, -0.5, 1.0).notes] == [None, None, 3.0, None]
    fast = _moved(tw.Score([tw.Note(0.0, 0.004, note=60, held=0.002)]), 0.0, 20.0).notes[0]
    assert (fast.duration, fast.held) == (1e-3, 1e-3)


def test_channels_of_a_score_with_those_of_their_zones() -> None:
    one = _channels(SCORE, [1])
    assert [n.channel for n in one.notes] == [0, 1, None]
    assert [(c.time, c.channel) for c in one.controls] == [(0.0, 0), (1.0, 0), (1.0, 1), (4.0, None)]
    assert ([p.number for p in one.parts], one.warnings) == ([1], ["other"])
    assert [n.channel for n in _channels(SCORE, [3]).notes] == [2]
    with pytest.raises(ScoreError, match="there is no channel 10; there are 1, 2, 3"):
        _channels(SCORE, [10])


def test_controls_before_at_and_between_times() -> None:
    history = History([Control(2.0, "cc1", 0.2), Control(1.0, "cc1", 0.1), Control(3.0, "cc1", 0.3)])
    assert [history.at(t) for t in (0.9, 1.0, 1.9, 2.0, 9.0)] == [None, 0.1, 0.1, 0.2, 0.3]
    assert [c.value for c in history.between(1.0, 3.0)] == [0.2]
    assert [c.value for c in history.between(0.9, 3.1)] == [0.1, 0.2, 0.3]
    common = Controllers([Control(1.0, "cc7", 0.5), Control(1.0, "cc7", 0.7, 2)])
    assert [common.at("cc7", channel, 1.0) for channel in (None, 2, 3)] == [0.5, 0.7, 0.5]
    assert common.at("cc11", 2, 1.0) is None


def test_names_of_ignored_controllers() -> None:
    names = {"cc74": "controller 74", "channel_pressure": "channel pressure", "bend": "bend"}
    assert {kind: ignored_name(kind) for kind in names} == names


@pytest.mark.parametrize(
    ("hand", "stops", "after"),
    [
        (1.0, [], 1.0),
        (5.0, [0.0], 5.0),
        (1.0, [4.0], 1.0),
        (1.0, [5.0], 2.0),
        (6.0, [5.0], 5.0),
        (6.0, [5.0, 8.0], 5.0),
        (1.0, [5.0, 10.0], 5.0),
        (9.0, [5.0, 10.0], 7.0),
        (6.0, [5.0, 10.0], 6.0),
        (1.0, [0.0, 7.0], 4.0),
    ],
)
def test_the_hand_moves_no_farther_than_it_must(hand: float, stops: list[float], after: float) -> None:
    assert hand_after(hand, [Option(i, stop) for i, stop in enumerate(stops)]) == after


def test_stops_and_pitches_of_a_string() -> None:
    fretted = PlayableString.fretted("s", 60, 3)
    assert fretted.pitches == (60, 61, 62, 63)
    assert [fretted.stop_for(p) for p in (50.0, 60.4, 60.6, 70.0)] == [0, 0, 1, 3]
    assert [fretted.pitch_at(s) for s in (0, 3, 4, 1.5)] == [60, 63, None, None]
    assert (fretted.range, PlayableString.fretted("s", 60).range) == ("C4 to D#4", "C4")
    free = PlayableString("s", (60.0, 72.0), continuous=True)
    assert [free.stop_for(p) for p in (50.0, 60.4, 72.0, 80.0)] == pytest.approx([0.0, 0.4, 12.0, 12.0])
    assert [free.pitch_at(s) for s in (0.0, 1.5, 12.0, 12.5)] == [60.0, 61.5, 72.0, None]
    assert PlayableString.fretted("s", 60).pitches == (60,)
    for pitches in ((), (60.0, 60.0), (60.0, float("nan"))):
        with pytest.raises(ScoreError, match="must rise"):
            PlayableString("s", pitches)


def test_notes_move_aside_for_one_that_has_a_single_string() -> None:
    matching = StringMatching(taken=0b1000)
    assert not matching.add([Option(3, 0.0)])
    both, first, second = [Option(0, 0.0), Option(1, 0.0)], [Option(0, 0.0)], [Option(1, 0.0)]
    assert matching.add(both)
    assert matching.add(first)  # the one before goes to the other string
    trial = matching.copy()
    assert not trial.add(second)
    assert trial.add([Option(2, 0.0)])
    assert matching.add([Option(2, 1.0)])  # the trial took nothing
    assert not matching.add([Option(2, 0.0)])


def test_voices_share_a_pluck_as_long_as_the_longer_and_as_loud_as_the_louder() -> None:
    """A millisecond apart is together; keys that are up before the end leave a pedal's note."""
    low = tw.Note(1.0, 4.0, note=60, channel=0, velocity_midi=90, held=1.0)
    high = tw.Note(1.001, 1.5, note=60, channel=1, velocity_midi=50)
    result = assign([low, high], GUITAR)
    (one,) = result.notes
    assert (one.note.time, one.note.duration, one.note.held, one.note.velocity_midi) == (1.0, 4.0, 1.501, 90)
    assert result.doubled == (high,)
    assert one.end == 5.0
    assert len(assign([low, replace(high, time=1.0011)], GUITAR).notes) == 2
    assert assign([replace(low, held=None), high], GUITAR).notes[0].note.held is None


def test_a_chooser_moves_its_hand_and_spares_what_sounds() -> None:
    chooser = StringChooser(GUITAR)
    (first,), dropped = chooser.assign([tw.Note(3.0, note=71)], {})
    assert (first.string, first.stop, chooser.hand, dropped) == ("E4", 7.0, 4.0, [])
    (second,), _ = chooser.assign([tw.Note(4.0, note=69)], {"E4": Sounding(7.0, 1.0)})
    assert (second.string, second.stop) == ("B3", 10.0)
    (third,), _ = StringChooser(GUITAR).assign([tw.Note(4.0, note=69)], {"E4": Sounding(7.0, 0.0)})
    assert (third.string, third.stop) == ("E4", 5.0)
    assert chooser.assign([], {}) == ([], [])
    nothing, ((index, drop),) = chooser.assign([tw.Note(4.0, note=20)], {})
    assert (nothing, index, drop.time) == ([], 0, 4.0)


def tab_of(*rows: tuple[float, str, float], beats: Beats | None = None, capo: int = 0, title: str = "T") -> Tablature:
    """Tablature of (quarter note, string, stop) at one quarter a second."""
    notes = [Assigned(tw.Note(at, 0.5, note=60), string, stop, 0.0, at + 0.5) for at, string, stop in rows]
    held = [PlayableString(s.name, tuple(pitch + capo for pitch in s.pitches)) for s in GUITAR]
    return tablature(notes, held, beats or Beats([(0.0, 0.0, 60.0)]), title=title, capo=capo)


def test_places_fingers_and_hands_of_a_tablature() -> None:
    tab = tab_of((0, "E2", 0), (1, "A2", 5), (1, "E4", 3), (2, "E4", 9), (3, "E4", 6))
    rows = [(tick, p.row, p.fret, p.finger, p.hand) for tick, chord in tab.chords for p in chord]
    # the hand begins at 1, moves to 2 for fret 5, to 6 for fret 9, and stays
    assert rows == [(0, 6, 0, 0, 1), (24, 5, 5, 4, 2), (24, 1, 3, 2, 2), (48, 1, 9, 4, 6), (72, 1, 6, 1, 6)]
    assert (list(tab.measures), list(tab.tempos)) == ([0, 96], [(0, 60.0)])
    capo = tab_of((0, "E2", 2), (1, "E4", 5), capo=2)
    assert [(p.fret, p.finger) for _, chord in capo.chords for p in chord] == [(0, 0), (3, 3)]
    assert [s.name for s in tab.strings] == ["E4", "B3", "G3", "D3", "A2", "E2"]


def test_tempos_of_a_tablature_are_changes_alone() -> None:
    beats = Beats([(0.0, 0.0, 60.0), (2.0, 2.0, 60.0), (3.0, 3.0, 90.0)], [(0.0, 3.0), (3.0, 2.0)])
    tab = tab_of((0, "E2", 0), (4, "E2", 1), beats=beats)
    assert list(tab.tempos) == [(0, 60.0), (72, 90.0)]
    assert list(tab.measures) == [0, 72, 120, 168]  # 4 s are 4.5 quarters, a quarter later ends the last chord


@pytest.mark.parametrize(
    ("onsets", "ticks", "triplets"),
    [
        ([0.0, 0.25, 0.5, 0.75], [0, 6, 12, 18], []), ([0.0, 1 / 3, 2 / 3], [0, 8, 16], [0]),
        ([0.0, 1 / 6, 0.5], [0, 4, 12], [0]), ([0.0, 0.125, 0.375], [0, 3, 9], []), ([0.5], [12], []),
        ([1.99, 2.0 + 1 / 3], [48, 56], [2]), ([1.98], [48], []), ([0.0, 0.5, 1 + 2 / 3], [0, 12, 40], [1]),
    ],
)  # fmt: skip
def test_onsets_go_to_the_nearest_of_eighths_or_sixths(
    onsets: list[float], ticks: list[int], triplets: list[int]
) -> None:
    tab = tab_of(*((at, "E4" if i % 2 else "E2", 0) for i, at in enumerate(onsets)))
    assert ([tick for tick, _ in tab.chords], sorted(tab.triplets)) == (ticks, triplets)


def test_text_of_a_tablature_by_hand() -> None:
    """After a fret or numeral a dash for each quarter of a quarter note, at most eight, and one before each measure."""
    lines = text(tab_of((0, "E2", 0), (1, "A2", 12), (4, "E4", 3))).splitlines()
    first = {"E2": "-" + "0----" + "----------", "A2": "-" + "-----" + "12--------"}
    after = {"E4": "-" + "3----------"}  # as wide as its numeral
    assert lines[:4] == ["T", "Tuning E2 A2 D3 G3 B3 E4", "", " " * 4 + " " + "I    " + "IX        " + "  " + "III"]
    assert lines[4:] == [
        f"{name} |{first.get(name, '-' * 16)}|{after.get(name, '-' * 12)}|"
        for name in ("E4", "B3", "G3", "D3", "A2", "E2")
    ]
    assert text(tab_of((0, "E2", 2), capo=2, title="")).startswith("Tablature\nTuning E2 A2 D3 G3 B3 E4, capo 2\n\n")


def test_lines_of_text_end_before_88_characters_and_empty_measures_have_eight() -> None:
    tab = tab_of(*((4.0 * k, "E2", 0) for k in (0, *range(2, 12))))
    rows = [row for row in text(tab).splitlines() if row.startswith("E2 |")]
    measure = "-0--------|"
    assert rows == ["E2 |" + measure + "-" * 8 + "|" + 5 * measure, "E2 |" + 5 * measure]
    assert max(map(len, rows)) <= 88


def test_a_tablature_of_musicxml_has_its_lengths_and_fingers() -> None:
    root = ET.fromstring(musicxml(tab_of((0, "E2", 0), (1.5, "A2", 3), (3.5, "E4", 5), (5, "E4", 0), capo=0)))
    rows = [
        (
            n.findtext("duration"),
            n.findtext("type"),
            len(n.findall("dot")),
            n.findtext(".//fret"),
            n.findtext(".//string"),
            n.findtext(".//fingering"),
            "".join(t.get("type", "") for t in n.findall("tie")),
            "".join(n.findtext(f"pitch/{k}", "") for k in ("step", "alter", "octave")),
        )
        for n in root.iter("note")
    ]
    assert rows == [
        ("36", "quarter", 1, "0", "6", None, "", "E2"),
        ("48", "half", 0, "3", "5", "3", "", "C3"),
        ("12", "eighth", 0, "5", "1", "4", "start", "A4"),
        ("24", "quarter", 0, "5", "1", None, "stop", "A4"),
        ("72", "half", 1, "0", "1", None, "", "E4"),
    ]
    assert [(t.findtext("beats"), t.findtext("beat-type")) for t in root.iter("time")] == [("4", "4")]
    tunings = [tuple(t.findtext(f"tuning-{k}") for k in ("step", "octave")) for t in root.iter("staff-tuning")]
    assert tunings == [("E", "2"), ("A", "2"), ("D", "3"), ("G", "3"), ("B", "3"), ("E", "4")]
    assert [e.text for e in root.iter("words")] == ["I", "II"]
    assert [e.get("tempo") for e in root.iter("sound")] == ["60"]
    assert root.findtext(".//divisions") == str(TICKS)


@pytest.mark.parametrize(
    ("meter", "time"),
    [(4.0, ("4", "4")), (3.0, ("3", "4")), (3.5, ("7", "8")), (0.25, ("1", "16")), (0.125, ("1", "32"))],
)
def test_time_signatures_of_measures(meter: float, time: tuple[str, str]) -> None:
    root = ET.fromstring(musicxml(tab_of((0, "E2", 0), beats=Beats([(0.0, 0.0, 60.0)], [(0.0, meter)]))))
    first = root.find(".//time")
    assert first is not None
    assert (first.findtext("beats"), first.findtext("beat-type")) == time


def test_a_chord_is_written_for_four_quarters_at_most_and_rests_follow() -> None:
    root = ET.fromstring(musicxml(tab_of((1, "E2", 0), (7, "E2", 0))))
    rows = [(n.find("rest") is not None, n.findtext("duration")) for n in root.iter("note")]
    assert rows == [(True, "24"), (False, "72"), (False, "24"), (True, "48"), (False, "24")]


def one_part(measures: str) -> str:
    return f"<score-partwise><part id='P'>{measures}</part></score-partwise>"


NOTE_XML = "<note><pitch><step>A</step><octave>3</octave></pitch><duration>1</duration></note>"


def test_pedals_of_sounds_are_up_down_or_between(tmp_path: Path) -> None:
    sounds = "".join(f'<sound damper-pedal="{value}"/>{NOTE_XML}' for value in ("yes", "no", "25", "no"))
    (tmp_path / "a.xml").write_text(one_part(f"<measure>{sounds}</measure>"))
    score = tw.read_score(tmp_path / "a.xml")
    assert [(c.kind, c.value) for c in score.controls] == [("cc64", v) for v in (1.0, 0.0, 0.25, 0.0)]


def test_measures_are_forgotten_once_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred measures within a limit that two of them together would pass."""
    monkeypatch.setattr(xml_files, "_MOST_KEPT", 25)
    (tmp_path / "a.xml").write_text(one_part(100 * f"<measure>{NOTE_XML}</measure>"))
    assert len(tw.read_score(tmp_path / "a.xml").notes) == 100
    (tmp_path / "b.xml").write_text(one_part(f"<measure>{3 * NOTE_XML}</measure>"))
    with pytest.raises(ScoreError, match="more than 25 elements, attributes and texts"):
        tw.read_score(tmp_path / "b.xml")


@pytest.mark.parametrize(
    ("how", "time", "pitch"),
    [
        ({}, 0.5, 60.0),
        ({"tempo": 2.0}, 0.25, 60.0),
        ({"transpose": 2.0}, 0.5, 62.0),
        ({"tempo": 0.5, "transpose": -3.0}, 1.0, 57.0),
    ],
)
def test_a_score_is_read_faster_or_higher_or_both(tmp_path: Path, how: Any, time: float, pitch: float) -> None:
    path = tmp_path / "a.mid"
    path.write_bytes(smf(event(480, 0x90, 60, 80) + event(480, 0x80, 60, 0)))
    (note,) = tw.read_score(path, **how).notes
    assert (note.time, note.duration, note.note) == pytest.approx((time, time, pitch))
    for wrong in ({"tempo": 0.049}, {"tempo": 20.1}, {"transpose": 48.1}, {"transpose": -48.1}):
        with pytest.raises(ScoreError, match="are allowed"):
            tw.read_score(path, **wrong)
    for edge in ({"tempo": 0.05}, {"tempo": 20.0}, {"transpose": 48.0}, {"transpose": -48.0}):
        assert len(tw.read_score(path, **edge).notes) == 1


def test_feels_of_two_values() -> None:
    """The value that is swung, in quarter notes, and the share of the first of two."""
    shares = {"Triplet": Fraction(2, 3), "Dotted": Fraction(3, 4), "Scottish": Fraction(1, 4)}
    eighths = {f"{name}8th": (Fraction(1, 2), share) for name, share in shares.items()}
    assert eighths | {f"{name}16th": (Fraction(1, 4), share) for name, share in shares.items()} == FEELS


@pytest.mark.parametrize(("tie", "times"), [("", [0.0, 1.0]), ("origin", [0.0, 1.0]), ("destination", [0.0])])
def test_a_note_is_tied_where_a_tie_ends(tmp_path: Path, tie: str, times: list[float]) -> None:
    ends = "".join(f' {end}="{str(end == tie).lower()}"' for end in ("origin", "destination"))
    score = tw.read_score(gpif(tmp_path / "a.gp", [(1, 2, "", ""), (1, 2, "", f"<Tie{ends}/>")]))
    assert [note.time for note in score.notes] == times
