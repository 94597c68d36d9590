"""Pictures of sounds: a tone stands at its frequency, an impulse at its time."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
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


def test_lines_stand_at_decades(tmp_path: Path) -> None:
    """Of silence, all that is seen; rows at equal ratios from 50 Hz at the bottom to 16 kHz."""
    _, levels = picture(tmp_path, np.zeros(48000))
    bright = np.flatnonzero((levels != levels[:1]).any(axis=(1, 2)))
    expected = SPECTRUM_HEIGHT * (1 - np.log(np.array([1e4, 1e3, 100.0]) / LOW_HZ) / np.log(TOP_HZ / LOW_HZ)) - 0.5
    np.testing.assert_allclose(bright, expected, atol=0.6)


def test_a_tone_does_not_leak(tmp_path: Path) -> None:
    """By a Hann window, a tone half-way between two bins is below -90 dB an octave away: as dark as it gets."""
    tone = np.sin(2 * np.pi * 256.5 * 48000 / 4096 * np.arange(48000) / 48000)
    _, levels = picture(tmp_path, tone)
    row = SPECTRUM_HEIGHT * (1 - np.log(6100.0 / LOW_HZ) / np.log(TOP_HZ / LOW_HZ))
    assert levels[int(row), WIDTH // 2].sum() == levels.sum(axis=-1).min()


@pytest.mark.parametrize("fs", [24000, 44100])
def test_rows_are_the_loudest_bins_of_their_band(rng: np.random.Generator, fs: int) -> None:
    """Or a value between two bins, or silence above half the sampling rate."""
    n, size = 3 * WIDTH, 4096
    sound = 1e-4 * np.cumsum(rng.standard_normal(n))
    shown = pictures._spectrogram(sound, fs)
    edges = [LOW_HZ * (TOP_HZ / LOW_HZ) ** (i / SPECTRUM_HEIGHT) * size / fs for i in range(SPECTRUM_HEIGHT + 1)]
    columns, rows = (0, 200, WIDTH - 1), np.zeros((SPECTRUM_HEIGHT, WIDTH))
    padded = np.concatenate([np.zeros(size // 2), sound, np.zeros(size)])
    cut = np.stack([padded[3 * column : 3 * column + size] for column in range(WIDTH)], axis=1)
    power = np.abs(np.fft.rfft(cut * np.hanning(size)[:, None], axis=0)) ** 2
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        bins = np.arange(int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9)) + 1)
        if high < size // 2 + 1:
            below, share = int(low), 0.5 * (low + high) % 1
            between = (1 - share) * power[below] + share * power[below + 1]
            rows[i] = power[bins].max(axis=0) if len(bins) else between
    level = 10 * np.log10(np.maximum(rows[::-1], 1e-30) / rows.max())
    expected = colormaps[pictures.LEVELS](1 - level / pictures.FLOOR_DB, bytes=True)
    lines = (np.log10(np.array([100.0, 1e3, 1e4]) / LOW_HZ) / np.log10(TOP_HZ / LOW_HZ) * SPECTRUM_HEIGHT).astype(int)
    kept = np.setdiff1d(np.arange(SPECTRUM_HEIGHT), SPECTRUM_HEIGHT - 1 - lines)
    for column in columns:
        assert np.abs(shown[kept, column].astype(int) - expected[kept, column]).max() <= 2


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


def test_levels_of_third_octaves_and_of_blocks_are_those_of_the_signal() -> None:
    """A sine has all its energy, A^2 N^2 / 4 of the transform, in its own band; blocks of it are at A^2 / 2."""
    fs, n, amplitude = 48000, 48000, 0.25
    tones = 1000.0 * 2.0 ** (np.arange(-9, 10, 3) / 3)
    centres = 1000.0 * 2.0 ** (np.arange(-13, 13) / 3)
    for freq in np.rint(tones):
        sine = amplitude * np.sin(2 * np.pi * freq * np.arange(n) / fs)
        bands = pictures._band_levels(sine, fs, centres)
        assert bands.max() == pytest.approx(20 * np.log10(amplitude * n / 2), abs=1e-6)
        assert centres[bands.argmax()] == pytest.approx(freq, rel=0.01)
        assert np.sort(bands)[-2] <= bands.max() - 100.0
    edge = 1000.0 * 2 ** (1 / 6)  # between the bands of 1000 and 1260 Hz
    for freq, band in ((0.99 * edge, 13), (1.01 * edge, 14)):
        assert pictures._band_levels(np.sin(2 * np.pi * round(freq) * np.arange(n) / fs), fs, centres).argmax() == band
    sound = np.stack([np.full(1000, 0.1), np.full(1000, 0.3)], axis=1)
    sound[500:] = 0.0
    np.testing.assert_allclose(pictures._levels(sound, 250), [10 * np.log10(0.05)] * 2 + [-120.0] * 2, atol=1e-9)


def test_a_picture_of_differences_shows_bands_and_times_that_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sound of twice the level is +6 dB in every band and at every time, and silence is not drawn."""
    axes: list[object] = []
    figure = pictures.figure
    monkeypatch.setattr(pictures, "figure", lambda *a, **k: axes.append(figure(*a, **k)) or axes[-1])
    fs = 16000
    low, high = (np.sin(2 * np.pi * freq * np.arange(fs) / fs)[:, None] for freq in (500.0, 4000.0))
    first = (low + high) * (np.arange(fs) < 0.75 * fs)[:, None]
    pictures.write_differences(tmp_path / "d.png", {"a": first, "b": low + 2 * high, "c": 2 * first}, fs, "heading")
    top, bottom = axes[0][1][:, 0]  # type: ignore[index]
    b, c, *_ = (np.asarray(line.get_xydata()) for line in top.get_lines())
    assert [list(np.asarray(ax.get_lines()[2].get_ydata())) for ax in (top, bottom)] == [[0.0, 0.0]] * 2
    assert dict(zip(np.rint(b[:, 0]), np.round(b[:, 1], 1), strict=True))[4000.0] == pytest.approx(6.0, abs=2.6)
    np.testing.assert_allclose(c[:, 1], 20 * np.log10(2.0), atol=1e-9)
    assert c[:, 0].max() < fs / 2
    later = np.asarray(bottom.get_lines()[1].get_xydata())
    np.testing.assert_allclose(later[:, 1], 20 * np.log10(2.0), atol=1e-9)
    assert later[:, 0].max() == pytest.approx(0.73, abs=0.021)  # silent from 0.75 s on
    assert (tmp_path / "d.png").stat().st_size > 0
