"""Pictures of a sound, waveform above spectrogram, composed as plain images: a batch has many of them.

A figure with drawn axes takes a quarter of a second each, an image a tenth of that; the axes are the same for all
pictures and described in `CAPTION`. One figure with axes is drawn of each group: how its sounds differ.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.plotting import COLOURS, DASHES, LEVELS, LINE, figure, frequency_axis, legend, plain, title
from tonewood.support.whole_files import whole_file
from tonewood.workshop.batch.stimuli import Samples

WIDTH, WAVE_HEIGHT, SPECTRUM_HEIGHT, GAP = 700, 96, 220, 4
HEIGHT = WAVE_HEIGHT + GAP + SPECTRUM_HEIGHT
FLOOR_DB = -90.0
LOW_HZ, TOP_HZ = 50.0, 16_000.0
LINES_HZ = (100.0, 1_000.0, 10_000.0)
CAPTION = (
    f"Above, the waveform re its own peak; below, the spectrogram from {LOW_HZ:g} Hz to {TOP_HZ / 1e3:g} kHz on a "
    f"logarithmic axis (lines at 100 Hz, 1 and 10 kHz), dark to bright from {FLOOR_DB:g} dB to the maximum."
)
_WINDOW = 4096
_INK = (*(int(COLOURS[0][i : i + 2], 16) for i in (1, 3, 5)), 255)

Pixels = NDArray[np.uint8]


def write_picture(path: Path, audio: Samples, fs: int) -> None:
    """Write waveform (all channels, one over the other) and spectrogram (of their mean) as PNG."""
    from matplotlib.image import imsave

    image = np.full((HEIGHT, WIDTH, 4), 255, dtype=np.uint8)
    image[:WAVE_HEIGHT] = _waveform(audio)
    image[WAVE_HEIGHT + GAP :] = _spectrogram(audio.mean(axis=1), fs)
    with whole_file(path, make_folder=True) as stream:
        # None takes the writer's name and version out
        imsave(stream, image, format="png", metadata={"Software": None})  # type: ignore[dict-item]  # stubs lack None


def _waveform(audio: Samples) -> Pixels:
    """Columns from the least to the largest sample, shape (WAVE_HEIGHT, WIDTH, 4)."""
    edges = np.linspace(0, len(audio), WIDTH + 1).astype(int)[:-1]
    peak = float(np.max(np.abs(audio), initial=0.0)) or 1.0
    row = np.linspace(1.0, -1.0, WAVE_HEIGHT)[:, None] * peak
    half = 1.01 * peak / (WAVE_HEIGHT - 1)  # every column shows at least a row, one that lies between two both
    pixels = np.full((WAVE_HEIGHT, WIDTH, 4), 255, dtype=np.uint8)
    for channel in audio.T:
        low, high = np.minimum.reduceat(channel, edges), np.maximum.reduceat(channel, edges)
        pixels[(row >= low - half) & (row <= high + half)] = _INK
    return pixels


def _spectrogram(sound: NDArray[np.float64], fs: int) -> Pixels:
    """Level re the maximum over time and frequency, shape (SPECTRUM_HEIGHT, WIDTH, 4); rows at equal ratios."""
    from matplotlib import colormaps

    starts = np.linspace(0, len(sound), WIDTH, endpoint=False).astype(int)
    padded = np.pad(sound, (_WINDOW // 2, _WINDOW))
    frames = padded[starts[:, None] + np.arange(_WINDOW)] * np.hanning(_WINDOW)
    power = np.abs(np.fft.rfft(frames, axis=1).T) ** 2
    edges = np.geomspace(LOW_HZ, TOP_HZ, SPECTRUM_HEIGHT + 1) * _WINDOW / fs
    rows = np.empty((SPECTRUM_HEIGHT, WIDTH))
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        first, last = math.ceil(low), math.floor(high)
        if last >= len(power):
            rows[i] = 0.0
        elif first <= last:  # the loudest bin of the row
            rows[i] = power[first : last + 1].max(axis=0)
        else:  # between two bins
            share = 0.5 * (low + high) - last
            rows[i] = (1 - share) * power[last] + share * power[min(last + 1, len(power) - 1)]
    level = 10.0 * np.log10(np.maximum(rows[::-1], 1e-30) / max(float(rows.max()), 1e-30))
    pixels: Pixels = colormaps[LEVELS](1.0 - level / FLOOR_DB, bytes=True)
    heights = np.log(np.array(LINES_HZ) / LOW_HZ) / math.log(TOP_HZ / LOW_HZ)
    lines = SPECTRUM_HEIGHT - 1 - (heights * SPECTRUM_HEIGHT).astype(int)
    pixels[lines, :, :3] = pixels[lines, :, :3] // 4 * 3 + 60
    return pixels


def write_differences(path: Path, sounds: Mapping[str, Samples], fs: int, heading: str) -> None:
    """Write how sounds differ from the first: levels of third-octave bands and level over time, both as differences.

    sounds : label -> (n, channels), as they are heard; the first is the reference.
    """
    labels = list(sounds)
    centres = 1000.0 * 2.0 ** (np.arange(-13, 13) / 3)
    centres = centres[centres * 2 ** (1 / 6) < fs / 2]
    bands = [_band_levels(sound.mean(axis=1), fs, centres) for sound in sounds.values()]
    hop = max(1, round(0.02 * fs))
    levels = [_levels(sound, hop) for sound in sounds.values()]
    picture, axes = figure(2, heights=[3.6, 3.6])
    loud = bands[0] > bands[0].max() - 60
    sounding = levels[0] > levels[0].max() - 60
    t = hop / fs * np.arange(len(levels[0]))
    for i, label in enumerate(labels[1:]):
        style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "ls": DASHES[i // len(COLOURS) % 4], "lw": LINE}
        axes[0, 0].plot(centres[loud], (bands[i + 1] - bands[0])[loud], **style, label=plain(label))
        axes[1, 0].plot(t[sounding], (levels[i + 1] - levels[0])[sounding], **style)
    for ax in axes[:, 0]:
        ax.axhline(0.0, color="0.5", lw=1.0)
        ax.set_ylabel("difference, dB")
    frequency_axis(axes[0, 0], 50.0, 20_000.0)
    axes[1, 0].set_xlabel("time, s")
    legend(axes[0, 0], title=plain(f"re {labels[0]}"))
    title(axes[0, 0], heading)
    with whole_file(path, make_folder=True) as stream:
        picture.savefig(stream, format="png", dpi=70, metadata={"Software": None})


def _band_levels(sound: NDArray[np.float64], fs: int, centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Energy in third-octave bands, dB."""
    power = np.abs(np.fft.rfft(sound)) ** 2
    total = np.concatenate([[0.0], np.cumsum(power)])
    edges = np.outer(2.0 ** np.array([-1 / 6, 1 / 6]), centres) * len(sound) / fs
    low, high = np.clip(np.rint(edges).astype(int), 0, len(power))
    return np.asarray(10 * np.log10(np.maximum(total[high] - total[low], 1e-12 * float(power.max(initial=1e-30)))))


def _levels(sound: Samples, hop: int) -> NDArray[np.float64]:
    """Level of blocks of `hop` samples, dB re full scale."""
    blocks = np.pad(sound**2, ((0, -len(sound) % hop), (0, 0))).reshape(-1, hop, sound.shape[1])
    return np.asarray(10 * np.log10(np.maximum(blocks.mean(axis=(1, 2)), 1e-12)))
