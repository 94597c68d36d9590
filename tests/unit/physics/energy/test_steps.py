"""Coefficients of known forces within steps, against the forces themselves."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.physics.energy.steps import KnownForce, _by_step, _on_interval
from tonewood.physics.stepping.forcing import SampledForce, Segment

DT = 1e-3


@pytest.mark.parametrize("factor", [1.0, 0.37, -2.5])
def test_a_sampled_force_that_is_constant_is_constant_in_every_interval(factor: float) -> None:
    force = KnownForce("gesture", "c", "p", SampledForce(0.0, 1e-4, np.full(101, 2.0)), factor=factor)
    for start, stop in ((0.0, 1.0), (0.2, 0.7)):
        assert _on_interval(force, 4, start, stop, DT) == pytest.approx([2.0 * factor, 0.0, 0.0], rel=1e-12)
    assert _by_step(force, 4, 2, DT) == pytest.approx(np.array([[2.0 * factor, 0.0, 0.0]] * 2), rel=1e-12)


@pytest.mark.parametrize("factor", [1.0, 0.37, -2.5])
@pytest.mark.parametrize("late", [0.0, 0.25e-3])
def test_a_segment_has_its_own_values_in_every_interval(factor: float, late: float) -> None:
    """f(t) = 3 + 200 t - 1e4 t^2 of the time since the segment's beginning, read at tau = 0, 1/2 and 1."""
    piece = Segment(1e-3, 9e-3, 3.0, 200.0, -1e4)
    force = KnownForce("gesture", "c", "p", (piece,), time=late, factor=factor)

    def value(t: float) -> float:
        since = t - late - 1e-3
        return factor * (3.0 + 200.0 * since - 1e4 * since * since)

    for start, stop in ((0.0, 1.0), (0.3, 0.9)):
        c = _on_interval(force, 5, start, stop, DT)
        for tau in (0.0, 0.5, 1.0):
            assert c @ [1, tau, tau * tau] == pytest.approx(value((5 + start + tau * (stop - start)) * DT), rel=1e-12)
    whole = _by_step(force, 5, 3, DT)
    for step in range(3):
        for tau in (0.0, 0.5, 1.0):
            assert whole[step] @ [1, tau, tau * tau] == pytest.approx(value((5 + step + tau) * DT), rel=1e-12)
    ends = _by_step(force, 0, 12, DT)
    assert np.all(ends[0] == 0.0)
    assert np.all(ends[10:] == 0.0)
    assert np.isnan(ends[[1, 9]][:, 0]).all() == (late > 0.0)
