"""Frequencies and Q of modes, with their intervals, from several taps at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.identify import LEAST_NOISE, identify
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape
from tonewood.workshop.fit.search import NothingFoundError, descend

#: standard deviations of half of a central interval of 90 % of a normal distribution
NORMAL_90 = 1.6449
#: combinations of taps that are fitted, and share of the energy that they hold
_ROWS, _ENERGY = 4, 0.999
#: Q below which a pole is background; dB below the strongest at which a peak is none
_LEAST_Q, _WEAKEST = 4.0, -50.0
#: error of linear modes, re what was recorded: supports slip, and damping depends on amplitude
LEAST_ERROR = 0.1
#: share of the level at its frequency that a mode has to have
_OWN = 0.35
#: chi-squared of the two numbers of a mode in one tap above which it is seen there
_SEEN = 18.4
#: fewest bins of a band
_FEWEST = 32


@dataclass(frozen=True)
class Peak:
    """A mode that rings after taps.

    Attributes
    ----------
    freq, quality : Hz, and Q = 1 / (2 zeta).
    freq_90, quality_90 : intervals of 90 %.
    level : dB, amplitude at the tap's beginning re the strongest peak, the mean square over the taps.
    seen : taps in which it stands out of the noise (probability by chance 1e-4).
    taps : all taps.
    """

    freq: float
    quality: float
    freq_90: tuple[float, float]
    quality_90: tuple[float, float]
    level: float
    seen: int
    taps: int

    @property
    def certain(self) -> bool:
        """Whether most taps show it, and its Q is known within a factor of 1.5."""
        return 2 * self.seen > self.taps and self.quality_90[1] < 1.5**2 * self.quality_90[0]


@one_blas_thread
def ringing(taps: Sequence[Floats], fs: float, band: tuple[float, float] = (50.0, 1000.0)) -> list[Peak]:
    """Estimate frequencies and Q of the modes that ring after taps, with their intervals.

    After the contact, x(t) = Re sum_k c_k exp(p_k t). The transform of T seconds, at bins n / T, has the same poles

        X(s) = sum_k c_k (1 - exp(p_k T)) / (2 (s - p_k)) + conjugates,

    whether or not the sound has ended, so there is no leakage. All taps share the poles; each has its own residues.

    A body on supports is not exactly linear: a support slips between taps, and damping depends on amplitude. No mode is
    added to explain errors below 10 %. A mode whose own part is less than 0.35 of the level at its frequency (r.m.s.
    of the taps) is the misfit of its neighbour's skirt: the others are fitted without it.

    Parameters
    ----------
    taps : samples of each, of the free motion, all of one length (see `cut_taps` and `Taps.analysed`).
    fs : Hz.
    band : Hz, lowest and highest frequency.

    Raises
    ------
    TonewoodError : no tap, a band of fewer than 32 bins, or nothing stands out of the noise.
    """
    if not taps:
        raise TonewoodError("there is no tap to be analysed", key="taps")
    if not 0 < band[0] < band[1] <= 0.5 * fs:
        raise TonewoodError(f"is {band[0]:g} {band[1]:g} Hz; 0 to {0.5 * fs:g} Hz, rising, are allowed", key="--band")
    freq, spectra = _spectra(taps, fs, band)
    rows = _combined(spectra)
    shape = Shape((), len(rows))
    try:
        modes = identify(freq, rows, shape, damping="viscous", least_error=LEAST_ERROR)
    except NothingFoundError:
        raise TonewoodError(
            "nothing that rings stands out of the noise: tap harder, nearer to the microphone", key="taps"
        ) from None
    problem, poles = _standing(*modes.bent[:2], freq, spectra)
    by_freq, by_zeta, _ = problem.deviations(poles)
    amplitude, seen = _in_each_tap(freq, spectra, poles)
    level = 20 * np.log10(np.sqrt(np.mean(amplitude**2, axis=0)) + 1e-300)
    inside = (poles.freq >= band[0]) & (poles.freq <= band[1]) & (poles.quality >= _LEAST_Q)
    inside &= np.isfinite(by_freq) & np.isfinite(by_zeta)
    level = level - level[inside].max(initial=-np.inf)
    return [
        Peak(
            float(poles.freq[i]), float(poles.quality[i]), _interval(poles.freq[i], by_freq[i]),
            _interval(poles.quality[i], by_zeta[i]), float(level[i]), int(seen[:, i].sum()), len(taps),
        )
        for i in np.flatnonzero(inside & (level > _WEAKEST))
    ]  # fmt: skip


def _interval(value: float, deviation: float) -> tuple[float, float]:
    """Central interval of 90 %, of a normal error of the logarithm."""
    return float(value * np.exp(-NORMAL_90 * deviation)), float(value * np.exp(NORMAL_90 * deviation))


def _spectra(taps: Sequence[Floats], fs: float, band: tuple[float, float]) -> tuple[Floats, Complexes]:
    """Bins of the band, and (n_taps, N) transforms of the same length of each tap."""
    n = len(taps[0])
    freq = np.fft.rfftfreq(n, 1 / fs)
    inside = (freq >= band[0]) & (freq <= band[1])
    if np.count_nonzero(inside) < _FEWEST:
        raise TonewoodError(
            f"{np.count_nonzero(inside)} bins of {fs / n:.3g} Hz lie between {band[0]:g} and {band[1]:g} Hz; "
            f"{_FEWEST} or more are needed: a wider band, or taps that ring longer", key="--band",
        )  # fmt: skip
    samples = np.array(taps)
    samples[:, 0] *= 0.5  # the trapezoid rule: sums are integrals but for terms of (s dt)^2 / 12
    return np.asarray(freq[inside], dtype=np.float64), np.asarray(np.fft.rfft(samples)[:, inside] / fs)


def _combined(spectra: Complexes) -> Complexes:
    """A few real combinations of taps that hold nearly all energy: taps on one place are much alike."""
    if len(spectra) == 1:
        return spectra
    unit = spectra / np.sqrt(np.mean(np.abs(spectra) ** 2, axis=1, keepdims=True))
    values, vectors = sla.eigh((unit @ unit.conj().T).real)
    order = np.argsort(-values)
    share = np.cumsum(values[order]) / values.sum()
    kept = order[: min(_ROWS, int(np.searchsorted(share, _ENERGY)) + 1)]
    return np.asarray(vectors[:, kept].T @ unit)


def _standing(problem: Projection, poles: Poles, freq: Floats, spectra: Complexes) -> tuple[Projection, Poles]:
    """The modes that are peaks, fitted without the others, and the problem with the noise that these leave."""
    together = Projection(FitData(freq, spectra, np.ones(spectra.shape)), Shape((), len(spectra)))
    while len(poles) > 1:
        columns, k = together.columns(poles)[0], len(poles)
        residues = together.solve(poles).residues
        at = np.clip(np.searchsorted(freq, poles.freq), 0, freq.size - 1)
        shares = residues[:, :k] * columns[np.arange(k), at] + residues[:, k : 2 * k] * columns[np.arange(k, 2 * k), at]
        there = together.model(poles, residues)[:, at]
        share = np.sqrt((np.abs(shares) ** 2).sum(axis=0) / (np.abs(there) ** 2).sum(axis=0))
        weak: list[int] = []
        for i in np.argsort(share):
            # neighbours stand in for each other: one of them at a time
            if share[i] < _OWN and all(abs(int(i) - j) > 1 for j in weak):
                weak.append(int(i))
        if not weak:
            break
        poles, solution = descend(problem, poles.without(weak), 12, 1e-6)
        level = np.maximum(
            noise.of_misfit(problem.misfit(poles, solution.residues), problem.model(poles, solution.residues)),
            LEAST_NOISE * np.abs(problem.data.mobility),
        )
        problem = Projection(replace(problem.data, sigma=level), problem.shape)
    return problem, poles


def _in_each_tap(freq: Floats, spectra: Complexes, poles: Poles) -> tuple[Floats, NDArray[np.bool_]]:
    """(n_taps, K) amplitudes when the tap began, and whether each mode stands out of that tap's noise."""
    shape, k = Shape((), len(spectra)), len(poles)
    data = FitData(freq, spectra, np.ones(spectra.shape))
    problem = Projection(data, shape)
    left = problem.misfit(poles, problem.solve(poles).residues)
    level = np.maximum(noise.of_misfit(left), LEAST_NOISE * np.abs(spectra))
    solution = Projection(replace(data, sigma=level), shape).solve(poles)
    chi2 = solution.chi2[:, :k] + solution.chi2[:, k : 2 * k]
    decayed = -np.expm1(-np.pi * poles.freq / poles.quality / float(np.median(np.diff(freq))))
    return np.hypot(solution.residues[:, :k], solution.residues[:, k : 2 * k]) / decayed, chi2 > _SEEN
