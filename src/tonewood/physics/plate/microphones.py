"""Microphones as a one-way modal bank: residues on the body's own poles for each driven point.

The pressure at r per force at point i is, with modes phi, poles p_k and the Rayleigh sums G_k (`radiation`),

    P_i(s) = exp(-s t0) sum_k G_k(s) s^2 phi_ki / ((s - p_k)(s - conj p_k)),        t0 the delay of the nearest source

G_k is a short sum of delays. The bank sum_k R_ki / (s - p_k) + conj. follows P_i exp(s t0) by least squares, weighted
for equal relative error at all frequencies up to the highest mode. Its poles are the body's and, besides, some of high
damping, as close as the spread of delays asks for. P(0) = P'(0) = 0 are conditions: a force at rest makes no sound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.plate.air import SOUND_SPEED
from tonewood.physics.plate.radiation import Sources
from tonewood.support.arrays import Complexes, Floats

#: Hz, lowest frequency of equal relative error
_LOWEST = 50.0
#: highest pole of high damping, as a multiple of the highest mode's frequency
_BEYOND = 2.5
#: level of the error that is allowed above the highest mode, as a multiple of that below
_ABOVE = 10.0
#: weight of the conditions at 0
_CONDITION = 1e3


@dataclass(frozen=True, eq=False)
class Bank:
    """Residues of a microphone.

    poles : (n,) 1/s, the body's, -omega_b of the shelf, and those of high damping; one of each pair.
    residues : (n, inputs) Pa/(N s).
    delay : s, that is not in the residues.
    error_db : median and 95th percentile of the error over frequency and inputs, dB.
    """

    poles: Complexes
    residues: Complexes
    delay: float
    error_db: tuple[float, float]

    def response(self, freq: ArrayLike) -> Complexes:
        """(n_freq, inputs) Pa/N."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64))[:, None]
        lower = (1 / (s - self.poles.conj())) @ (self.residues.conj() * (self.poles.imag > 0)[:, None])
        return np.asarray((1 / (s - self.poles)) @ self.residues + lower)


def pressure(
    sources: Sources, at: ArrayLike, poles: Complexes, shapes: Floats, freq: Floats, delay: float
) -> Complexes:
    """(n_freq, inputs) Pa/N at a position (3,) m: the sum that a bank follows, `delay` (s) taken out.

    poles : (n,) of the modes whose volumes `sources` has.
    shapes : (inputs, n) at the driven points.
    """
    s = 2j * np.pi * freq
    gains = sources.pressure(at, freq, delay).T
    modal = s[:, None] ** 2 / ((s[:, None] - poles) * (s[:, None] - poles.conj()))
    return np.asarray((gains * modal) @ shapes.T)


def microphone(
    sources: Sources, at: ArrayLike, poles: Complexes, shapes: Floats, highest: float, delay: float | None = None
) -> Bank:
    """Fit the bank of one microphone.

    at : (3,) m.
    poles, shapes : as for `pressure`; shapes (inputs, n) at every point that may be driven.
    highest : Hz, that the bank is stepped up to; poles of high damping above it are left out.
    delay : s, taken out; that of the nearest source where left out. A smaller one stays in the bank.
    """
    from tonewood.support.scipy_linalg import sla

    delay = float(sources.distances(at).min()) / SOUND_SPEED if delay is None else delay
    freq = _frequencies(poles, highest)
    target = pressure(sources, at, poles, shapes, freq, delay)
    top = float(np.abs(poles).max() / (2 * np.pi))
    wide = _background(sources, at, top, delay)
    every = np.concatenate([poles, wide[np.abs(wide) < 2 * np.pi * highest]])
    s = 2j * np.pi * freq[:, None]
    columns = _columns(s, every)
    level = np.sqrt(np.mean(np.abs(target) ** 2, axis=1))
    level = np.maximum(level, 1e-3 * level.max())
    weight = 1 / np.where(freq <= top, level, _ABOVE * level)
    conditions = np.vstack([_columns(np.zeros((1, 1)), every).real, _slope(every)]) * _CONDITION
    conditions[1] *= 2 * np.pi * _LOWEST
    rows = np.vstack([(columns * weight[:, None]).real, (columns * weight[:, None]).imag, conditions / level.max()])
    right = np.vstack([(target * weight[:, None]).real, (target * weight[:, None]).imag, np.zeros((2, len(shapes)))])
    size = np.sqrt((rows**2).sum(axis=0))
    size[len(every) :][every.imag == 0] = np.inf  # a real pole has a real residue
    filters = sla.lstsq(rows / size, right, cond=1e-9, lapack_driver="gelsy")[0] / size[:, None]
    bank = Bank(every, filters[: len(every)] + 1j * filters[len(every) :], delay, (0.0, 0.0))
    heard = (freq >= _LOWEST) & (freq <= top)
    ratio = bank.response(freq[heard]) - target[heard]
    error = 20 * np.log10(1 + np.abs(ratio) / np.maximum(np.abs(target[heard]), 1e-2 * level[heard, None]))
    return Bank(every, bank.residues, delay, (float(np.median(error)), float(np.percentile(error, 95))))


def _background(sources: Sources, at: ArrayLike, top: float, delay: float) -> Complexes:
    """Poles of high damping up to `_BEYOND` times `top` (Hz), and that of the shelf.

    A delay of T changes over 1/T Hz: poles 1/T apart and as wide, T the spread of delays, follow the sum of the tails
    of the body's modes between their resonances.
    """
    farthest = max(float(r.max(initial=0.0)) for r in (sources.distances(at), sources.distances_behind(at)))
    spread = farthest / SOUND_SPEED - delay
    step = min(1.0 / spread, 0.3 * top)
    pairs = 2 * np.pi * step * ((np.arange(int(_BEYOND * top / step)) + 0.5) * 1j - 1.0)
    return np.asarray(pairs if sources.baffled else np.concatenate([[-sources.shelf + 0j], pairs]))


def _frequencies(poles: Complexes, highest: float) -> Floats:
    """Frequencies (Hz) of a fit: even in logarithm, and close about every pole."""
    near = np.abs(poles[:, None]) / (2 * np.pi) - poles.real[:, None] / (2 * np.pi) * np.array(
        [-2, -1, -0.5, 0, 0.5, 1, 2]
    )
    freq = np.concatenate([np.geomspace(5.0, highest, 1200), near.ravel()])
    return np.unique(freq[(freq >= 5.0) & (freq <= highest)])


def _columns(s: NDArray[np.inexact], poles: Complexes) -> Complexes:
    """(n, 2 m) response per real and per imaginary part of each residue."""
    upper, lower = 1 / (s - poles), (poles.imag > 0) / (s - poles.conj())
    return np.asarray(np.hstack([upper + lower, 1j * (upper - lower)]))


def _slope(poles: Complexes) -> Floats:
    """(1, 2 m) the same for its derivative at s = 0."""
    upper, lower = 1 / poles**2, (poles.imag > 0) / poles.conj() ** 2
    return np.asarray(-np.concatenate([upper + lower, 1j * (upper - lower)]).real[None, :])
