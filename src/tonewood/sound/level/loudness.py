"""Loudness and true peak of a sound (ITU-R BS.1770-4), and the gain that brings it to a loudness.

Signals are float64 of shape (n, channels), 1.0 is full scale.
"""

from __future__ import annotations

import cmath
import math
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from tonewood.errors import OutputError
from tonewood.support.arrays import Floats
from tonewood.support.units import decibel

BLOCK = 0.400  # s, gating block of BS.1770
_REACH, _REACH_GAIN = 10, 2.25  # of scipy's fourfold filter: samples each side, and sum of |h| (2.2414) over them
METER_FS = 48000  # Hz, the rate for which BS.1770 gives its filters
OVERSAMPLING = 4
#: K-weighting at 48 kHz, BS.1770-4 tables 1 and 2
_K_WEIGHTING = (
    (1.53512485958697, -2.69169618940638, 1.19839281085285, 1.0, -1.69065929318241, 0.73248077421585),
    (1.0, -2.0, 1.0, 1.0, -1.99004745483398, 0.99007225036621),
)


def resampled(audio: Floats, fs: int, target: int) -> Floats:
    """The sound at another rate, by a linear-phase polyphase filter (flat to 0.45 of the lower rate, -100 dB)."""
    if fs == target:
        return audio
    from scipy.signal import firwin, kaiserord, resample_poly

    ratio = Fraction(target, fs)
    up, down = ratio.numerator, ratio.denominator
    widest = max(up, down)
    taps, beta = kaiserord(110.0, 0.1 / widest)  # transition from 0.9 to 1.0 of the lower Nyquist frequency
    kernel = firwin(taps | 1, 0.95 / widest, window=("kaiser", beta))
    return np.asarray(
        resample_poly(audio, up, down, axis=0, window=kernel)  # type: ignore[call-overload]  # stubs lack kernels
    )


def loudness(audio: Floats, fs: int) -> tuple[float, bool]:
    """Loudness by BS.1770-4, LUFS, and whether its gates applied; (-inf, False) for silence.

    A sound shorter than a gating block is padded with zeros to one block and measured whole: no gate can apply. Nor
    can one to a sound that lies below the absolute gate throughout; it is measured at full scale.
    """
    peak = float(np.max(np.abs(audio), initial=0.0))
    if peak == 0.0:
        return -math.inf, False
    block = math.ceil(BLOCK * fs)
    if len(audio) >= block and math.isfinite(lufs := _gated(audio, fs)):
        return lufs, True
    padded: Floats = np.pad(audio / peak, ((0, max(0, block - len(audio))), (0, 0)))
    return _gated(padded, fs) + decibel(peak), False


def _gated(audio: Floats, fs: int) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):  # no block above the gate: -inf
        return float(_meter().integrated_loudness(resampled(audio, fs, METER_FS)))


@cache
def _meter() -> Any:
    import pyloudnorm

    # of its filters, the one that meets the standard's -3.01 LUFS at 997 Hz; exact at this rate only
    return pyloudnorm.Meter(METER_FS, filter_class="DeMan", block_size=BLOCK)


def loudest(audio: Floats, fs: int, window: float = BLOCK) -> float:
    """Loudness of the loudest stretch of a sound, LUFS, without gates; with 400 ms the largest momentary loudness.

        L = -0.691 + 10 log10( max_t sum_c (1/T) int_{t-T}^{t} y_c^2 ),   y K-weighted

    A shorter sound is padded to T; silence gives -inf. Source: BS.1770-4; EBU Tech 3341 for T = 400 ms.

    audio : (n, channels).
    fs : Hz.
    window : T, s.
    """
    from scipy.signal import sosfilt

    block = math.ceil(window * METER_FS)
    sound = resampled(audio, fs, METER_FS)
    power = np.sum(np.asarray(sosfilt(_K_WEIGHTING, np.pad(sound, ((0, block), (0, 0))), axis=0)) ** 2, axis=1)
    total = np.cumsum(np.pad(power, (1, 0)))
    largest = float(np.max(total[block:] - total[:-block])) / block
    return -0.691 + 10.0 * math.log10(largest) if largest > 0.0 else -math.inf


def sine_loudness(freq: float, channels: int = 1) -> float:
    """Loudness of a long sine of amplitude 1 in each channel, LUFS: that of K-weighting at its frequency.

        L = -0.691 + 10 log10( channels |H(f)|^2 / 2 )

    freq : Hz, below half of `METER_FS`.
    """
    z = cmath.exp(-2j * math.pi * freq / METER_FS)
    gain = math.prod(
        abs((b0 + b1 * z + b2 * z**2) / (a0 + a1 * z + a2 * z**2)) for b0, b1, b2, a0, a1, a2 in _K_WEIGHTING
    )
    return -0.691 + 10.0 * math.log10(channels * gain**2 / 2.0)


def true_peak(audio: Floats) -> float:
    """Largest absolute value of the fourfold oversampled sound (never less than the samples' own).

    The oversampled wave is at most `_REACH_GAIN` times the largest sample within the filter's reach, so stretches
    that cannot hold the peak are left out: most of a decaying sound.
    """
    from scipy.signal import resample_poly

    peak = float(np.max(np.abs(audio), initial=0.0))
    size = 256
    blocks = np.pad(np.abs(audio).max(axis=1), (0, -len(audio) % size)).reshape(-1, size).max(axis=1)
    around = np.pad(blocks, 1)
    near = np.maximum(np.maximum(around[:-2], around[2:]), blocks)
    edges = np.flatnonzero(np.diff(near * _REACH_GAIN > peak, prepend=False, append=False))
    for first, last in edges.reshape(-1, 2) * size:
        start = max(0, first - 2 * _REACH)
        over = resample_poly(audio[start : last + 2 * _REACH], OVERSAMPLING, 1, axis=0)
        inside = over[(first - start) * OVERSAMPLING : (last - start) * OVERSAMPLING]
        peak = max(peak, float(np.max(np.abs(inside), initial=0.0)))
    return peak


def matching_gain_db(audio: Floats, fs: int, target_lufs: float) -> float:
    """Gain in dB that brings a sound to a loudness.

    The absolute gate (-70 LUFS) depends on the level itself, so the gated loudness is measured again at the level
    found, until it stays.

    Raises OutputError : the sound is silent.
    """
    peak = float(np.max(np.abs(audio), initial=0.0))
    if peak == 0.0:
        raise OutputError("the sound is silent: it has no loudness to match")
    gain = -decibel(peak)
    for _ in range(8):
        factor = 10.0 ** (gain / 20.0)
        step = target_lufs - loudness(audio * factor, fs)[0]
        gain += step
        if abs(step) < 1e-4:
            break
    return gain
