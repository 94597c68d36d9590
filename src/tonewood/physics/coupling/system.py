"""A set of components, connections and readouts, compiled to the plain arrays that a stepper needs.

The arrays are the model: immutable, and shared by the C++ kernel and its NumPy twin. `State` is the rest.
A component can be exchanged for another basis of itself (another stop, fewer modes): only its own arrays and the
small matrix of `connections.linear_solve` change.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from tonewood.physics.coupling.compiled import BLOCK_SIZE, PADDING, Compiled, Injection, PrescribedMotion, State
from tonewood.physics.coupling.connections import Connection, LinearSolve, NonlinearSolve, Term
from tonewood.physics.coupling.elimination import Elimination, GapCompliance
from tonewood.physics.coupling.layout import Drive, Layout, Readout
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.user import ModalPotential
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply, flow, powers, real_form
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

    potentials : energies beside those of the modes, of any kinds.
    on : which of them act.
    """

    dt: float
    layout: Layout
    compiled: tuple[Compiled, ...]
    connections: tuple[Connection, ...]
    elimination: Elimination
    potentials: tuple[Potential, ...] = ()
    on: tuple[bool, ...] = ()

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
        potentials: Sequence[Potential] = (),
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
        known = {c.name for c in connections}
        if len(known) != len(connections):
            raise ValueError("two connections have the same name")
        wanted = [d.connection for d in drives] + [name for r in readouts for name, _ in r.forces]
        for name in wanted:
            if name not in known:
                raise ValueError(f"no connection {name!r}")
        for probe in (p for r in readouts for p in r.probes):
            if probe.component not in components:
                raise ValueError(f"no component {probe.component!r} to read")
        _check_potentials(potentials, components, driven)
        names, joined = tuple(components), tuple(connections)
        room = tuple(_padded(max(components[n].n_modes, (capacities or {}).get(n, 0))) for n in names)
        layout = Layout(names, room, joined, tuple(readouts), tuple(drives), dict(owners or {}))
        system = cls(
            dt=dt,
            layout=layout,
            compiled=(),
            connections=joined,
            elimination=Elimination.of(joined, GapCompliance((), layout), dt),
            potentials=tuple(potentials),
            on=(True,) * len(potentials),
        )
        return system.with_compiled({name: system.compile(name, components[name]) for name in names})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        return self.layout.names

    @property
    def capacities(self) -> tuple[int, ...]:
        """Modes that the state has room for, one per component."""
        return self.layout.capacities

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

    def ports_of(self, name: str) -> list[str]:
        """Points of a component that connections or drives act on, sorted; the same whatever its basis."""
        return list(self.layout.ports[name])

    def compile(self, name: str, basis: ModalBasis, *, like: Compiled | None = None) -> Compiled:
        """Compile another basis of the component `name`; it may be kept and used again with `with_compiled`.

        Where the basis has the very poles of `like`, which was compiled before, the propagator is taken from there.
        """
        slot = self.slot(name)
        ports = np.array([basis.index(p) for p in self.layout.ports[name]], dtype=np.intp)
        if like is not None and like.basis.poles is basis.poles:
            E, held, form = like.E, like.held, real_form(basis, like.form.A)
        else:
            E, held = flow(basis, self.dt)
            held *= self.dt
            form = real_form(basis)
        W = apply(held, form.B[ports])
        rows, readouts, difference = [form.C[ports]], [], []
        for channel, readout in enumerate(self.readouts):
            probes = [p for p in readout.probes if p.component == name]
            if not probes:
                continue
            index = np.array([basis.index(p.point) for p in probes], dtype=np.intp)
            mean = readout.quantity == "acceleration"
            motion = form.rows("velocity" if mean else readout.quantity, index)
            factor = np.array([p.factor for p in probes]) / (self.dt if mean else 1.0)
            rows.append(np.einsum("p,pmx->mx", factor, motion)[None])
            readouts.append(channel)
            difference.append(mean)
        all_rows = np.concatenate(rows)
        numbers = 2 * basis.n_modes
        after = powers(E, W, BLOCK_SIZE).reshape(BLOCK_SIZE * len(ports), numbers)
        history = (after @ all_rows.reshape(len(all_rows), numbers).T).reshape(BLOCK_SIZE, len(ports), len(all_rows))
        gaps = self.layout.gaps[slot]
        a = self.layout.incidence[slot][gaps]
        compliance = a @ history[0, :, : len(ports)].T @ a.T
        residual = a @ basis.residual[ports][:, ports] @ a.T
        potentials = [p for p in self.potentials if name in p.components]
        if potentials and not basis.is_real:
            raise ValueError(f"{potentials[0].name}: the modes of {name} must be real")
        return Compiled(
            basis, self.dt, form, ports, E, held, W, all_rows, history,
            np.array(readouts, dtype=np.intp), np.array(difference, dtype=bool), gaps, a, compliance, residual,
            {p.name: p.share(name, basis, self.dt) for p in potentials},
        )  # fmt: skip

    def with_compiled(self, changes: Mapping[str, Compiled]) -> System:
        """Exchange components for already compiled bases of themselves."""
        for name, new in changes.items():
            if new.basis.n_modes > (room := self.capacities[self.slot(name)]):
                raise ValueError(f"{name}: room for {room} modes, not {new.basis.n_modes}")
        known = dict(zip(self.names, self.compiled, strict=False)) | dict(changes)
        compiled = tuple(known[name] for name in self.names)
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
        return System(self.dt, self.layout, compiled, elimination.connections, elimination, self.potentials, self.on)

    def gaps(self, states: Sequence[Floats]) -> Floats:
        """(m,) m, gaps of all connections at states (n_modes, 2) by component slot, residual compliance at rest."""
        total = np.zeros(len(self.connections))
        for i, c in enumerate(self.compiled):
            if not self.driven[i]:
                total += self.incidence(i) @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], states[i])
        return total

    def with_potentials(self, names: Collection[str], among: Collection[str] | None = None) -> System:
        """Switch on the potentials of these names, and off all others; of those `among` these names, if given.

        While a string's coupling to its longitudinal motion is off, that motion is stepped on its own. The energy that
        a potential stores appears or vanishes with it: switch where it is small, or book it.
        """
        known = [p.name for p in self.potentials]
        if unknown := set(names) - set(known):
            raise ValueError(f"no potential {sorted(unknown)}; there are {known}")
        kept = known if among is None else among
        pairs = zip(known, self.on, strict=True)
        on = tuple(name in names if name in kept else is_on for name, is_on in pairs)
        return self if on == self.on else replace(self, on=on)

    @property
    def resets(self) -> bool:
        """Whether a potential acts whose psi is put back every 64 steps."""
        return any(on and not p.one_way for p, on in zip(self.potentials, self.on, strict=True))

    @property
    def memory(self) -> tuple[slice, ...]:
        """Place of each potential's numbers in `State.potentials`."""
        ends = np.cumsum([0, *(p.memory for p in self.potentials)]).tolist()
        return tuple(slice(*pair) for pair in pairwise(ends))

    def joined(self, index: int) -> Any:
        """Return a potential as it is stepped: `Potential.join` of its components' shares."""
        potential = self.potentials[index]
        parts = [self.compiled[self.slot(name)] for name in potential.components]
        shares = tuple(part.potentials[potential.name] for part in parts)
        return parts[0].joined(potential.name, shares, potential.join)

    def potential(self, name: str) -> int:
        """Index of a potential."""
        return next(i for i, p in enumerate(self.potentials) if p.name == name)

    @property
    def offsets(self) -> tuple[int, ...]:
        """Start of each component in `State.modes`."""
        return self.layout.offsets

    @property
    def driven(self) -> tuple[bool, ...]:
        """Which components are driven one way."""
        return self.layout.driven

    @property
    def owners(self) -> Mapping[str, str]:
        """Component -> string that it belongs to, of those that belong to one."""
        return self.layout.owners

    def slot(self, name: str) -> int:
        """Index of a component."""
        return self.layout.slots[name]

    def modes_of(self, state: State, name: str) -> Floats:
        """(2, n_modes) view of one component's modes in a state."""
        i = self.slot(name)
        start = self.offsets[i]
        return state.modes[:, start : start + self.compiled[i].basis.n_modes]

    def start(self) -> State:
        """Return the state of rest."""
        m = len(self.connections)
        modes = np.zeros((2, sum(self.capacities)))
        return State(modes, np.zeros(m), 0, np.zeros(m), np.zeros(m), self.kept_memory(np.zeros(0)))

    def kept_memory(self, memory: Floats) -> Floats:
        """Numbers of the potentials: those given if they are of this system, zero where a potential is off."""
        places = self.memory
        size = places[-1].stop if places else 0
        memory = memory if memory.size == size else np.zeros(size)
        for place, on in zip(places, self.on, strict=True):
            if not on:
                memory[place] = 0.0
        return memory

    def check_potentials(self, state: State) -> None:
        """Check that potentials of one's own are bounded from below in the motion so far.

        Raises TonewoodError : the V of one has fallen below its `least`; one line.
        """
        for index in self._own_potentials:
            if self.on[index]:
                self.joined(index).check_state(state.potentials[self.memory[index]])

    @cached_property
    def _own_potentials(self) -> tuple[int, ...]:
        return tuple(i for i, p in enumerate(self.potentials) if isinstance(p, ModalPotential))

    def controlled(self, controls: Sequence[PrescribedMotion], start: int, n: int) -> dict[int, Floats]:
        """(4, n) offset at the beginning and the end of each step, velocity and scale, of controlled connections.

        Returns Place among `nonlinear` -> array, for the connections that `controls` touch in the n steps from `start`.
        """
        out: dict[int, Floats] = {}
        for control in controls:
            first, last = max(control.start, start), min(control.stop, start + n)
            if first >= last:
                continue
            j = self._nonlinear_place(control.connection)
            if j not in out:
                law = self.nonlinear.laws[j] if self.nonlinear else None
                still = law.velocity if law else 0.0
                out[j] = np.repeat([[law.offset if law else 0.0]] * 2 + [[still], [1.0]], n, axis=1)
            here, there = slice(first - start, last - start), slice(first - control.start, last - control.start)
            if control.offset is not None:
                out[j][0, here], out[j][1, here] = control.offset[:-1][there], control.offset[1:][there]
            if control.velocity is not None:
                out[j][2, here] = control.velocity[there]
            if control.scale is not None:
                out[j][3, here] = control.scale[there]
        return out

    def _nonlinear_place(self, connection: str) -> int:
        names = [self.connections[i].name for i in self.nonlinear.index] if self.nonlinear else []
        if connection not in names:
            raise ValueError(f"no nonlinear connection {connection!r} to control")
        return names.index(connection)

    def incidence(self, slot: int) -> Floats:
        """(m, n_ports) share of each port of a component in each gap (for a driven one: of each force in a port)."""
        return self.layout.incidence[slot]

    def force_weights(self) -> Floats:
        """(n_readouts, m) weights of the connection forces in the readouts."""
        return self.layout.force_weights

    def gap_matrix(self, which: str) -> Floats:
        """(m, m) m/N, ``compliance`` or ``residual`` of all components as the gaps see it."""
        gap = self.elimination.gap
        return gap.compliance if which == "compliance" else gap.residual


def _check_potentials(potentials: Sequence[Potential], components: Collection[str], driven: Collection[str]) -> None:
    """Refuse potentials of equal names, on components that are missing, driven one way, or of another potential."""
    if len({p.name for p in potentials}) != len(potentials):
        raise ValueError("two potentials have the same name")
    own = [name for p in potentials for name in p.components]
    for p in potentials:
        for name in (*p.components, *p.targets):
            if name not in components or name in driven or own.count(name) > (name in p.components):
                raise ValueError(f"{p.name}: a potential needs two-way components of its own, not {name!r}")


def _padded(n: int) -> int:
    return -(-max(n, 1) // PADDING) * PADDING
