"""Closed-form error of interpolatory updates, the last of the thesis' open questions (Chinnakonda 2007, chapter 4).

Between uniform nodes at fractions c_i of a step H the force's interpolation of degree p misses, about the middle t_m,

    r - P r = r^(p+1)(t_m) H^(p+1)/(p+1)! w(s) + r^(p+2)(t_m) H^(p+2)/(p+2)! w(s) (s - 1/2) + ...,

w(s) = prod (s - c_i), and the exact flow carries it into the mode with the weight exp(lambda H (1 - s)). One step adds

    d = H^(p+2)/(p+1)! k1(lambda H) r^(p+1)(t_m) + H^(p+3)/(p+2)! k2(lambda H) r^(p+2)(t_m),
    k1(z) = int exp(z (1 - s)) w(s) ds = sum_j w_j j! phi_(j+1)(z),   k2 alike with w(s) (s - 1/2),

to the error e = exact - update. Under a force exp(i omega t) that sums up in closed form, with E = exp(lambda H):

    e_n = d_0 (exp(i omega n H) - E^n) / (exp(i omega H) - E).

For small |lambda| h the error of P1 is the mode's response to a force -h^2 r''/12 (k1 = -1/6); that of
P2 over two steps to h^4 (lambda r''' - r''''/4)/45 (k1 = z/120, k2 = -1/120), of fourth order for an oscillating and
for a decaying mode alike. For lambda h far below -1 they are the responses to (h/2) r''/lambda and
(h^2/3) r'''/lambda: small, and of first and second order. In between P2 seems to be of third order, as the thesis
has it for heavy damping.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.polynomial import polynomial as poly
from numpy.typing import NDArray

from tonewood.lab.interpolatory import Update
from tonewood.physics.modal.modes import BLOCK, PAIR, ModalBasis
from tonewood.physics.modal.propagator import phi
from tonewood.support.arrays import Complexes, Floats


def kernels(degree: int, z: Complexes) -> tuple[Complexes, Complexes]:
    """k1(z) and k2(z) of the interpolation at degree + 1 uniform nodes of [0, 1], degree >= 1."""
    nodes = np.linspace(0.0, 1.0, degree + 1)
    w = np.asarray(poly.polyfromroots(nodes), dtype=np.float64)
    second = np.asarray(poly.polymul(w, [-0.5, 1.0]), dtype=np.float64)
    values = phi(second.size, np.asarray(z, dtype=np.complex128))

    def integral(coefficients: NDArray[np.float64]) -> Complexes:
        return np.asarray(sum(c * factorial(j) * values[j + 1] for j, c in enumerate(coefficients)))

    return integral(w), integral(second)


def harmonic_error(update: Update, poles: Complexes, omega: float, dt: float, n: int) -> Complexes:
    """(n, n_modes) estimated error of modes under exp(i omega t) from rest, after 0, 1, 2, ... updates.

    update : interpolatory (``weighted``) of degree 1 or more.
    poles : (n_modes,) 1/s.
    omega : rad/s, of either sign.
    dt : s between samples.
    """
    if not update.weighted or update.degree == 0:
        raise ValueError("estimates are of weighted updates of degree 1 or more")
    p, H = update.degree, dt * update.span
    k1, k2 = kernels(p, poles * H)
    slope = (1j * omega) ** (p + 1) * np.exp(0.5j * omega * H)
    d = slope * H ** (p + 2) / factorial(p + 1) * (k1 + 1j * omega * H / (p + 2) * k2)
    step = np.arange(n)[:, None] * H
    E, turn = np.exp(poles * H), np.exp(1j * omega * H)
    return np.asarray(d * (np.exp(1j * omega * step) - np.exp(poles * step)) / (turn - E))


def sine_error(
    update: Update, basis: ModalBasis, amplitudes: dict[str, float], omega: float, dt: float, n: int, point: str
) -> Floats:
    """(n,) m, estimated displacement error at a point under forces amplitude * sin(omega t) from rest.

    Raises ValueError : the basis has blocks (rigid-body or coinciding poles), whose errors are not of this form.
    """
    if np.any(basis.kind == BLOCK):
        raise ValueError("estimates are of modes with simple poles")
    e = (harmonic_error(update, basis.poles, omega, dt, n) - harmonic_error(update, basis.poles, -omega, dt, n)) / 2j
    left = np.sum([a * basis.left[basis.index(name)] for name, a in amplitudes.items()], axis=0)
    weight = np.where(basis.kind == PAIR, 2.0, 1.0) * basis.right[basis.index(point)]
    return np.asarray((e * (weight * left)).sum(axis=1).real)
