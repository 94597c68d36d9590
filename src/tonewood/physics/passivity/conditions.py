"""Can a body given by modes create energy? Tests of a modal basis before it is allowed to sound.

A component with poles lambda and shapes r, l (``z' = lambda z + l f``, displacement ``y = sum c Re(r z)``) has the
mobility

    Y(s) = s sum_k r_k l_k^T / (s - lambda_k)        (both of each conjugate pair, m/(s N))

and is passive exactly when no pole lies in the right half plane, the Hermitian part of Y(j w) is positive
semidefinite at every w, and each undamped pole has a Hermitian positive semidefinite residue. Real modes of a
structure have this by construction; a truncated or measured list of complex modes has it hardly ever, because the
direct term D = 2 Re sum r l^T vanishes only for complete lists.

Method. If every mode is passive by itself, the basis is. Otherwise the frequencies where the Hermitian part can
change its signature are zeros of G(s) = Y(s) + Y(-s)^T, which are eigenvalues of the even ("Hamiltonian") pencil

    [ A  0    B   ]       [ I 0 0 ]
    [ 0 -A^T -C^T ]  - s  [ 0 I 0 ]        Boyd, Balakrishnan & Kabamba, Math. Control Signals Systems 2 (1989)
    [ C  B^T  D+D^T ]     [ 0 0 0 ]

Its direct term is singular, so it is inverted about a real shift s0, which leaves an ordinary matrix
``T = F + F [B; -C^T] G(s0)^-1 [C B^T] F``, F = (diag(A, -A^T) - s0)^-1, with eigenvalues 1/(s - s0); D is never
inverted. No eigenvalue is judged to lie on the imaginary axis or not: the imaginary parts of *all* cut the axis into
intervals in which the signature is constant, and the smallest eigenvalue of the Hermitian part is computed at each
cut (a touching point or a violation of any narrowness) and in each interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import conjugate_weights, extend, halve, real_form
from tonewood.physics.modal.mobility import (
    PORT_RANK,
    balanced,
    mobility,
    port_directions,
    port_scale,
    smallest_hermitian,
    step_gain,
)
from tonewood.support.arrays import Complexes, Floats

#: default tolerance: share of |Y| (or of the quantity it is compared with) by which a sign may be wrong. Rounding of a
#: 40-degree-of-freedom eigenproblem reaches 1e-11; the growth 1e-9 allows takes days to be heard.
TOLERANCE = 1e-9

#: |Re lambda| / |lambda| below which a pole counts as undamped
UNDAMPED = 1e-11

_STRUCTURAL = 1e-12  # share of a residue by which it may miss the form of a real mode
_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Violation:
    """A band in which the mobility creates power.

    lower_hz, upper_hz : its ends; the upper one is inf if the direct term is negative.
    worst_hz : where it is worst, among frequencies up to 30 times the highest pole.
    size : smallest eigenvalue of the Hermitian part of Y there, negated, relative to |Y| (Frobenius), ports scaled
        to equal mobility. For an undamped pole: the same of its residue.
    """

    lower_hz: float
    upper_hz: float
    worst_hz: float
    size: float


@dataclass(frozen=True)
class PassivityReport:
    """Result of `check`; plain data.

    faults : one clause per failed test; empty when the basis is passive.
    method : ``each mode`` (all passive by themselves) or ``pencil``; ``none`` if the list was not fit to be tested.
    right_rank, left_rank : dimensions of the port space that the right and left shapes span.
    ranks_agree : both span the same space.
    conjugate_misfit : largest misfit between a mode and its conjugate in a full list, 0 for a half list.
    unstable : (frequency in Hz, growth in 1/s) of each pole with Re lambda > 0.
    direct_term : norm of D = 2 Re sum r l^T relative to sum 2 |r| |l|.
    direct_min : smallest eigenvalue of its symmetric part, on the same scale.
    violations : bands where the Hermitian part of the mobility is negative, by frequency.
    dt : s, the step for which `step_compliance_min` was computed, or None.
    step_compliance_min : smallest eigenvalue of the symmetric part of Z = sum c Re(r W0 l^T), W0 = expm1(lambda dt)
        / lambda, relative to sum c |r| |W0| |l|, or None.
    """

    n_modes: int
    n_ports: int
    tolerance: float
    faults: tuple[str, ...]
    method: str
    right_rank: int
    left_rank: int
    ranks_agree: bool
    conjugate_misfit: float
    unstable: tuple[tuple[float, float], ...]
    direct_term: float
    direct_min: float
    violations: tuple[Violation, ...]
    dt: float | None
    step_compliance_min: float | None

    @property
    def passive(self) -> bool:
        """True if every test was passed."""
        return not self.faults

    @property
    def worst(self) -> float:
        """Size of the largest violation of the mobility, 0 if there is none."""
        return max((v.size for v in self.violations), default=0.0)

    def summary(self) -> str:
        """One line: passive, or the fault and its frequency or point."""
        return "passive" if self.passive else "not passive: " + "; ".join(self.faults)

    def require(self, *, file: str | None = None, key: str | None = None) -> None:
        """Raise PassivityError with the summary unless the basis is passive."""
        if not self.passive:
            raise PassivityError(self.summary(), file=file, key=key)


def check(
    poles: ArrayLike, right: ArrayLike, left: ArrayLike, *, dt: float | None = None, tolerance: float = TOLERANCE
) -> PassivityReport:
    """Test whether a component given by its modes is passive; see the module's head for the method.

    Parameters
    ----------
    poles : (n,) 1/s; one of each conjugate pair (Im > 0) and real poles (Im = 0), or a full list with both of each
        pair, whose closure under conjugation is then tested too.
    right, left : (n_ports, n) shapes of the ports where forces act; the normalisation is in the left ones.
    dt : s, step for which the step compliance is tested as well.
    tolerance : share of |Y(w)| by which its Hermitian part may be negative, of sum |r| |l| by which the direct term
        may, and of the step compliance; residues positive only to rounding pass.

    Returns
    -------
    PassivityReport. Nothing is raised for a bad basis: ask `PassivityReport.require`.

    Notes
    -----
    Results do not depend on the units of the ports: they are scaled to equal mobility first. A pole at zero counts
    as a pure dashpot (its mobility is constant); rigid-body modes are double poles and not of this form. About 1 s
    for 200 complex modes, instantly for real modes.
    """
    lam, r, l_ = (np.asarray(a, dtype=np.complex128) for a in (poles, right, left))
    if lam.ndim != 1 or r.ndim != 2 or r.shape != l_.shape or r.shape[1] != lam.size:
        raise ValueError(f"poles {lam.shape}, right {r.shape} and left {l_.shape} do not fit together")
    n_given, n_ports = lam.size, r.shape[0]
    if not all(bool(np.all(np.isfinite(a))) for a in (lam, r, l_)):
        return PassivityReport(
            n_given, n_ports, tolerance, ("a pole or shape is not a finite number",), "none",
            0, 0, False, 0.0, (), 0.0, 0.0, (), dt, None,
        )  # fmt: skip
    lam, r, l_, misfit = halve(lam, r, l_)
    faults: list[str] = []
    if misfit > math.sqrt(tolerance):
        faults.append(f"modes and their conjugates differ by {misfit:.2g}")

    scale = port_scale(lam, r, l_)
    r, l_ = r / scale[:, None], l_ / scale[:, None]
    r, l_ = balanced(r, l_)
    ports, amounts = port_directions(r, l_)
    floor = PORT_RANK * float(amounts.max(initial=0.0))
    right_rank, left_rank = _rank(r, floor), _rank(l_, floor)
    agree = right_rank == left_rank == amounts.size
    if not agree:
        faults.append(f"right shapes (rank {right_rank}) and left shapes (rank {left_rank}) span different port spaces")
    growing = np.flatnonzero(lam.real > UNDAMPED * np.abs(lam))
    unstable = tuple((float(lam[k].imag / (2 * np.pi)), float(lam[k].real)) for k in growing)
    if unstable:
        freq, rate = max(unstable, key=lambda pole: pole[1])
        faults.append(f"{len(unstable)} pole(s) grow, fastest {freq:.6g} Hz at {rate:.3g} 1/s")

    weight = conjugate_weights(lam)
    sizes = weight * np.linalg.norm(r, axis=0) * np.linalg.norm(l_, axis=0) if lam.size else np.zeros(0)
    total = float(np.sum(sizes)) or 1.0
    direct = ((r * weight) @ l_.T).real
    direct_term = float(np.linalg.norm(direct)) / total
    direct_min = smallest_hermitian(direct) / total
    if direct_min < -tolerance:
        faults.append(f"direct term 2 Re sum r l^T is negative, {direct_min:.3g} of sum 2 |r||l|")

    violations: tuple[Violation, ...] = ()
    method = "each mode"
    if unstable or not modal_partners(lam, r, l_)[0].all():
        method = "pencil"
        violations = _undamped_residues(lam, r, l_, tolerance) + _bands(
            lam, ports.T @ r, ports.T @ l_, direct_min < -tolerance, tolerance
        )
        violations = tuple(sorted(violations, key=lambda v: v.lower_hz))
    if violations:
        v = max(violations, key=lambda band: band.size)
        faults.append(
            f"mobility is negative in {len(violations)} band(s), worst {v.lower_hz:.6g} to {v.upper_hz:.6g} Hz: "
            f"{v.size:.3g} of |Y| at {v.worst_hz:.6g} Hz"
        )

    z_min = None
    if dt is not None:
        gain = step_gain(lam, dt)
        z_scale = float(np.sum(sizes * np.abs(gain))) or 1.0
        z_min = smallest_hermitian(((r * (weight * gain)) @ l_.T).real) / z_scale
        if z_min < -tolerance:
            faults.append(f"compliance over a step of {dt:.4g} s is negative, {z_min:.3g} of its terms")
    return PassivityReport(
        n_given, n_ports, tolerance, tuple(faults), method, right_rank, left_rank, agree, misfit, unstable,
        direct_term, direct_min, violations, dt, z_min,
    )  # fmt: skip


def modal_partners(poles: Complexes, right: Complexes, left: Complexes) -> tuple[NDArray[np.bool_], list[int]]:
    """Which modes of a half list are passive by themselves, to rounding, or with one partner.

    * a pair with r l^T = -i b phi phi^T, b >= 0, Re lambda <= 0: a real mode, Y = s phi phi^T / (m (s^2 + ...));
    * a real pole with r l^T positive semidefinite;
    * two real poles with opposite residues: an overdamped real mode.

    Returns (n,) passive or not, and for each mode the slow partner of an overdamped one, -1 for all others.
    """
    residues = np.einsum("ik,jk->kij", right, left)
    slack = _STRUCTURAL * np.abs(residues).sum(axis=(1, 2))
    symmetric = np.abs(residues - residues.transpose(0, 2, 1)).sum(axis=(1, 2)) <= slack
    trace = np.einsum("kii->k", residues)
    candidate = symmetric & (poles.real <= UNDAMPED * np.abs(poles))
    pair = poles.imag > 0.0
    imaginary = np.abs(residues.real).sum(axis=(1, 2)) <= slack
    passive = candidate & np.where(pair, imaginary & (trace.imag <= 0.0), trace.real >= 0.0)
    partner = [-1] * poles.size
    for k in np.flatnonzero(candidate & ~pair & ~passive):
        # H = N (lambda_k - lambda_j) / ((s - lambda_k)(s - lambda_j)) with N = r_k l_k^T, here negative
        opposite = np.abs(residues + residues[k]).sum(axis=(1, 2)) <= slack + slack[k]
        for j in np.flatnonzero(candidate & ~pair & opposite & (poles.real > poles[k].real)):
            if int(j) not in partner:
                passive[k], partner[k] = True, int(j)
                break
    return passive, partner


def _rank(shapes: Complexes, floor: float) -> int:
    """Dimension of the real port space that shapes span."""
    if shapes.size == 0:
        return 0
    return int(np.sum(np.linalg.svdvals(np.concatenate([shapes.real, shapes.imag], axis=1)) > floor))


def _undamped_residues(poles: Complexes, right: Complexes, left: Complexes, tolerance: float) -> tuple[Violation, ...]:
    """Undamped poles whose residue of the mobility, lambda sum r l^T, is not Hermitian positive semidefinite."""
    violations = []
    left_over = [int(k) for k in np.flatnonzero((np.abs(poles.real) <= UNDAMPED * np.abs(poles)) & (poles.imag > 0))]
    while left_over:
        first = poles[left_over[0]]
        group = [k for k in left_over if abs(poles[k] - first) <= 10 * UNDAMPED * abs(first)]
        left_over = [k for k in left_over if k not in group]
        residue = 1j * (right[:, group] @ left[:, group].T)  # of Y, without the positive factor |lambda|
        size = float(np.linalg.norm(residue)) or 1.0
        skew = float(np.linalg.norm(residue - residue.conj().T)) / (2 * size)
        worst = max(-smallest_hermitian(residue) / size, skew)
        if worst > tolerance:
            freq = float(first.imag / (2 * np.pi))
            violations.append(Violation(freq, freq, freq, worst))
    return tuple(violations)


def _bands(
    poles: Complexes, right: Complexes, left: Complexes, negative_at_infinity: bool, tolerance: float
) -> tuple[Violation, ...]:
    """Bands where the Hermitian part of the mobility of the damped modes is negative."""
    damped = (np.abs(poles.real) > UNDAMPED * np.abs(poles)) | (poles == 0)  # at zero: a constant mobility
    lam, r, l_ = poles[damped], right[:, damped], left[:, damped]
    if not lam.any() or r.shape[0] == 0:
        return ()

    full_poles, full_right, full_left = extend(lam, r, l_)
    sizes = np.linalg.norm(full_right, axis=0) * np.linalg.norm(full_left, axis=0)

    def excess(omega: Floats) -> Floats:
        """Smallest eigenvalue of the Hermitian part relative to |Y|, above the tolerance and the rounding."""
        y = mobility(lam, r, l_, omega)
        norm = np.sqrt((np.abs(y) ** 2).sum(axis=(1, 2)))
        rounding = _ROUNDING * np.array([w * np.sum(sizes / np.abs(1j * w - full_poles)) for w in omega])
        norm = np.maximum(norm, np.finfo(np.float64).tiny)
        smallest = np.array([smallest_hermitian(one) for one in y])
        return np.asarray(smallest / norm + tolerance + rounding / norm)

    lowest, highest = 1e-3 * float(np.abs(lam[lam != 0]).min()), 30.0 * float(np.abs(lam).max())
    cuts = np.concatenate([signature_changes(lam, r, l_), lam.imag, np.abs(lam), [lowest, highest]])
    cuts = np.unique(cuts[(cuts >= lowest) & (cuts <= highest)])
    grid = np.unique(np.concatenate([cuts, 0.5 * (cuts[1:] + cuts[:-1])]))
    values = excess(grid)

    violations = []
    negative = np.flatnonzero(values < 0.0)
    for run in np.split(negative, np.flatnonzero(np.diff(negative) > 1) + 1) if negative.size else []:
        first, last = int(run[0]), int(run[-1])
        lower = 0.0 if first == 0 else _crossing(excess, grid[first - 1], grid[first])
        ends_open = last == grid.size - 1
        upper = float(grid[last]) if ends_open else _crossing(excess, grid[last + 1], grid[last])
        worst_at = int(run[np.argmin(values[run])])
        around = max(lower, grid[max(worst_at - 1, 0)]), min(upper, grid[min(worst_at + 1, grid.size - 1)])
        worst, value = _lowest(excess, around, (float(grid[worst_at]), float(values[worst_at])))
        if ends_open and negative_at_infinity:
            upper = math.inf
        violations.append(Violation(lower / (2 * np.pi), upper / (2 * np.pi), worst / (2 * np.pi), tolerance - value))
    return tuple(violations)


def signature_changes(poles: Complexes, right: Complexes, left: Complexes) -> Floats:
    """All w >= 0, rad/s, at which the signature of Y(jw) + Y(jw)^H can change, and others that do no harm.

    Imaginary parts of all zeros of G(s) = Y(s) + Y(-s)^T, by the inverted pencil of the module's head.
    """
    form = real_form(poles, right, left)
    n = form.A.shape[0]
    C, D = form.C, form.D
    big_b = np.concatenate([form.B, -C.T])
    big_c = np.concatenate([C, form.B.T], axis=1)
    sizes = np.abs(poles[poles != 0])
    best: tuple[float, float, Floats] | None = None
    middle = math.sqrt(float(sizes.min()) * float(sizes.max()))
    for shift in (middle, 0.6180339887 * middle, 1.6180339887 * middle):
        solved = _solve_blocks(poles, shift, big_b, n)
        G = D + D.T - big_c @ solved
        condition = 1.0 / max(float(np.linalg.svdvals(G)[-1]), np.finfo(np.float64).tiny) * float(np.linalg.norm(G, 2))
        if best is None or condition < best[0]:
            best = condition, shift, G
    assert best is not None
    condition, shift, G = best
    if condition > 1e14:
        # a singular pencil: a generic small change keeps its regular eigenvalues (Hochstenbach, Mehl & Plestenjak 2019)
        G = G + 1e-13 * float(np.linalg.norm(G, 2)) * np.diag(np.linspace(1.0, 2.0, G.shape[0]))
    F = _solve_blocks(poles, shift, np.eye(2 * n), n)
    T = F + (F @ big_b) @ np.linalg.solve(G, big_c @ F)
    mu = np.linalg.eigvals(T)
    mu = mu[np.abs(mu) > 1e-12 * np.abs(mu).max()]
    return np.asarray(np.unique(np.abs((shift + 1.0 / mu).imag)))


def _solve_blocks(poles: Complexes, shift: float, rhs: Floats, n: int) -> Floats:
    """(diag(A, -A^T) - shift)^-1 rhs with the 2 x 2 blocks of `real_form`, by rows."""
    out = np.empty_like(rhs)
    pairs = np.flatnonzero(poles.imag > 0.0)
    reals = np.flatnonzero(poles.imag == 0.0)
    for offset, sign in ((0, 1.0), (n, -1.0)):
        # block [[a, -w], [w, a]] of A and [[-a, -w], [w, -a]] of -A^T
        a, w = sign * poles.real[pairs] - shift, poles.imag[pairs]
        det = (a**2 + w**2)[:, None]
        x, y = rhs[offset + pairs], rhs[offset + poles.size + np.arange(pairs.size)]
        out[offset + pairs] = (a[:, None] * x + w[:, None] * y) / det
        out[offset + poles.size + np.arange(pairs.size)] = (a[:, None] * y - w[:, None] * x) / det
        out[offset + reals] = rhs[offset + reals] / (sign * poles.real[reals] - shift)[:, None]
    return out


def _crossing(excess: Callable[[Floats], Floats], outside: float, inside: float) -> float:
    """Return the point at which the excess changes its sign between two points of known sign."""
    from scipy.optimize import brentq

    low, high = min(outside, inside), max(outside, inside)
    return float(brentq(lambda w: float(excess(np.array([w]))[0]), low, high, xtol=1e-14 * high, rtol=1e-14))


def _lowest(
    excess: Callable[[Floats], Floats], bounds: tuple[float, float], best: tuple[float, float]
) -> tuple[float, float]:
    """Lowest excess between two bounds: place and value, not above a known one."""
    from scipy.optimize import minimize_scalar

    low, high = bounds
    if not high > low:
        return best
    minimum = minimize_scalar(
        lambda w: float(excess(np.array([w]))[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-5 * (high - low)},
    )
    at, value = float(minimum.x), float(minimum.fun)
    return (at, value) if value < best[1] else best
