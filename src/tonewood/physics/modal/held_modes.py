"""Modes of a component whose point is held: the partials of a string whose end hardly moves.

A string's modes with its bridge end free are no partials: every one of them takes part in the motion of a string whose
end is held. Held there it has modes u_j of its own (Klosner & Ranlet 1978 call them fixed-base modes). In
free-interface coordinates q (mass-normalised, frequencies w_k, shapes a_k at the point)

    sum_k a_k^2 / (w_k^2 - W_j^2) = 0,      u_jk = g_j a_k / (w_k^2 - W_j^2),      |u_j| = 1,

and g_j is both the force that mode j exerts on the clamp per unit amplitude, and how strongly a motion d of the
point drives it, p_j'' + 2 s_j p_j' + W_j^2 p_j = g_j d.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.secular import secular_roots
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class HeldModes:
    """Modes of a component of real modes with one of its points held.

    stiffness, shape : (n,) w_k^2 (1/s^2) and a_k (1/sqrt(kg)) of the free-interface modes, in order of frequency.
    freq_rad : (n - 1,) W_j, rad/s, one between every two w_k.
    damping_rate : (n - 1,) s_j, 1/s.
    force : (n - 1,) g_j, N per m sqrt(kg).
    vectors : (n - 1, n) u_jk: p = vectors @ q gives the amplitudes of the held modes.
    """

    stiffness: Floats
    shape: Floats
    freq_rad: Floats
    damping_rate: Floats
    force: Floats
    vectors: Floats

    @classmethod
    def of(cls, basis: ModalBasis, point: str) -> HeldModes:
        """Hold `point` of a basis of real modes with stiffness.

        Raises ValueError : modes are not real, or one has no stiffness, or the point does not move.
        """
        if not basis.is_real or np.any(basis.stiffness <= 0):
            raise ValueError("only a component of real modes with stiffness can be held")
        a, k = basis.right[basis.index(point)].real, basis.stiffness
        if np.any(np.diff(k) <= 0) or np.any(a == 0.0):
            raise ValueError(f"the point {point!r} must move in every mode, and no two may have one frequency")
        between = 0.25 * (np.sqrt(k[:-1]) + np.sqrt(k[1:])) ** 2
        square, distance = secular_roots(k, a * a, k[:-1], k[1:], between)
        u = -a / distance
        g = 1 / np.sqrt(np.sum(u * u, axis=1))
        vectors = g[:, None] * u
        return cls(k, a, np.sqrt(square), vectors**2 @ basis.damping_rate, g, vectors)

    @property
    def n_modes(self) -> int:
        """Number of held modes."""
        return int(self.freq_rad.size)
