"""Errors of a method's motion, in numbers.

Pitch and decay are read from the poles the method puts in place of the true ones, waveforms from its samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.support.arrays import Complexes, Floats

#: centres of the third-octave bands that are compared, Hz, and how far below the loudest, dB
BANDS, BAND_FLOOR = 1000.0 * 2.0 ** (np.arange(-13, 13) / 3), -80.0
#: a component this far from every true one is spurious, Hz
SPURIOUS_GAP = 20.0


@dataclass(frozen=True, slots=True)
class PoleErrors:
    """Errors of partials.

    cents_median, cents_worst : |interval| to the true partials, cents.
    cents_20 : worst of partials 1 to 20.
    decay_median, decay_worst : |error| of decay rates, relative.
    lost : partials that have no pole of the method near them.
    """

    cents_median: float
    cents_worst: float
    cents_20: float
    decay_median: float
    decay_worst: float
    lost: int


def pole_errors(poles: Complexes, true: Complexes, numbers: NDArray[np.intp] | None = None) -> PoleErrors:
    """Compare poles with the true ones; a partial farther off than half its distance to the next (nan too) is lost.

    numbers : (k,) of the partials, 1, 2, ... where left out.
    """
    n = np.arange(1, len(true) + 1) if numbers is None else numbers
    near = np.abs(poles.imag - true.imag) < 0.5 * true.imag / n
    if not near.any():
        return PoleErrors(np.nan, np.nan, np.nan, np.nan, np.nan, len(true))
    cents = np.abs(1200 * np.log2(poles.imag[near] / true.imag[near]))
    decay = np.abs(poles.real[near] / true.real[near] - 1)
    low = n[near] <= 20
    return PoleErrors(
        float(np.median(cents)),
        float(cents.max()),
        float(cents[low].max()) if low.any() else np.nan,
        float(np.median(decay)),
        float(decay.max()),
        int(np.sum(~near)),
    )


@dataclass(frozen=True, slots=True)
class WaveErrors:
    """Errors of a waveform.

    waveform : ||y - y_true|| / ||y_true||.
    spectral_db : rms difference of third-octave levels, dB; see `wave_errors`.
    spurious_db : highest component that is not there in truth, dB re the true spectrum's peak.
    """

    waveform: float
    spectral_db: float
    spurious_db: float


def wave_errors(y: Floats, true: Floats, fs: float, partials: Complexes) -> WaveErrors:
    """Compare displacements (n,) at fs Hz.

    The spectral distance is that of accelerations, nearer to hearing: levels in third-octave bands from 50 Hz to
    16 kHz of the spectrum under a Hann window, times omega^2; rms of the level difference over all bands where the true
    one is within 80 dB of the loudest. Spurious is the largest acceleration in the spectrum of y - y_true farther than
    20 Hz from every true partial.

    partials : (k,) poles of the true motion, 1/s.
    """
    error = y - true
    if not np.all(np.isfinite(error)):
        return WaveErrors(np.nan, np.nan, np.nan)
    from scipy.fft import rfft, rfftfreq

    window = np.hanning(len(y))
    freq = rfftfreq(len(y), 1 / fs)
    weight = (2 * np.pi * freq) ** 2
    tiny = np.finfo(float).tiny
    ours, theirs, wrong = (np.abs(rfft(signal * window)) * weight for signal in (y, true, error))
    band = np.digitize(freq, BANDS * 2 ** (-1 / 6))
    levels = [
        10 * np.log10(np.maximum(np.bincount(band, spectrum**2, len(BANDS) + 1)[1:], tiny))
        for spectrum in (ours, theirs)
    ]
    there = (0.45 * fs > BANDS * 2 ** (1 / 6)) & (levels[1] > levels[1].max() + BAND_FLOOR)
    true_freq = np.sort(np.concatenate([[0.0], np.abs(partials.imag) / (2 * np.pi), [1e12]]))
    after = np.searchsorted(true_freq, freq).clip(1, len(true_freq) - 1)
    apart = np.minimum(freq - true_freq[after - 1], true_freq[after] - freq) > SPURIOUS_GAP
    apart &= freq < 0.5 * fs
    return WaveErrors(
        float(sla.norm(error) / sla.norm(true)),
        float(np.sqrt(np.mean((levels[0] - levels[1])[there] ** 2))),
        float(20 * np.log10(max(wrong[apart].max(), tiny) / theirs.max())) if apart.any() else np.nan,
    )


def energy_drift(energies: Floats) -> float:
    """Largest change of the stored energy of an undamped system, relative to the first."""
    return float(np.max(np.abs(energies / energies[0] - 1)))
