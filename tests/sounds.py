"""Measuring sounds: frequency and decay of a partial, without any model of its source."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def partial(x: Floats, fs: float, near: float, *, frame: float = 0.4, hop: float = 0.2) -> tuple[float, float]:
    """Frequency (Hz) and decay rate (1/s) of the partial next to `near`.

    Two Hann windows `hop` seconds apart: the phase between them gives the frequency, the level the decay. Wants no
    other partial within 4 / frame Hz. A decaying oscillation passes both windows alike, so that nothing is biased.
    """
    n, d = round(frame * fs), round(hop * fs)
    w = np.hanning(n)
    freq = near
    for _ in range(4):
        t = np.arange(n) / fs
        probe = w * np.exp(-2j * np.pi * freq * t)
        a, b = probe @ x[:n], probe @ x[d : d + n]
        turned = np.angle(b / a * np.exp(-2j * np.pi * freq * d / fs))
        freq += turned / (2 * np.pi * d / fs)
    return freq, -float(np.log(abs(b / a))) / (d / fs)


def cents(a: float, b: float) -> float:
    return 1200 * float(np.log2(a / b))


def above(x: Floats, fs: float, freq: float) -> Floats:
    """The part of a sound above a frequency, by a steep linear-phase filter; as long as x."""
    from scipy.signal import fftconvolve, firwin

    n = 401
    return np.asarray(fftconvolve(x, firwin(n, freq, fs=fs, pass_zero=False), mode="same"))
