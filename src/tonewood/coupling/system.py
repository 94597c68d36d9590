"""A set of components, connections and readouts, compiled to the plain arrays that a stepper needs.

The arrays are the model: immutable, and shared by the C++ kernel and its NumPy twin. What moves is `State`.
A component can be exchanged for another basis of itself (another stop, fewer modes): only its own arrays and the
small matrix of `connections.linear_solve` change.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.connections import (
    Connection,
    LinearLaws,
    LinearSolve,
    NonlinearGaps,
    NonlinearLaws,
    NonlinearSolve,
)
from tonewood.coupling.geometric import GeometricPart, GeometricStretch
from tonewood.coupling.laws import Friction
from tonewood.coupling.layout import Drive, Layout, Probe, Readout
from tonewood.coupling.tension import TensionModulation, TensionPart
from tonewood.modal.modes import ModalBasis
from tonewood.modal.propagator import RealForm, apply, flow, impulse_series, powers, real_form

__all__ = [
    "BLOCK_SIZE",
    "PADDING",
    "Compiled",
    "Control",
    "Drive",
    "Injection",
    "Probe",
    "Readout",
    "State",
    "System",
]

Floats = NDArray[np.float64]

#: samples that the kernel steps at a time: the reach of `Compiled.history`
BLOCK_SIZE = 16
#: modes of a component are padded to a multiple of this in the state
PADDING = 16


@dataclass(frozen=True, eq=False)
class Compiled:
    """One component ready to be stepped by dt.

    Attributes
    ----------
    basis : the modes.
    dt : s, step.
    form : their real 2 x 2 blocks.
    ports : (n_ports,) rows of `basis.points` that connections act on, in order of their names.
    E : (n_modes, 2, 2) propagator of one step.
    W : (n_ports, n_modes, 2) state added by a unit force held over one step.
    rows : (n_rows, n_modes, 2) displacement rows of the ports, then the readouts' rows.
    history : (BLOCK_SIZE, n_ports, n_rows) response of every row k steps after a unit force held over one step;
        history[0, :, :n_ports] is the port compliance Z.
    readouts : (n_rows - n_ports,) channel that each further row adds to.
    difference : (n_rows - n_ports,) whether the row is read as (y(t + h) - y(t)) / h.
    gaps : (g,) connections that its ports have a share in; none for a driven component.
    shares : (g, n_ports) these shares.
    compliance, residual : (g, g) m/N, its share of these gaps' compliance over one step, and of their residual
        compliance.
    tension : its share of a tension, if it belongs to one.
    geometric : its share of a string whose longitudinal motion is stepped, likewise.
    """

    basis: ModalBasis
    dt: float
    form: RealForm
    ports: NDArray[np.intp]
    E: Floats
    W: Floats
    rows: Floats
    history: Floats
    readouts: NDArray[np.intp]
    difference: NDArray[np.bool_]
    gaps: NDArray[np.intp]
    shares: Floats
    compliance: Floats
    residual: Floats
    tension: TensionPart | None = None
    geometric: GeometricPart | None = None
    _impulses: dict[str, Floats] = field(init=False, repr=False, default_factory=dict)

    def impulses(self, point: str) -> Floats:
        """`propagator.impulse_series` of a named point, kept for use again."""
        if point not in self._impulses:
            self._impulses[point] = impulse_series(self.basis, self.form, self.basis.index(point), self.dt)
        return self._impulses[point]

    @cached_property
    def gap_velocity(self) -> Floats:
        """(g, 2 n_modes) what its modes' numbers, (2, n_modes), add to the velocities of its gaps."""
        rows = self.form.rows("velocity", self.ports).swapaxes(1, 2)
        return np.asarray(self.shares @ rows.reshape(len(self.ports), 2 * self.basis.n_modes))

    @cached_property
    def gap_push(self) -> Floats:
        """(g, 2 n_modes) what an impulse of 1 N s across each gap adds to these numbers."""
        B = self.form.B[self.ports].swapaxes(1, 2)
        return np.asarray(self.shares @ B.reshape(len(self.ports), 2 * self.basis.n_modes))

    @cached_property
    def gap_mobility(self) -> Floats:
        """(g, g) m/s of each gap (first index) per impulse of 1 N s across another."""
        return np.asarray(self.gap_velocity @ self.gap_push.T)


@dataclass(eq=False)
class State:
    """All that moves: plain arrays, owned by whoever steps.

    Attributes
    ----------
    modes : (2, capacity) the two numbers of every mode, component after component, padded.
    forces : (m,) N, connection forces of the step before.
    sample : steps taken since time 0.
    series : (m,) m, displacement of the residual compliance in series with nonlinear connections; empty is rest.
    slip : (m,) m/s, relative velocity of friction connections over the step before, 0 when sticking; empty is rest.
    tension : (n_tensions, 3) N, mean additional tension of the last three steps, latest first; empty is rest.
    """

    modes: Floats
    forces: Floats
    sample: int = 0
    series: Floats = field(default_factory=lambda: np.zeros(0))
    slip: Floats = field(default_factory=lambda: np.zeros(0))
    tension: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def copy(self) -> State:
        """Return an independent copy."""
        return State(
            self.modes.copy(),
            self.forces.copy(),
            self.sample,
            self.series.copy(),
            self.slip.copy(),
            self.tension.copy(),
        )

    def restore(self, other: State) -> None:
        """Take over all of another state."""
        self.modes[:], self.forces[:], self.sample = other.modes, other.forces, other.sample
        self.series, self.slip, self.tension = other.series.copy(), other.slip.copy(), other.tension.copy()


