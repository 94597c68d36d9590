"""Intervals of 90 % that a fit reports, on simulated bodies: how many hold the truth."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import random_body

from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.responses import Responses

FREQ = np.arange(80.0, 500.0)


def held(seed):
    """Of the modes of one body, seen with noise of an additive and a relative part: which intervals hold the truth."""
    rng = np.random.default_rng(1000 + seed)
    truth = random_body(3, seed=seed, low=110.0, high=460.0)
    truth.residues[:] = np.sign(truth.residues) * np.maximum(np.abs(truth.residues), 0.3)  # each can be found
    clean = truth.mobility(FREQ)
    size = 10 ** rng.uniform(-3.5, -2.2) * np.abs(clean).max() + 10 ** rng.uniform(-3, -2) * np.abs(clean)
    mobility = clean + size / np.sqrt(2) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    rows = [x for x in fit_responses(Responses(FREQ, mobility, (("a", "a"), ("b", "a")))).rows if x["measured"]]
    out = []
    for f, q, mass in zip(truth.freq, truth.quality, 1 / truth.residues[0], strict=True):
        row = min(rows, key=lambda x: abs(x["freq_Hz"] - f))
        for name, value in (("freq_Hz", f), ("Q", q), ("mass_kg", mass)):
            low, high = row["interval_90"][name]
            out.append(low <= value <= high)
    return len(rows), out


def check(n_bodies, low, high):
    numbers, found = zip(*(held(seed) for seed in range(n_bodies)), strict=True)
    share = np.mean(np.reshape(found, (-1, 3)), axis=0)
    assert np.all((low <= share) & (share <= high)), share
    assert np.mean(np.array(numbers) == 3) > 0.97


@pytest.mark.slow
def test_intervals_hold_the_truth_of_a_few_bodies():
    """Of 20 bodies, 60 modes: 90 % within three standard deviations of a share of 60."""
    check(20, 0.78, 0.99)


@pytest.mark.validate
def test_intervals_hold_the_truth_of_two_hundred_bodies():
    check(200, 0.85, 0.95)
