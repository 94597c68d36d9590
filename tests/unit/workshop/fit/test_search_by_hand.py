"""Steps and decisions of the search for modes, on costs that the test gives."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fit_scenes import TAU
from scipy.optimize import brentq

from tonewood.workshop.fit import search
from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape

FREQ = np.arange(60.0, 801.0)


class Costs:
    """A problem whose costs come in turn, with one gradient and one curvature of (ln w, ln zeta) everywhere."""

    def __init__(self, costs, gradient=(0.01, 0.02), curvature=(1.0, 1.0), size=4000, step=1.0):
        self.data = SimpleNamespace(freq=np.array([100.0, 200.0]), step=step)
        self.size, self.costs, self.asked = size, iter(costs), []
        self.normal, self.gradient = np.diag(curvature), np.array(gradient)

    def solve(self, poles, slopes=False):
        self.asked.append((float(poles.log_freq[0]), float(poles.log_zeta[0])))
        return SimpleNamespace(cost=next(self.costs), normal=self.normal, gradient=self.gradient)


def descended(problem, start, most=9, enough=0.1):
    """Result, and steps (ln w, ln zeta) from one pole that was asked for to the next."""
    poles, solution = search.descend(problem, start, most, enough)
    return poles, solution, np.diff(problem.asked, axis=0)


@pytest.mark.parametrize(
    ("costs", "asked", "ends"),
    [
        # the cost counts as a thousandth of the 4000 numbers at least: 0.1 * 4 ends a descent
        ([3.0, 2.61, 1.0], 2, 2.61),
        ([3.0, 2.59, 2.50, 1.0], 3, 2.50),
        ([40.0, 36.1, 1.0], 2, 36.1),
        ([40.0, 35.9, 34.0, 1.0], 3, 34.0),
        # a step that gains less than a hundredth of that is none: six are tried, each shorter
        ([3.0, *[2.997] * 6, 1.0], 7, 3.0),
        ([3.0, 2.997, 2.995, 1.0], 3, 2.995),
        ([100.0, 80.0, 60.0, 40.0, 20.0], 4, 40.0),  # no more than three steps
    ],
)
def test_a_descent_ends_where_a_step_gains_too_little(costs, asked, ends) -> None:
    problem = Costs(costs)
    _, solution, steps = descended(problem, Poles.at([150.0], [10.0]), most=3)
    assert solution.cost == ends
    assert len(steps) == asked - 1


def test_steps_are_those_of_levenberg_and_marquardt_on_a_grid() -> None:
    """g / (curvature (1 + damping)): damping 1e-3 at first, an eighth after each step, eight times if it was none."""
    costs = [100.0, 80.0, 70.0, 75.0, 60.0, 50.0]
    problem = Costs(costs, gradient=(0.04, -0.9), curvature=(4.0, 9.0), size=1)
    poles, _, _ = descended(problem, Poles.at([150.0], [10.0]), most=4, enough=1e-12)
    asked = np.array(problem.asked)
    # the third step gains nothing: the fourth starts where it did, and the fifth is damped as that was
    for before, after, damping in ((0, 1, 1e-3), (1, 2, 1.25e-4), (2, 3, 1.5625e-5), (2, 4, 1.25e-4), (4, 5, 1.25e-4)):
        step = np.array([0.01, -0.1]) / (1 + damping)
        assert asked[after] - asked[before] == pytest.approx(step, abs=2e-6)
    fine = [np.log(TAU * 150.0), np.log(0.05)]
    for at, c in zip(asked[1:], [100.0, 80.0, 70.0, 70.0, 60.0], strict=True):
        grid = 2.0 ** np.floor(np.log2(np.sqrt(1e-2 * 1e-12 * c) / np.sqrt([4.0, 9.0])))
        assert at / grid == pytest.approx(np.round(at / grid), abs=1e-6)
        assert np.all(np.abs(at - fine) < 1.0)
    assert poles.log_freq[0] == asked[-1, 0]


@pytest.mark.parametrize(("damping_tries", "shorter"), [(0, 1.001), (1, 1.008), (2, 1.064), (5, 1 + 32.768)])
def test_steps_that_gain_nothing_are_shortened(damping_tries, shorter) -> None:
    """Of 1e-3 times 8 for each; the shortened steps start where the first one did."""
    problem = Costs([100.0, *[101.0] * damping_tries, 50.0, 49.9999], size=1)
    descended(problem, Poles.at([150.0], [10.0]), most=1, enough=1e-12)
    asked = np.array(problem.asked)
    assert len(asked) == damping_tries + 2
    assert asked[-1] - asked[0] == pytest.approx(np.array([0.01, 0.02]) / shorter, abs=2e-6)


@pytest.mark.parametrize(
    ("gradient", "quality", "step"),
    [
        ((9.0, 0.0), 10.0, (0.05, 0.0)), ((-9.0, 0.0), 10.0, (-0.05, 0.0)),  # by the damping ratio
        ((0.0, 9.0), 10.0, (0.0, 0.3)), ((0.0, -9.0), 10.0, (0.0, -0.3)),
        ((0.0, 9.0), 0.5 / 0.3, (0.0, np.log(0.35 / 0.3))),  # up to a ratio of 0.35
        ((0.0, -9.0), 1500.0, (0.0, np.log(0.05 / 0.1))),  # a bandwidth of a twentieth of a step, 0.05 Hz, at least
    ],
)  # fmt: skip
def test_steps_have_their_limits(gradient, quality, step) -> None:
    problem = Costs([100.0, 1.0], gradient, size=1)
    _, _, steps = descended(problem, Poles.at([150.0], [quality]), most=1, enough=1e-9)
    expected = np.array(step)
    if quality == 1500.0:
        expected[1] = max(-0.3, np.log(0.5 * 0.05 / 150.0) - np.log(0.5 / 1500.0))
    assert steps[0] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("gradient", "at", "end"), [(-9.0, 51.0, 50.0), (9.0, 315.0, 320.0)])
def test_poles_leave_the_band_by_half_and_by_sixteen_tenths_of_its_ends(gradient, at, end) -> None:
    problem = Costs([100.0, 1.0], (gradient, 0.0), size=1)
    poles, _, _ = descended(problem, Poles.at([at], [5.0]), most=1, enough=1e-9)
    assert poles.freq[0] == pytest.approx(end, rel=1e-9)


@pytest.mark.parametrize(
    ("at", "least"),
    [(150.0, 0.5 * 0.05 / 150.0), (200.0, 0.5 * 0.05 / 200.0)],
)
def test_damping_stays_above_a_twentieth_of_a_step(at, least) -> None:
    problem = Costs([100.0, 1.0], (0.0, -9.0), size=1)
    poles, _, _ = descended(problem, Poles.at([at], [0.5 / (1.1 * least)]), most=1, enough=1e-9)
    assert np.exp(poles.log_zeta[0]) == pytest.approx(least, rel=1e-9)
    problem = Costs([100.0, 1.0], (0.0, -9.0), size=1, step=1e-4)
    poles, _, _ = descended(problem, Poles.at([at], [0.5 / 1.1e-5]), most=1, enough=1e-9)
    assert np.exp(poles.log_zeta[0]) == pytest.approx(1e-5, rel=1e-9)


def test_poles_that_pass_each_other_are_sorted() -> None:
    problem: Any = Costs([100.0, 1.0, 0.5], size=1)
    problem.normal, problem.gradient = np.eye(4), np.array([0.05, -0.05, 0.0, 0.0])
    start = Poles(np.log(TAU * np.array([150.0, 151.0])), np.log([0.05, 0.06]))
    poles, solution = search.descend(problem, start, 1, 1e-6)
    assert np.all(np.diff(poles.log_freq) > 0)
    assert np.exp(poles.log_zeta) == pytest.approx([0.06, 0.05], rel=1e-3)
    assert solution.cost == 0.5  # solved again in that order


# modes of the whole search


def resonances(freq, at, quality):
    s, w = 1j * TAU * np.asarray(freq), TAU * np.asarray(at, float)[:, None]
    return s / (s * s + w / np.asarray(quality, float)[:, None] * s + w * w)


def test_a_pole_of_two_has_the_larger_one_s_share(monkeypatch) -> None:
    """Where they lie, weighted by their largest residues: 3 and 1."""
    poles = Poles.at([200.0, 203.0], [30.0, 20.0])
    y = np.array([[3.0, 1.0], [0.5, 0.2]]) @ resonances(FREQ, [200.0, 203.0], [30.0, 20.0])
    problem = Projection(FitData(FREQ, y, np.full(y.shape, 1e-4)), Shape((0,), 2, False, False, False))
    tried = []
    monkeypatch.setattr(search, "_may_be_one", lambda problem, poles, residues, pair, one: tried.append((pair, one)))
    assert search.joined(problem, poles)[0] is poles
    ((pair, one),) = tried
    assert pair == (0, 1)
    assert one.log_freq == pytest.approx([0.75 * np.log(TAU * 200) + 0.25 * np.log(TAU * 203)])
    assert one.log_zeta == pytest.approx([0.75 * np.log(0.5 / 30) + 0.25 * np.log(0.5 / 20)])
    tried.clear()
    # apart by less than the sum of their damping ratios, 1/60 and 1/40
    for second, n in ((200 * np.exp(0.99 / 24), 1), (200 * np.exp(1.01 / 24), 0)):
        search.joined(problem, Poles.at([200.0, second], [30.0, 20.0]))
        assert len(tried) == n
        tried.clear()
    # of five modes side by side each is tried with the next three, the nearest first
    search.joined(problem, Poles.at(200 + np.array([0.0, 1.0, 2.1, 3.3, 4.6]), [10.0] * 5))
    assert tried[0][0] == (0, 1)
    assert len({pair for pair, _ in tried}) == 9
    assert (0, 4) not in [pair for pair, _ in tried]


@pytest.mark.parametrize(
    ("costs", "rounds"), [([100.0, 90.0, 89.1], 3), ([100.0, 90.0, 88.9, 88.5], 4), ([100.0, 110.0], 2)]
)
def test_rounds_of_a_search_end_where_modes_cost_more_than_they_gain(costs, rounds, monkeypatch) -> None:
    """Costs with the prices of all modes: a round that gains less than 1 is told of, and its modes are not taken."""
    made, told, left, moved = iter(range(99)), [], [], []
    data = FitData(FREQ, np.ones((1, FREQ.size), complex), np.ones((1, FREQ.size)))
    shape = Shape((0,), 1, False, False, False)
    price = Projection(data, shape).price

    def pruned(problem, poles, steps=4):
        n = next(made)
        found = Poles.at(100.0 * np.arange(1, n + 2), np.full(n + 1, 10.0))
        cost = costs[n] - price * (n + 1) if n < len(costs) else 0.0
        return found, LinearFit(cost, np.zeros((1, n + 1)), np.zeros((1, n + 1)))

    def descend(problem, poles, most, enough):
        moved.append((len(poles), most, enough))
        return poles, None

    monkeypatch.setattr(FitData, "thinned", lambda self: self)
    monkeypatch.setattr(search.MatchedFilters, "candidates", lambda self, misfit: Poles.at([150.0], [10.0]))
    monkeypatch.setattr(search, "descend_in_groups", lambda problem, poles, most: poles)
    monkeypatch.setattr(search, "descend", descend)
    monkeypatch.setattr(search, "pruned", pruned)
    monkeypatch.setattr(search, "joined", lambda problem, poles: (poles, None))
    monkeypatch.setattr(Projection, "misfit", lambda self, poles, residues: left.append(len(poles)))
    monkeypatch.setattr(Projection, "solve", lambda self, poles: LinearFit(0.0, np.zeros((1, 1)), np.zeros((1, 1))))
    search.sought(data, shape, None, lambda iteration: told.append((len(iteration.freq), iteration.misfit)))
    assert [n for n, _ in told] == list(range(1, rounds + 1))
    assert told[0][1] == pytest.approx((costs[0] - price) / (2 * FREQ.size))
    assert left == list(range(1, rounds))  # the first round looks at the data themselves
    assert moved == [*((n, 4, 1e-4) for n in range(1, rounds + 1)), (rounds - 1, 15, 1e-6)]


def test_groups_of_eight_are_moved_by_themselves(monkeypatch) -> None:
    """Of 20 modes: 8, 8 and 4; a group of too few bins stays. Of 16 all move at once."""
    moved = []

    def descend(problem, poles, most, enough):
        moved.append((len(poles), most, enough))
        return Poles(poles.log_freq + 1e-3, poles.log_zeta + 0.1), None

    monkeypatch.setattr(search, "descend", descend)
    monkeypatch.setattr(search, "_around", lambda problem, poles, residues, mine: None if 9 in mine else problem)
    y = np.ones((1, FREQ.size), complex)
    problem = Projection(FitData(FREQ, y, np.ones(y.shape)), Shape((0,), 1, False, False, False))
    poles = Poles.at(np.linspace(100.0, 700.0, 20), np.full(20, 30.0))
    found = search.descend_in_groups(problem, poles, 5)
    assert moved == [(8, 5, 1e-3), (4, 5, 1e-3)]
    stays = (np.arange(20) >= 8) & (np.arange(20) < 16)
    assert found.log_freq - poles.log_freq == pytest.approx(np.where(stays, 0.0, 1e-3))
    assert found.log_zeta - poles.log_zeta == pytest.approx(np.where(stays, 0.0, 0.1))
    moved.clear()
    search.descend_in_groups(problem, poles[:16], 7)
    assert moved == [(16, 7, 1e-4)]


# which modes stay


def scene(at, quality, residues, sigma=1e-4, shape=None, freq=FREQ, beside=0.0):
    y = np.atleast_2d(residues) @ resonances(freq, at, quality) + beside
    shape = shape or Shape((0,), len(y), False, False, False)
    return Projection(FitData(freq, y, np.full(y.shape, sigma)), shape), Poles.at(at, quality)


def change_near(weak, quality):
    """dB, r.m.s. change within two bandwidths and five steps of 600 Hz, where the other mode alone is fitted."""
    near = np.abs(FREQ - 600.0) <= 2 * 600.0 / quality + 5.0
    first, second = resonances(FREQ, [300.0, 600.0], [30.0, quality])
    y = first + weak * second
    alone = np.vdot(first, y).real / np.vdot(first, first).real * first
    return np.sqrt(np.mean((20 * np.log10(np.abs(alone / y))[near]) ** 2))


@pytest.mark.parametrize(("level", "seen"), [(0.049, False), (0.051, True)])
def test_a_mode_that_changes_a_response_by_a_twentieth_of_a_decibel_stays(level, seen) -> None:
    weak = brentq(lambda weak: change_near(weak, 40.0) - level, 1e-6, 0.1)
    problem, poles = scene([300.0, 600.0], [30.0, 40.0], [1.0, weak])
    assert search.inaudible(problem, poles, np.zeros(0)).tolist() == ([] if seen else [1])


@pytest.mark.parametrize(("driving", "doubt", "whole"), [((0,), 0.2, False), ((), 0.11, True), ((), 0.09, False)])
def test_without_a_driving_point_a_doubtful_mode_has_to_matter_over_the_whole_band(
    driving, doubt, whole, monkeypatch
) -> None:
    """19 of 741 bins are near it: 0.15 dB there are a sixth of that in all."""
    weak = brentq(lambda weak: change_near(weak, 300.0) - 0.15, 1e-6, 0.1)
    shape = Shape(driving, 1, False, False, False)
    problem, poles = scene([300.0, 600.0], [30.0, 300.0], [1.0, weak], shape=shape)
    monkeypatch.setattr(Projection, "deviations", lambda self, poles: (None, np.full(len(poles), doubt), None))
    assert search.inaudible(problem, poles, np.zeros(0)).tolist() == ([1] if whole else [])


def test_of_several_the_one_that_matters_least_is_named() -> None:
    problem, poles = scene([200.0, 400.0, 600.0], [30.0] * 3, [1.0, 3e-5, 1e-5], sigma=1e-8)
    assert search.inaudible(problem, poles, np.zeros(0)).tolist() == [2]
    assert search.inaudible(problem, poles, np.array([600.0 * np.exp(0.029)])).tolist() == [1]
    assert search.inaudible(problem, poles, np.array([600.0 * np.exp(0.031)])).tolist() == [2]


def test_modes_of_which_one_costs_too_much_are_taken_away_the_weakest_first(monkeypatch) -> None:
    """Neighbours one at a time; those farther apart than four half bandwidths at once. A wrong sign comes first."""
    gone = []

    def descend(problem, poles, most, enough):
        gone.append((poles.freq.round(3).tolist(), most, enough))
        return poles, None

    monkeypatch.setattr(search, "descend", descend)
    # the half bandwidths re the frequencies are 0.02 each: 300 and 320 are within four of both, 300 and 360 are not
    at, quality = [150.0, 300.0, 320.0, 600.0], [25.0] * 4
    problem, poles = scene(at, quality, [1.0, 2e-7, 1e-7, 3e-7])
    search.pruned(problem, poles, steps=3)
    assert gone == [([150.0, 300.0], 3, 1e-3), ([150.0], 3, 1e-3)]
    gone.clear()
    problem, poles = scene([150.0, 300.0, 360.0, 600.0], quality, [1.0, 2e-7, 1e-7, 3e-7])
    search.pruned(problem, poles)
    assert gone == [([150.0], 4, 1e-3)]
    gone.clear()


class StopError(Exception):
    """Ends a search with the poles that it would go on with."""


@pytest.mark.parametrize(("share", "first"), [(0.21, 300.0), (0.19, 320.0)])
def test_a_mode_of_a_wrong_sign_counts_a_fifth_of_its_gain(share, first, monkeypatch) -> None:
    """Beside a neighbour that gains a share of it."""

    def stop(problem, poles, most, enough):
        raise StopError(poles)

    at = [150.0, 300.0, 320.0, 600.0]
    problem, poles = scene(at, [25.0] * 4, [1.0, -1.0, 1.0, 1.0])
    answer = LinearFit(0.0, np.array([[1.0, -1.0, 1.0, 1.0]]), np.array([[1e4, 100.0, 100.0 * share, 1e4]]))
    monkeypatch.setattr(Projection, "solve", lambda self, poles: answer)
    monkeypatch.setattr(search, "prices", lambda problem, poles, solution: np.full(len(poles), 1e3))
    monkeypatch.setattr(search, "descend", stop)
    with pytest.raises(StopError) as caught:
        search.pruned(problem, poles)
    assert caught.value.args[0].freq == pytest.approx([f for f in at if f != first])


def test_two_modes_may_be_one_for_four_prices_on_the_bins_around_them(monkeypatch) -> None:
    """Two neighbours on each side move with them; of too few bins all have to move."""
    at = 200.0 + 40.0 * np.arange(8)
    problem, poles = scene(at.tolist(), [20.0] * 8, np.ones(8))
    residues, one = problem.solve(poles).residues, Poles.at([340.0], [20.0])
    moved, costs = [], [0.0]

    def descend(problem, poles, most, enough):
        moved.append((poles.freq.round(3).tolist(), most, enough))
        return poles, LinearFit(costs[0], residues, residues)

    monkeypatch.setattr(search, "descend", descend)
    monkeypatch.setattr(search, "prices", lambda problem, poles, solution: np.array([9.0, 9.0, 5.0, 7.0, 9.0, 9.0]))
    before = search._around(problem, poles, residues, np.arange(1, 7)).solve(poles[1:7]).cost
    for costs[0], may in ((before + 27.9, True), (before + 28.1, False)):
        assert search._may_be_one(problem, poles, residues, (3, 4), one) is may
    assert moved[0] == ([240.0, 280.0, 340.0, 400.0, 440.0], 6, 1e-4)
    search._may_be_one(problem, poles, residues, (0, 1), one)
    assert moved[-1][0] == [280.0, 320.0, 340.0]
    search._may_be_one(problem, poles, residues, (6, 7), one)
    assert moved[-1][0] == [340.0, 360.0, 400.0]
    monkeypatch.setattr(search, "_around", lambda *_: None)
    assert search._may_be_one(problem, poles, residues, (3, 4), one) is True


# matched filters


def test_filters_are_on_a_grid_of_three_tenths_of_a_bandwidth_that_bins_resolve() -> None:
    problem, _ = scene([200.0], [20.0], [1.0])
    at, quality = search.MatchedFilters(problem)._grid
    assert sorted(set(quality)) == [3, 6, 12, 25, 50, 100, 200, 400, 800]
    for q in set(quality):
        mine = at[quality == q]
        assert np.diff(np.log(mine)) == pytest.approx(0.3 / q)
        assert mine[0] == pytest.approx(max(60.0, 60.0 * np.exp(0.3 / q * np.ceil(np.log(0.5 * q / 60.0) * q / 0.3))))
        assert mine[-1] < 800.0 <= mine[-1] * np.exp(0.3 / q)


@pytest.mark.parametrize("structural", [False, True])
def test_a_filter_reaches_six_bandwidths_and_three_bins(structural) -> None:
    """The conjugate resonance over its noise, sqrt(2) / sigma; its length is the sum of squares."""
    problem, _ = scene([200.0], [20.0], [1.0], 1e-3, Shape((0,), 1, False, False, False, structural))
    one = search.MatchedFilters(problem)
    (filters,), lengths = one._filters
    at, quality = one._grid
    for k in (5, np.flatnonzero(quality == 25)[40], np.flatnonzero(quality == 100)[150]):
        w, s, reach = TAU * at[k], 1j * TAU * FREQ, 6 * at[k] / quality[k] + 3
        h = s / (s * s + (1j * w * w / quality[k] if structural else w / quality[k] * s) + w * w)
        row = np.where((at[k] - reach <= FREQ) & (at[k] + reach > FREQ), h.conj() * np.sqrt(2) / 1e-3, 0.0)
        np.testing.assert_allclose(filters[[k]].toarray()[0], row, rtol=1e-9)
        assert lengths[0, k] == pytest.approx(np.sum(np.abs(row) ** 2))


def test_candidates_are_as_many_as_are_asked_for_and_worth_their_price() -> None:
    problem, _ = scene([100.0, 300.0, 600.0], [25.0] * 3, [1.0, 2.0, 3.0], 1e-4)
    filters = search.MatchedFilters(problem)
    assert len(filters.candidates(problem.data.mobility, 2)) == 2
    assert filters.candidates(problem.data.mobility, 1).freq[0] == pytest.approx(600.0, rel=0.01)
    assert len(filters.candidates(problem.data.mobility)) == 12
    problem, _ = scene([600.0], [25.0], [1.0])
    gain = 2 * np.sum(np.abs(problem.data.mobility) ** 2) / 1e-8
    for share, some in ((1.1, True), (0.99, False)):
        weak = problem.data.mobility * np.sqrt(share * problem.price / gain)
        assert (len(filters.candidates(weak)) > 0) is some
