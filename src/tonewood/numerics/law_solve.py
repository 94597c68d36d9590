"""Forces of nonlinear laws over one step, all gaps at once: what the kernel does, in NumPy and without hurry.

The linear connections are eliminated, so the gaps move to g+ = g_u + Z f with one symmetric, positive semi-definite Z.
Laws with a potential see p = offset - g and are solved together by Newton's method on

    r = f(p) - f,   p = p_u - Z f,      df = r - s (I + s Z s)^-1 s Z r,   s = sqrt(df/dp),

which never inverts Z, made safe by a search along the step: the slope of the convex function behind the equation,
(Z df) . (f - f(p)), must have shrunk or turned. Friction is solved gap by gap, exactly, in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.laws import Friction, NonlinearLaw, PotentialLaw

Floats = NDArray[np.float64]

#: of the displacement that the forces make, and of the gaps themselves (rounding)
TOLERANCE, ROUNDING = 1e-12, 4e-16
MAX_ITERATIONS, MAX_SWEEPS = 100, 200


@dataclass(frozen=True, eq=False)
class Drives:
    """Where the partners of nonlinear laws are over one step.

    Attributes
    ----------
    offset, offset_after : (k,) m at the beginning and the end of the step.
    velocity : (k,) m/s of friction's partner.
    scale : (k,) factor on the force of the law.
    """

    offset: Floats
    offset_after: Floats
    velocity: Floats
    scale: Floats


@dataclass(frozen=True, eq=False)
class Solution:
    """Forces (k,) N, relative velocities of friction laws (k,) m/s, Newton iterations, and whether they converged."""

    forces: Floats
    slip: Floats
    iterations: int
    converged: bool


def find_forces(
    laws: Sequence[NonlinearLaw], Z: Floats, free: Floats, gap: Floats, dt: float, drives: Drives, guess: Floats,
    slip: Floats,
) -> Solution:  # fmt: skip
    """Find the forces of all laws over one step.

    Parameters
    ----------
    laws : k laws.
    Z : (k, k) m/N.
    free, gap : (k,) m, g_u and g.
    guess : (k,) N, where to start: the forces of the step before.
    slip : (k,) m/s, relative velocities of the step before.
    """
    sliding = [j for j, law in enumerate(laws) if isinstance(law, Friction)]
    stored = np.array([j for j, law in enumerate(laws) if not isinstance(law, Friction)], dtype=np.intp)
    potentials = [law for law in laws if not isinstance(law, Friction)]
    f, velocities, iterations, converged = guess.copy(), slip.copy(), 0, True
    old = (drives.offset - gap)[stored]
    noise = ROUNDING * float(np.max(np.abs([free, gap, drives.offset_after]), initial=0.0))
    for _sweep in range(MAX_SWEEPS):
        before = f.copy()
        for j in sliding:
            law = laws[j]
            assert isinstance(law, Friction)
            mobility, normal = Z[j, j] / dt, law.normal_force * drives.scale[j]
            without = (free[j] + Z[j] @ f - Z[j, j] * f[j] - gap[j]) / dt - drives.velocity[j]
            velocities[j] = law.velocity_after(without, mobility * normal, slip[j])
            f[j] = (velocities[j] - without) / mobility if mobility > 0 else 0.0
        if stored.size:
            rest = drives.offset_after - free
            if sliding:
                rest = rest - Z[:, sliding] @ f[sliding]
            f[stored], count, converged = newton(
                potentials, Z[np.ix_(stored, stored)], rest[stored], old, dt, drives.scale[stored], f[stored], noise
            )
            iterations += count
        if not sliding or len(laws) == 1 or not converged:
            break
        moved = float(np.abs(Z @ (f - before)).max())
        if moved <= TOLERANCE * float(np.abs(Z @ f).max()) + noise:
            break
    else:
        converged = False
    return Solution(f, velocities, iterations, converged)


def newton(
    laws: Sequence[PotentialLaw], Z: Floats, free: Floats, old: Floats, dt: float, scale: Floats, guess: Floats,
    noise: float,
) -> tuple[Floats, int, bool]:  # fmt: skip
    """Solve f = scale f_law(p), p = free - Z f; see the module. `noise` : m, rounding of `free`."""
    import scipy.linalg as sla

    def evaluate(p: Floats) -> tuple[Floats, Floats]:
        pairs = [law.force(float(a), float(b), dt) for law, a, b in zip(laws, p, old, strict=True)]
        both = np.array(pairs).reshape(len(laws), 2) * scale[:, None]
        return both[:, 0], both[:, 1]

    f = guess.copy()
    p = free - Z @ f
    law_force, slope = evaluate(p)
    for iteration in range(MAX_ITERATIONS + 1):
        r = law_force - f
        if not np.all(np.isfinite(r)):
            return f, iteration, False
        if np.abs(Z @ r).max(initial=0.0) <= TOLERANCE * np.abs(free - p).max(initial=0.0) + noise:
            return f, iteration, True
        s = np.sqrt(slope)
        inner = np.eye(len(laws)) + s[:, None] * Z * s
        step = r - s * sla.solve(inner, s * (Z @ r), assume_a="pos")
        moved = Z @ step
        start, t = float(moved @ (f - law_force)), 1.0
        for _ in range(60):
            p_try = p - t * moved
            law_force, slope = evaluate(p_try)
            along = float(moved @ (f + t * step - law_force))
            if along < 0 or abs(along) <= 0.9 * abs(start):
                break
            t *= 0.5
        f, p = f + t * step, p_try
    return f, MAX_ITERATIONS, False
