"""Connections whose laws change while gestures last: fingers' dashpots, and connections that are idle otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.gestures import Active
from tonewood.physics.coupling.connections import Connection, Law, SpringDashpot
from tonewood.physics.coupling.elimination import Elimination
from tonewood.physics.coupling.system import System

#: sets of laws that are kept
_KEPT = 256


def holds_at(active: Sequence[Active], now: int) -> dict[str, float]:
    """String -> damping (N s/m) of the finger that holds it at a sample."""
    damping: dict[str, float] = {}
    for gesture in active:
        reached = [size for sample, size in gesture.holds if sample <= now]
        if reached and reached[-1] > 0 and gesture.play.string is not None:
            damping[gesture.play.string] = reached[-1]
    return damping


class GestureConnections:
    """The connections of a model that gestures change, and their laws with and without a gesture.

    model : whose `resting` connections, and dashpots with the role hold, are meant.
    """

    def __init__(self, model: Model):
        connections = list(enumerate(model.system.connections))
        # index, law without a gesture, and the connection with one
        self._idle = [(j, c.law, model.resting[c.name]) for j, c in connections if c.name in model.resting]
        # index, law without a finger, and the string
        self._holds = [(j, c.law, c.owner) for j, c in connections if c.role == "hold"]
        #: identity of connections -> these, and their laws without fingers
        self._free: dict[int, tuple[tuple[Connection, ...], Elimination]] = {}
        #: identity of laws without fingers, and the strings' dashpots -> laws with them
        self._kept: dict[tuple[int, frozenset[tuple[str, float]]], Elimination] = {}

    def with_holds(self, system: System, holds: Mapping[str, float]) -> System:
        """Return the system with fingers' dashpots as in `holds`; itself if they are so already.

        The same few dashpots come and go with every note: their laws are kept.
        """
        if len(self._kept) >= _KEPT:
            self._free.clear()
            self._kept.clear()
        now = system.connections
        if id(now) not in self._free:
            free = self._held(system, {}).elimination.laws_alone
            self._free[id(now)] = now, free
            self._free[id(free.connections)] = free.connections, free
            self._kept[id(free), frozenset()] = free
        free = self._free[id(now)][1]
        key = id(free), frozenset(holds.items())
        if key not in self._kept:
            self._kept[key] = laws = self._held(system, holds).elimination.laws_alone
            self._free[id(laws.connections)] = laws.connections, free
        laws = self._kept[key]
        return system if laws.connections is now else system.with_laws_of(laws)

    def _held(self, system: System, holds: Mapping[str, float]) -> System:
        laws = {string: SpringDashpot(damping=damping) for string, damping in holds.items()}
        return with_laws(system, [(j, laws.get(string, none)) for j, none, string in self._holds])

    def with_moved(self, system: System, active: Sequence[Active]) -> System:
        """Return the system with those connections in effect that gestures move; itself if they are so already."""
        if not self._idle:
            return system
        moved = {m.connection for a in active for m in a.play.gesture.motions}
        return with_laws(system, [(j, c.law if c.name in moved else none) for j, none, c in self._idle])


def with_laws(system: System, changes: Sequence[tuple[int, Law]]) -> System:
    """Return the system with these laws, each with the index of its connection; itself if it has them already."""
    now = system.connections
    laws = {now[j].name: replace(now[j], law=law) for j, law in changes if law is not now[j].law and law != now[j].law}
    return system.with_laws(laws) if laws else system
