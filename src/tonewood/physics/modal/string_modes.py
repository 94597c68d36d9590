"""Modes of a stiff string that is held at one end and moved by a body at the other.

    mu u_tt + loss = T u_xx - EI u_xxxx + f(x, t),    x = 0 at the bridge, x = L at the nut or stop,
    u_xx(0) = 0,  u(0) = displacement of the bridge,    u(L) = u_xx(L) = 0.

Fixed-base modes sin(n pi x / L), n = 1 .. N, and one constraint mode, the static ramp 1 - x / L (Klosner & Ranlet
1978, Eqs 5-8), made diagonal once: in the coordinates (ramp, sines) the mass matrix is

    M = [[mu L / 3, b^T], [b, mu L / 2]],  b_n = mu L / (n pi),      K = diag(T / L, L/2 (T k_n^2 + EI k_n^4)),

and its N + 1 modes are those of the string with its bridge end free. Modes cos((2n - 1) pi x / 2L) have zero slope at
the bridge and converge slowly; these converge fast, because the ramp gives a body the string's true end impedance.

Loss. A law gives the decay rate sigma_n of the partials between *fixed* ends, because strings are measured in this way
and the end on a bridge is nearly fixed. Fixed-end partial n is a mixture of the free-end modes k, with shares P_nk of
its mass (rows sum to 1), so that to first order in the loss it decays at sum_k P_nk s_k. Rates s_k = sigma(omega_k)
would not reproduce the law but average it over n +- 1/2 and a long tail: 19 % too low at n = 1 if eta is constant.
Therefore s_k >= 0 is found from sum_k P_nk s_k = sigma_n (`loss_rates`). The modes stay real, so the string is passive
whatever the law, and so is any part of its modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.secular import secular_roots
from tonewood.support.arrays import Floats, read_only

#: limit of the number of modes of a string: cost and memory grow with its square
MOST_MODES = 3000
#: eta(omega rad/s, k 1/m) -> loss factor; the decay rate of a partial is sigma = omega eta / 2
LossFactor = Callable[[Floats, Floats], ArrayLike]

#: relative error of a fixed-end partial's decay rate at which `loss_rates` ends; iterations at most, and those after
#: which the error must have fallen by a twentieth
_LOSS_TOLERANCE = 5e-5
_LOSS_ITERATIONS = 400
_LOSS_PATIENCE = 25


def wavenumber(freq_rad: ArrayLike, tension: float, linear_density: float, bending_stiffness: float) -> Floats:
    """Return the wavenumber k of a travelling wave, 1/m: mu omega^2 = T k^2 + EI k^4, in a form that does not cancel.

    Parameters
    ----------
    freq_rad : (n,) omega, rad/s.
    tension, linear_density, bending_stiffness : T, N; mu, kg/m; EI, N m^2, may be 0.
    """
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
    """Return component modes of a string: every mode below `freq_upper`, or just `n_modes` of them.

        u(x, t) = (1 - x/L) a_0(t) + sum_n a_n(t) sin(n pi x/L),      x = 0 at the bridge,

    mu u'' = T u_xx - EI u_xxxx between hinged ends, in modes of these functions. The number of
    fixed-base modes is chosen so that the highest of the N + 1 modes, some 15 % above the N-th sine, still lies below
    the limit: a basis from which solved modes are dropped detunes coupled partials by cents.

    Parameters
    ----------
    length : m, between the bridge and the nut or stop.
    tension : N, greater than 0.
    linear_density : kg/m.
    bending_stiffness : EI, N m^2, may be 0.
    loss : eta(omega, k) >= 0, at the undamped frequency and the wavenumber of each partial between fixed ends.
    freq_upper : Hz.
    n_modes : number of modes, ramp included; give this or `freq_upper`.

    Returns
    -------
    Real modes with the point ``bridge`` at 0 m and a shape function for every x in [0, length]; mass-normalised,
    1/sqrt(kg). The residual compliance at the bridge is exactly zero: the ramp holds all of the static one. Between
    other places it is that of the sines beyond the N-th. `metadata` holds ``length, tension, linear_density,
    bending_stiffness``, ``vec`` (N + 1, N + 1) the coefficients of the modes (columns) in (ramp, sines),
    ``tension_part`` and ``bending_part`` (n_modes,) with omega^2 = T tension_part + EI bending_part,
    ``wavenumber`` (n_modes,), and ``loss_error`` (N,), relative error of each fixed-end partial's decay rate.

    Raises
    ------
    ValueError : a parameter is out of range, no mode or more than 3000 lie below `freq_upper`, or the loss law gives a
        negative or infinite number.

    Source: Klosner and Ranlet (1978), fixed-base modes and a constraint mode, eqs. 1-8; docs/theory.md, section 4.
    """
    if not (length > 0 and tension > 0 and linear_density > 0 and bending_stiffness >= 0):
        raise ValueError("a string needs length, tension and linear density above 0 and a bending stiffness not below")
    if (freq_upper is None) == (n_modes is None):
        raise ValueError("give either freq_upper or n_modes of a string")
    parameters = (length, tension, linear_density, bending_stiffness)
    if freq_upper is not None:
        count = length / np.pi * float(wavenumber(2 * np.pi * freq_upper, *parameters[1:]))
        if not count < MOST_MODES + 1:
            raise ValueError(
                f"this string has some {np.floor(count):.6g} modes below {freq_upper:g} Hz; "
                f"at most {MOST_MODES} are allowed"
            )
        n_modes = min(_count_below(2 * np.pi * freq_upper, *parameters), MOST_MODES)
        if n_modes < 1:
            raise ValueError(f"no mode of this string lies below {freq_upper:g} Hz")
    if n_modes is None or not 1 <= n_modes <= MOST_MODES:
        raise ValueError(f"a string of {n_modes} modes; 1 to {MOST_MODES} are allowed")
    omega2, vec = _solve(n_modes - 1, *parameters)
    n_sines = len(vec) - 1
    k = np.asarray(np.arange(1, n_sines + 1) * np.pi / length, dtype=np.float64)
    omega = np.sqrt(omega2)
    mode_wavenumber = wavenumber(omega, tension, linear_density, bending_stiffness)
    stiffness = tension * k**2 + bending_stiffness * k**4  # L/2 is left out: it is in the mass too
    shares = length / 2 / linear_density * (stiffness[:, None] * vec[1:] / omega2) ** 2
    partial = np.sqrt(stiffness / linear_density)
    rates = loss_rates(shares, _rates(loss, partial, k), _rates(loss, omega, mode_wavenumber))

    def shape(x: float) -> Floats:
        return np.asarray((1 - x / length) * vec[0] + np.sin(k * x) @ vec[1:])

    def residual_at(x: ArrayLike, y: ArrayLike) -> Floats:
        at_x, at_y = (np.sin(np.asarray(position)[..., None] * k) for position in (x, y))
        sines = np.sum(at_x * (at_y / (tension * k**2 + bending_stiffness * k**4)), axis=-1)
        return np.asarray(held_string_compliance(x, y, length, tension, bending_stiffness) - 2 / length * sines)

    basis = ModalBasis.real(
        natural_freq_rad=omega,
        damping_rate=rates.mode,
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
            "loss_error": rates.error,
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
    its diagonal in the sines is, and so is the Schur complement of the ramp.
    """
    n_sines = int(length / np.pi * wavenumber(limit, tension, linear_density, bending_stiffness))
    k = np.arange(1, n_sines + 1) * np.pi / length
    sines = length / 2 * (tension * k**2 + bending_stiffness * k**4 - limit**2 * linear_density)
    k, sines = k[sines < 0], sines[sines < 0]  # rounding may put the highest at the limit itself
    ramp = tension / length - limit**2 * linear_density * length / 3
    eliminated = ramp - np.cumsum(np.concatenate([[0.0], (limit**2 * linear_density / k) ** 2 / sines]))
    # the sums only grow
    return int(np.searchsorted(eliminated, 0.0))


