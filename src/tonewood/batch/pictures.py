"""Pictures of a sound, waveform above spectrogram, composed as plain images: a batch has many of them.

A figure with drawn axes takes a quarter of a second each, an image a tenth of that; what the axes would say is the
same for all pictures and stands in `CAPTION`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonewood.batch.stimuli import Audio
from tonewood.plotting import COLOURS, LEVELS
from tonewood.whole_files import whole_file

WIDTH, WAVE_HEIGHT, SPECTRUM_HEIGHT, GAP = 700, 96, 220, 4
HEIGHT = WAVE_HEIGHT + GAP + SPECTRUM_HEIGHT
FLOOR_DB = -90.0
TOP_HZ = 12_000.0
GRID_HZ = 2_000.0
CAPTION = (
    f"Above, the waveform re its own peak; below, the spectrogram up to {TOP_HZ / 1e3:g} kHz (a line every "
    f"{GRID_HZ / 1e3:g} kHz), dark to bright from {FLOOR_DB:g} dB to the maximum."
)
_WINDOW = 2048
_INK = (*(int(COLOURS[0][i : i + 2], 16) for i in (1, 3, 5)), 255)

Pixels = NDArray[np.uint8]


def write_picture(path: Path, audio: Audio, fs: int) -> None:
    """Write waveform (all channels, one over the other) and spectrogram (of their mean) as PNG."""
    from matplotlib.image import imsave

    image = np.full((HEIGHT, WIDTH, 4), 255, dtype=np.uint8)
    image[:WAVE_HEIGHT] = _waveform(audio)
    image[WAVE_HEIGHT + GAP :] = _spectrogram(audio.mean(axis=1), fs)
    with whole_file(path, make_folder=True) as stream:
        # None takes the writer's name and version out
        imsave(stream, image, format="png", metadata={"Software": None})  # type: ignore[dict-item]  # stubs lack None


def _waveform(audio: Audio) -> Pixels:
    """Columns from the least to the largest sample, shape (WAVE_HEIGHT, WIDTH, 4)."""
    edges = np.linspace(0, len(audio), WIDTH + 1).astype(int)[:-1]
    peak = float(np.max(np.abs(audio), initial=0.0)) or 1.0
    row = np.linspace(1.0, -1.0, WAVE_HEIGHT)[:, None] * peak
    half = peak / (WAVE_HEIGHT - 1)  # every column shows at least its line
    pixels = np.full((WAVE_HEIGHT, WIDTH, 4), 255, dtype=np.uint8)
    for channel in audio.T:
        low, high = np.minimum.reduceat(channel, edges), np.maximum.reduceat(channel, edges)
        pixels[(row >= low - half) & (row <= high + half)] = _INK
    return pixels


def _spectrogram(sound: NDArray[np.float64], fs: int) -> Pixels:
    """Level re the maximum over time and frequency, shape (SPECTRUM_HEIGHT, WIDTH, 4)."""
    from matplotlib import colormaps

    starts = np.linspace(0, len(sound), WIDTH, endpoint=False).astype(int)
    padded = np.pad(sound, (_WINDOW // 2, _WINDOW))
    frames = padded[starts[:, None] + np.arange(_WINDOW)] * np.hanning(_WINDOW)
    bins = max(SPECTRUM_HEIGHT, int(_WINDOW / 2 * min(1.0, 2 * TOP_HZ / fs)))
    power = np.abs(np.fft.rfft(frames, axis=1).T[:bins]) ** 2
    rows = np.maximum.reduceat(power, np.linspace(0, bins, SPECTRUM_HEIGHT + 1).astype(int)[:-1], axis=0)[::-1]
    level = 10.0 * np.log10(np.maximum(rows, 1e-30) / max(float(rows.max()), 1e-30))
    pixels: Pixels = colormaps[LEVELS](1.0 - level / FLOOR_DB, bytes=True)
    top = bins * fs / _WINDOW
    lines = SPECTRUM_HEIGHT - 1 - (np.arange(GRID_HZ, top, GRID_HZ) / top * SPECTRUM_HEIGHT).astype(int)
    pixels[lines, :, :3] = pixels[lines, :, :3] // 4 * 3 + 60
    return pixels
