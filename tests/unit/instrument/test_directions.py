"""Directions: unit vectors, polarizations perpendicular to the string."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tonewood.instrument.contract.directions import polarization_vectors, unit_vector

ANGLE = math.radians(23.6)
INCLINED = (math.cos(ANGLE), 0.0, -math.sin(ANGLE))


def test_unit_vector() -> None:
    assert unit_vector("y") == (0.0, 1.0, 0.0)
    assert math.hypot(*unit_vector((0.916, 0.0, -0.4))) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), INCLINED])
@pytest.mark.parametrize("tilt", [0.0, 12.0, -40.0])
def test_perpendicular_right_handed_and_tilted(axis: tuple[float, float, float], tilt: float) -> None:
    first, second = (np.array(v) for v in polarization_vectors(axis, ("z", "y"), tilt))
    for v in (first, second):
        assert v @ np.array(axis) == pytest.approx(0.0, abs=1e-15)
        assert v @ v == pytest.approx(1.0)
    assert first @ second == pytest.approx(0.0, abs=1e-15)
    untilted = np.array(polarization_vectors(axis, ("z", "y"), 0.0)[0])
    assert first @ untilted == pytest.approx(math.cos(math.radians(tilt)))
    assert second @ untilted == pytest.approx(-math.sin(math.radians(tilt)))


def test_share_of_an_inclined_string() -> None:
    (only,) = polarization_vectors(INCLINED, ("z",), 0.0)
    assert only[2] == pytest.approx(math.cos(ANGLE))


def test_a_single_polarization_is_tilted_too() -> None:
    (only,) = polarization_vectors((1.0, 0.0, 0.0), ("z",), 30.0)
    assert only[2] == pytest.approx(math.cos(math.radians(30)))
