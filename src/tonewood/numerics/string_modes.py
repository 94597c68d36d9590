"""Modes of a stiff string that is held at one end and moved by a body at the other.

    mu u_tt + loss = T u_xx - EI u_xxxx + f(x, t),    x = 0 at the bridge, x = L at the nut or stop,
    u_xx(0) = 0,  u(0) = displacement of the bridge,    u(L) = u_xx(L) = 0.

Fixed-base modes sin(n pi x / L), n = 1 .. N, and one constraint mode, the static ramp 1 - x / L (Klosner & Ranlet
1978, Eqs 5-8), made diagonal once: in the coordinates (ramp, sines) the mass matrix is

    M = [[mu L / 3, b^T], [b, mu L / 2]],  b_n = mu L / (n pi),      K = diag(T / L, L/2 (T k_n^2 + EI k_n^4)),

and its N + 1 modes are those of the string with its bridge end free. Unlike modes cos((2n - 1) pi x / 2L), whose
slope at the bridge is zero, they converge at once: a body joined to them meets the string's true end impedance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

from tonewood.numerics.modes import ModalBasis

Floats = NDArray[np.float64]
#: eta(omega rad/s, k 1/m) -> loss factor; the decay rate of a mode is sigma = omega eta / 2
LossFactor = Callable[[Floats, Floats], ArrayLike]


def wavenumber(freq_rad: ArrayLike, tension: float, linear_density: float, bending_stiffness: float) -> Floats:
    """Wavenumber k of a travelling wave, 1/m: mu omega^2 = T k^2 + EI k^4, in a form that does not cancel."""
    w2 = linear_density * np.asarray(freq_rad, dtype=np.float64) ** 2
    return np.asarray(np.sqrt(2 * w2 / (tension + np.sqrt(tension**2 + 4 * bending_stiffness * w2))))


def string_basis(
    length: float,
    tension: float,
    linear_density: float,
    bending_stiffness: float,
    loss: LossFactor,
    *,
    freq_upper: float | None = None,
    n_modes: int | None = None,
) -> ModalBasis:
    """Component modes of a string: every mode below `freq_upper`, or just `n_modes` of them.

    The number of fixed-base modes is chosen so that the highest of the N + 1 modes, some 15 % above the N-th sine,
    still lies below the limit: a basis from which solved modes are dropped detunes coupled partials by cents.

    Parameters
    ----------
    length : m, between the bridge and the nut or stop.
    tension : N, greater than 0.
    linear_density : kg/m.
    bending_stiffness : EI, N m^2, may be 0.
    loss : eta(omega, k), at the undamped frequency and the wavenumber of each mode.
    freq_upper : Hz.
    n_modes : number of modes, ramp included; give this or `freq_upper`.

    Returns
    -------
    Real modes with the point ``bridge`` at 0 m and a shape function for every x in [0, length]; mass-normalised,
    1/sqrt(kg). The residual compliance at the bridge is exactly zero: the ramp holds all of the static one. Between
    other places it is that of the sines beyond the N-th. `metadata` holds ``length, tension, linear_density,
    bending_stiffness``, ``vec`` (N + 1, N + 1) the coefficients of the modes (columns) in (ramp, sines),
    ``tension_part`` and ``bending_part`` (n_modes,) with omega^2 = T tension_part + EI bending_part, and
    ``wavenumber`` (n_modes,).

    Raises
    ------
    ValueError : a parameter is out of range, or not even one mode lies below `freq_upper`.
    """
    if not (length > 0 and tension > 0 and linear_density > 0 and bending_stiffness >= 0):
        raise ValueError("a string needs length, tension and linear density above 0 and a bending stiffness not below")
    if (freq_upper is None) == (n_modes is None):
        raise ValueError("give either freq_upper or n_modes of a string")
    parameters = (length, tension, linear_density, bending_stiffness)
    if freq_upper is not None:
        n_modes = _count_below(2 * np.pi * freq_upper, *parameters)
        if n_modes < 1:
            raise ValueError(f"no mode of this string lies below {freq_upper:g} Hz")
    if n_modes is None or n_modes < 1:
        raise ValueError("a string needs at least one mode")
    omega2, vec = _solve(n_modes - 1, *parameters)
    n_sines = len(vec) - 1
    k = np.arange(1, n_sines + 1) * np.pi / length
    omega = np.sqrt(omega2)
    mode_wavenumber = wavenumber(omega, tension, linear_density, bending_stiffness)

    def shape(x: float) -> Floats:
        return np.asarray((1 - x / length) * vec[0] + np.sin(k * x) @ vec[1:])

    def residual_at(x: ArrayLike, y: ArrayLike) -> Floats:
        at_x, at_y = (np.sin(np.asarray(place)[..., None] * k) for place in (x, y))
        sines = np.sum(at_x * (at_y / (tension * k**2 + bending_stiffness * k**4)), axis=-1)
        return np.asarray(held_string_compliance(x, y, length, tension, bending_stiffness) - 2 / length * sines)

    basis = ModalBasis.real(
        natural_freq_rad=omega,
        damping_rate=omega * np.asarray(loss(omega, mode_wavenumber)) / 2,
        points={"bridge": 0.0},
        shape=shape,
        residual=np.zeros((1, 1)),
        metadata={
            "length": length,
            "tension": tension,
            "linear_density": linear_density,
            "bending_stiffness": bending_stiffness,
            "vec": vec,
            "tension_part": np.concatenate([[1 / length], length / 2 * k**2]) @ vec**2,
            "bending_part": np.concatenate([[0.0], length / 2 * k**4]) @ vec**2,
            "wavenumber": mode_wavenumber,
        },
    )
    return replace(basis, residual_at=residual_at)


def held_string_compliance(
    x: ArrayLike, y: ArrayLike, length: float, tension: float, bending_stiffness: float
) -> Floats:
    """Deflection at x under a unit force at y of a stiff string held at both ends, without moments there, m/N.

    (1/T) [ a (L - b) / L - sinh(q a) sinh(q (L - b)) / (q sinh(q L)) ],  a = min(x, y), b = max(x, y),
    q^2 = T / EI: the closed form of 2/L sum sin(k x) sin(k y) / (T k^2 + EI k^4). Arrays go element by element.
    """
    a, b = np.minimum(x, y), np.maximum(x, y)
    string = a * (length - b) / length
    if bending_stiffness == 0:
        return np.asarray(string / tension)
    q = float(np.sqrt(tension / bending_stiffness))
    # both sinh written with their growing exponential taken out: q L is often some hundreds
    stiff = np.exp(-q * (b - a)) * np.expm1(-2 * q * a) * np.expm1(-2 * q * (length - b))
    return np.asarray((string + stiff / (2 * q * np.expm1(-2 * q * length))) / tension)


def _count_below(limit: float, length: float, tension: float, linear_density: float, bending_stiffness: float) -> int:
    """Largest N + 1 for which all modes lie below `limit`, rad/s; 0 if there is none.

    By Sylvester's law of inertia the N + 1 eigenvalues lie below the limit where K - limit^2 M is negative definite:
    its diagonal in the sines is, and so is what remains of the ramp when they are eliminated.
    """
    n_sines = int(length / np.pi * wavenumber(limit, tension, linear_density, bending_stiffness))
    k = np.arange(1, n_sines + 1) * np.pi / length
    sines = length / 2 * (tension * k**2 + bending_stiffness * k**4 - limit**2 * linear_density)
    ramp = tension / length - limit**2 * linear_density * length / 3
    eliminated = ramp - np.cumsum(np.concatenate([[0.0], (limit**2 * linear_density / k) ** 2 / sines]))
    # the sums only grow
    return int(np.searchsorted(eliminated, 0.0))


def _solve(
    n_sines: int, length: float, tension: float, linear_density: float, bending_stiffness: float
) -> tuple[Floats, Floats]:
    """omega^2 (N + 1,) and mass-normalised vectors (N + 1, N + 1) in (ramp, sines)."""
    k = np.arange(1, n_sines + 1) * np.pi / length
    mass = np.diag(np.concatenate([[length / 3], np.full(n_sines, length / 2)])) * linear_density
    mass[0, 1:] = mass[1:, 0] = linear_density / k
    stiffness = np.concatenate([[tension / length], length / 2 * (tension * k**2 + bending_stiffness * k**4)])
    # scaled so that the stiffness is the identity: the eigenvalues are 1 / omega^2, and it is the low modes, those
    # that are heard as pitch, that keep all their digits
    scale = 1 / np.sqrt(stiffness)
    inverse, vec = sla.eigh(scale[:, None] * mass * scale)
    omega2 = 1 / inverse[::-1]
    return omega2, scale[:, None] * vec[:, ::-1] * np.sqrt(omega2)
