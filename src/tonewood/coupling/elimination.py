"""Forces of a system's connections under the compliance of its components, solved for when first asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.compiled import Compiled
from tonewood.coupling.connections import (
    Connection,
    LinearLaws,
    LinearSolve,
    NonlinearGaps,
    NonlinearLaws,
    NonlinearSolve,
)
from tonewood.coupling.layout import Layout

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GapCompliance:
    """Compliance of all components at the gaps of the connections; summed when first used."""

    compiled: tuple[Compiled, ...]
    layout: Layout
    _seen: dict[NonlinearLaws, NonlinearGaps] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def compliance(self) -> Floats:
        """(m, m) m/N, over one step."""
        return self.layout.gathered([c.compliance for c in self.compiled])

    @cached_property
    def residual(self) -> Floats:
        """(m, m) m/N, residual compliance."""
        return self.layout.gathered([c.residual for c in self.compiled])

    def seen_by(self, laws: NonlinearLaws) -> NonlinearGaps:
        """Compliance at the gaps of nonlinear laws; cached, as linear laws change more often."""
        if laws not in self._seen:
            self._seen[laws] = NonlinearGaps.of(laws, self.compliance, self.residual)
        return self._seen[laws]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Connections' forces under the compliance of what they join; solved for when first wanted."""

    connections: tuple[Connection, ...]
    linear: LinearLaws
    others: NonlinearLaws
    gap: GapCompliance
    dt: float

    @classmethod
    def of(cls, connections: tuple[Connection, ...], gap: GapCompliance, dt: float) -> Elimination:
        """Of connections as they are, for a step of dt (s)."""
        laws = [c.law for c in connections]
        return cls(connections, LinearLaws.of(laws, dt), NonlinearLaws.of(laws, dt), gap, dt)

    def with_gap(self, gap: GapCompliance) -> Elimination:
        """These connections between other components."""
        return Elimination(self.connections, self.linear, self.others, gap, self.dt)

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
        """Of the linear connections."""
        return self.linear.solve(self.gap.compliance, self.gap.residual)

    @cached_property
    def nonlinear(self) -> NonlinearSolve | None:
        """Of the others, if there are any."""
        return NonlinearSolve(self.gap.seen_by(self.others), self.solve) if self.others.laws else None
