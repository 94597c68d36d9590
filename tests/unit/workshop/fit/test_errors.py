"""Errors that a fit reports, against those of many realisations of noise; parts of the search, one by one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fit_scenes import TAU, random_body

from tonewood.workshop.fit import noise
from tonewood.workshop.fit.body import passive_body
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape
from tonewood.workshop.fit.search import MatchedFilters, _never_positive, descend, joined

REAL = Shape((0,), 2, False, False, False)


def test_reported_errors_of_modes_are_what_the_errors_are():
    """Cents, Q and shape at the driving point of 40 fits: r.m.s. re their deviations, within the spread."""
    truth, freq = random_body(2, seed=2, high=700.0), np.arange(60.0, 800.5)
    ratios = []
    for seed in range(40):
        mobility, sigma = truth.noisy(freq, 0.01, seed)
        problem = Projection(FitData(freq, mobility, sigma), REAL)
        poles, found = descend(problem, Poles.at(truth.freq, truth.quality), 30, 1e-12)
        body = passive_body(
            SimpleNamespace(problem=problem, poles=poles, solution=found), (("a", "a"), ("b", "a"))
        )  # fmt: skip
        errors = (
            1200 * np.log2(body.freq / truth.freq) / body.cents,
            (body.quality / truth.quality - 1) / body.quality_error,
            (body.shapes[:, 0] / np.sqrt(truth.residues[0]) - 1) / body.shape_error,
        )
        ratios.append(errors)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(ratios), axis=(0, 2))), 1.0, atol=0.2)


@pytest.mark.parametrize("n_hits", [3, 10])
def test_noise_of_a_coherence_is_that_of_its_hits(n_hits):
    """H1 of random forces and white noise: its errors in 4000 bins."""
    rng, n_bins, share = np.random.default_rng(5), 4000, 0.3

    def drawn():
        return rng.normal(size=(n_hits, n_bins)) + 1j * rng.normal(size=(n_hits, n_bins))

    force, true = drawn(), 2.0 - 1.0j
    motion = true * force + share * drawn()
    cross, power = np.sum(force.conj() * motion, axis=0), np.sum(np.abs(force) ** 2, axis=0)
    response = cross / power
    coherence = np.abs(cross) ** 2 / (power * np.sum(np.abs(motion) ** 2, axis=0))
    sigma = noise.of_coherence(response[None], coherence[None], n_hits)
    # of few hits the errors of forces at random have long tails: medians
    ratio = np.median(np.abs(response - true)) / (np.median(sigma) * np.sqrt(np.log(2)))
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_noise_alone_is_found_as_it_is_and_of_neighbours_beside_a_slope():
    rng = np.random.default_rng(1)
    error = 0.3 / np.sqrt(2) * (rng.normal(size=(2, 6000)) + 1j * rng.normal(size=(2, 6000)))
    for level in (noise.of_misfit(error), noise.of_neighbours(error + np.linspace(0, 50, 6000))):
        assert np.mean(level) == pytest.approx(0.3, rel=0.03)


@pytest.mark.parametrize("alpha", [0.0, 2.0, 5.0])
def test_errors_of_windowed_responses_stay_within_the_bound_on_tied_bins(alpha):
    """White noise of a record of one second, windowed by exp(-alpha t): the errors of poles re their deviations."""
    truth, rng, ratios = random_body(3, seed=2, high=700.0), np.random.default_rng(0), []
    t = np.arange(2048) / 2048
    window = np.exp(-alpha * t)
    freq = np.arange(60.0, 801.0)
    clean = truth.mobility(freq, alpha)
    size = 0.01 * np.sqrt(np.mean(np.abs(clean) ** 2, axis=1, keepdims=True))
    for _ in range(15):
        error = np.fft.rfft(rng.normal(size=(2, t.size)) * window)[:, 60:801] / np.sqrt(np.sum(window**2))
        problem = Projection(FitData(freq, clean + size * error, size * np.ones(freq.size), alpha), REAL)
        poles, _ = descend(problem, Poles.at(truth.freq, truth.quality), 10, 1e-9)
        by_freq, by_zeta, _ = problem.deviations(poles)
        ratios.append((poles.log_freq - np.log(TAU * truth.freq)) / by_freq)
        ratios.append((poles.log_zeta - np.log(0.5 / truth.quality)) / by_zeta)
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) / noise.tied(alpha, 1.0) < 1.1


def test_a_pair_is_not_joined_for_less_than_its_price(monkeypatch):
    """A mode that gains a little more than its price is kept, one that gains a little less is not."""
    freq = np.arange(150.0, 260.0, 0.25)
    truth = random_body(2, seed=1)
    truth.freq[:], truth.quality[:], truth.residues[:] = (200.0, 201.5), 50.0, [[1.0, 1.0], [1.0, 0.9]]
    mobility, sigma = truth.noisy(freq, 0.003, seed=3)
    problem = Projection(FitData(freq, mobility, sigma), REAL)
    poles, two = descend(problem, Poles.at(truth.freq, truth.quality), 20, 1e-9)
    _, fewer = descend(problem, Poles.at([200.7], [49.0]), 20, 1e-9)
    gain = fewer.cost - two.cost
    assert gain > 100
    for price, count in ((0.97 * gain, 2), (1.03 * gain, 1)):
        monkeypatch.setattr(Projection, "price", price)
        assert len(joined(problem, poles)[0]) == count


@pytest.mark.parametrize(("shape", "numbers"), [(REAL, 4), (Shape((0,), 2), 6), (Shape((0,), 1, False), 3)])
def test_a_mode_is_worth_its_numbers_in_schwarz_criterion(shape, numbers):
    """k ln n: frequency, damping and a residue for each point, or two; n counts real and imaginary parts."""
    freq = np.arange(100.0, 151.0)
    data = FitData(freq, np.ones((2, freq.size), complex), np.ones((2, freq.size)))
    assert Projection(data, shape).price == pytest.approx(numbers * np.log(2 * 2 * 51), rel=1e-12)


def test_a_residue_is_negative_beyond_doubt_from_three_deviations_on():
    """At one driving point that suffices; a mode that is positive at none is refused in any case."""
    residues = np.array([[-1.0, -1.0, 1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -0.1, 1.0], [-9.0, -9.0, -9.0, 9.0, -9.0]])
    chi2 = np.array([[9.1, 8.9, 100.0, 0.1, 50.0], [100.0, 100.0, 4.0, 0.1, 50.0], [99.0] * 5])
    assert _never_positive(residues, chi2, (0, 1)).tolist() == [True, False, False, True, False]
    assert not _never_positive(residues, chi2, ()).any()


def test_a_matched_filter_sees_the_whole_gain_of_a_mode():
    """Of one mode without noise, on a grid that has it: the gain is the whole chi-squared, there and nowhere more."""
    freq = np.arange(100.0, 1000.0)
    problem = Projection(FitData(freq, np.zeros((1, freq.size), complex), np.ones((1, freq.size))), Shape((0,), 1))
    filters = MatchedFilters(problem)
    at, quality = filters._grid
    for k in np.flatnonzero(quality == 25)[[5, 40]]:
        s = 1j * TAU * freq
        y = (s / (s * s + TAU * at[k] / quality[k] * s + (TAU * at[k]) ** 2))[None]
        y = y * (40.0 / np.abs(y).max())
        found = filters.candidates(y, 1)
        assert found.freq[0] == pytest.approx(at[k], rel=1e-9)
        assert found.quality[0] == pytest.approx(25.0, rel=1e-9)


def test_modes_beyond_the_band_stand_for_nothing_that_noise_could_be():
    """Neither a mass line nor a compliance where residues of these columns are not three deviations above zero."""
    truth, freq = random_body(2, seed=2, high=700.0), np.arange(60.0, 800.5)
    pairs = (("a", "a"), ("b", "a"))
    for seed in range(8):
        mobility, sigma = truth.noisy(freq, 0.01, seed)
        problem = Projection(FitData(freq, mobility, sigma), Shape((0,), 2, complex=False))
        poles, found = descend(problem, Poles.at(truth.freq, truth.quality), 10, 1e-9)
        modes: Any = SimpleNamespace(problem=problem, poles=poles, solution=found)
        body = passive_body(modes, pairs)
        clear = found.residues[0, 2:] > 3 * problem.deviations(poles)[2][0, 2:]
        assert np.count_nonzero(~body.measured) == clear[0]
        assert body.compliance.any() == clear[1]
    s = 2j * np.pi * freq
    modes.problem = problem = Projection(FitData(freq, mobility + 4.0 / s + 2e-7 * s, sigma), problem.shape)
    modes.poles, modes.solution = descend(problem, poles, 10, 1e-9)
    body = passive_body(modes, pairs)
    assert np.count_nonzero(~body.measured) == 1
    assert body.compliance[0, 0] == pytest.approx(2e-7, rel=0.2)
    lower = body.shapes[0, 0] ** 2
    assert lower == pytest.approx(4.0, rel=0.2)


def test_a_descent_on_exact_data_ends_where_the_cost_is_rounding():
    """A cost of exactly 0, and then one of either sign below it: no step is taken for that."""

    def solve(poles, slopes=False):
        cost = 0.0 if poles.freq[0] == pytest.approx(15.0, rel=1e-12) else -1e-20
        return SimpleNamespace(cost=cost, normal=np.eye(2), gradient=np.ones(2))

    data = SimpleNamespace(freq=np.array([10.0, 20.0]), step=1.0)
    problem: Any = SimpleNamespace(data=data, solve=solve, size=4)
    assert descend(problem, Poles.at([15.0], [10.0]), 9, 1e-6)[1].cost == 0.0
