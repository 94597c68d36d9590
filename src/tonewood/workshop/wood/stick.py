"""Young's modulus along the grain of a free brace stick, from its size, mass and taps.

Bending of a Timoshenko bar that is free at both ends. With b^2 = rho A L^4 w^2 / (E I), r^2 = I / (A L^2) and
s^2 = E I / (k G A L^2), alpha, beta as below, the frequencies are the zeros of

    2 - 2 cosh(b alpha) cos(b beta) + b (b^2 r^2 (r^2 - s^2)^2 + (3 r^2 - s^2)) sinh(b alpha) sin(b beta)
                                      / sqrt(1 - b^2 r^2 s^2),
    alpha, beta = sqrt((-+ (r^2 + s^2) + sqrt((r^2 - s^2)^2 + 4 / b^2)) / 2).

Source: T. C. Huang, J. Appl. Mech. 28 (1961) 579, free-free case; k = 5/6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.plate.plate import SHEAR_FACTOR
from tonewood.support.arrays import Floats
from tonewood.workshop.wood.board import MODEL_ERROR, NORMAL_90, losses_of, sorted_peaks

#: b L of a slender free bar's modes: cosh x cos x = 1
_SLENDER = np.array([4.730040745, 7.853204624, 10.99560784, 14.13716549, 17.27875966, 20.42035225])
#: standard deviation of ln (G / E_L) about the species' own
_SHEAR_SPREAD = 0.4
#: of ln f between a peak and a mode that are paired
_PAIRED = 0.12


@dataclass(frozen=True, eq=False)
class Stick:
    """Constants of a stick.

    E_L, density : Pa, kg/m^3.
    loss_L : loss factor; None where no peak has a Q.
    intervals : name -> 90 % interval of E_L, and of loss_L.
    measured, computed : Hz, peaks and the modes that they are taken for, by pairs.
    peaks_without_mode : Hz.
    """

    E_L: float
    density: float
    loss_L: float | None
    intervals: dict[str, tuple[float, float]]
    measured: tuple[float, ...]
    computed: tuple[float, ...]
    peaks_without_mode: tuple[float, ...]


def bar_freq(length: float, height: float, density: float, young: float, shear: float, count: int = 6) -> Floats:
    """Frequencies (count,) Hz of a free Timoshenko bar of rectangular section, 6 at most.

    length, height : m; the bar bends across `height`.
    density : kg/m^3.
    young, shear : Pa.
    """
    from scipy.optimize import brentq

    r2 = height**2 / 12 / length**2
    s2 = r2 * young / (SHEAR_FACTOR * shear)
    scale = np.sqrt(young * height**2 / 12 / density) / length**2 / (2 * np.pi)

    def equation(b: float) -> float:
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        alpha, beta = np.sqrt((-(r2 + s2) + root) / 2), np.sqrt((r2 + s2 + root) / 2)
        a, c = b * alpha, b * beta
        rest = b * (b**2 * r2 * (r2 - s2) ** 2 + 3 * r2 - s2) / np.sqrt(1 - b**2 * r2 * s2)
        return float((2 - 2 * np.cosh(a) * np.cos(c) + rest * np.sinh(a) * np.sin(c)) / np.cosh(a))

    out: list[float] = []
    highest = 0.99 / np.sqrt(r2 * s2)  # above it both waves along the bar travel
    grid = np.linspace(0.3 * _SLENDER[0] ** 2, min(_SLENDER[count - 1] ** 2 * 1.02, highest), 2000)
    values = [equation(b) for b in grid]
    for i in np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1])):
        out.append(brentq(equation, grid[i], grid[i + 1], xtol=1e-12) * scale)
    return np.array(out[:count])


def estimate_stick(
    length: float,
    width: float,
    height: float,
    mass: float,
    freq: Sequence[float],
    errors: Sequence[float],
    q: Sequence[float] = (),
    *,
    shear_ratio: float,
    thickness_error: float = 5e-5,
    size_error: float = 5e-4,
    model_error: float = MODEL_ERROR,
) -> Stick:
    """Estimate E_L of a stick tapped across its `height`.

    The lowest peak is the first mode; each further peak is paired with the mode that is nearest, within 12 %.

    length, width, height : m.
    mass : kg.
    freq, errors : (n,) Hz, peaks and their standard deviations.
    q : (n,) quality factors; the loss is not estimated without them.
    shear_ratio : G_LT / E_L of the species.
    thickness_error, size_error, model_error : as for a board; the error of the height is `thickness_error`.
    Raises ValueError : there is no peak.
    """
    if not len(freq):
        raise ValueError("no peak; one or more are wanted")
    peaks, spread, quality = sorted_peaks(freq, errors, q, model_error)
    density = mass / (length * width * height)

    def log_freq(theta: Floats) -> Floats:
        young = np.exp(theta[0])
        return np.log(bar_freq(length, height, density, young, young * np.exp(theta[1])))

    mean = np.array([0.0, np.log(shear_ratio)])
    unit = bar_freq(length, height, density, 1e10, 1e10 * shear_ratio)[0]
    theta = np.array([np.log(1e10 * (peaks[0] / unit) ** 2), mean[1]])
    i = j = np.zeros(1, dtype=np.intp)
    for _ in range(8):
        modes = log_freq(theta)
        j = np.abs(np.log(peaks)[:, None] - modes).argmin(axis=1)
        near = np.abs(np.log(peaks) - modes[j]) < _PAIRED
        i = np.array([k for k in np.flatnonzero(near) if k == _nearest(np.log(peaks), modes, j, near, j[k])])
        j = j[i]
        jacobian = np.column_stack([(log_freq(theta + d)[j] - log_freq(theta - d)[j]) / 2e-4 for d in 1e-4 * np.eye(2)])
        rows = np.vstack([jacobian / spread[i, None], [[0.0, 1 / _SHEAR_SPREAD]]])
        right = np.append((np.log(peaks[i]) - log_freq(theta)[j]) / spread[i], (mean[1] - theta[1]) / _SHEAR_SPREAD)
        theta = theta + np.linalg.lstsq(rows, right, rcond=None)[0]
    modes = log_freq(theta)
    worse = max(1.0, float(np.sum(((np.log(peaks[i]) - modes[j]) / spread[i]) ** 2)) / max(len(i) - 1, 1))
    variance = worse * np.linalg.inv(rows.T @ rows)[0, 0]
    # at a given mass E follows f^2 L^3 / (w h^3)
    sizes = np.hypot(3 * thickness_error / height, np.hypot(3 * size_error / length, size_error / width))
    error = float(np.hypot(np.sqrt(variance), sizes))
    young = float(np.exp(theta[0]))
    losses, loss_intervals = losses_of(quality[i], np.ones((len(i), 1)), ("loss_L",), fewest=1)
    return Stick(
        E_L=young,
        density=density,
        loss_L=losses.get("loss_L"),
        intervals={"E_L": (young * np.exp(-NORMAL_90 * error), young * np.exp(NORMAL_90 * error))} | loss_intervals,
        measured=tuple(map(float, peaks[i])),
        computed=tuple(map(float, np.exp(modes[j]))),
        peaks_without_mode=tuple(map(float, np.delete(peaks, i))),
    )


def _nearest(peaks: Floats, modes: Floats, j: NDArray[np.intp], near: NDArray[np.bool_], mode: int) -> int:
    """Peak nearest to a mode among those that are paired with it."""
    mine = np.flatnonzero((j == mode) & near)
    return int(mine[np.argmin(np.abs(peaks[mine] - modes[mode]))])
