"""Analyses against published tables, other programs and simulated experiments."""

from __future__ import annotations

import copy
import math
from dataclasses import astuple, replace
from pathlib import Path

import listening_fakes as fakes
import listening_studies as studies
import numpy as np
import pytest
from published import DRUGS, HOUSING, MACHINES, RATINGS, SLEEP
from scipy import stats

from tonewood.cli.main import run
from tonewood.workshop.batch.manifest import ManifestError, check_manifest
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import models, pooling, power, results, simulations, strata
from tonewood.workshop.listening.detection import sensitivity, shares_of
from tonewood.workshop.listening.incomplete import CrossedFit, IncompleteFit
from tonewood.workshop.listening.models import bradley_terry, linear_analysis, rank_analysis
from tonewood.workshop.listening.ordinal import clustered, fit_counts, grades, ordinal_analysis
from tonewood.workshop.listening.panel import SimulatedPanel, simulate
from tonewood.workshop.listening.plain import methods, summary
from tonewood.workshop.listening.quest import QuestTable, QuestTrack, table_of
from tonewood.workshop.listening.results import analyse
from tonewood.workshop.listening.thresholds import thresholds

GUIDE = {
    "type": "staircase", "path": "exciters.pluck.from_bridge", "scale": "percent", "start": 40.0, "ratio": True,
    "lowest": 0.5, "highest": 80.0, "intervals": 3, "unit": "%",
}  # fmt: skip
LEVITT = {"steps": [2.0, 1.4, 1.2], "down": 2, "reversals": 8, "discard": 2}


def rows_of(y: np.ndarray) -> list[dict]:
    """Rows of an array (listeners, levels, repetitions)."""
    return [
        {"listener": str(i), "f": str(j), "value": float(v)}
        for i, own in enumerate(np.atleast_3d(y))
        for j, values in enumerate(own)
        for v in values
    ]


def test_strata_are_those_of_winer_s_table() -> None:
    """R 4.2's anova(mlm, test = "Spherical") prints F, both epsilons and both probabilities."""
    contrasts = strata.contrasts([(x,) for x in "abcd"], {"drug": list("abcd")})
    found = strata.tested(np.array(DRUGS, dtype=float), contrasts.bases["drug",], sounds=False)
    assert found.statistic == pytest.approx((698.2 / 3) / (112.8 / 12))
    assert found.statistic == pytest.approx(24.759, abs=5e-4)
    assert found.epsilon == pytest.approx(0.6049, abs=5e-5)
    assert found.p_greenhouse == pytest.approx(0.00064903, abs=5e-9)
    assert (15 * found.epsilon - 2) / (3 * (4 - 3 * found.epsilon)) == pytest.approx(1.0789, abs=5e-5)
    assert (found.df1, found.df2) == (3.0, 12.0)  # the corrected epsilon is cut to 1
    assert found.p_value == pytest.approx(1.9925e-05, abs=5e-10)


@pytest.mark.parametrize(
    ("listeners", "sounds", "df"), [(0.0, 2.0, 5.0), (3.0, 0.0, 4.0), (0.0, 0.0, 1.0), (3.0, 2.0, 5 / 1.15)]
)
def test_degrees_of_freedom_of_two_samples_are_weighted_by_their_variances(listeners, sounds, df) -> None:
    """(a + b) / (a / 4 + b / 5) of variances a and b; 1 where there are none."""
    parts = [(np.array([[v]]), f) for v, f in ((listeners, 4), (sounds, 5), (0.1, 20))]
    assert strata._joined(parts)[2] == pytest.approx(df)


def test_strata_are_those_of_statsmodels() -> None:
    """AnovaRM of Winer's table and of two crossed factors."""
    pandas = pytest.importorskip("pandas")
    anova = pytest.importorskip("statsmodels.stats.anova")
    rows = rows_of(np.array(DRUGS)[:, :, None])
    theirs = anova.AnovaRM(pandas.DataFrame(rows), "value", "listener", ["f"]).fit().anova_table
    (ours,) = linear_analysis(rows, ["f"], 0.95, {"f": list("0123")}).tests
    assert ours.statistic == pytest.approx(theirs["F Value"].iloc[0])
    rows = [
        {"listener": str(i), "a": f"{j // 3}", "b": f"{j % 3}", "value": float(v)}
        for i, own in enumerate(np.random.default_rng(2).normal(0, 1, (7, 6))) for j, v in enumerate(own)
    ]  # fmt: skip
    theirs = anova.AnovaRM(pandas.DataFrame(rows), "value", "listener", ["a", "b"]).fit().anova_table
    ours = linear_analysis(rows, ["a", "b"], 0.95, {"a": list("01"), "b": list("012")}).tests
    assert [t.statistic for t in ours] == pytest.approx(list(theirs["F Value"]))


def test_strata_are_those_of_sums_of_squares(rng: np.random.Generator) -> None:
    """Two crossed factors: F of each effect is its mean square over that of its interaction with listeners."""
    y = rng.normal(0, 1, (9, 3, 4)) + rng.normal(0, 2, (9, 3, 1)) + rng.normal(0, 1, (9, 1, 4))
    levels = {"a": list("012"), "b": list("0123")}
    contrasts = strata.contrasts([(a, b) for a in "012" for b in "0123"], levels)
    m = y.mean(axis=0)
    parts = {
        ("a",): (m.mean(1) - m.mean(), y.mean(2) - y.mean((1, 2))[:, None] - m.mean(1) + m.mean(), 4, 2),
        ("b",): (m.mean(0) - m.mean(), y.mean(1) - y.mean((1, 2))[:, None] - m.mean(0) + m.mean(), 3, 3),
    }
    for effect, (own, error, times, df) in parts.items():
        f = (9 * times * np.sum(own**2) / df) / (times * np.sum(error**2) / (df * 8))
        found = strata.tested(y.reshape(9, 12), contrasts.bases[effect], sounds=False)
        assert found.statistic == pytest.approx(f)
    c = y - y.mean(2, keepdims=True) - y.mean(1, keepdims=True) + y.mean((1, 2), keepdims=True)
    f = 9 * np.sum(c.mean(0) ** 2) / 6 / (np.sum((c - c.mean(0)) ** 2) / (6 * 8))
    assert strata.tested(y.reshape(9, 12), contrasts.bases["a", "b"], sounds=False).statistic == pytest.approx(f)


def test_the_machines_are_those_of_lmer() -> None:
    """The balanced mixed model with (1 | worker/machine) has F = 20.57608 on 2 and 10 (lmerTest 3.1-3)."""
    found = linear_analysis(rows_of(np.array(MACHINES)), ["f"], 0.95, {"f": ["0", "1", "2"]})
    assert found is not None
    assert found.exact
    assert found.tests[0].statistic == pytest.approx(20.57608, rel=1e-6)
    assert [t.difference for t in found.terms] == pytest.approx([7.966667, 13.916667], abs=1e-6)


