"""Strikes while a body still rings, and recordings with a constant: where a tap begins."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.workshop.taps.cutting import cut_taps
from tonewood.workshop.taps.ringing import ringing

FS = 12000
MODES = ((98.0, 15.0, 1.0), (190.0, 30.0, 0.8), (235.0, 25.0, 0.5), (402.0, 45.0, 0.6))
LONG = ((150.0, 400.0, 1.0), (300.0, 800.0, 0.9))
BEATS = ((190.0, 300.0, 1.0), (193.0, 300.0, 1.0), (235.0, 200.0, 0.5))


def struck(modes, times, sizes, seconds, noise=1e-4):
    """Sum of the free motions of each strike, A exp(-pi f t / Q) sin(2 pi f sqrt(1 - 1 / 4 Q^2) t), and noise."""
    x = noise * np.random.default_rng(1).normal(size=round(seconds * FS))
    for at, size in zip(times, sizes, strict=True):
        n = round(at * FS)
        t = np.arange(x.size - n) / FS
        for f, q, a in modes:
            damped = f * np.sqrt(1 - 1 / (4 * q * q))
            x[n:] += 0.1 * size * a * np.exp(-np.pi * f / q * t) * np.sin(2 * np.pi * damped * t)
    return x


@pytest.mark.parametrize(("after", "kept"), [(0.04, 3), (0.08, 3), (0.2, 6)])
def test_a_tap_that_is_struck_again_ends_there(after, kept):
    """Within 0.1 s of the second strike the first is left out; both have the poles of the body in what is left."""
    times = np.add.outer([0.5, 1.5, 2.5], [0.0, after]).ravel()
    taps = cut_taps(struck(MODES, times, [1.0, 0.6, 0.8, 0.7, 1.1, 0.5], 3.5), FS)
    assert (len(taps.samples), len(taps.left_out)) == (kept, 6 - kept)
    assert all("another one follows too early" in line for line in taps.left_out)
    peaks = [peak for peak in ringing(taps.analysed(), FS) if peak.certain]
    assert [peak.freq for peak in peaks] == pytest.approx([f for f, _, _ in MODES], rel=1e-3)
    assert [peak.quality for peak in peaks] == pytest.approx([q for _, q, _ in MODES], rel=0.03)


def test_strikes_on_a_body_that_rings_on_are_taps_of_their_own():
    taps = cut_taps(struck(LONG, [0.5, 1.5, 2.5, 3.5], [1.0, 0.7, 1.2, 0.9], 4.5), FS)
    assert [x.size / FS for x in taps.samples] == pytest.approx([0.975, 0.975, 0.975, 0.995], abs=5e-3)
    peaks = ringing(taps.analysed(), FS)
    assert [peak.quality for peak in peaks] == pytest.approx([400.0, 800.0], rel=0.02)


def test_modes_that_beat_are_no_strikes():
    assert len(cut_taps(struck(BEATS, [0.5, 1.5], [1.0, 1.0], 2.5), FS).samples) == 2


def test_a_constant_is_no_tap():
    with pytest.raises(TonewoodError, match="holds no tap"):
        cut_taps(np.full(FS, 0.5), FS)
    taps = cut_taps(struck(MODES, [0.5, 1.5], [1.0, 1.0], 2.5, noise=0.0) + 0.4, FS)
    assert (len(taps.samples), taps.left_out) == (2, ())
