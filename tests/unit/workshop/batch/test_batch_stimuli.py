from __future__ import annotations

import hashlib

import numpy as np
import pytest
from scipy.signal import freqz, resample_poly

from tonewood.errors import OutputError
from tonewood.sound.level.loudness import loudest
from tonewood.workshop.batch import production, stimuli, trimming
from tonewood.workshop.batch.manifest import Stimuli
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.batch.stimuli import StimulusError
from tonewood.workshop.batch.store import Rendered

FS = 48000


def sine(freq: float, seconds: float, amplitude: float = 1.0, fs: int = FS, phase: float = 0.0):
    t = np.arange(round(seconds * fs)) / fs
    return amplitude * np.sin(2 * np.pi * freq * t + phase)[:, None]


def pluck(freq: float, seconds: float, t60: float = 1.0, fs: int = FS):
    t = np.arange(round(seconds * fs)) / fs
    return (np.exp(-np.log(1000) * t / t60) * np.sin(2 * np.pi * freq * t))[:, None]


@pytest.mark.parametrize("fs", [44100, 48000, 96000])
def test_loudness_reference_of_bs1770(fs: int) -> None:
    # BS.1770-4 Annex 1: a 0 dB FS 997 Hz sine in one channel reads -3.01 LKFS
    got = stimuli.measured(sine(997.0, 5.0, fs=fs), fs)
    assert got.lufs == pytest.approx(-3.01, abs=0.005)
    assert got.gated


def test_two_equal_channels_are_3_db_louder() -> None:
    mono = sine(997.0, 2.0)
    both = stimuli.measured(np.repeat(mono, 2, axis=1), FS).lufs
    assert both - stimuli.measured(mono, FS).lufs == pytest.approx(10 * np.log10(2), abs=1e-9)


def test_silence_around_a_sound_is_gated_away() -> None:
    tone = sine(997.0, 10.0, 0.1)
    padded = np.concatenate([np.zeros((10 * FS, 1)), tone, np.zeros((10 * FS, 1))])
    # 97 whole blocks and two each of a quarter, a half and three quarters lie above the relative gate
    expected = -23.01 + 10 * np.log10((97 + 2 * 1.5) / 103)
    assert stimuli.measured(padded, FS).lufs == pytest.approx(expected, abs=0.01)


def test_a_short_sound_is_measured_over_one_block() -> None:
    short = sine(997.0, 0.1)
    got = stimuli.measured(short, FS)
    assert not got.gated
    assert got.lufs == pytest.approx(-3.01 + 10 * np.log10(0.1 / 0.4), abs=0.02)  # mean over 400 ms
    gain = stimuli.matching_gain_db(short, FS, -30.0)
    assert stimuli.measured(short * 10 ** (gain / 20), FS).lufs == pytest.approx(-30.0, abs=1e-3)


@pytest.mark.parametrize("level_db", [0.0, -60.0, -200.0])
def test_matching_does_not_depend_on_the_level_given(level_db: float) -> None:
    sound = pluck(196.0, 6.0)
    gain = stimuli.matching_gain_db(sound * 10 ** (level_db / 20), FS, -23.0)
    assert gain + level_db == pytest.approx(stimuli.matching_gain_db(sound, FS, -23.0), abs=1e-6)
    final = stimuli.measured(sound * 10 ** ((level_db + gain) / 20), FS)
    assert final.lufs == pytest.approx(-23.0, abs=1e-3)
    assert final.gated


def test_silence_has_no_loudness_to_match() -> None:
    assert stimuli.measured(np.zeros((FS, 1)), FS).lufs == -np.inf
    with pytest.raises(OutputError, match="silent"):
        stimuli.matching_gain_db(np.zeros((FS, 1)), FS, -23.0)


def test_true_peak_between_samples() -> None:
    # a sine at fs/4 sampled 45 degrees off its crests: samples at 0.7071, the wave reaches 1
    between = sine(FS / 4, 0.1, phase=np.pi / 4)
    windowed = stimuli.faded(between, FS, 0.01, 0.01)
    got = stimuli.measured(windowed, FS)
    assert got.peak_dbfs == pytest.approx(-3.0103, abs=1e-3)
    assert got.true_peak_dbtp == pytest.approx(0.0, abs=0.02)


def test_true_peak_is_never_below_the_samples(rng: np.random.Generator) -> None:
    noise = rng.standard_normal((2000, 2))
    assert stimuli.true_peak(noise) >= np.max(np.abs(noise))


def test_true_peak_leaves_nothing_out(rng: np.random.Generator) -> None:
    for n in (1, 100, 256, 5000):
        sound = rng.standard_normal((n, 2)) * np.exp(-rng.uniform(0, 5) * np.linspace(0, 1, n))[:, None]
        whole = max(np.max(np.abs(resample_poly(sound, 4, 1, axis=0))), np.max(np.abs(sound)))
        assert stimuli.true_peak(sound) == pytest.approx(whole, rel=1e-12)
    assert stimuli.true_peak(np.zeros((300, 1))) == 0.0


