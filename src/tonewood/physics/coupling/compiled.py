"""Data of a stepper: compiled components, known forces, prescribed motion of partners, and the state."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.layout import Layout
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.coordinates import ModalCoordinates
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import RealForm, apply, flow, impulse_series, powers, real_form
from tonewood.support.arrays import Floats

#: samples that the kernel steps at a time: the reach of `Compiled.history`
BLOCK_SIZE = 16
#: modes of a component are padded to a multiple of this in the state
PADDING = 16


@dataclass(frozen=True, eq=False)
class Compiled:
    """One component ready to be stepped by dt.

    basis : the modes.
    dt : s, step.
    form : their real 2 x 2 blocks.
    ports : (n_ports,) rows of `basis.points` that connections act on, in order of their names.
    E : (n_modes, 2, 2) propagator of one step.
    response : (n_modes, 2, 2) dt phi_1(A dt): state added by a force that is constant over one step, per its B.
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
    potentials : name of a potential that acts on it -> its share, what `Potential.share` returned.
    """

    basis: ModalBasis
    dt: float
    form: RealForm
    ports: NDArray[np.intp]
    E: Floats
    response: Floats
    W: Floats
    rows: Floats
    history: Floats
    readouts: NDArray[np.intp]
    difference: NDArray[np.bool_]
    gaps: NDArray[np.intp]
    shares: Floats
    compliance: Floats
    residual: Floats
    potentials: Mapping[str, Any] = field(default_factory=dict)
    _joined: dict[str, tuple[tuple[Any, ...], Any]] = field(init=False, repr=False, default_factory=dict)
    _impulses: dict[str, Floats] = field(init=False, repr=False, default_factory=dict)
    _motions: dict[bytes, tuple[NDArray[np.intp], Floats]] = field(init=False, repr=False, default_factory=dict)

    @classmethod
    def of(
        cls,
        name: str,
        basis: ModalBasis,
        layout: Layout,
        dt: float,
        potentials: Iterable[Potential],
        like: Compiled | None = None,
    ) -> Compiled:
        """Compile a basis of the component `name`.

        potentials : of the system.
        like : of the component; where it has the very poles of the basis, its propagator is taken over.
        Raises ValueError : a potential acts on it, and its modes are not real.
        """
        slot = layout.slots[name]
        ports = np.array([basis.index(p) for p in layout.ports[name]], dtype=np.intp)
        if like is not None and like.basis.poles is basis.poles:
            E, response, form = like.E, like.response, real_form(basis, like.form.A)
        else:
            E, response = flow(basis, dt)
            response *= dt
            form = real_form(basis)
        W = apply(response, form.B[ports])
        rows, readouts, difference = [form.C[ports]], [], []
        for channel, readout in enumerate(layout.readouts):
            probes = [p for p in readout.probes if p.component == name]
            if not probes:
                continue
            index = np.array([basis.index(p.point) for p in probes], dtype=np.intp)
            mean = readout.quantity == "acceleration"
            motion = form.rows("velocity" if mean else readout.quantity, index)
            factor = np.array([p.factor for p in probes]) / (dt if mean else 1.0)
            rows.append(np.einsum("p,pmx->mx", factor, motion)[None])
            readouts.append(channel)
            difference.append(mean)
        all_rows = np.concatenate(rows)
        numbers = 2 * basis.n_modes
        after = powers(E, W, BLOCK_SIZE).reshape(BLOCK_SIZE * len(ports), numbers)
        history = (after @ all_rows.reshape(len(all_rows), numbers).T).reshape(BLOCK_SIZE, len(ports), len(all_rows))
        gaps = layout.gaps[slot]
        a = layout.incidence[slot][gaps]
        compliance = a @ history[0, :, : len(ports)].T @ a.T
        residual = a @ basis.residual[ports][:, ports] @ a.T
        acting = [p for p in potentials if name in p.components]
        if acting and not basis.is_real:
            raise ValueError(f"{acting[0].name}: the modes of {name} must be real")
        return cls(
            basis, dt, form, ports, E, response, W, all_rows, history,
            np.array(readouts, dtype=np.intp), np.array(difference, dtype=bool), gaps, a, compliance, residual,
            {p.name: p.share(name, basis, dt) for p in acting},
        )  # fmt: skip

    @cached_property
    def coordinates(self) -> ModalCoordinates:
        """Coordinates of its modes, which must be real."""
        return ModalCoordinates.of(self.basis, self.dt, self.response)

    def joined(self, name: str, shares: tuple[Any, ...], join: Callable[[tuple[Any, ...]], Any]) -> Any:
        """The potential of a name joined of all its components' shares; the last result is kept with the first one."""
        entry = self._joined.get(name)
        if entry is None or any(a is not b for a, b in zip(entry[0], shares, strict=True)):
            self._joined[name] = entry = shares, join(shares)
        return entry[1]

    def impulses(self, point: str) -> Floats:
        """`propagator.impulse_series` of a named point, kept for use again."""
        if point not in self._impulses:
            self._impulses[point] = impulse_series(self.basis, self.form, self.basis.index(point), self.dt)
        return self._impulses[point]

    def held_force(self, point: str) -> Floats:
        """(n_modes, 2) state added by a unit force at a named point held over one step."""
        return apply(self.response, self.form.B[self.basis.index(point)])

    def motions(self, ports: NDArray[np.intp]) -> tuple[NDArray[np.intp], Floats]:
        """(r,) as few of some ports (p,) as move the others with them, and (p, r) how, u = span u_r.

        Where p ports of a body move by r < p independent motions (a rigid bridge that heaves and rocks has two), r of
        them span the rest, in displacements and in forces; a force on one is span^T f on those.
        """
        if (key := ports.tobytes()) not in self._motions:
            self._motions[key] = _independent(self, ports)
        return self._motions[key]

    @cached_property
    def gap_velocity(self) -> Floats:
        """(g, 2 n_modes) velocities of its gaps per number of its modes, (2, n_modes)."""
        rows = self.form.rows("velocity", self.ports).swapaxes(1, 2)
        return np.asarray(self.shares @ rows.reshape(len(self.ports), 2 * self.basis.n_modes))

    @cached_property
    def gap_scatter(self) -> Floats:
        """(g, 2 n_modes) change of these numbers by an impulse of 1 N s across each gap."""
        B = self.form.B[self.ports].swapaxes(1, 2)
        return np.asarray(self.shares @ B.reshape(len(self.ports), 2 * self.basis.n_modes))

    @cached_property
    def gap_mobility(self) -> Floats:
        """(g, g) m/s of each gap (first index) per impulse of 1 N s across another."""
        return np.asarray(self.gap_velocity @ self.gap_scatter.T)


