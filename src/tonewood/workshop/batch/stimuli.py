"""From a rendered sound to a listening-test stimulus: rate, channels, length, fades, level, dither.

All signals are float64 of shape (n, channels), 1.0 is full scale. Level is set by one gain per file and nothing
else, so nothing of a sound's dynamics is touched. True peak is that of ITU-R BS.1770-4, Annex 2, by fourfold
oversampling. Loudness is one of two:

- ``bs1770_gated``: BS.1770-4 over the whole sound, the alignment of BS.1534 and BS.1116. Its gate (10 LU below the
  mean) leaves out most of a decay, but not all: two notes with the same attack and decays (T60) of 1 and 8 s
  differ by 4 dB. For phrases and sustained sounds.
- ``loudest``: K-weighted level of the loudest 100 ms (`window`), about the time over which the ear integrates loudness
  (100 to 200 ms: B. C. J. Moore, An Introduction to the Psychology of Hearing, 6th ed., chapter 4). The same two notes
  differ by 2 dB. For single plucked notes.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.sound.level.loudness import loudest, loudness
from tonewood.sound.level.loudness import matching_gain_db as matching_gain_db
from tonewood.sound.level.loudness import resampled as resampled
from tonewood.sound.level.loudness import true_peak as true_peak
from tonewood.support.units import decibel

Samples = NDArray[np.float64]
PEAK_MARGIN_DB = 0.01  # a page lowered for its true peak ends this much below the limit: room for dither
BITS = {"PCM_16": 16, "PCM_24": 24}


class StimulusError(TonewoodError):
    """A rendered sound cannot be made a stimulus."""


@dataclass(frozen=True)
class Measured:
    """Loudness and peaks of a sound, and how the loudness was found.

    lufs : LUFS, BS.1770-4; -inf for silence.
    momentary_lufs : LUFS, of the loudest 400 ms.
    gated : False for a sound shorter than a gating block, or one with no block above the absolute gate.
    peak_dbfs, true_peak_dbtp : dB re full scale, of the samples and of the fourfold oversampled sound.
    """

    lufs: float
    momentary_lufs: float
    gated: bool
    peak_dbfs: float
    true_peak_dbtp: float


def with_channels(audio: Samples, channels: int, downmix: str = "mean") -> Samples:
    """The sound with so many channels: mono is the mean of all or the first, more come from mono only."""
    present = audio.shape[1]
    if present == channels:
        return audio
    if channels == 1:
        return audio[:, :1] if downmix == "first" else audio.mean(axis=1, keepdims=True)
    if present == 1:
        return np.repeat(audio, channels, axis=1)
    raise StimulusError(f"{present} channels cannot become {channels}; allowed: 1, {present}")


def faded(audio: Samples, fs: int, fade_in: float, fade_out: float) -> Samples:
    """A copy with raised-cosine fades, ``(1 - cos(pi t / T)) / 2``; fades longer than the sound share it.

    audio : (n, channels).
    fs : Hz.
    fade_in, fade_out : s.
    """
    sound = np.array(audio)
    n = len(sound)
    n_in, n_out = round(fade_in * fs), round(fade_out * fs)
    if n_in + n_out > n:
        n_in = n * n_in // (n_in + n_out)
        n_out = n - n_in
    sound[:n_in] *= _raised_cosine(n_in)[:, None]
    sound[n - n_out :] *= _raised_cosine(n_out)[::-1, None]
    return sound


def _raised_cosine(n: int) -> NDArray[np.float64]:
    return np.asarray((1.0 - np.cos(np.pi * np.arange(n) / n)) / 2.0 if n else np.empty(0))


def measured(audio: Samples, fs: int) -> Measured:
    """Loudness (BS.1770-4), sample peak and true peak.

    A sound shorter than a gating block is padded with zeros to one block and measured whole: no gate can apply. Nor
    can one to a sound that lies below the absolute gate throughout; it is measured at full scale.
    """
    peak = float(np.max(np.abs(audio), initial=0.0))
    lufs, gated = loudness(audio, fs)
    return Measured(lufs, loudest(audio, fs), gated, decibel(peak), decibel(true_peak(audio)))


def level_gain_db(audio: Samples, fs: int, method: str, target_lufs: float, window: float = 0.1) -> float:
    """Gain in dB that brings a sound to a loudness by ``bs1770_gated`` or ``loudest``; 0 for ``none``.

    Raises OutputError : the sound is silent.
    """
    if method == "none":
        return 0.0
    level = loudest(audio, fs, window) if method == "loudest" else -math.inf
    return target_lufs - level if math.isfinite(level) else matching_gain_db(audio, fs, target_lufs)


def page_drop_db(true_peaks_dbtp: list[float], limit_dbtp: float) -> float:
    """Attenuation of a whole page that keeps all its sounds below the limit; 0 or positive, dB."""
    excess = max(true_peaks_dbtp) - limit_dbtp
    return excess + PEAK_MARGIN_DB if excess > 0 else 0.0


def quantised(audio: Samples, subtype: str, random: np.random.Generator) -> NDArray[np.int16 | np.int32]:
    """Integer samples with triangular dither of two steps' width, shape (n, channels).

    The error has zero mean and a variance of a quarter of a squared step, whatever the sound.

    audio : full scale is 1.0.
    subtype : ``PCM_16`` (int16) or ``PCM_24`` (int32, in the lower 24 bits).
    Raises StimulusError : a sample would be clipped.
    """
    full = 2 ** (BITS[subtype] - 1)
    dither = random.random(audio.shape) - random.random(audio.shape)
    steps = np.floor(audio * full + dither + 0.5)
    if steps.size and (steps.max() > full - 1 or steps.min() < -full):
        raise StimulusError(f"the sound passes full scale ({float(np.max(np.abs(audio))):.3f} of 1)")
    return np.asarray(steps, dtype=np.int16 if subtype == "PCM_16" else np.int32)


def samples_sha256(samples: NDArray[Any]) -> str:
    """SHA-256 of the integer samples, little-endian, channels interleaved (2 bytes each in 16 bit, 4 in 24 bit)."""
    return hashlib.sha256(np.ascontiguousarray(samples, dtype=samples.dtype.newbyteorder("<")).tobytes()).hexdigest()


def anchor(audio: Samples, fs: int, cutoff: int) -> Samples:
    """The low-pass anchor of BS.1534-3, linear phase, no delay, as long as the sound.

    Mask of the 3.5 kHz anchor: within 0.1 dB up to the cutoff, 25 dB down 500 Hz above it, 50 dB 1 kHz above it; the
    7 kHz anchor is held to the same one.

    Raises StimulusError : the rate is too low for the cutoff.
    """
    from scipy.signal import firwin, kaiserord, oaconvolve

    if cutoff + 500 >= fs / 2:
        raise StimulusError(f"an anchor of {cutoff} Hz needs a rate above {2 * (cutoff + 500)} Hz, not {fs}")
    taps, beta = kaiserord(65.0, 500.0 / (fs / 2))
    kernel = firwin(taps | 1, cutoff + 250.0, window=("kaiser", beta), fs=fs)
    return np.asarray(oaconvolve(audio, kernel[:, None], mode="same", axes=0), dtype=np.float64)
