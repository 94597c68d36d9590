"""Assembled second-order systems solved directly: the references that know nothing of modes or constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Matrices(NamedTuple):
    """M x'' + C x' + K x = f: kg, N s/m, N/m."""

    M: Floats
    C: Floats
    K: Floats


def chain(
    masses: Sequence[float], dashpots: Sequence[float], springs: Sequence[float], *, wall: str = "left"
) -> Matrices:
    """Masses in a row; one link per mass, the odd one to a wall on the ``left`` or the ``right``.

    Parameters
    ----------
    masses : n, kg.
    dashpots, springs : n links in their order from left to right, N s/m and N/m.
    """
    n = len(masses)
    if not len(dashpots) == len(springs) == n:
        raise ValueError("a chain to one wall has as many links as masses")
    stretch = np.eye(n) - np.eye(n, k=-1) if wall == "left" else np.eye(n) - np.eye(n, k=1)
    return Matrices(
        np.diag(np.asarray(masses, dtype=np.float64)),
        stretch.T @ np.diag(dashpots) @ stretch,
        stretch.T @ np.diag(springs) @ stretch,
    )


def joined(parts: Sequence[Matrices], maps: Sequence[ArrayLike]) -> Matrices:
    """Assemble parts whose dofs are x_part = map x: sum of map^T (M, C, K) map."""
    L = [np.asarray(m, dtype=np.float64) for m in maps]
    return Matrices(*(
        np.sum([a.T @ part[i] @ a for part, a in zip(parts, L, strict=True)], axis=0) for i in range(3)
    ))  # fmt: skip


def state_matrix(system: Matrices) -> Floats:
    """(2n, 2n) A of (x, x')' = A (x, x')."""
    n = len(system.M)
    stiff, loss = sla.solve(system.M, system.K), sla.solve(system.M, system.C)
    return np.block([[np.zeros((n, n)), np.eye(n)], [-stiff, -loss]])


def poles(system: Matrices) -> Complexes:
    """Poles with positive imaginary part, 1/s, by rising size."""
    values = np.asarray(sla.eigvals(state_matrix(system)), dtype=np.complex128)
    values = values[values.imag > 0]
    return values[np.argsort(np.abs(values))]


def free_motion(system: Matrices, x0: ArrayLike, v0: ArrayLike, dt: float, n: int) -> Floats:
    """(n, 2 n_dof) x and x' at t = 0, dt, ... from one matrix exponential.

    Powers are taken by doubling, so that rounding grows with log n only.
    """
    step = sla.expm(state_matrix(system) * dt)
    out = np.concatenate([np.asarray(x0, dtype=np.float64), np.asarray(v0, dtype=np.float64)])[None]
    while len(out) < n:
        out = np.concatenate([out, out @ step.T])
        step = step @ step
    return out[:n]


def receptance(system: Matrices, s: ArrayLike, output: int, source: int) -> Complexes:
    """(n,) displacement of dof `output` per force on dof `source` at complex frequencies s, 1/s (m/N)."""
    values = np.atleast_1d(np.asarray(s, dtype=np.complex128))
    dynamic = values[:, None, None] ** 2 * system.M + values[:, None, None] * system.C + system.K
    unit = np.zeros((len(system.M), 1))
    unit[source] = 1.0
    return np.asarray([sla.solve(D, unit)[output, 0] for D in dynamic])


def modal_receptance(system: Matrices, s: ArrayLike, output: ArrayLike, source: ArrayLike) -> Complexes:
    """(n,) displacement along `output` per force along `source`, both (n_dof,), from one eigenproblem: for many s."""
    values, vectors, scale = _eigenvectors(system)
    n = len(system.M)
    scatter = scale * np.concatenate([np.zeros(n), sla.solve(system.M, np.asarray(source, dtype=np.float64))])
    residue = (np.asarray(output) @ vectors[:n]) * sla.solve(vectors, scatter)
    return np.asarray(np.sum(residue / (np.atleast_1d(s)[:, None] - values), axis=1), dtype=np.complex128)


def _eigenvectors(system: Matrices) -> tuple[Complexes, Complexes, Floats]:
    """Poles and eigenvectors of the state (x, x' scaled): velocities in units of the highest rate, for their sake."""
    n = len(system.M)
    scale = np.concatenate([np.ones(n), np.full(n, 1 / np.sqrt(sla.norm(sla.solve(system.M, system.K), 2)))])
    values, vectors = sla.eig(scale[:, None] * state_matrix(system) / scale)
    return values, vectors, scale


def ramp_and_release(
    system: Matrices, direction: ArrayLike, rate: float, release: float, times: ArrayLike, output: ArrayLike
) -> Floats:
    """Displacement under a force that grows from zero and is let go, from the eigenvectors of the system.

    Parameters
    ----------
    direction : (n_dof,) share of each dof in the force.
    rate : N/s, until `release`, s.
    times : (n,) s.
    output : (n_dof,) share of each dof in the displacement.

    Returns
    -------
    (n,) m.
    """
    n = len(system.M)
    values, vectors, scale = _eigenvectors(system)
    scatter = scale * np.concatenate([np.zeros(n), sla.solve(system.M, np.asarray(direction, dtype=np.float64))])
    driven = rate * sla.solve(vectors, scatter)
    t = np.asarray(times, dtype=np.float64)
    decayed = np.minimum(t, release)[:, None] * values
    ramp = driven * (np.expm1(decayed) - decayed) / values**2
    free = np.exp(np.maximum(t - release, 0.0)[:, None] * values)
    return np.asarray(((ramp * free) @ (np.asarray(output) @ vectors[:n])).real)
