"""The nearest passive body to a modal basis that is not quite one.

Poles and right shapes stay; the left shapes are replaced by

    l = X (r Lambda)^H,   X_ij = -Q_ij / (lambda_i + conj(lambda_j)),   Q >= 0,  Q r^H = 0      (full lists)

so that A X + X A^H = -Q: X^-1 / 2 is a storage function (Kalman-Yakubovich-Popov), the mobility has no negative
Hermitian part at any frequency, and the symmetric part of the direct term, -r Q r^H / 2, is zero. Every passive basis
with these poles and right shapes and without direct term is of this form, and l is linear in Q: the nearest one, in
the H2 norm of the mobility with ports scaled to equal mobility, is a convex problem. It is solved by accelerated
projected gradients (FISTA: Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009) 183; restarts: O'Donoghue & Candes, Found.
Comput. Math. 15 (2015) 715); the projection on the set of Q clips eigenvalues. The skew part of the direct term is
lossless; a mild penalty keeps it small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import conjugate_weights, extend, halve, real_form
from tonewood.physics.modal.mobility import PORT_RANK, mobility, port_scale
from tonewood.physics.passivity.conditions import UNDAMPED, PassivityReport, check
from tonewood.physics.passivity.storage import Storage, lyapunov_dissipation
from tonewood.support.arrays import Complexes, Floats

#: relative H2 change of the mobility above which a repair is refused
MAX_CHANGE = 0.1

_FLATTENINGS = (1.0, 0.5, 0.0)
_EVENING = 0.4  # 0: all modes on the scale of their energies, 0.5: all of equal weight
_PROPER = 1e-4  # share of sum |r||l| below which the skew direct term counts as gone
_TRIAL = 200  # iterations, at most, after which variants twice as far as the nearest are given up
_MARGIN = 1e-5  # loss added in every direction, relative to the modes' own, so that X is safely invertible


@dataclass(frozen=True, eq=False)
class RepairedBasis:
    """A passive basis, its storage function, and how far it is from the one given.

    poles, right, left : half list as given to `repair`, but for shapes; (n,) and (n_ports, n).
    storage : its storage function; states [z; conj(z_pairs)] of this list.
    flattening : share mu of the imaginary parts of the right shapes that was kept; 1: right shapes unchanged.
    pole_change : 0: poles are never moved.
    residue_change : change of the residues r l^T relative to them, root of sums of squares, ports scaled.
    mobility_change : change of the mobility relative to it in the H2 norm (strictly proper parts), ports scaled.
    peak_error_db : largest |change of Y| at any peak over the largest |Y|, 20 log10.
    peak_level_db : largest change of |Y| at a peak of the mobility, dB.
    direct_skew : remaining direct term (skew: lossless) relative to sum 2 |r||l|.
    iterations : of the solver, for the variant kept.
    before, after : reports of `physics.passivity.conditions.check`.
    """

    poles: Complexes
    right: Complexes
    left: Complexes
    storage: Storage
    flattening: float
    pole_change: float
    residue_change: float
    mobility_change: float
    peak_error_db: float
    peak_level_db: float
    direct_skew: float
    iterations: int
    before: PassivityReport
    after: PassivityReport

    def summary(self) -> str:
        """One line: how far poles, residues and mobility moved."""
        kept = "right shapes kept" if self.flattening == 1 else f"imaginary shapes times {self.flattening:g}"
        return (
            f"made passive: poles unchanged, {kept}, residues moved {self.residue_change:.2%}, "
            f"mobility {self.mobility_change:.2%} (H2), at its peaks {self.peak_error_db:.1f} dB"
        )


def repair(
    poles: ArrayLike,
    right: ArrayLike,
    left: ArrayLike,
    *,
    max_change: float = MAX_CHANGE,
    max_iterations: int | None = None,
) -> RepairedBasis:
    """Make a basis passive by the smallest change of its left shapes, or refuse.

    Three variants are tried: the right shapes as they are, and with their imaginary parts (once each mode's phase is
    turned to make them small) halved and removed; the one with the smallest change is kept. Deterministic.

    poles : (n,) 1/s, half or full list; all damped. Undamped poles and poles at zero have no place in a list of
        complex modes that needs repair.
    right, left : (n_ports, n) shapes.
    max_change : largest relative H2 change of the mobility that is accepted.
    max_iterations : of the solver for the variant kept; by default 300 to 3000, fewer the more modes.
    Raises PassivityError : a pole is not damped, the list is not closed under conjugation, or the change would exceed
        `max_change`.
    """
    before = check(poles, right, left)
    lam, r, l_, misfit = halve(*(np.asarray(a, dtype=np.complex128) for a in (poles, right, left)))
    if before.method == "none" or misfit > 1e-4 or before.unstable:
        raise PassivityError(f"cannot be repaired: {'; '.join(before.faults)}")
    if np.any(lam.real >= -UNDAMPED * np.abs(lam)):
        raise PassivityError("cannot be repaired: a pole is undamped; give every mode some damping")
    scale = port_scale(lam, r, l_)[:, None]
    right_scaled, left_scaled = r / scale, l_ / scale
    # a mode that is not driven or not seen at any port does nothing: it is kept, at rest
    active = (np.abs(r).sum(axis=0) > 0.0) & (np.abs(l_).sum(axis=0) > 0.0)
    if not active.any():
        raise PassivityError("cannot be repaired: no mode is both driven and seen at the ports")

    attempts = [_Nearest(lam[active], right_scaled[:, active], left_scaled[:, active], mu) for mu in _FLATTENINGS]
    limit = max_iterations or max(300, min(3000, 2_500_000 // lam.size**2))
    for share in (5, 3):
        for attempt in attempts:
            attempt.run(min(_TRIAL, limit // share))
        nearest = min(attempt.change() for attempt in attempts)
        attempts = [attempt for attempt in attempts if attempt.change() <= 2.0 * nearest]
    best = min(attempts, key=_Nearest.change)
    best.run(limit)
    new_right, new_left = right_scaled.copy(), np.zeros_like(left_scaled)
    new_right[:, active], new_left[:, active], P_active = best.result()

    rows = np.concatenate([active, active[lam.imag > 0.0]])
    P = np.zeros((rows.size, rows.size), dtype=np.complex128)
    P[np.ix_(rows, rows)] = P_active
    n_ports = r.shape[0]
    storage = Storage(
        P,
        lyapunov_dissipation(extend(lam, r, l_)[0], P),
        np.zeros((rows.size, n_ports), dtype=np.complex128),
        np.zeros((n_ports, n_ports)),
        "repair",
    )
    change = best.change()
    after = check(lam, new_right * scale, new_left * scale)
    if not after.passive:
        raise PassivityError(f"could not be repaired: {after.summary()}")
    if change > max_change:
        raise PassivityError(
            f"making it passive would change its mobility by {change:.3g} (H2), more than the {max_change:.3g} allowed"
        )
    weight = conjugate_weights(lam)
    old, new = (np.einsum("ik,jk->kij", a, b) for a, b in ((right_scaled, left_scaled), (new_right, new_left)))
    residue_change = math.sqrt(_squares(new - old, weight) / _squares(old, weight))
    peaks = np.abs(lam.imag)
    old_y = mobility(lam, right_scaled, left_scaled, peaks)
    new_y = mobility(lam, new_right, new_left, peaks)
    old_size, new_size, moved = (np.sqrt((np.abs(y) ** 2).sum(axis=(1, 2))) for y in (old_y, new_y, new_y - old_y))
    tiny = np.finfo(np.float64).tiny
    levels = 20.0 * np.log10(np.maximum(new_size, tiny) / np.maximum(old_size, tiny))
    return RepairedBasis(
        poles=lam,
        right=new_right * scale,
        left=new_left * scale,
        storage=storage,
        flattening=best.flattening,
        pole_change=0.0,
        residue_change=residue_change,
        mobility_change=change,
        peak_error_db=float(20.0 * np.log10(max(moved.max(), tiny) / max(old_size.max(), tiny))),
        peak_level_db=float(levels[np.argmax(np.abs(levels))]),
        direct_skew=after.direct_term,
        iterations=best.iterations,
        before=before,
        after=after,
    )


class _Nearest:
    """The convex problem for one choice of right shapes.

    Real states x = (sqrt(2) Re z, sqrt(2) Im z) of the pairs, then the real modes; time in units of the modes' middle
    frequency; modes scaled for even convergence. With C = R A and X = lyap(Q), L = X C^T, D = R L:

        minimise  tr(L^T W L) - 2 tr(L^T T)  over  Q >= 0, R Q = 0,  subject to  D - D^T = 0,

    W the observability Gramian of (A, C), T that of (A, C) against the given basis, times its left shapes, both over
    the squared H2 norm of the given mobility. The side condition is met by multipliers (augmented Lagrangian).
    """

    def __init__(self, poles: Complexes, right: Complexes, left: Complexes, flattening: float):
        self.flattening = flattening
        self.iterations = 0
        turn = np.exp(0.5j * np.angle((right**2).sum(axis=0)))
        turned = right / turn
        shapes = right if flattening == 1.0 else (turned.real + 1j * flattening * turned.imag) * turn
        self._order = np.argsort(poles.imag == 0.0, kind="stable")  # pairs first
        self.right = shapes
        self._unit = float(np.exp(np.mean(np.log(np.abs(poles)))))
        lam = poles[self._order] / self._unit
        shapes, right, left = (a[:, self._order] for a in (shapes, right, left / self._unit))

        # Q of a single real mode is the unit matrix under the first factor; the second evens out how much the modes
        # weigh in the mobility, and with that the curvature of the problem
        loss = 2.0 * np.abs(lam.real)
        right_size, left_size = linalg.norm(shapes, axis=0) * np.abs(lam), linalg.norm(left, axis=0)
        weight = right_size * left_size / np.sqrt(loss)
        evened = (weight / weight.max()) ** -_EVENING
        self._gain = np.sqrt(loss * left_size / right_size) * evened
        n, pairs = lam.size, int(np.sum(lam.imag > 0.0))
        self._rows = np.concatenate([np.arange(pairs), np.arange(n, n + pairs), np.arange(pairs, n)])
        form = real_form(lam, shapes * self._gain, left / self._gain)
        transformed = real_form(lam, right * self._gain, left / self._gain)
        self._R, self._C, given_C = (a[:, self._rows] for a in (form.R, form.C, transformed.C))
        given_B = form.B[self._rows]
        self._to_full = form.to_full[:, self._rows]
        self._pairs = pairs
        self._kernels = tuple(
            -1.0 / (lam[:pairs, None] + other[None, :]) for other in (lam[:pairs].conj(), lam[:pairs], lam[pairs:])
        )
        self._kernel_real = -1.0 / (lam[pairs:, None].real + lam[None, pairs:].real)

        gramian = self._lyap(given_C.T @ given_C, adjoint=True)
        square = float(np.sum(given_B * (gramian @ given_B)))
        self._W = self._lyap(self._C.T @ self._C, adjoint=True) / square
        self._T = self._lyap(self._C.T @ given_C, adjoint=True) @ given_B / square
        self._amount = float(np.sum(linalg.norm(self._R, axis=0) * linalg.norm(given_B, axis=1)))
        self._seen = linalg.orth(self._R.T, rcond=PORT_RANK)
        self._multiplier = np.zeros((self._R.shape[0],) * 2)
        self._penalty = 0.0
        steepest = self._largest_curvature(lambda L: self._W @ L)
        skew_curvature = self._largest_curvature(lambda L: self._R.T @ _skew(self._R @ L))
        if skew_curvature > 0.0:
            self._penalty = steepest / skew_curvature
        self._lipschitz = self._largest_curvature(self._curve)
        self._start = np.diag(np.concatenate([evened[:pairs], evened[:pairs], evened[pairs:]]) ** -2)
        self._Q = self._project(self._start)
        self._ahead, self._momentum = self._Q, 1.0

    def _lyap(self, G: Floats, *, adjoint: bool = False) -> Floats:
        """X with A X + X A^T = -G; adjoint: with A^T X + X A = -G. Element by element in complex states."""
        p = self._pairs
        kernels = [k.conj() for k in self._kernels] if adjoint else self._kernels
        aa, ab, ba, bb = G[:p, :p], G[:p, p : 2 * p], G[p : 2 * p, :p], G[p : 2 * p, p : 2 * p]
        same = ((aa + bb) + 1j * (ba - ab)) * (0.5 * kernels[0])  # row z, column z
        other = ((aa - bb) + 1j * (ba + ab)) * (0.5 * kernels[1])  # row z, column conj(z)
        X = np.empty_like(G)
        X[:p, :p], X[p : 2 * p, p : 2 * p] = same.real + other.real, same.real - other.real
        X[p : 2 * p, :p], X[:p, p : 2 * p] = other.imag + same.imag, other.imag - same.imag
        if G.shape[0] > 2 * p:
            for rows, out in ((G[:, 2 * p :], X[:, 2 * p :]), (G[2 * p :].T, X[2 * p :].T)):
                mixed = (rows[:p] + 1j * rows[p : 2 * p]) * kernels[2]
                out[:p], out[p : 2 * p] = mixed.real, mixed.imag
            X[2 * p :, 2 * p :] = G[2 * p :, 2 * p :] * self._kernel_real
        return X

    def _project(self, Q: Floats) -> Floats:
        """Nearest positive semidefinite matrix without the directions that R sees."""
        seen = self._seen
        Q = Q - seen @ (seen.T @ Q)
        Q = Q - (Q @ seen) @ seen.T
        values, vectors = linalg.eigh(0.5 * (Q + Q.T), driver="evd", check_finite=False)
        positive = int(np.searchsorted(values, 0.0))
        root = vectors[:, positive:] * np.sqrt(values[positive:])
        return np.asarray(root @ root.T)

    def _curve(self, L: Floats) -> Floats:
        """Gradient with respect to L of the quadratic terms."""
        return self._W @ L + self._penalty * (self._R.T @ _skew(self._R @ L))

    def _adjoint(self, gradient: Floats) -> Floats:
        """Gradient with respect to Q from that with respect to L."""
        outer = gradient @ self._C
        return self._lyap(0.5 * (outer + outer.T), adjoint=True)

    def _largest_curvature(self, curve: Callable[[Floats], Floats]) -> float:
        """Lipschitz constant of a linear gradient, by power iteration."""
        Q, size = np.eye(self._C.shape[1]), 0.0
        for _ in range(40):
            Q = self._adjoint(curve(self._lyap(Q) @ self._C.T))
            size = float(linalg.norm(Q))
            if size == 0.0:
                break
            Q = Q / size
        return 1.05 * size

    def run(self, iterations: int) -> None:
        """Iterate until the squared distance, looked at every 50 iterations, changes by less than 1 % or 1e-8."""
        watched = math.inf
        for count in range(iterations):
            L = self._lyap(self._ahead) @ self._C.T
            D = self._R @ L
            if count % 50 == 0:
                square = float(np.sum(L * (self._W @ L - 2.0 * self._T))) + 1.0
                proper = float(linalg.norm(_skew(D))) < _PROPER * self._amount
                if proper and abs(watched - square) < max(0.01 * square, 1e-8):
                    return
                watched = square
            if count % 10 == 9:
                self._multiplier += self._penalty * _skew(D)
            gradient = self._curve(L) - self._T + self._R.T @ self._multiplier
            step = self._project(self._ahead - self._adjoint(gradient) / self._lipschitz)
            if np.sum((self._ahead - step) * (step - self._Q)) > 0.0:
                self._momentum = 1.0
            momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * self._momentum**2))
            self._ahead = step + (self._momentum - 1.0) / momentum * (step - self._Q)
            self._Q, self._momentum = step, momentum
            self.iterations += 1

    def _solution(self) -> tuple[Floats, Floats]:
        """X and L of the present Q with a little loss in every direction that may have one."""
        root = np.sqrt(np.diag(self._start))
        free = np.diag(root) - (self._seen @ self._seen.T) * root
        X = self._lyap(self._Q + _MARGIN * (free @ free.T))
        X = 0.5 * (X + X.T)
        return X, X @ self._C.T

    def change(self) -> float:
        """Relative H2 change of the mobility, strictly proper parts."""
        _, L = self._solution()
        return math.sqrt(max(0.0, float(np.sum(L * (self._W @ L - 2.0 * self._T))) + 1.0))

    def result(self) -> tuple[Complexes, Complexes, Complexes]:
        """Right and left shapes in the order given, and P over the full list."""
        X, L = self._solution()
        n = self._order.size
        P = self._to_full @ (0.5 * linalg.inv(X)) @ self._to_full.conj().T
        gains = np.concatenate([self._gain, self._gain[: self._pairs]])
        P = 0.5 * (P + P.conj().T) / np.outer(gains, gains)
        left = (self._to_full @ L)[:n].T * self._gain * self._unit
        # back to the order given: modes, then the conjugates of its pairs
        position = np.argsort(self._order)
        pairs_first = self._order[: self._pairs]
        full_position = np.concatenate([position, n + np.argsort(np.argsort(pairs_first))])
        return self.right, left[:, position], P[np.ix_(full_position, full_position)]


def _skew(matrix: Floats) -> Floats:
    return 0.5 * (matrix - matrix.T)


def _squares(residues: Complexes, weight: Floats) -> float:
    return float(np.sum(weight[:, None, None] * np.abs(residues) ** 2))
