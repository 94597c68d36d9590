"""Parts of the search for modes: poles, bins, projection, prices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_parts import FREQ, REAL, resonances
from fit_scenes import TAU

from tonewood.workshop.fit import search
from tonewood.workshop.fit.identify import Modes, _reach, identify
from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape

# -- search ------------------------------------------------------------------------------------------------------------


def test_poles_keep_their_order_and_damping() -> None:
    poles = Poles.at([300.0, 100.0], [50.0, 10.0])
    assert poles.freq.tolist() == pytest.approx([100.0, 300.0])
    assert poles.quality.tolist() == pytest.approx([10.0, 50.0])
    more = poles.joined(Poles.at([200.0], [400.0]))
    assert more.freq.tolist() == pytest.approx([100.0, 200.0, 300.0])
    assert more.without([1]).quality.tolist() == pytest.approx([10.0, 50.0])
    assert more[more.freq > 150].freq.tolist() == pytest.approx([200.0, 300.0])
    assert len(Poles.none()) == 0
    assert more.damped_beyond(99.0, 201.0).quality.tolist() == pytest.approx([10.0, 400.0, 50.0])
    assert more.damped_beyond(90.0, 110.0).quality.tolist() == pytest.approx([10.0, 10.0, 10.0])
    assert more.damped_beyond(1.0, 2.0).quality.tolist() == pytest.approx([10.0, 400.0, 50.0])


def test_thinned_bins_are_weighted_means() -> None:
    """Resolution 10: at 60 Hz six bins of 1 Hz make one."""
    rng = np.random.default_rng(1)
    y, sigma = rng.standard_normal((2, 741)) + 1j, rng.uniform(1, 2, (2, 741))
    thin = FitData(FREQ, y, sigma, 3.0).thinned(10.0)
    weight = 1 / sigma[:, :6] ** 2
    assert thin.freq[0] == np.mean(FREQ[:6])
    assert thin.freq[1] == np.mean(FREQ[6:12])  # from 66 Hz on: 6 again
    assert thin.mobility[:, 0] == pytest.approx((y[:, :6] * weight).sum(axis=1) / weight.sum(axis=1))
    assert thin.sigma[:, 0] == pytest.approx(weight.sum(axis=1) ** -0.5)
    assert thin.half_width[0] == pytest.approx(np.std(FREQ[:6]))
    assert thin.alpha == 3.0
    assert FitData(FREQ, y, sigma).thinned(900.0).freq.tolist() == FREQ.tolist()


def test_muted_and_cut_bins() -> None:
    data = FitData(FREQ, np.ones((1, 741), complex), np.ones((1, 741)), 2.0, np.arange(741.0))
    muted = data.without([100.0, 200.5])
    assert FREQ[muted.sigma[0] > 1].tolist() == [99.0, 100.0, 101.0, 199.0, 200.0, 201.0, 202.0]
    assert muted.sigma.max() == 1e4
    cut = data.cut(10, 13, np.full((1, 3), 0.25))
    assert (cut.freq.tolist(), cut.mobility.tolist(), cut.alpha) == ([70.0, 71.0, 72.0], [[0.75] * 3], 2.0)
    assert cut.half_width.tolist() == [10.0, 11.0, 12.0]
    assert data.step == 1.0
    assert data.s[0] == 2.0 + 1j * TAU * 60


@pytest.mark.parametrize("structural", [False, True])
def test_columns_are_resonances_with_their_slopes(structural) -> None:
    poles, step = Poles.at([100.0, 300.0], [20.0, 40.0]), 1e-6
    data = FitData(FREQ, np.zeros((1, 741), complex), np.ones((1, 741)), 5.0)
    problem = Projection(data, Shape((0,), 1, True, True, True, structural))
    columns, slopes = problem.columns(poles)
    s, w = 5.0 + 1j * TAU * FREQ, TAU * np.array([[100.0], [300.0]])
    loss = 1j * w * w / [[20.0], [40.0]] if structural else w / [[20.0], [40.0]] * s
    h = s / (s * s + loss + w * w)
    np.testing.assert_allclose(columns, np.vstack([h, w / s * h]), rtol=1e-10)
    for t, moved in enumerate(
        (Poles(poles.log_freq + step, poles.log_zeta), Poles(poles.log_freq, poles.log_zeta + step))
    ):
        change = (problem.columns(moved)[0] - columns) / step
        np.testing.assert_allclose(np.vstack([pair[t] for pair in slopes]), change, atol=1e-4 * np.abs(change).max())
    residues = np.array([[1.0, 2.0, 0.3, 0.0, 5.0, 7.0]])
    scale = TAU * np.sqrt(60.0 * 800.0)
    np.testing.assert_allclose(
        problem.model(poles, residues)[0], residues[0, :4] @ columns + 5 * scale / s + 7 * s / scale
    )
    two = Projection(replace(data, half_width=np.full(741, 2.0)), Shape((0,), 1, False, False, False, structural))
    mean = np.zeros((2, 741), complex)
    for off in (2.0, -2.0):
        moved = s + 1j * TAU * off
        loss = 1j * w * w / [[20.0], [40.0]] if structural else w / [[20.0], [40.0]] * moved
        mean = mean + moved / (moved * moved + loss + w * w) / 2
    np.testing.assert_allclose(two.columns(poles)[0], mean, rtol=1e-10)


def test_a_solution_has_the_cost_and_the_gains_of_its_residues() -> None:
    """Least squares by NumPy; chi2 is the rise of the cost if one column is left out."""
    rng = np.random.default_rng(2)
    poles = Poles.at([100.0, 110.0, 300.0], [20.0, 30.0, 40.0])
    sigma = rng.uniform(0.5, 1.5, (2, 741)) * 1e-4
    y = np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 0.5]]) @ resonances(FREQ, [100.0, 110.0, 300.0], [20.0, 30.0, 40.0])
    y = y + sigma * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)) / np.sqrt(2)
    problem = Projection(FitData(FREQ, y, sigma), REAL)
    solution, cost = problem.solve(poles, slopes=True), 0.0
    columns = problem.columns(poles)[0]

    def squares(p, kept):
        a = (columns[kept] * np.sqrt(2) / sigma[p]).T
        b = y[p] * np.sqrt(2) / sigma[p]
        a, b = np.concatenate([a.real, a.imag]), np.concatenate([b.real, b.imag])
        x = np.linalg.lstsq(a, b, rcond=None)[0]
        return x, float(np.sum((b - a @ x) ** 2))

    for p in range(2):
        x, least = squares(p, [0, 1, 2])
        cost += least
        assert solution.residues[p] == pytest.approx(x, rel=1e-6)
        for i in range(3):
            assert solution.chi2[p, i] == pytest.approx(
                squares(p, [j for j in range(3) if j != i])[1] - least, rel=1e-5
            )
    assert solution.cost == pytest.approx(cost)
    assert problem.size == 4 * 741
    assert problem.price == pytest.approx(4 * np.log(problem.size))
    assert Projection(problem.data, Shape((0,), 5)).price == pytest.approx(12 * np.log(problem.size))


def test_signs_of_residues_at_driving_points() -> None:
    residues = np.array([[1.0, -1.0, -1.0, 0.0, 2.0], [5.0, -3.0, 2.0, -1.0, -2.0]])
    chi2 = np.array([[100.0, 9.1, 8.9, 100.0, 50.0], [100.0, 100.0, 100.0, 1.0, 8.9]])
    assert search._never_positive(residues, chi2, (0,)).tolist() == [False, True, True, True, False]
    assert search._never_positive(residues, chi2, (0, 1)).tolist() == [False, True, False, True, False]
    assert not search._never_positive(residues, chi2, ()).any()
    assert search._put(np.array([0.26, -0.8]), np.array([0.5, 0.5])).tolist() == [0.5, -1.0]


def test_a_price_is_that_of_the_misfit_around_a_mode() -> None:
    """Bins within two bandwidths and five steps; a misfit of 4 per number costs four times as much."""
    poles = Poles.at([200.0, 600.0], [40.0, 60.0])
    data = FitData(FREQ, np.zeros((1, 741), complex), np.ones((1, 741)))
    assert search._reaches(data, poles).tolist() == pytest.approx([15.0, 25.0])
    problem = Projection(data, REAL)
    left = np.where(FREQ < 400, 2.0, 0.5)[None] + 0j
    noisy = Projection(replace(data, mobility=left), REAL)
    none = LinearFit(0.0, np.zeros((1, 2)), np.zeros((1, 2)))
    assert search.prices(noisy, poles, none) == pytest.approx([4 * problem.price, problem.price])
    step = np.where(FREQ < 210, 3.0, 0.0)[None] + 0j  # 24 of the 30 bins around 200.5 Hz
    found = search.prices(Projection(replace(data, mobility=step), REAL), Poles.at([200.5, 600.0], [40.0, 60.0]), none)
    assert found == pytest.approx([9 * 24 / 30 * problem.price, problem.price])


def test_modes_nobody_would_see_are_told() -> None:
    """A mode of a millionth of another's residue; one that is wanted is left."""
    data = FitData(
        FREQ, np.array([1.0, 1e-6]) @ resonances(FREQ, [200.0, 600.0], [40.0, 60.0])[None], np.full((1, 741), 1e-9)
    )
    problem, poles = Projection(data, REAL), Poles.at([200.0, 600.0], [40.0, 60.0])
    assert search.inaudible(problem, poles, np.zeros(0)).tolist() == [1]
    assert search.inaudible(problem, poles, np.array([605.0])).tolist() == []
    assert search.inaudible(problem, poles, np.array([300.0, 605.0])).tolist() == []
    assert search.inaudible(problem, poles, np.array([640.0])).tolist() == [1]
    assert search.inaudible(problem, poles[:1], np.zeros(0)).tolist() == []
    assert search._decibels(np.array([2.0, 0.1]), np.array([20j, -0.001])) == pytest.approx([20.0, -40.0])


