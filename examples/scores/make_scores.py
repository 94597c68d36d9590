"""Writes the scores beside it: melodies in the public domain, set for these instruments by hand, and two exercises.

python examples/scores/make_scores.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import tonewood as tw
from tonewood.instrument.scales import note_number

#: (beat, length in beats, note name, velocity)
Event = tuple[float, float, str, int]


def line(text: str, *, start: float = 0.0, velocity: int = 80) -> list[Event]:
    """``C4:1.5 D4:.5 -:1``: names with lengths in beats, ``-`` rests."""
    events, beat = [], start
    for word in text.split():
        name, _, length = word.partition(":")
        beats = float(length or 1)
        if name != "-":
            events.append((beat, beats, name, velocity))
        beat += beats
    return events


def score(events: Iterable[Event], title: str, beat: float) -> tw.Score:
    """Events as notes; one beat lasts `beat` seconds."""
    notes = [
        tw.Note(b * beat, length * beat * 0.97, note=note_number(name), velocity_midi=v, channel=0)
        for b, length, name, v in sorted(events)
    ]
    return tw.Score(notes, name=title, metadata={"title": title})


def greensleeves() -> list[Event]:
    """English, before 1580; beats are eighths of 6/8."""
    theme = (
        "A3:1 C4:2 D4:1 E4:1.5 F4:.5 E4:1 D4:2 B3:1 G3:1.5 A3:.5 B3:1 "
        "C4:2 A3:1 A3:1.5 G#3:.5 A3:1 B3:2 G#3:1 E3:2 "
        "A3:1 C4:2 D4:1 E4:1.5 F4:.5 E4:1 D4:2 B3:1 G3:1.5 A3:.5 B3:1 "
        "C4:1.5 B3:.5 A3:1 G#3:1.5 F#3:.5 G#3:1 A3:6 "
        "G4:3 G4:1.5 F#4:.5 E4:1 D4:2 B3:1 G3:1.5 A3:.5 B3:1 "
        "C4:2 A3:1 A3:1.5 G#3:.5 A3:1 B3:2 G#3:1 E3:3 "
        "G4:3 G4:1.5 F#4:.5 E4:1 D4:2 B3:1 G3:1.5 A3:.5 B3:1 "
        "C4:1.5 B3:.5 A3:1 G#3:1.5 F#3:.5 G#3:1 A3:6"
    )
    bass = (
        "A2:3 A2:3 G2:3 G2:3 A2:3 F2:3 E2:3 E2:3 A2:3 A2:3 G2:3 G2:3 A2:3 E2:3 A2:3 E3:3 "
        "C3:3 C3:3 G2:3 G2:3 A2:3 F2:3 E2:3 E2:3 C3:3 C3:3 G2:3 G2:3 A2:3 E2:3 A2:6"
    )
    return line(theme, velocity=86) + line(bass, start=1.0, velocity=70)


def romance() -> list[Event]:
    """Spanish, anonymous, 19th century; beats are triplet eighths of 3/4."""
    melody = (
        "B4 B4 B4 B4 A4 G4 G4 F#4 E4 E4 G4 B4 E5 E5 E5 E5 D5 C5 C5 B4 A4 A4 B4 C5 "
        "B4 C5 B4 D#5 C5 B4 B4 A4 G4 G4 F#4 E4 F#4 F#4 F#4 F#4 G4 F#4 E4 G4 B4 E4"
    )
    below = [("B3", "G3")] * 18 + [("E4", "C4")] * 6 + [("F#4", "D#4")] * 6 + [("B3", "G3")] * 6
    below += [("B3", "A3")] * 6 + [("B3", "G3")] * 3
    bass = ["E2"] * 6 + ["A2"] * 2 + ["B2"] * 2 + ["E2"] * 2 + ["B2"] * 2 + ["E2"] * 2
    events: list[Event] = []
    for i, name in enumerate(melody.split()):
        events.append((3.0 * i, 3.0 if i < 45 else 9.0, name, 92))
        events += [(3.0 * i + 1 + j, 2.0, inner, 62) for j, inner in enumerate(below[i] if i < 45 else ())]
    events += [(9.0 * i, 9.0, name, 76) for i, name in enumerate(bass)]
    return events


def prelude() -> list[Event]:
    """J. S. Bach, Prelude in C, BWV 846 (1722), bars 1 to 9 an octave lower, and a close; beats are sixteenths."""
    bars = [
        "C3 E3 G3 C4 E4", "C3 D3 A3 D4 F4", "B2 D3 G3 D4 F4", "C3 E3 G3 C4 E4", "C3 E3 A3 E4 A4",
        "C3 D3 F#3 A3 D4", "B2 D3 G3 D4 G4", "B2 C3 E3 G3 C4", "A2 C3 E3 G3 C4",
    ]  # fmt: skip
    events: list[Event] = []
    for bar, names in enumerate(bars):
        low, second, *upper = names.split()
        for half in (0, 8):
            at = 16.0 * bar + half
            events += [(at, 8.0, low, 78), (at + 1, 7.0, second, 70)]
            events += [(at + 2 + i, 1.0, name, 72) for i, name in enumerate(upper * 2)]
    events += [(144.0 + 0.3 * i, 16.0, name, 70) for i, name in enumerate(["C3", "E3", "G3", "C4", "E4"])]
    return events


def scale() -> list[Event]:
    """Two octaves of C and back; beats are eighths."""
    up = ["C3", "D3", "E3", "F3", "G3", "A3", "B3", "C4", "D4", "E4", "F4", "G4", "A4", "B4"]
    return line(" ".join([*up, "C5", *reversed(up)]), velocity=84)


def chords() -> list[Event]:
    """A cadence on all six strings, thumb to finger; beats are quarters."""
    shapes = ["E2 B2 E3 G#3 B3 E4", "E2 A2 E3 A3 C#4 E4", "E2 B2 D3 G#3 B3 E4", "E2 B2 E3 G#3 B3 E4"]
    return [
        (2.0 * i + 0.05 * j, 2.0 - 0.05 * j, name, 90)
        for i, shape in enumerate(shapes)
        for j, name in enumerate(shape.split())
    ]


def pentatonic() -> list[Event]:
    """For the harp: an ostinato over its eight strings, made up; beats are eighths."""
    low = "E3 A3 F#3 B3 E3 A3 F#3 A3 " * 6
    high = "- F#4 - E4 A4 - E4 - - C#4 - F#4 E4 - C#4 - - F#4 - A4 F#4 - E4 - - E4 - C#4 - E4 - -"
    return [*line(low, velocity=70), *line(high, start=16.0, velocity=88), (48.0, 8.0, "E3", 80)]


PIECES = {
    "greensleeves": (greensleeves, 0.36),
    "romance": (romance, 0.21),
    "prelude": (prelude, 0.2),
    "scale": (scale, 0.3),
    "chords": (chords, 0.8),
    "pentatonic": (pentatonic, 0.22),
}


def main(folder: Path = Path(__file__).parent) -> None:
    """Write every piece as a MIDI file."""
    for name, (events, beat) in PIECES.items():
        tw.write_midi(score(events(), name, beat), folder / f"{name}.mid", bpm=60.0 / beat)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