def _rates(loss: LossFactor, freq_rad: Floats, wavenumber: Floats) -> Floats:
    """Decay rates sigma = omega eta / 2, 1/s, of partials of these frequencies."""
    law = np.asarray(loss(read_only(freq_rad), read_only(wavenumber)))
    if law.dtype.kind not in "fiu":
        raise ValueError(f"the loss law gives numbers of the type {law.dtype}; eta must be real")
    eta = np.broadcast_to(law.astype(np.float64), freq_rad.shape)
    wrong = np.flatnonzero(~(np.isfinite(eta) & (eta >= 0.0)))
    if wrong.size:
        freq = freq_rad[wrong[0]] / (2 * np.pi)
        raise ValueError(f"the loss law gives eta = {eta[wrong[0]]:g} at {freq:.6g} Hz; it must be 0 or more")
    return np.asarray(freq_rad * eta / 2)


@dataclass(frozen=True, slots=True)
class LossRates:
    """Decay rates of modes, 1/s, and by how much of itself each partial's rate differs from the one asked for."""

    mode: Floats
    error: Floats


def loss_rates(shares: Floats, partial: Floats, guess: Floats) -> LossRates:
    """Decay rates s_k >= 0 of modes with which partials, mixtures of these modes, decay as they should.

    sum_k P_nk s_k = sigma_n is solved by s_k <- s_k sum_n P_nk (sigma_n / sum_j P_nj s_j) / sum_n P_nk, which keeps
    every sign (Richardson 1972; Lucy 1974). It ends when no partial is off by more than 5e-5 of its rate. There need
    not be such rates: a law that grows faster than omega^2 and is all there is (bending loss without loss to the
    air), or that has a narrow peak, asks for negative ones. Then the low partials decay too quickly, and `error` says
    by how much.

    shares : (n_partials, n_modes) P_nk >= 0 of each partial's mass; rows sum to 1.
    partial : (n_partials,) sigma_n >= 0, 1/s.
    guess : (n_modes,) >= 0, 1/s, s_k to begin with; those that are 0 stay so.
    """
    if not partial.size:
        return LossRates(guess, np.zeros(0))
    s, column, positive = guess, shares.sum(axis=0), partial > 0.0
    error, before = np.zeros(len(partial)), np.inf
    for i in range(_LOSS_ITERATIONS):
        rates = shares @ s
        error[positive] = rates[positive] / partial[positive] - 1
        worst = np.abs(error).max()
        if worst <= _LOSS_TOLERANCE or not np.all(rates > 0.0):
            break
        if i % _LOSS_PATIENCE == 0:
            if worst > 0.95 * before:  # no such rates exist
                break
            before = worst
        s = s * ((partial / rates) @ shares) / column
    return LossRates(s, error)


