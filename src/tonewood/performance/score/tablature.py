"""Tablature: notes that have their strings and stops, on a grid of measures, as MusicXML 4.0 or as text.

Onsets go to sixteenths, thirty-seconds or triplets of their quarter note, whichever is nearest. A chord is written
until the next one begins, at most for `LONGEST` quarter notes: tablature leaves to the player how long a string rings.
The hand is that of `fingering`, the finger of a note its distance from the hand.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree as ET

from tonewood.instrument.scales import note_name
from tonewood.performance.score.assignment import Assigned, PlayableString
from tonewood.performance.score.fingering import HAND_SPAN, Option, hand_after
from tonewood.performance.score.note import Beats
from tonewood.support.text_files import one_line

#: divisions of a quarter note
TICKS = 24
#: quarter notes that a chord is written for at most
LONGEST = 4
#: ticks -> type and dots, of plain lengths and in triplets
_PLAIN = {
    144: ("whole", 1), 96: ("whole", 0), 72: ("half", 1), 48: ("half", 0), 36: ("quarter", 1), 24: ("quarter", 0),
    18: ("eighth", 1), 12: ("eighth", 0), 9: ("16th", 1), 6: ("16th", 0), 3: ("32nd", 0),
}  # fmt: skip
_TRIPLET = {16: ("quarter", 0), 12: ("eighth", 1), 8: ("eighth", 0), 4: ("16th", 0)}
_STEPS = ("C", "C", "D", "D", "E", "F", "F", "G", "G", "A", "A", "B")
_SHARP = (0, 1, 0, 1, 0, 0, 1, 0, 1, 0, 1, 0)
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE score-partwise PUBLIC "-//Recordare//DTD MusicXML 4.0 Partwise//EN" "http://www.musicxml.org/dtds/partwise.dtd">
"""
#: characters of a line of text
_WIDTH = 88


@dataclass(frozen=True)
class Placed:
    """A note of a tablature.

    note : with its string and stop.
    row : number of the string, 1 the highest.
    fret : counted from the capo; a fraction is rounded.
    finger : 0 open, 1 to 4 from the index finger.
    hand : stop under the first finger, counted from the capo.
    """

    note: Assigned
    row: int
    fret: int
    finger: int
    hand: int


@dataclass(frozen=True)
class Tablature:
    """Chords of a score on the strings of an instrument.

    title : of the score.
    strings : the highest first.
    capo : at which stop.
    chords : notes that are struck together, and the tick at which they are.
    triplets : quarter notes that have an onset on triplets.
    measures : ticks at which measures begin, the end of the last one besides.
    tempos : (tick, quarter notes per minute).
    """

    title: str
    strings: Sequence[PlayableString]
    capo: int
    chords: Sequence[tuple[int, Sequence[Placed]]]
    triplets: frozenset[int]
    measures: Sequence[int]
    tempos: Sequence[tuple[int, float]]


def tablature(
    notes: Sequence[Assigned], strings: Sequence[PlayableString], beats: Beats, *, title: str = "", capo: int = 0
) -> Tablature:
    """Place notes on lines and on the grid of measures.

    notes : in time order, stops counted from the nut.
    strings : of the instrument, as the capo holds them.
    beats : of the score.
    capo : stop from which frets are counted.
    """
    lines = sorted(strings, key=lambda s: -s.pitches[0])
    number = {string.name: i for i, string in enumerate(lines, 1)}
    quarters = [max(beats.quarter(a.note.time), 0.0) for a in notes]
    grid, triplets = _grid(quarters)
    chords: list[tuple[int, list[Placed]]] = []
    hand = 1.0
    struck: dict[int, dict[int, Assigned]] = {}
    taken: dict[int, dict[int, int]] = {row: {} for row in number.values()}
    for tick, note in zip(grid, notes, strict=True):
        row = number[note.string]
        struck.setdefault(_free(tick, taken[row]), {})[row] = note
    for tick, chord in sorted(struck.items()):
        hand = hand_after(hand, [Option(row, a.stop - capo) for row, a in chord.items()])
        chords.append((tick, [_placed(a, row, capo, hand) for row, a in chord.items()]))
    last = max((tick for tick, _ in chords), default=0) + TICKS
    measures = [round(m * TICKS) for m in beats.measures(last / TICKS)]
    by_tick = {max(round(at * TICKS), 0): bpm for _, at, bpm in beats.tempos}
    tempos = [item for before, item in pairwise([(-1, 0.0), *sorted(by_tick.items())]) if item[1] != before[1]]
    return Tablature(one_line(title), lines, capo, chords, triplets, measures, tempos)


