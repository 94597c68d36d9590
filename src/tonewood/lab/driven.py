"""Assembled systems under known forces, exactly: the matrix exponential carries the force along as states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

from tonewood.lab.assembled import Matrices, state_matrix
from tonewood.physics.stepping.forcing import Segment

Floats = NDArray[np.float64]


def triangle(peak: float, rise: float, fall: float) -> tuple[Segment, Segment]:
    """Force that rises linearly to `peak` (N) in `rise` s and falls to nothing in `fall` s."""
    return Segment(0.0, rise, 0.0, peak / rise), Segment(rise, rise + fall, peak, -peak / fall)


def force_at(pieces: Sequence[Segment], t: float) -> float:
    """Value of a piecewise quadratic force at a time, N."""
    for piece in pieces:
        if piece.start <= t < piece.stop:
            return piece.shifted(t - piece.start)[0]
    return 0.0


def driven_states(A: Floats, column: Floats, pieces: Sequence[Segment], dt: float, n: int, start: ArrayLike) -> Floats:
    """(n, n_states) x at 0, dt, ... of x' = A x + column F(t), exact for a piecewise quadratic F.

    Pieces must follow one another from time 0; their bounds need not lie on the grid.
    """
    size = len(A)
    big = np.zeros((size + 3, size + 3))
    big[:size, :size], big[:size, size] = A, column
    big[size, size + 1], big[size + 1, size + 2] = 1.0, 1.0
    cache: dict[float, Floats] = {}

    def over(duration: float) -> Floats:
        key = round(duration, 15)
        if key not in cache:
            cache[key] = sla.expm(big * duration)
        return cache[key]

    out = np.empty((n, size))
    out[0] = x = np.asarray(start, dtype=np.float64)
    bounds = sorted({edge for piece in pieces for edge in (piece.start, piece.stop)})
    driven = min(n, int(np.ceil(max(bounds, default=0.0) / dt - 1e-9)) + 1)
    for step in range(1, driven):
        t, end = (step - 1) * dt, step * dt
        for edge in [b for b in bounds if t + 1e-12 * dt < b < end - 1e-12 * dt] + [end]:
            piece = next((p for p in pieces if p.start - 1e-12 * dt <= t < p.stop - 1e-12 * dt), None)
            c = (0.0, 0.0, 0.0) if piece is None else piece.shifted(t - piece.start)
            x = (over(edge - t) @ np.concatenate([x, [c[0], c[1], 2 * c[2]]]))[:size]
            t = edge
        out[step] = x
    power, known = over(dt)[:size, :size], driven - 1
    while known < n - 1:
        # free motion, doubled: samples driven-1 .. known give those that follow
        more = min(known - driven + 2, n - 1 - known)
        out[known + 1 : known + 1 + more] = out[driven - 1 : driven - 1 + more] @ power.T
        known += more
        power = power @ power
    return out


def driven_motion(
    system: Matrices, direction: ArrayLike, pieces: Sequence[Segment], dt: float, n: int, start: ArrayLike | None = None
) -> Floats:
    """(n, 2 n_dof) x and x' of M x'' + C x' + K x = direction F(t).

    Parameters
    ----------
    direction : (n_dof,).
    pieces : F(t), N.
    start : (2 n_dof,) x and x' at time 0, rest if left out.
    """
    column = np.concatenate([np.zeros(len(system.M)), sla.solve(system.M, np.asarray(direction, dtype=np.float64))])
    first = np.zeros(column.size) if start is None else start
    return driven_states(state_matrix(system), column, pieces, dt, n, first)
