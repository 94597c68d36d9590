"""Notes, controls and scores: every score format is read into these."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from operator import itemgetter
from typing import TYPE_CHECKING

from tonewood.errors import ScoreError, kind_of
from tonewood.instrument.scales import note_number

# (low, high) of every number a note may carry; both ends are allowed
_RANGES: dict[str, tuple[float, float]] = {
    "time": (0.0, math.inf),
    "duration": (0.0, math.inf),
    "held": (0.0, math.inf),
    "note": (-128.0, 256.0),
    "freq": (1e-3, 1e6),
    "force": (0.0, math.inf),
    "velocity_midi": (0.0, 127.0),
    "stop": (0.0, math.inf),
    "from_bridge": (0.0, math.inf),
    "angle_deg": (-math.inf, math.inf),
    "channel": (0, 15),
    "partial": (2, 64),
    "program": (1, 128),
}
#: semitones of a glide, from the lowest note to the highest
_MOST_GLIDE = 384


@dataclass(frozen=True, slots=True)
class Note:
    """One note of a score; the instrument decides on attributes that are None.

    Attributes
    ----------
    time : s, when the pluck releases (the ramp runs before it).
    duration : s, from `time` to the note's end.
    held : s, from `time` on, for which its key is down, where a pedal makes `duration` longer; None if none does.
    note : MIDI note number, fractions are cents / 100, or a name such as ``E2``; or give `freq`, or `string` with
        `stop`.
    freq : Hz, instead of `note`.
    force : N, peak of the gesture; or give `velocity_midi`.
    velocity_midi : 1..127, mapped to a force by the instrument's documented curve.
    string : name of the string; None lets the assignment choose.
    stop : number of the fret, 0 is open, a fraction on a string without frets; None is decided from the pitch.
    from_bridge : m, where the string is played.
    angle_deg : degrees, between the first polarization and the force.
    technique : name of a playing technique the instrument declares, e.g. ``palm``.
    channel : MIDI channel 0..15 the note came from, or None.
    marks : signs written at it, e.g. ``palm_mute``; an instrument that has a technique for one plays it so, and
        ``tablature`` lets the assignment choose where no string has the note at its `stop`.
    partial : of a harmonic: number of the partial that a light finger leaves; `note` is its pitch, `stop` that of the
        string under it. None of a note that is none.
    glides : (s after `time`, semitones from `note`), ...: where the stopping finger is, without a new stroke; it begins
        elsewhere where the first is at 0 s.
    program : of General MIDI, from 1, that its channel or part has; None where the file names none.

    Raises
    ------
    ScoreError : a number is not finite or out of its range.
    """

    time: float
    duration: float = 1.0
    note: float | None = None
    freq: float | None = None
    force: float | None = None
    velocity_midi: float | None = None
    string: str | None = None
    stop: float | None = None
    from_bridge: float | None = None
    angle_deg: float | None = None
    technique: str | None = None
    channel: int | None = None
    marks: tuple[str, ...] = ()
    held: float | None = None
    partial: int | None = None
    glides: tuple[tuple[float, float], ...] = ()
    program: int | None = None

    if TYPE_CHECKING:  # names are numbers once it is made

        def __init__(
            self,
            time: float,
            duration: float = 1.0,
            note: float | str | None = None,
            freq: float | None = None,
            force: float | None = None,
            velocity_midi: float | None = None,
            string: str | None = None,
            stop: float | None = None,
            from_bridge: float | None = None,
            angle_deg: float | None = None,
            technique: str | None = None,
            channel: int | None = None,
            marks: tuple[str, ...] = (),
            held: float | None = None,
            partial: int | None = None,
            glides: tuple[tuple[float, float], ...] = (),
            program: int | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        if isinstance(self.note, str):
            object.__setattr__(self, "note", float(note_number(self.note)))
        for name in ("string", "technique"):
            if not isinstance(getattr(self, name), str | None):
                raise ScoreError(f"{name} of a note is {kind_of(getattr(self, name))}: a name is allowed")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if value is None:
                continue
            number = float(value) if isinstance(value, Real) else math.nan
            if not (low <= number <= high and math.isfinite(number)):
                allowed = (
                    "finite numbers"
                    if low == -math.inf
                    else f"numbers from {low:g}" + (f" to {high:g}" if high < math.inf else "")
                )
                raise ScoreError(f"{name} of a note is {value!r}: {allowed} are allowed")

        for time, steps in self.glides:
            if not (0.0 <= time < math.inf and abs(steps) <= _MOST_GLIDE):
                allowed = f"times from 0 and up to {_MOST_GLIDE} semitones are allowed"
                raise ScoreError(f"a glide of a note is ({time!r}, {steps!r}): {allowed}")

    @property
    def key_up(self) -> float:
        """When its key is released, s."""
        return self.time + (self.duration if self.held is None else self.held)


def ignored_name(kind: str) -> str:
    """Name of a controller's kind among those that are counted as ignored: ``controller 1``, ``channel pressure``."""
    return f"controller {kind[2:]}" if kind.startswith("cc") else kind.replace("_", " ")


