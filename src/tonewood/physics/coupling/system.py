"""A set of components, connections and readouts, compiled to the plain arrays that a stepper needs.

The arrays are the model: immutable, and shared by the C++ kernel and its NumPy twin. `State` is the rest.
A component can be exchanged for another basis of itself (another stop, fewer modes): only its own arrays and the
small matrix of `connections.linear_solve` change.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.compiled import BLOCK_SIZE, PADDING, Compiled, Injection, PrescribedMotion, State
from tonewood.physics.coupling.connections import Connection, LinearSolve, NonlinearSolve, Term
from tonewood.physics.coupling.elimination import Elimination, GapCompliance
from tonewood.physics.coupling.geometric import GeometricStretch
from tonewood.physics.coupling.laws import Friction
from tonewood.physics.coupling.layout import Drive, Layout, Readout
from tonewood.physics.coupling.phantoms import MEMORY, DrivenLongitudinal
from tonewood.physics.coupling.tension import TensionModulation
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply, flow, powers, real_form

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

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class System:
    """Components, connections and readouts at one step length.

    Build with `System.build`; exchange a component with `with_basis`, connections' laws with `with_laws`, and switch
    tensions with `with_tensions`.
    """

    dt: float
    layout: Layout
    compiled: tuple[Compiled, ...]
    connections: tuple[Connection, ...]
    elimination: Elimination
    tensions: tuple[TensionModulation, ...] = ()
    stretches: tuple[GeometricStretch, ...] = ()
    is_on: tuple[bool, ...] = ()
    phantoms: tuple[DrivenLongitudinal, ...] = ()
    phantoms_on: tuple[bool, ...] = ()

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
        tensions: Sequence[TensionModulation] = (),
        geometric: Sequence[GeometricStretch] = (),
        owners: Mapping[str, str] | None = None,
        phantoms: Sequence[DrivenLongitudinal] = (),
    ) -> System:
        """Compile.

        Parameters
        ----------
        components : name -> basis. One that `drives` name is driven one way: no connection may act on it.
        capacities : name -> modes to leave room for, where a component may later take a larger basis.
        tensions : strings whose tension rises with their amplitude; all are on.
        geometric : strings whose longitudinal motion is coupled to the transverse one; all are on.
        owners : component -> string that it belongs to, of those that belong to one.
        phantoms : strings whose longitudinal motion is driven one way; all are on.

        Raises
        ------
        ValueError : a connection, probe, drive or tension names a component, point or connection that is not there.
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
        stretched = [name for t in tensions for name in t.components] + [name for g in geometric for name in g.parts]
        for name in stretched:
            if name not in components or name in driven or stretched.count(name) > 1:
                raise ValueError(f"a tension needs two-way components of its own, not {name!r}")
        for phantom in phantoms:
            for name in (*phantom.components, *(name for name, _, _ in phantom.onto)):
                if name not in components or name in driven or name in stretched:
                    raise ValueError(f"{phantom.name}: its longitudinal motion cannot go with {name!r}")
        if tensions and geometric:
            both = f"{tensions[0].name} and {geometric[0].name}"
            raise ValueError(f"{both}: where a string has longitudinal motion, all rising tensions go into `geometric`")
        names, joined = tuple(components), tuple(connections)
        room = tuple(_padded(max(components[n].n_modes, (capacities or {}).get(n, 0))) for n in names)
        layout = Layout(names, room, joined, tuple(readouts), tuple(drives), dict(owners or {}))
        system = cls(
            dt=dt,
            layout=layout,
            compiled=(),
            connections=joined,
            elimination=Elimination.of(joined, GapCompliance((), layout), dt),
            tensions=tuple(tensions),
            stretches=tuple(geometric),
            is_on=(True,) * len(tensions or geometric),
            phantoms=tuple(phantoms),
            phantoms_on=(True,) * len(phantoms),
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
        tension = next((t.part(name, basis, self.dt, held) for t in self.tensions if name in t.components), None)
        geometric = next((g.part(name, basis, held) for g in self.stretches if name in g.parts), None)
        phantom = next((p.part(name, basis, self.dt) for p in self.phantoms if name in p.components), None)
        return Compiled(
            basis, self.dt, form, ports, E, held, W, all_rows, history,
            np.array(readouts, dtype=np.intp), np.array(difference, dtype=bool), gaps, a, compliance, residual, tension,
            geometric, phantom,
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
        return System(
            self.dt, self.layout, compiled, elimination.connections, elimination, self.tensions, self.stretches,
            self.is_on, self.phantoms, self.phantoms_on,
        )  # fmt: skip

    def gaps(self, states: Sequence[Floats]) -> Floats:
        """(m,) m, gaps of all connections at states (n_modes, 2) by component slot, residual compliance at rest."""
        total = np.zeros(len(self.connections))
        for i, c in enumerate(self.compiled):
            if not self.driven[i]:
                total += self.incidence(i) @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], states[i])
        return total

    def with_tensions(self, names: Collection[str]) -> System:
        """Switch on the tensions of these names, and off all others.

        A string with longitudinal motion is then linear, too: its longitudinal motion is stepped, but no longer coupled
        to the transverse one. The stored energy, EA/(8 L) S^2 without longitudinal motion, appears or vanishes with the
        coupling: switch where it is small, or book it.
        """
        known = [t.name for t in self.rising]
        if unknown := set(names) - set(known):
            raise ValueError(f"no tension {sorted(unknown)}; there are {known}")
        return replace(self, is_on=tuple(name in names for name in known))

    def with_phantoms(self, names: Collection[str]) -> System:
        """Switch on the longitudinal forces of these strings, and off all others."""
        return replace(self, phantoms_on=tuple(p.name in names for p in self.phantoms))

    @property
    def rising(self) -> tuple[TensionModulation | GeometricStretch, ...]:
        """Strings whose tension rises while it is on: all of one kind."""
        return self.tensions or self.stretches

    @property
    def tension_on(self) -> tuple[bool, ...]:
        """Which of `tensions` are on."""
        return self.is_on if self.tensions else ()

    @property
    def geometric(self) -> tuple[GeometricStretch, ...]:
        """Strings whose longitudinal motion is coupled to the transverse one, and on."""
        return () if self.tensions else tuple(s for s, on in zip(self.stretches, self.is_on, strict=True) if on)

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
        return State(
            modes, np.zeros(m), 0, np.zeros(m), np.zeros(m), np.zeros((len(self.rising), 4)),
            np.zeros((len(self.phantoms), MEMORY)),
        )  # fmt: skip

    def controlled(self, controls: Sequence[PrescribedMotion], start: int, n: int) -> dict[int, Floats]:
        """(4, n) offset at the beginning and the end of each step, velocity and scale, of controlled connections.

        Returns
        -------
        Place among `nonlinear` -> array, for the connections that `controls` touch in the n steps from `start`.
        """
        out: dict[int, Floats] = {}
        for control in controls:
            first, last = max(control.start, start), min(control.stop, start + n)
            if first >= last:
                continue
            j = self._nonlinear_place(control.connection)
            if j not in out:
                law = self.nonlinear.laws[j] if self.nonlinear else None
                still = law.velocity if isinstance(law, Friction) else 0.0
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


def _padded(n: int) -> int:
    return -(-max(n, 1) // PADDING) * PADDING