def _free(tick: int, taken: dict[int, int]) -> int:
    """Take the first free tick for a string that is struck again within a step of the grid.

    taken : tick -> a later one, between which and itself all of its steps are taken.
    """
    passed = [tick]
    while passed[-1] in taken:
        passed.append(taken[passed[-1]])
    taken.update(dict.fromkeys(passed, passed[-1] + TICKS // 8))
    return passed[-1]


def _placed(assigned: Assigned, row: int, capo: int, hand: float) -> Placed:
    stop = assigned.stop - capo
    finger = 0 if stop <= 0 else 1 + min(max(math.floor(stop - hand), 0), int(HAND_SPAN))
    return Placed(assigned, row, round(stop), finger, max(round(hand), 1))


def _grid(quarters: Sequence[float]) -> tuple[list[int], frozenset[int]]:
    """Ticks of onsets, and the quarter notes that are divided in three.

    A quarter note whose onsets are nearer to sixths than to quarters of it is divided in three, otherwise by eight.
    """
    by_beat: dict[int, list[float]] = {}
    for at in quarters:
        by_beat.setdefault(math.floor(at + 1 / 64), []).append(at)
    triplets = set()
    for beat, onsets in by_beat.items():
        error = {n: sum(abs(round((at - beat) * n) / n - (at - beat)) for at in onsets) for n in (4, 6, 8)}
        if error[6] < 0.8 * min(error[4], error[8] + len(onsets) / 96):
            triplets.add(beat)
    ticks = []
    for at in quarters:
        beat = math.floor(at + 1 / 64)
        fine = 6 if beat in triplets else 8
        ticks.append(beat * TICKS + round((at - beat) * fine) * TICKS // fine)
    return ticks, frozenset(triplets)


def _pieces(begin: int, end: int, tab: Tablature) -> Iterator[tuple[int, int, bool]]:
    """(tick, ticks, whether in a triplet) of lengths that notation has, of a span within a measure."""
    at = begin
    while at < end:
        beat = at // TICKS
        triplet = beat in tab.triplets
        until = min(end, (beat + 1) * TICKS) if triplet else end
        if not triplet:
            beats = range(at // TICKS + 1, -(-until // TICKS))
            until = min([until, *(b * TICKS for b in beats if b in tab.triplets)])
        lengths = _TRIPLET if triplet and until - at != TICKS else _PLAIN
        length = next((n for n in lengths if n <= until - at), until - at)
        yield at, length, triplet and length in _TRIPLET and lengths is _TRIPLET
        at += length


def musicxml(tab: Tablature) -> bytes:
    """The tablature as a file of MusicXML 4.0: one part on a staff with a line per string."""
    root = ET.Element("score-partwise", version="4.0")
    _text(ET.SubElement(root, "work"), "work-title", tab.title or "Tablature")
    _text(ET.SubElement(ET.SubElement(root, "identification"), "encoding"), "software", "tonewood")
    listed = ET.SubElement(ET.SubElement(root, "part-list"), "score-part", id="P1")
    _text(listed, "part-name", "Tablature")
    _text(ET.SubElement(listed, "score-instrument", id="P1-I1"), "instrument-name", "Guitar")
    part = ET.SubElement(root, "part", id="P1")
    starts = [tick for tick, _ in tab.chords]
    hand, size = 0, 0
    for i, (begin, end) in enumerate(zip(tab.measures, tab.measures[1:], strict=False)):
        measure = ET.SubElement(part, "measure", number=str(i + 1))
        if i == 0 or end - begin != size:
            size = end - begin
            _attributes(measure, tab, size, first=i == 0)
        for tick, bpm in tab.tempos[bisect_left(tab.tempos, (begin,)) : bisect_left(tab.tempos, (end,))]:
            _tempo(measure, tick - begin, bpm)
        at = begin
        first = bisect_left(starts, begin)
        for k in range(max(first - 1, 0), bisect_left(starts, end)):  # the one before may last into the measure
            tick = starts[k]
            if _until(tab, k) <= begin:
                continue
            _rest(measure, at, max(tick, begin), tab)
            chord = tab.chords[k][1]
            if tick >= begin and chord[0].hand != hand:
                hand = chord[0].hand
                _words(measure, _roman(hand))
            at = min(_until(tab, k), end)
            _chord(measure, max(tick, begin), at, k, tab)
        _rest(measure, at, end, tab)
    ET.indent(root)
    return (_HEAD + ET.tostring(root, encoding="unicode") + "\n").encode()


def _until(tab: Tablature, k: int) -> int:
    """Tick until which a chord is written."""
    tick = tab.chords[k][0]
    following = tab.chords[k + 1][0] if k + 1 < len(tab.chords) else tab.measures[-1]
    return min(following, tick + LONGEST * TICKS)


def _text(parent: ET.Element, tag: str, text: object = None, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, tag, attributes)
    element.text = None if text is None else str(text)
    return element


def _attributes(measure: ET.Element, tab: Tablature, size: int, *, first: bool) -> None:
    attributes = ET.SubElement(measure, "attributes")
    if first:
        _text(attributes, "divisions", TICKS)
    time = ET.SubElement(attributes, "time")
    unit = next((n for n in (4, 8, 16) if size * n % (4 * TICKS) == 0), 32)
    _text(time, "beats", max(size * unit // (4 * TICKS), 1))
    _text(time, "beat-type", unit)
    if not first:
        return
    clef = ET.SubElement(attributes, "clef")
    _text(clef, "sign", "TAB")
    _text(clef, "line", 5)
    details = ET.SubElement(attributes, "staff-details")
    _text(details, "staff-lines", len(tab.strings))
    for row, string in enumerate(reversed(tab.strings), 1):
        tuning = _text(details, "staff-tuning", line=str(row))
        step, alter, octave = _spelled(string.pitches[0] - tab.capo)
        _text(tuning, "tuning-step", step)
        if alter:
            _text(tuning, "tuning-alter", alter)
        _text(tuning, "tuning-octave", octave)
    if tab.capo:
        _text(details, "capo", tab.capo)


def _spelled(pitch: float) -> tuple[str, int, int]:
    whole = round(pitch)
    return _STEPS[whole % 12], _SHARP[whole % 12], whole // 12 - 1


def _words(measure: ET.Element, words: str) -> None:
    direction = _text(measure, "direction", placement="above")
    _text(_text(direction, "direction-type"), "words", words)


def _tempo(measure: ET.Element, offset: int, bpm: float) -> None:
    direction = _text(measure, "direction", placement="above")
    metronome = _text(_text(direction, "direction-type"), "metronome")
    _text(metronome, "beat-unit", "quarter")
    _text(metronome, "per-minute", f"{bpm:.6g}")
    if offset:
        _text(direction, "offset", offset)
    _text(direction, "sound", tempo=f"{bpm:.6g}")


def _rest(measure: ET.Element, begin: int, end: int, tab: Tablature) -> None:
    for at, length, triplet in _pieces(begin, end, tab):
        note = ET.SubElement(measure, "note")
        _text(note, "rest")
        _length(note, length, triplet)
        _notations(note, at, length, triplet)


def _length(note: ET.Element, length: int, triplet: bool, ties: Sequence[str] = ()) -> None:
    """Duration, ties, voice and type, in the order of the schema."""
    _text(note, "duration", length)
    for kind in ties:
        _text(note, "tie", type=kind)
    _text(note, "voice", 1)
    kind, dots = (_TRIPLET if triplet else _PLAIN).get(length, ("32nd", 0))
    _text(note, "type", kind)
    for _ in range(dots):
        _text(note, "dot")
    if triplet:
        change = _text(note, "time-modification")
        _text(change, "actual-notes", 3)
        _text(change, "normal-notes", 2)


def _notations(note: ET.Element, at: int, length: int, triplet: bool, ties: Sequence[str] = ()) -> ET.Element | None:
    """Ties and brackets of triplets; returns the element, which has none where there is nothing to note."""
    edges = [k for k, there in (("start", at % TICKS == 0), ("stop", (at + length) % TICKS == 0)) if there]
    if not ties and not (triplet and edges):
        return None
    notations = ET.SubElement(note, "notations")
    for kind in ties:
        _text(notations, "tied", type=kind)
    for kind in edges if triplet else ():
        _text(notations, "tuplet", type=kind)
    return notations


def _chord(measure: ET.Element, begin: int, end: int, k: int, tab: Tablature) -> None:
    """Notes of a chord, tied where notation divides their length or a measure ends."""
    tick, chord = tab.chords[k]
    for at, length, triplet in _pieces(begin, end, tab):
        ties = ["stop"] * (at > tick) + ["start"] * (at + length < _until(tab, k))
        for i, placed in enumerate(sorted(chord, key=lambda p: p.row)):
            note = ET.SubElement(measure, "note")
            if i:
                _text(note, "chord")
            string = tab.strings[placed.row - 1]
            sounding = string.pitches[0] + placed.fret
            step, alter, octave = _spelled(sounding)
            pitch = _text(note, "pitch")
            _text(pitch, "step", step)
            if alter:
                _text(pitch, "alter", alter)
            _text(pitch, "octave", octave)
            _length(note, length, triplet, ties)
            notations = _notations(note, at, length, triplet and i == 0, ties)
            notations = ET.SubElement(note, "notations") if notations is None else notations
            technical = _text(notations, "technical")
            if at == tick and placed.finger:
                _text(technical, "fingering", placed.finger)
            _text(technical, "string", placed.row)
            _text(technical, "fret", placed.fret)


def _roman(number: int) -> str:
    """Numeral of a position up to 39."""
    return "X" * (number // 10) + ("", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX")[number % 10]


def text(tab: Tablature) -> str:
    """The tablature as lines of characters: positions of the hand, then one line per string, the highest first."""
    names = [note_name(s.pitches[0] - tab.capo) for s in tab.strings]
    width = max(map(len, names))
    heads = [" " * width + "  ", *(f"{name:<{width}} |" for name in names)]
    out = [tab.title or "Tablature", "Tuning " + " ".join(reversed(names)) + (f", capo {tab.capo}" if tab.capo else "")]
    rows = list(heads)
    hand = 0
    starts = [tick for tick, _ in tab.chords]
    for begin, end in zip(tab.measures, tab.measures[1:], strict=False):
        columns = [""] * (1 + len(names))
        inside = tab.chords[bisect_left(starts, begin) : bisect_left(starts, end)]
        for k, (tick, chord) in enumerate(inside):
            following = inside[k + 1][0] if k + 1 < len(inside) else end
            frets = {p.row: str(p.fret) for p in chord}
            here = _roman(chord[0].hand) if chord[0].hand != hand else ""
            hand = chord[0].hand
            lead = 1 + ((tick - begin) * 8 // TICKS if k == 0 else 0) // 2
            wide = max(max(map(len, frets.values())), len(here)) + max(1, min((following - tick) * 4 // TICKS, 8))
            columns[0] += " " * lead * (k == 0) + f"{here:<{wide}}"
            for row_number in range(1, len(names) + 1):
                columns[row_number] += "-" * lead * (k == 0) + f"{frets.get(row_number, ''):-<{wide}}"
        if not inside:
            columns = [" " * 8, *["-" * 8 for _ in names]]
        columns = [columns[0] + " ", *(c + "|" for c in columns[1:])]
        if len(rows[0]) + len(columns[0]) > _WIDTH and len(rows[0]) > len(heads[0]):
            out += ["", *(row.rstrip() for row in rows)]
            rows = list(heads)
        rows = [row + column for row, column in zip(rows, columns, strict=True)]
    return "\n".join([*out, "", *(row.rstrip() for row in rows)]) + "\n"
