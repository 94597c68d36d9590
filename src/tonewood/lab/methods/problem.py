"""The problem that every method steps: rigidly connected components, input forces and displacement outputs.

    x' = A x + B f,   gaps g = C x,   constraint forces f,   two numbers per mode.

On the level of accelerations f = -S C A^2 x with S = (C A B)^+, which is Udwadia and Kalaba's equation; see `forms`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.propagator import apply, flow, real_form
from tonewood.support.arrays import Floats

Array = NDArray[np.float64] | NDArray[np.complex128]
#: sums of points with factors
Sums = Sequence[Sequence[Term]]


@dataclass(frozen=True)
class Problem:
    """Components and rigid constraints, and their arrays over all modes side by side.

    components : name -> basis.
    constraints : connections whose law is `Rigid` without offset.
    inputs : driven points, one force (N) each.
    outputs : points whose displacement (m) is read.
    """

    components: Mapping[str, ModalBasis]
    constraints: tuple[Connection, ...]
    inputs: tuple[Term, ...] = ()
    outputs: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        for c in self.constraints:
            if c.law != Rigid():
                raise ValueError(f"constraint {c.name!r}: these methods know rigid constraints without offset")

    @cached_property
    def starts(self) -> dict[str, slice]:
        """Modes of each component."""
        out, first = {}, 0
        for name, basis in self.components.items():
            out[name] = slice(first, first + basis.n_modes)
            first += basis.n_modes
        return out

    @property
    def n_modes(self) -> int:
        """Number of modes of all components."""
        return sum(basis.n_modes for basis in self.components.values())

    @cached_property
    def gaps(self) -> Sums:
        """Terms of the constraints."""
        return [c.terms for c in self.constraints]

    @cached_property
    def A(self) -> Floats:
        """(n, 2, 2) 1/s."""
        return np.concatenate([real_form(basis).A for basis in self.components.values()])

    @cached_property
    def B(self) -> Floats:
        """(m, n, 2) x' per constraint force."""
        return self._rows("B", self.gaps)

    @cached_property
    def C(self) -> Floats:
        """(m, n, 2) gaps of the constraints, m."""
        return self._rows("C", self.gaps)

    @cached_property
    def driven(self) -> Floats:
        """(n_inputs, n, 2) x' per force at the driven points."""
        return self._rows("B", [(t,) for t in self.inputs])

    @cached_property
    def out(self) -> Floats:
        """(n_outputs, n, 2) displacement of the points that are read, m."""
        return self._rows("C", [(t,) for t in self.outputs])

    @cached_property
    def CA2(self) -> Floats:
        """(m, n, 2) accelerations of the gaps without forces."""
        return through(through(self.C, self.A), self.A)

    @cached_property
    def S(self) -> Floats:
        """(m, m) (C A B)^+, kg: force per acceleration of the gaps."""
        return scaled_pinv(product(through(self.C, self.A), self.B))

    @property
    def generator(self) -> Floats:
        """(2n, 2n) A of x' = A x + ..., two numbers per mode, components one after another."""
        return np.asarray(sla.block_diag(*self.A))

    @property
    def gap_rows(self) -> Floats:
        """(m, 2n) gaps of the constraints."""
        return self.C.reshape(-1, 2 * self.n_modes)

    @property
    def gap_columns(self) -> Floats:
        """(2n, m) x' per constraint force."""
        return self.B.reshape(-1, 2 * self.n_modes).T

    @property
    def input_columns(self) -> Floats:
        """(2n, n_inputs)."""
        return self.driven.reshape(-1, 2 * self.n_modes).T

    @property
    def output_rows(self) -> Floats:
        """(n_outputs, 2n)."""
        return self.out.reshape(-1, 2 * self.n_modes)

    @property
    def impulse_columns(self) -> Floats:
        """(2n, n_inputs) state after unit impulses at the inputs, the constraints answering with impulses of theirs."""
        rate = self.gap_rows @ self.generator
        answer = scaled_pinv(rate @ self.gap_columns) @ rate @ self.input_columns
        return np.asarray(self.input_columns - self.gap_columns @ answer)

    @property
    def residual(self) -> Floats:
        """(m, m) residual compliance that the constraints see, m/N."""
        out = np.zeros((len(self.constraints),) * 2)
        for name, basis in self.components.items():
            weight = np.array([
                [sum(t.factor for t in terms if (t.component, t.point) == (name, p)) for p in basis.points]
                for terms in self.gaps
            ])  # fmt: skip
            out += weight @ basis.residual @ weight.T
        return out

    def gather(self, arrays: Mapping[str, NDArray[Any]], sums: Sums) -> NDArray[Any]:
        """(len(sums), n, ...) weighted sums of rows (n_points, n_modes, ...) of the components' points."""
        some = next(iter(arrays.values()))
        out = np.zeros((len(sums), self.n_modes, *some.shape[2:]), dtype=some.dtype)
        for row, terms in zip(out, sums, strict=True):
            for t in terms:
                row[self.starts[t.component]] += (
                    t.factor * arrays[t.component][self.components[t.component].index(t.point)]
                )
        return out

    def _rows(self, which: str, sums: Sums) -> Floats:
        return self.gather({name: getattr(real_form(b), which) for name, b in self.components.items()}, sums)

    def flow(self, dt: float, order: int = 1) -> Floats:
        """phi_0(A dt) .. phi_order(A dt), (order + 1, n, 2, 2)."""
        return np.concatenate([flow(basis, dt, order) for basis in self.components.values()], axis=1)

    def rate(self, x: Floats) -> Floats:
        """Rate x' of the constrained motion, (n, 2)."""
        f = -self.S @ np.einsum("mnx,nx->m", self.CA2, x)
        return np.asarray(apply(self.A, x) + np.einsum("m,mnx->nx", f, self.B))

    def static(self, forces: Floats) -> Floats:
        """(n, 2) state at rest under constant forces on the driven points, the gaps closed."""
        inverse = sla.inv(self.A)
        response = -apply(inverse, self.driven)
        yields = -apply(inverse, self.B)
        loose = np.einsum("i,inx->nx", np.atleast_1d(forces), response)
        f = -scaled_pinv(product(self.C, yields) + self.residual) @ np.einsum("mnx,nx->m", self.C, loose)
        return np.asarray(loose + np.einsum("m,mnx->nx", f, yields))

    def state_of(self, x: Floats, system: System) -> Floats:
        """(2, capacity) the same state as a kernel holds it."""
        out = np.zeros((2, sum(system.layout.capacities)))
        for name, offset in zip(system.names, system.layout.offsets, strict=True):
            part = x[self.starts[name]]
            out[:, offset : offset + len(part)] = part.T
        return out

    def x_of(self, state: Floats, system: System) -> Floats:
        """(n, 2) from a kernel's state."""
        parts = {
            name: state[:, offset : offset + basis.n_modes].T
            for name, offset, basis in zip(
                system.names, system.layout.offsets, (c.basis for c in system.compiled), strict=True
            )
        }
        return np.concatenate([parts[name] for name in self.components])

    @cached_property
    def energy_weights(self) -> Floats:
        """(n, 2, 2) E = sum x^T w x / 2: kinetic and potential energy of real modes, J.

        Of complex modes omega |r| / |l| |z|^2, the same up to the terms that two modes of a non-proportionally damped
        motion have in common.
        """
        out = np.zeros((self.n_modes, 2, 2))
        for name, basis in self.components.items():
            if basis.is_real:
                read, weight = motion_of(basis), np.zeros((basis.n_modes, 2, 2))
                weight[:, 0, 0], weight[:, 1, 1] = basis.stiffness, 1.0
                out[self.starts[name]] = np.einsum("nyx,nyz,nzw->nxw", read, weight, read)
                continue
            size = np.abs(basis.right).max(axis=0) / np.where(basis.left.any(axis=0), np.abs(basis.left).max(axis=0), 1)
            out[self.starts[name], [0, 1], [0, 1]] = (np.sqrt(basis.stiffness) * size)[:, None]
        return out

    def energy(self, x: Floats) -> float:
        """Stored energy of a state, J; see `energy_weights`."""
        return float(0.5 * np.einsum("nx,nxy,ny->", x, self.energy_weights, x))

    def system(self, dt: float, laws: Sequence[Connection] = (), **options: Any) -> System:
        """Return the problem for the project's own stepper, with nonlinear connections if wanted."""
        readouts = [
            Readout(f"{i}", "displacement", (Term(t.component, t.point, t.factor),)) for i, t in enumerate(self.outputs)
        ]
        return System.build(self.components, [*self.constraints, *laws], readouts, dt=dt, **options)

    @cached_property
    def real(self) -> RealModes:
        """Mass-normalised real modes; ValueError if a component's modes are not real."""
        for name, basis in self.components.items():
            if not basis.is_real:
                raise ValueError(f"the modes of {name!r} are not real")
        bases = self.components.values()
        shapes = {name: basis.right.real for name, basis in self.components.items()}
        return RealModes(
            np.concatenate([b.stiffness for b in bases]),
            np.concatenate([b.damping_rate for b in bases]),
            self.gather(shapes, self.gaps),
            self.gather(shapes, [(t,) for t in self.inputs]),
            self.gather(shapes, [(t,) for t in self.outputs]),
            np.concatenate([motion_of(b) for b in bases]),
        )


