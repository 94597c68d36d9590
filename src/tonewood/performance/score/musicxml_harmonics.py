"""Harmonics of MusicXML whose notes say which pitch they write: of the string, of the touch, or that which sounds.

An artificial harmonic may be written as a chord of the three; one note of it is heard.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from xml.etree.ElementTree import Element

from tonewood.performance.score.harmonics import interval, partial_at
from tonewood.performance.score.written import WrittenNote

_KINDS = ("base-pitch", "touching-pitch", "sounding-pitch")
_HIGHEST = 64


def kind_of_pitch(note: Element) -> str:
    """Return which pitch of a harmonic a note writes; empty where it does not say so."""
    harmonic = note.find("notations/technical/harmonic")
    return "" if harmonic is None else next((kind for kind in _KINDS if harmonic.find(kind) is not None), "")


def not_heard(measure: Element) -> tuple[set[Element], int]:
    """Notes that say where a string is stopped or touched, beside one of their chord that is heard.

    Returns They, and how many touched ones stand beside no note of the pitch that sounds.
    """
    out: set[Element] = set()
    chords: list[dict[str, list[Element]]] = []
    for note in measure.findall("note"):
        if note.find("chord") is None or not chords:
            chords.append(defaultdict(list))
        chords[-1][kind_of_pitch(note)].append(note)
    alone = 0
    for chord in chords:
        base, touched, heard = (chord.get(kind, []) for kind in _KINDS)
        if heard or base:
            out |= {*touched, *(base if heard else ())}
            alone += 0 if heard else len(touched)
    return out, alone


def sounding(note: WrittenNote, natural: bool, base: float | None) -> WrittenNote:
    """A harmonic written at the pitch that sounds, on its string.

    natural : it is touched at its fret, on an open string; else stopped there.
    base : pitch of the string under it, where it is known. Without it a natural harmonic is the partial that has a
        node at its fret, any other the octave.
    """
    signs = tuple(sign for sign in note.signs if sign != "harmonic")
    partial = 2
    if base is not None:
        partial = round(2 ** min(max((note.pitch - base) / 12, 0.0), 6.0))
    elif natural and note.fret:
        partial = partial_at(note.fret) or 2
    if base is not None and not (partial > 1 and abs(note.pitch - base - interval(partial)) < 0.7):
        return replace(note, signs=signs, partial=2, string=None, fret=None)
    return replace(note, signs=signs, partial=partial, fret=0 if natural and note.string else note.fret)
