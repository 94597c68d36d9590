"""Layout of a system: the data of components, connections and readouts that no basis and no law changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tonewood.physics.coupling.connections import Connection, Term
from tonewood.support import moved
from tonewood.support.arrays import Floats, Indices


def __getattr__(name: str) -> Any:
    return moved.renamed(__name__, name, {"Probe": Term})


@dataclass(frozen=True, slots=True)
class Readout:
    """One channel: a weighted sum of points' motion, or of connection forces (N).

    Displacement and velocity are read at the sample's time t_n; acceleration and force are means over the step that
    begins there, [t_n, t_n + h]: the force is constant over a step, and a mean needs no direct term.

    Attributes
    ----------
    name : unique in its system.
    quantity : ``displacement`` (m), ``velocity`` (m/s) or ``acceleration`` (m/s^2) of points, or ``force`` (N).
    probes : terms whose sum is read, where the quantity is one of points.
    forces : name of a connection, factor; where the quantity is force.

    Raises
    ------
    ValueError : another quantity.
    """

    name: str
    quantity: str
    probes: tuple[Term, ...] = ()
    forces: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.quantity not in ("displacement", "velocity", "acceleration", "force"):
            raise ValueError(
                f"a readout's quantity is displacement, velocity, acceleration or force, not {self.quantity!r}"
            )


@dataclass(frozen=True, slots=True)
class Drive:
    """A one-way input: a point of a driven component receives `factor` times the force of a connection.

    Attributes
    ----------
    component, point : names.
    connection : its name in the system.
    factor : on its force.
    impulses : whether it receives also those by which joined points are given one velocity (`physics.stepping.motion`).
    """

    component: str
    point: str
    connection: str
    factor: float = 1.0
    impulses: bool = False


@dataclass(frozen=True, eq=False)
class Layout:
    """Indices of m connections between named components.

    names : of the components.
    capacities : modes that the state has room for, one per component.
    connections : of which only names and terms are looked at.
    readouts, drives : as in `System`.
    owners : component -> string that it belongs to; the body and microphones have none.
    """

    names: tuple[str, ...]
    capacities: tuple[int, ...]
    connections: tuple[Connection, ...]
    readouts: tuple[Readout, ...]
    drives: tuple[Drive, ...]
    owners: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def slots(self) -> Mapping[str, int]:
        """Component -> its index."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Connection -> its index."""
        return {connection.name: j for j, connection in enumerate(self.connections)}

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Start of each component in `State.modes`."""
        return tuple(int(x) for x in np.cumsum((0, *self.capacities[:-1])))

    @cached_property
    def driven(self) -> tuple[bool, ...]:
        """Which components are driven one way."""
        one_way = {d.component for d in self.drives}
        return tuple(name in one_way for name in self.names)

    @cached_property
    def ports(self) -> Mapping[str, tuple[str, ...]]:
        """Component -> points of it that connections or drives act on, sorted."""
        points_of: dict[str, set[str]] = {name: set() for name in self.names}
        for term in (t for c in self.connections for t in c.terms):
            points_of[term.component].add(term.point)
        for drive in self.drives:
            points_of[drive.component].add(drive.point)
        return {name: tuple(sorted(points)) for name, points in points_of.items()}

    @cached_property
    def incidence(self) -> tuple[Floats, ...]:
        """(m, n_ports) per component: share of each of its ports in each gap (of a driven one: of each force)."""
        out = [np.zeros((len(self.connections), len(self.ports[name]))) for name in self.names]
        column = {(name, point): i for name in self.names for i, point in enumerate(self.ports[name])}
        for j, connection in enumerate(self.connections):
            for term in connection.terms:
                out[self.slots[term.component]][j, column[term.component, term.point]] += term.factor
        for drive in self.drives:
            j = self.places[drive.connection]
            out[self.slots[drive.component]][j, column[drive.component, drive.point]] += drive.factor
        return tuple(out)

    @cached_property
    def touching(self) -> tuple[tuple[Indices, Floats], ...]:
        """Per component: (g,) connections that it has a share in, driven ones too, and (g, n_ports) these shares."""
        nonzero = [np.flatnonzero(np.any(a != 0.0, axis=1)) for a in self.incidence]
        return tuple((on, a[on]) for on, a in zip(nonzero, self.incidence, strict=True))

    @cached_property
    def gaps(self) -> tuple[Indices, ...]:
        """(g,) per component: connections that its ports have a share in; none for a driven one."""
        none = np.zeros(0, dtype=np.intp)
        return tuple(none if one_way else on for (on, _), one_way in zip(self.touching, self.driven, strict=True))

    @cached_property
    def force_weights(self) -> Floats:
        """(n_readouts, m) weights of the connection forces in the readouts."""
        out = np.zeros((len(self.readouts), len(self.connections)))
        for i, readout in enumerate(self.readouts):
            for name, factor in readout.forces:
                out[i, self.places[name]] += factor
        return out

    def gathered(self, shares: list[Floats]) -> Floats:
        """(m, m) sum of (g, g) matrices of the components' gaps."""
        m = len(self.connections)
        rows, columns = self.entries
        each = np.concatenate([np.zeros(0), *(share.ravel() for share in shares)])
        return np.asarray(np.bincount(rows * m + columns, each, m * m).reshape(m, m), dtype=np.float64)

    @cached_property
    def entries(self) -> tuple[Indices, Indices]:
        """Rows and columns of the entries of all components' gap matrices, one after another."""
        none = np.zeros(0, dtype=np.intp)
        rows = [none, *(np.repeat(on, len(on)) for on in self.gaps)]
        return np.concatenate(rows), np.concatenate([none, *(np.tile(on, len(on)) for on in self.gaps)])

    @cached_property
    def entry_slots(self) -> Indices:
        """Component that each of `entries` belongs to."""
        return np.repeat(np.arange(len(self.names)), [len(on) ** 2 for on in self.gaps])

    @cached_property
    def joints(self) -> tuple[Indices, Indices]:
        """Component and connection of every share of a component in a gap."""
        slots = np.repeat(np.arange(len(self.names)), [len(on) for on in self.gaps])
        return slots, np.concatenate([np.zeros(0, dtype=np.intp), *self.gaps])