def test_sleepstudy_has_the_slope_of_lme4() -> None:
    """Days + (Days | Subject): 10.467286, error 1.545790, t 6.771481 on 17 degrees of freedom (lmerTest 3.1-3)."""
    days = np.arange(10.0) - 4.5
    y = np.array(SLEEP)
    rows = (days / (days @ days))[None]
    intercept = np.full((1, 10), 0.1) - 4.5 * rows
    for one in (
        strata.estimated(y, np.vstack([rows, intercept]), 0.95, sounds=False),
        IncompleteFit(y, np.column_stack([np.ones(10), days])).estimated(np.vstack([rows, rows]), 0.95),
    ):
        assert one.difference[0] == pytest.approx(10.467286, abs=1e-6)
        error = (one.high - one.low) / 2 / stats.t.ppf(0.975, one.df)
        assert error[0] == pytest.approx(1.545790, abs=2e-6)
        assert one.df[0] == pytest.approx(17)
        assert one.difference[0] / error[0] == pytest.approx(6.771481, rel=1e-5)
    exact = strata.estimated(y, intercept, 0.95, sounds=False)
    assert exact.difference[0] == pytest.approx(251.405105, abs=1e-6)
    assert (exact.high - exact.low)[0] / 2 / stats.t.ppf(0.975, 17) == pytest.approx(6.824597, rel=1e-5)


def test_answers_of_some_listeners_are_missing() -> None:
    """At a variance of 0 Kenward and Roger's 17.95 (pbkrtest 0.5.2) are the design's 18; Satterthwaite claims 117."""
    rows = [{"listener": str(w), "item": str(i), "cond": str(c), "value": float(v)} for w, i, c, v in RATINGS]
    levels = {"cond": list("012"), "item": list("01234")}
    fixed = linear_analysis(rows, ["cond", "item"], 0.95, levels)
    assert not fixed.exact
    cond = next(t for t in fixed.tests if t.name == "cond")
    assert 17.0 < cond.df2 < 18.0
    assert fixed.notes == (
        "17 of 150 cells of listeners have no answer: differences allow for that, means per factor do not",
    )
    sampled = linear_analysis(rows, ["cond", "item"], 0.95, levels, ["item"])
    assert sampled.tests[0].df2 < 30
    assert "of listeners and of sounds" in sampled.method
    errors = [(t.high - t.low) / 2 / stats.t.ppf(0.975, t.df) for t in sampled.terms]
    assert [t.difference for t in sampled.terms] == pytest.approx([11.98, 20.84], abs=0.15)  # lmer: 11.986864, 20.84
    assert errors == pytest.approx([1.59, 1.41], rel=0.3)  # lmer: 1.587, 1.413


def test_effects_are_over_all_cells() -> None:
    """An effect at one level of the other factor only is half an effect, whichever level comes first."""
    rng = np.random.default_rng(1)
    rows = [
        {"listener": str(i), "a": a, "b": b, "value": (20.0 if a + b == "yy" else 0.0) + rng.normal(0, 1e-3)}
        for i in range(5) for a in "xy" for b in "xy"
    ]  # fmt: skip
    found = linear_analysis(rows, ["a", "b"], 0.95, {"a": ["x", "y"], "b": ["x", "y"]})
    whole = {t.name: t.difference for t in found.terms}
    assert whole["a=y"] == pytest.approx(10, abs=0.01)
    assert whole["a=y : b=y"] == pytest.approx(20, abs=0.01)
    part = [row for row in rows if (row["listener"], row["a"], row["b"]) != ("0", "y", "y")]
    missing = linear_analysis(part, ["a", "b"], 0.95, {"a": ["x", "y"], "b": ["x", "y"]})
    assert not missing.exact
    assert {t.name: t.difference for t in missing.terms} == pytest.approx(whole, abs=0.05)
    empty = [row for row in rows if (row["a"], row["b"]) != ("y", "y")]
    found = linear_analysis(empty, ["a", "b"], 0.95, {"a": ["x", "y"], "b": ["x", "y"]})
    assert found.notes == ("interaction left out, it has empty cells: a : b",)
    assert [t.difference for t in found.terms] == pytest.approx([0, 0], abs=0.01)


def cell_rows(y: np.ndarray) -> list[dict]:
    """Rows of an array (listeners, 3, 3) of two factors; NaN is missing."""
    return [
        {"listener": str(i), "a": str(j), "b": str(k), "value": float(v)}
        for (i, j, k), v in np.ndenumerate(y) if not np.isnan(v)
    ]  # fmt: skip


def test_answers_without_any_spread_are_no_rounding_errors() -> None:
    """Equal answers showed differences of 1e-14 points with p < 0.001; equal differences had p = 0."""
    levels = {"a": list("012"), "b": list("012")}
    for missing in (False, True):  # where answers are missing, those of a listener are compared with those of others
        y = np.broadcast_to(np.linspace(20.1, 20.1 if missing else 60.3, 8)[:, None, None], (8, 3, 3)).copy()
        y[0, 0, 0] = np.nan if missing else y[0, 0, 0]
        for random in ((), ("b",)):
            found = linear_analysis(cell_rows(y), ["a", "b"], 0.95, levels, random)
            assert [(t.low, t.difference, t.high, t.p_value) for t in found.terms] == [(0, 0, 0, 1)] * len(found.terms)
            assert [t.p_value for t in found.tests] == [1.0] * len(found.tests)
        y[:, 1] += 7.3
        found = linear_analysis(cell_rows(y), ["a", "b"], 0.95, levels)
        term = next(t for t in found.terms if t.name == "a=1")
        assert term.difference == pytest.approx(7.3)
        signs = stats.binomtest(8, 8, 0.5).pvalue
        assert term.p_value == pytest.approx(signs, rel=1e-9) if not missing else signs <= term.p_value < 0.05
        assert next(t for t in found.tests if t.name == "a").p_value == pytest.approx(term.p_value, rel=0.5)
        assert "p is that of the sign test: a=1" in found.notes[-1]


def test_what_one_listener_alone_decides_is_not_stated(rng: np.random.Generator) -> None:
    """Such differences had the spread of the others, who say nothing of them."""
    levels = {"a": list("012"), "b": list("012")}
    y = rng.normal(50, 8, (10, 3, 3))
    y[1:, 2] = np.nan
    found = linear_analysis(cell_rows(y), ["a", "b"], 0.95, levels)
    assert {t.name for t in found.terms if len(t.effect) == 1} == {"a=1", "b=1", "b=2"}
    assert "left out, rated by one listener only: a=2" in found.notes
    whole = linear_analysis(cell_rows(y[:, :2]), ["a", "b"], 0.95, levels)
    assert [(t.difference, t.low) for t in found.terms] == [(t.difference, t.low) for t in whole.terms]
    y = rng.normal(50, 8, (10, 3, 3))
    y[1:, 2, 2] = np.nan  # a cell of one listener is in every main effect over all cells, but not in a=1
    found = linear_analysis(cell_rows(y), ["a", "b"], 0.95, levels)
    assert {t.name for t in found.terms} == {"a=1", "b=1", "a=1 : b=1", "a=1 : b=2", "a=2 : b=1"}
    assert found.notes[-1].startswith("not stated, because one listener or sound alone decides it: a=2, b=2")
    y[1, 2, 2] = 51.0
    assert len(linear_analysis(cell_rows(y), ["a", "b"], 0.95, levels).terms) == 8


def false_alarms(random: bool, count: int) -> float:
    """Share of experiments in which a factor without an effect is found, when sounds differ in it."""
    rng = np.random.default_rng(4)
    contrasts = strata.contrasts([("a",), ("b",)], {"f": ["a", "b"]})
    y = rng.normal(0, 5, (count, 20, 6, 2)) + rng.normal(0, 5, (count, 1, 6, 2)) + rng.normal(0, 5, (count, 20, 1, 2))
    found = strata.tested(y if random else y.mean(axis=2), contrasts.bases["f",], sounds=random)
    return float(np.mean(found.p_value < 0.05))


