"""Setup of a string: directions of motion, stops, and tension before and after tuning."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tonewood.instrument.bundle.schema import Finger
from tonewood.instrument.contract.base import Longitudinal
from tonewood.physics.modal.fretted import FrettedString
from tonewood.support.params import Vector

#: cents of pitch between given and used tension from which on a render reports them; printed tensions and a compliant
#: body make up to 27 (E2 of flamenco_guitar, beside a strong body mode)
NOTICEABLE_CENTS = 30.0


@dataclass(frozen=True, slots=True)
class Polarization:
    """One plane in which a string moves.

    component : its name in the system, ``STRING.NAME``.
    direction : unit vector, tilt included.
    ends : body point -> (p . d), share of that point's displacement in the string's end; without any the end is rigid.
    detune : frequency ratio to the first polarization.
    """

    component: str
    direction: Vector
    ends: Mapping[str, float]
    detune: float = 1.0


@dataclass(frozen=True, slots=True)
class LongitudinalMotion:
    """Motion along a string.

    component : its name in the system, ``STRING.longitudinal``.
    direction : unit vector from the bridge to the nut.
    ends : body point -> share of that point's displacement in the string's end.
    motion : as the resonator gives it.
    """

    component: str
    direction: Vector
    ends: Mapping[str, float]
    motion: Longitudinal


@dataclass(frozen=True, slots=True)
class Stopping:
    """Stops of a string.

    count : highest stop, in steps of the scale; 0 for open strings.
    continuous : whether stops between whole steps exist.
    freq : stop -> pitch of its note, Hz.
    compensate : ``each_stop``, ``open_only``, ``frets`` or ``none``.
    hold : ``pitch`` or ``tension``: which of the two of the bundle the open string keeps where it is compensated.
    finger : soft finger that stops the string; None where the stop is an ideal end.
    stretch_cents : by which the tuning raises all its pitches, `freq` included; the tension given is not expected to.
    fretted : the string over its real frets, which set lengths and tensions of its stops; None without them.
    """

    count: int
    continuous: bool
    freq: Callable[[float], float]
    compensate: str
    hold: str = "pitch"
    finger: Finger | None = None
    stretch_cents: float = 0.0
    fretted: FrettedString | None = None


@dataclass(frozen=True, slots=True)
class GivenTension:
    """Tension that the bundle gives an open string, and the tension used.

    string : its name.
    given, used : N, of the first polarization.
    held : ``pitch`` or ``tension``: which of the two was kept.
    raised_cents : pitch of the open string at the given tension, from its note; 0 where the pitch is held.
    stretch_cents : by which the tuning raises the note.
    """

    string: str
    given: float
    used: float
    held: str
    raised_cents: float
    stretch_cents: float = 0.0

    @property
    def cents(self) -> float:
        """Pitch at the given tension, from the note without stretch: 600 lg2(given / used) cents and the stretch."""
        if self.held == "tension":
            return self.raised_cents
        return 600.0 * math.log2(self.given / self.used) + self.stretch_cents

    @property
    def noticeable(self) -> bool:
        """Whether they differ by more than `NOTICEABLE_CENTS`."""
        return abs(self.cents) > NOTICEABLE_CENTS

    def line(self) -> str:
        """One line that says which of the two was kept."""
        if self.held == "tension":
            off = f"{self.cents:+.0f} cents from its note"
            return f"{self.string}: its tension of {self.given:g} N is held; it sounds {off}"
        return (
            f"{self.string}: tuned to its note at {self.used:.4g} N; the {self.given:g} N given would sound "
            f"{self.cents:+.0f} cents from it (tuning.hold: tension keeps them)"
        )
