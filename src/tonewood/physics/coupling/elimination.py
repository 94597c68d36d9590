"""Forces of a system's connections under the compliance of its components, solved for when first asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.compiled import Compiled
from tonewood.physics.coupling.connections import (
    Connection,
    LinearLaws,
    LinearSolve,
    NonlinearGaps,
    NonlinearLaws,
    NonlinearSolve,
    SpringDashpot,
)
from tonewood.physics.coupling.inverse import MOST_IN_PART, Hub, InverseInParts
from tonewood.physics.coupling.layout import Layout
from tonewood.support.arrays import Floats

#: linear connections from which on their compliance is inverted in parts: below, one dense matrix is quicker
LEAST_IN_PARTS = 64


@dataclass(frozen=True, eq=False)
class GapCompliance:
    """Compliance of all components at the gaps of the connections; summed when first used."""

    compiled: tuple[Compiled, ...]
    layout: Layout
    solves: dict[LinearLaws, LinearSolve] = field(init=False, repr=False, default_factory=dict)
    _seen: dict[NonlinearLaws, NonlinearGaps] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def compliance(self) -> Floats:
        """(m, m) m/N, over one step."""
        return self.layout.gathered([c.compliance for c in self.compiled])

    @cached_property
    def residual(self) -> Floats:
        """(m, m) m/N, residual compliance."""
        return self.layout.gathered([c.residual for c in self.compiled])

    def diagonal(self, which: str) -> Floats:
        """(m,) m/N, diagonal of ``compliance`` or ``residual``."""
        each = np.concatenate([np.zeros(0), *(getattr(c, which).diagonal() for c in self.compiled)])
        m = len(self.layout.connections)
        return np.asarray(np.bincount(self.layout.joints[1], each, m), dtype=np.float64)

    def residual_among(self, places: Sequence[int]) -> Floats:
        """(k, k) m/N, residual compliance among k of the gaps."""
        index = np.full(len(self.layout.connections), -1)
        index[places] = np.arange(len(places))
        rows, columns = (index[ends] for ends in self.layout.entries)
        each = np.concatenate([np.zeros(0), *(c.residual.ravel() for c in self.compiled)])
        among = (rows >= 0) & (columns >= 0)
        out = np.zeros((len(places), len(places)))
        np.add.at(out, (rows[among], columns[among]), each[among])
        return out

    def in_parts(self, laws: LinearLaws) -> InverseInParts | None:
        """Invert the compliance of linear connections in parts; None where there are few, or no parts."""
        if (k := len(laws.on)) < LEAST_IN_PARTS:
            return None
        index = np.full(len(self.layout.connections), -1)
        index[laws.on] = np.arange(k)
        slots, connections = self.layout.joints
        met = np.bincount(slots[laws.active[connections]], minlength=len(self.compiled))
        hub = int(np.argmax(met)) if met.max(initial=0) > MOST_IN_PART else -1
        rows, columns = self.layout.entries
        others = self.layout.entry_slots != hub
        compliance, residual = (
            np.concatenate([np.zeros(0), *(getattr(c, which).ravel() for c in self.compiled)])
            for which in ("compliance", "residual")
        )
        compliance = np.where(others, compliance, 0.0)
        residual = 2 * residual * (laws.rigid[rows] & laws.rigid[columns])

        def inverted(residual: Floats, hub: Hub | None) -> InverseInParts | None:
            values = compliance + residual
            joined = laws.active[rows] & laws.active[columns] & (values != 0.0)
            entries = (
                np.concatenate([index[rows[joined]], np.arange(k)]),
                np.concatenate([index[columns[joined]], np.arange(k)]),
                np.concatenate([values[joined], laws.softness[laws.on]]),
            )
            return InverseInParts.of(k, entries, hub)

        if hub < 0:
            return inverted(residual, None)
        at = self.compiled[hub].gaps
        solution = inverted(residual, self._hub(hub, index))
        if solution is None and np.any(self.compiled[hub].residual) and np.all(laws.rigid[at[index[at] >= 0]]):
            # its residual compliance joins connections that are in parts otherwise: it goes with the hub's motions
            return inverted(np.where(others, residual, 0.0), self._hub(hub, index, yields=True))
        return solution

    def _hub(self, slot: int, index: NDArray[np.intp], *, yields: bool = False) -> Hub:
        """Motions of a component.

        index : (m,) of each connection that can carry force, -1 of the others.
        yields : its residual compliance, of which rigid connections see twice as much, is in that of the motions.
        """
        compiled = self.compiled[slot]
        gaps = np.flatnonzero(index[compiled.gaps] >= 0)
        shares, at = compiled.shares[gaps], index[compiled.gaps[gaps]]
        used = np.flatnonzero(np.any(shares != 0.0, axis=0))
        ports, span = (used, np.eye(len(used))) if yields else compiled.motions(used)
        shares = shares[:, used]
        point, factor = np.full(int(index.max()) + 1, -1), np.zeros(int(index.max()) + 1)
        if np.all(np.count_nonzero(shares, axis=1) == 1):
            point[at], factor[at] = np.argmax(shares != 0.0, axis=1), shares.sum(axis=1)
        else:  # ends that several points share: every connection has a point of its own
            point[at], factor[at], span = np.arange(len(at)), 1.0, shares @ span
        compliance = compiled.history[0][ports][:, ports].T
        if yields:
            ports_of_hub = compiled.ports[used]
            compliance = compliance + 2 * compiled.basis.residual[ports_of_hub][:, ports_of_hub]
        return Hub(slot, ports, point, factor, span, np.ascontiguousarray(compliance))

    def seen_by(self, laws: NonlinearLaws) -> NonlinearGaps:
        """Compliance at the gaps of nonlinear laws; cached, as linear laws change more often."""
        if laws not in self._seen:
            self._seen[laws] = NonlinearGaps.of(laws, self.compliance, self.residual)
        return self._seen[laws]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Connections' forces under the compliance of the components that they join; solved for when first wanted."""

    connections: tuple[Connection, ...]
    linear: LinearLaws
    others: NonlinearLaws
    gap: GapCompliance
    dt: float

    @classmethod
    def of(cls, connections: tuple[Connection, ...], gap: GapCompliance, dt: float) -> Elimination:
        """Make it of connections as they are, for a step of dt (s)."""
        laws = [c.law for c in connections]
        return cls(connections, LinearLaws.of(laws, dt), NonlinearLaws.of(laws, dt), gap, dt)

    def with_gap(self, gap: GapCompliance) -> Elimination:
        """Return the elimination of these connections between other components."""
        return Elimination(self.connections, self.linear, self.others, gap, self.dt)

    @property
    def laws_alone(self) -> Elimination:
        """Return the elimination with its laws alone, between no components."""
        return self.with_gap(GapCompliance((), self.gap.layout))

    def with_laws(self, laws: Mapping[int, Connection]) -> Elimination:
        """Other laws of connections at some places."""
        connections, new = list(self.connections), {j: connection.law for j, connection in laws.items()}
        for j, connection in laws.items():
            if connection.terms != connections[j].terms:
                raise ValueError("a connection's terms cannot change, only its law")
            connections[j] = connection
        linear, others = self.linear.changed(new, self.dt), self.others.changed(new, self.dt)
        return Elimination(tuple(connections), linear, others, self.gap, self.dt)

    @cached_property
    def solve(self) -> LinearSolve:
        """Solve of the linear connections; found once for the same laws between the same components."""
        solves = self.gap.solves
        if self.linear not in solves:
            solves.clear()
            solves[self.linear] = self._solved()
        return solves[self.linear]

    @cached_property
    def springs_in_series(self) -> Mapping[int, SpringDashpot]:
        """Place -> law of each spring whose gap has residual compliance R, in series with it.

        Where the gaps of all springs are alike, (I + R K) u = 1 gives the share u of each that its spring sees. A share
        outside (0, 1] tells that they are not alike: then R of the other gaps is left out.
        """
        laws = {j: self.connections[j].law for j in np.flatnonzero(self.linear.active & ~self.linear.rigid).tolist()}
        springs = {j: law for j, law in laws.items() if isinstance(law, SpringDashpot) and law.stiffness > 0.0}
        if not springs:
            return {}
        softened = self.gap.residual_among(list(springs)) * [law.stiffness for law in springs.values()]
        shares = np.linalg.solve(np.eye(len(springs)) + softened, np.ones(len(springs)))
        shares = np.where((shares > 0.0) & (shares <= 1.0), shares, 1 / (1 + softened.diagonal()))
        pairs = zip(springs.items(), shares.tolist(), strict=True)
        return {j: law.softened(share) for (j, law), share in pairs if share < 1.0}

    def _solved(self) -> LinearSolve:
        laws = self.linear.changed(self.springs_in_series, self.dt)
        if (by := self.gap.in_parts(laws)) is not None:
            return laws.solved(by, self.gap.diagonal("compliance"), self.gap.diagonal("residual"))
        return laws.solve(self.gap.compliance, self.gap.residual)

    @cached_property
    def nonlinear(self) -> NonlinearSolve | None:
        """Solve of the nonlinear connections, if there are any."""
        return NonlinearSolve(self.gap.seen_by(self.others), self.solve) if self.others.laws else None
