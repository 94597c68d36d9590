"""Pitches of MusicXML, and their neighbours in a key."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from tonewood.performance.score.xml_files import number_of, text_of

_STEPS = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
#: letters in the order in which sharps are written, and in the order of pitch
_SHARPS, _LETTERS = "FCGDAEB", "CDEFGAB"


def pitch_of(element: Element | None, step: str, alter: str, octave: str) -> float | None:
    """MIDI number of a pitch whose parts have these names; None where it has no letter, or is out of range."""
    letter = text_of(element, step)
    if letter not in _STEPS:
        return None
    pitch = 12 * (number_of(element, octave, 4.0) + 1) + _STEPS[letter] + number_of(element, alter, 0.0)
    return pitch if 0.0 <= pitch <= 140.0 else None


def neighbours(element: Element, fifths: int) -> tuple[int, int]:
    """Semitones down and up to the neighbours of a note in its key, or by an accidental at its ornament.

    element : a note with a pitch.
    fifths : sharps of the key, below 0 flats.
    """
    letter = text_of(element, "pitch/step")
    pitch = _STEPS[letter] + round(number_of(element, "pitch/alter", 0.0))
    out = []
    for way in (-1, 1):
        other = _LETTERS[(_LETTERS.index(letter) + way) % 7]
        index = _SHARPS.index(other)
        alter = (fifths > index) - (-fifths > 6 - index)
        for mark in element.findall("notations/ornaments/accidental-mark"):
            if (mark.get("placement") == "below") == (way < 0):
                alter = {"sharp": 1, "natural": 0, "flat": -1}.get((mark.text or "").strip(), alter)
        step = (_STEPS[other] + alter - pitch) * way % 12
        out.append(step if 0 < step < 5 else 2)
    return out[0], out[1]