def _independent(compiled: Compiled, ports: NDArray[np.intp]) -> tuple[NDArray[np.intp], Floats]:
    all_of_them = ports, np.eye(len(ports))
    if len(ports) < 3:
        return all_of_them
    parts = [part[ports].reshape(len(ports), -1) for part in (compiled.rows, compiled.W)]
    motion = np.hstack([part / (np.max(np.abs(part), initial=0.0) or 1.0) for part in parts])
    chosen = _pivots(motion, 1e-13)
    if len(chosen) in (0, len(ports)):
        return all_of_them
    span = np.linalg.lstsq(motion[chosen].T, motion.T, rcond=None)[0].T
    if np.max(np.abs(motion - span @ motion[chosen])) > 1e-14 * len(chosen):
        return all_of_them
    return ports[chosen], np.ascontiguousarray(span)


def _pivots(rows: Floats, least: float) -> NDArray[np.intp]:
    """Rows that span all of them, sorted: Gram-Schmidt with the largest rest first, down to `least` of the largest."""
    rest, chosen, first = rows.copy(), list[int](), 0.0
    for _ in range(min(rows.shape)):
        sizes = np.sqrt(np.einsum("ij,ij->i", rest, rest))
        sizes[chosen] = 0.0
        k = int(np.argmax(sizes))
        first = first or float(sizes[k])
        if sizes[k] <= least * first:
            break
        chosen.append(k)
        unit = rest[k] / sizes[k]
        rest -= np.outer(rest @ unit, unit)
    return np.sort(np.array(chosen, dtype=np.intp))


@dataclass(eq=False)
class State:
    """State of a system: plain arrays, owned by the caller of the stepper.

    modes : (2, capacity) the two numbers of every mode, component after component, padded.
    forces : (m,) N, connection forces of the step before.
    sample : steps taken since time 0.
    series : (m,) m, displacement of the residual compliance in series with nonlinear connections; empty is rest.
    slip : (m,) m/s, relative velocity of friction connections over the step before, 0 when sticking; empty is rest.
    potentials : numbers of the potentials, one after another (`Potentials.memory`); empty is rest.
    """

    modes: Floats
    forces: Floats
    sample: int = 0
    series: Floats = field(default_factory=lambda: np.zeros(0))
    slip: Floats = field(default_factory=lambda: np.zeros(0))
    potentials: Floats = field(default_factory=lambda: np.zeros(0))

    def copy(self) -> State:
        """Return an independent copy."""
        return State(
            self.modes.copy(),
            self.forces.copy(),
            self.sample,
            self.series.copy(),
            self.slip.copy(),
            self.potentials.copy(),
        )

    def restore(self, other: State) -> None:
        """Take over all of another state."""
        self.modes[:], self.forces[:], self.sample = other.modes, other.forces, other.sample
        self.series, self.slip, self.potentials = other.series.copy(), other.slip.copy(), other.potentials.copy()


@dataclass(frozen=True, eq=False)
class Injection:
    """A known force, compiled: x_u(n) += sum_k vectors[k] values[k, n - start] for the modes of one component.

    component : its name.
    start : absolute sample of the first step it acts in.
    vectors : (n_vectors, n_modes, 2).
    values : (n_vectors, n_steps).
    further : computes what follows after the last step; None where nothing does.
    """

    component: str
    start: int
    vectors: Floats
    values: Floats
    further: Callable[[], Injection] | None = None

    @cached_property
    def stop(self) -> int:
        """Absolute sample after the last step it acts in."""
        return self.start + int(self.values.shape[1])


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """Moves or scales a nonlinear connection's partner sample by sample, in place of its law's constants.

    Its work on the partner comes from outside: only f (g+ - g) is balanced by the law.

    connection : its name.
    start : absolute sample of the first step it acts in.
    offset : (n_steps + 1,) m, gap of zero compression at the beginning of each step and the end of the last.
    velocity : (n_steps,) m/s, of the partner in a `Friction`, mean over each step.
    scale : (n_steps,) factor, not negative, on the force of the law: a bow's pressure, a finger's weight.
    further : computes what follows after the last step; None where nothing does.
    """

    connection: str
    start: int
    offset: Floats | None = None
    velocity: Floats | None = None
    scale: Floats | None = None
    further: Callable[[], PrescribedMotion] | None = None

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
