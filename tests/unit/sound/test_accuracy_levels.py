"""The three settings of ``--accuracy``, and the filter between the engine's rate and that of the sound."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

import tonewood as tw
from tonewood.instrument.model.assembly import FREQ_LIMIT, Model
from tonewood.sound.render.resampling import Resampler

FS = 8000.0


#: of the engine's rate to that of the sound, as text: test names
RATIOS = ["1/4", "1/2", "3/4", "5/4", "2", "4"]


def resampled(ratio: str, sound: np.ndarray, first: int, chunk: int) -> tuple[int, np.ndarray]:
    """Number of the first frame, and the frames."""
    resampler = Resampler(Fraction(ratio), sound.shape[1])
    parts = [resampler(sound[i : i + chunk], first + i) for i in range(0, len(sound), chunk)]
    return resampler.frame(first), np.concatenate(parts)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.44])
def test_resampler_keeps_what_lies_below_and_delays_nothing(ratio: str, share: float) -> None:
    engine_fs, freq = FS * float(Fraction(ratio)), share * min(FS, FS * float(Fraction(ratio)))
    n = np.arange(-640, 8000)
    first, got = resampled(ratio, np.cos(2 * np.pi * freq * n / engine_fs + 0.3)[:, None], -640, 512)
    wanted = np.cos(2 * np.pi * freq * (first + np.arange(len(got))) / FS + 0.3)
    inner = slice(1000, -10)
    np.testing.assert_allclose(got[inner, 0], wanted[inner], atol=1e-5)


@pytest.mark.parametrize("ratio", RATIOS)
def test_resampler_removes_what_would_alias(ratio: str) -> None:
    """Above the lower Nyquist frequency: aliases, and images of the engine's sound."""
    p, q = Fraction(ratio).as_integer_ratio()
    n = np.arange(8000)
    low = 0.3 if p < q else 0.51 / float(Fraction(ratio))
    _, got = resampled(ratio, np.cos(2 * np.pi * low * n)[:, None], 0, 512)
    got = got[1000:-10, 0]
    if p < q:  # the tone itself stays: the rest without it
        t = np.arange(len(got)) * low * p / q
        basis = np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=1)
        got = got - basis @ scipy.linalg.lstsq(basis, got)[0]
    assert np.abs(got).max() < 1e-5


@pytest.mark.parametrize("ratio", RATIOS)
def test_resampler_does_not_know_of_chunks(ratio: str) -> None:
    sound = np.random.default_rng(3).standard_normal((4096, 2))
    np.testing.assert_array_equal(resampled(ratio, sound, -64, 64)[1], resampled(ratio, sound, -64, 2048)[1])


def test_ratio_one_is_the_sound_itself() -> None:
    sound = np.random.default_rng(3).standard_normal((64, 2))
    first, got = resampled("1", sound, -64, 32)
    assert first == -64
    np.testing.assert_array_equal(got, sound)


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


SCORE = tw.Score([tw.Note(0.01, 0.1, note=45, force=1.0)])


def sound(instrument: tw.Instrument, block: int = 4096, **options: object) -> np.ndarray:
    renderer = tw.Renderer(SCORE, instrument, max_duration=0.2, **options)  # type: ignore[arg-type]  # passed on
    return np.concatenate(list(renderer.blocks(block)))


def test_standard_is_the_default(monochord: tw.Instrument) -> None:
    np.testing.assert_array_equal(sound(monochord), sound(monochord, accuracy="standard"))


def test_reference_is_the_engine_at_four_times_the_rate(monochord: tw.Instrument) -> None:
    from scipy.signal import resample_poly

    fine = tw.Renderer(SCORE, monochord, 192000, max_duration=0.2)
    wanted = resample_poly(np.concatenate(list(fine.blocks())), 1, 4, axis=0)
    got = sound(monochord, accuracy="reference")
    assert got.shape == wanted.shape == (9600, 1)
    # the two filters differ where they fall off
    assert np.abs(got - wanted)[:9000].max() < 0.02 * np.abs(wanted).max()


@pytest.mark.parametrize("accuracy", ["draft", "reference"])
def test_resampled_sounds_do_not_know_of_blocks(monochord: tw.Instrument, accuracy: str) -> None:
    np.testing.assert_array_equal(sound(monochord, 777, accuracy=accuracy), sound(monochord, 9600, accuracy=accuracy))


@pytest.mark.parametrize("accuracy", ["draft", "reference"])
def test_resampled_renders_go_back_to_a_snapshot(monochord: tw.Instrument, accuracy: str) -> None:
    renderer = tw.Renderer(SCORE, monochord, max_duration=0.2, accuracy=accuracy)
    blocks = renderer.blocks(1000)
    next(blocks)
    kept = renderer.snapshot()
    first = np.concatenate(list(blocks))
    renderer.restore(kept)
    np.testing.assert_array_equal(np.concatenate(list(renderer.blocks(1000))), first)


def test_draft_is_the_engine_at_half_the_rate(monochord: tw.Instrument) -> None:
    from scipy.signal import resample_poly

    coarse = tw.Renderer(SCORE, monochord, 24000, max_duration=0.2)
    wanted = resample_poly(np.concatenate(list(coarse.blocks())), 2, 1, axis=0)
    got = sound(monochord, accuracy="draft")
    assert got.shape == wanted.shape == (9600, 1)
    # the two filters differ where they fall off
    assert np.abs(got - wanted)[:9000].max() < 0.02 * np.abs(wanted).max()


def test_a_bundle_says_how_coarse_a_draft_may_be(monochord: tw.Instrument) -> None:
    finer = monochord.replace({"draft_oversampling": 0.75, "oversampling": 2})
    rates = [tw.Renderer(SCORE, i, accuracy="draft").model.fs for i in (monochord, finer)]
    assert rates == [24000, 72000]
    assert len(sound(finer, accuracy="draft")) == 9600


def test_steps_and_highest_mode_are_options_of_their_own(monochord: tw.Instrument) -> None:
    def model(**options: object) -> Model:
        return tw.Renderer(SCORE, monochord, **options).model  # type: ignore[arg-type]  # passed on

    def highest(made: Model) -> float:
        return max(float(c.basis.natural_freq.max()) for c in made.system.compiled)

    assert model(oversampling=0.75, accuracy="reference").fs == 36000
    assert 0.9 * 5e3 < highest(model(freq_limit=5e3)) <= 5e3
    assert highest(model(accuracy="draft", freq_limit=40e3)) <= FREQ_LIMIT * 24e3
    np.testing.assert_array_equal(sound(monochord, oversampling=0.5), sound(monochord, accuracy="draft"))


def test_unknown_setting_is_reported_in_one_line(monochord: tw.Instrument) -> None:
    with pytest.raises(tw.TonewoodError, match=r"accuracy: is 'best'; draft, standard, reference are allowed"):
        tw.Renderer(SCORE, monochord, accuracy="best")
