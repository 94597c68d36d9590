"""Signs of MusicXML, tempos and jumps that are drawn or stand in words; its units of time, loudness and bends."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from xml.etree.ElementTree import Element

from tonewood.performance.score.bend_curves import Curve, bend_curve
from tonewood.performance.score.limits import number, whole
from tonewood.performance.score.written import WrittenNote
from tonewood.performance.score.xml_files import MOST, number_of, text_of

DYNAMICS = {
    "pppppp": 1, "ppppp": 4, "pppp": 8, "ppp": 20, "pp": 33, "p": 49, "mp": 64,
    "mf": 80, "f": 96, "ff": 112, "fff": 126, "ffff": 127, "fffff": 127, "ffffff": 127,
}  # fmt: skip
_SIGNS = {
    "staccato": "staccato", "staccatissimo": "staccato", "accent": "accent", "strong-accent": "marcato",
    "harmonic": "harmonic", "tap": "tapping", "wavy-line": "vibrato", "fingering": "",
    "turn": "turn", "delayed-turn": "turn", "inverted-turn": "inverted_turn", "delayed-inverted-turn": "inverted_turn",
    "mordent": "mordent", "inverted-mordent": "inverted_mordent",
    "string": "", "fret": "", "hammer-on": "", "pull-off": "", "bend": "", "pluck": "", "up-bow": "", "down-bow": "",
    "trill-mark": "", "tremolo": "", "accidental-mark": "", "slur": "", "tied": "", "tuplet": "", "tenuto": "",
    "thumb-position": "", "open-string": "", "breath-mark": "", "slide": "", "glissando": "", "arpeggiate": "",
    "dynamics": "", "palm-mute": "palm_mute", "fermata": "", "golpe": "golpe",
}  # fmt: skip
#: durations per quarter note; others are damaged
MOST_DIVISIONS = 16384
#: number of an ending, and passes between two with a hyphen
_MOST_ENDING, _MOST_BETWEEN = 9999, 32
#: beats of a measure, and the number of their note value
_MOST_BEATS = 1024
_UNITS = {
    "long": 16.0,
    "breve": 8.0,
    "whole": 4.0,
    "half": 2.0,
    "quarter": 1.0,
    "eighth": 0.5,
    "16th": 0.25,
    "32nd": 0.125,
    "64th": 0.0625,
}
#: a tempo in words: a sign for its note value, if any, and quarter notes of that
_TEMPO_WORDS = re.compile(
    r"(?:(?<!\w)([♩♪qehw\U0001d15d-\U0001d160]))?(\.?)\s*=\s*(?:ca?\.\s*)?(\d+(?:\.\d+)?)(?![\d.]*\s*[Hh]z)"
)
#: name of a pitch at the end of words: a number after it is its frequency
_PITCH_NAME = re.compile(r"(?<!\w)(?:[A-G][#b♯♭]?['’′]*\d?|[a-g](?:['’′]+|\d)|la\d?)\s*$")
_GLYPHS = {"♪": 0.5, "e": 0.5, "\U0001d160": 0.5, "h": 2.0, "\U0001d15e": 2.0, "w": 4.0, "\U0001d15d": 4.0}
#: letters of words -> sign of a jump, or of a mark
_JUMP_WORDS = {"segno": "segno", "coda": "coda", "fine": "fine", "tocoda": "to_coda", "dacoda": "to_coda"} | {
    word + goal: sign + (f"_al_{goal[2:]}" if goal else "")
    for word, sign in (("dc", "da_capo"), ("dacapo", "da_capo"), ("ds", "dal_segno"), ("dalsegno", "dal_segno"))
    for goal in ("", "alfine", "alcoda")
}


def jump_sign(kind: Element) -> str | None:
    """Return the sign of a jump or mark that is drawn or stands in words; None for others."""
    if kind.tag in ("segno", "coda"):
        return kind.tag
    words = re.sub(r"[^a-z]", "", (kind.text or "")[:40].lower()) if kind.tag == "words" else ""
    return _JUMP_WORDS.get(words)


def written_tempo(element: Element, ignored: Counter[str]) -> float | None:
    """Return quarter notes a minute of a metronome mark, or of words in which a number stands.

    What cannot be read of a mark is counted.
    """
    metronome = element.find("direction-type/metronome")
    if metronome is not None:
        name = text_of(metronome, "beat-unit")
        ignored["metronome whose beat-unit is not known"] += name not in _UNITS
        unit = _UNITS.get(name, 1.0) * (2.0 - 0.5 ** len(metronome.findall("beat-unit-dot")))
        match = re.search(r"-?\d+(\.\d+)?", text_of(metronome, "per-minute")[:40])
        equal_units = len(metronome.findall("beat-unit")) > 1 or metronome.find("metronome-note") is not None
        kind = "metronome that relates two values" if equal_units else "per-minute that cannot be read"
        ignored[kind] += match is None
        return (number(match.group(0), -MOST, MOST) or 0.0) * unit if match else None
    for words in element.findall("direction-type/words"):
        text = (words.text or "")[:200]
        if (tempo_word := _TEMPO_WORDS.search(text)) is not None and not _PITCH_NAME.search(text[: tempo_word.start()]):
            glyph, dot, beats = tempo_word.groups()
            return (number(beats, 0.0, MOST) or 0.0) * _GLYPHS.get(glyph, 1.0) * (1.5 if dot else 1.0)
    return None


def velocity_of(share: float) -> int:
    """Return the MIDI velocity of dynamics in percent of forte, 90."""
    return min(max(round(share * 0.9), 1), 127)


def divisions_of(element: Element) -> Fraction:
    """Return the durations per quarter note of attributes; 0 where there are none, or none within bounds."""
    divisions = number_of(element, "divisions", 0.0, 1 / MOST_DIVISIONS, MOST_DIVISIONS)
    return Fraction(divisions).limit_denominator(MOST_DIVISIONS)


def meter_of(element: Element, before: Fraction) -> Fraction:
    """Return the quarter notes of a measure by the time signature of attributes; those before where there is none."""
    time = element.find("time")
    if time is None:
        return before
    meter = Fraction(0)
    for over, under in zip(time.findall("beats"), time.findall("beat-type"), strict=False):
        beats = [whole(word, 1, _MOST_BEATS) for word in (over.text or "").split("+")[:_MOST_BEATS]]
        unit = whole(under.text or "", 1, _MOST_BEATS)
        if unit is None or None in beats:
            return Fraction(0)
        meter += Fraction(4 * sum(n or 0 for n in beats), unit)
    return meter


def offset_of(element: Element, sound: Element | None, ignored: Counter[str]) -> Fraction:
    """Return the durations by which a direction, or its sound, acts later; what cannot be read is counted.

    The offset of a direction is of its picture alone where it does not say otherwise.
    """
    offsets = (element.find("offset[@sound='yes']"), None if sound is None else sound.find("offset"))
    later = [number(offset.text or "", -MOST, MOST) for offset in offsets if offset is not None]
    ignored["offset that cannot be read"] += None in later
    return sum((Fraction(value or 0.0).limit_denominator(MOST_DIVISIONS) for value in later), Fraction(0))


def passes_of(word: str) -> frozenset[int]:
    """Return the passes of a number of an ending, or of two with a hyphen, which some programs write.

    Empty where it cannot be read.
    """
    first, hyphen, last = word.partition("-")
    low = whole(first, 1, _MOST_ENDING)
    high = whole(last, 1, _MOST_ENDING) if hyphen else low
    return frozenset() if low is None or high is None else frozenset(range(low, min(high, low + _MOST_BETWEEN) + 1))


def strum_of(arpeggiate: Element | None, place: int) -> int:
    """Place of a note of an arpeggio; below 0 counted from its highest note, which comes first."""
    return 0 if arpeggiate is None else -place if arpeggiate.get("direction") == "down" else place


def from_lowest(notes: list[WrittenNote]) -> None:
    """Let the places of arpeggios that go down begin at 0."""
    lowest: Counter[Fraction] = Counter()
    for note in notes:
        lowest[note.at] = min(lowest[note.at], note.strum)
    for i, note in enumerate(notes):
        if lowest[note.at] < 0:
            notes[i] = replace(note, strum=note.strum - lowest[note.at])


def bend_of(technical: Element | None) -> Curve:
    """Course of a note's bends, one after the other, in equal parts of the note."""
    bends = [] if technical is None else technical.findall("bend")
    if not bends:
        return ()
    points: list[tuple[float, float]] = []
    value = 0.0
    for i, bend in enumerate(bends):
        target = 0.0 if bend.find("release") is not None else 100.0 * number_of(bend, "bend-alter", 0.0)
        begin = i / len(bends)
        points.append((begin, target if bend.find("pre-bend") is not None else value))
        points.append((begin + 0.5 / len(bends), target))
        value = target
    return bend_curve([*points, (1.0, value)])


def signs_of(element: Element) -> tuple[set[str], Counter[str]]:
    """Return the signs at a note that are followed, and a count of others by their names."""
    signs: set[str] = set()
    ignored: Counter[str] = Counter()
    for sign in _notated(element):
        name = _SIGNS.get(sign.tag)
        if name is None:
            ignored[sign.tag] += 1
        elif name:
            signs.add(name)
        if sign.get("type") == "stop":
            ending = {"hammer-on": "hammer_on", "pull-off": "pull_off", "slide": "slide", "glissando": "slide"}
            signs |= {ending[sign.tag]} if sign.tag in ending else set()
    return signs, ignored


def _notated(element: Element) -> Iterator[Element]:
    for notations in element.findall("notations"):
        for sign in notations:
            if sign.tag in ("articulations", "technical", "ornaments"):
                yield from sign
            else:
                yield sign