def test_sounds_are_a_sample_where_the_manifest_says_so() -> None:
    assert false_alarms(random=False, count=1000) > 0.15
    assert 0.04 < false_alarms(random=True, count=6000) < 0.065
    manifest = {**fakes.fakes.manifest(**fakes.BASE), "random": ["scroe"]}
    with pytest.raises(ManifestError, match="random: scroe is not one of instrument, score, damping, pluck"):
        check_manifest(manifest)


@pytest.mark.parametrize("gaps", ["", "20 % at random"])
@pytest.mark.parametrize("null", studies.NULLS)
def test_false_alarms_and_coverage_hold(null: str, gaps: str) -> None:
    """The small count: bounds are wider than those of the long tier by the standard error."""
    found = studies.rating_rates(np.random.default_rng(1), 1000 if gaps else 3000, 12, null, gaps)
    wider = 0.01 if gaps else 0.0
    for share in (found.test, found.difference, found.other, found.interaction):
        assert 0.033 - wider < share < 0.067 + wider
    assert 0.93 - wider < found.coverage < 0.965 + wider


@pytest.mark.validate
@pytest.mark.parametrize("listeners", [12, 20, 40])
@pytest.mark.parametrize("gaps", ["", *studies.GAPS])
@pytest.mark.parametrize("null", studies.NULLS)
def test_false_alarms_and_coverage_of_5000_experiments(null: str, gaps: str, listeners: int) -> None:
    rates = []
    for seed in (1, 2, 3):
        found = studies.rating_rates(np.random.default_rng(seed), 5000, listeners, null, gaps)
        alarms = (found.test, found.difference, found.other, found.interaction)
        for share in alarms:
            assert 0.035 - 0.0035 <= share <= 0.06 + 0.0035  # a standard error beyond, for a single seed
        rates.append((*alarms, found.coverage))
    *means, coverage = np.mean(rates, axis=0)
    assert all(0.035 <= share <= 0.06 for share in means)
    assert 0.94 <= coverage <= 0.97


@pytest.mark.parametrize("population", studies.OTHERS)
def test_populations_that_nothing_was_chosen_on(population: str) -> None:
    """Where one listener in ten responds, intervals of 40 listeners are too narrow, too; the page says so."""
    found = studies.rating_rates(np.random.default_rng(5), 1000, 40, population)
    few = population == "one listener in ten responds"
    assert 0.025 < found.test < 0.07
    assert 0.025 < found.difference < (0.09 if few else 0.07)
    assert (0.91 if few else 0.93) < found.coverage < 0.97


@pytest.mark.slow
@pytest.mark.parametrize("spread", studies.SPREADS)
def test_random_sounds_with_missing_answers_hold_false_alarms_and_coverage(spread: str) -> None:
    *alarms, coverage = studies.sampled_rates(np.random.default_rng(1), 1000, 12, 6, 0.1, spread)
    assert all(0.012 < share < 0.075 for share in alarms)  # standard error 0.7 %
    assert 0.93 < coverage < 0.985


@pytest.mark.validate
@pytest.mark.parametrize("listeners", [12, 20, 40])
@pytest.mark.parametrize("sounds", [6, 12])
@pytest.mark.parametrize("spread", studies.SPREADS)
def test_random_sounds_of_15000_experiments(spread: str, sounds: int, listeners: int) -> None:
    case = (5000, listeners, sounds, 0.1, spread)
    rates = [studies.sampled_rates(np.random.default_rng(seed), *case) for seed in (1, 2, 3)]
    *alarms, coverage = np.mean(rates, axis=0)
    least = 0.035 if spread != "neither differs" else 0.027
    assert all(least - 0.002 <= share <= 0.06 for share in alarms)  # a standard error beyond
    assert 0.94 <= coverage <= 0.972


def test_random_sounds_with_all_answers_have_the_quasi_f(rng: np.random.Generator) -> None:
    levels = {"a": list("012"), "b": list("01")}
    contrasts = strata.contrasts([(a, b) for a in "012" for b in "01"], levels)
    x = np.hstack([np.ones((6, 1)), *contrasts.bases.values()])
    y = rng.normal(0, 1, (9, 5, 6)) + rng.normal(0, 1, (9, 1, 6)) + rng.normal(0, 2, (1, 5, 6))
    y += rng.normal(0, 5, (9, 1, 1)) + rng.normal(0, 5, (1, 5, 1))
    fit = CrossedFit(y, x)
    for effect, basis in contrasts.bases.items():
        own, rows = strata.tested(y, basis, sounds=True), contrasts.differences[effect]
        for mine, theirs in zip(astuple(fit.tested(basis)), astuple(own), strict=True):
            assert mine == pytest.approx(theirs, rel=1e-9)
        one, other = fit.estimated(rows, 0.95), strata.estimated(y, rows, 0.95, sounds=True)
        for mine, theirs in zip(astuple(one), astuple(other), strict=True):
            assert mine == pytest.approx(theirs, rel=1e-9)


def dense(y: np.ndarray, x: np.ndarray, contrast: np.ndarray) -> tuple[float, float, float]:
    """Estimate, variance and degrees of freedom after Pustejovsky and Tipton (2018), with matrices of all answers."""
    there = ~np.isnan(y)
    who = np.nonzero(there)[0]
    design, values = np.tile(x, (len(y), 1))[there.ravel()], y[there]
    working = np.eye(len(who)) + 100.0 * (who[:, None] == who)
    weight = np.linalg.inv(working)
    inverse = np.linalg.inv(design.T @ weight @ design)
    beta = inverse @ design.T @ weight @ values
    apart = np.eye(len(who)) - design @ inverse @ design.T @ weight
    scores, vectors = [], []
    for i in range(len(y)):
        own = who == i
        u, s, _ = np.linalg.svd(working[np.ix_(own, own)])
        root = u * np.sqrt(s) @ u.T
        inner = np.linalg.inv(root) @ (apart @ working @ apart.T)[np.ix_(own, own)] @ np.linalg.inv(root)
        u, s, _ = np.linalg.svd(inner)
        adjusted = root @ (u * np.where(s > 1e-9, s, np.inf) ** -0.5 @ u.T) @ np.linalg.inv(root)
        row = contrast @ inverse @ design[own].T @ weight[np.ix_(own, own)] @ adjusted
        scores.append(row @ (values - design @ beta)[own])
        vectors.append(apart[own].T @ row)
    spread = np.array(vectors) @ working @ np.array(vectors).T
    return contrast @ beta, np.sum(np.square(scores)), np.trace(spread) ** 2 / np.sum(spread**2)


