"""Derivatives of the modes of a component by a mass, a spring, a dashpot or a tuned damper at one of its points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tonewood.physics.modal.conjugates import extend
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Complexes

#: relative distance of poles below which they count as one
SAME = 1e-9


def lump_change(
    basis: ModalBasis, point: int, lump: Sequence[float], massive: bool = True, below: Sequence[float] = (1.0,)
) -> tuple[Complexes, Complexes]:
    """Derivatives of poles and residues as a lump z(s), such as m s^2 + d s + k, grows at one point a.

        lambda_k' = -(r_a l_a)_k z(lambda_k),    H_pp' = -H_pa z H_ap,    H_pa = sum_k r_p l_a / (s - lambda_k) + R

    The residue's derivative is the coefficient of 1 / (s - lambda_k) in H_pp', by expansion in all modes. Of poles that
    coincide only one moves, by the sum of their r_a l_a; the terms between them are halved, because their residues add
    up.

    basis : modes with all lumps that are fixed already.
    lump : rates of m, d and k: kg, N s/m, N/m per unit of the parameter; or numerator of any other z, highest power
        first.
    massive : whether the lump has a mass, and so lies on the residual compliance R; see `loaded`.
    below : denominator of z.
    Returns (n,) lambda', (p, n) derivatives of r_p l_p.
    """
    n = len(basis.poles)
    lam, right, left = extend(basis.poles, basis.right, basis.left)
    bottom = np.polyval(below, lam)
    z = np.polyval(lump, lam) / bottom
    slope = (np.polyval(np.polyder(lump), lam) - z * np.polyval(np.polyder(below), lam)) / bottom
    product = right[point] * left[point]
    gap = lam[:n, None] - lam[None, :]
    same = np.abs(gap) <= SAME * np.abs(lam[:n, None])
    inverse = np.where(same, 0.0, 1.0 / np.where(same, 1.0, gap))
    rate = -product[:n] * z[:n]
    for k in range(n):
        if (mates := np.flatnonzero(same[k])).size > 1:
            rate[k] = -product[mates].sum() * z[k] if k == mates[0] else 0.0
    outward, inward = right * left[point], right[point] * left  # (p, 2n): r_p l_a, r_a l_p
    residual = basis.residual[:, point, None] if massive else 0.0
    regular_out, regular_in = outward @ inverse.T + residual, inward @ inverse.T + residual
    between = 0.5 * (outward[:, :n] * (inward @ same.T) + inward[:, :n] * (outward @ same.T))
    change = outward[:, :n] * z[:n] * regular_in + regular_out * z[:n] * inward[:, :n] + between * slope[:n]
    return np.asarray(rate), np.asarray(-change)
