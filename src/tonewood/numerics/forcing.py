"""Known forces in time, compiled to what a stepper adds to its modes: exact for any piecewise quadratic force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import PAIR, ModalBasis
from tonewood.numerics.propagator import apply, flow, phi, polynomial_injection, real_form
from tonewood.numerics.system import Injection

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Segment:
    """A known force F(t) = c0 + c1 (t - start) + c2 (t - start)^2 for start <= t < stop; s, N, N/s, N/s^2."""

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
    pieces: Sequence[Segment],
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
    whole: list[tuple[int, Floats]] = []  # first step, (3, n) coefficients at the beginning of each step
    parts: list[tuple[int, float, float, tuple[float, float, float]]] = []  # step, begin and end in it, coefficients
    for piece in pieces:
        begin, end = (time + piece.start) / dt, (time + piece.stop) / dt
        if not end > begin:
            continue
        n0, n1 = int(np.floor(begin)), int(np.ceil(end))
        full0, full1 = int(np.ceil(begin)), int(np.floor(end))
        for n in sorted({n0, n1 - 1} - set(range(full0, full1))):
            if first is None or n >= first:
                a, b = max(begin - n, 0.0), min(end - n, 1.0)
                parts.append((n, a * dt, b * dt, piece.shifted((n + a - begin) * dt)))
        full0 = full0 if first is None else max(full0, first)
        if full1 > full0:
            at = (np.arange(full0, full1) - begin) * dt
            c1 = piece.c1 + 2 * piece.c2 * at
            coefficients = np.stack([piece.c0 + at * (piece.c1 + piece.c2 * at), c1, np.full(at.shape, piece.c2)])
            whole.append((full0, coefficients))
    broken: dict[int, Floats] = {}
    for (n, *_), added in zip(parts, _partial_steps(basis, B, dt, [p[1:] for p in parts]), strict=True):
        broken[n] = broken.get(n, 0.0) + added
    out = [Injection(component, n, v[None], np.ones((1, 1))) for n, v in sorted(broken.items())]
    if whole:
        start, stop = min(n for n, _ in whole), max(n + c.shape[1] for n, c in whole)
        values = np.zeros((3, stop - start))
        for n, coefficients in whole:
            values[:, n - start : n - start + coefficients.shape[1]] += coefficients
        _, p1, p2, p3 = flow(basis, dt, 3)
        vectors = np.stack([apply(dt * p1, B), apply(dt**2 * p2, B), apply(2 * dt**3 * p3, B)])
        used = np.any(values != 0.0, axis=1)
        if used.any():
            out.append(Injection(component, start, vectors[used], values[used]))
    return out


def _partial_steps(
    basis: ModalBasis, B: Floats, dt: float, parts: Sequence[tuple[float, float, tuple[float, float, float]]]
) -> list[Floats]:
    """What `polynomial_injection` gives for each part (start, stop, coefficients) of a step; pairs all at once."""
    if not parts or np.any(basis.kind != PAIR):
        return [polynomial_injection(basis, B, dt, *part) for part in parts]
    start, stop = np.array([p[:2] for p in parts]).T
    d, rest = (stop - start)[:, None], np.maximum(dt - stop, 0.0)[:, None]
    c0, c1, c2 = np.array([p[2] for p in parts]).T[:, :, None]
    _, p1, p2, p3 = phi(3, basis.poles * d)
    added = (d * (c0 * p1 + d * (c1 * p2 + 2 * d * c2 * p3))) * np.exp(basis.poles * rest) * (B[:, 0] + 1j * B[:, 1])
    return list(np.stack([added.real, added.imag], axis=-1))