def test_incomplete_ratings_are_analysed_by_cluster_robust_variances(rng: np.random.Generator) -> None:
    """The fast form is that of whole matrices; with all answers it is the analysis by strata, to rounding."""
    levels = {"a": list("012"), "b": list("01")}
    contrasts = strata.contrasts([(a, b) for a in "012" for b in "01"], levels)
    x = np.hstack([np.ones((6, 1)), *contrasts.bases.values()])
    y = rng.normal(50, 5, (8, 1)) + rng.normal(0, 1, (8, 6)) * np.array([1, 1, 3, 3, 9, 9])
    y[[0, 1, 1, 4, 5, 5, 5, 5], [0, 3, 5, 2, 1, 2, 3, 4]] = np.nan
    for effect, rows in contrasts.differences.items():
        found = IncompleteFit(y, x).estimated(rows, 0.95)
        for i, row in enumerate(rows):
            value, v, df = dense(y, x, row @ x)
            assert found.difference[i] == pytest.approx(value, rel=1e-9)
            assert found.df[i] == pytest.approx(df, rel=1e-9)
            half = stats.t.ppf(0.975, df) * math.sqrt(v)
            assert found.high[i] - found.difference[i] == pytest.approx(half, rel=1e-9)
        whole = np.nan_to_num(y, nan=50.0)
        one, other = IncompleteFit(whole, x), strata.tested(whole, contrasts.bases[effect], sounds=False)
        for mine, theirs in zip(astuple(one.tested(contrasts.bases[effect])), astuple(other), strict=True):
            assert mine == pytest.approx(theirs, rel=1e-9)


def test_levels_that_no_listener_shares_are_compared_between_listeners() -> None:
    """Then each listener has one number, and the test is Welch's."""
    rng = np.random.default_rng(5)
    rows = [
        {"listener": str(i), "f": "ab"[i % 2], "value": rng.normal(50 + 10 * (i % 2), 2 + 5 * (i % 2))}
        for i in range(14)
    ]
    found = linear_analysis(rows, ["f"], 0.95, {"f": ["a", "b"]})
    a, b = ([row["value"] for row in rows if row["f"] == f] for f in "ab")
    welch = stats.ttest_ind(a, b, equal_var=False)
    (term,) = found.terms
    assert term.difference == pytest.approx(np.mean(b) - np.mean(a))
    assert term.difference / (term.high - term.low) * 2 * stats.t.ppf(0.975, term.df) == pytest.approx(-welch.statistic)


def test_variances_by_clusters_are_those_of_clubsandwich() -> None:
    """clubSandwich 0.5.8 (R 4.2.2), CR2 of nlme's gls with corCompSymm fixed at 100 / 101: estimate, error, df."""
    rows = [{"listener": str(w), "item": str(i), "cond": str(c), "value": float(v)} for w, i, c, v in RATINGS]
    found = linear_analysis(rows, ["cond", "item"], 0.95, {"cond": list("012"), "item": list("01234")})
    terms = {t.name: t for t in found.terms}
    for name, value, error, df in (
        ("cond=1", 11.905901661, 0.978967953, 8.779339887),
        ("cond=2", 20.84, 1.1534682, 9.0),
        ("item=4", -3.988054709, 1.410575728, 8.613659433),
    ):
        one = terms[name]
        assert one.difference == pytest.approx(value, abs=1e-8)
        assert one.df == pytest.approx(df, abs=1e-5)
        # the root of the working matrix is Cholesky's there and the symmetric one here
        assert (one.high - one.low) / 2 / stats.t.ppf(0.975, one.df) == pytest.approx(error, rel=2e-5)


def test_odds_are_those_of_polr() -> None:
    """The example of MASS::polr (R): coefficients and cuts as its help prints them."""
    cont, kind, infl = (x.ravel() for x in np.meshgrid(range(2), range(4), range(3), indexing="ij"))
    x = np.column_stack([infl == 1, infl == 2, kind == 1, kind == 2, kind == 3, cont == 1]).astype(float)
    beta, alpha, converged = fit_counts(np.array(HOUSING, dtype=float).reshape(24, 3), x, prior=1e-9)
    assert converged
    printed = [0.5663937, 1.2888191, -0.5723501, -0.3661866, -1.0910149, 0.3602841]
    assert beta == pytest.approx(printed, abs=1e-6)
    assert alpha == pytest.approx([-0.4961353, 0.6907083], abs=1e-6)


def test_odds_are_clustered_as_in_sandwich() -> None:
    """sandwich::vcovCL(glm, type = "HC0", cadjust = TRUE), R 4.2.2, of ratings grouped into two grades at 50."""
    counts = np.zeros((10, 3, 2))
    for who, _, condition, value in RATINGS:
        counts[who, condition, int(value > 50)] += 1
    eta, v, converged = clustered(counts, np.array([[0, 0], [1, 0], [0, 1.0]]), prior=1e-9)
    assert converged
    assert eta == pytest.approx([0, 1.56861592, 2.90264185], abs=1e-7)
    assert np.sqrt(np.diag(v)) == pytest.approx([0, 0.207498327, 0.437935626], abs=1e-8)


def test_odds_that_are_infinite_are_not_stated(rng: np.random.Generator) -> None:
    rows = [
        {"listener": str(i), "f": "ab"[j], "value": float(np.clip(round(3 + j + own + rng.normal()), 1, 5))}
        for i, own in enumerate(rng.normal(0, 1, 9)) for j in (0, 1) for _ in range(4)
    ]  # fmt: skip
    levels = {"f": ["a", "b"]}
    assert len(ordinal_analysis(rows, ["f"], 0.95, levels).terms) == 1
    best = [r | {"value": 5.0} if r["f"] == "b" else r for r in rows]
    found = ordinal_analysis(best, ["f"], 0.95, levels)
    assert not found.terms
    assert not found.tests
    assert found.notes[0] == "all answers to b stand at one end of the scale"


def test_values_are_grouped_into_grades_that_keep_their_order(rng: np.random.Generator) -> None:
    values = np.clip(rng.normal(92, 8, 500), 0, 100)
    found = grades(values, (0.0, 100.0))
    assert np.all(np.diff(found[np.argsort(values)]) >= 0)
    assert 10 < found.max() < 20
    assert set(np.flatnonzero(found == found.max())) == set(np.flatnonzero(values == 100.0))
    assert list(grades(np.array([3.0, 1.0, 3.0, 5.0]), (1.0, 5.0))) == [1, 0, 1, 2]


@pytest.mark.parametrize(
    "listeners", [pytest.param(12, marks=pytest.mark.slow), 20, pytest.param(40, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("count", [1500, pytest.param(15_000, marks=pytest.mark.validate)])
@pytest.mark.parametrize("cuts", studies.CUTS)
def test_odds_hold_false_alarms_and_coverage(cuts: str, count: int, listeners: int) -> None:
    *alarms, coverage, bias, failed = studies.odds_rates(np.random.default_rng(1), count, listeners, cuts)
    wider = 0.015 if count < 5000 else 0.0
    assert all(0.035 - wider < share < 0.06 + wider for share in alarms)
    assert 0.94 - wider < coverage < 0.97 + wider
    assert abs(bias) < 0.05 + wider
    assert failed == 0


def panel(**changes) -> SimulatedPanel:
    return SimulatedPanel.model_validate({"schema": "tonewood-panel/1", **changes})


def test_a_panel_without_effects_rates_the_hidden_reference_like_the_others(tmp_path: Path) -> None:
    """It gave the hidden reference 100 and the others their deviations: p was 5e-5."""
    pages = [
        {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]},
        {"type": "bs1116", "group_by": ["pluck"], "reference": {"damping": "complex"}},
    ]
    test = fakes.made(tmp_path, pages)
    simulate(test, panel(), 60, seed=5)
    mushra, grades = analyse(tmp_path / "out", screening=False).pages
    for term in mushra.linear.terms:
        assert term.p_value > 1e-3
        assert abs(term.difference) < 3
    best = [row["role"] for row in mushra.rows if row["value"] == 100.0]
    assert 0.2 < best.count("reference") / len(best) < 0.5  # one of three: at chance
    values = [row["value"] for row in grades.rows]
    assert abs(np.mean(np.sign(values))) < 0.25


@pytest.mark.validate
def test_panels_without_effects_find_effects_in_5_percent_of_tests(tmp_path: Path) -> None:
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]}
    test = fakes.made(tmp_path, [page])
    alarms = []
    for seed in range(300):
        for old in (tmp_path / "out" / "answers").glob("*"):
            old.unlink()
        simulate(test, panel(slope_sd=4.0), 14, seed=seed)
        (found,) = analyse(tmp_path / "out", screening=False).pages
        alarms += [t.p_value < 0.05 for t in found.linear.tests]
    assert 0.03 < np.mean(alarms) < 0.07