@dataclass(frozen=True, eq=False)
class RealModes:
    """A problem of real modes.

    omega2, sigma : (n,) 1/s^2, 1/s.
    gaps, inputs, outs : (., n) shapes at the rigid gaps, the driven points and the readouts.
    read : (n, 2, 2) state x -> (q, q').
    """

    omega2: Floats
    sigma: Floats
    gaps: Floats
    inputs: Floats
    outs: Floats
    read: Floats


def motion_of(basis: ModalBasis) -> Floats:
    """(n, 2, 2) state -> (q, q') of real modes: of a pair, q = 2 Re z, q' = 2 Re(lambda z); a block holds them."""
    read = np.zeros((basis.n_modes, 2, 2))
    read[:, 0, 0], read[:, 1, 0], read[:, 1, 1] = 2.0, 2 * basis.poles.real, -2 * basis.poles.imag
    read[basis.kind != PAIR] = np.eye(2)
    return read


def inverses(blocks: Floats) -> Floats:
    """Inverses of (n, 2, 2) blocks, one by one: SciPy before 1.17 inverts no stacks."""
    return np.array([sla.inv(block) for block in blocks]).reshape(blocks.shape)


def through(rows: Floats, blocks: Floats) -> Floats:
    """Rows (k, n, 2) times blocks (n, 2, 2): the rows of a state after the blocks have acted."""
    out = np.empty_like(rows)
    out[..., 0] = rows[..., 0] * blocks[:, 0, 0] + rows[..., 1] * blocks[:, 1, 0]
    out[..., 1] = rows[..., 0] * blocks[:, 0, 1] + rows[..., 1] * blocks[:, 1, 1]
    return out


def product(rows: Floats, columns: Floats) -> Floats:
    """(k, l) sum over modes of rows (k, n, 2) and columns (l, n, 2)."""
    return np.asarray(rows.reshape(len(rows), -1) @ columns.reshape(len(columns), -1).T)