@dataclass(frozen=True, eq=False)
class Injection:
    """A known force, compiled: x_u(n) += sum_k vectors[k] values[k, n - start] for the modes of one component.

    Attributes
    ----------
    component : its name.
    start : absolute sample of the first step it acts in.
    vectors : (n_vectors, n_modes, 2).
    values : (n_vectors, n_steps).
    """

    component: str
    start: int
    vectors: Floats
    values: Floats

    @property
    def stop(self) -> int:
        """Absolute sample after the last step it acts in."""
        return self.start + int(self.values.shape[1])


@dataclass(frozen=True, eq=False)
class Control:
    """Moves or scales a nonlinear connection's partner sample by sample, in place of its law's constants.

    What it does to the partner is work from outside: only f (g+ - g) is balanced by the law.

    Attributes
    ----------
    connection : its name.
    start : absolute sample of the first step it acts in.
    offset : (n_steps + 1,) m, gap of zero compression at the beginning of each step and the end of the last.
    velocity : (n_steps,) m/s, of the partner in a `Friction`, mean over each step.
    scale : (n_steps,) factor, not negative, on the force of the law: a bow's pressure, a finger's weight.
    """

    connection: str
    start: int
    offset: Floats | None = None
    velocity: Floats | None = None
    scale: Floats | None = None

    def __post_init__(self) -> None:
        lengths = {len(a) for a in (self.velocity, self.scale) if a is not None}
        lengths |= {len(self.offset) - 1} if self.offset is not None else set()
        if len(lengths) != 1 or min(lengths) < 0:
            raise ValueError(f"a control of {self.connection!r} needs arrays of one number of steps")
        if self.scale is not None and not np.all(self.scale >= 0.0):
            raise ValueError(f"a control of {self.connection!r} has a negative scale")

    @property
    def stop(self) -> int:
        """Absolute sample after the last step it acts in."""
        for array, extra in ((self.velocity, 0), (self.scale, 0), (self.offset, 1)):
            if array is not None:
                return self.start + len(array) - extra
        return self.start


@dataclass(frozen=True, eq=False)
class GapCompliance:
    """What all components together give way by, as the gaps of the connections see it; summed when first wanted."""

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
        """What the gaps of nonlinear laws give way by; kept, as linear laws change more often than these."""
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
        """The same connections between other components."""
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
    ) -> System:
        """Compile.

        Parameters
        ----------
        components : name -> basis. One that `drives` name is driven one way: no connection may act on it.
        capacities : name -> modes to leave room for, where a component may later take a larger basis.
        tensions : strings whose tension rises with their amplitude; all are on.
        geometric : strings whose longitudinal motion is coupled to the transverse one; all are on.
        owners : component -> string that it belongs to, of those that belong to one.

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
        if tensions and geometric:
            both = f"{tensions[0].name} and {geometric[0].name}"
            raise ValueError(f"{both}: where a string moves along itself, all rising tensions go into `geometric`")
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
        )
        return system.with_compiled({name: system.compile(name, components[name]) for name in names})

    @property
    def names(self) -> tuple[str, ...]:
        """Of the components."""
        return self.layout.names

    @property
    def capacities(self) -> tuple[int, ...]:
        """Modes that the state has room for, one per component."""
        return self.layout.capacities

    @property
    def readouts(self) -> tuple[Readout, ...]:
        """What is read, one channel each."""
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
        """What nonlinear connections see; None if there are none."""
        return self.elimination.nonlinear

    def ports_of(self, name: str) -> list[str]:
        """Points of a component that connections or drives act on, sorted; the same whatever its basis."""
        return list(self.layout.ports[name])

    def compile(self, name: str, basis: ModalBasis) -> Compiled:
        """Compile another basis of the component `name`; it may be kept and used again with `with_compiled`."""
        slot = self.slot(name)
        ports = np.array([basis.index(p) for p in self.layout.ports[name]], dtype=np.intp)
        form = real_form(basis)
        phi = flow(basis, self.dt)
        held = self.dt * phi[1]
        E, W = phi[0], apply(held, form.B[ports])
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
        return Compiled(
            basis, self.dt, form, ports, E, W, all_rows, history,
            np.array(readouts, dtype=np.intp), np.array(difference, dtype=bool), gaps, a, compliance, residual, tension,
            geometric,
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

    def _with(self, compiled: tuple[Compiled, ...], elimination: Elimination) -> System:
        # what `replace` does; several of these are made for every note
        return System(
            self.dt, self.layout, compiled, elimination.connections, elimination, self.tensions, self.stretches,
            self.is_on,
        )  # fmt: skip

    def with_tensions(self, names: Collection[str]) -> System:
        """Switch on the tensions of these names, and off all others.

        A string that moves along itself is then linear, too: its longitudinal motion is stepped, but no longer coupled
        to the transverse one. The stored energy, EA/(8 L) S^2 without longitudinal motion, appears or vanishes with the
        coupling: switch where it is small, or book it.
        """
        known = [t.name for t in self.rising]
        if unknown := set(names) - set(known):
            raise ValueError(f"no tension {sorted(unknown)}; there are {known}")
        return replace(self, is_on=tuple(name in names for name in known))

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
        """Those that are on of the strings whose longitudinal motion is coupled to the transverse one."""
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
        return State(modes, np.zeros(m), 0, np.zeros(m), np.zeros(m), np.zeros((len(self.tensions), 3)))

    def controlled(self, controls: Sequence[Control], start: int, n: int) -> dict[int, Floats]:
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
