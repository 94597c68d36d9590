"""The three settings of the renderer's dials, and the decimator behind the finest."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.output.accuracy import LEVELS, Decimator

FS = 8000.0


def decimated(factor: int, sound: np.ndarray, chunk: int) -> np.ndarray:
    decimator = Decimator(factor, sound.shape[1])
    parts = [decimator(sound[i : i + chunk]) for i in range(0, len(sound), chunk)]
    return np.concatenate(parts)[decimator.lead :]


@pytest.mark.parametrize("freq", [0.0, 500.0, 3500.0])
def test_decimator_keeps_what_lies_below_and_delays_nothing(freq: float) -> None:
    t = np.arange(8000)[:, None] / (4 * FS)
    got = decimated(4, np.cos(2 * np.pi * freq * t + 0.3), 512)
    wanted = np.cos(2 * np.pi * freq * np.arange(len(got)) / FS + 0.3)
    inner = slice(100, len(got) - 100)
    np.testing.assert_allclose(got[inner, 0], wanted[inner], atol=1e-4)


def test_decimator_removes_what_would_alias() -> None:
    t = np.arange(8000)[:, None] / (4 * FS)
    got = decimated(4, np.cos(2 * np.pi * 4100.0 * t), 512)
    assert np.abs(got[100:-100]).max() < 1e-5


def test_decimator_does_not_know_of_chunks() -> None:
    sound = np.random.default_rng(3).standard_normal((4096, 2))
    np.testing.assert_array_equal(decimated(4, sound, 64), decimated(4, sound, 2048))


def test_factor_one_is_the_sound_itself() -> None:
    sound = np.random.default_rng(3).standard_normal((64, 2))
    assert Decimator(1, 2).lead == 0
    np.testing.assert_array_equal(Decimator(1, 2)(sound), sound)


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


def test_reference_does_not_know_of_blocks(monochord: tw.Instrument) -> None:
    np.testing.assert_array_equal(
        sound(monochord, 777, accuracy="reference"), sound(monochord, 9600, accuracy="reference")
    )


def test_reference_goes_back_to_a_snapshot(monochord: tw.Instrument) -> None:
    renderer = tw.Renderer(SCORE, monochord, max_duration=0.2, accuracy="reference")
    blocks = renderer.blocks(1000)
    next(blocks)
    kept = renderer.snapshot()
    first = np.concatenate(list(blocks))
    renderer.restore(kept)
    np.testing.assert_array_equal(np.concatenate(list(renderer.blocks(1000))), first)


def test_draft_steps_fewer_modes_and_is_near(monochord: tw.Instrument) -> None:
    draft, full = (tw.Renderer(SCORE, monochord, accuracy=name) for name in ("draft", "standard"))
    assert draft.model.n_modes < 0.7 * full.model.n_modes
    highest = max(float(c.basis.natural_freq.max()) for c in draft.model.system.compiled)
    assert highest <= LEVELS["draft"].freq_limit


def test_unknown_setting_is_reported_in_one_line(monochord: tw.Instrument) -> None:
    with pytest.raises(tw.TonewoodError, match=r"accuracy: is 'best'; draft, standard, reference are allowed"):
        tw.Renderer(SCORE, monochord, accuracy="best")
