"""Onsets, third octaves, envelopes, exponentials and splits against signals of closed form."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tonewood.workshop.estimate import search
from tonewood.workshop.estimate.partials import Bands, _modes, _rate, measure_partial, poles
from tonewood.workshop.estimate.recordings import FS
from tonewood.workshop.estimate.spectra import THIRD_OCTAVES, db, find_onset, running_rms, third_octaves


@pytest.mark.parametrize("freq", [82.4, 440.0])
def test_a_note_begins_20_db_below_its_first_peak(freq: float) -> None:
    """A rise of 60 dB in 60 ms after silence, or after noise 40 dB down: 20 dB are 20 ms."""
    t = np.arange(FS) / FS - 0.3
    swell = np.where(t < 0, 0.0, 10 ** (3 * (np.minimum(t / 0.06, 1.0) - 1))) * np.exp(-np.maximum(t - 0.06, 0) * 3)
    sound = swell * np.sin(2 * np.pi * freq * t)
    noise = 0.003 * np.random.default_rng(1).standard_normal(FS)
    for x, moved in ((sound, 0), (sound + noise, 0), (np.concatenate([np.zeros(5000), sound]), 5000)):
        start, top = find_onset(x, freq)
        assert (start - moved) / FS == pytest.approx(0.34, abs=0.006 if freq > 400 else 0.015)
        assert (top - moved) / FS == pytest.approx(0.358, abs=0.006 if freq > 400 else 0.02)


def test_levels_and_third_octaves_of_a_sine() -> None:
    assert db(np.array([1.0, 100.0, 0.0])).tolist() == [0.0, 20.0, -240.0]
    t = np.arange(FS) / FS
    for band in (0, 7, 20):
        powers = third_octaves(np.sin(2 * np.pi * THIRD_OCTAVES[band] * t))
        assert int(np.argmax(powers)) == band
        assert powers[band] > 1e3 * np.delete(powers, band).max()
    above, below = (third_octaves(np.sin(2 * np.pi * 1000 * 2**share * t)) for share in (0.15, 0.18))
    assert (int(np.argmax(above)), int(np.argmax(below))) == (10, 11)
    np.testing.assert_allclose(
        running_rms(np.sin(2 * np.pi * 1000 * t), 0.01)[FS // 2 :: 997][:20], np.sqrt(0.5), rtol=0.01
    )


def test_an_envelope_is_that_of_its_band() -> None:
    """A decaying partial 1.5 Hz beside the middle of its band turns by 1.5 Hz; one outside is not heard."""
    onset, rate, freq = 6000, 4.0, 500.0
    t = np.arange(3 * FS) / FS
    x = np.zeros(onset + t.size)
    x[onset:] = 0.3 * np.exp(-rate * t) * np.cos(2 * np.pi * (freq + 1.5) * t + 0.7)
    x[onset:] += 0.3 * np.exp(-rate * t) * np.cos(2 * np.pi * 700.0 * t)
    bands = Bands(x, onset)
    assert bands.end == pytest.approx(min(t[-1], 3.1), abs=0.11)
    y, time = bands.envelope(freq, 30.0)
    inside = (time > 0.1) & (time < 1.0)
    expected = 0.3 * np.exp(-rate * time + 1j * (2 * np.pi * 1.5 * time + 0.7))
    assert np.abs(y - expected)[inside].max() < 0.02 * 0.3
    partial = measure_partial(bands, 1, freq + 1.5, 200.0)
    assert partial is not None
    assert (partial.rate, partial.early) == pytest.approx((rate, rate), rel=0.01)
    assert partial.modes[0].amplitude == pytest.approx(0.3, rel=0.01)
    assert measure_partial(bands, 1, 600.0, 200.0) is None or not measure_partial(bands, 1, 600.0, 200.0).clear


def test_two_exponentials_are_told_apart() -> None:
    """Beats of two decays: rates, distances and amplitudes, the strongest first; one more is not invented."""
    t = 0.045 + np.arange(200) / 150
    s = np.array([-2.0 + 2j * np.pi * 0.4, -6.0 - 2j * np.pi * 1.1])
    y = np.exp(np.outer(t, s)) @ np.array([0.4, 1.0])
    found = _modes(y + 1e-5 * np.random.default_rng(2).standard_normal(200), t)
    assert found is not None
    modes = found[1]
    assert [m.amplitude for m in modes] == pytest.approx([1.0, 0.4], rel=1e-3)
    assert [m.rate for m in modes] == pytest.approx([6.0, 2.0], rel=1e-3)
    assert [m.offset for m in modes] == pytest.approx([-1.1, 0.4], rel=1e-3)
    assert set(poles([y[:20]], (1, 2, 3))) == {1, 2}
    assert np.sort(np.log(poles([y], (2,))[2]).real * 150) == pytest.approx(np.sort(s.real), rel=1e-6)


def test_a_rate_is_that_of_the_first_decibels() -> None:
    """20 dB per second at first, 5 later: over 15 dB the first alone; what does not fall has none."""
    t = np.arange(400) / 100
    level = np.where(t < 1.0, -20 * t, -20 - 5 * (t - 1.0))
    assert _rate(t, level, 0, 15.0) == pytest.approx(20 / 20 * np.log(10))
    assert _rate(t, level, 0, 30.0) < 0.6 * _rate(t, level, 0, 15.0)
    assert np.isnan(_rate(t, 0 * level, 0, 15.0))
    assert np.isnan(_rate(t, 100 * level, 0, 15.0))


def test_a_split_follows_the_depth_of_the_beats() -> None:
    def notes(value: float, count: int = 3) -> list[SimpleNamespace]:
        return [SimpleNamespace(modulation=(value, value, np.nan)) for _ in range(count)]

    assert search._split(2.0, notes(0.3), notes(0.2)) == pytest.approx(3.0)
    assert search._split(2.0, notes(0.9), notes(0.1)) == pytest.approx(3.6)  # by 1.8 at most at a time
    assert search._split(2.0, notes(0.1), notes(0.9)) == pytest.approx(2.0 / 1.8)
    assert search._split(11.0, notes(0.9), notes(0.1)) == 12.0
    assert search._split(0.0, notes(0.3), notes(0.2)) == pytest.approx(0.075)
    assert search._split(2.0, notes(0.3, 2), notes(0.2, 2)) == 2.0  # fewer than six tell nothing
    assert search._split(None, notes(0.3), notes(0.2)) is None


def test_noise_gives_each_band_what_its_width_is() -> None:
    """White noise over 8 s: power in proportion to a third of an octave about each middle frequency, the lowest too."""
    powers = third_octaves(np.random.default_rng(3).standard_normal(8 * FS))
    width = THIRD_OCTAVES * (2 ** (1 / 6) - 2 ** (-1 / 6))
    np.testing.assert_allclose(powers / powers.sum() * width.sum() / width, 1.0, atol=5 / np.sqrt(8 * width[0]))
