"""Energy that a component stores, loses and receives over an interval, in closed form from where it begins.

Over an interval of length d a component x' = A x + B F(t) moves under forces that are known polynomials,
F = c0 + c1 tau + c2 tau^2 with tau = t / d. With s = (x, c0, c1, 2 c2), all at the beginning,

    x(t) = [exp(M tau) s]_x,                                  M the generator of s,
    lost = d int_0^1 n(x, F) dtau = s^T N s,                  n a quadratic form: 2 sigma q'^2 of each real mode,
    d int_0^1 tau^j y'(t) dtau = L_j s,   j = 0, 1, 2,        so that int F y' dt = sum_j c_j L_j s.

N and L_j are integrals of matrix exponentials, computed once for each length by doubling: those over half an interval
give those over the whole (Van Loan, IEEE Trans. Autom. Control 23 (1978) 395, has them from one exponential,
which overflows for stiff modes). Nothing is read from the motion at the interval's end, so a balance that closes is
evidence about the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import BLOCK, PAIR, REAL, ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.physics.passivity.storage import Storage
from tonewood.support.arrays import Floats

# Gauss-Legendre rule and Taylor order that are exact to rounding where |M tau| <= 1/2
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_ORDER = 16

#: key of a basis' metadata: (n_modes,) share of each real mode's loss that is radiated as sound
RADIATED = "radiated"


@dataclass(frozen=True, eq=False)
class IntervalForms:
    """Forms of s over one length of time, for b independent groups of modes.

    duration : d, s.
    flow : (b, n_x, n_s) x at the end.
    lost : (b, n_s, n_s) N, J.
    moments : (b, 3, n_y, n_s) L_j.
    """

    duration: float
    flow: Floats
    lost: Floats
    moments: Floats


class ComponentEnergy:
    """Energy of one component with forces on some of its points.

    Real modes are taken one by one; complex modes together, by a storage function P of their passivity.

    basis : the modes.
    points : names of the points that may receive forces.
    dt : s, a typical interval; sets the scale of the numbers inside.
    storage : of a basis whose modes are not real, for exactly these points in this order.
    radiated : (n_modes,) share of each mode's loss that is sound, from the basis' metadata; None where it is not known.
    Raises ValueError : the modes are not real and no storage function is given.
    """

    def __init__(self, basis: ModalBasis, points: Sequence[str], dt: float, storage: Storage | None = None):
        self.points = tuple(points)
        self.radiated: Floats | None = None
        index = np.array([basis.index(p) for p in points], dtype=np.intp)
        form = real_form(basis)
        n = basis.n_modes
        velocity = form.rows("velocity", index)
        # the second number of a block is a velocity: in units of 1/dt it is of the size of the first
        unit = np.ones((n, 2))
        unit[basis.kind == BLOCK, 1] = dt
        A = unit[:, :, None] * form.A / unit[:, None, :]
        if storage is None:
            if not basis.is_real:
                raise ValueError("the energy of complex modes needs a storage function")
            pair = basis.kind == PAIR
            q = np.stack([np.where(pair, 2.0, 1.0), np.zeros(n)], axis=-1) / unit
            v = (
                np.stack(
                    [np.where(pair, 2 * basis.poles.real, 0.0), np.where(pair, -2 * basis.poles.imag, 1.0)], axis=-1
                )
                / unit
            )
            self._q, self._v, self._stiffness = q, v, basis.stiffness
            self._P: Floats | None = None
            self._A = A
            # a unit modal force, and the shapes that make it of point forces
            gain = np.where(pair, -0.5 / np.where(pair, basis.poles.imag, 1.0), 1.0)
            self._B = np.stack([np.zeros(n), gain], axis=-1)[:, :, None] * unit[:, :, None]
            self._shapes = basis.right.real[index]
            self._v_rows = np.concatenate([v, np.zeros((n, 1))], axis=1)[:, None]
            rows = np.sqrt(2 * basis.damping_rate)[:, None] * self._v_rows[:, 0]
            self._N = rows[:, :, None] * rows[:, None, :]
            radiated = basis.metadata.get(RADIATED)
            self.radiated = None if radiated is None else np.asarray(radiated, dtype=np.float64)
            if self.radiated is not None and self.radiated.shape != (n,):
                raise ValueError(f"{RADIATED} of a basis of {n} modes has {self.radiated.size} shares")
        else:
            T = _full_state_matrix(basis) / unit.ravel()
            d = 2 * n
            self._P = (T.conj().T @ storage.P @ T).real
            self._A = np.zeros((1, d, d))
            for k in range(n):
                self._A[0, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = A[k]
            self._B = (form.B[index] * unit).reshape(len(index), d).T[None]
            direct = np.einsum("imx,jmx->ij", form.C[index], form.B[index])
            self._v_rows = np.concatenate([(velocity / unit).reshape(len(index), d), direct], axis=1)[None]
            cross = (T.conj().T @ storage.cross).real
            self._N = np.block([[(T.conj().T @ storage.Q @ T).real, cross], [cross.T, storage.direct]])[None]
        self._unit = unit
        size = np.abs(self._B).max(axis=(1, 2), initial=0.0) * dt
        self._force_unit = np.where(size > 0, size, 1.0)
        self._by_duration: dict[float, IntervalForms] = {}
        self._dt = dt

    def stored(self, x: Floats) -> Floats:
        """Stored energy, J, of states x (T, n_modes, 2); (T,)."""
        scaled = x * self._unit
        if self._P is None:
            first, second = scaled[..., 0], scaled[..., 1]
            q = self._q[:, 0] * first + self._q[:, 1] * second
            v = self._v[:, 0] * first + self._v[:, 1] * second
            return np.asarray(0.5 * ((v * v).sum(axis=1) + (q * q) @ self._stiffness))
        flat = scaled.reshape(len(x), -1)
        return np.asarray(np.einsum("ti,ti->t", flat @ self._P, flat))

    def forms(self, duration: float) -> IntervalForms:
        """Forms over an interval; those of the typical one are kept."""
        if duration in self._by_duration:
            return self._by_duration[duration]
        forms = _interval_forms(self._A, self._B / self._force_unit[:, None, None], self._scaled(), duration)
        if duration == self._dt:
            self._by_duration[duration] = forms
        return forms

    def start(self, x: Floats, forces: Floats, modal_forces: Floats | None = None) -> Floats:
        """States s of T intervals, (b, T, n_s).

        x : (T, n_modes, 2).
        forces : (T, n_points, k) N, c0 .. c(k-1) over each interval, k = 1 or 3; fewer make s shorter.
        modal_forces : (T, n_modes) modal forces that are constant over each interval, on real modes.
        """
        T, k = len(x), forces.shape[2]
        if self._P is None:
            states = (x * self._unit).transpose(1, 0, 2)
            inputs = np.einsum("pm,tpk->mtk", self._shapes, forces)[:, :, :, None]
            if modal_forces is not None:
                inputs[:, :, 0, 0] += modal_forces.T
        else:
            states = (x * self._unit).reshape(1, T, -1)
            inputs = forces.transpose(0, 2, 1)[None]
        inputs = inputs * self._force_unit[:, None, None, None]
        if k == 3:
            inputs = inputs * np.array([1.0, 1.0, 2.0])[:, None]
        return np.concatenate([states, inputs.reshape(len(inputs), T, -1)], axis=2)

    def flow(self, forms: IntervalForms, s: Floats) -> Floats:
        """States (T, n_modes, 2) at the end of the intervals."""
        x = s @ forms.flow[:, :, : s.shape[2]].transpose(0, 2, 1)
        shaped = x.transpose(1, 0, 2) if self._P is None else x.reshape(s.shape[1], -1, 2)
        return np.asarray(shaped / self._unit)

    def lost(self, forms: IntervalForms, s: Floats) -> Floats:
        """Energy dissipated, J, over each interval; (T,)."""
        k = s.shape[2]
        return np.asarray(np.einsum("bti,bti->t", s @ forms.lost[:, :k, :k], s))

    def sound(self, forms: IntervalForms, s: Floats) -> Floats:
        """Radiated part of the dissipated energy, J, over each interval; (T,), zeros where it is not known."""
        if self.radiated is None:
            return np.zeros(s.shape[1])
        k = s.shape[2]
        return np.asarray(np.einsum("b,bti,bti->t", self.radiated, s @ forms.lost[:, :k, :k], s))

    def moments(self, forms: IntervalForms, s: Floats, point: str) -> Floats:
        """(T, 3) m s^j: d int tau^j y' dtau of one point."""
        p = self.points.index(point)
        L = forms.moments[:, :, 0 if self._P is None else p, : s.shape[2]]
        each = np.einsum("bjs,bts->btj", L, s, optimize=True)
        if self._P is None:
            return np.asarray(np.einsum("m,mtj->tj", self._shapes[p], each))
        return np.asarray(each[0])

    def _scaled(self) -> tuple[Floats, Floats]:
        d = self._A.shape[1]
        unit = np.ones((len(self._A), self._N.shape[1]))
        unit[:, d:] = 1 / self._force_unit[:, None]
        return self._N * unit[:, :, None] * unit[:, None, :], self._v_rows * unit[:, None, :]


