"""Pictures of a sound: waveform above spectrogram, and the plot of a listening test's results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.batch.stimuli import Audio
from tonewood.batch.store import whole_file

FLOOR_DB = -90.0
TOP_HZ = 12_000.0


def figure(width: float, height: float) -> Any:
    """An empty Matplotlib figure of `width` x `height` inches, drawn without a display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), dpi=100)
    FigureCanvasAgg(made)
    return made


def save(made: Any, path: Path) -> None:
    """Write a figure as PNG, without the writer's name and version in it."""
    with whole_file(path) as stream:
        made.savefig(stream, format="png", metadata={"Software": None})


def write_picture(path: Path, audio: Audio, fs: int) -> None:
    """Waveform (all channels) above the spectrogram of the channels' mean, dB re its maximum."""
    n = len(audio)
    made = figure(7.0, 3.2)
    above, below = made.subplots(2, 1, sharex=True, height_ratios=(1, 2))
    made.subplots_adjust(left=0.1, right=0.98, top=0.97, bottom=0.14, hspace=0.1)
    step = max(1, n // 1200)
    columns = audio[: n - n % step].reshape(-1, step, audio.shape[1])
    time = np.arange(len(columns)) * step / fs
    for low, high in zip(columns.min(axis=1).T, columns.max(axis=1).T, strict=True):
        above.fill_between(time, low, high, linewidth=0.3)
    peak = 1.05 * float(np.max(np.abs(audio), initial=1e-6))
    above.set(ylim=(-peak, peak), ylabel="full scale")
    top = min(TOP_HZ, fs / 2)
    below.imshow(
        _spectrogram(audio.mean(axis=1), fs, top),
        aspect="auto",
        origin="lower",
        extent=(0, n / fs, 0, top / 1e3),
        vmin=FLOOR_DB,
        vmax=0.0,
        cmap="magma",
        interpolation="nearest",
    )
    below.set(xlim=(0, n / fs), ylabel="kHz", xlabel="s")
    save(made, path)


def _spectrogram(sound: NDArray[np.float64], fs: int, top: float) -> NDArray[np.float64]:
    """Level in dB re the maximum, shape (frequencies up to `top` Hz, about 600 times)."""
    size = min(2048, max(16, len(sound)))
    hop = max(1, min(size // 2, len(sound) // 600))
    padded = np.pad(sound, (size // 2, size))
    starts = np.arange(0, max(1, len(sound)), hop)
    frames = padded[starts[:, None] + np.arange(size)] * np.hanning(size)
    power = np.abs(np.fft.rfft(frames, axis=1).T[: int(size * top / fs) + 1]) ** 2
    return np.asarray(10.0 * np.log10(np.maximum(power, 1e-30) / max(float(power.max()), 1e-30)))
