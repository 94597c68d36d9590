"""Scatter of strings' tilt and split: from a seed, per string and stop."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.string_schema import Scatter
from tonewood.instrument.model.assembly import assemble
from tonewood.support.units import cents


def test_draws_are_normal_and_of_a_seed() -> None:
    scatter = Scatter(seed=1, tilt_deg=6.0, split_cents=4.0)
    tilts = np.array([scatter.tilt(f"s{i}") for i in range(500)])
    splits = np.array([scatter.split("E2", i) for i in range(500)])
    assert np.std(tilts) == pytest.approx(6.0, rel=0.1)
    assert np.std(splits) == pytest.approx(4.0, rel=0.1)
    assert abs(np.mean(splits)) < 0.6
    assert scatter.split("E2", 3) == Scatter(seed=1, split_cents=4.0).split("E2", 3)
    assert scatter.split("E2", 3) != Scatter(seed=2, split_cents=4.0).split("E2", 3)
    assert scatter.split("E2", 3.25) == pytest.approx(0.75 * scatter.split("E2", 3) + 0.25 * scatter.split("E2", 4))


def test_the_second_plane_is_off_by_its_split() -> None:
    """Frequencies of a limp string follow the root of the tension, so all modes are off by the same interval."""
    guitar = Instrument.load("classical_guitar").replace({"strings.G3.bending_stiffness": 0.0})
    string = assemble(guitar, 8000.0, freq_limit=3000.0).strings["G3"]
    scatter = guitar.spec.strings["G3"].scatter
    for stop in (0, 5):
        first, second = (basis.natural_freq for basis in string.bases(stop).values())
        n = min(len(first), len(second))
        off = [cents(b / a) for a, b in zip(first[:n], second[:n], strict=True)]
        assert off == pytest.approx([scatter.split("G3", stop)] * n, abs=1e-6)
    angle = np.degrees(np.arctan2(*np.array(string.polarizations[0].direction)[[1, 2]]))
    assert angle == pytest.approx(scatter.tilt("G3"))
