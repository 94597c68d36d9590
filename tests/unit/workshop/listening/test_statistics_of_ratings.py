"""Models of ratings: false alarms, coverage, and values of other programs."""

from __future__ import annotations

import math
from dataclasses import astuple

import listening_fakes as fakes
import listening_studies as studies
import numpy as np
import pytest
from published import DRUGS, HOUSING, MACHINES, RATINGS, SLEEP
from scipy import stats
from statistics_rows import rows_of

from tonewood.workshop.batch.manifest import ManifestError, check_manifest
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.incomplete import CrossedFit, IncompleteFit
from tonewood.workshop.listening.models import linear_analysis
from tonewood.workshop.listening.ordinal import clustered, fit_counts, grades, ordinal_analysis


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
