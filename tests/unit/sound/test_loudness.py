"""True peaks and gains that bring a sound to a loudness: cases in which neighbours and gates decide."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import resample_poly

from tonewood.errors import OutputError
from tonewood.sound.level.loudness import loudest, loudness, matching_gain_db, true_peak

FS = 48000


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("at", [255, 256, 257, 512])
def test_a_true_peak_beside_a_block_s_loud_neighbour(at: int, backwards: bool) -> None:
    """The wave overshoots before alternating samples begin: at the edge of blocks, in one that is silent itself."""
    n = np.arange(1024 - at)
    sound = np.concatenate([np.zeros(at), (-1.0) ** n * np.exp(-n / 60)])[:, None]
    sound = sound[::-1] if backwards else sound
    whole = float(np.abs(resample_poly(sound, 4, 1, axis=0)).max())
    assert whole > 1.1
    assert true_peak(sound) == pytest.approx(whole, rel=1e-12)


def test_a_gain_is_found_where_the_absolute_gate_moves_with_it() -> None:
    """Brought to -66 LUFS, the quieter half falls below -70 LUFS and counts no more: one measurement does not do."""
    t = np.arange(6 * FS) / FS
    tone = np.sin(2 * np.pi * 997.0 * t)
    sound = np.concatenate([tone, 10 ** (-8 / 20) * tone])[:, None]
    gain = matching_gain_db(sound, FS, -66.0)
    assert loudness(sound * 10 ** (gain / 20), FS)[0] == pytest.approx(-66.0, abs=1e-3)


def test_a_true_peak_among_stretches_with_silence_between() -> None:
    """Several stretches may hold the peak: the largest of their oversampled waves counts, wherever it is."""
    burst = (-1.0) ** np.arange(200) * np.sin(np.pi * np.arange(200) / 400)
    for gains in ([0.98, 1.0, 0.97], [1.0, 0.98, 0.97], [0.97, 0.98, 1.0]):
        sound = np.concatenate([np.concatenate([gain * burst, np.zeros(2000)]) for gain in gains])[:, None]
        whole = float(np.abs(resample_poly(sound, 4, 1, axis=0)).max())
        assert whole > 1.05
        assert true_peak(sound) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize(
    ("level_db", "seconds", "lost_db", "gated"),
    [(-20.0, 3.0, 0.0, True), (-20.0, 0.2, 3.01, False), (-80.0, 3.0, 0.0, False)],
)
def test_a_tone_of_the_standard_on_one_channel(level_db: float, seconds: float, lost_db: float, gated: bool) -> None:
    """BS.1770-4: 997 Hz of full scale on one channel has -3.01 LUFS; half a block has half of it."""
    t = np.arange(round(seconds * FS)) / FS
    tone = 10 ** (level_db / 20) * np.sin(2 * np.pi * 997.0 * t)[:, None]
    found, gates = loudness(np.pad(tone, ((0, 0), (0, 1))), FS)
    assert gates is gated
    assert found == pytest.approx(level_db - 3.01 - lost_db, abs=0.1)
    rest = np.zeros((FS, 1))
    expected = level_db - 3.01 - lost_db  # of the loudest 400 ms, whatever stands before and after
    assert loudest(np.concatenate([rest, tone, rest, 0.5 * tone]), FS) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize(("n", "gated"), [(3532, False), (3533, True)])
def test_a_block_at_a_rate_that_it_does_not_divide(n: int, gated: bool) -> None:
    """400 ms are 3532.8 samples at 8832 Hz: 3532 are less than a block, 3533 are one."""
    tone = 0.1 * np.sin(2 * np.pi * 997.0 / 8832 * np.arange(n))[:, None]
    found, gates = loudness(tone, 8832)
    assert (found, gates) == (pytest.approx(-23.01, abs=0.1), gated)


@pytest.mark.parametrize("sound", [np.zeros((FS, 2)), np.zeros((0, 1))])
def test_silence_has_no_loudness(sound: np.ndarray) -> None:
    assert loudest(sound, FS) == -np.inf
    assert true_peak(sound) == 0.0
    with pytest.raises(OutputError, match="the sound is silent"):
        matching_gain_db(sound, FS, -23.0)
