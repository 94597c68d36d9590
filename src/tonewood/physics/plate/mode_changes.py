"""How modes change with a parameter p: derivatives of eigenvalues and shapes, by modal expansion.

Modes (K - lambda_i M) z_i = 0 with Z^T M Z = 1 change by

    lambda_i' = z_i^T (K' - lambda_i M') z_i,    z_i' = sum_j c_ji z_j + y_i,
    c_ji = z_j^T (K' - lambda_i M') z_i / (lambda_i - lambda_j),    c_ii = -z_i^T M' z_i / 2

over the modes j that are known; y_i is the share of all others, (K - lambda_i M) y_i = -(K' - lambda_i M') z_i in their
space. Modes of one eigenvalue are first turned so that Z^T (K' - lambda M') Z is diagonal among them: its values are
their lambda', and c_ji = -z_j^T M' z_i / 2 between them. The turned shapes are those into which the parameter splits
them.

Sources: R. L. Fox and M. P. Kapoor, AIAA J. 6 (1968) 2426, equations 7 and 17; R. B. Nelson, AIAA J. 14 (1976) 1201;
for equal eigenvalues W. C. Mills-Curran, AIAA J. 26 (1988) 867; for y the power series of M. A. Akgün, Int. J. Numer.
Methods Eng. 37 (1994) 941.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tonewood.support.arrays import Floats

#: relative distance of eigenvalues below which they count as one
SAME = 1e-9
#: largest error of y, of its first term
_TOLERANCE = 1e-9
_ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class ModeChange:
    """Modes and their derivatives with respect to one parameter.

    vectors : (n, m) shapes, turned among those of one eigenvalue.
    values_rate : (m,) lambda'.
    vectors_rate : (n, m) z'.
    """

    vectors: Floats
    values_rate: Floats
    vectors_rate: Floats


def clusters(values: Floats) -> list[slice]:
    """Runs of ascending eigenvalues that count as one."""
    scale = np.maximum(np.abs(values[1:]), np.abs(values).max(initial=0.0) * 1e-12)
    starts = [0, *(1 + np.flatnonzero(np.diff(values) > SAME * scale)).tolist(), len(values)]
    return [slice(a, b) for a, b in pairwise(starts) if b > a]


def mode_change(
    values: Floats,
    vectors: Floats,
    stiffness_rate: Floats,
    mass_rate: Floats,
    mass: Any,
    others: Callable[[Floats], Floats],
    shift: float,
    count: int,
) -> ModeChange:
    """Differentiate the first `count` modes.

    values, vectors : (m,) lambda, ascending, and (n, m) shapes with Z^T M Z = 1; more than `count`, the better by far.
    stiffness_rate, mass_rate : (n, m) K' Z and M' Z.
    mass : M, with ``@``.
    others : (K + shift M)^-1 applied to (n, k).
    shift : 1/s^2, 0 or more.
    count : number of modes to differentiate; one eigenvalue more makes the series for y converge.
    """
    z, k_z, m_z = vectors.copy(), stiffness_rate.copy(), mass_rate.copy()
    groups = clusters(values)
    for group in groups:
        if group.stop - group.start > 1:
            lam = float(values[group].mean())
            inner = z[:, group].T @ (k_z[:, group] - lam * m_z[:, group])
            _, turn = np.linalg.eigh(0.5 * (inner + inner.T))
            for a in (z, k_z, m_z):
                a[:, group] = a[:, group] @ turn
    force = k_z[:, :count] - values[:count] * m_z[:, :count]
    projected = z.T @ force
    gap = values[None, :count] - values[:, None]
    together = np.zeros(gap.shape, dtype=bool)
    for group in groups:
        together[group, slice(group.start, min(group.stop, count))] = True
    overlap = z.T @ m_z[:, :count]
    c = np.where(together, -0.5 * overlap, projected / np.where(together, 1.0, gap))
    rest = _others(force, values[:count], z, mass, others, shift)
    return ModeChange(z[:, :count], projected.diagonal().copy(), z @ c + rest)


def _others(
    force: Floats, values: Floats, z: Floats, mass: Any, others: Callable[[Floats], Floats], shift: float
) -> Floats:
    """Share y of the modes that are not known: y <- S (-force + (lambda + s^2) M y), without the known ones."""
    m_z = np.asarray(mass @ z)

    def without(y: Floats) -> Floats:
        return y - z @ (m_z.T @ y)

    step = y = without(others(-force))
    first = np.linalg.norm(y, axis=0)
    for _ in range(_ITERATIONS):
        step = without(others(np.asarray(mass @ step) * (values + shift)))
        y = y + step
        if np.all(np.linalg.norm(step, axis=0) <= _TOLERANCE * np.maximum(first, 1e-300)):
            break
    return y