def _solve(
    n_sines: int, length: float, tension: float, linear_density: float, bending_stiffness: float
) -> tuple[Floats, Floats]:
    """omega^2 (N + 1,), ascending, and mass-normalised vectors (N + 1, N + 1) in (ramp, sines), the ramp positive.

    With p_n = M_n / K_n of the sines, the N + 1 values y = 1 / omega^2 are the roots of

        F(y) = K_r y - M_r - sum_n (b_n^2 / M_n) p_n / (y - p_n),

    one between every two p_n, one below the least (from 0) and one above the largest (to the trace).
    """
    k = np.arange(1, n_sines + 1) * np.pi / length
    mass, ramp_mass = linear_density * length / 2, linear_density * length / 3
    stiffness = length / 2 * (tension * k**2 + bending_stiffness * k**4)
    ramp_stiffness, coupling, pole = tension / length, linear_density / k, mass / stiffness
    weight = coupling**2 / mass * pole
    high = np.concatenate([[2 * (ramp_mass / ramp_stiffness + pole.sum())], pole])
    low = np.concatenate([pole, [0.0]])
    y = 4 / (1 / np.sqrt(high) + 1 / np.sqrt(np.maximum(low, 0.3 * high))) ** 2  # omega half way between both ends
    y, distance = secular_roots(pole, weight, low, high, y, slope=ramp_stiffness, constant=ramp_mass)
    sines = (coupling / mass * pole)[:, None] / distance.T
    ramp = 1 / np.sqrt(y * (ramp_stiffness + stiffness @ sines**2))
    return 1 / y, np.concatenate([np.ones((1, n_sines + 1)), sines]) * ramp
