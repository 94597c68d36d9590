"""The phrase that the desk plays: a chord, a scale, notes by name or a file; always a file that a render takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tonewood.errors import ScoreError, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.scales import note_number
from tonewood.performance.score.midi import read_midi, write_midi
from tonewood.performance.score.note import Note, Score
from tonewood.performance.score.reading import read_score

#: s between notes of a strummed chord, of a scale and of single notes; s that a chord lasts
_STRUM, _STEP, _CHORD = 0.03125, 0.25, 2.0
#: notes by name at most
_MOST = 64
#: s of a phrase that are rendered at most
LONGEST = 60.0


def phrase(kind: str, instrument: Instrument, file: Path, *, notes: str = "", velocity: float = 80.0) -> Score:
    """Make a phrase, write it as MIDI, and read it back: what is heard is what the file says.

    kind : chord (open strings), scale (from the lowest string on), or notes.
    notes : names such as ``E2 B2 E3``; those with + between them sound together.
    velocity : 1 to 127.
    Raises ScoreError : there is no such kind, or a note has no name.
    """
    if not 1 <= velocity <= 127:
        raise ScoreError(f"is {velocity!r}; 1 to 127 are allowed", key="velocity")
    strings = sorted({round(instrument.open_note(name)) for name in instrument.groups})
    apart, lasting = _STEP, 4 * _STEP
    if kind == "chord":
        apart, lasting = _STRUM, _CHORD
        steps = [[key] for key in strings]
        if len(strings) > 6:
            steps = [steps[i * len(steps) // 6] for i in range(6)]
    elif kind == "scale":
        lasting = 2 * _STEP
        steps = [[min(strings) + k] for k in (0, 2, 4, 5, 7, 9, 11, 12)]
    elif kind == "notes":
        words = notes.split()
        if not 1 <= len(words) <= _MOST:
            raise ScoreError(f"{len(words)} notes; 1 to {_MOST} are allowed, e.g. E2 B2 E3+G3", key="notes")
        steps = [[round(float(note_number(name))) for name in word.split("+")] for word in words]
    else:
        raise ScoreError(f"is {kind!r}; chord, scale, notes or file are allowed", key="phrase")
    played = [Note(apart * i, lasting, note=k, velocity_midi=velocity) for i, step in enumerate(steps) for k in step]
    write_midi(Score(played, name="phrase"), file)
    return read_midi(file)


class ChosenPhrase:
    """The phrase that the page asks for, and its file.

    score_file : score of the command line; None without one.
    file : to be written.
    Raises TonewoodError : both are one file.
    """

    def __init__(self, score_file: Path | None, file: Path):
        if score_file is not None and score_file.exists() and file.exists() and score_file.samefile(file):
            raise TonewoodError("is the file that the desk writes its phrases to; give a copy of it", file=score_file)
        self.score_file, self._file = score_file, file
        #: kind, notes and velocity as for `phrase`; the kind ``file`` is the score of the command line
        self.asked: dict[str, Any] = {"kind": "file" if score_file else "chord", "notes": "", "velocity": 80}

    @property
    def file(self) -> Path:
        """File of the phrase, as a command names it."""
        return self.score_file if self.asked["kind"] == "file" and self.score_file is not None else self._file

    def score(self, instrument: Instrument) -> Score:
        """Return the notes of the phrase, of a file the first `LONGEST` seconds.

        Raises TonewoodError : the phrase cannot be read, or no file was given.
        """
        asked = self.asked
        if asked["kind"] != "file":
            return phrase(asked["kind"], instrument, self._file, notes=asked["notes"], velocity=asked["velocity"])
        if self.score_file is None:
            raise TonewoodError("no file was given on the command line: --phrase FILE", key="phrase")
        return read_score(self.score_file, stop=LONGEST)
