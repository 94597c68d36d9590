"""Level over time, and over time and frequency, of a sound."""

from __future__ import annotations

import numpy as np

from tonewood.support.arrays import Floats

#: level of silence, dB re full scale
SILENCE_DB = -200.0


def level_curve(samples: Floats, fs: float, *, interval: float = 0.02) -> tuple[Floats, Floats]:
    """Level of consecutive intervals: 10 lg of the mean square over time and channels.

    samples : (n, n_channels), 1.0 is full scale.
    interval : s.
    Returns time, level_db : (n_intervals,) s, middle of each interval, and dB re full scale.
    """
    size = max(1, round(interval * fs))
    count = max(1, len(samples) // size)
    whole = np.pad(samples, ((0, max(0, count * size - len(samples))), (0, 0)))[: count * size]
    power = np.mean(whole.reshape(count, -1) ** 2, axis=1)
    level = 10 * np.log10(np.maximum(power, 10 ** (SILENCE_DB / 10)))
    return np.asarray((np.arange(count) + 0.5) * size / fs, dtype=np.float64), np.asarray(level)


def spectrogram(
    samples: Floats, fs: float, *, window: int = 4096, columns: int = 600, freq_upper: float = 8000.0
) -> tuple[Floats, Floats, Floats]:
    """Level over time and frequency of the mean of all channels, through a Hann window.

    A sine of amplitude a has the level 20 lg a in its bin.

    samples : (n, n_channels), 1.0 is full scale.
    window : samples of the window; its main lobe is 4 fs / window wide.
    columns : at most as many times.
    freq_upper : Hz, highest frequency returned.
    Returns time, freq, level_db : (n_time,) s, middle of each window; (n_freq,) Hz; (n_freq, n_time) dB.
    """
    mono = samples.mean(axis=1)
    padded = np.pad(mono, (window // 2, window))
    last = max(len(mono) - window // 2, 1)  # the last window ends with the sound, whose end is no event
    starts = np.linspace(0, last, min(columns, last + 1), dtype=np.intp)
    shape = np.hanning(window)
    freq = np.fft.rfftfreq(window, 1 / fs)
    bins = max(2, int(np.count_nonzero(freq <= freq_upper)))
    frames = padded[starts[:, None] + np.arange(window)] * shape
    size = 2 * np.abs(np.fft.rfft(frames, axis=1)[:, :bins].T) / shape.sum()
    level = 20 * np.log10(np.maximum(size, 10 ** (SILENCE_DB / 20)))
    return np.asarray(starts / fs), np.asarray(freq[:bins]), np.asarray(level)