def test_lines_of_the_mains_are_muted_and_named() -> None:
    rng, freq = np.random.default_rng(3), np.arange(100.0, 500.0)
    y = resonances(freq, [200.0], [40.0])
    y = y + 1e-4 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    y[0, [50, 250]] += 0.2
    sigma = np.full(y.shape, 1.4e-4)
    modes = identify(freq, y, Shape((0,), 1, True, False, False), damping="viscous", sigma=sigma)
    assert sorted(modes.mains) == pytest.approx([150.0, 350.0], abs=0.1)
    assert modes.poles.freq == pytest.approx([200.0], rel=1e-3)
    assert modes.misfit == pytest.approx(1.0, abs=0.1)


def test_lines_of_few_bins_are_no_modes() -> None:
    """A line in one bin is worth nothing beside its four best; a sharp mode is."""
    clean = resonances(FREQ, [200.3], [400.0])[0]
    line = clean.copy()
    line[440] += 0.05
    for y, at, told in ((line, 500.0, [1]), (clean + resonances(FREQ, [500.2], [900.0])[0], 500.2, [])):
        problem = Projection(FitData(FREQ, y[None], np.full((1, 741), 1e-6)), Shape((0,), 1, False, False, False))
        assert search.mains(problem, Poles.at([200.3, at], [400.0, 900.0])).tolist() == told
    assert search.mains(problem, Poles.at([200.3, 900.0], [400.0, 2000.0])).tolist() == []
    # in noise, whatever the unit
    rng = np.random.default_rng(4)
    rough = line + 1e-3 * (rng.standard_normal(741) + 1j * rng.standard_normal(741))
    for unit in (1e-6, 1.0, 1e6):
        problem = Projection(FitData(FREQ, unit * rough[None], np.full((1, 741), unit * 1.4e-3)), problem.shape)
        assert search.mains(problem, Poles.at([200.3, 500.0], [400.0, 900.0])).tolist() == [1]