def test_screening_does_not_make_effects(tmp_path: Path) -> None:
    """It leaves those out who missed the hidden reference: the figures of the first lines are not of the rest alone."""
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]}
    simulate(fakes.made(tmp_path, [page]), panel(), 100, seed=1)
    found = analyse(tmp_path / "out")
    (own,) = found.pages
    assert len(own.screened) > 15
    assert own.linear.terms[0].high < 0  # of those who are left
    lines = summary(found)
    assert any("no difference between proportional and complex is shown" in line for line in lines)
    for line in lines:
        if "95 % interval" in line and "no difference" in line and "points" in line:
            low, high = line.split("95 % interval ")[1].split(",")[0].split(" to ")
            assert float(low.replace("\N{MINUS SIGN}", "-")) <= 0 <= float(high.replace("\N{MINUS SIGN}", "-"))
    assert not any("depends on" in line for line in lines)


def test_pairs_are_tested_over_all_cells_and_cells_by_holm(tmp_path: Path) -> None:
    """--dry-run counted the answers of all cells, the report tested each cell, unadjusted."""
    page = {"type": "abx", "group_by": ["pluck"], "pairs": {"damping": "all"}, "times": 2, "expect": 0.8}
    test = fakes.made(tmp_path, [page])
    simulate(test, panel(d_prime={"damping": {"block": 2.5}}), 8, seed=2)
    found = analyse(tmp_path / "out")
    (own,) = found.pages
    assert (len(own.pairs), len(own.detections)) == (3, 9)
    raw = [stats.binomtest(p.right, 8 * 3 * 2, 0.5, alternative="greater").pvalue for p in own.pairs]
    assert [p.p_value for p in own.pairs] == pytest.approx(raw)
    assert min(p.p_holm for p in own.pairs) == pytest.approx(3 * min(raw))
    assert min(d.p_holm for d in own.detections) == pytest.approx(9 * min(d.p_value for d in own.detections))
    lines = summary(found)
    assert sum("told apart (" in line and "of 48 answers" in line for line in lines) == 3
    assert "9 cells" in lines[-1]
    (row,) = power.power_of(test.manifest, {0: 6})
    assert row.listeners == math.ceil(power.answers_for_share(0.8, 0.5, 0.05 / 3, 0.8) / 6)
    assert "over all cells, of one of 3 pairs" in str(row)


