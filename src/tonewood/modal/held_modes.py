"""A component seen from one point: its modes when that point is held, and the same component with fewer of them.

A string's modes with its bridge end free are no partials: every one of them takes part in the motion of a string whose
end hardly moves. Held there it has modes u_j of its own (Klosner & Ranlet 1978 call them fixed-base modes), and those
are what is heard one by one. In free-interface coordinates q (mass-normalised, frequencies w_k, shapes a_k at the
point; its residual compliance lies between it and whatever holds it)

    sum_k a_k^2 / (w_k^2 - W_j^2) = 0,      u_jk = g_j a_k / (w_k^2 - W_j^2),      |u_j| = 1,

and g_j is both the force that mode j exerts on what holds it per unit amplitude, and how strongly a motion d of the
point drives it, p_j'' + 2 s_j p_j' + W_j^2 p_j = g_j d.

Left to its lowest held modes and the static shape c = K^-1 a / (a K^-1 a) under a displacement of the point, the
component keeps its static compliance there, and couples to others as before: what is lost is the inertia of the held
modes left out, not their stiffness. Partials of a string on a body then keep their pitch to some 1e-5 cent up to the
highest mode kept, where dropping free-interface modes and adding their static compliance costs some cents.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.modal.modes import ModalBasis

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeldModes:
    """Modes of a component of real modes with one of its points held.

    Attributes
    ----------
    stiffness, shape : (n,) w_k^2 (1/s^2) and a_k (1/sqrt(kg)) of the free-interface modes, in order of frequency.
    freq_rad : (n - 1,) W_j, rad/s, one between every two w_k.
    damping_rate : (n - 1,) s_j, 1/s.
    force : (n - 1,) g_j, N per m sqrt(kg).
    """

    stiffness: Floats
    shape: Floats
    freq_rad: Floats
    damping_rate: Floats
    force: Floats

    @classmethod
    def of(cls, basis: ModalBasis, point: str) -> HeldModes:
        """Hold `point` of a basis of real modes with stiffness.

        Raises
        ------
        ValueError : modes are not real, or one has no stiffness, or the point does not move.
        """
        if not basis.is_real or np.any(basis.stiffness <= 0):
            raise ValueError("only a component of real modes with stiffness can be held")
        i = basis.index(point)
        a, k = basis.right[i].real, basis.stiffness
        if np.any(np.diff(k) <= 0) or np.any(a == 0.0):
            raise ValueError(f"the point {point!r} must move in every mode, and no two may have one frequency")
        freq = np.sqrt(_roots(k, a * a))
        u = a / (k[None, :] - (freq**2)[:, None])
        g = 1 / np.sqrt(np.sum(u * u, axis=1))
        return cls(k, a, freq, (g[:, None] * u) ** 2 @ basis.damping_rate, g)

    @property
    def n_modes(self) -> int:
        """Number of held modes."""
        return int(self.freq_rad.size)

    @cached_property
    def vectors(self) -> Floats:
        """(n - 1, n) u_jk: p = vectors @ q gives the amplitudes of the held modes."""
        gap = self.stiffness[None, :] - (self.freq_rad**2)[:, None]
        return np.asarray(self.force[:, None] * self.shape / gap)

    @cached_property
    def compliance(self) -> float:
        """Static compliance at the point without the residual, m/N."""
        return float(np.sum(self.shape**2 / self.stiffness))


def _roots(poles: Floats, weights: Floats, straight: tuple[float, float] | None = None) -> Floats:
    """Roots x_j of sum weights / (poles - x) = 0, (n - 1,) between the poles; of a - b x - sum weights / (poles - x)
    where `straight` = (a, b) is given, n + 1: one below the poles and one above them, too.

    Newton's method on the sum times the distances to both poles, which is nearly straight between them; bisection where
    it would leave the bracket. `a` must exceed sum weights / poles, and b be positive.
    """
    a, b = straight or (0.0, 0.0)
    low, high = poles[:-1].copy(), poles[1:].copy()
    if straight:
        # above the highest pole the sum is no larger than with all weights at that pole
        total = float(weights.sum())
        above = np.sqrt(total / b) + max(a / b - poles[-1], 0.0)
        low, high = np.concatenate([[0.0], poles]), np.concatenate([poles, [poles[-1] + above]])
    left, right = low.copy(), high.copy()
    x = 0.25 * (np.sqrt(low) + np.sqrt(high)) ** 2
    for _ in range(80):
        inverse = 1 / (poles[None, :] - x[:, None])
        total_at, slope = inverse @ weights - a + b * x, inverse**2 @ weights + b
        low, high = np.where(total_at < 0, x, low), np.where(total_at < 0, high, x)
        width = (right - x) * (x - left)
        step = -total_at * width / (slope * width + total_at * (right + left - 2 * x))
        new = x + step
        inside = (new >= low) & (new <= high)
        new = np.where(inside, new, 0.5 * (low + high))
        done = np.abs(new - x) <= 1e-12 * x
        x = new
        if done.all():
            break
    return np.asarray(x)


@dataclass(frozen=True, eq=False)
class Condensed:
    """A component left to its lowest held modes and the static shape.

    Attributes
    ----------
    basis : n_held + 1 real modes, or none at all; residual compliance keeps the static one between all points.
    vectors : (n, n_modes) orthonormal, q = vectors @ q_condensed.
    held : (n_held, n_modes) amplitudes of the held modes kept, p = held @ q_condensed.
    stiffness : (n,) w_k^2 of the whole component.
    """

    basis: ModalBasis
    vectors: Floats
    held: Floats
    stiffness: Floats

    def expand(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Coordinates of the whole component in the same motion: energy is what it was."""
        return self.vectors @ q, self.vectors @ velocity

    def reduce(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Nearest motion of the condensed component: displacement in the energy norm, which keeps the point's own,
        and velocity in the mass norm. Neither energy can rise.
        """
        displacement = self.vectors.T @ (self.stiffness * q) / self.basis.stiffness
        return displacement, self.vectors.T @ velocity


def condensed(basis: ModalBasis, held: HeldModes, n_held: int) -> Condensed:
    """Keep the n_held lowest held modes of a component and its static shape; with n_held < 0 nothing moves.

    In the kept coordinates (static shape d, held modes) stiffness is diagonal and mass an arrow, M_dj = -g_j / W_j^2:
    the frequencies are the roots of

        K_dd + sum g_j^2 / W_j^2 - w^2 (M_dd - sum M_dj^2) - sum g_j^2 / (W_j^2 - w^2) = 0,

    and a mode's amplitudes are p_j = w^2 M_dj d / (W_j^2 - w^2). Damping starts as the diagonal of the damping matrix
    that the condensed modes see, and is turned by positive factors until the held modes decay as in the whole
    component: as it stands, partials near the highest one would decay 2 % too quickly.

    Raises
    ------
    ValueError : more held modes than there are.
    """
    n = basis.n_modes
    if n_held > held.n_modes:
        raise ValueError(f"there are {held.n_modes} held modes, not {n_held}")
    if n_held < 0:
        whole = basis.select(np.zeros(n, dtype=bool))
        nothing = replace(whole, metadata=_metadata(basis, np.zeros((n, 0))))
        return Condensed(nothing, np.zeros((n, 0)), np.zeros((0, 0)), basis.stiffness)
    static = held.shape / held.stiffness / held.compliance
    kept = held.vectors[:n_held]
    shared = -held.force[:n_held] / held.freq_rad[:n_held] ** 2
    alone = float(static @ static - shared @ shared)
    square = np.array([1 / (held.compliance * alone)])
    if n_held:
        a = 1 / held.compliance - float(held.force[:n_held] @ shared)
        square = _roots(held.freq_rad[:n_held] ** 2, held.force[:n_held] ** 2, (a, alone))
    freq = np.sqrt(square)
    amplitude = shared[:, None] * square / (held.freq_rad[:n_held, None] ** 2 - square)
    coefficients = np.concatenate([np.ones((1, n_held + 1)), amplitude])
    # potential energy of unit mass; where modes are nearly uncoupled its terms have no cancellation
    elastic = 1 / held.compliance + (held.freq_rad[:n_held] ** 2) @ amplitude**2
    coefficients *= np.sqrt(square / elastic)
    vectors = np.column_stack([static, kept.T]) @ coefficients
    right = basis.right.real
    shapes = right @ vectors
    residual = basis.residual + (right / basis.stiffness) @ right.T - (shapes / freq**2) @ shapes.T
    new = ModalBasis.real(
        freq,
        _decaying(basis.damping_rate @ vectors**2, (kept @ vectors) ** 2, held.damping_rate[:n_held]),
        dict(zip(basis.points, shapes, strict=True)),
        residual=residual,
        metadata=_metadata(basis, vectors),
    )
    return Condensed(new, vectors, coefficients[1:], basis.stiffness)


def _decaying(damping_rate: Floats, shares: Floats, wanted: Floats) -> Floats:
    """Damping rates near the given ones with shares @ damping_rate = wanted, to some 1e-5, all of one sign."""
    rest = 1.0 - shares.sum(axis=0)
    for _ in range(6 if np.all(wanted > 0.0) else 0):
        damping_rate = damping_rate * (shares.T @ (wanted / (shares @ damping_rate)) + rest)
    return damping_rate


#: arrays of metadata that are quadratic forms of a mode's shape, diagonal in the modes
_FORMS = ("tension_part", "bending_part", "stretch_part")


def _metadata(basis: ModalBasis, vectors: Floats) -> dict[str, object]:
    """What is true of the condensed modes too: numbers, and forms of the shapes."""
    out = {key: value for key, value in basis.metadata.items() if not isinstance(value, np.ndarray)}
    for key in _FORMS:
        if isinstance(form := basis.metadata.get(key), np.ndarray):
            out[key] = form @ vectors**2
    return out
