"""Known forces in time, compiled to what a stepper adds to its modes: exact for any piecewise quadratic force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import ModalBasis
from tonewood.numerics.propagator import apply, flow, polynomial_injection, real_form
from tonewood.numerics.system import Injection

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Piece:
    """F(t) = c0 + c1 (t - start) + c2 (t - start)^2 for start <= t < stop; s, N, N/s, N/s^2."""

    start: float
    stop: float
    c0: float
    c1: float = 0.0
    c2: float = 0.0

    def shifted(self, by: float) -> tuple[float, float, float]:
        """Coefficients about start + by."""
        return self.c0 + by * (self.c1 + by * self.c2), self.c1 + 2 * by * self.c2, self.c2


def compile_force(
    component: str,
    basis: ModalBasis,
    point: str,
    pieces: Sequence[Piece],
    dt: float,
    *,
    time: float = 0.0,
    first: int | None = None,
    factor: float = 1.0,
) -> list[Injection]:
    """Injections of a force on one point.

    Steps that lie inside one piece share three vectors (constant, linear and quadratic part); a step with a
    breakpoint gets a vector of its own, to which each part of the step adds exactly.

    Parameters
    ----------
    pieces : in time order, not overlapping, times relative to `time`.
    dt : s, step.
    time : s, absolute time of the pieces' origin; step n is [n dt, (n + 1) dt].
    first : earliest step to compile (absolute); what lies before it is left out.
    factor : multiplies the force.
    """
    B = real_form(basis).B[basis.index(point)] * factor
    whole: dict[int, tuple[float, float, float]] = {}
    broken: dict[int, Floats] = {}
    for piece in pieces:
        begin, end = (time + piece.start) / dt, (time + piece.stop) / dt
        if not end > begin:
            continue
        n0, n1 = int(np.floor(begin)), int(np.ceil(end))
        for n in range(n0 if first is None else max(n0, first), n1):
            a, b = max(begin - n, 0.0), min(end - n, 1.0)
            if b <= a:
                continue
            coefficients = piece.shifted((n + a - begin) * dt)
            if a == 0.0 and b == 1.0:
                whole[n] = coefficients
            else:
                part = polynomial_injection(basis, B, dt, a * dt, b * dt, coefficients)
                broken[n] = broken.get(n, 0.0) + part
    out = [Injection(component, n, v[None], np.ones((1, 1))) for n, v in sorted(broken.items())]
    if whole:
        start, stop = min(whole), max(whole) + 1
        values = np.zeros((3, stop - start))
        for n, c in whole.items():
            values[:, n - start] = c
        _, p1, p2, p3 = flow(basis, dt, 3)
        vectors = np.stack([apply(dt * p1, B), apply(dt**2 * p2, B), apply(2 * dt**3 * p3, B)])
        used = np.any(values != 0.0, axis=1)
        if used.any():
            out.append(Injection(component, start, vectors[used], values[used]))
    return out
