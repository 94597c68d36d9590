"""Hits whose zero or whose frequencies drift, made of closed forms in the frequency domain."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import TAU

from tonewood.workshop.fit import drift
from tonewood.workshop.fit.files import Reading, read_responses
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.hits import responses_of_hits

FS, N = 5000.0, 5000
NATURAL, MASS = np.array([103.0, 196.0, 325.0]), np.array([0.1, 0.2, 0.15])
SHAPES = np.array([[1, 1, 1], [1, -0.5, 0.8]])
NAMES = ("p0", "p1")


def hits(shifts, zero=0.0, noise=1e-3):
    """Force (H, N) and acceleration (H, 2, N) of hits whose frequencies are shifted, (H, 1) or (H, 3) relative."""
    rng, t = np.random.default_rng(5), np.arange(N) / FS
    force, motion = [], []
    for h, shift in enumerate(shifts):
        f = np.zeros(N)
        f[250:257] = (5 + h) * np.hanning(9)[1:-1]
        freq = np.fft.rfftfreq(4 * N, 1 / FS)
        s, w = 1j * TAU * freq, TAU * NATURAL[:, None] * (1 + np.asarray(shift)[:, None])
        accelerance = (SHAPES * SHAPES[0] / MASS) @ (s**2 / (s**2 + w * s / 30 + w**2))
        a = np.fft.irfft(np.fft.rfft(f, 4 * N) * accelerance, 4 * N)[:, :N]
        level = a.std(axis=1, keepdims=True)
        motion.append(a + noise * level * rng.normal(size=a.shape) + zero * level * (0.5 + 3 * t))
        force.append(f + 1e-3 * f.max() * rng.normal(size=N))
    return np.array(force), np.array(motion)


def fitted(tmp_path, force, motion):
    """Fit of a CSV file a hit."""
    t, paths = np.arange(N) / FS, []
    for h, (f, a) in enumerate(zip(force, motion, strict=True)):
        paths.append(tmp_path / f"hit_{h}.csv")
        table = np.column_stack([t, f, *a])
        np.savetxt(paths[-1], table, delimiter=",", header="time_s,p0_force,p0,p1", comments="")
    return fit_responses(read_responses(paths, Reading("accelerance")), band=(40, 600))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nothing", "zero", "frequencies", "frequencies far"])
def test_hits_that_drift_are_a_body_with_their_own_q(tmp_path, kind):
    """Without the correction: Q 28.8 and no body where the zero drifts."""
    shifts = np.linspace(-1, 1, 4)[:, None] * {"frequencies": 3e-3, "frequencies far": 2e-2}.get(kind, 0.0)
    fit = fitted(tmp_path, *hits(shifts, zero=1.0 if kind == "zero" else 0.0))
    rows = [row for row in fit.rows if row["measured"]]
    assert [row["freq_Hz"] for row in rows] == pytest.approx(NATURAL, rel=1e-3)
    assert [row["Q"] for row in rows] == pytest.approx([30.0] * 3, rel=0.02)
    assert [row["mass_kg"] for row in rows] == pytest.approx(MASS, rel=0.02)
    lines = [line for line in fit.warnings if "drift" in line]
    if kind == "nothing":
        assert not lines
    elif kind == "zero":
        assert len(lines) == 1
        assert "the zero drifts during a hit of p0 (" in lines[0]
    else:
        assert len(lines) == 1
        said = float(lines[0].split("drift by ")[1].split(" %")[0])
        assert said == pytest.approx(100 * np.ptp(shifts), rel=0.05)


def test_shifts_of_each_hit_are_found_and_peaks_that_move_by_themselves_are_named():
    shifts = np.array([[0.0], [0.001], [-0.002], [0.0005]])
    common = np.array(responses_of_hits(*hits(shifts), FS).drift.common)
    assert common - common.mean() == pytest.approx(shifts[:, 0] - shifts.mean(), abs=1e-4)
    own = np.zeros((4, 3))
    own[:, 1] = [0.0, 0.004, 0.008, 0.012]
    peaks = responses_of_hits(*hits(own), FS).drift.peaks
    assert any(abs(freq - 197.0) < 2 and moved > 0.006 for freq, moved, _ in peaks)
    assert not any(responses_of_hits(*hits(np.zeros((4, 1)), noise=0.1), FS).drift.common)


def test_a_zero_that_drifts_is_taken_out_and_told_re_the_peak() -> None:
    """The largest of the hits, of each channel by itself."""
    t, hit = np.arange(400), np.where(np.arange(400) == 100, 2.0, 0.0)
    motion = np.array([0.5 * hit + 1e-3 * t, 0.5 * hit - 5e-4 * t])[:, None]
    force, motion, moved = drift.level_zero(np.array([hit, hit]), motion)
    np.testing.assert_allclose(force, [hit, hit], atol=1e-12)
    np.testing.assert_allclose(motion[:, 0], [0.5 * hit, 0.5 * hit], atol=1e-12)
    np.testing.assert_allclose(moved, [0.0, 0.399], atol=1e-9)