@pytest.mark.parametrize(("quality", "reach"), [(100.0, 0.03), (10.0, 0.05)])
def test_a_frequency_names_modes_within_half_of_their_bandwidth(quality, reach) -> None:
    assert _reach(Poles.at([100.0], [quality]), 0) == pytest.approx(reach)


def test_collinearity_is_that_of_pappa() -> None:
    """1 of residues in phase, whatever the phase; 0 of a circle; worked out for (1, j/2)."""
    residues = np.array([[1.0, 1.0, 1.0, 0.0, 1.0, 0.0], [2.0, 0.0, 0.0, 0.0, 2.0, 0.5]])
    residues[:, [1, 4]] = [[1.0, 0.0], [0.0, 1.0]]
    residues[:, [0, 3]] = [[1.0, 1.0], [2.0, 2.0]]
    poles = Poles.at([100.0, 200.0, 300.0], [9.0] * 3)
    modes = Modes(None, poles, None, (None, poles, LinearFit(0.0, residues, residues)), [])
    assert modes.complexity == pytest.approx([1.0, 0.0, (0.75 / 1.25) ** 2])


# -- search again ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bent", [False, True])
def test_neighbouring_modes_are_moved_on_the_bins_around_them_less_the_others(bent) -> None:
    """Bins within four bandwidths; residues of the others, turned ones too, are taken off."""
    shape = Shape((0,), 1, bent, False, False)
    poles = Poles.at([100.0, 300.0, 500.0], [20.0, 30.0, 50.0])
    rows = resonances(FREQ, [100.0, 300.0, 500.0], [20.0, 30.0, 50.0])
    turned = TAU * np.array([[100.0], [300.0], [500.0]]) / (2j * np.pi * FREQ) * rows
    y = np.array([1.0, 2.0, 3.0]) @ rows + bent * (np.array([0.2, -0.3, 0.4]) @ turned)
    problem = Projection(FitData(FREQ, y[None], np.full((1, 741), 1e-6)), shape)
    part = search._around(problem, poles, problem.solve(poles).residues, np.array([1]))
    assert part.data.freq.tolist() == list(range(260, 340))
    own = 2.0 * rows[1] - bent * 0.3 * turned[1]
    assert part.data.mobility[0] == pytest.approx(own[200:280], rel=1e-5)
    assert part.shape == shape
    coarse = Projection(FitData(FREQ[::60], y[None, ::60], np.full((1, 13), 1e-6)), shape)
    assert search._around(coarse, poles, problem.solve(poles).residues, np.array([1])) is None


