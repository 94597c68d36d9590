"""Components seen through their ports, at complex frequency: what the modes of a coupled system are found with.

    H(s) = sum_k r_k l_k^T / (s - lambda_k) + conj. part + sum_blocks r l^T / (s^2 + 2 sigma s + omega^2) + R

Components joined rigidly by forces f move freely where [sum A H(s) A^T] f = 0: a mode of the whole is a zero of the
determinant, whatever the number of modes of the parts. The matrix is as small as the number of joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import BLOCK, PAIR, ModalBasis

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Ports:
    """One component at some rows over its points.

    Attributes
    ----------
    poles : (n,) 1/s, both of each pair.
    right, left : (p, n).
    weight : (n,) energy of |z|^2 = 1: omega |r| / |l| / 2 over all points of the component.
    stiffness, damping_rate : (b,) of modes kept as second-order blocks.
    block_right, block_left : (p, b).
    residual : (p, p) m/N.
    """

    poles: Complexes
    right: Complexes
    left: Complexes
    weight: Floats
    stiffness: Floats
    damping_rate: Floats
    block_right: Complexes
    block_left: Complexes
    residual: Floats

    @classmethod
    def of(cls, basis: ModalBasis, rows: Floats) -> Ports:
        """See `basis` through `rows` (p, n_points)."""
        block, pair = basis.kind == BLOCK, basis.kind == PAIR
        single = ~block
        right, left = rows @ basis.right, rows @ basis.left

        def full(values: Complexes) -> Complexes:
            return np.concatenate([values[..., single], np.conj(values[..., pair])], axis=-1)

        size_r, size_l = np.abs(basis.right).max(axis=0), np.abs(basis.left).max(axis=0)
        weight = np.sqrt(basis.stiffness) * size_r / np.where(size_l > 0, size_l, 1.0) / 2
        return cls(
            poles=full(basis.poles),
            right=full(right),
            left=full(left),
            weight=np.concatenate([weight[single], weight[pair]]),
            stiffness=basis.stiffness[block],
            damping_rate=basis.damping_rate[block],
            block_right=right[:, block],
            block_left=left[:, block],
            residual=np.asarray(rows @ basis.residual @ rows.T),
        )

    def energy(self, s: complex, force: Complexes) -> float:
        """Mean modal energy, J, of the motion under port forces f exp(s t), (p,) N."""
        z = (self.left.T @ force) / (s - self.poles)
        total = float(np.sum(self.weight * np.abs(z) ** 2))
        if self.stiffness.size:
            q = (self.block_left.T @ force) / (s**2 + 2 * self.damping_rate * s + self.stiffness)
            total += float(np.sum((abs(s) ** 2 + self.stiffness) / 4 * np.abs(q) ** 2))
        return total


class Joint:
    """Components joined at p gaps: M(s), the sum of their receptances.

    Parameters
    ----------
    parts : each with p ports, one per gap (rows of zeros where it does not take part).
    """

    def __init__(self, parts: Sequence[Ports]):
        self.parts = tuple(parts)
        self.size = parts[0].residual.shape[0]
        self._poles = np.concatenate([p.poles for p in parts])
        self._residues = np.concatenate([_products(p.right, p.left) for p in parts], axis=1)
        self._stiffness = np.concatenate([p.stiffness for p in parts])
        self._damping_rate = np.concatenate([p.damping_rate for p in parts])
        self._block_residues = np.concatenate([_products(p.block_right, p.block_left) for p in parts], axis=1)
        self._residual = np.sum([p.residual for p in parts], axis=0).ravel()

    def receptance(self, s: complex) -> tuple[Complexes, Complexes]:
        """M(s) and its derivative, (p, p) each."""
        reach = 1 / (s - self._poles)
        value = self._residues @ reach + self._residual
        slope = -(self._residues @ reach**2)
        if self._stiffness.size:
            below = 1 / (s**2 + 2 * self._damping_rate * s + self._stiffness)
            value = value + self._block_residues @ below
            slope = slope - self._block_residues @ (2 * (s + self._damping_rate) * below**2)
        return value.reshape(self.size, self.size), slope.reshape(self.size, self.size)

    def determinant(self, s: complex) -> tuple[complex, complex]:
        """Return det M and its derivative, det M tr(M^-1 M')."""
        M, D = self.receptance(s)
        if self.size == 1:
            return complex(M[0, 0]), complex(D[0, 0])
        if self.size == 2:
            det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
            slope = D[0, 0] * M[1, 1] + M[0, 0] * D[1, 1] - D[0, 1] * M[1, 0] - M[0, 1] * D[1, 0]
            return complex(det), complex(slope)
        import scipy.linalg as sla

        det = complex(sla.det(M))
        return det, det * complex(np.trace(sla.solve(M, D)))

    def null(self, s: complex) -> tuple[Complexes, Complexes]:
        """Right and left null vectors v, w of M at a zero s, norm 1: M v = 0, w M = 0; v are the gaps' forces."""
        M = self.receptance(s)[0]
        if self.size == 1:
            return np.ones(1, dtype=np.complex128), np.ones(1, dtype=np.complex128)
        if self.size == 2:
            # at a zero the adjugate has rank 1 and is v w
            adjugate = np.array([[M[1, 1], -M[0, 1]], [-M[1, 0], M[0, 0]]])
            i, j = np.unravel_index(int(np.argmax(np.abs(adjugate))), (2, 2))
            v, w = adjugate[:, j], adjugate[i]
            return v / np.sqrt(np.vdot(v, v).real), w / np.sqrt(np.vdot(w, w).real)
        import scipy.linalg as sla

        U, _, Vh = sla.svd(M)
        return np.asarray(Vh[-1].conj()), np.asarray(U[:, -1].conj())

    def shares(self, s: complex) -> Floats:
        """(n_parts,) share of the modal energy in each part, in the mode at a zero s."""
        force = self.null(s)[0]
        energy = np.array([part.energy(s, force) for part in self.parts])
        return np.asarray(energy / energy.sum())

    def newton(
        self,
        start: complex,
        *,
        multiply: Sequence[complex] = (),
        divide: Sequence[complex] = (),
        tolerance: float = 1e-11,
        steps: int = 40,
    ) -> complex | None:
        """A zero of det M prod (s - multiply) / prod (s - divide) from `start`; None if it does not settle.

        Poles of det M near the start are to be multiplied out, zeros already found divided out.
        """  # fmt: skip
        s = complex(start)
        for _ in range(steps):
            det, slope = self.determinant(s)
            if det == 0:
                return s
            rate = slope / det
            rate += sum(1 / (s - pole) for pole in multiply if s != pole)
            rate -= sum(1 / (s - zero) for zero in divide if s != zero)
            step = 1 / rate if rate != 0 else 0.05 * abs(s)
            if abs(step) > 0.05 * abs(s):
                step *= 0.05 * abs(s) / abs(step)
            s -= step
            if abs(step) <= tolerance * abs(s):
                return s if s.imag > 0 else None
        return None

    def zeros(self, starts: Sequence[complex], *, multiply: Sequence[complex] = ()) -> list[complex]:
        """Zeros of det M, each once, one for each start that leads to another."""
        found: list[complex] = []
        for start in starts:
            s = self.newton(start, multiply=multiply, divide=found)
            if s is not None and all(abs(s - other) > 1e-9 * abs(s) for other in found):
                found.append(s)
        return found


def _products(right: Complexes, left: Complexes) -> Complexes:
    """(p * p, n) r_i l_j of every mode."""
    p, n = right.shape
    return np.asarray((right[:, None, :] * left[None, :, :]).reshape(p * p, n))
