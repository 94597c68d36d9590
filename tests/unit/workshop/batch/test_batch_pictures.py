"""Pictures of sounds: a tone stands at its frequency, an impulse at its time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tonewood.workshop.batch import pictures
from tonewood.workshop.batch.pictures import GAP, HEIGHT, LOW_HZ, SPECTRUM_HEIGHT, TOP_HZ, WAVE_HEIGHT, WIDTH


def picture(folder: Path, sound: np.ndarray, fs: int = 48000) -> tuple[np.ndarray, np.ndarray]:
    """Waveform and spectrogram of a sound of one channel, 0 to 1, as a PNG file has them."""
    pictures.write_picture(folder / "a.png", sound[:, None], fs)
    image = imread(folder / "a.png")
    assert image.shape == (HEIGHT, WIDTH, 4)
    return image[:WAVE_HEIGHT, :, :3], image[WAVE_HEIGHT + GAP :, :, :3]


@pytest.mark.parametrize(("freq", "fs"), [(3000.0, 48000), (3000.0, 44100), (440.0, 48000), (12000.0, 32000)])
def test_a_tone_is_brightest_at_its_frequency(tmp_path: Path, freq: float, fs: int) -> None:
    _, levels = picture(tmp_path, np.sin(2 * np.pi * freq * np.arange(fs) / fs), fs)
    brightness = levels[:, WIDTH // 2].sum(axis=-1)
    rows = np.flatnonzero(brightness == brightness.max())
    # rows at equal ratios, from the bottom; a bin is one row wide at 1/7 of the range and more above
    expected = SPECTRUM_HEIGHT * (1 - np.log(freq / LOW_HZ) / np.log(TOP_HZ / LOW_HZ)) - 0.5
    assert rows.mean() == pytest.approx(expected, abs=1.0)


def test_an_impulse_stands_at_its_time(tmp_path: Path) -> None:
    """Columns are 100 samples apart; an impulse is in those whose window of 4096 samples, centred, reaches it."""
    sound = np.zeros(100 * WIDTH)
    sound[65000] = 1.0
    wave, levels = picture(tmp_path, sound)
    inked = np.flatnonzero((wave != wave[:, :1]).any(axis=(0, 2)))
    assert inked.tolist() == [650]
    bright = np.flatnonzero((levels != levels[:, :1]).any(axis=(0, 2)))
    assert bright.tolist() == list(range(630, 671))


def test_a_silent_half_is_a_line(tmp_path: Path) -> None:
    wave, _ = picture(tmp_path, np.repeat([0.0, 1.0], 3500))
    assert (wave < 1.0).any(axis=-1).sum(axis=0).min() >= 1


def test_a_waveform_spans_its_peaks(tmp_path: Path) -> None:
    """Plus and minus the peak fill all rows; half of it half of them; a constant is a line."""
    n = 100
    swing = np.tile([1.0, -1.0], n * WIDTH // 2)
    swing[: n * WIDTH // 2] *= 0.5
    swing[: n * WIDTH // 4] = 0.25
    wave, _ = picture(tmp_path, swing)
    ink = (wave < 1.0).any(axis=-1).sum(axis=0)
    assert set(ink[: WIDTH // 4]) <= {1, 2, 3}
    assert set(ink[WIDTH // 4 : WIDTH // 2]) <= {WAVE_HEIGHT // 2, WAVE_HEIGHT // 2 + 1, WAVE_HEIGHT // 2 + 2}
    assert set(ink[WIDTH // 2 :]) == {WAVE_HEIGHT}