@pytest.mark.slow
def test_too_few_listeners_and_thresholds_beyond_the_levels_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first lines left the page out; the threshold was 32 % of levels that end at 10 %; the command broke off."""
    pages = [{"type": "rating", "scales": [{"name": "dry", "label": "Dry"}]},
             {"type": "ab", "pairs": {"damping": ["complex", "block"]}},
             fakes.STAIRS | {"reversals": 4, "longest": 12, "discard": 1}]  # fmt: skip
    simulate(fakes.made(tmp_path, pages), panel(), 2, seed=1)
    found = analyse(tmp_path / "out")
    lines = summary(found)
    assert "no difference is tested, with answers of 2 listeners; three are needed." in lines[0]
    assert "lies above the levels that can be presented, which end at 10 %" in lines[-1]
    assert found.pages[1].pairs[0].d_high is None  # six answers put no bound on d'
    with pytest.raises(SystemExit) as done:
        run(["results", str(tmp_path / "out")])
    assert not done.value.code
    assert "\N{EN DASH}]" in capsys.readouterr().out.split("threshold")[1]


def test_few_listeners_who_agree_are_no_scale() -> None:
    """Three of three made an interval without width: in one of four tests of coins."""
    rows = [{"listener": str(i), "f": "x|y", "value": 1.0} for i in range(12)]
    for n, sure in ((3, False), (5, False), (7, True), (12, True)):  # as in the sign test, from six or seven on
        x, y = bradley_terry(rows[:n], "f", 0.95)
        assert (y.low > x.high) == sure
    alarms, covered = studies.choice_rates(np.random.default_rng(2), 300, 12, 2, 0.5)
    assert alarms < 0.09
    assert covered > 0.91


def test_the_power_promised_is_had() -> None:
    promised = power.rating_power([0.0, 5.0, 0.0], 8.0**2 / 2 * np.eye(3), 25, 0.05)[0]
    had = studies.power_had(np.random.default_rng(3), 3000, 25, 5.0, 8.0)
    assert had == pytest.approx(promised, abs=0.035)


def test_power_is_that_of_student_s_t() -> None:
    """Differences of two levels: of listeners, or of random sounds where listeners hardly differ."""
    mean, sd, n = 5.0, 8.0, 20
    at = stats.t.ppf(0.975, n - 1)
    law = stats.nct(n - 1, mean / sd * math.sqrt(n))
    true = law.sf(at) + law.cdf(-at)
    wide, narrow = sd**2 / 2 * np.eye(2), 1e-4 * np.eye(2)
    assert power.rating_power([0.0, mean], wide, n, 0.05)[0] == pytest.approx(true, abs=0.025)
    sounds = power.SoundSpread(n, wide, np.zeros((2, 2)))
    assert power.rating_power([0.0, mean], narrow, 60, 0.05, sampled=sounds)[0] == pytest.approx(true, abs=0.025)


@pytest.mark.slow
def test_power_of_random_sounds_is_had(tmp_path: Path) -> None:
    """Six sounds, which differ in the effect: the power is that of the quasi-F, whatever the number of listeners."""
    own, spread = power.stated_spread(12.0, 5.0, 6, 2)
    promised = power.rating_power([0.0, 8.0], own, 20, 0.05, sampled=spread)[0]
    had = studies.power_had_by_sounds(np.random.default_rng(3), 1500, 20, 6, 8.0, 12.0, 5.0)
    assert had == pytest.approx(promised, abs=0.04)
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "expect": 10.0}
    fixed = fakes.made(tmp_path, [page])
    factor = next(f for f, x in fixed.manifest.choices().items() if f != "damping" and len(x) > 1)
    few = []
    for spread in (1.5, 30.0):
        pages = [fixed.manifest.pages[0].model_copy(update={"expect_sound_sd": spread})]
        few += power.power_of(fixed.manifest.model_copy(update={"random": [factor], "pages": pages}), {})
    (whole,) = power.power_of(fixed.manifest, {})
    assert few[0].listeners > whole.listeners
    assert "random sounds with sd 1.5" in str(few[0])
    row = few[1]
    assert row.listeners is None
    assert "no number of listeners is enough for 10 points" in str(row)


@pytest.mark.slow
def test_power_of_ordinal_scales_is_that_of_shares_of_comparisons(tmp_path: Path) -> None:
    """Grades are drawn one by one and analysed as in the report; a scale that ends changes little."""
    promised = power.ordinal_power([0.0, 0.6, 0.0], 1.0, 6, (1.0, 5.0), 25, 0.05)[0]
    had = studies.power_had_by_shares(np.random.default_rng(3), 300, 25, 0.6, 1.0)
    assert had == pytest.approx(promised, abs=0.07)
    assert power.ordinal_power([0.0, 0.6, 0.0], 1.0, 6, (2.9, 3.1), 25, 0.05)[0] == pytest.approx(promised, abs=0.06)
    assert power.ordinal_power([0.0, 0.0, 0.0], 1.0, 6, (1.0, 5.0), 12, 0.05)[0] < 0.03  # a third of 5 %, by Holm
    scale = {"name": "bright", "label": "Brightness", "low": 1.0, "high": 5.0, "ordinal": True}
    test = fakes.made(tmp_path, [{"type": "rating", "scales": [scale], "expect": 0.6, "expect_sd": 1.0}])
    (row,) = power.power_of(test.manifest, {})
    assert "0.6 of 4 points, sd 1, by shares of comparisons in 3 sounds" in str(row)
    simulate(test, panel(ratings={"damping": {"block": -1.5}}, listener_sd=0.2, residual_sd=0.3), 8, seed=1)
    (piloted,) = power.power_of(test.manifest, {}, analyse(tmp_path / "out"))
    assert "8 listeners of a pilot" in str(piloted)
    assert piloted.listeners < row.listeners


def test_a_pilot_s_spread_is_of_listeners_sounds_and_pairs() -> None:
    rng = np.random.default_rng(6)
    y = rng.normal(0, 6, (400, 1, 2)) + rng.normal(0, 3, (1, 400, 2)) + rng.normal(0, 9, (400, 400, 2))
    listeners, sounds = power._pilot_spread(y, 5)
    for found, sd in ((listeners, 6.0), (sounds.sounds, 3.0), (sounds.pairs, 9.0)):
        assert np.sqrt(np.diag(found)) == pytest.approx([sd, sd], rel=0.12)
    assert sounds.count == 5


@pytest.mark.parametrize(("effect", "sd", "trials"), [(5.0, 12.0, 1), (10.0, 15.0, 4), (20.0, 20.0, 1)])
def test_stated_effects_are_those_of_the_ratings(effect: float, sd: float, trials: int) -> None:
    """Mean and spread of the rated differences, cut off at 100, are the stated ones; listeners as of a t test."""
    people = power.MushraListeners.stated(np.array([0.0, -effect]), sd, trials=trials)
    y, _ = people.drawn(np.random.default_rng(7), 1, 20_000)
    differences = (y[..., 1] - y[..., 0]).mean(axis=(0, 2))
    assert differences.mean() == pytest.approx(-effect, rel=0.04)
    assert differences.std() == pytest.approx(sd, rel=0.03)
    wanted = (sum(stats.norm.ppf([0.975, 0.8])) * sd / effect) ** 2
    needed = power.fewest(lambda m: float(power.mushra_power(people, m, 0.05)[0]), 0.8, "")
    assert needed == pytest.approx(wanted + 1.9, abs=0.1 * wanted + 1)  # t with small samples needs two more


@pytest.mark.slow
@pytest.mark.parametrize(("listeners", "random"), [(14, False), (24, True)])
def test_power_of_stated_effects_with_screening_is_had(
    listeners: int, random: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Panels take the test and their answers are analysed and screened; of 300 tests, the standard error is 2.8 %."""
    for unused in ("ordinal_analysis", "rank_analysis"):  # p of points does not depend on them
        monkeypatch.setattr(results, unused, lambda *_: None)
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [7000]}
    factors = copy.deepcopy(fakes.BASE["factors"])
    sounds, rng = {}, np.random.default_rng(4)
    if random:
        factors["pluck"]["levels"] = {f"p{i}": 1 + i / 1000 for i in range(6)}
        test = fakes.made(tmp_path, [page], factors=factors, random=["pluck"])
        people = power.MushraListeners.stated(np.array([0.0, 0.0, -10.0]), 12.0, sounds=6, sound_sd=5.0)
        sounds = {f"damping={d}, pluck={p}": 5 / math.sqrt(2) for d in factors["damping"]["levels"]
                  for p in factors["pluck"]["levels"]}  # fmt: skip
    else:
        test = fakes.made(tmp_path, [page])
        people = power.MushraListeners.stated(np.array([0.0, 0.0, -10.0]), 12.0, trials=3)
    promised = power.mushra_power(people, listeners, 0.05)[1]
    taken, left_out = 300, 0
    had = []
    for seed in range(taken):
        for old in (tmp_path / "out" / "answers").glob("*"):
            old.unlink()
        drawn = {rule: sd * rng.standard_normal() for rule, sd in sounds.items()}
        own = panel(listener_sd=people.own_sd, slope_sd=people.slope_sd, residual_sd=people.residual_sd,
                    ratings={"damping": {"block": float(people.effects[2])}}, interactions=drawn)  # fmt: skip
        simulate(test, own, listeners, seed=seed)
        found = analyse(tmp_path / "out")
        left_out += len(found.pages[0].screened)
        had.append(any(": block is rated" in line for line in summary(found)))
    assert 0.5 < promised < 0.9
    assert np.mean(had) == pytest.approx(promised, abs=0.05)
    stays = people.drawn(np.random.default_rng(1), 200, 100)[1]
    assert left_out / (taken * listeners) == pytest.approx(1 - stays.mean(), abs=0.04)


def test_power_counts_those_whom_the_screening_leaves_out() -> None:
    """With nobody left out it is that of the pilot's spread; with half of them it is near that of half as many."""
    pilot = np.repeat(np.random.default_rng(8).normal(50, 6, (200, 2)), 2, axis=0)  # half of them are as all are
    effects, half = np.array([0.0, 5.0]), np.arange(400) % 2 == 0

    def plain(n: int) -> float:
        return float(power.rating_power(effects, np.cov(pilot, rowvar=False), n, 0.05)[0])

    whole = power.screened_power(pilot, np.ones(400, dtype=bool), effects, 20, 0.05)[0]
    assert whole == pytest.approx(plain(20), abs=0.04)
    screened = power.screened_power(pilot, half, effects, 40, 0.05)[0]
    assert screened < plain(20) + 0.03  # standard error 1 %
    assert screened == pytest.approx(plain(20), abs=0.1)
    _, spread = power.stated_spread(6.0 * math.sqrt(2), 2.0, 8, 2)
    shares = [power.screened_power(pilot, who, effects, 20, 0.05, sampled=spread)[0] for who in (half | True, half)]
    listeners = np.cov(pilot, rowvar=False) - spread.pairs / 8
    assert shares[0] == pytest.approx(power.rating_power(effects, listeners, 20, 0.05, sampled=spread)[0], abs=0.05)
    assert shares[1] < shares[0] - 0.1


