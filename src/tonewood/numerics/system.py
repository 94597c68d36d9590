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

from tonewood.numerics.connections import Connection, LinearLaws, LinearSolve, NonlinearSolve, nonlinear_solve
from tonewood.numerics.geometric import GeometricPart, GeometricStretch
from tonewood.numerics.laws import Friction
from tonewood.numerics.modes import ModalBasis
from tonewood.numerics.propagator import RealForm, apply, flow, real_form
from tonewood.numerics.tension import TensionModulation, TensionPart

Floats = NDArray[np.float64]

#: samples that the kernel steps at a time: the reach of `Compiled.history`
BLOCK_SIZE = 16
#: modes of a component are padded to a multiple of this in the state
PADDING = 16


@dataclass(frozen=True, slots=True)
class Probe:
    """Share of a point's motion in a readout; `quantity` is displacement, velocity or acceleration."""

    component: str
    point: str
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class Readout:
    """One channel: a weighted sum of points' motion, or of connection forces (N).

    Displacement and velocity are read at the sample's time t_n; acceleration and force are means over the step that
    begins there, [t_n, t_n + h]: the force is constant over a step, and a mean needs no direct term.
    """

    name: str
    quantity: str
    probes: tuple[Probe, ...] = ()
    forces: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.quantity not in ("displacement", "velocity", "acceleration", "force"):
            raise ValueError(
                f"a readout's quantity is displacement, velocity, acceleration or force, not {self.quantity!r}"
            )


@dataclass(frozen=True, slots=True)
class Drive:
    """A one-way input: `point` of a driven component receives `factor` times the force of a connection."""

    component: str
    point: str
    connection: str
    factor: float = 1.0


