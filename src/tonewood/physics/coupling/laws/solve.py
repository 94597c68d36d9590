"""Forces of nonlinear laws over one step, all gaps at once: in NumPy, as the reference of the kernel.

The linear connections are eliminated, so the gaps move to g+ = g_u + Z f with one symmetric, positive semi-definite Z.
Laws with a potential see p = offset - g and are solved together by Newton's method on

    r = f(p) - f,   p = p_u - Z f,      df = r - s (I + s Z s)^-1 s Z r,   s = sqrt(df/dp),

which never inverts Z, made safe by a search along the step: the slope of the convex function behind the equation,
(Z df) . (f - f(p)), must have shrunk or turned. Friction is solved gap by gap, exactly, in between
(`laws.friction`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.laws.base import NonlinearLaw, PotentialLaw
from tonewood.physics.coupling.laws.friction import FrictionBranch
from tonewood.support.arrays import Floats

#: of the displacement that the forces make, and of the gaps themselves (rounding)
TOLERANCE, ROUNDING = 1e-12, 4e-16
MAX_ITERATIONS, MAX_SWEEPS = 100, 200
#: before friction forces are found by Newton's method where going from law to law does not end
FEW_SWEEPS = 10


@dataclass(frozen=True, eq=False)
class Partners:
    """Prescribed motion of the partners of nonlinear laws over one step.

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
    """Forces (k,) N, Newton iterations, and whether they converged."""

    forces: Floats
    iterations: int
    converged: bool


def find_forces(
    laws: Sequence[NonlinearLaw], Z: Floats, free: Floats, gap: Floats, dt: float, partners: Partners, guess: Floats,
    branches: Mapping[int, FrictionBranch], *, careful: bool = False,
) -> Solution:  # fmt: skip
    """Find the forces of all laws over one step.

    laws : k laws.
    Z : (k, k) m/N.
    free, gap : (k,) m, g_u and g.
    guess : (k,) N, where to start: the forces of the step before.
    branches : of the friction laws, by connection; open ones are decided.
    careful : friction forces are found by Newton's method, damped, where going from law to law does not end.
    """
    stored = np.array([j for j, law in enumerate(laws) if isinstance(law, PotentialLaw)], dtype=np.intp)
    potentials = [law for law in laws if isinstance(law, PotentialLaw)]
    f, iterations, converged = guess.copy(), 0, True
    sliding = list(branches)
    careful = careful and bool(sliding) and len(laws) > 1
    old = (partners.offset - gap)[stored]
    noise = ROUNDING * float(np.max(np.abs([free, gap, partners.offset_after]), initial=0.0))
    for _sweep in range(FEW_SWEEPS if careful else MAX_SWEEPS):
        before = f.copy()
        for j, friction in branches.items():
            without = (free[j] + Z[j] @ f - Z[j, j] * f[j] - gap[j]) / dt - partners.velocity[j]
            friction.meet(float(without), float(Z[j, j]) / dt)
            f[j] = friction.force
        if stored.size:
            rest = partners.offset_after - free
            if sliding:
                rest = rest - Z[:, sliding] @ f[sliding]
            f[stored], count, converged = newton(
                potentials, Z[np.ix_(stored, stored)], rest[stored], old, dt, partners.scale[stored], f[stored], noise
            )
            iterations += count
        if not sliding or len(laws) == 1 or not converged:
            break
        moved = float(np.abs(Z @ (f - before)).max())
        if moved <= TOLERANCE * float(np.abs(Z @ f).max()) + noise:
            break
    else:
        converged = False
    if careful and not converged:
        return _find_friction(laws, Z, free, gap, dt, partners, f, branches, stored, noise)
    return Solution(f, iterations, converged)


