"""Gain over frequency as a cascade of bells and shelves: of any smooth course, of minimum phase.

    bell:   H(s) = (s^2 + sqrt(g) (w/q) s + w^2) / (s^2 + (w/q) s / sqrt(g) + w^2),    |H(i w)| = g
    shelf:  H(s) = (g s + sqrt(g) w) / (s + sqrt(g) w),                                |H(i w)| = sqrt(g)

by the bilinear transform, with w kept in place: s = w / tan(w h / 2) (z - 1) / (z + 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tonewood.support.arrays import Complexes, Floats

#: Hz, dB, and the quality of a bell; None for a shelf
Band = tuple[float, float, float | None]

#: share of the sampling rate above which the middle of a band is out of reach; it is left out
_HIGHEST = 0.49


class Equalizer:
    """Filters the channels of a streamed sound; samples do not depend on the size of blocks.

    bands : of each channel. One whose middle lies above 0.49 `fs` is left out.
    fs : sampling rate, Hz.
    memory : (n_sections, n_channels, 2) state of the filters.
    """

    def __init__(self, bands: Sequence[Sequence[Band]], fs: float):
        rows = [[section(band, fs) for band in channel if band[0] < _HIGHEST * fs] for channel in bands]
        longest = max(map(len, rows), default=0)
        through = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]
        self._sections = [np.array(row + [through] * (longest - len(row))) for row in rows]
        self.memory: Floats = np.zeros((longest, len(rows), 2))

    def __bool__(self) -> bool:
        return len(self.memory) > 0

    def __call__(self, sound: Floats) -> Floats:
        """(n, n_channels) filtered frames that follow those of the last call."""
        if not self or not len(sound):
            return sound
        from scipy.signal import sosfilt

        out = np.empty_like(sound)
        for channel, sections in enumerate(self._sections):
            column = np.ascontiguousarray(sound[:, channel])
            state = np.ascontiguousarray(self.memory[:, channel])
            out[:, channel], self.memory[:, channel] = sosfilt(sections, column, zi=state)
        return out


def section(band: Band, fs: float) -> list[float]:
    """Coefficients b0, b1, b2, a0 = 1, a1, a2 of a band at a sampling rate (Hz)."""
    freq, gain_db, q = band
    g = 10 ** (gain_db / 20)
    t, root = math.tan(math.pi * freq / fs), math.sqrt(g)
    if q is None:
        b = [g + root * t, root * t - g, 0.0]
        a = [1 + root * t, root * t - 1, 0.0]
    else:
        up, down = root * t / q, t / (q * root)
        b = [1 + up + t * t, 2 * (t * t - 1), 1 - up + t * t]
        a = [1 + down + t * t, 2 * (t * t - 1), 1 - down + t * t]
    return [x / a[0] for x in (*b, *a)]


def response_db(bands: Sequence[Band], freq: Floats) -> Floats:
    """(n_freq,) dB, gain of a cascade of bands at frequencies (Hz), in continuous time."""
    total = np.zeros_like(freq, dtype=np.float64)
    for middle, gain_db, q in bands:
        s: Complexes = np.asarray(1j * freq / middle)
        root = 10 ** (gain_db / 40)
        total += 20 * np.log10(np.abs(_shelf(s, root) if q is None else _bell(s, root, q)))
    return total


def _shelf(s: Complexes, root: float) -> Complexes:
    """(n_freq,) response at s, re the middle; `root` is that of the gain."""
    return np.asarray((root**2 * s + root) / (s + root))


def _bell(s: Complexes, root: float, q: float) -> Complexes:
    """(n_freq,) response at s, re the middle; `root` is that of the gain."""
    return np.asarray((s * s + root / q * s + 1) / (s * s + s / (q * root) + 1))
