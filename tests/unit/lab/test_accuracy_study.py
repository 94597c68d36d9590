"""Results of the study where they can be predicted."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.lab.accuracy.linear_cases import PARTIALS, LinearCase, a2_case, fabre_case, sliding_string
from tonewood.lab.accuracy.study import AB3_LIMIT, exchanged, lowest_rate, own_point, scheme_point


@pytest.fixture(scope="module")
def guitar() -> LinearCase:
    return fabre_case()


def test_partials_of_the_guitar_at_48_khz(guitar: LinearCase) -> None:
    point = own_point(guitar, 48e3).point
    assert point.stable == "stable"
    assert point.lost == 0
    assert point.cents_20 < 0.01
    assert point.energy < 1e-10
    assert len(guitar.poles) == PARTIALS


def test_order_is_four(guitar: LinearCase) -> None:
    errors = [own_point(guitar, fs, problem=guitar.problem()).point.cents_20 for fs in (48e3, 96e3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.25)


def test_adams_bashforth_is_stable_above_its_limit_only(guitar: LinearCase) -> None:
    limit = lowest_rate(guitar.problem(), AB3_LIMIT)
    assert scheme_point(guitar, "ab3", 0.9 * limit).point.stable != "stable"
    assert scheme_point(guitar, "ab3", 1.02 * limit).point.stable == "stable"


def test_string_without_its_ramp_is_out_of_tune(guitar: LinearCase) -> None:
    """Sliding cosines, cut off at N, lack 2 / (pi^2 N) of the static compliance: 351 / N cents."""
    case = a2_case()
    string = case.string
    assert string is not None
    place = {"pluck": 0.2 * string.length}
    found = []
    for freq_upper in (5e3, 20e3):
        basis = sliding_string(string, freq_upper, residual=False).with_places(place)
        problem = exchanged(case.problem(), "string", basis)
        found.append((basis.n_modes, own_point(case, 48e3, problem=problem).point.cents_median))
    for n, cents in found:
        assert cents == pytest.approx(351 / n, rel=0.15)