def test_page_drop() -> None:
    assert stimuli.page_drop_db([-3.0, -1.0, -20.0], -1.0) == 0.0
    assert stimuli.page_drop_db([-3.0, 2.0], -1.0) == pytest.approx(3.0 + stimuli.PEAK_MARGIN_DB)


def test_fades_are_raised_cosines() -> None:
    got = stimuli.faded(np.ones((1000, 2)), 1000, 0.1, 0.2)
    t = np.arange(100) / 100
    np.testing.assert_allclose(got[:100, 0], np.sin(np.pi * t / 2) ** 2, atol=1e-15)
    assert np.all(got[100:800] == 1.0)
    np.testing.assert_allclose(got[800:1000, 1][::-1], np.sin(np.pi * np.arange(200) / 400) ** 2, atol=1e-15)
    assert np.array_equal(stimuli.faded(np.ones((600, 2)), 1000, 0.0, 0.0), np.ones((600, 2)))


def test_fades_longer_than_the_sound_share_it() -> None:
    got = stimuli.faded(np.ones((90, 1)), 1000, 0.1, 0.2)
    assert got[0, 0] == got[-1, 0] == 0.0
    assert np.argmax(got) in (30, 29)
    assert stimuli.faded(np.ones((0, 1)), 1000, 0.1, 0.1).shape == (0, 1)


