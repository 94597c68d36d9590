"""Gestures of exciters: events, places, known forces, and helpers to make them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated

from pydantic import Field

from tonewood.errors import BundleError
from tonewood.instrument.contract.attached import Motion
from tonewood.physics.stepping.forcing import SampledForce, Segment
from tonewood.support.params import Number, Parameters, quantity


@dataclass(frozen=True, slots=True)
class Hold:
    """Dashpot of a finger on the string, from `start` to `stop`; dissipates only.

    Attributes
    ----------
    start, grown, stop : s; the damping grows smoothly from `start` to `grown`, and ends at `stop`.
    damping : N s/m, from `grown` on.
    """

    start: float
    grown: float
    stop: float
    damping: float

    def at(self, time: float) -> float:
        """Return the damping at a time, N s/m."""
        if not self.start <= time < self.stop:
            return 0.0
        s = 1.0 if self.grown <= self.start else min((time - self.start) / (self.grown - self.start), 1.0)
        return self.damping * s * s * (3.0 - 2.0 * s)


@dataclass(frozen=True, slots=True)
class Event:
    """One event for an exciter: a note, or the part of one that it plays.

    Attributes
    ----------
    values : parameters of the exciter that this event changes, e.g. ``force`` or ``from_bridge``.
    freq : pitch that will sound, Hz; 0 where there is none.
    duration : s, of the note; infinite if it is not known.
    stop, stop_before : stops of the string at this event and at the one before it on this string (0 open).
    length_before : m, speaking length at `stop_before`; 0 where there is no string.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    freq: float = 0.0
    duration: float = math.inf
    stop: float = 0.0
    stop_before: float = 0.0
    length_before: float = 0.0


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a gesture: a string at a stop, or a point of the body.

    Attributes
    ----------
    name : of the string, or ``component.point``.
    length : m, speaking length; 0 of a point.
    planes : number of the string's polarizations.
    tension : N, of the string at this stop.
    strings : those of its key, each with a factor on the force of the exciter's contact with it: 0 where the exciter
        misses it.
    """

    name: str
    length: float = 0.0
    planes: int = 1
    tension: float = 0.0
    strings: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Gesture:
    """Known forces at one place.

    Attributes
    ----------
    segments : in time order, seconds relative to the event's time; negative times prepare it.
    from_bridge : place on the string, m; None on a body, and where the last gesture on the string was.
    angle_deg : of the force, from the first polarization towards the second.
    hold : dashpot of the finger on the string, or None.
    on : input that the forces enter, one of those that the exciter has `attach`ed; None for the string itself.
    motions : of the partners of the exciter's own connections.
    stops : course of the string's stop, in segments like those of a force; after them the stop is that of the note.
        On a fretted string it is rounded down to a fret. Without segments the note's stop holds from the gesture's
        start on.
    touches : point the exciter has `attach`ed -> course of its place, m from the bridge; followed on the control grid.
        Points that are not named lie where `attach` has put them.
    width : m, of the string, about `from_bridge`, over which the forces are spread evenly; 0 for a point.
    noise : a random part of the force, added to the segments; None without one.
    """

    segments: tuple[Segment, ...]
    from_bridge: float | None = None
    angle_deg: float = 0.0
    hold: Hold | None = None
    on: str | None = None
    motions: tuple[Motion, ...] = ()
    stops: tuple[Segment, ...] = ()
    touches: Mapping[str, tuple[Segment, ...]] = field(default_factory=dict)
    width: float = 0.0
    noise: SampledForce | None = None

    @property
    def start(self) -> float:
        """Beginning of the gesture, s relative to the event."""
        begins = [s.start for s in self._pieces] + [part.start for part in (self.hold, self.noise) if part]
        return min(begins, default=0.0)

    @property
    def stop(self) -> float:
        """End of the gesture, s relative to the event."""
        ends = [s.stop for s in self._pieces] + [part.stop for part in (self.hold, self.noise) if part]
        return max(ends, default=0.0)

    @property
    def _pieces(self) -> tuple[Segment, ...]:
        return self.segments + tuple(s for motion in self.motions for s in motion.segments)

    def force(self, time: float) -> float:
        """Return the force at a time without its random part, N."""
        return sum(
            s.c0 + s.c1 * (time - s.start) + s.c2 * (time - s.start) ** 2
            for s in self.segments
            if s.start <= time < s.stop
        )


class Fraction(Parameters):
    """A place as a share of the speaking length, from the bridge."""

    fraction: float = quantity("1", low=0.0, high=1.0, doc="0 is the bridge, 1 the nut or stop")


#: metres from the bridge, or ``{fraction: share of the speaking length}``
StringPlace = Annotated[Number, Field(ge=0.0)] | Fraction


_OPTIONAL = StringPlace | None
#: share of the speaking length next to either end where a string is not played
_NEAREST = 0.01
#: s, below which a change of force is a step: the square of a much shorter one is 0
_SHORTEST_STEP = 1e-15


def metres(place: StringPlace, on: Place) -> float:
    """Return a place in metres from the bridge, limited to 1 % of the speaking length from either end.

    A place behind the stop cannot be played; the nearest place before it is taken.

    Parameters
    ----------
    place : m, or a share of the speaking length.
    on : string at its stop.

    Raises
    ------
    BundleError : `on` is no string.
    """
    if on.length <= 0:
        raise BundleError(f"{on.name} is not a string: there is no place from its bridge")
    x = place.fraction * on.length if isinstance(place, Fraction) else float(place)
    return min(max(x, _NEAREST * on.length), (1 - _NEAREST) * on.length)


@cache
def _place_fields(kind: type[Parameters]) -> tuple[str, ...]:
    return tuple(name for name, field in kind.model_fields.items() if field.annotation in (StringPlace, _OPTIONAL))


def places(parameters: Parameters, open_length: float, length: float) -> dict[str, float]:
    """Places among parameters, given in metres or as shares of the speaking length: name -> m from the bridge.

    Raises ValueError : a place lies beyond the open string; names it.
    """
    metres = {}
    for name in _place_fields(type(parameters)):
        position = getattr(parameters, name)
        if position is None:
            continue
        metres[name] = position.fraction * length if isinstance(position, Fraction) else float(position)
        if metres[name] > open_length:
            raise ValueError(
                f"{name} is {metres[name]:g} m; places up to {open_length:g} m, the open string, are allowed"
            )
    return metres


def is_played(x: float, length: float) -> bool:
    """Whether `metres` leaves a place x (m) from the bridge unchanged on this speaking length (m)."""
    return _NEAREST * length <= x <= (1 - _NEAREST) * length


def smooth_step(start: float, stop: float, low: float, high: float) -> tuple[Segment, ...]:
    """Return a force that goes from one value to another by two parabolas, level at both ends.

    Parameters
    ----------
    start, stop : s, relative to the event; nothing is returned unless stop is later by a femtosecond or more.
    low, high : N, at these times.
    """
    if stop - start < _SHORTEST_STEP:
        return ()
    width, rise = stop - start, high - low
    middle, bend = start + width / 2, 2 * rise / width**2
    return (Segment(start, middle, low, 0.0, bend), Segment(middle, stop, low + rise / 2, 2 * rise / width, -bend))