@pytest.mark.slow
def test_power_takes_a_pilot_s_answers(tmp_path: Path) -> None:
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "expect": 10.0}
    test = fakes.made(tmp_path, [page])
    (stated,) = power.power_of(test.manifest, {})
    simulate(test, panel(listener_sd=2.0, residual_sd=3.0, ratings={"damping": {"block": -30.0}}), 12, seed=1)
    (piloted,) = power.power_of(test.manifest, {}, analyse(tmp_path / "out"))
    assert "12 listeners of a pilot" in str(piloted)
    assert piloted.listeners < stated.listeners
    assert stated.stated
    unstated = fakes.made(tmp_path / "unstated", [{k: v for k, v in page.items() if k != "expect"}])
    assert not power.power_of(unstated.manifest, {})[0].stated
    (piloted,) = power.power_of(unstated.manifest, {}, analyse(tmp_path / "out"))
    assert piloted.stated
    assert float(piloted.effect.split()[0]) == pytest.approx(-30.0, abs=5.0)


def test_power_of_a_staircase_takes_a_pilot_s_thresholds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[simulations.Population, float]] = []

    def fewest(page: StaircasePage, people: simulations.Population, margin: float, *_: float) -> int:
        asked.append((people, margin))
        return 7

    monkeypatch.setattr(power, "threshold_listeners", fewest)
    test = fakes.made(tmp_path, [fakes.STAIRS | {"expect": 1.0, "expect_sd": 2.0, "expect_slope": 3.0, "margin": 1.3}])
    (stated,) = power.power_of(test.manifest, {})
    assert asked.pop() == (simulations.Population(1.0, math.log(2.0), 3.0), pytest.approx(math.log(1.3)))
    assert "by 30 % than 1, spread between listeners 2" in str(stated)
    simulate(test, panel(thresholds={"1": {"mean": 0.5, "sd": 1.1, "slope": 4.0}}), 4, seed=1)
    pilot = analyse(tmp_path / "out")
    seen = pilot.pages[0].thresholds
    (piloted,) = power.power_of(test.manifest, {}, pilot)
    assert asked.pop()[0] == simulations.Population(seen.mean, math.log(seen.spread), seen.slope)
    assert f"than {seen.mean:.3g}," in str(piloted)
    unfinished = replace(pilot, pages=(replace(pilot.pages[0], thresholds=None),))
    (again,) = power.power_of(test.manifest, {}, unfinished)
    assert asked.pop()[0] == simulations.Population(1.0, math.log(2.0), 3.0)
    assert again == stated


def test_the_best_sound_of_a_panel_gets_the_grade_of_the_reference(tmp_path: Path) -> None:
    """BS.1116: one of two gets 5; a sound 40 points worse than the reference gets it nearly never."""
    test = fakes.made(tmp_path, [{"type": "bs1116", "group_by": ["pluck"], "reference": {"damping": "complex"}}])
    simulate(test, panel(residual_sd=1.0, ratings={"damping": {"block": -40.0, "proportional": -40.0}}), 4, seed=2)
    (page,) = analyse(tmp_path / "out", screening=False).pages
    values = [row["value"] for row in page.rows]
    assert len(values) == 4 * 6
    assert max(values) < 0


def test_quest_plus_takes_the_levels_of_the_reference_run() -> None:
    """Watson's example with one unknown in questplus 2023.1: 20 answers, then mean, deviation and mode."""
    grid = np.arange(-40, 1, 1.0)
    right = 1 - 0.02 - (1 - 0.5 - 0.02) * np.exp(-(10.0 ** (3.5 * (grid[:, None] - grid) / 20)))
    table = QuestTable(right, np.ones(len(grid)))
    posterior, levels = table.prior, []
    for answer in "CCCICCICCCICCCCICICC":
        at = int(table.best(posterior))
        levels.append(int(grid[at]))
        posterior = table.updated(posterior, at, answer == "C")
    assert levels == [
        -18,
        -22,
        -25,
        -28,
        -19,
        -20,
        -22,
        -16,
        -17,
        -18,
        -19,
        -14,
        -15,
        -16,
        -17,
        -18,
        -15,
        -16,
        -13,
        -13,
    ]
    mean = float(posterior @ grid)
    assert mean == pytest.approx(-15.734298, abs=1e-6)
    assert math.sqrt(posterior @ grid**2 - mean**2) == pytest.approx(3.055088, abs=1e-6)
    assert grid[np.argmax(posterior)] == -17


def test_quest_plus_takes_the_levels_of_questplus(rng: np.random.Generator) -> None:
    questplus = pytest.importorskip("questplus")
    levels, thresholds_, slopes, lapses = (np.arange(-20, 1, 1.0), np.arange(-20, 1, 2.0), np.array([2.0, 3.5, 6.0]),
                                           np.array([0.01, 0.05]))  # fmt: skip
    theirs = questplus.QuestPlus(
        stim_domain={"intensity": levels}, func="weibull", stim_scale="dB",
        param_domain={
            "threshold": thresholds_, "slope": slopes, "lower_asymptote": np.array([1 / 3]), "lapse_rate": lapses
        },
        outcome_domain={"response": ["Correct", "Incorrect"]}, stim_selection_method="min_entropy",
        param_estimation_method="mean",
    )  # fmt: skip
    t, b, lapse = (x.ravel() for x in np.meshgrid(thresholds_, slopes, lapses, indexing="ij"))
    right = 1 - lapse - (1 - 1 / 3 - lapse) * np.exp(-(10.0 ** (b * (levels[:, None] - t) / 20)))
    table = QuestTable(right, np.ones(len(t)))
    posterior = table.prior
    for _ in range(30):
        at = int(table.best(posterior))
        assert levels[at] == theirs.next_stim["intensity"]
        answer = bool(rng.random() < 0.75)
        posterior = table.updated(posterior, at, answer)
        theirs.update(stim=theirs.next_stim, outcome={"response": "Correct" if answer else "Incorrect"})
    assert float(posterior @ t) == pytest.approx(theirs.param_estimate["threshold"], abs=1e-9)


def test_a_track_of_quest_plus_is_that_of_many_at_once() -> None:
    page = StaircasePage.model_validate(GUIDE)
    (levels,), (right,) = simulations.trials(page, np.array([1.6]), np.array([2.0]), 0.02, np.random.default_rng(1))
    track = QuestTrack(page)
    for level, answer in zip(levels, right, strict=True):
        assert track.level == pytest.approx(level, rel=1e-9)
        assert track.step_after(bool(answer)) in {float(f"{math.exp(u):.10g}") for u in table_of(page)[0]}
        track.answer(bool(answer))
    assert track.done


@pytest.mark.parametrize(
    "page", [pytest.param(GUIDE, marks=pytest.mark.slow), GUIDE | LEVITT], ids=["QUEST+", "Levitt"]
)
def test_thresholds_are_without_bias(page: dict) -> None:
    people = simulations.Population(5.0, 0.25, 2.0)
    found = studies.threshold_rates(np.random.default_rng(3), 25, 12, StaircasePage.model_validate(page), people)
    assert abs(found.bias_mean) < 0.09  # the standard error is 2.5 %
    assert found.coverage_mean >= 0.84
    assert 0.90 < found.coverage_listener < 0.99