@pytest.mark.parametrize("fs", [44100, 48000])
def test_loudest_is_that_of_the_loudest_400_ms(fs: int) -> None:
    assert loudest(sine(997.0, 5.0, fs=fs), fs) == pytest.approx(-3.01, abs=0.005)
    # 400 ms of tone after a quiet one: only these count; half of them is 3 dB less
    loud, quiet = sine(997.0, 0.4, 0.5, fs=fs), sine(997.0, 2.0, 0.05, fs=fs)
    both = np.concatenate([quiet, loud, quiet])
    assert loudest(both, fs) == pytest.approx(-3.01 - 6.02, abs=0.02)
    assert loudest(loud[: len(loud) // 2], fs) == pytest.approx(-3.01 - 6.02 - 3.01, abs=0.02)
    assert loudest(np.zeros((fs, 1)), fs) == -np.inf


def test_loudness_of_notes_that_decay() -> None:
    """The loudest 100 ms in closed form; how much the length of a decay matters to either measure."""
    gains = {}
    weight = loudest(sine(220.0, 2.0), FS) - 10 * np.log10(0.5)  # K-weighting at 220 Hz
    for t60 in (1.0, 8.0):
        note = pluck(220.0, 8.0, t60)
        gain = stimuli.level_gain_db(note, FS, "loudest", -23.0)
        rate = 2 * np.log(1000) / t60  # of the energy
        mean = 0.5 * (1 - np.exp(-0.1 * rate)) / (0.1 * rate)
        assert -23.0 - gain == pytest.approx(weight + 10 * np.log10(mean), abs=0.05)
        gains[t60] = (gain, stimuli.level_gain_db(note, FS, "bs1770_gated", -23.0))
    by_loudest, by_gated = (gains[1.0][i] - gains[8.0][i] for i in (0, 1))
    assert 0 < by_loudest < 2.5
    assert by_gated > 4.0


def test_onsets_stand_at_the_same_sample() -> None:
    sound = np.concatenate([np.zeros((777, 1)), pluck(300.0, 1.0)])
    first = trimming.onset(sound, -40.0)
    assert first == 777 + int(np.argmax(np.abs(pluck(300.0, 1.0)[:, 0]) >= 0.01 * np.abs(pluck(300.0, 1.0)).max()))
    assert trimming.onset(1e-6 * sound, -40.0) == first  # whatever the level
    for place in (0, 100, 5000):
        moved = trimming.shifted(sound, place - first)
        assert trimming.onset(moved, -40.0) == place
        assert np.array_equal(moved[place:], sound[first:])
    assert trimming.onset(np.zeros((10, 2)), -40.0) == 0


@pytest.mark.parametrize("t60", [0.5, 1.5])
def test_a_sound_ends_where_it_has_decayed_by_60_db(t60: float) -> None:
    end = trimming.end(pluck(400.0, 8.0, t60), 960, -60.0)
    assert end / FS == pytest.approx(t60, abs=0.03)
    later = np.concatenate([pluck(400.0, 2.0, 0.2), pluck(400.0, 2.0, t60)])  # a second note counts
    assert trimming.end(later, 960, -60.0) / FS == pytest.approx(2.0 + t60, abs=0.03)
    assert trimming.end(np.zeros((5000, 1)), 960, -60.0) == 960


def test_a_room_is_a_convolution(rng: np.random.Generator) -> None:
    dry, response = rng.standard_normal((200, 1)), rng.standard_normal((31, 2))
    wet = trimming.convolved(dry, response)
    for c in range(2):
        np.testing.assert_allclose(wet[:, c], np.convolve(dry[:, 0], response[:, c]), atol=1e-12)


@pytest.mark.parametrize(("subtype", "bits"), [("PCM_16", 16), ("PCM_24", 24)])
def test_dither_has_no_mean_and_a_quarter_step_of_variance(subtype: str, bits: int) -> None:
    # TPDF: the error is independent of the signal in its first two moments, variance (1/12 + 1/6) step^2
    n = 200_000
    full = 2 ** (bits - 1)
    for level in (0.0, 0.25, 0.5, 17.3):
        got = stimuli.quantised(np.full((n, 1), level / full), subtype, generator(1, "dither", level))
        error = got.astype(float) - level
        assert abs(error.mean()) < 5 * 0.5 / np.sqrt(n)
        assert error.var() == pytest.approx(0.25, rel=0.02)


def test_dither_is_the_seed_s() -> None:
    sound = pluck(220.0, 0.1) * 0.5
    first = stimuli.quantised(sound, "PCM_16", generator(7, "dither", "a"))
    again = stimuli.quantised(sound, "PCM_16", generator(7, "dither", "a"))
    other = stimuli.quantised(sound, "PCM_16", generator(8, "dither", "a"))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.max(np.abs(first.astype(int) - other)) <= 3
    assert stimuli.samples_sha256(first) == hashlib.sha256(first.astype("<i2").tobytes()).hexdigest()


def test_clipping_is_refused() -> None:
    with pytest.raises(StimulusError, match="passes full scale"):
        stimuli.quantised(np.full((4, 1), 1.1), "PCM_16", generator(0))


@pytest.mark.parametrize("cutoff", [3500, 7000])
@pytest.mark.parametrize("fs", [44100, 48000, 96000])
def test_anchor_meets_the_mask(cutoff: int, fs: int) -> None:
    impulse = np.zeros((8191, 1))
    impulse[4095] = 1.0
    response = stimuli.anchor(impulse, fs, cutoff)[:, 0]
    np.testing.assert_allclose(response, response[::-1], atol=1e-12)  # linear phase, no delay
    freq, h = freqz(response, worN=16384, fs=fs)
    level = 20 * np.log10(np.abs(h) + 1e-15)
    assert np.max(np.abs(level[freq <= cutoff])) < 0.1
    assert np.max(level[freq >= cutoff + 500]) < -25.0
    assert np.max(level[freq >= cutoff + 1000]) < -50.0


def test_anchor_needs_the_rate() -> None:
    with pytest.raises(StimulusError, match="8000"):
        stimuli.anchor(np.zeros((10, 1)), 8000, 3500)


@pytest.mark.parametrize(("fs", "freq"), [(96000, 1000.0), (96000, 18000.0), (44100, 15000.0), (192000, 440.0)])
def test_resampling_keeps_a_sine(fs: int, freq: float) -> None:
    got = stimuli.resampled(sine(freq, 0.5, fs=fs), fs, FS)
    wanted = sine(freq, 0.5)
    assert len(got) == len(wanted)
    middle = slice(4800, -4800)
    assert np.max(np.abs(got[middle] - wanted[middle])) < 3e-5  # -90 dB


def test_resampling_lets_nothing_fold_back() -> None:
    got = stimuli.resampled(sine(30000.0, 0.5, fs=96000), 96000, FS)
    assert np.max(np.abs(got[4800:-4800])) < 1e-5


def test_channels() -> None:
    stereo = np.array([[1.0, 3.0], [2.0, 4.0]])
    assert stimuli.with_channels(stereo, 1).tolist() == [[2.0], [3.0]]
    assert stimuli.with_channels(stereo, 1, "first").tolist() == [[1.0], [2.0]]
    assert stimuli.with_channels(stereo[:, :1], 2).tolist() == [[1.0, 1.0], [2.0, 2.0]]
    with pytest.raises(StimulusError, match="3 channels cannot become 2"):
        stimuli.with_channels(np.zeros((4, 3)), 2)


def test_a_sound_is_trimmed_by_blocks_of_the_time_given() -> None:
    """A click in each of two blocks of 50 ms, the second 40 dB below: kept to the end of its block, or left out."""
    settings = Stimuli.model_validate(
        {"fs": FS, "duration": 1.0, "onset": {"align": "score", "at": 0.0}, "fade": {"in": 0.0, "out": 0.0}}
    )
    block = round(0.05 * FS)
    sound = np.zeros((FS, 1))
    sound[10], sound[block + 20] = 1.0, 0.01
    for level_db, blocks in ((-45.0, 2), (-35.0, 1)):
        trim = settings.trim.model_copy(update={"level_db": level_db, "block": 0.05})
        kept = production.prepared(Rendered(sound, FS), settings.model_copy(update={"trim": trim}))
        assert len(kept) == blocks * block
        np.testing.assert_array_equal(kept, sound[: len(kept)])
