"""Laws that come and go with gestures: fingers' dashpots, and connections that rest while nobody moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tonewood.coupling.connections import Law, SpringDashpot
from tonewood.coupling.system import System
from tonewood.engine.gestures import Active
from tonewood.instrument.assembly import Model


def string_of(name: str) -> str:
    """STRING of ``STRING.y`` and ``STRING.PART.NAME``."""
    return name.partition(".")[0]


def holds_at(active: Sequence[Active], now: int) -> dict[str, float]:
    """String -> damping (N s/m) of the finger that holds it at a sample."""
    wanted: dict[str, float] = {}
    for gesture in active:
        reached = [size for sample, size in gesture.holds if sample <= now]
        if reached and reached[-1] > 0 and gesture.play.string is not None:
            wanted[gesture.play.string] = reached[-1]
    return wanted


class Surroundings:
    """The connections of a model that gestures wake: where they are, and how they are at work."""

    def __init__(self, model: Model):
        connections = list(enumerate(model.system.connections))
        # place, law at rest, and the law at work or the string that is held
        self._resting = [(j, c.law, model.resting[c.name]) for j, c in connections if c.name in model.resting]
        self._holds = [(j, c.law, string_of(c.name)) for j, c in connections if c.name.endswith(".hold")]

    def held(self, system: System, holds: Mapping[str, float]) -> System:
        """The system with fingers' dashpots as in `holds`; itself if they are so already."""
        laws = {string: SpringDashpot(damping=damping) for string, damping in holds.items()}
        return _with_laws(system, [(j, laws.get(string, rest)) for j, rest, string in self._holds])

    def woken(self, system: System, active: Sequence[Active]) -> System:
        """The system with those resting connections in effect that gestures move; itself if they are so already."""
        if not self._resting:
            return system
        wanted = {m.connection for a in active for m in a.play.gesture.motions}
        return _with_laws(system, [(j, c.law if c.name in wanted else rest) for j, rest, c in self._resting])


def _with_laws(system: System, wanted: Sequence[tuple[int, Law]]) -> System:
    """The system with these laws at these places; itself if they are there already."""
    now = system.connections
    laws = {now[j].name: replace(now[j], law=law) for j, law in wanted if law is not now[j].law and law != now[j].law}
    return system.with_laws(laws) if laws else system
