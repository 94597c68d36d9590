"""Components and rigid constraints as flat arrays over all modes, from which every method is made.

    x' = A x + B f,   gaps g = C x,   constraint forces f.

On the level of accelerations f = -S C A^2 x with S = (C A B)^+, which is Udwadia and Kalaba's equation; see
`lab.methods.forms`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.methods.problem import Problem
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import PAIR
from tonewood.physics.modal.propagator import apply, flow, real_form

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Flat:
    """All modes of a problem side by side.

    Attributes
    ----------
    problem : components, constraints, driven and read points.
    """

    problem: Problem

    @cached_property
    def starts(self) -> dict[str, slice]:
        """Modes of each component."""
        out, first = {}, 0
        for name, basis in self.problem.components.items():
            out[name] = slice(first, first + basis.n_modes)
            first += basis.n_modes
        return out

    @property
    def n_modes(self) -> int:
        """Number of modes of all components."""
        return sum(basis.n_modes for basis in self.problem.components.values())

    @cached_property
    def A(self) -> Floats:
        """(n, 2, 2) 1/s."""
        return np.concatenate([real_form(basis).A for basis in self.problem.components.values()])

    @cached_property
    def B(self) -> Floats:
        """(m, n, 2) x' per constraint force."""
        return self._gather(tuple(c.terms for c in self.problem.constraints), "B")

    @cached_property
    def C(self) -> Floats:
        """(m, n, 2) gaps of the constraints, m."""
        return self._gather(tuple(c.terms for c in self.problem.constraints), "C")

    @cached_property
    def scatter(self) -> Floats:
        """(n_inputs, n, 2) x' per force at the driven points."""
        return self._gather(tuple((t,) for t in self.problem.inputs), "B")

    @cached_property
    def out(self) -> Floats:
        """(n_outputs, n, 2) displacement of the points that are read, m."""
        return self._gather(tuple((t,) for t in self.problem.outputs), "C")

    @cached_property
    def CA2(self) -> Floats:
        """(m, n, 2) accelerations of the gaps without forces."""
        return through(through(self.C, self.A), self.A)

    @cached_property
    def S(self) -> Floats:
        """(m, m) (C A B)^+, kg: force per acceleration of the gaps."""
        return scaled_pinv(product(through(self.C, self.A), self.B))

    def flow(self, dt: float, order: int = 1) -> Floats:
        """phi_0(A dt) .. phi_order(A dt), (order + 1, n, 2, 2)."""
        return np.concatenate([flow(basis, dt, order) for basis in self.problem.components.values()], axis=1)

    def rate(self, x: Floats) -> Floats:
        """Rate x' of the constrained motion, (n, 2)."""
        f = -self.S @ np.einsum("mnx,nx->m", self.CA2, x)
        return np.asarray(apply(self.A, x) + np.einsum("m,mnx->nx", f, self.B))

    def static(self, forces: Floats) -> Floats:
        """(n, 2) state at rest under constant forces on the driven points, the gaps closed."""
        inverse = sla.inv(self.A)
        response = -apply(inverse, self.scatter)
        yields = -apply(inverse, self.B)
        loose = np.einsum("i,inx->nx", np.atleast_1d(forces), response)
        f = -scaled_pinv(product(self.C, yields) + self.problem.residual) @ np.einsum("mnx,nx->m", self.C, loose)
        return np.asarray(loose + np.einsum("m,mnx->nx", f, yields))

    def state_of(self, x: Floats, system: System) -> Floats:
        """(2, capacity) the same state as a kernel holds it."""
        out = np.zeros((2, sum(system.capacities)))
        for name, offset in zip(system.names, system.offsets, strict=True):
            part = x[self.starts[name]]
            out[:, offset : offset + len(part)] = part.T
        return out

    def x_of(self, state: Floats, system: System) -> Floats:
        """(n, 2) from a kernel's state."""
        parts = {
            name: state[:, offset : offset + basis.n_modes].T
            for name, offset, basis in zip(
                system.names, system.offsets, (c.basis for c in system.compiled), strict=True
            )
        }
        return np.concatenate([parts[name] for name in self.problem.components])

    @cached_property
    def energy_weights(self) -> Floats:
        """(n, 2, 2) E = sum x^T w x / 2: kinetic and potential energy of real modes, J.

        Of complex modes omega |r| / |l| |z|^2, the same up to the terms that two modes of a non-proportionally damped
        motion have in common.
        """
        out = np.zeros((self.n_modes, 2, 2))
        for name, basis in self.problem.components.items():
            size = np.abs(basis.right).max(axis=0) / np.where(basis.left.any(axis=0), np.abs(basis.left).max(axis=0), 1)
            block = np.zeros((basis.n_modes, 2, 2))
            pair = basis.kind == PAIR
            if basis.is_real:
                # q = 2 Re z, q' = 2 Re(lambda z)
                read = np.zeros((basis.n_modes, 2, 2))
                read[:, 0, 0], read[:, 1, 0] = 2.0, 2 * basis.poles.real
                read[:, 1, 1] = -2 * basis.poles.imag
                read[~pair] = np.eye(2)
                weight = np.zeros((basis.n_modes, 2, 2))
                weight[:, 0, 0], weight[:, 1, 1] = basis.stiffness, 1.0
                block = np.einsum("nyx,nyz,nzw->nxw", read, weight, read)
            else:
                block[:, [0, 1], [0, 1]] = (np.sqrt(basis.stiffness) * size)[:, None]
            out[self.starts[name]] = block
        return out

    def energy(self, x: Floats) -> float:
        """Stored energy of a state, J; see `energy_weights`."""
        return float(0.5 * np.einsum("nx,nxy,ny->", x, self.energy_weights, x))

    def _gather(self, sums: tuple[tuple[Term, ...], ...], which: str) -> Floats:
        out = np.zeros((len(sums), self.n_modes, 2))
        forms = {name: real_form(basis) for name, basis in self.problem.components.items()}
        for row, terms in zip(out, sums, strict=True):
            for t in terms:
                index = self.problem.components[t.component].index(t.point)
                row[self.starts[t.component]] += t.factor * getattr(forms[t.component], which)[index]
        return out


@dataclass(frozen=True, eq=False)
class RealModes:
    """A problem of real modes.

    Attributes
    ----------
    omega2, sigma : (n,) 1/s^2, 1/s.
    gaps, outs : (., n) shapes at the rigid gaps and at the readouts.
    read : (n, 2, 2) state x -> (q, q').
    """

    omega2: Floats
    sigma: Floats
    gaps: Floats
    outs: Floats
    read: Floats

    @classmethod
    def of(cls, flat: Flat) -> RealModes:
        """Collect them; ValueError if a component's modes are not real."""
        for name, basis in flat.problem.components.items():
            if not basis.is_real:
                raise ValueError(f"the modes of {name!r} are not real")
        bases = flat.problem.components.values()
        poles = np.concatenate([b.poles for b in bases])
        pair = np.concatenate([b.kind for b in bases]) == 0
        read = np.tile(np.eye(2), (len(poles), 1, 1))
        read[pair] = 2 * np.stack(
            [np.stack([np.ones(pair.sum()), np.zeros(pair.sum())], -1), np.stack([poles.real, -poles.imag], -1)[pair]],
            axis=1,
        )
        back = inverses(read)
        # a displacement row of (q, q') has only q in it
        return cls(
            np.concatenate([b.stiffness for b in bases]),
            np.concatenate([b.damping_rate for b in bases]),
            through(flat.C, back)[..., 0],
            through(flat.out, back)[..., 0],
            read,
        )


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
