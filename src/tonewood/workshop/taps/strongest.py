"""Peaks of taps on a bare board: the maxima of the mean spectrum, each fitted by itself.

`ringing` explains everything that was recorded by modes; where supports slip between taps one resonance becomes several
there. For the constants of a board, each strong resonance must be listed once. About a maximum of the mean power one
pole pair is fitted to all taps' spectra X_k,

    X_k(s) (s^2 + c_1 s + c_0) = b_k0 + b_k1 s,    omega^2 = c_0,  Q = omega / c_1,

linear in all coefficients and weighted by the denominator of the iteration before (C. K. Sanathanan and J. Koerner,
IEEE Trans. Autom. Control 8 (1963) 56). The same of each tap by itself gives the scatter of the frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.support.arrays import Complexes, Floats

#: s, longest part of a tap
_LONGEST = 2.0
#: dB, by which a peak stands out of the mean spectrum, and below the highest at most
_STANDS, _DEEPEST = 6.0, 50.0
#: share of its frequency within which a tap's own peak is the same
_SAME = 0.015


@dataclass(frozen=True, slots=True)
class StrongPeak:
    """A resonance that taps excite: Hz, Q, and the standard deviation of the frequency among taps, Hz."""

    freq: float
    quality: float
    error: float


def strongest(taps: Sequence[Floats], fs: float, band: tuple[float, float], most: int = 30) -> list[StrongPeak]:
    """Resonances between two frequencies, by frequency.

    taps : samples of each.
    fs : Hz.
    band : Hz, lowest and highest frequency.
    most : number of them, the highest.
    """
    from scipy.signal import find_peaks

    taps = [tap[: int(_LONGEST * fs)] for tap in taps]
    n = 4 * max(len(tap) for tap in taps)
    freq = np.fft.rfftfreq(n, 1 / fs).astype(np.float64)
    inside = (freq >= band[0]) & (freq <= band[1])
    spectra = np.array([np.fft.rfft(_faded(tap), n)[inside] for tap in taps])
    freq = freq[inside]
    spectra = spectra[np.any(spectra != 0.0, axis=1)]
    if not len(spectra):
        return []
    spectra /= np.sqrt(np.mean(np.abs(spectra) ** 2, axis=1))[:, None]
    level = 10 * np.log10(np.mean(np.abs(spectra) ** 2, axis=0) + 1e-30)
    apart = max(1, int(0.01 * band[0] / (freq[1] - freq[0])))
    maxima, _ = find_peaks(level, prominence=_STANDS, height=level.max() - _DEEPEST, distance=apart)
    out: list[StrongPeak] = []
    for index in sorted(maxima, key=lambda i: -level[i])[:most]:
        pole = _pole(freq, spectra, float(freq[index]))
        if pole is None or abs(pole[0] / freq[index] - 1) > _SAME:
            continue
        if any(abs(pole[0] - other.freq) < 0.5 * other.freq / other.quality for other in out):
            continue  # the shoulder of a higher peak
        alone = [one[0] for x in spectra if (one := _pole(freq, x[None], float(freq[index]))) is not None]
        near = np.array([f for f in alone if abs(f / pole[0] - 1) < _SAME])
        scatter = float(np.std(near, ddof=1) / np.sqrt(len(near))) if len(near) > 1 else 0.0
        least = 0.02 * pole[0] / pole[1]  # of its width
        out.append(StrongPeak(*pole, max(scatter, least)))
    return sorted(out, key=lambda peak: peak.freq)


def _faded(tap: Floats) -> Floats:
    """A tap whose last fifth fades out."""
    n = len(tap) // 5
    out = tap - tap.mean()
    out[-n:] *= 0.5 * (1 + np.cos(np.pi * np.arange(n) / n))
    return np.asarray(out)


def _pole(freq: Floats, spectra: Complexes, start: float) -> tuple[float, float] | None:
    """Hz and Q of the pole pair about a frequency; None where there is no damped one."""
    step = float(freq[1] - freq[0])
    f, q = start, start / max(0.01 * start, 4 * step)
    for _ in range(4):
        some = np.abs(freq - f) < max(2.0 * f / q, 3 * step)
        s = 1j * freq[some] / f  # in units of omega
        weight = 1 / np.abs(s**2 + s / q + 1)
        x = spectra[:, some]
        taps, points = x.shape
        rows = np.zeros((taps, points, 2 + 2 * taps), dtype=np.complex128)
        rows[:, :, 0], rows[:, :, 1] = x * s * weight, x * weight
        for k in range(taps):
            rows[k, :, 2 + 2 * k], rows[k, :, 3 + 2 * k] = -weight, -s * weight
        matrix, right = rows.reshape(taps * points, -1), -(x * s**2 * weight).ravel()
        poles, residues = matrix[:, :2], matrix[:, 2:]  # c_1 and c_0 are real, the residues are not
        whole = np.vstack([
            np.hstack([poles.real, residues.real, -residues.imag]),
            np.hstack([poles.imag, residues.imag, residues.real]),
        ])  # fmt: skip
        c1, c0 = np.linalg.lstsq(whole, np.concatenate([right.real, right.imag]), rcond=None)[0][:2]
        if not (c0 > 0.5 and 0 < c1 < 0.5):
            return None
        f, q = float(f * np.sqrt(c0)), float(np.sqrt(c0) / c1)
    return f, q
