"""Poles of large systems with few joints, from the matrix that the joints' forces see.

A motion exp(s t) needs M(s) f = 0 with M as small as the number of joints. Most modes belong to one joint alone (a
string's), and add to one diagonal entry only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tonewood.lab.methods.problem import Problem
from tonewood.physics.modal.propagator import apply
from tonewood.support.arrays import Complexes, Floats

#: most linear problems that are solved for one zero
_STEPS = 60


@dataclass(frozen=True, eq=False)
class Products:
    """Sums over modes of weight_n rows_in columns_jn, rows and columns (m, n, k) being given once.

    alone, joint, modes : (n_alone,) products, joints and places of the modes that belong to one joint.
    shared, others : (m m, n_shared) products and places of the modes of several.
    m : joints.
    """

    alone: Floats
    joint: NDArray[np.intp]
    modes: NDArray[np.intp]
    shared: Floats
    others: NDArray[np.intp]
    m: int

    @classmethod
    def of(cls, rows: Floats, columns: Floats) -> Products:
        """From arrays (m, n, k) of each joint's rows and columns."""
        touched: NDArray[np.bool_] = np.any(rows != 0, axis=2) | np.any(columns != 0, axis=2)
        count = touched.sum(axis=0)
        modes, others = np.flatnonzero(count == 1), np.flatnonzero(count > 1)
        joint = np.argmax(touched[:, modes], axis=0)
        shared = np.einsum("ink,jnk->ijn", rows[:, others], columns[:, others])
        return cls(
            np.sum(rows[joint, modes] * columns[joint, modes], axis=1),
            joint, modes, shared.reshape(len(rows) ** 2, -1), others, len(rows),
        )  # fmt: skip

    def __call__(self, weight: Complexes) -> Complexes:
        """(m, m) for weights (n,)."""
        value = self.alone * weight[self.modes]
        out = (self.shared @ weight[self.others]).reshape(self.m, self.m)
        diagonal = np.bincount(self.joint, value.real, self.m) + 1j * np.bincount(self.joint, value.imag, self.m)
        out[np.arange(self.m), np.arange(self.m)] += diagonal
        return np.asarray(out)


@dataclass(frozen=True, eq=False)
class Transfer:
    """Rows (u - F)^-1 columns, summed over modes: (u rows columns - rows adj(F) columns) / det(u - F).

    For a step, F = E - 1 and u = exp(s h) - 1: near zero frequency E and exp(s h) differ from 1 by little.
    """

    plain: Products
    turned: Products
    blocks: Floats

    @classmethod
    def of(cls, rows: Floats, columns: Floats, blocks: Floats) -> Transfer:
        """From (m, n, 2) rows and columns, and (n, 2, 2) F."""
        a, b, c, d = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 0], blocks[:, 1, 1]
        adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], 1)
        return cls(Products.of(rows, columns), Products.of(rows, apply(adjugate, columns)), blocks)

    def __call__(self, u: complex) -> Complexes:
        """(m, m)."""
        F = self.blocks
        det = (u - F[:, 0, 0]) * (u - F[:, 1, 1]) - F[:, 0, 1] * F[:, 1, 0]
        weight = np.asarray(1 / det, dtype=np.complex128)
        return np.asarray(u * self.plain(weight) - self.turned(weight))


def continuous_matrix(flat: Problem) -> Callable[[complex], Complexes]:
    """Map s -> (m, m) receptance seen by the joints, C (s - A)^-1 B + R: zero determinant at a pole of the whole."""
    transfer, R = Transfer.of(flat.C, flat.B, flat.A), flat.residual
    return lambda s: transfer(s) + R


def nearest_zero(
    matrix: Callable[[complex], Complexes], start: complex, joint: int | None = None, *, reach: float = 0.02
) -> complex:
    """Zero of det matrix(s) near `start` by successive linear problems; nan if it does not converge.

    joint : of several zeros near, take the one whose null vector (the forces) is largest there; None takes the nearest.
    reach : longest step, and farthest zero considered, relative to s.
    """
    s = complex(start)
    for _ in range(_STEPS):
        d = 1e-6 * abs(s)
        M, D = matrix(s), (matrix(s + d) - matrix(s - d)) / (2 * d)
        if not (np.all(np.isfinite(M)) and np.all(np.isfinite(D))):
            break
        step = complex(M[0, 0] / D[0, 0]) if M.shape == (1, 1) else _chosen(M, D, joint, reach * abs(s))
        if not np.isfinite(step):
            break
        if abs(step) > reach * abs(s):
            step *= reach * abs(s) / abs(step)
        s -= step
        if abs(step) < 1e-13 * abs(s):
            return s
    return complex(np.nan, np.nan)


def _chosen(M: Complexes, D: Complexes, joint: int | None, reach: float) -> complex:
    """Theta of M v = theta D v: the nearest, or of those within reach the one with most of v at a joint."""
    solved, fault = lapack.zgesv(M, D)[2:]
    if fault > 0:
        return complex(np.nan)
    inverse, _, vectors, fault = lapack.zgeev(solved, compute_vl=0)
    if fault > 0 or not inverse.any():
        return complex(np.nan)
    theta = 1 / np.where(inverse == 0, 1e-300, inverse)
    nearest = int(np.argmin(np.abs(theta)))
    if joint is None:
        return complex(theta[nearest])
    share = np.abs(vectors[joint]) / np.sqrt(np.sum(np.abs(vectors) ** 2, axis=0))
    share = np.where(np.abs(theta) < reach, share, 0.0)
    return complex(theta[int(np.argmax(share))] if share.any() else theta[nearest])