def _full_state_matrix(basis: ModalBasis) -> NDArray[np.complex128]:
    """T with [z; conj(z_pairs)] = T (Re z_1, Im z_1, Re z_2, ...)."""
    if np.any(basis.kind == BLOCK):
        raise ValueError("a storage function of modes stepped as blocks is not known")
    real = basis.kind == REAL
    if np.any(basis.right[:, real].imag != 0) or np.any(basis.left[:, real].imag != 0):
        raise ValueError("shapes of real poles must be real for a storage function")
    n, pairs = basis.n_modes, np.flatnonzero(basis.kind == PAIR)
    T = np.zeros((n + pairs.size, 2 * n), dtype=np.complex128)
    T[np.arange(n), 2 * np.arange(n)] = 1.0
    T[pairs, 2 * pairs + 1] = 1j
    T[n + np.arange(pairs.size), 2 * pairs] = 1.0
    T[n + np.arange(pairs.size), 2 * pairs + 1] = -1j
    return T


def _interval_forms(A: Floats, B: Floats, integrands: tuple[Floats, Floats], duration: float) -> IntervalForms:
    """Forms of x' = A x + B F over `duration`.

    A, B : (b, n_x, n_x) 1/s and (b, n_x, p).
    integrands : (b, n_x + p, n_x + p) loss and (b, n_y, n_x + p) velocities, forms and rows of (x, F).
    """
    b, n_x, p = B.shape
    n_s = n_x + 3 * p
    M = np.zeros((b, n_s, n_s))
    M[:, :n_x, :n_x], M[:, :n_x, n_x : n_x + p] = A * duration, B * duration
    M[:, n_x : n_x + p, n_x + p : n_x + 2 * p] = M[:, n_x + p : n_x + 2 * p, n_x + 2 * p :] = np.eye(p)
    loss, rows = np.zeros((b, n_s, n_s)), np.zeros((b, integrands[1].shape[1], n_s))
    loss[:, : n_x + p, : n_x + p], rows[:, :, : n_x + p] = integrands
    doublings = max(0, int(np.ceil(np.log2(2 * np.abs(M).sum(axis=2).max(initial=0.5)))))
    t = 0.5**doublings

    powers = [np.broadcast_to(np.eye(n_s), M.shape)]
    for k in range(1, _ORDER + 1):
        powers.append(powers[-1] @ (M * (t / k)))

    def exponential(share: float) -> Floats:
        total = powers[_ORDER] * share
        for k in range(_ORDER - 1, 0, -1):
            total = (total + powers[k]) * share
        return np.asarray(total + powers[0])

    flow = exponential(1.0)
    lost = np.zeros_like(M)
    moment = [np.zeros_like(rows) for _ in range(3)]
    for node, weight in zip((_NODES + 1) / 2, _WEIGHTS / 2, strict=True):
        at = exponential(float(node))
        lost += (weight * t) * at.transpose(0, 2, 1) @ loss @ at
        moved = (weight * t) * rows @ at
        for j in range(3):
            moment[j] += moved * (node * t) ** j
    for _ in range(doublings):
        lost = lost + flow.transpose(0, 2, 1) @ lost @ flow
        first, second, third = moment
        moment = [
            first + first @ flow,
            second + (second + t * first) @ flow,
            third + (third + 2 * t * second + t * t * first) @ flow,
        ]
        flow = flow @ flow
        t *= 2
    return IntervalForms(duration, flow[:, :n_x], lost * duration, np.stack(moment, axis=1) * duration)
