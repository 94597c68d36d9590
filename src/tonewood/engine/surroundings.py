"""Laws that come and go with gestures: fingers' dashpots, and connections that rest while nobody moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tonewood.engine.gestures import Active
from tonewood.numerics.connections import Connection, SpringDashpot
from tonewood.numerics.system import System


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


def held(system: System, holds: Mapping[str, float]) -> System:
    """The system with fingers' dashpots as in `holds`; itself if they are so already."""
    laws = {}
    for connection in system.connections:
        if connection.name.endswith(".hold"):
            law = SpringDashpot(damping=holds.get(string_of(connection.name), 0.0))
            if law != connection.law:
                laws[connection.name] = replace(connection, law=law)
    return system.with_laws(laws) if laws else system


def woken(system: System, resting: Mapping[str, Connection], active: Sequence[Active]) -> System:
    """The system with those `resting` connections in effect that gestures move; itself if they are so already."""
    wanted = {m.connection for a in active for m in a.play.gesture.motions}
    laws = {}
    for connection in system.connections:
        if connection.name in resting:
            law = resting[connection.name].law if connection.name in wanted else SpringDashpot()
            if law != connection.law:
                laws[connection.name] = replace(connection, law=law)
    return system.with_laws(laws) if laws else system