def test_modes_that_create_energy_or_gain_nothing_are_taken_away() -> None:
    y = resonances(FREQ, [200.0], [40.0])[0] - 0.5 * resonances(FREQ, [500.0], [50.0])[0]
    problem = Projection(FitData(FREQ, y[None], np.full((1, 741), 1e-5)), Shape((0,), 1, False, False, False))
    poles = Poles.at([200.0, 500.0], [40.0, 50.0])
    assert search.without_negative(problem, poles).freq == pytest.approx([200.0])
    assert search.pruned(problem, poles)[0].freq == pytest.approx([200.0], rel=1e-3)
    assert len(search.without_negative(problem, poles[1:])) == 1
    assert search.pruned(problem, poles[1:])[0].freq.tolist() == poles[1:].freq.tolist()  # the last one is left
    wrong = -resonances(FREQ, [200.0, 500.0], [40.0, 50.0]).sum(axis=0, keepdims=True)
    with pytest.raises(search.NothingFoundError, match="no mode that is passive"):
        search.pruned(Projection(replace(problem.data, mobility=wrong), problem.shape), poles)
    two = Projection(replace(problem.data, mobility=resonances(FREQ, [200.0], [40.0])), problem.shape)
    apart = Poles.at([199.0, 201.0], [40.0, 40.0])
    joined, solution = search.joined(two, apart)
    assert (joined.freq, joined.quality) == (pytest.approx([200.0], rel=1e-5), pytest.approx([40.0], rel=1e-3))
    assert solution.residues[0] == pytest.approx([1.0], rel=1e-3)
    both = Poles.at([200.0, 300.0], [40.0, 40.0])
    assert search.joined(two, both)[0] is both


# -- grid --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("enough", [1e-3, 1e-5])
def test_poles_lie_on_a_grid_that_costs_a_hundredth_of_what_ends_a_descent(enough) -> None:
    rng = np.random.default_rng(6)
    at, quality = [100.0, 250.0, 400.0], [20.0, 30.0, 40.0]
    clean = np.array([[1.0, 2.0, 0.5]]) @ resonances(FREQ, at, quality)
    y = clean + 1e-4 * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    problem = Projection(FitData(FREQ, y, np.full(y.shape, 1e-4)), Shape((0,), 1, False, False, False))
    start = Poles.at(np.array(at) * 1.003, np.array(quality) * 1.1)
    before = problem.solve(start, slopes=True)
    poles, there = search.descend(problem, start, 1, enough)
    assert there.cost < 0.5 * before.cost
    step = 2.0 ** np.floor(np.log2(np.sqrt(1e-2 * enough * before.cost / np.diag(before.normal))))
    steps = np.concatenate([poles.log_freq, poles.log_zeta]) / step
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.any(np.round(steps) % 2 == 1)
