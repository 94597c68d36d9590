"""Events of a performance, plain data in time order: the engine's only input besides the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from tonewood.instrument.contract.gestures import Gesture

#: samples between two points of the control grid
GRID = 64


@dataclass(frozen=True, slots=True)
class Change:
    """An action of the left hand on a string; None leaves a value as it is.

    time : s; takes effect at the last point of the control grid before it.
    string : its name.
    stop : number of the stop, 0 open; a fraction where stops are continuous.
    cents : how far the string is bent from the stop's own pitch.
    added_damping : 1/s, added to every mode's decay rate: a finger that damps.
    touches : (point, m from the bridge), ...: points of the string that lie elsewhere than their part says.
    damper : share of the loss of the felt that rests on the string: 0 where it is lifted, 1 where it lies.
    """

    time: float
    string: str
    stop: float | None = None
    cents: float | None = None
    added_damping: float | None = None
    touches: tuple[tuple[str, float], ...] | None = None
    damper: float | None = None


@dataclass(frozen=True, slots=True)
class Play:
    """A gesture at an absolute time, on a string or on a point ``component.point``; `exciter` is its maker's name."""

    time: float
    gesture: Gesture
    string: str | None = None
    at: str | None = None
    exciter: str = ""

    @property
    def start(self) -> float:
        """When the gesture begins, s; before `time` where it has to be prepared."""
        return self.time + self.gesture.start

    @property
    def stop(self) -> float:
        """When it is over, s."""
        return self.time + self.gesture.stop


@dataclass(frozen=True)
class Timeline:
    """Changes in the order of their time, plays in the order of their start."""

    changes: Sequence[Change]
    plays: Sequence[Play]

    @cached_property
    def stops(self) -> dict[str, set[float]]:
        """String -> stops at which it is held, those that a slide passes among them."""
        stops: dict[str, set[float]] = {}
        for change in self.changes:
            if change.stop is not None:
                stops.setdefault(change.string, set()).add(change.stop)
        return stops

    @cached_property
    def bent(self) -> dict[str, set[float]]:
        """String -> stops at which it is bent."""
        stop, cents, bent = dict[str, float](), dict[str, float](), dict[str, set[float]]()
        for change in self.changes:
            name = change.string
            stop[name] = stop.get(name, 0.0) if change.stop is None else change.stop
            cents[name] = cents.get(name, 0.0) if change.cents is None else change.cents
            if cents[name]:
                bent.setdefault(name, set()).add(stop[name])
        return bent

    @cached_property
    def start(self) -> float:
        """Time of the first thing that happens, s, at most 0."""
        return min([0.0, *(c.time for c in self.changes), *(p.start for p in self.plays)])

    @cached_property
    def stop(self) -> float:
        """Time of the last thing that happens, s."""
        return max([0.0, *(c.time for c in self.changes), *(p.stop for p in self.plays)])