@pytest.mark.validate
@pytest.mark.parametrize("slope", [2.0, 4.0])
def test_thresholds_of_the_guide_hold_bias_and_coverage(slope: float) -> None:
    people, page = simulations.Population(5.0, 0.25, slope), StaircasePage.model_validate(GUIDE)
    found = [studies.threshold_rates(np.random.default_rng(seed), 67, 12, page, people) for seed in (1, 2, 3)]
    mean, coverage, own, each = np.mean(
        [(x.bias_mean, x.coverage_mean, x.bias_listener, x.coverage_listener) for x in found], axis=0
    )
    assert abs(mean) <= 0.05
    assert abs(own) <= 0.05
    assert 0.93 <= each <= 0.97
    assert 0.93 - 0.018 <= coverage <= 0.97 + 0.012  # a standard error of 201 experiments beyond


@pytest.mark.slow
def test_reversals_are_corrected() -> None:
    """Their mean was 23 to 61 % too high."""
    page, rng = StaircasePage.model_validate(GUIDE | LEVITT), np.random.default_rng(7)
    raw, corrected = [], []
    for _ in range(12):
        true = math.log(5.0) + 0.25 * rng.standard_normal(12)
        levels, right = simulations.trials(page, true, np.full(12, 1.5), 0.02, rng)
        rows = [
            {"listener": str(i), "index": j, "track": 0, "level": x, "right": r}
            for i in range(12) for j, (x, r) in enumerate(zip(levels[i], right[i], strict=True))
        ]  # fmt: skip
        found = thresholds(rows, page, "%", 0.95)
        for one, t in zip(found.listeners, true, strict=True):
            if one.reversals is not None:
                corrected.append(math.log(one.reversals) - t)
                raw.append(corrected[-1] + math.log(found.correction))
    assert np.mean(raw) > 0.2
    assert abs(np.mean(corrected)) < 0.12


def test_pooled_sensitivity_is_that_of_the_population() -> None:
    ours, together, coverage = studies.sensitivity_rates(np.random.default_rng(1), 150, 20, 20, "more_2", 2.5, 0.8)
    assert abs(ours) < 0.05
    assert together < -0.08
    assert coverage > 0.9
    rng = np.random.default_rng(2)
    d, k = np.maximum(1.8 + 0.6 * rng.standard_normal(30), 0), 1.4 + 0.5 * rng.standard_normal(30)
    hit = stats.norm.cdf((d - k) / math.sqrt(2)) + stats.norm.cdf((-d - k) / math.sqrt(2))
    alarm = np.minimum(2 * stats.norm.cdf(-k / math.sqrt(2)), 1.0)
    hits, alarms, n = rng.binomial(40, hit), rng.binomial(40, alarm), np.full(30, 40)
    value, low, high = pooling.pooled_same_different(hits, n, alarms, n, 0.95)
    assert low < 1.8 < high
    assert value == pytest.approx(1.8, abs=0.3)
    all_right = np.array([20.0, 20.0, 20.0, 12.0])  # the mean of single d' is infinite
    assert pooling.pooled(all_right, np.full(4, 20.0), shares_of("more_2"), 0.95)[0] < 8
    assert math.isinf(sensitivity(1.0, "more_2"))


def test_shares_of_preference_do_not_depend_on_the_scale(rng: np.random.Generator) -> None:
    y = rng.normal(60, 10, (10, 2, 3)) + np.array([0, 8])[:, None]
    ranks = rank_analysis(rows_of(y), ("f",)).superiority[0]
    bent = rank_analysis(rows_of(np.exp(y / 5)), ("f",)).superiority[0]
    assert (ranks.share, ranks.p_value) == (bent.share, bent.p_value)
    assert models.share_interval(np.zeros(14), 0.95) == pytest.approx((0, 0, stats.beta.ppf(0.975, 1, 14), 2.0**-13))
    by_hand = np.mean([[[b > a for a in own[0]] for b in own[1]] for own in y])
    assert ranks.share == pytest.approx(by_hand)


def test_bradley_terry_counts_listeners_not_answers() -> None:
    """Each of ten listeners gives one answer twenty times over: nearly as sure as ten answers (one tie is added)."""
    rows = [{"listener": str(i), "f": "x|y", "value": float(i < 7)} for i in range(10)]
    few, many = (bradley_terry(rows * k, "f", 0.95)[1] for k in (1, 20))
    assert many.high - many.low == pytest.approx(few.high - few.low, rel=0.15)


def test_the_first_lines_say_difference_certainty_and_unit(tmp_path: Path) -> None:
    pages = [
        {"type": "mushra", "group_by": ["damping"], "reference": {"pluck": "near"}, "anchors": [3500]},
        fakes.STAIRS,
        {"type": "abx", "pairs": {"pluck": ["near", "far"]}, "times": 6},
    ]
    test = fakes.made(tmp_path, pages)
    heard = panel(
        ratings={"pluck": {"far": -20.0}}, d_prime={"pluck": {"far": 2.0}},
        thresholds={"2": {"mean": 0.25, "sd": 1.2, "slope": 4.0}},
    )  # fmt: skip
    simulate(test, heard, 16, seed=3)
    found = analyse(tmp_path / "out")
    lines = summary(found)
    far = next(line for line in lines if "far is rated" in line)
    assert "points below near (body.detune 1.01 against 1" in far
    assert "just-noticeable differences" in far  # 1 % of a threshold near 0.25 %
    times = float(far.split("1.01 against 1, ")[1].split(" just")[0])
    assert times == pytest.approx(1.0 / found.pages[1].thresholds.mean, rel=0.05)
    assert any("the just-noticeable difference is 0.2" in line for line in lines)
    assert any("are told apart" in line and "d' =" in line for line in lines)
    assert "Levitt" in methods(found)


@pytest.mark.slow
def test_a_scale_that_ends_is_told(tmp_path: Path) -> None:
    scale = {"name": "dry", "label": "Dry", "low": 0.0, "high": 10.0}
    test = fakes.made(tmp_path, [{"type": "rating", "scales": [scale, scale | {"name": "o", "ordinal": True}]}])
    simulate(test, panel(ratings={"damping": {"block": 9.0}}, residual_sd=2.0), 12, seed=3)
    found = analyse(tmp_path / "out")
    lines = summary(found)
    assert any("stand at an end of the scale" in line for line in lines)
    assert any("in 9" in line and "of comparisons" in line for line in lines)
    assert any("grades have an order" in line for line in lines)
    assert any("the odds of a higher rating are" in line for line in lines)
    assert "cumulative logit" in methods(found)


@pytest.mark.parametrize(("kind", "shape"), [(CrossedFit, (2, 6, 5, 3)), (IncompleteFit, (2, 6, 3))])
def test_experiments_in_front_are_each_by_itself(
    kind: type[CrossedFit | IncompleteFit], shape: tuple[int, ...]
) -> None:
    y = np.random.default_rng(8).normal(50.0, 9.0, shape)
    y[..., 0, 1] = y[0, 3, ..., 2] = np.nan
    x = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [1.0, -1.0, -1.0]])
    contrasts, _ = np.linalg.qr(np.array([[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]))
    both = astuple(kind(y, x).tested(contrasts))
    for i in range(2):
        for whole, one in zip(both, astuple(kind(y[i], x).tested(contrasts)), strict=True):
            np.testing.assert_allclose(np.asarray(whole)[i], one, rtol=1e-9)