def _find_friction(
    laws: Sequence[NonlinearLaw], Z: Floats, free: Floats, gap: Floats, dt: float, partners: Partners, guess: Floats,
    branches: Mapping[int, FrictionBranch], stored: NDArray[np.intp], noise: float,
) -> Solution:  # fmt: skip
    """Find the forces by damped Newton iterations on the friction forces, on their branches, with contacts for each.

    The residual of a friction force is the force that `FrictionBranch.meet` gives for the motion, less that force; it
    answers a change of friction forces through the compliance that contacts leave, at their slopes.
    """
    from tonewood.support.scipy_linalg import sla

    potentials = [laws[j] for j in stored]
    sliding = np.array(list(branches), dtype=np.intp)
    mobilities = Z[sliding, sliding] / dt
    old, scale = (partners.offset - gap)[stored], partners.scale[stored]
    iterations = 0

    def wrong(f: Floats) -> tuple[Floats, bool]:
        """Set the forces of contacts in f; return the residual of friction, m/s, and whether contacts were found."""
        nonlocal iterations
        converged = True
        if stored.size:
            rest = (partners.offset_after - free - Z[:, sliding] @ f[sliding])[stored]
            f[stored], count, converged = newton(
                potentials, Z[np.ix_(stored, stored)], rest, old, dt, scale, f[stored], noise
            )  # fmt: skip
            iterations += count
        without = (free + Z @ f - gap)[sliding] / dt - mobilities * f[sliding] - partners.velocity[sliding]
        for friction, v, mobility in zip(branches.values(), without, mobilities, strict=True):
            friction.meet(float(v), float(mobility))
        return mobilities * (np.array([friction.force for friction in branches.values()]) - f[sliding]), converged

    f = guess.copy()
    r, converged = wrong(f)
    for _ in range(MAX_ITERATIONS):
        displaced = float(np.abs(Z @ f).max())
        if converged and float(np.abs(r).max()) * dt <= TOLERANCE * displaced + noise:
            return Solution(f, iterations, True)
        p = (partners.offset_after - free - Z @ f)[stored]
        slope = np.array([law.force(float(a), float(b), dt)[1] for law, a, b in zip(potentials, p, old, strict=True)])
        root = np.sqrt(slope * scale)
        inner = np.eye(len(stored)) + root[:, None] * Z[np.ix_(stored, stored)] * root
        across = root[:, None] * Z[np.ix_(stored, sliding)]
        answers = (Z[np.ix_(sliding, sliding)] - across.T @ sla.solve(inner, across, assume_a="pos")) / dt
        kept = np.array([1.0 - friction.follows() for friction in branches.values()])
        jacobian = -kept[:, None] * (answers - np.diag(mobilities)) - np.diag(mobilities)
        step, t, size = -sla.lstsq(jacobian, r)[0], 1.0, float(np.abs(r).max())
        for _halved in range(50):
            tried = f.copy()
            tried[sliding] += t * step
            r, converged = wrong(tried)
            if converged and float(np.abs(r).max()) < (1 - 1e-3 * t) * size:
                break
            t *= 0.5
        else:
            return Solution(f, iterations, False)
        f = tried
    return Solution(f, iterations, False)


def newton(
    laws: Sequence[PotentialLaw], Z: Floats, free: Floats, old: Floats, dt: float, scale: Floats, guess: Floats,
    noise: float,
) -> tuple[Floats, int, bool]:  # fmt: skip
    """Solve f = scale f_law(p), p = free - Z f; see the module. `noise` : m, rounding of `free`."""
    from tonewood.support.scipy_linalg import sla

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
        # effect of the rounding of p on the forces: that of a dashpot depends on small differences
        heard = np.abs(Z) @ (slope * np.maximum(np.abs(p), np.abs(old))) * ROUNDING
        if np.all(np.abs(Z @ r) <= TOLERANCE * np.abs(free - p).max(initial=0.0) + noise + heard):
            return f, iteration, True
        s = np.sqrt(slope)
        inner = np.eye(len(laws)) + s[:, None] * Z * s
        step = r - s * sla.solve(inner, s * (Z @ r), assume_a="pos")
        moved = Z @ step
        start, t = float(moved @ (f - law_force)), 1.0
        for _ in range(60):
            p_try = p - t * moved
            law_force, slope = evaluate(p_try)
            descent = float(moved @ (f + t * step - law_force))
            if descent < 0 or abs(descent) <= 0.9 * abs(start):
                break
            t *= 0.5
        f, p = f + t * step, p_try
    return f, MAX_ITERATIONS, False
