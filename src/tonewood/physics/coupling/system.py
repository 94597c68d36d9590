"""A set of components, connections and readouts, compiled to the plain arrays that a stepper needs.

The arrays are the model: immutable, and shared by the C++ kernel and its NumPy twin. `State` is the rest.
A component can be exchanged for another basis of itself (another stop, fewer modes): only its own arrays and the
small matrix of `connections.LinearLaws.solve` change.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tonewood.physics.coupling.compiled import BLOCK_SIZE, PADDING, Compiled, Injection, PrescribedMotion, State
from tonewood.physics.coupling.connections import Connection, LinearSolve, NonlinearSolve, Term
from tonewood.physics.coupling.elimination import Elimination, GapCompliance
from tonewood.physics.coupling.layout import Drive, Layout, Readout
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.switched import Potentials
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

__all__ = [
    "BLOCK_SIZE",
    "PADDING",
    "Compiled",
    "Drive",
    "Injection",
    "PrescribedMotion",
    "Readout",
    "State",
    "System",
    "Term",
]


@dataclass(frozen=True, eq=False)
class System:
    """Components, connections and readouts at one step length.

    Build with `System.build`; exchange a component with `with_basis`, connections' laws with `with_laws`, and switch
    potentials with `with_potentials`.

    potentials : energies beside those of the modes, and which of them act.
    """

    dt: float
    layout: Layout
    compiled: tuple[Compiled, ...]
    connections: tuple[Connection, ...]
    elimination: Elimination
    potentials: Potentials

    def __repr__(self) -> str:
        modes = sum(c.basis.n_modes for c in self.compiled)
        return (
            f"System({len(self.compiled)} components, {modes} modes, {len(self.connections)} connections, "
            f"{1 / self.dt:g} Hz)"
        )

    @classmethod
    def build(
        cls,
        components: Mapping[str, ModalBasis],
        connections: Sequence[Connection] = (),
        readouts: Sequence[Readout] = (),
        *,
        dt: float,
        drives: Sequence[Drive] = (),
        capacities: Mapping[str, int] | None = None,
        potentials: Iterable[Potential] = (),
        owners: Mapping[str, str] | None = None,
    ) -> System:
        """Compile.

        components : name -> basis. One that `drives` name is driven one way: no connection may act on it.
        capacities : name -> modes to leave room for, where a component may later take a larger basis.
        potentials : energies beside those of the modes; all are on.
        owners : component -> string that it belongs to, of those that belong to one.
        Raises ValueError : a connection, probe, drive or potential names a component, point or connection that is not
            there.
        """
        if not dt > 0:
            raise ValueError(f"a step is longer than {dt} s")
        driven = {d.component for d in drives}
        for connection in connections:
            for term in connection.terms:
                if term.component not in components:
                    raise ValueError(f"connection {connection.name!r}: no component {term.component!r}")
                if term.component in driven:
                    raise ValueError(f"connection {connection.name!r}: {term.component!r} is driven one way")
        there = {c.name for c in connections}
        if len(there) != len(connections):
            raise ValueError("two connections have the same name")
        for name in [d.connection for d in drives] + [name for r in readouts for name, _ in r.forces]:
            if name not in there:
                raise ValueError(f"no connection {name!r}")
        for probe in (p for r in readouts for p in r.probes):
            if probe.component not in components:
                raise ValueError(f"no component {probe.component!r} to read")
        names, joined = tuple(components), tuple(connections)
        room = tuple(_padded(max(components[n].n_modes, (capacities or {}).get(n, 0))) for n in names)
        layout = Layout(names, room, joined, tuple(readouts), tuple(drives), dict(owners or {}))
        system = cls(
            dt=dt,
            layout=layout,
            compiled=(),
            connections=joined,
            elimination=Elimination.of(joined, GapCompliance((), layout), dt),
            potentials=Potentials.of(potentials, components, driven),
        )
        return system.with_compiled({name: system.compile(name, components[name]) for name in names})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        return self.layout.names

    @property
    def readouts(self) -> tuple[Readout, ...]:
        """Readouts, one channel each."""
        return self.layout.readouts

    @property
    def drives(self) -> tuple[Drive, ...]:
        """One-way inputs."""
        return self.layout.drives

    @property
    def solve(self) -> LinearSolve:
        """Forces of the linear connections."""
        return self.elimination.solve

    @property
    def nonlinear(self) -> NonlinearSolve | None:
        """Elimination for the nonlinear connections; None if there are none."""
        return self.elimination.nonlinear

    def compile(self, name: str, basis: ModalBasis, *, like: Compiled | None = None) -> Compiled:
        """Compile another basis of the component `name`; it may be kept and used again with `with_compiled`.

        Where the basis has the very poles of `like`, which was compiled before, the propagator is taken from there.
        """
        return Compiled.of(name, basis, self.layout, self.dt, self.potentials, like)

    def with_compiled(self, changes: Mapping[str, Compiled]) -> System:
        """Exchange components for already compiled bases of themselves."""
        for name, new in changes.items():
            if new.basis.n_modes > (room := self.layout.capacities[self.slot(name)]):
                raise ValueError(f"{name}: room for {room} modes, not {new.basis.n_modes}")
        components = dict(zip(self.names, self.compiled, strict=False)) | dict(changes)
        compiled = tuple(components[name] for name in self.names)
        return self._with(compiled, self.elimination.with_gap(GapCompliance(compiled, self.layout)))

    def with_basis(self, name: str, basis: ModalBasis) -> System:
        """Exchange one component's basis."""
        return self.with_compiled({name: self.compile(name, basis)})

    def with_laws(self, laws: Mapping[str, Connection]) -> System:
        """Exchange laws of connections (their terms must stay)."""
        places = self.layout.places
        changes = {places[name]: new for name, new in laws.items() if name in places}
        return self._with(self.compiled, self.elimination.with_laws(changes))

    def with_laws_of(self, other: Elimination) -> System:
        """Take over all laws from another elimination of the same connections."""
        return self._with(self.compiled, other.with_gap(self.elimination.gap))

    def _with(self, compiled: tuple[Compiled, ...], elimination: Elimination) -> System:
        # the same as `replace`, but quicker; several of these are made for every note
        return System(self.dt, self.layout, compiled, elimination.connections, elimination, self.potentials)

    def gaps(self, states: Sequence[Floats]) -> Floats:
        """(m,) m, gaps of all connections at states (n_modes, 2) by component slot, residual compliance at rest."""
        total = np.zeros(len(self.connections))
        for i, c in enumerate(self.compiled):
            if not self.layout.driven[i]:
                total += self.layout.incidence[i] @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], states[i])
        return total

    def with_potentials(self, names: Collection[str], among: Collection[str] | None = None) -> System:
        """Switch on the potentials of these names, and off all others; of those `among` these names, if given.

        While a string's coupling to its longitudinal motion is off, that motion is stepped on its own. The energy that
        a potential stores appears or vanishes with it: switch where it is small, or book it.
        """
        potentials = self.potentials.switched(names, among)
        return self if potentials is self.potentials else replace(self, potentials=potentials)

    def joined(self, index: int) -> Any:
        """Return a potential as it is stepped: `Potential.join` of its components' shares."""
        potential = self.potentials[index]
        parts = [self.compiled[self.slot(name)] for name in potential.components]
        shares = tuple(part.potentials[potential.name] for part in parts)
        return parts[0].joined(potential.name, shares, potential.join)

    def slot(self, name: str) -> int:
        """Index of a component."""
        return self.layout.slots[name]

    def room_of(self, state: State, name: str) -> Floats:
        """(2, capacity) view of all that a state holds of one component."""
        start = self.layout.offsets[(i := self.slot(name))]
        return state.modes[:, start : start + self.layout.capacities[i]]

    def modes_of(self, state: State, name: str) -> Floats:
        """(2, n_modes) view of one component's modes in a state."""
        return self.room_of(state, name)[:, : self.compiled[self.slot(name)].basis.n_modes]

    def start(self) -> State:
        """Return the state of rest."""
        m = len(self.connections)
        modes = np.zeros((2, sum(self.layout.capacities)))
        return State(modes, np.zeros(m), 0, np.zeros(m), np.zeros(m), self.potentials.checked(np.zeros(0)))

    def check_potentials(self, state: State) -> None:
        """Check that potentials of one's own are bounded from below in the motion so far.

        Raises TonewoodError : the V of one has fallen below its `least`; one line.
        """
        for index in self.potentials.user:
            self.joined(index).check_state(state.potentials[self.potentials.memory[index]])


def _padded(n: int) -> int:
    return -(-max(n, 1) // PADDING) * PADDING
