"""Mobility of a component from its modes, and the scaling of its ports."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.conjugates import extend
from tonewood.support.arrays import Complexes, Floats

#: share of the largest singular value at which a direction of the port space counts as absent
PORT_RANK = 1e-8


def mobility(poles: Complexes, right: Complexes, left: Complexes, omega: ArrayLike) -> Complexes:
    """Mobility Y(j w) = j w sum r l^T / (j w - lambda), conjugates included.

    poles, right, left : half list, (n,) 1/s and (n_ports, n).
    omega : (F,) rad/s.
    Returns (F, n_ports, n_ports), m/(s N).
    """
    s = 1j * np.atleast_1d(np.asarray(omega, dtype=np.float64))
    lam, r, l_ = extend(poles, right, left)
    out = np.empty((s.size, r.shape[0], r.shape[0]), dtype=np.complex128)
    rows = max(1, 2_000_000 // max(1, r.size))  # keeps the intermediate array below 32 MB
    for start in range(0, s.size, rows):
        part = s[start : start + rows]
        gain = part[:, None] / (part[:, None] - lam)
        out[start : start + rows] = (gain[:, None, :] * r) @ l_.T
    return out


def step_gain(poles: Complexes, dt: float) -> Complexes:
    """W0 = expm1(lambda dt) / lambda: a modal state's gain from a force held over one step.  (n,), s"""
    x = poles * dt
    safe = np.where(x == 0, 1.0, x)
    return np.asarray(dt * np.where(x == 0, 1.0, np.expm1(safe) / safe), dtype=np.complex128)


def port_scale(poles: Complexes, right: Complexes, left: Complexes) -> Floats:
    """Scale of each port, (n_ports,): square root of its mobility summed over the peaks; 1 for a dead port.

    Dividing the shapes by it makes results independent of the units and mobilities of the ports.
    """
    peak = np.abs(poles) / np.maximum(np.abs(poles.real), 1e-6 * np.abs(poles) + np.finfo(np.float64).tiny)
    scale = np.ones(right.shape[0])
    for _ in range(3):
        r, l_ = balanced(right / scale[:, None], left / scale[:, None])
        size = np.sqrt(((np.abs(r) ** 2 + np.abs(l_) ** 2) * np.maximum(peak, 1.0)).sum(axis=1))
        scale *= np.where(size > 0.0, size, 1.0)
    return scale


def port_directions(right: Complexes, left: Complexes) -> tuple[Floats, Floats]:
    """Orthonormal directions (n_ports, rank) in which ports move or are driven, and how much, (rank,)."""
    if right.size == 0:
        return np.zeros((right.shape[0], 0)), np.zeros(0)
    basis, values, _ = np.linalg.svd(
        np.concatenate([right.real, right.imag, left.real, left.imag], axis=1), full_matrices=False
    )
    rank = int(np.sum(values > PORT_RANK * values[0]))
    return basis[:, :rank], values[:rank]


def balanced(right: Complexes, left: Complexes) -> tuple[Complexes, Complexes]:
    """Shapes with each mode scaled so that its two have the same norm; residues stay."""
    norms = np.sqrt((np.abs(right) ** 2).sum(axis=0)), np.sqrt((np.abs(left) ** 2).sum(axis=0))
    alive = (norms[0] > 0) & (norms[1] > 0)
    gain = np.sqrt(np.divide(norms[1], norms[0], out=np.ones_like(norms[0]), where=alive))
    return right * gain, left / gain


def smallest_hermitian(matrix: NDArray[np.float64] | Complexes) -> float:
    """Smallest eigenvalue of the Hermitian part; 0 for an empty matrix."""
    if matrix.size == 0:
        return 0.0
    return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.conj().T))[0])
