"""Parts of a fit by themselves: figures of modes, poles, bins, noise, responses and hits, worked out in the test."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from fit_scenes import TAU, Truth, random_body

from tonewood.errors import TonewoodError
from tonewood.workshop.fit import arrays, drift, figure, files, folder, noise, radiation, search, texts, universal
from tonewood.workshop.fit import fit as whole
from tonewood.workshop.fit.body import _shapes, passive_body
from tonewood.workshop.fit.drift import Drift
from tonewood.workshop.fit.fit import Fit, fit_responses
from tonewood.workshop.fit.hits import is_double
from tonewood.workshop.fit.identify import Modes, _reach, identify
from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape
from tonewood.workshop.fit.radiation import FittedRadiation
from tonewood.workshop.fit.responses import Responses, to_mobility
from tonewood.workshop.fit.stability import ORDERS, stability

FREQ = np.arange(60.0, 801.0)
REAL = Shape((0,), 2, False, False, False)


def resonances(freq, at, quality, alpha=0.0):
    s, w = alpha + 1j * TAU * np.asarray(freq), TAU * np.asarray(at, float)[:, None]
    return s / (s * s + w / np.asarray(quality, float)[:, None] * s + w * w)


# poles and bins


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


# the search


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


# noise


def test_noise_of_windows_runs_and_spikes() -> None:
    x = np.array([0.5, 3.0])
    assert [noise.tied(a, 2.0) for a in 2 * x] == pytest.approx(np.sqrt(2 * x / (1 - np.exp(-2 * x))))
    assert noise.tied(0.0, 1.0) == 1.0
    assert noise._runs(np.array([True, True, False, True])).tolist() == [[0, 2], [3, 4]]
    rng = np.random.default_rng(3)
    row = 1e-3 * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    y = np.array([row, row[::-1]])
    assert not noise.outliers(y).any()
    y[0, 100] += 0.5
    y[1, 200] -= 0.5j
    assert [np.flatnonzero(out).tolist() for out in noise.outliers(y)] == [[100], [200]]
    sharp = y[1:] * 0 + row + 0.01 * resonances(np.arange(400.0) + 100, [300.0], [60.0]) * 1e3
    assert not noise.outliers(sharp).any()
    assert not noise.outliers(y[:, :9]).any()
    with pytest.raises(ValueError, match="9 bins tell no noise; 10 or more do"):
        noise.of_neighbours(y[:, :9])
    fourth = np.convolve(np.eye(1, 9, 4)[0] * 3, noise._FOURTH)[2:-2]
    assert noise._spikes(fourth[2:7] * 10 + 0j, 50) == [54]


@pytest.mark.parametrize(("bins", "size"), [((150, 151), 40.0), ((150, 151), -30.0), ((150, 152), 40.0)])
def test_spikes_beside_each_other_are_both_found(bins: tuple[int, ...], size: float) -> None:
    """Those that explain the differences best, not others that explain them nearly."""
    rng = np.random.default_rng(4)
    y = (rng.standard_normal((1, 400)) + 1j * rng.standard_normal((1, 400))) / np.sqrt(2)
    y[0, list(bins)] += size
    assert np.flatnonzero(noise.outliers(y)[0]).tolist() == list(bins)


def test_noise_of_a_coherence_has_ends() -> None:
    """A coherence of 1 counts as 1 - 1e-9, one of 0 as 1e-4; two hits have no bias that could be taken out."""
    response = np.full((1, 80), 3.0 - 4.0j)
    for coherence, g in ((1.0, 1 - 1e-9), (0.0, 1e-4), (0.6, 0.6)):
        for n, bias in ((5, 5 / 4), (2, 1.0)):
            sigma = noise.of_coherence(response, np.full((1, 80), coherence), n)
            assert sigma == pytest.approx(5.0 * np.sqrt(bias * (1 - g) / (n * g)), rel=1e-6)


def test_two_parts_are_found_from_medians() -> None:
    """Powers that are exactly a + r |Y|^2; a constant level has no relative part."""
    size = np.random.default_rng(4).uniform(0.1, 9.0, (2, 600)) ** 2
    power = np.array([[2.0], [0.0]]) + np.array([[0.3], [0.01]]) * size
    assert noise._two_parts(power, size) == pytest.approx(power, rel=0.02)
    assert noise.of_misfit(np.full((1, 400), 2.0 + 0j)) == pytest.approx(np.full((1, 400), 2 / np.sqrt(np.log(2))))


# responses


def responses(truth, freq=FREQ, **more):
    return Responses(freq, truth.mobility(freq), (("a", "a"), ("b", "a")), **more)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth(
        np.array([150.0, 320.0, 560.0]), np.array([30.0, 50.0, 60.0]), np.array([[1.0, 2.0, 4.0], [-0.5, 1.0, 2.0]])
    )


def test_bands_hold_both_ends_and_no_zero(truth) -> None:
    freq = np.concatenate([[0.005], np.arange(1.0, 101.0)])
    y = truth.mobility(freq)
    y[0, 50] = np.nan
    r = Responses(freq, y, (("a", "a"), ("b", "a")), coherence=np.ones((2, 101)), pressure={("m", "a"): y[1]})
    assert r.band(None, None).freq.tolist() == [*range(1, 50), *range(51, 101)]
    part = r.band(10.0, 60.0)
    assert (part.freq[0], part.freq[-1], part.freq.size) == (10.0, 60.0, 50)
    assert part.coherence.shape == (2, 50)
    assert part.pressure["m", "a"] == pytest.approx(truth.mobility(part.freq)[1])
    assert r.band(69.0, 100.0).freq.size == 32
    with pytest.raises(TonewoodError, match="31 bins lie between 70 and 100 Hz; 32 or more are needed"):
        r.band(70.0, None)


def test_names_references_and_exchange(truth) -> None:
    y = np.arange(4.0)[:, None] * np.ones(5) + 0j
    pairs = (("a", "a"), ("a", "b"), ("c", "b"), ("b", "d"))
    r = Responses(np.arange(5.0), y, pairs, pressure={("m", "b"): y[0], ("m", "a"): y[1]})
    assert (r.points, r.references, r.driving, r.microphones) == (("a", "b", "c", "d"), ("a", "b", "d"), (0,), ("m",))
    assert r.reciprocal().pairs == (("a", "a"), ("b", "a"), ("c", "b"), ("b", "d"))
    kept, others = r.reciprocal().of_driven()
    assert (kept.pairs, others) == ((("a", "a"), ("b", "a")), ("b", "d"))
    assert kept.mobility[:, 0].tolist() == [0.0, 1.0]
    assert list(kept.pressure) == [("m", "a")]
    about = Responses(r.freq, y[:2], (("s", "a"), ("s", "b")))
    assert about.reciprocal().pairs == (("a", "s"), ("b", "s"))
    assert about.of_driven() == (about, ())
    new = r.renamed({"a": "x", "m": "mic"})
    assert new.pairs == (("x", "x"), ("x", "b"), ("c", "b"), ("b", "d"))
    assert list(new.pressure) == [("mic", "b"), ("mic", "x")]
    with pytest.raises(TonewoodError, match="there is no point 'q'; there are a, b, c, d, m"):
        r.renamed({"q": "x"})
    with pytest.raises(TonewoodError, match="two points would be called 'b'"):
        r.renamed({"a": "b"})


def test_what_no_body_has_is_told(truth) -> None:
    r = responses(truth)
    assert r.checked() is r
    assert r.no_body() is None
    assert replace(r, pairs=(("b", "a"), ("c", "a"))).no_body().startswith("no driving point: the sensor did not")
    assert "'a' has a negative real part over 100%" in replace(r, mobility=-r.mobility).no_body()
    half = r.mobility * np.where(FREQ < 60 + 0.07 * 741, -1, 1)  # 7 % of the band
    assert "over 7%" in replace(r, mobility=half).no_body()
    assert replace(r, mobility=r.mobility * np.where(FREQ < 60 + 0.04 * 741, -1, 1)).no_body() is None
    size = float(np.median(np.abs(r.mobility[0])))
    kg = 1 / (TAU * np.sqrt(60.0 * 800.0) * size)
    for mass, told in ((1.1e-5, False), (0.9e-5, True), (0.9e4, False), (1.1e4, True)):
        assert (replace(r, mobility=r.mobility * kg / mass).no_body() is not None) == told
    with pytest.raises(TonewoodError, match="rings before it is struck"):
        replace(r, mobility=r.mobility.conj()).checked()
    with pytest.raises(TonewoodError, match="do not rise"):
        replace(r, freq=r.freq[::-1]).checked()
    zero = r.mobility.copy()
    zero[1, 31:] = 0
    with pytest.raises(TonewoodError, match="b:a is 0 in nearly all bins"):
        replace(r, mobility=zero).checked()
    zero[1, 31] = 1e-3
    with pytest.raises(TonewoodError, match="rings"):
        replace(r, mobility=zero.conj()).checked()


def test_incoherent_parts_and_outliers(truth) -> None:
    coherence = np.ones((2, 741))
    coherence[0, 100:200] = 0.4
    coherence[0, 400:410] = 0.1  # shorter than half of the running median
    r = responses(truth, coherence=coherence)
    assert r.incoherent(0) == [(160.0, 259.0)]
    assert r.incoherent(1) == []
    assert responses(truth).incoherent(0) == []
    spiked = r.mobility.copy()
    spiked[1, 300] += 1.0
    kept, out = replace(r, mobility=spiked).without_outliers()
    assert out == (360.0,)
    assert (kept.freq.size, kept.mobility.shape, kept.coherence.shape) == (740, (2, 740), (2, 740))
    uneven = np.array([*FREQ[:-1], 800.5])
    assert replace(r, freq=uneven, mobility=spiked).without_outliers()[1] == ()


@pytest.mark.parametrize(("form", "power"), [("receptance", 1), ("mobility", 0), ("accelerance", -1)])
def test_forms_are_powers_of_s(form, power) -> None:
    freq, y = np.array([10.0, 20.0]), np.array([1.0 + 1j, 2.0])
    assert to_mobility(y, freq, form, 3.0) == pytest.approx(y * (3.0 + 1j * TAU * freq) ** power)
    if power < 0:
        assert to_mobility(y, np.array([0.0, 1.0]), form)[0] == 0


# hits, drift, stability, radiation


def test_a_second_pulse_is_a_double_hit() -> None:
    fs, force = 10000.0, 1e-4 * np.random.default_rng(1).standard_normal(4000)
    force[1000:1010] += np.hanning(10)
    assert not is_double(force, fs)
    for at, size, double in (
        (2000, 0.05, True),
        (2000, 0.02, False),
        (1024, 0.05, False),
        (1036, 0.05, True),
        (500, 0.05, True),
    ):
        again = force.copy()
        again[at] += size
        assert is_double(again, fs) is double
    noisy = force + 0.01 * np.random.default_rng(2).standard_normal(4000)
    assert not is_double(noisy, fs)
    assert not is_double(np.ones(3), fs)


def test_lines_of_a_drift_have_its_figures() -> None:
    zero, common, peak = Drift((0.012, 0.0), (0.001, -0.002), ((250.0, 0.004, 0.5),)).lines(("force", "a"))
    assert "of force (1.2 % of its peak)" in zero
    assert "drift by 0.3 % from hit to hit (+0.1, -0.2 %)" in common
    assert peak.startswith("the peak at 250 Hz drifts by 0.4 % from hit to hit, 50% of its bandwidth")
    assert Drift((0.0, 0.0), (0.0,)).lines(("force", "a")) == ()


def test_poles_of_a_body_are_stable_at_every_order(truth) -> None:
    chart = stability(FREQ, truth.mobility(FREQ))
    assert set(chart.order) <= set(ORDERS)
    for f, q in zip(truth.freq, truth.quality, strict=True):
        near = (np.abs(chart.freq / f - 1) < 1e-3) & (np.abs(chart.quality / q - 1) < 0.05)
        assert set(chart.order[near]) >= set(ORDERS[2:])
        assert chart.stable[near & (chart.order > 12)].all()
    assert not chart.stable[chart.order == 4].any()
    assert chart.freq.min() >= 60
    assert chart.freq.max() <= 800


def test_a_bank_of_microphones_is_written_as_its_residues() -> None:
    pole = np.array([-10.0 + 600j])
    bank = FittedRadiation(
        ("l", "r"), pole, 20.0, np.array([[1 + 2j], [3.0]]), np.array([[0.5j], [0.0]]), np.zeros((0, 0))
    )
    _, names, row = bank.table().splitlines()
    assert names == "f_Hz,Q,l_re,l_im,l_moment_re,l_moment_im,r_re,r_im,r_moment_re,r_moment_im"
    assert [float(x) for x in row.split(",")] == pytest.approx([600 / TAU, 30.0, 1, 2, 0, 0.5, 3, 0, 0, 0])
    s = 4.0 + 1j * TAU * 90.0
    cut = s * s / ((s + 0.8 * TAU * 20) * (s + 1.25 * TAU * 20))
    wanted = [cut * (r / (s - pole[0]) + np.conj(r) / (s - np.conj(pole[0]))) for r in (1 + 2j - 0.25j, 3.0)]
    assert bank.pressure(np.array([90.0]), -0.5, 4.0)[:, 0] == pytest.approx(wanted)


# the body and its figures


def exact(truth, shape=REAL, pairs=(("a", "a"), ("b", "a")), beside=0.0, sigma=1e-6):
    """Modes of a problem of known residues."""
    y = truth.mobility(FREQ) + beside
    problem = Projection(FitData(FREQ, y, np.full(y.shape, sigma)), shape)
    poles = Poles.at(truth.freq, truth.quality)
    return SimpleNamespace(problem=problem, poles=poles, solution=problem.solve(poles)), pairs


def test_a_body_has_the_shapes_of_its_residues(truth) -> None:
    body = passive_body(*exact(truth))
    assert body.points == ("a", "b")
    assert body.freq == pytest.approx(truth.freq)
    assert body.quality == pytest.approx(truth.quality)
    assert body.shapes == pytest.approx((truth.residues / np.sqrt(truth.residues[0])).T, rel=1e-5)
    assert body.measured.all()
    assert not body.compliance.any()
    assert [line.split(":")[0] for line in body.dropped] == [
        "mass line of modes below the band",
        "compliance of modes above the band",
    ]
    assert body.mobility(FREQ, (("b", "a"), ("b", "b")))[0] == pytest.approx(truth.mobility(FREQ)[1], rel=1e-4)
    bb = (truth.residues[1] ** 2 / truth.residues[0]) @ resonances(FREQ, truth.freq, truth.quality, 2.0)
    assert body.mobility(FREQ, (("b", "b"),), 2.0)[0] == pytest.approx(bb, rel=1e-4)
    deviations = exact(truth)[0].problem.deviations(Poles.at(truth.freq, truth.quality))
    assert body.cents == pytest.approx(1200 * deviations[0] / np.log(2))
    assert body.quality_error == pytest.approx(deviations[1])
    assert body.shape_error == pytest.approx(0.5 * deviations[2][0, :3] / truth.residues[0], rel=1e-5)


def test_modes_beyond_the_band_become_a_mass_and_a_compliance(truth) -> None:
    """Residues E of 0.2 and 0.1, C of 0.4 and 0.2 re the middle of the band."""
    scale, s = TAU * np.sqrt(60.0 * 800.0), 1j * TAU * FREQ
    lower, upper = np.array([[4e-3], [2e-3]]), np.array([[8e-3], [4e-3]])
    shape = Shape((0,), 2, False)
    body = passive_body(*exact(truth, shape, beside=lower * scale / s + upper * s / scale, sigma=1e-9))
    assert body.freq == pytest.approx([60.0 / 8, *truth.freq])
    assert body.quality[0] == 5.0
    assert body.shapes[0] == pytest.approx(np.sqrt(scale) * np.array([4e-3, 2e-3]) / np.sqrt(4e-3), rel=1e-3)
    assert body.compliance == pytest.approx(np.array([[8e-3, 4e-3], [4e-3, 2e-3]]) / scale, rel=1e-3)
    assert body.measured.tolist() == [False, True, True, True]
    assert np.isnan(body.cents[0])
    assert body.dropped == ()


def test_several_references_and_modes_that_create_energy() -> None:
    one = Truth(
        np.array([200.0, 500.0]), np.array([40.0, 1.9]), np.array([[4.0, 1.0], [2.0, -1.0], [2.2, -1.0], [1.0, 1.0]])
    )
    pairs = (("a", "a"), ("b", "a"), ("a", "b"), ("b", "b"))
    body = passive_body(*exact(one, Shape((0, 3), 2, False, False, False), pairs, sigma=0.1))
    values, vectors = np.linalg.eigh([[4.0, 2.1], [2.1, 1.0]])
    assert np.abs(body.shapes[0]) == pytest.approx(np.abs(vectors[:, -1]) * np.sqrt(values[-1]), rel=1e-3)
    assert np.abs(body.shapes[1]) == pytest.approx([1.0, 1.0], rel=1e-3)
    assert body.shapes[1].prod() == pytest.approx(-1.0, rel=1e-3)
    assert body.measured.tolist() == [True, False]  # Q below 2
    # of every residue known alike, the driving one is measured once, that of two points twice
    deviations = exact(one, Shape((0, 3), 2, False, False, False), pairs, sigma=0.1)[0].problem.deviations(
        Poles.at(one.freq, one.quality)
    )[2]
    assert body.shape_error[0] == pytest.approx(0.5 * deviations[0, 0] / values[-1], rel=1e-3)
    negative = Truth(np.array([200.0, 500.0]), np.array([40.0, 30.0]), np.array([[4.0, -1.0], [2.0, 1.0]]))
    left = passive_body(*exact(negative))
    assert left.freq == pytest.approx([200.0])
    assert left.dropped[0] == "mode at 500.0 Hz: negative residue at the driving point"


@pytest.mark.parametrize(
    ("weak", "certain", "count"),
    [(0.44, True, 1), (0.46, True, 2), (0.46, False, 2), (0.44, False, 1), (-0.1, True, 1)],
)
def test_further_shapes_stand_out_by_four_and_a_half_deviations(weak, certain, count) -> None:
    """Residues diag(4, weak) known within 0.1; of one reference alone a shape that is not certain needs three."""
    pairs = (("a", "a"), ("b", "a"), ("b", "b"))
    shapes, error = _shapes(np.array([4.0, 0.0, weak]), np.full(3, 0.1), pairs, ("a", "b"), certain=certain)
    assert error == pytest.approx(0.1 / 4)
    assert [np.abs(x).tolist() for x in shapes] == [[2.0, 0.0], [0.0, np.sqrt(abs(weak))]][:count]
    for value, kept in ((0.29, certain), (0.31, True), (-0.1, False)):
        shapes, error = _shapes(np.array([value, 0.3]), np.full(2, 0.1), pairs[:2], ("a", "b"), certain=certain)
        assert len(shapes) == kept
        if kept:
            assert shapes[0] == pytest.approx(np.array([value, 0.3]) / np.sqrt(value))
        assert error == pytest.approx(0.1 / value if kept else np.inf)


@pytest.fixture(scope="module")
def fitted() -> Fit:
    truth = Truth(np.array([150.0, 320.0]), np.array([30.0, 50.0]), np.array([[1.0, 2.0], [-0.5, 1.0]]))
    freq = np.arange(80.0, 481.0)
    y, _ = truth.noisy(freq, 0.003, 1)
    r = Responses(freq, y, (("a", "a"), ("b", "a")), files={"x.csv": "0"}, kept=(4, 5), remarks=("a remark",))
    return fit_responses(r, damping="viscous")


def test_a_fit_without_a_mode_or_with_one_to_drop_that_is_none_is_refused(fitted) -> None:
    r = fitted.responses
    rng = np.random.default_rng(2)
    noise_alone = rng.standard_normal(r.mobility.shape) + 1j * rng.standard_normal(r.mobility.shape)
    with pytest.raises(TonewoodError, match="responses: no mode stands out of the noise: wrong files, band or"):
        fit_responses(replace(r, mobility=noise_alone), damping="viscous")
    turned = fit_responses(replace(r, mobility=-r.mobility), damping="viscous")
    assert (turned.body, len(turned.modes.poles)) == (None, 2)
    assert "mobility of 'a' has a negative real part" in turned.no_body
    problem, poles, solution = turned.modes.bent
    by_freq, by_zeta, _ = problem.deviations(poles)
    rows = turned.rows
    assert [row["sd_cents"] for row in rows] == pytest.approx(1200 * np.log2(np.e) * by_freq)
    assert [row["sd_Q"] for row in rows] == pytest.approx(by_zeta)
    whole_row = problem.model(poles, solution.residues)
    for i, row in enumerate(rows):
        part = solution.residues[:, [i, i + 2]] @ problem.columns(poles)[0][[i, i + 2]]
        change = np.abs(20 * np.log10(np.abs(1 - part / whole_row))).max()
        assert row["without_db"] == pytest.approx(change)
        shape = solution.residues[:, i] - 1j * solution.residues[:, i + 2]
        assert np.array(row["shape"]) @ [1, 1j] == pytest.approx(shape / shape[np.argmax(np.abs(shape))])
        assert (row["mass_kg"], row["sd_shape"], row["interval_90"].get("mass_kg")) == (None, None, None)
    with pytest.raises(TonewoodError, match="--drop: there is no mode at 250 Hz; the nearest is at 320"):
        fit_responses(r, damping="viscous", drop=(250.0,))


def test_a_coherence_is_the_least_noise_of_a_fit(fitted) -> None:
    coherence = np.full(fitted.responses.mobility.shape, 0.9)
    fit = fit_responses(replace(fitted.responses, coherence=coherence, n_hits=4), damping="viscous")
    least = noise.of_coherence(fit.responses.mobility, coherence, 4)
    assert np.all(fit.modes.problem.data.sigma >= 0.999 * least)
    assert np.median(fit.modes.problem.data.sigma / least) < 1.2
    assert np.median(fitted.modes.problem.data.sigma / least) < 0.2


def test_rows_of_a_fit_have_intervals_and_changes(fitted) -> None:
    measured = [row for row in fitted.rows if row["measured"]]
    assert [row["freq_Hz"] for row in measured] == pytest.approx([150.0, 320.0], rel=1e-3)
    assert [row["mass_kg"] for row in measured] == pytest.approx([1.0, 0.5], rel=0.02)
    k = 1.6449
    for row in measured:
        spread = np.exp(k * row["sd_cents"] * np.log(2) / 1200)
        assert row["interval_90"]["freq_Hz"] == pytest.approx([row["freq_Hz"] / spread, row["freq_Hz"] * spread])
        assert row["interval_90"]["Q"] == pytest.approx([row["Q"] * np.exp(x * k * row["sd_Q"]) for x in (-1, 1)])
        assert row["interval_90"]["mass_kg"] == pytest.approx(
            [row["mass_kg"] * np.exp(2 * x * k * row["sd_shape"]) for x in (-1, 1)]
        )
        assert row["mpc"] == pytest.approx(1.0, abs=1e-3)
    body, r = fitted.body, fitted.responses
    assert fitted.mobility == pytest.approx(body.mobility(r.freq, r.pairs))
    assert fitted.error_db == pytest.approx(np.abs(20 * np.log10(np.abs(fitted.mobility / r.mobility))))
    for i in range(body.freq.size):
        part = body.shapes[i, 0] ** 2 * resonances(r.freq, body.freq[i : i + 1], body.quality[i : i + 1])[0]
        change = 20 * np.log10(np.abs(1 - part / fitted.mobility[0]))
        assert fitted.without_db[i] == pytest.approx(np.abs(change).max())
    assert repr(fitted) == f"<Fit of {body.freq.size} modes, {fitted.error_db.max():.2f} dB at most>"


def test_facts_and_table_of_a_fit(fitted) -> None:
    facts = fitted.facts()
    assert (facts["band_Hz"], facts["step_Hz"], facts["window_tau_s"]) == ([80.0, 480.0], 1.0, None)
    assert facts["hits"] == {"kept": 4, "given": 5}
    assert (facts["pairs"], facts["damping"], facts["files"]) == ([["a", "a"], ["b", "a"]], "viscous", {"x.csv": "0"})
    error = fitted.error_db
    assert facts["error_db"] == pytest.approx(
        {"rms": np.sqrt(np.mean(error**2)), "95%": np.quantile(error, 0.95), "most": error.max()}
    )
    assert facts["noise"] == pytest.approx(np.sqrt(np.mean(fitted.modes.problem.data.sigma**2, axis=1)))
    assert facts["compliance_m_per_N"] == fitted.body.compliance.tolist()
    assert "a remark" in facts["warnings"]
    assert any(line.startswith("driven at a alone") for line in facts["warnings"])
    first, _, names, *rows = fitted.table().splitlines()
    assert first.startswith("# Fitted to x.csv from 80 to 480 Hz; mass-normalised shapes")
    assert names == "f_Hz,Q,a,b,sd_cents,sd_Q_percent,measured"
    cells = [[float(x) for x in row.split(",")] for row in rows]
    assert [row[:2] for row in cells] == [
        list(pair) for pair in zip(fitted.body.freq, fitted.body.quality, strict=True)
    ]
    assert [row[2:4] for row in cells] == fitted.body.shapes.tolist()
    assert [row[6] for row in cells] == [float(x) for x in fitted.body.measured]
    for row, of in zip(cells, fitted.rows, strict=True):
        wanted = (of["sd_cents"], 100 * of["sd_Q"]) if of["measured"] else (0.0, 0.0)
        assert row[4:6] == pytest.approx(wanted, rel=5e-3)


def test_warnings_of_a_fit(fitted) -> None:
    def said(rows=(), modes=None, **more):
        fit = Fit(fitted.responses, modes or fitted.modes, fitted.body, **more)
        fit.__dict__["rows"] = [{"measured": True, "mass_kg": 1.0, "freq_Hz": 300.0, "Q": 10.0} | row for row in rows]
        return "\n".join(fit.warnings)

    usual = said([{}])
    assert usual == "a remark\n" + fitted.warnings[-1]
    assert "mode at 300.0 Hz: its bandwidth of 2.9 Hz (Q 103) holds fewer than 3 bins of 1 Hz" in said([{"Q": 103.0}])
    assert said([{"Q": 100.0}]) == usual
    assert "3 modes are narrower than 3 bins of 1 Hz (300, 300, 300 Hz)" in said([{"Q": 103.0}] * 3)
    assert said([{"Q": 103.0}] * 2).count("mode at 300.0 Hz") == 2
    assert "the band ends in the peak of the mode at 470.0 Hz" in said([{"freq_Hz": 470.0, "Q": 46.0}])
    assert said([{"freq_Hz": 470.0, "Q": 48.0}]) == usual
    assert "the band ends in the peak of the mode at 81.0 Hz" in said([{"freq_Hz": 81.0, "Q": 20.0}])
    assert "half of the modes weigh less than 0.001 kg" in said([{"mass_kg": 1e-3}])
    assert said([{"mass_kg": 1.1e-3}, {"mass_kg": 1.2e-3}, {"mass_kg": 1e-5}]) == usual
    assert "half of the modes weigh more than 1e+03 kg" in said([{"mass_kg": 1e3}])
    assert "no passive body: because" in said([{}], no_body="because")
    assert "responses from 'p', 'q' were left out" in said([{}], not_driven=("p", "q"))
    seven = tuple(float(i) for i in range(100, 107))
    assert "left out, 7: 100, 101, 102, 103, 104, 105 ... Hz" in said([{}], outliers=seven)
    assert "left out, 6: 100, 101, 102, 103, 104, 105 Hz" in said([{}], outliers=seven[:6])
    assert "3 bins without a finite number" in said([{}], empty=3)
    assert "of the mains perhaps, were left out: 50.0, 100.0 Hz" in said(
        [{}], replace(fitted.modes, mains=(100.0, 50.0))
    )
    idle = said([{}], replace(fitted.modes, idle=(*seven[::-1],)))
    assert "7 weak or doubtful modes" in idle
    assert "(100, 101, 102, 103, 104, 105 ... Hz); --keep 100 would keep one" in idle
    problem, poles, solution = fitted.modes.bent
    for misfit, told in ((1.49, False), (1.51, True)):
        loud = LinearFit(misfit * problem.size, solution.residues, solution.chi2)
        lines = said([{}], replace(fitted.modes, bent=(problem, poles, loud)))
        assert (f"the misfit is {misfit:.2f} times the noise" in lines) is told


def test_low_bands_and_coherences_are_told(fitted) -> None:
    r = fitted.responses

    def said(**more):
        fit = Fit(replace(r, **more), fitted.modes, fitted.body)
        fit.__dict__["rows"] = []
        return "\n".join(fit.warnings)

    assert "the responses end at 19.9 Hz: kHz read as Hz" in said(freq=r.freq * 19.9 / 480)
    assert "kHz" not in said(freq=r.freq * 20.1 / 480)
    coherence = np.ones((2, 401))
    for k in range(5):
        coherence[0, 10 + 80 * k : 50 + 80 * k] = 0.1
    low = said(coherence=coherence, n_hits=4)
    assert "the coherence at a is low: 90 to 129 Hz, 170 to 209 Hz, 250 to 289 Hz and 2 more; move --band" in low
    assert "the coherences were not used" not in low
    assert "the coherences were not used" in said(coherence=coherence)
    assert "driven at" not in said(pairs=(("a", "a"), ("b", "b")))


@pytest.mark.parametrize(("shape", "mass"), [([0.5, 9.0], 4.0), ([0.0, 1.0], None)])
def test_masses_are_felt_at_the_first_point(shape, mass) -> None:
    assert whole._mass(np.array(shape)) == mass
    assert whole._or_none(np.inf) is None
    assert whole._or_none(2.0) == 2.0
    assert whole._change(np.array([2.0, 4.0 + 0j]), np.array([1.0, 3.0 + 0j])) == pytest.approx(20 * np.log10(4))


def test_modes_of_a_fit_without_a_driving_point(truth) -> None:
    """Shapes are residues re the largest; no mass; two points have a collinearity of 1."""
    two = random_body(2, seed=5, high=300.0)
    freq = np.arange(60.0, 361.0)
    y, _ = two.noisy(freq, 0.003, 2)
    fit = fit_responses(Responses(freq, y, (("b", "a"), ("c", "a"))), damping="viscous")
    assert fit.body is None
    assert fit.no_body.startswith("no driving point")
    inside = [row for row in fit.rows if row["measured"]]
    for row in inside:
        i = int(np.argmin(np.abs(two.freq - row["freq_Hz"])))
        assert (row["freq_Hz"], row["Q"]) == (
            pytest.approx(two.freq[i], rel=2e-3),
            pytest.approx(two.quality[i], rel=0.1),
        )
        wanted = two.residues[:, i] / two.residues[np.argmax(np.abs(two.residues[:, i])), i]
        assert [complex(*x) for x in row["shape"]] == pytest.approx(wanted, abs=0.05)
        assert (row["mass_kg"], row["sd_shape"], row["interval_90"]["mass_kg"]) == (None, None, None)
    names = fit.table().splitlines()[2]
    assert names == "f_Hz,Q,b:a_re,b:a_im,c:a_re,c:a_im,sd_cents,sd_Q_percent,measured"


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


@pytest.mark.parametrize(
    ("time", "rate"),
    [
        (np.arange(50) / 1000, 1000.0),
        (np.round(np.arange(3000) / 2000, 3), 2000.0),  # some times repeat
        (np.round(np.arange(1000) / 100 / 0.02) * 0.02, 100.0),  # two thousandths of 10 s are 20 ms
        (np.round(np.arange(500) / 10000, 3), None),  # of 50 ms 0.1 ms
        (np.array([0.0, 1.0, 2.005]), 2 / 2.005),
        (np.array([0.0, 1.0, 2.02]), None),
        (np.array([0.0, 1.0, 1.0, 3.0]), None),
        (np.zeros(3), None),
        (np.zeros(1), None),
    ],
)
def test_rates_of_times(time, rate) -> None:
    if rate is None:
        with pytest.raises(TonewoodError, match="times are not evenly spaced"):
            files._rate(Path("a.csv"), time)
    else:
        assert files._rate(Path("a.csv"), time) == pytest.approx(rate, rel=1e-3 if time.size > 99 else 1e-9)


def test_two_sided_and_padded_data_are_told() -> None:
    half = np.array([1 + 1j, 2 - 1j, 0.5j])
    assert files._mirrored([np.concatenate([half, half[::-1].conj()])]) == 3
    assert files._mirrored([np.concatenate([[7.0], half, [4.0], half[::-1].conj()])]) == 5
    assert files._mirrored([np.concatenate([half, half])]) == 0
    assert files._mirrored([np.concatenate([half, half[::-1].conj()]), np.arange(6) + 1j]) == 0
    assert files._mirrored([np.ones(6, complex)]) == 0
    assert files._padded(np.append(np.ones(18), np.zeros(2)))
    assert not files._padded(np.append(np.ones(19), np.zeros(1)))
    assert files._padded(np.zeros(1))


def test_nodes_without_a_response_are_named() -> None:
    def sets(nodes, reference=1):
        return [{"rsp_node": n, "ref_node": reference} for n in nodes]

    path = Path("a.uff")
    assert universal._missing_nodes(path, [{"type": 58}], sets([1, 2, 4])) == (
        "a.uff has no response at 1 of its nodes: 3; sets may be missing",
    )
    geometry = {"type": 15, "node_nums": [1, 2, 4, 9]}
    assert universal._missing_nodes(path, geometry, sets([1, 2, 4]))[0].count(": 9;") == 1
    assert universal._missing_nodes(path, [], sets([1, 2, 3])) == ()
    assert universal._missing_nodes(path, [], sets([1, 9])) == ()
    many = [{"type": 15, "node_nums": range(1, 15)}]
    (line,) = universal._missing_nodes(path, many, sets(range(1, 8)))
    assert "at 7 of its nodes: 8, 9, 10, 11, 12, 13 ...;" in line
    moved = [{"rsp_node": 1, "ref_node": n} for n in (1, 2, 4)]
    assert ": 3;" in universal._missing_nodes(path, [], moved)[0]


def test_ends_of_universal_files() -> None:
    for line, bound in (
        (b"    -1", True),
        (b"ab    -1", True),
        (b"abcde    -1", False),
        (b"a\0cdef    -1", True),
        (b"    -2", False),
    ):
        assert universal._bounds(line) is bound
    assert universal._uff_units([{"type": 15}, {"type": 164, "force": 2, "length": 3}]) == (2.0, 3.0)
    assert universal._uff_units({"type": 58}) == (1.0, 1.0)


def test_a_hit_is_scaled_and_named() -> None:
    reading = files.Reading("mobility", points=("p", "q"), references=(("p", "a_"),), sensitivity=(2.0, 3.0, 4.0))
    hit = files._scaled(Path("a_1.wav"), 100.0, np.array([[1.0, 2], [1, 0], [0, 1]]), reading, reading.sensitivity)
    assert (hit.force.tolist(), hit.motion.tolist()) == ([2.0, 4.0], [[3.0, 0.0], [0.0, 4.0]])
    assert (hit.names, hit.reference, hit.fs) == (("p", "q"), "p", 100.0)
    for channels, sensitivity, name, said in (
        (1, (1.0,), "a_1.wav", "has one channel"),
        (2, (1.0, 1.0), "a_1.wav", "has 1 responses; --points names 2"),
        (3, (1.0, 1.0), "a_1.wav", "has 3 channels; --sensitivity gives 2 numbers"),
        (3, (1.0, 1.0, 1.0), "b.wav", "is not named"),
    ):
        with pytest.raises(TonewoodError, match=said):
            files._scaled(Path(name), 1.0, np.ones((channels, 2)), reading, sensitivity)


def test_the_picture_of_a_fit_has_its_curves(fitted, monkeypatch, tmp_path) -> None:
    drawn = []
    monkeypatch.setattr(figure, "save", lambda made, path: drawn.append(made))
    figure.draw_fit(fitted, tmp_path / "a.png")
    top, off, spread, quality, chart = drawn[0].axes
    r = fitted.responses
    lines = top.lines[1:]
    for i in range(2):
        for line, values in ((lines[2 * i], r.mobility[i]), (lines[2 * i + 1], fitted.mobility[i])):
            assert line.get_ydata() == pytest.approx(20 * np.log10(np.abs(values)) - 40.0 * i)
        assert off.lines[i].get_ydata() == pytest.approx(20 * np.log10(np.abs(fitted.mobility[i] / r.mobility[i])))
    sure = [row for row in fitted.rows if row["measured"]]
    assert spread.lines[0].get_ydata() == pytest.approx([row["sd_cents"] for row in sure])
    assert quality.lines[0].get_ydata() == pytest.approx([100 * row["sd_Q"] for row in sure])
    assert spread.lines[0].get_xdata() == pytest.approx([row["freq_Hz"] for row in sure])
    stable = stability(r.freq, r.mobility)
    assert chart.lines[1].get_xdata() == pytest.approx(stable.freq[stable.stable])
    assert chart.lines[0].get_ydata().tolist() == stable.order[~stable.stable].tolist()
    most = max(1.0, np.quantile(fitted.error_db, 0.99))
    assert off.get_ylim() == pytest.approx((-most, most))


# drift, the grid of poles, folders


def shifted_hits(shift, noise_size=0.0, seed=5):
    """Hits X = F (H - e f H') of two responses; forces of constant shares of the power, any phase."""
    rng, freq = np.random.default_rng(seed), np.arange(1.0, 201.0)
    size = np.array([1.0, 2.0, 3.0])
    force = size[:, None] * np.exp(2j * np.pi * rng.uniform(size=(3, 200)))
    h, slope = rng.standard_normal((2, 2, 200)) + 1j * rng.standard_normal((2, 2, 200))
    motion = force[:, None] * (h - np.asarray(shift)[:, None, None] * freq * slope)
    motion = motion + noise_size * (rng.standard_normal(motion.shape) + 1j * rng.standard_normal(motion.shape))
    turn = 0.01 * rng.standard_normal((3, 200))
    return drift.Spectra(freq, force, motion, force * turn, motion * turn[:, None] + force[:, None] * slope), size


def test_shifts_of_hits_are_relative_to_the_mean_by_power() -> None:
    """H of all hits by H1 moves by the mean of their shifts, weighted by the power of their forces."""
    shift, bins = np.array([3e-6, -1e-6, 2e-6]), np.arange(20, 180)
    spectra, size = shifted_hits(shift)
    moved, deviation = spectra.moves(bins)
    assert moved == pytest.approx(shift - np.sum(size**2 * shift) / np.sum(size**2), rel=1e-4)
    assert np.all(deviation < 1e-9)
    many = [shifted_hits(np.zeros(3), 1.0, seed)[0].moves(bins) for seed in range(60)]
    spread = np.std([m for m, _ in many], axis=0)
    assert np.mean([d for _, d in many], axis=0) == pytest.approx(spread, rel=0.35)


def test_spectra_of_hits_are_those_at_their_own_frequencies() -> None:
    """Sums over the samples at (1 + e) f; slopes in f, with time from the sample of the largest force on."""
    rng, fs, stretch = np.random.default_rng(6), 40.0, np.array([0.0, 0.01])
    force, motion = rng.standard_normal((2, 20)), rng.standard_normal((2, 3, 20))
    force[1, 4] = 9.0
    spectra = drift.Spectra.of(force, motion, fs, stretch)
    assert spectra.freq.tolist() == [2.0 * i for i in range(11)]
    t = np.arange(20) / fs
    for h, e in enumerate(stretch):
        turns = np.exp(-1j * TAU * (1 + e) * spectra.freq[:, None] * t)
        slopes = -1j * TAU * (1 + e) * turns * (t - 4 / fs)
        assert spectra.force[h] == pytest.approx(turns @ force[h])
        assert spectra.motion[h] == pytest.approx(motion[h] @ turns.T)
        assert spectra.force_slope[h] == pytest.approx(slopes @ force[h])
        assert spectra.motion_slope[h] == pytest.approx(motion[h] @ slopes.T)


def test_peaks_have_the_width_of_half_their_power() -> None:
    """Triangles of |H|^2 |F|^2 at bins 50 and 120, forces of any size and phase; the third is too low."""
    power = np.zeros(200)
    for at, height in ((50, 1.0), (120, 0.01), (160, 0.9e-4)):
        power += height * np.maximum(0, 1 - np.abs(np.arange(200) - at) / 9.5)
    rng = np.random.default_rng(8)
    force = rng.uniform(1, 3, (2, 200)) * np.exp(2j * np.pi * rng.uniform(size=(2, 200)))
    response = np.sqrt(power / np.sum(np.abs(force) ** 2, axis=0)) * np.array([[0.6], [0.8j]])
    motion = force[:, None] * response
    peaks = drift.Spectra(2.0 * np.arange(200), force, motion, 0 * force, 0 * motion).peaks()
    assert [width for _, width in peaks] == [18.0, 18.0]  # the nine bins above half, of 2 Hz
    assert [(bins[0], bins[-1]) for bins, _ in peaks] == [(37, 63), (107, 133)]


def test_one_hit_is_not_brought_together() -> None:
    hit = np.zeros((1, 64))
    hit[0, 3] = 2.0
    spectra, stretch, peaks = drift.brought_together(hit, hit[:, None] * 0.5, 640.0)
    assert (stretch.tolist(), peaks) == ([0.0], [])
    assert spectra.freq[[1, -1]].tolist() == [10.0, 320.0]
    assert spectra.motion[0, 0] == pytest.approx(np.exp(-2j * np.pi * np.arange(33) * 3 / 64))
    assert np.abs(spectra.force_slope).max() < 1e-12  # time begins at the hit


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


def test_a_folder_of_a_fit_has_its_figures(fitted, tmp_path) -> None:
    """Keys of the bundle and facts against the fit; files of another fit are removed."""
    bank = FittedRadiation(
        ("l", "r"), np.array([-1 + 9j, -2 + 20j]), 12.0, np.ones((2, 2)), np.ones((2, 2)), np.array([[3.0, -4.0]])
    )
    places = {"a": folder.MeasuredPoint(), "b": folder.MeasuredPoint((0.0, 1.0, 0.0), 0.25)}
    out = folder.FitFolder(fitted, bank, places, folder.Origin(title='a "b"', licence="CC0"), {"x": 1})
    facts = out.facts()
    assert facts["radiation"] == {"channels": ["l", "r"], "modes": 2, "error_db_rms": pytest.approx(12.5**0.5)}
    assert (facts["title"], facts["settings"]) == ('a "b"', {"x": 1})
    path = tmp_path / "new"
    files = out.write(path, lambda fit, file: file.write_bytes(b"picture"))
    assert [file.name for file in files] == ["body.csv", "radiation.csv", "body.yaml", "fit.json", "fit.png"]
    assert (path / "fit.png").read_bytes() == b"picture"
    assert json.loads((path / "fit.json").read_text())["radiation"]["modes"] == 2
    keys = yaml.safe_load((path / "body.yaml").read_text())
    hashes = [hashlib.sha256((path / name).read_bytes()).hexdigest() for name in ("body.csv", "radiation.csv")]
    assert [keys["provenance"][key]["sha256"] for key in ("body", "outputs.microphones")] == hashes
    source = keys["sources"]["measurement"]
    assert source["text"].startswith('a "b"; measured by ')
    assert source["text"].endswith(f"driven at {', '.join(fitted.responses.references)}; files: x.csv (SHA-256 0)")
    r, measured = fitted.responses, fitted.body.measured
    assert source["changes"].startswith(f"{np.count_nonzero(measured)} modes fitted by ")
    assert source["changes"].endswith(f": {r.freq[0]:g} to {r.freq[-1]:g} Hz, 4 of 5 hits")
    note = keys["provenance"]["body.truncation"]["note"]
    assert note.startswith(f"modes above {r.freq[-1]:g} Hz; {np.count_nonzero(~measured)} rows")
    assert keys["body"]["truncation"]["residual_compliance"] == fitted.body.compliance.tolist()
    # driven at one point, which counts as the middle
    assert keys["body"]["points"]["a"]["u"] == 0.0
    assert keys["body"]["points"]["b"] == {"direction": [0.0, 1.0, 0.0], "u": 0.25}
    assert [o["name"] for o in keys["outputs"]] == ["microphones", "bridge"]
    assert (keys["outputs"][0]["low_cut"], keys["outputs"][0]["full_scale"]) == (12.0, 40.0)
    assert keys["outputs"][1]["at"] == {"mean": [f"body.{name}" for name in r.references]}
    replace(out, radiation=None).write(path)
    assert not any((path / name).exists() for name in ("radiation.csv", "fit.png"))
    assert json.loads((path / "fit.json").read_text())["radiation"] is None
    assert "u" not in yaml.safe_load((path / "body.yaml").read_text())["body"]["points"]["a"]
    with pytest.raises(ZeroDivisionError):
        out.write(tmp_path / "fails", lambda fit, file: 1 / 0)
    assert not (tmp_path / "fails").exists()


@pytest.mark.parametrize(("places", "driven"), [((0.0,), "a"), ((-0.5, 0.5), "ab")])
def test_a_bank_is_that_of_its_pressures(places, driven) -> None:
    """Two poles, one microphone, noise of 1e-5: poles, heave and moment; the high-pass lies at a fifth of 60 Hz."""
    poles = TAU * np.array([200.0, 500.0]) * (-0.5 / np.array([8.0, 60.0]) + 1j)
    heave, moment = np.array([3.0 + 1j, -2.0 + 2j]), np.array([1.0 - 1j, 0.5j])
    s = 1j * TAU * FREQ
    a, b = TAU * 12.0 * np.array([0.8, 1.25])
    rng, heard = np.random.default_rng(7), {}
    for name, u in zip(driven, places, strict=True):
        residues = (heave + u * moment)[:, None]
        bank = (residues / (s - poles[:, None]) + residues.conj() / (s - poles.conj()[:, None])).sum(axis=0)
        error = rng.standard_normal(FREQ.size) + 1j * rng.standard_normal(FREQ.size)
        heard["m", name] = bank * s * s / ((s + a) * (s + b)) + 1e-5 * np.abs(bank).max() * error
    pairs = tuple((name, name) for name in driven)
    given = Responses(FREQ, np.ones((len(pairs), FREQ.size), complex), pairs, pressure=heard)
    body = SimpleNamespace(
        freq=np.array([201.0, 498.0, 900.0]), quality=np.array([35.0, 70.0, 5.0]), measured=np.array([1, 1, 0], bool)
    )
    at = dict(zip(driven, places, strict=True))
    bank = radiation.fit_radiation(given, body, at)
    assert (bank.channels, bank.low_cut) == (("m",), 12.0)
    assert bank.poles == pytest.approx(poles, rel=1e-4)
    assert bank.heave[0] == pytest.approx(heave, rel=1e-3)
    assert bank.moment[0] == pytest.approx(moment if len(places) > 1 else [0, 0], rel=5e-3, abs=1e-12)
    assert bank.error_db.shape == (len(places), FREQ.size)
    assert np.median(np.abs(bank.error_db)) < 0.05
    assert radiation.fit_radiation(replace(given, pressure={}), body, at) is None
    if len(places) > 1:
        with pytest.raises(TonewoodError, match="say where these lie"):
            radiation.fit_radiation(given, body, {"a": 0.3, "b": 0.3})
        with pytest.raises(TonewoodError, match="'m' was not measured from 'b'"):
            radiation.fit_radiation(replace(given, pressure={("m", "a"): heard["m", "a"]}), body, at)


def test_a_picture_leaves_out_what_has_no_deviation_or_lies_beyond_the_band(fitted, monkeypatch, tmp_path) -> None:
    drawn = []
    monkeypatch.setattr(figure, "save", lambda made, path: drawn.append(made))
    row = {"measured": True, "sd_cents": 2.0, "freq_Hz": 200.0, "sd_Q": 0.03}
    rows = [row, row | {"sd_cents": None, "freq_Hz": 210.0}, row | {"measured": False, "freq_Hz": 900.0}]
    fit = SimpleNamespace(rows=rows, responses=fitted.responses, mobility=fitted.mobility, error_db=fitted.error_db)
    figure.draw_fit(fit, tmp_path / "a.png")
    assert [drawn[0].axes[i].lines[0].get_xdata().tolist() for i in (2, 3)] == [[200.0]] * 2
    assert drawn[0].axes[3].lines[0].get_ydata().tolist() == [3.0]


def test_a_universal_file_cut_off_after_its_nodes_names_them(tmp_path) -> None:
    """The node line is the eighth of a data set; of seven lines it is not there."""
    nodes = "    4         0    1         0       NONE        12   3       NONE         7   3"
    lines = ["    -1", "    58", *["text"] * 5, nodes]
    for count, said in ((8, r"data set 1 \(response at node 12 to node 7\), and"), (7, "data set 1, and")):
        (tmp_path / "a.uff").write_text("\n".join(lines[:count]) + "\n")
        with pytest.raises(TonewoodError, match=said):
            universal._whole(tmp_path / "a.uff")
    (tmp_path / "a.uff").write_text("\n".join([*lines, "    -1"]) + "\n")
    assert universal._whole(tmp_path / "a.uff") is None


def test_signs_at_the_end_of_each_line_are_no_columns(tmp_path) -> None:
    rows = [(100.0 + k, 0.5 * k, -1.0 * k) for k in range(64)]
    text = "\n".join(["f;re;im;;", *("{};{};{};;".format(*row) for row in rows)])
    (tmp_path / "a.csv").write_text(text)
    _, columns, names, others = texts._table(tmp_path / "a.csv")
    assert columns.T.tolist() == [list(row) for row in rows]
    assert (names, others) == ([], 0)  # words of the head and columns do not match in number


@pytest.mark.parametrize(
    ("shape", "pairs"),
    [
        ((9,), [("H", "unnamed")]),
        ((9, 2), [("H_1", "unnamed"), ("H_2", "unnamed")]),
        ((9, 2, 2), [("H_1", "H_1"), ("H_1", "H_2"), ("H_2", "H_1"), ("H_2", "H_2")]),
        ((9, 1, 2), [("H_1", "unnamed_1"), ("H_1", "unnamed_2")]),
    ],
)
def test_arrays_are_rows_of_points_and_references(shape, pairs) -> None:
    x = np.arange(float(np.prod(shape))).reshape(shape)
    found = arrays._pairs_of("a.H", x)
    assert [pair for pair, _ in found] == pairs
    for (_, row), expected in zip(found, x.reshape(9, -1).T, strict=True):
        assert row.tolist() == expected.tolist()


def test_modes_are_dropped_and_kept_by_frequency() -> None:
    """Of two modes that stand out one is dropped; those that nothing shows are kept where they are wanted."""
    rng, freq = np.random.default_rng(3), np.arange(100.0, 500.0)
    y = np.array([[1.0, 0.8]]) @ resonances(freq, [200.0, 400.0], [40.0, 50.0])
    y = y + 1e-4 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    shape = Shape((0,), 1, True, False, False)

    def freqs(**more):
        poles = identify(freq, y, shape, damping="viscous", **more).poles
        return poles.freq[(poles.freq > 100) & (poles.freq < 499)]

    assert freqs() == pytest.approx([200.0, 400.0], rel=1e-3)
    assert not np.any(np.abs(freqs(drop=[405.0]) - 400.0) < 4.0)
    for wanted in ([300.0], [260.0, 320.0]):
        found = freqs(keep=wanted)
        assert len(found) == 2 + len(wanted)
        assert all(np.abs(found / f - 1).min() < 0.05 for f in wanted)
    for dropped, nearest in ((280.0, r"(199\.99|200)"), (290.0, r"(399\.9|400)")):
        with pytest.raises(LookupError, match=rf"there is no mode at {dropped:g} Hz; the nearest is at {nearest}"):
            identify(freq, y, shape, damping="viscous", drop=[dropped])


@pytest.mark.parametrize(
    ("names", "chosen", "taken"),
    [
        (["X", "frf", "H_psd"], [], "frf"),
        (["s.X", "s.Mobility", "Y_corr"], [], "Mobility"),
        (["X", "frf"], ["X"], "X"),
        (["X"], [], "X"),
    ],
)
def test_of_complex_arrays_that_called_a_response_is_one(names, chosen, taken) -> None:
    freq = np.arange(1.0, 21.0)
    given = {"freq_Hz": freq} | {name: (i + 1j) * freq for i, name in enumerate(names)}
    table = arrays.responses_of_arrays(Path("a.npz"), given, chosen)
    assert list(table.rows) == [(taken, "unnamed")]
    at = next(i for i, name in enumerate(names) if name.endswith(taken))
    assert table.rows[taken, "unnamed"].tolist() == ((at + 1j) * freq).tolist()
    assert table.form == ("mobility" if taken == "Mobility" else None)
