"""The limiter: never above its ceiling, samples below it untouched, the same for every block size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import tonewood as tw
from tonewood.sound.level.limiter import Limiter

Floats = NDArray[np.float64]
FS = 8000


def limited(x: Floats, block: int = 1000, **options: float) -> Floats:
    blocks = list(Limiter(FS, **options).process(x[i : i + block] for i in range(0, len(x), block)))
    assert [len(b) for b in blocks] == [min(block, len(x) - i) for i in range(0, len(x), block)]
    return np.concatenate(blocks) if blocks else x


@given(
    n=st.integers(1, 9000),
    peaks=st.lists(st.tuples(st.integers(0, 8999), st.floats(-20, 20)), max_size=8),
    seed=st.integers(0, 99),
)
def test_nothing_passes_the_ceiling(n: int, peaks: list[tuple[int, float]], seed: int) -> None:
    x = 0.3 * np.random.default_rng(seed).standard_normal((n, 2)).clip(-2, 2)
    for at, size in peaks:
        x[at % n, at % 2] = size
    y = limited(x, ceiling_db=-1.0)
    assert y.shape == x.shape
    assert np.abs(y).max() <= 10 ** (-1 / 20) * (1 + 1e-12)
    assert np.all(y * x >= 0)
    assert np.all(np.abs(y) <= np.abs(x))


def test_quiet_sound_is_left_alone_to_the_bit(rng: np.random.Generator) -> None:
    x = rng.uniform(-0.9, 0.9, (5000, 2))
    limiter = Limiter(FS)
    assert np.array_equal(np.concatenate(list(limiter.process([x]))), x)
    assert limiter.reduction_db == 0.0


def test_blocks_do_not_matter(rng: np.random.Generator) -> None:
    x = rng.standard_normal((10000, 2)) * np.exp(-np.arange(10000) / 2000)[:, None]
    reference = limited(x, 1 << 20)
    for block in (1, 7, 64, 511, 4096):
        assert np.array_equal(limited(x, block), reference)


def test_the_gain_moves_smoothly_and_comes_back() -> None:
    x = np.full((3 * FS, 1), 0.1)
    x[FS] = 4.0
    limiter = Limiter(FS, ceiling_db=-1.0, look_ahead=0.005, release_db_s=60.0)
    y = np.concatenate(list(limiter.process([x])))
    gain = 20 * np.log10((y / x)[:, 0])
    needed = 20 * np.log10(4.0) + 1.0
    assert gain[FS] == pytest.approx(-needed, abs=1e-9)
    assert limiter.reduction_db == pytest.approx(needed, abs=1e-9)
    assert np.abs(np.diff(gain)).max() <= needed / (0.005 * FS) * 1.001  # spread over the time it looks ahead
    assert np.all(gain[: FS - 41] == 0.0)
    back = np.flatnonzero(gain[FS:] > -1e-9)[0] / FS
    assert back == pytest.approx(needed / 60.0 + 0.005, abs=0.006)


def test_channels_share_one_gain() -> None:
    x = np.full((2000, 2), 0.5)
    x[1000, 0] = 3.0
    y = limited(x)
    assert np.allclose(y[:, 0] / x[:, 0], y[:, 1] / x[:, 1])


def test_a_ceiling_at_full_scale_or_above_is_refused() -> None:
    with pytest.raises(tw.TonewoodError, match="just below 0"):
        Limiter(FS, ceiling_db=0.0)
