"""The one event type: a note. Scores of every kind become a list of these before anything is played."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Note:
    """One note of a score; what is not given is decided by the instrument.

    Attributes
    ----------
    time : s, when the pluck releases (the ramp runs before it).
    duration : s, from `time` to the note's end.
    note : MIDI note number, fractions are cents / 100; or give `freq`, or `string` with `stop`.
    freq : Hz, instead of `note`.
    force : N, peak of the gesture; or give `velocity_midi`.
    velocity_midi : 1..127, mapped to a force by the instrument's documented curve.
    string : name of the string; None lets the assignment choose.
    stop : number of the fret, 0 is open; None is decided from the pitch.
    from_bridge : m, where the string is played.
    angle_deg : degrees, between the first polarization and the force.
    technique : name of a playing technique the instrument declares, e.g. ``palm``.
    channel : MIDI channel 0..15 the note came from, or None.
    """

    time: float
    duration: float = 1.0
    note: float | None = None
    freq: float | None = None
    force: float | None = None
    velocity_midi: float | None = None
    string: str | None = None
    stop: int | None = None
    from_bridge: float | None = None
    angle_deg: float | None = None
    technique: str | None = None
    channel: int | None = None


@dataclass(frozen=True, slots=True)
class Control:
    """A controller's value from `time` on: `kind` is ``bend`` (value in cents) or ``ccN`` (value 0..1)."""

    time: float
    kind: str
    value: float
    channel: int | None = None


@dataclass(frozen=True, slots=True)
class Dropped:
    """A note that cannot be played, and why: nothing is lost without this."""

    time: float
    note: float | None
    channel: int | None
    reason: str


@dataclass(frozen=True)
class Score:
    """Notes and controllers in time order, with what was dropped or mended while reading."""

    notes: Sequence[Note]
    controls: Sequence[Control] = ()
    dropped: Sequence[Dropped] = ()
    warnings: Sequence[str] = ()
    name: str = "score"
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """End of the last note, s (0 for an empty score)."""
        return max((n.time + n.duration for n in self.notes), default=0.0)