@dataclass(frozen=True, eq=False)
class Compiled:
    """One component ready to be stepped by dt.

    Attributes
    ----------
    basis : the modes.
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
    compliance, residual : (g, g) m/N, its share of these gaps' compliance over one step, and of their residual
        compliance.
    tension : its share of a tension, if it belongs to one.
    geometric : its share of a string whose longitudinal motion is stepped, likewise.
    """

    basis: ModalBasis
    form: RealForm
    ports: NDArray[np.intp]
    E: Floats
    W: Floats
    rows: Floats
    history: Floats
    readouts: NDArray[np.intp]
    difference: NDArray[np.bool_]
    gaps: NDArray[np.intp]
    compliance: Floats
    residual: Floats
    tension: TensionPart | None = None
    geometric: GeometricPart | None = None

    @cached_property
    def velocity(self) -> Floats:
        """(n_ports, n_modes, 2) velocity rows of the ports."""
        return self.form.rows("velocity", self.ports)

    @cached_property
    def mobility(self) -> Floats:
        """(n_ports, n_ports) m/s of each port (first index) per impulse of 1 N s at another."""
        p = len(self.ports)
        return np.asarray(self.velocity.reshape(p, -1) @ self.form.B[self.ports].reshape(p, -1).T)


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
class System:
    """Components, connections and readouts at one step length.

    Build with `System.build`; exchange a component with `with_basis`, connections' laws with `with_laws`, and switch
    tensions with `with_tensions`.
    """

    dt: float
    names: tuple[str, ...]
    compiled: tuple[Compiled, ...]
    connections: tuple[Connection, ...]
    readouts: tuple[Readout, ...]
    drives: tuple[Drive, ...]
    capacities: tuple[int, ...]
    solve: LinearSolve
    nonlinear: NonlinearSolve | None = None
    tensions: tuple[TensionModulation, ...] = ()
    tension_on: tuple[bool, ...] = ()
    geometric: tuple[GeometricStretch, ...] = ()
    wiring: tuple[Floats, ...] = ()
    linear: LinearLaws | None = None
    places: NDArray[np.intp] | None = None

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
    ) -> System:
        """Compile.

        Parameters
        ----------
        components : name -> basis. One that `drives` name is driven one way: no connection may act on it.
        capacities : name -> modes to leave room for, where a component may later take a larger basis.
        tensions : strings whose tension rises with their amplitude; all are on.
        geometric : strings whose longitudinal motion is stepped with the transverse one.

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
        names = tuple(components)
        system = cls(
            dt=dt,
            names=names,
            compiled=(),
            connections=tuple(connections),
            readouts=tuple(readouts),
            drives=tuple(drives),
            capacities=tuple(_padded(max(components[n].n_modes, (capacities or {}).get(n, 0))) for n in names),
            solve=LinearSolve(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros((0, 0))),
            tensions=tuple(tensions),
            tension_on=(True,) * len(tensions),
            geometric=tuple(geometric),
        )
        compiled = tuple(system.compile(name, components[name]) for name in names)
        wiring = tuple(system._incidence(name) for name in names)
        return replace(system, compiled=compiled, wiring=wiring)._solved()

    def ports_of(self, name: str) -> list[str]:
        """Points of a component that connections or drives act on, sorted; the same whatever its basis."""
        points = {t.point for c in self.connections for t in c.terms if t.component == name}
        return sorted(points | {d.point for d in self.drives if d.component == name})

    def compile(self, name: str, basis: ModalBasis) -> Compiled:
        """Compile another basis of the component `name`; it may be kept and used again with `with_compiled`."""
        ports = np.array([basis.index(p) for p in self.ports_of(name)], dtype=np.intp)
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
        history = (
            _responses(E, W).reshape(BLOCK_SIZE * len(ports), numbers) @ all_rows.reshape(len(all_rows), numbers).T
        ).reshape(BLOCK_SIZE, len(ports), len(all_rows))
        slot = self.slot(name)
        wired = self.wiring[slot] if self.wiring else self._incidence(name)
        a = np.zeros((0, len(ports))) if self.driven[slot] else wired
        gaps = np.flatnonzero(np.any(a != 0.0, axis=1))
        a = a[gaps]
        compliance = a @ history[0, :, : len(ports)].T @ a.T
        residual = a @ basis.residual[ports][:, ports] @ a.T
        tension = next((t.part(name, basis, self.dt, held) for t in self.tensions if name in t.components), None)
        geometric = next((g.part(name, basis, held) for g in self.geometric if name in g.parts), None)
        return Compiled(
            basis, form, ports, E, W, all_rows, history,
            np.array(readouts, dtype=np.intp), np.array(difference, dtype=bool), gaps, compliance, residual, tension,
            geometric,
        )  # fmt: skip

    def with_compiled(self, changes: Mapping[str, Compiled]) -> System:
        """Exchange components for already compiled bases of themselves."""
        compiled = list(self.compiled)
        for name, new in changes.items():
            i = self.names.index(name)
            if new.basis.n_modes > self.capacities[i]:
                raise ValueError(f"{name}: room for {self.capacities[i]} modes, not {new.basis.n_modes}")
            compiled[i] = new
        return replace(self, compiled=tuple(compiled))._solved()

    def with_basis(self, name: str, basis: ModalBasis) -> System:
        """Exchange one component's basis."""
        return self.with_compiled({name: self.compile(name, basis)})

    def with_laws(self, laws: Mapping[str, Connection]) -> System:
        """Exchange laws of connections (their terms must stay)."""
        connections = tuple(laws.get(c.name, c) for c in self.connections)
        if any(
            new is not old and new.terms != old.terms for new, old in zip(connections, self.connections, strict=True)
        ):
            raise ValueError("a connection's terms cannot change, only its law")
        return replace(self, connections=connections, linear=None)._solved()

    def with_tensions(self, names: Collection[str]) -> System:
        """Switch on the tensions of these names, and off all others.

        The stored energy EA/(8 L) S^2 of a string appears or vanishes with its tension: switch where it is small, or
        book it.
        """
        known = [t.name for t in self.tensions]
        if unknown := set(names) - set(known):
            raise ValueError(f"no tension {sorted(unknown)}; there are {known}")
        return replace(self, tension_on=tuple(name in names for name in known))

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Start of each component in `State.modes`."""
        return tuple(int(x) for x in np.cumsum((0, *self.capacities[:-1])))

    @cached_property
    def driven(self) -> tuple[bool, ...]:
        """Which components are driven one way."""
        one_way = {d.component for d in self.drives}
        return tuple(name in one_way for name in self.names)

    def slot(self, name: str) -> int:
        """Index of a component."""
        return self.names.index(name)

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
        return self.wiring[slot]

    def _incidence(self, name: str) -> Floats:
        place = {point: i for i, point in enumerate(self.ports_of(name))}
        out = np.zeros((len(self.connections), len(place)))
        for j, connection in enumerate(self.connections):
            for term in connection.terms:
                if term.component == name:
                    out[j, place[term.point]] += term.factor
            for drive in self.drives:
                if drive.component == name and drive.connection == connection.name:
                    out[j, place[drive.point]] += drive.factor
        return out

    def force_weights(self) -> Floats:
        """(n_readouts, m) weights of the connection forces in the readouts."""
        index = {c.name: j for j, c in enumerate(self.connections)}
        out = np.zeros((len(self.readouts), len(self.connections)))
        for i, readout in enumerate(self.readouts):
            for name, factor in readout.forces:
                out[i, index[name]] += factor
        return out

    def gap_matrix(self, which: str) -> Floats:
        """(m, m) m/N, ``compliance`` or ``residual`` of all components as the gaps see it."""
        m = len(self.connections)
        places = self._places() if self.places is None else self.places
        shares = [getattr(c, which).ravel() for c in self.compiled]
        total = np.bincount(places, np.concatenate([np.zeros(0), *shares]), m * m)
        return np.asarray(total.reshape(m, m), dtype=np.float64)

    def _places(self) -> NDArray[np.intp]:
        """Where the entries of all components' gap matrices belong; the same whatever their bases."""
        m = len(self.connections)
        none = np.zeros(0, dtype=np.intp)
        return np.concatenate([none, *((c.gaps[:, None] * m + c.gaps).ravel() for c in self.compiled)])

    def _solved(self) -> System:
        laws = [c.law for c in self.connections]
        linear = self.linear or LinearLaws.of(laws, self.dt)
        compliance, residual = self.gap_matrix("compliance"), self.gap_matrix("residual")
        solve = linear.solve(compliance, residual)
        nonlinear = nonlinear_solve(laws, solve, compliance, residual)
        places = self._places() if self.places is None else self.places
        return replace(self, linear=linear, places=places, solve=solve, nonlinear=nonlinear)


def _responses(E: Floats, W: Floats) -> Floats:
    """(BLOCK_SIZE, n_ports, n_modes, 2) E^k W, k = 0 .. BLOCK_SIZE - 1, by doubling."""
    out = np.empty((BLOCK_SIZE, *W.shape))
    out[0], known, power = W, 1, E
    while known < BLOCK_SIZE:
        out[known : 2 * known] = apply(power, out[: min(known, BLOCK_SIZE - known)])
        known, power = 2 * known, power @ power
    return out


def _padded(n: int) -> int:
    return -(-max(n, 1) // PADDING) * PADDING
