"""Assembled second-order systems solved directly: the references that know nothing of modes or constraints.

Free motion and known forces by matrix exponentials, which carry the force along as states; nonlinear ones by DOP853.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.errors import NumericalError
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.stepping.forcing import Segment
from tonewood.support.arrays import Complexes, Floats


class Matrices(NamedTuple):
    """M x'' + C x' + K x = f: kg, N s/m, N/m."""

    M: Floats
    C: Floats
    K: Floats


def chain(
    masses: Sequence[float], dashpots: Sequence[float], springs: Sequence[float], *, wall: str = "left"
) -> Matrices:
    """Masses in a row; one link per mass, the odd one to a wall on the ``left`` or the ``right``.

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

    direction : (n_dof,) share of each dof in the force.
    rate : N/s, until `release`, s.
    times : (n,) s.
    output : (n_dof,) share of each dof in the displacement.
    Returns (n,) m.
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
    power, last = over(dt)[:size, :size], driven - 1
    while last < n - 1:
        # free motion, doubled: samples driven-1 .. known give those that follow
        more = min(last - driven + 2, n - 1 - last)
        out[last + 1 : last + 1 + more] = out[driven - 1 : driven - 1 + more] @ power.T
        last += more
        power = power @ power
    return out


def driven_motion(
    system: Matrices, direction: ArrayLike, pieces: Sequence[Segment], dt: float, n: int, start: ArrayLike | None = None
) -> Floats:
    """(n, 2 n_dof) x and x' of M x'' + C x' + K x = direction F(t).

    direction : (n_dof,).
    pieces : F(t), N.
    start : (2 n_dof,) x and x' at time 0, rest if left out.
    """
    column = np.concatenate([np.zeros(len(system.M)), sla.solve(system.M, np.asarray(direction, dtype=np.float64))])
    first = np.zeros(column.size) if start is None else start
    return driven_states(state_matrix(system), column, pieces, dt, n, first)


def continuous_force(law: Contact | HardeningSpring, gap: float, rate: float) -> float:
    """Force of a law at a gap and its rate, N; it opens the gap where positive."""
    p, v = law.offset - gap, -rate
    if isinstance(law, Contact):
        return law.stiffness * p**law.exponent * (1 + law.loss * v) if p > 0 else 0.0
    spring = law.stiffness * p + law.cubic * p**3
    return spring + (law.damping + law.quadratic_damping * abs(v)) * v


def integrated(
    rate: Callable[[float, Floats], Floats], start: Floats, times: Floats, edges: Sequence[float] = (),
    *, rtol: float = 1e-12, atol: float = 1e-15,
) -> Floats:  # fmt: skip
    """(n, n_states) y at rising times of y' = rate(t, y) by DOP853, restarted at each of `edges` (s).

    Raises NumericalError : an interval cannot be integrated to that tolerance.
    """
    from scipy.integrate import solve_ivp

    out = np.empty((len(times), len(start)))
    out[0] = y = start
    last = float(times[-1])
    for a, b in pairwise(sorted({float(times[0]), last} | {e for e in edges if times[0] < e < last})):
        inside = np.flatnonzero((times > a) & (times <= b))
        # forces are continuous, so the value just inside the piece does at both of its ends
        stay = lambda t, y, a=a, b=b: rate(min(max(t, a), b - 1e-13), y)  # noqa: E731
        outputs = np.unique(np.concatenate([times[inside], [b]]))
        done = solve_ivp(stay, (a, b), y, method="DOP853", rtol=rtol, atol=atol, t_eval=outputs)
        if not done.success:
            raise NumericalError(f"the reference was not found: {done.message}")
        out[inside] = done.y.T[: inside.size]
        y = done.y[:, -1]
    return out