@dataclass(frozen=True, slots=True)
class Control:
    """A controller's value from a time on.

    Attributes
    ----------
    time : s.
    kind : ``bend`` (cents), ``ccN`` or ``channel_pressure`` (0..1).
    value : in that unit.
    channel : MIDI channel 0..15, or None for all notes.

    Raises
    ------
    ScoreError : a number is not finite or out of its range.
    """

    time: float
    kind: str
    value: float
    channel: int | None = None

    def __post_init__(self) -> None:
        low, high = (-math.inf, math.inf) if self.kind == "bend" else (0.0, 1.0)
        if not (low <= self.value <= high and math.isfinite(self.value)):
            allowed = "finite cents" if self.kind == "bend" else "0 to 1"
            raise ScoreError(f"{self.kind} of {self.value!r} at {self.time!r} s: {allowed} are allowed")
        if not 0.0 <= self.time < math.inf:
            raise ScoreError(f"{self.kind} at {self.time!r} s: times from 0 are allowed")


@dataclass(frozen=True, slots=True)
class Dropped:
    """A note that cannot be played, and why.

    Attributes
    ----------
    time : s.
    note : MIDI number, if it has one.
    channel : MIDI channel 0..15, if it has one.
    reason : one line.
    """

    time: float
    note: float | None
    channel: int | None
    reason: str


@dataclass(frozen=True)
class Beats:
    """Quarter notes and measures of a score.

    tempos : (s, quarter notes, quarter notes per minute) from which on a tempo holds, in order of time.
    meters : (quarter notes, length in them) of measures: from the first on, one after the other.
    """

    tempos: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 120.0),)
    meters: Sequence[tuple[float, float]] = ((0.0, 4.0),)

    def quarter(self, time: float) -> float:
        """Quarter notes from the beginning at a time, s."""
        at, began, bpm = self.tempos[max(bisect_right(self.tempos, time, key=itemgetter(0)) - 1, 0)]
        return began + (time - at) * bpm / 60.0

    def measures(self, end: float) -> list[float]:
        """Quarter notes at which measures begin, and the end of the last one, which is at `end` or later."""
        out = [0.0]
        for (_, length), until in zip(self.meters, [*(at for at, _ in self.meters[1:]), math.inf], strict=True):
            while out[-1] < min(until, end) - 1e-6:
                out.append(min(out[-1] + length, until))
        return out


@dataclass(frozen=True)
class ScorePart:
    """A part of a file: what `read_score` takes under its number.

    number : of the part, or the MIDI channel, from 1.
    name : empty where it has none.
    channels : other MIDI channels, from 1, that belong to it: those of a zone of MPE.
    programs : program of General MIDI, from 1, or None where the file names none -> number of its notes.
    n_drums : notes of percussion, which are not read.
    """

    number: int
    name: str = ""
    channels: tuple[int, ...] = ()
    programs: Mapping[int | None, int] = field(default_factory=dict)
    n_drums: int = 0


@dataclass(frozen=True)
class Score:
    """Notes and controls in time order.

    Attributes
    ----------
    notes, controls : of the score.
    dropped : notes that could not be read.
    warnings : lines about the file.
    name : of the score, or of its file.
    metadata : texts of the file: ``title``, ``composer``, ``copyright``, as far as it has them.
    ignored : kind of a message or mark -> how many of them were ignored while reading.
    file : path that it was read from, as it was given; None of a score that was made otherwise.
    parts : of the file, as far as they were read.
    beats : None of a score without them.

    Raises
    ------
    ScoreError : `notes` is no list of notes.
    """

    notes: Sequence[Note]
    controls: Sequence[Control] = ()
    dropped: Sequence[Dropped] = ()
    warnings: Sequence[str] = ()
    name: str = "score"
    metadata: dict[str, str] = field(default_factory=dict)
    ignored: Mapping[str, int] = field(default_factory=dict)
    file: str | None = None
    parts: Sequence[ScorePart] = ()
    beats: Beats | None = None

    @property
    def place(self) -> str:
        """File, or else name, that errors name."""
        return self.file or self.name

    def __post_init__(self) -> None:
        if isinstance(self.notes, str | bytes) or not isinstance(self.notes, Sequence):
            raise ScoreError(f"notes of a score are {kind_of(self.notes)}: a list of notes is allowed")
        wrong = next((note for note in self.notes if not isinstance(note, Note)), None)
        if wrong is not None:
            raise ScoreError(f"a note of a score is {kind_of(wrong)}: a Note is allowed")

    def __repr__(self) -> str:
        return (
            f"Score({self.name!r}, {len(self.notes)} notes, {len(self.controls)} controls, {self.duration:.6g} s, "
            f"{len(self.dropped)} dropped)"
        )

    @property
    def duration(self) -> float:
        """End of the last note, s (0 for an empty score)."""
        return max((n.time + n.duration for n in self.notes), default=0.0)
