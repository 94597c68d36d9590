"""Values of the analysis and of the course of a test against figures worked out by hand."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import listening_fakes as fakes
import numpy as np
import pyarrow.parquet as pq
import pytest
from listening_studies import NULLS, graded, ratings, without
from scipy import optimize, special, stats

from tonewood.sound.level.loudness import loudest
from tonewood.workshop.batch.pages import LevelPage, MushraPage, PairedPage, RatingPage, StaircasePage
from tonewood.workshop.batch.pages import localised as in_language
from tonewood.workshop.listening.answer_file import _lines_after_the_first, listener_of, place_of, printable
from tonewood.workshop.listening.cells import cells_of, shared
from tonewood.workshop.listening.checked_answer import checked, choices, share_wanted
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial
from tonewood.workshop.listening.detection import Detection, adjusted, detections, sensitivity, share_right, task_of
from tonewood.workshop.listening.figures import figures_of
from tonewood.workshop.listening.headphones import ramped
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.means import cell_means, listener_means, screen, student_interval
from tonewood.workshop.listening.models import (
    END_SHARE,
    LinearAnalysis,
    ModelTerm,
    RankAnalysis,
    ScaleValue,
    Superiority,
    bradley_terry,
    linear_analysis,
    rank_analysis,
    share_interval,
    share_test,
)
from tonewood.workshop.listening.on_demand import RenderedPairs
from tonewood.workshop.listening.ordinal import (
    OddsTerm,
    OrdinalAnalysis,
    clustered,
    fit_counts,
    grades,
    ordinal_analysis,
)
from tonewood.workshop.listening.panel import PanelThreshold, SimulatedPanel, _Listener, _reply, _rule
from tonewood.workshop.listening.plain import (
    _as_level,
    _cells,
    _detected,
    _difference,
    _in_unit,
    _number,
    _of_page,
    _p,
    _scalar,
    _threshold,
    _value,
    methods,
    summary,
)
from tonewood.workshop.listening.pooling import D, pooled
from tonewood.workshop.listening.power import (
    _levels,
    _pilot_means,
    _pilot_spread,
    _sounds,
    _staircase,
    _trials,
    power_of,
)
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.quest import LEVELS, QuestTable, QuestTrack, table_of
from tonewood.workshop.listening.report import p_text
from tonewood.workshop.listening.results import (
    PageResults,
    PanelResults,
    _difference_grades,
    _in_order,
    _share,
    _used,
    levels_of,
    write_tables,
)
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.shown import _details, kind_of_texts, shown
from tonewood.workshop.listening.simulated_power import (
    TooManyListenersError,
    _batches,
    answers_for_share,
    fewest,
    screened_found,
    stated_spread,
)
from tonewood.workshop.listening.simulations import trials
from tonewood.workshop.listening.staircase import StaircaseTrack
from tonewood.workshop.listening.table import AnswerTable, Key, KeySound, _cell, _listener_names, tidy
from tonewood.workshop.listening.thresholds import (
    ListenerThreshold,
    ThresholdGrid,
    Thresholds,
    quantile,
    thresholds,
    track_of,
)
from tonewood.workshop.listening.trials import Step

LEVITT = StaircasePage.model_validate(fakes.STAIRS)
LINEAR = StaircasePage.model_validate(
    {"type": "staircase", "path": "body.t60", "scale": "add", "start": 4.0, "lowest": 0.0, "highest": 10.0,
     "steps": [2.0, 1.0], "reversals": 4, "discard": 1, "longest": 30, "down": 2, "intervals": 2}
)  # fmt: skip


def row(listener: str, value: float | None, **other: Any) -> dict[str, Any]:
    return {"listener": listener, "value": value, "role": "sound", "trial": "1", "repetition": 1, **other}


# -- means, cells and models ------------------------------------------------------------------------------------------


def test_quartiles_are_of_answers_and_means_of_listeners() -> None:
    rows = [row("a", v, f="x", g=1) for v in (10, 20, 30)] + [row("b", 60, f="x", g=1), row("c", None, f="x", g=1)]
    rows += [row("a", 5, f="y", g=1)]
    x, y = cell_means(rows, ("g", "f"), 0.9)
    assert (x.label, x.listeners, x.answers, x.mean) == ("g=1, f=x", 2, 4, 40.0)
    assert (x.lower_quartile, x.median, x.upper_quartile) == (17.5, 25.0, 37.5)
    half = stats.t.ppf(0.95, 1) * math.sqrt(800) / math.sqrt(2)
    assert (x.low, x.high) == pytest.approx((40 - half, 40 + half))
    assert (y.mean, y.low, y.high) == (5.0, None, None)
    assert student_interval([3.0], 0.95) == (3.0, None, None)


@pytest.mark.parametrize(
    ("role", "value", "bad", "trials", "reason"),
    [
        ("reference", 89.9, 4, 20, "hidden reference below 90 in 4 of 20 trials"),
        ("reference", 89.9, 3, 20, ""),  # 15 % is not more
        ("reference", 90.0, 9, 20, ""),
        ("anchor70", 90.1, 4, 20, "mid anchor above 90 in 4 of 20 trials"),
        ("anchor70", 90.1, 3, 20, ""),
        ("anchor70", 90.0, 9, 20, ""),
        ("anchor35", 100.0, 9, 20, ""),
    ],
)
def test_listeners_are_screened_at_15_percent(role: str, value: float, bad: int, trials: int, reason: str) -> None:
    usual = {"reference": 100.0, "anchor70": 40.0, "anchor35": 20.0}[role]
    rows = [
        row(who, value if who == "x" and k < bad else usual, role=role, trial=str(k), repetition=rep)
        for who in "xabcd" for k in range(trials // 2) for rep in (1, 2)
    ]  # fmt: skip
    changed = [r for r in rows if r["listener"] == "x"]
    for k, r in enumerate(changed):
        r["value"] = value if k < bad else usual
    assert [(one.listener, one.reason) for one in screen(rows)] == ([("x", reason)] if reason else [])


@pytest.mark.parametrize(("easy", "counts"), [(1, True), (2, False)])
def test_a_trial_that_more_than_a_quarter_take_for_good_does_not_count(easy: int, counts: bool) -> None:
    rows = [row(f"{k}", 95 if k < easy else 50, role="anchor70") for k in range(4)]
    assert bool(screen(rows)) is counts


def test_cells_are_of_levels_that_several_listeners_rated() -> None:
    rows = [row(who, v, a=a, b="k") for who, a, v in
            (("1", "x", 1), ("2", "x", 3), ("3", "x", 5), ("1", "y", 2), ("2", "y", 8), ("3", "z", 9))]  # fmt: skip
    left, single = shared(rows, ["a"])
    assert (single, len(left)) == (("a=z",), 5)
    data = cells_of(rows, ["a", "b"], {"a": ["y", "x", "z"], "b": ["k"]}, [])
    assert data is not None
    assert (data.cells, data.used, data.sampled, data.complete) == ([("y",), ("x",)], ["a"], (), False)
    assert data.single == ("a=z",)
    np.testing.assert_allclose(data.means[:, 0], [[2, 1], [8, 3], [np.nan, 5]])
    # within cells: (1, 3, 5) and (2, 8): squares 8 + 18 over 5 answers less 2 cells
    assert data.cell_sd() == pytest.approx(math.sqrt(26 / 3))
    assert cells_of(rows, ["b"], {"b": ["k"]}, []) is None
    assert cells_of([r for r in rows if r["listener"] != "3"], ["a"], {"a": ["y", "x"]}, []) is None
    sampled = cells_of([r | {"b": r["listener"]} for r in rows[:5]], ["a", "b"], {"a": ["x", "y"]}, ["b"])
    assert sampled is not None
    assert (sampled.sampled, sampled.means.shape) == (("b",), (3, 3, 2))


def test_bradley_terry_of_one_listener_has_the_error_of_a_logit() -> None:
    """Of n choices and one tie: value logit(p) / 2 each way, error of logit(p) 1 / sqrt((n + 1) p q)."""
    rows = [row("a", float(i < 14), f="x|y") for i in range(19)]
    p = 14.5 / 20
    x, y = bradley_terry(rows, "f", 0.9)
    logit = math.log(p / (1 - p))
    half = stats.norm.ppf(0.95) / math.sqrt(20 * p * (1 - p)) / 2
    assert (x.level, y.level) == ("x", "y")
    assert (x.value, y.value) == pytest.approx((-logit / 2, logit / 2), rel=1e-5)
    assert (y.low, y.high) == pytest.approx((logit / 2 - half, logit / 2 + half), rel=1e-4)
    turned = bradley_terry([r | {"f": "y|x", "value": 1 - r["value"]} for r in rows], "f", 0.9)
    assert {s.level: s.value for s in turned} == pytest.approx({"x": x.value, "y": y.value}, rel=1e-9)


def test_ranks_of_pairs_are_those_by_hand() -> None:
    """Changes 1, -2, 3, 4 of one listener each: ranks 1 + 3 + 4 - 2 of 10; above in 3 of 4."""
    rows = [row(str(i), 50.0, f="a") for i in range(4)]
    rows += [row(str(i), 50.0 + d, f="b") for i, d in enumerate((1, -2, 3, 4))]
    found = rank_analysis(rows, ("f",))
    (pair,) = found.pairs
    assert (pair.first, pair.second, pair.listeners, pair.r) == ("a", "b", 4, 0.6)
    assert pair.p_value == pair.p_holm == pytest.approx(stats.wilcoxon([1, -2, 3, 4]).pvalue)
    (one,) = found.superiority
    assert (one.share, one.listeners) == (0.75, 4)
    t = stats.ttest_1samp([1, 0, 1, 1], 0.5)
    assert one.p_value == pytest.approx(t.pvalue)
    interval = t.confidence_interval(0.95)
    assert (one.low, one.high) == pytest.approx((max(interval.low, 0), min(interval.high, 1)))
    assert found.tests == ()  # Friedman's test is of three levels and more
    assert rank_analysis(rows[:2] + rows[4:6], ("f",)).pairs == ()
    equal = rank_analysis([r | {"value": 1.0} for r in rows], ("f",)).pairs[0]
    assert (equal.p_value, equal.r) == (1.0, 0.0)


def test_friedman_and_kendall_of_three_levels() -> None:
    """Ranks 1 2 3 of all five listeners: chi^2 = n (k - 1) = 10, W = 1; then one listener turned round."""
    rows = [row(str(i), float(10 * i + j), f=f) for i in range(5) for j, f in enumerate("abc")]
    (test,) = rank_analysis(rows, ("f",)).tests
    assert (test.statistic, test.df, test.effect) == pytest.approx((10.0, 2, 1.0))
    turned = [r | {"value": -r["value"]} if r["listener"] == "0" else r for r in rows]
    (test,) = rank_analysis(turned, ("f",)).tests
    sums = np.array([4 * 1 + 3, 5 * 2, 4 * 3 + 1])
    assert test.statistic == pytest.approx(12 / (5 * 3 * 4) * np.sum(sums**2) - 3 * 5 * 4)
    assert test.effect == pytest.approx(test.statistic / 10)


def test_ranks_compare_levels_where_all_else_is_equal(rng: np.random.Generator) -> None:
    """Half of the listeners did not rate b on the score that everybody rates 30 points higher: p was below 0.01."""
    values = np.arange(64.0) % 7 + 50
    rng.shuffle(values)
    of = {(who, s, d): values[4 * who + 2 * k + j] + 30 * k for who in range(16)
          for k, s in enumerate("lh") for j, d in enumerate("ab")}  # fmt: skip
    kept = {k: v for k, v in of.items() if k[0] % 2 == 0 or k[1:] != ("h", "b")}
    ranks = rank_analysis([row(str(who), v, s=s, d=d) for (who, s, d), v in kept.items()], ("d", "s"))
    change = [np.mean([of[w, s, "b"] - of[w, s, "a"] for s in ("lh" if w % 2 == 0 else "l")]) for w in range(16)]
    (pair,) = (one for one in ranks.pairs if one.factor == "d")
    assert (pair.listeners, pair.p_value) == (16, pytest.approx(stats.wilcoxon(np.round(change, 9)).pvalue))
    assert pair.p_value > 0.05


def test_rounding_errors_have_no_rank() -> None:
    """0.1 + 0.2 + 0.3 is not 0.3 + 0.2 + 0.1: ten listeners without a difference had p = 0.002."""
    rows = [
        row(str(who), v, s=str(k), d=d)
        for who in range(10)
        for d, own in (("a", (0.1, 0.2, 0.3)), ("b", (0.3, 0.2, 0.1)))
        for k, v in enumerate(own)
    ]
    (pair,) = (one for one in rank_analysis(rows, ("d", "s")).pairs if one.factor == "d")
    assert (pair.p_value, pair.r) == (1.0, 0.0)


@pytest.mark.parametrize(("name", "read"), [("page", False), ("value", False), ("type", True)])
def test_answers_to_a_factor_that_hides_a_column_are_not_analysed(name: str, read: bool) -> None:
    sounds = {code: KeySound(condition=code, levels={name: code}) for code in "ab"}
    key = Key.model_construct(factors=[name], levels={name: ["a", "b"]}, stimuli=sounds)
    test: Any = SimpleNamespace(trials=())
    if read:
        assert tidy(test, key, []).factors == (name,)
    else:
        with pytest.raises(ListeningError, match=f"factors: {name} is a column of the table of answers"):
            tidy(test, key, [])


def test_means_of_listeners_take_one_pass() -> None:
    """The time grew with the square of the number of listeners: of 10 000 the means took hours."""

    class Passes(list[dict[str, Any]]):
        count = 0

        def __iter__(self) -> Iterator[dict[str, Any]]:
            self.count += 1
            return super().__iter__()

    rows = Passes({"listener": str(k % 50), "value": float(k)} for k in range(100))
    assert listener_means(rows) == {str(k): k + 25.0 for k in range(50)}
    assert rows.count <= 2


def test_shares_are_tested_against_a_half() -> None:
    y = np.array([[0.2, 0.4, 0.9, 0.6], [0.7, 0.7, 0.7, 0.7], [0.5, 0.5, 0.5, 0.5]])
    found = share_test(y)
    assert found == pytest.approx([stats.ttest_1samp(y[0], 0.5).pvalue, 2 * 0.5**4, 1.0])
    mean, low, high, p = share_interval(np.full(4, 0.7), 0.95)
    unseen = 1 - 0.025 ** (1 / 4)
    assert (mean, low, high, p) == pytest.approx((0.7, 0.7 * (1 - unseen), 0.7 + 0.3 * unseen, 0.125))
    assert share_interval(np.array([0.0, 1.0, 1.0]), 0.95)[1:3] == (0.0, 1.0)


def test_answers_at_the_ends_and_sizes_of_effects(rng: np.random.Generator) -> None:
    y = np.round(np.clip(rng.normal(60, 20, (6, 2, 3)), 0, 100))
    y[0, 0, 0], y[1, 1, 1] = 0.0, 100.0
    rows = [row(str(i), y[i, j, k], f="ab"[j]) for i in range(6) for j in range(2) for k in range(3)]
    found = linear_analysis(rows, ["f"], 0.95, {"f": ["b", "a"]}, ends=(0.0, 100.0))
    assert found is not None
    assert found.at_ends == pytest.approx(np.mean((y == 0) | (y == 100)))
    (term,) = found.terms
    assert (term.name, term.effect) == ("f=a", ("f",))
    assert term.difference == pytest.approx(y[:, 0].mean() - y[:, 1].mean())
    sd = math.sqrt(np.sum((y - y.mean(axis=(0, 2), keepdims=True)) ** 2) / (36 - 2))
    assert term.cohens_d == pytest.approx(term.difference / sd)
    assert (found.answers, found.listeners, found.formula, found.exact) == (36, 6, "value ~ f", True)
    assert linear_analysis(rows, ["f"], 0.95, {"f": ["a", "b"]}).at_ends is None  # type: ignore[union-attr]
    for a, b, d in ((0.3, 0.1, -math.inf), (0.1, 0.3, math.inf), (0.1, 0.1, 0.0)):  # without any spread it was 0
        rows = [row(str(i), {"a": a, "b": b}[f], f=f) for i in range(7) for f in "ab"]
        assert linear_analysis(rows, ["f"], 0.95, {"f": ["a", "b"]}).terms[0].cohens_d == d  # type: ignore[union-attr]


# -- detection --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("page", "task"),
    [
        ({"type": "ab", "pairs": {"f": "all"}}, "same"),
        ({"type": "abx", "pairs": {"f": "all"}}, "abx"),
        ({"type": "afc", "pairs": {"f": "all"}}, "odd_3"),
        ({"type": "afc", "pairs": {"f": "all"}, "intervals": 2}, "abx"),
        ({"type": "afc", "pairs": {"f": "all"}, "intervals": 2, "question": "?"}, "more_2"),
        ({"type": "afc", "pairs": {"f": "all"}, "question": "?"}, "more_3"),
        ({"type": "paired_comparison", "pairs": {"f": "all"}, "question": "?"}, None),
    ],
)
def test_tasks_of_pages(page: dict[str, Any], task: str | None) -> None:
    from tonewood.workshop.batch.pages import AbPage, AbxPage, AfcPage

    kinds: dict[str, Any] = {"ab": AbPage, "abx": AbxPage, "afc": AfcPage, "paired_comparison": PairedPage}
    assert task_of(kinds[page["type"]].model_validate(page)) == task


def test_shares_of_a_listener_have_exact_intervals() -> None:
    """Clopper and Pearson by the beta distribution; d' of two intervals is sqrt(2) Phi^-1(p)."""
    rows = [row("a", float(i < 15), right=i < 15) for i in range(20)] + [row("a", None, right=None)]
    (one,) = detections([r | {"f": "x|y"} for r in rows], ("f",), "more_2", 0.9)
    assert (one.cell, one.listeners, one.right, one.answers, one.undecided) == ({"f": "x|y"}, 1, 15, 20, 1)
    bounds = stats.beta.ppf(0.05, 15, 6), stats.beta.ppf(0.95, 16, 5)
    assert (one.share, one.low, one.high) == pytest.approx((0.75, *bounds))
    assert one.p_value == pytest.approx(stats.binom.sf(14, 20, 0.5))
    expected = [math.sqrt(2) * stats.norm.ppf(p) for p in (0.75, *bounds)]
    assert (one.d_prime, one.d_low, one.d_high) == pytest.approx(expected, rel=1e-6)
    assert (one.listener_mean, one.listener_low) == (0.75, None)
    (nobody,) = detections([row("a", None, f="x")], ("f",), "abx", 0.95)
    assert (nobody.share, nobody.p_value, nobody.undecided) == (None, None, 1)
    both = adjusted([one, nobody, replace(one, p_value=0.03)])
    p = one.p_value or 0.0
    assert p < 0.03 < 2 * p
    assert [d.p_holm for d in both] == [2 * p, None, 2 * p]


@pytest.mark.parametrize("task", ["more_2", "more_3", "odd_3", "abx", "same"])
def test_sensitivity_is_the_inverse_of_the_share(task: Any) -> None:
    for d in (0.3, 1.0, 2.5):
        assert sensitivity(share_right(d, task), task) == pytest.approx(d, rel=1e-6)
    assert sensitivity(0.1, task) == 0.0


def test_the_share_of_an_unbiased_listener_says_same_or_different() -> None:
    """At the best criterion of a grid of them."""
    k = np.linspace(0, 6, 4001)
    d = 1.8
    hit = stats.norm.cdf((d - k) / math.sqrt(2)) + stats.norm.cdf((-d - k) / math.sqrt(2))
    assert share_right(d, "same") == pytest.approx(
        np.max((hit + 1 - 2 * stats.norm.cdf(-k / math.sqrt(2))) / 2), abs=1e-6
    )


def test_the_population_of_many_like_listeners_has_their_sensitivity() -> None:
    shares = np.array([share_right(float(d), "more_2") for d in D])
    right = round(400 * share_right(1.5, "more_2"))
    value, low, high = pooled(np.full(12, right), np.full(12, 400), shares, 0.95)
    assert value == pytest.approx(1.5, abs=0.06)
    assert low < 1.5 < high  # type: ignore[operator]
    wide = pooled(np.full(12, right), np.full(12, 400), shares, 0.999)
    assert wide[1] <= low
    assert pooled(np.full(3, 9), np.full(3, 9), shares, 0.95)[2] is None  # always right: no upper bound


# -- grades, psychometric functions, staircases -----------------------------------------------------------------------


def test_twenty_grades_are_kept_and_more_are_grouped() -> None:
    values = np.arange(20.0)
    assert grades(values, None).tolist() == list(range(20))
    more = grades(np.arange(200.0), None)
    assert more.max() == 17
    assert (np.bincount(more) >= 10).all()
    ends = grades(np.r_[np.zeros(3), np.arange(1.0, 200.0), np.full(2, 200.0)], (0.0, 200.0))
    assert (np.bincount(ends)[[0, -1]] == [3, 2]).all()
    assert ends.max() == 19


def test_odds_of_two_cells_of_two_grades_are_the_ratio_of_counts() -> None:
    """Half an answer, distributed as all are, is added to each cell."""
    counts = np.array([[30.0, 10.0], [16.0, 24.0]])
    beta, alpha, done = fit_counts(counts, np.array([[0.0], [1.0]]))
    share = counts.sum(axis=0) / counts.sum()
    a, b = counts + 0.5 * share
    assert done
    assert beta[0] == pytest.approx(math.log(b[1] / b[0]) - math.log(a[1] / a[0]), rel=1e-6)
    assert alpha[0] == pytest.approx(math.log(a[0] / a[1]), rel=1e-6)


@pytest.mark.parametrize(
    "counts",
    [
        [[0.0, 4.0, 0.0], [1.0, 0.0, 31.0]], [[0.0, 0.0, 11.0], [0.0, 0.0, 23.0], [4.0, 1.0, 0.0]],
        [[5.0, 2.0, 0.0], [0.0, 0.0, 27.0]], [[3.0, 5.0, 2.0], [1.0, 4.0, 7.0]],
    ],
)  # fmt: skip
def test_odds_of_extreme_tables_are_those_of_maximum_likelihood(counts: list[list[float]]) -> None:
    """Each table alone and in a stack; whole steps of Fisher's scoring leave the first two for good."""
    x, table = np.eye(len(counts))[:, 1:], np.array(counts)
    cells, n = len(x), table + 0.5 * table.sum(axis=0) / table.sum()

    def unlikely(v: np.ndarray) -> float:
        cuts = np.array([v[0], v[0] + np.exp(v[1])])
        f = special.expit(cuts - (x @ v[2:])[:, None])
        return -float(np.sum(n * np.log(np.diff(np.c_[np.zeros(cells), f, np.ones(cells)]))))

    best = optimize.minimize(unlikely, np.zeros(1 + cells), method="BFGS", options={"gtol": 1e-8}).x
    beta, alpha, done = fit_counts(np.array([table, table[::-1]]), x)
    assert done.tolist() == [True, True]
    np.testing.assert_allclose(beta[0], best[2:], atol=1e-4)
    np.testing.assert_allclose(alpha[0], [best[0], best[0] + np.exp(best[1])], atol=1e-4)
    last = beta[1, -1]  # the other way round, odds are those of the last cell
    np.testing.assert_allclose(np.r_[0.0, beta[1]], last + np.r_[0.0, best[2:]][::-1], atol=1e-4)


@pytest.mark.parametrize(
    ("u", "p"), [(0.0, 0.75), (1e9, 0.96), (-1e9, 0.5), (0.5, None)]
)  # at the threshold the share; far above 1 - lapses, far below the guesses
def test_a_psychometric_function_at_its_threshold_and_its_ends(u: float, p: float | None) -> None:
    found = psychometric(u, 0.0, 2.0, 0.5, 0.75, 0.04)
    q = (0.75 - 0.5) / (1 - 0.5 - 0.04)
    by_hand = 0.5 + 0.46 / (1 + math.exp(-min(max(2.0 * u, -700), 700) - math.log(q / (1 - q))))
    assert found == pytest.approx(by_hand if p is None else p, rel=1e-9)


def test_a_staircase_goes_step_by_step() -> None:
    """Two right answers lower the level by 2, and by 1 after two reversals; a wrong one raises it."""
    track = StaircaseTrack(LINEAR)
    answers = (1, 1, 1, 0, 1, 1, 0, 0, 1, 1)
    seen = []
    for right in answers:
        assert not track.done
        ahead = track.step_after(bool(right))
        seen.append(track.level)
        track.answer(bool(right))
        assert track.level == ahead
    # right at 4 4, wrong at the second 2, right at 4 4, now by steps of 1, wrong at 3 and 4, right at 5 5
    assert seen == [4, 4, 2, 2, 4, 4, 3, 4, 5, 5]
    assert track.reversal_levels == [2, 4, 3, 5]
    assert (track.done, track.converged) == (True, True)
    assert track.threshold == pytest.approx((4 + 3 + 5) / 3)
    assert (track.levels, track.right) == (seen, [bool(x) for x in answers])
    long = StaircaseTrack(LINEAR.model_copy(update={"longest": 5}))
    for _ in range(5):
        long.answer(True)
    assert (long.done, long.converged, long.threshold) == (True, False, None)
    ratio = StaircaseTrack(LEVITT)
    ratio.answer(False)
    assert ratio.level == 10.0  # not above the highest
    assert LEVITT.mean([1.0, 4.0]) == pytest.approx(2.0)


def test_tracks_are_of_the_page_s_method() -> None:
    quest = StaircasePage.model_validate(
        {"type": "staircase", "path": "a.b", "start": 40.0, "ratio": True, "lowest": 0.5, "highest": 80.0, "trials": 10}
    )
    assert isinstance(track_of(LEVITT), StaircaseTrack)
    track = track_of(quest)
    assert isinstance(track, QuestTrack)
    u, table = table_of(quest)
    np.testing.assert_allclose(u, np.linspace(math.log(0.5), math.log(80), LEVELS))
    assert abs(math.log(track.level / 40.0)) <= (u[1] - u[0]) / 2
    for k in range(10):
        assert track.done is (k >= 10)
        track.answer(True)
    assert (track.done, len(track.levels)) == (True, 10)
    assert track.levels[-1] < track.levels[0]
    assert table.right.shape == (41, 61 * 7 * 3)


def test_expected_entropies_are_those_by_hand() -> None:
    right, prior = np.array([[0.6, 0.9], [0.8, 0.8]]), np.array([1.0, 3.0])
    table = QuestTable(right, prior)

    def entropy(p: Any) -> float:
        return float(-np.sum(p * np.log(p)))

    expected = []
    for level in right:
        yes = float(level @ table.prior)
        up, down = table.prior * level / yes, table.prior * (1 - level) / (1 - yes)
        expected.append(yes * entropy(up) + (1 - yes) * entropy(down))
    np.testing.assert_allclose(table.entropies(table.prior), expected)
    assert table.best(table.prior) == 0
    np.testing.assert_allclose(table.updated(table.prior, 0, False), [0.25 * 0.4 / 0.175, 0.75 * 0.1 / 0.175])


def test_quantiles_of_a_density_lie_in_the_middle_of_its_points() -> None:
    x = np.array([0.0, 1.0, 2.0, 3.0])
    assert quantile(x, np.array([1.0, 1.0, 1.0, 1.0]), 0.5) == pytest.approx(1.5)
    assert quantile(x, np.array([0.0, 2.0, 2.0, 0.0]), 0.25) == pytest.approx(1.0)
    assert quantile(x, np.array([1.0, 1.0, 1.0, 1.0]), 0.0) == 0.0


def test_a_bound_beyond_the_levels_is_none() -> None:
    grid = ThresholdGrid(LEVITT)
    assert grid.bound(math.log(0.01)) == pytest.approx(0.01)
    assert grid.bound(math.log(0.5)) == pytest.approx(0.5)
    assert grid.bound(math.log(0.0099)) is None
    assert grid.bound(math.log(10.1)) is None
    assert (grid.u[0], grid.u[-1]) == pytest.approx((math.log(0.01) - grid.span / 4, math.log(10) + grid.span / 4))
    assert grid.guess == pytest.approx(1 / 3)


# -- power ------------------------------------------------------------------------------------------------------------


def test_answers_for_a_share_are_those_of_the_binomial_test() -> None:
    """From this number on, and not with one less, the power of the exact test stays above."""
    n = answers_for_share(0.75, 0.5, 0.05, 0.8)

    def reached(k: int) -> bool:
        least = next(r for r in range(k + 2) if stats.binom.sf(r - 1, k, 0.5) <= 0.05)
        return bool(stats.binom.sf(least - 1, k, 0.75) >= 0.8)

    assert not reached(n - 1)
    assert all(reached(k) for k in range(n, n + 30))
    with pytest.raises(ListeningError, match="not above guessing"):
        answers_for_share(0.5, 0.5, 0.05, 0.8)


@pytest.mark.parametrize("needed", [3, 4, 5, 17, 10_000])
def test_the_fewest_listeners_are_searched_for(needed: int) -> None:
    assert fewest(lambda n: 0.9 if n >= needed else 0.1, 0.9, "") == needed
    with pytest.raises(TooManyListenersError, match="more than 10000 listeners would be needed for it"):
        fewest(lambda n: 0.0, 0.5, "it")


def test_stated_spreads_are_halves_of_variances() -> None:
    listeners, sounds = stated_spread(12.0, 5.0, 6, 3)
    np.testing.assert_allclose(listeners, 36.0 * np.eye(3))
    np.testing.assert_allclose(sounds.sounds, 12.5 * np.eye(3))
    np.testing.assert_allclose(sounds.pairs, 6 * 36.0 * np.eye(3))
    assert sounds.count == 6


def test_an_effect_must_be_seen_with_and_without_those_left_out(rng: np.random.Generator) -> None:
    y = np.zeros((4, 8, 2)) + rng.normal(0, 0.1, (4, 8, 2))
    y[..., 1] += 5.0  # all differ
    y[1, :4, 1] -= 30.0  # half of them the other way
    kept = np.ones((4, 8), dtype=bool)
    kept[1, :4] = False
    kept[2, 2:] = False  # two are too few
    kept[3, 3:] = False
    assert screened_found(y, kept, 0.05)[:, 0].tolist() == [True, False, False, True]


def manifest(**choices: list[str]) -> Any:
    return SimpleNamespace(choices=lambda: choices, conditions=None, random=[], repeats=1)


def test_numbers_of_trials_levels_and_sounds() -> None:
    page = MushraPage.model_validate({"type": "mushra", "group_by": ["note"], "reference": {"damping": "a"}})
    whole = manifest(note=["x", "y", "z"], damping=["a", "b"], body=["k", "l"])
    assert _levels(whole, page) == 2
    assert _levels(manifest(body=["k", "l", "m"], damping=["a"]), page) == 3
    assert _levels(manifest(note=["x", "y"]), page) == 2  # nothing varies
    assert _trials(whole, page, 2, 1) == (3, 2)
    whole.repeats = 4
    assert _trials(whole, page, 2, 3) == (4, 2)
    assert _trials(whole, page.model_copy(update={"subset": 6}), 2, 1) == (6, 2)
    whole.random = ["body"]
    assert _trials(whole, page, 2, 2) == (6, 1)
    assert (_sounds(whole), _sounds(manifest())) == (2, 1)
    rows = [{"note": n, "damping": d, "body": "k"} for n in "xy" for d in "ab"]
    listed = SimpleNamespace(choices=whole.choices, conditions=rows, random=["note"], repeats=1)
    assert (_sounds(listed), _trials(listed, page, 2, 1)) == (2, (2, 1))


def test_means_of_a_pilot_are_of_listeners_who_have_all() -> None:
    rows = [row(who, 10 * i + j + 100 * k, d=d, n=n)
            for i, who in enumerate("pqrs") for j, d in enumerate("ab") for k, n in enumerate("xy")]  # fmt: skip
    rows = [r for r in rows if not (r["listener"] == "s" and r["n"] == "y")]
    rows += [row("p", None, d="a", n="x"), row("p", 999, d="a", n="x") | {"role": "anchor70"}]
    own = SimpleNamespace(factors=("n", "d"), rows=rows)
    means, who = _pilot_means(own, {"d": "b"}, ["n"])  # type: ignore[arg-type, misc]
    assert who == ["p", "q", "r"]
    assert means.tolist() == [[[10 * i + 1, 10 * i], [10 * i + 101, 10 * i + 100]] for i in range(3)]
    assert _pilot_means(SimpleNamespace(factors=("n",), rows=rows), {}, ["n"]) == (None, [])  # type: ignore[arg-type]
    few = SimpleNamespace(factors=("n", "d"), rows=[r for r in rows if r["listener"] != "r"])
    assert _pilot_means(few, {}, ["n"]) == (None, [])  # type: ignore[arg-type]
    covariance, spread = _pilot_spread(means[:, :1], 1)
    assert spread is None
    np.testing.assert_allclose(covariance, np.full((2, 2), 100.0))


def test_power_of_a_page_is_stated_with_its_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.listening.simulated_power.EXPERIMENTS", 100)
    pages = [
        {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "times": 2},
        {"type": "paired_comparison", "pairs": {"damping": ["complex", "block"]}, "question": "?", "expect": 0.8},
        {"type": "instructions"},
    ]
    test = fakes.made(tmp_path, pages)
    abx, choice = power_of(test.manifest, {0: 6, 1: 3})
    answers = answers_for_share(0.7, 0.5, 0.05, 0.8)
    assert (abx.page, abx.name, abx.listeners, abx.stated) == (1, "abx", math.ceil(answers / 6), False)
    d = sensitivity(0.7, "abx")
    assert abx.effect == f"70 % right, d' = {d:.2f}: {answers} answers, 6 a listener, over all cells"
    assert str(abx).endswith("over all cells (not stated by the page)")
    assert choice.stated
    assert choice.effect.startswith("80 % chosen: ")
    assert f": {3 * (choice.listeners or 0)} answers, 3 a listener" in choice.effect


# -- simulated listeners ----------------------------------------------------------------------------------------------


def simulated(**changes: Any) -> Any:
    """A listener without any spread of sounds r (the reference), s, an anchor."""
    given = {"schema": "tonewood-panel/1", "listener_sd": 0.0, "residual_sd": 0.0, **changes}
    levels = {"r": {"d": "a", "p": "x"}, "s": {"d": "b", "p": "y"}, "k": {"d": "a", "p": "x"}}
    sounds = {c: SimpleNamespace(levels=v, role="anchor35" if c == "k" else "sound") for c, v in levels.items()}
    trials = [SimpleNamespace(id="t", reference="r", stimuli=("s",))]
    test = SimpleNamespace(trials=trials)
    panel = SimulatedPanel.model_validate(given)
    return _Listener(panel, SimpleNamespace(stimuli=sounds), test, np.random.default_rng(1))  # type: ignore[arg-type]


def test_simulated_ratings_without_spread_are_the_effects() -> None:
    one = simulated(ratings={"d": {"b": -20.0}, "p": {"y": -5.0, "x": 2.0}}, interactions={"d=b, p=y": -3.0})
    slots = {"reference": "r", "A": "s", "B": "r", "C": "k"}
    assert one._mushra(slots) == {"A": 100.0 - 20 - 5 - 2 - 3, "B": 100.0, "C": 25.0}
    assert one._bs1116({"reference": "r", "A": "s", "B": "r"}) == {"A": 5 - 30 / 25, "B": 5.0}
    page = RatingPage.model_validate(
        {"type": "rating", "scales": [{"name": "q", "label": "Q", "low": 0.0, "high": 60.0}]}
    )
    session = SimpleNamespace(step=Step(0, 0, "t", {"A": "s"}), page=page, page_index=0)
    assert one.answer(session)["values"] == {"q": 30.0 - 28.0}
    assert _rule("d=b, p = y") == {"d": "b", "p": "y"}


def test_simulated_choices_follow_positions_and_thresholds() -> None:
    sure = simulated(d_prime={"d": {"b": 40.0}}, preference={"d": {"b": 60.0}}, thresholds={})
    step = Step(0, 0, "t", {"A": "r", "B": "s", "X": "s"}, "B")
    pages = {p["type"]: p for p in fakes.ALL}
    from tonewood.workshop.batch.pages import AbPage, AbxPage

    abx = AbxPage.model_validate({**pages["abx"], "pairs": {"d": "all"}})
    ab = AbPage.model_validate({**pages["ab"], "pairs": {"d": "all"}})
    paired = PairedPage.model_validate({**pages["paired_comparison"], "pairs": {"d": "all"}})
    for _ in range(20):
        assert sure._judged(abx, step, ["A", "B", "undecided"]) == "B"
        assert sure._judged(ab, replace(step, correct="different"), ["same", "different"]) == "different"
        assert sure._judged(ab, replace(step, correct="same"), ["same", "different"]) == "same"
        assert sure._judged(paired, step, ["A", "B"]) == "B"
        assert sure._judged(paired, replace(step, slots={"A": "s", "B": "r"}), ["A", "B"]) == "A"
    wanted = PanelThreshold(mean=0.5, sd=1.2, slope=4.0, lapses=0.0)
    one = simulated(thresholds={"1": wanted.model_dump()})
    one.deviation = 2.0
    assert one._detects(LEVITT, 0, 0.5 * 1.2**2) == pytest.approx(LEVITT.share)
    assert one._detects(LEVITT, 1, 0.5) == pytest.approx(1 / 3)
    assert one._detects(LEVITT, 0, None) == pytest.approx(1 / 3)


@pytest.mark.parametrize("d", [0.5, 3.0])
def test_simulated_answers_say_different_beyond_half_of_d(d: float) -> None:
    """Differences of two observations, N(0, 2) or N(d, 2), against the criterion d / 2, at least 0.7."""
    from tonewood.workshop.batch.pages import AbPage

    one, page = simulated(d_prime={"d": {"b": d}}), AbPage.model_validate({"type": "ab", "pairs": {"d": "all"}})
    for correct, mean in (("same", 0.0), ("different", d)):
        step = Step(0, 0, "t", {"A": "r", "B": "s"}, correct)
        found = np.mean([one._judged(page, step, []) == "different" for _ in range(4000)])
        beyond = [stats.norm.sf((max(d / 2, 0.7) - sign * mean) / math.sqrt(2)) for sign in (1, -1)]
        assert found == pytest.approx(sum(beyond), abs=0.025)


def test_simulated_replies_to_questions() -> None:
    assert _reply(SimpleNamespace(kind="choice", choices={"b": 1, "a": 2})) == "b"
    for kind, reply in (("text", "simulated"), ("number", 0.0), ("scale", 3.5)):
        assert _reply(SimpleNamespace(kind=kind, low=2.0, high=5.0)) == reply


def test_responses_to_levels_are_a_listener_s_own() -> None:
    one = simulated(slope_sd=4.0)
    many = [_Listener(one.panel, one.key, one.test, np.random.default_rng(k))._response("s") for k in range(800)]
    assert one._response("s") == one._response("s")
    assert np.std(many) == pytest.approx(4.0 * math.sqrt(2), rel=0.1)  # of two levels
    assert simulated()._response("s") == 0.0


# -- the course of a test ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return fakes.made(tmp_path_factory.mktemp("every"), fakes.ALL)


def stepped(test: ListeningTest) -> dict[tuple[str, bool], dict[str, Any]]:
    """The first view of each type of page, of training apart."""
    session, views = Session(test, 3), dict[tuple[str, bool], dict[str, Any]]()
    while session.step is not None:
        view = shown(test, session, "en")
        assert view["index"] == session.step.index
        assert view["progress"] == pytest.approx(session.step.index / session.total)
        views.setdefault((view["type"], view["training"]), view)
        session.pass_over()
    views["done", False] = shown(test, session, "en")
    return views


def test_views_are_those_of_the_pages(every: ListeningTest) -> None:
    views = stepped(every)
    assert views["done", False] == {"type": "done", "index": 0, "progress": 1.0}
    trained = views["abx", True]
    assert trained["training"]
    abx = views["abx", False]
    assert [c["value"] for c in abx["choices"]] == ["A", "B", "undecided"]
    assert (abx["slots"], abx["open"], abx["sequence"], abx["listen"]) == (["A", "B", "X"], None, False, 0.5)
    assert (abx["loop"], abx["restart"], abx["plays"], abx["waveform"], abx["last"]) == (
        "whole",
        False,
        None,
        False,
        False,
    )
    mushra = views["mushra", False]
    assert (mushra["open"], mushra["slots"][0], len(mushra["slots"])) == ("reference", "reference", 1 + 5)
    assert mushra["choices"] == []
    afc = views["afc", False]
    assert (afc["slots"], afc["sequence"], afc["question"]) == (["1", "2", "3"], True, "")
    assert [c["value"] for c in afc["choices"]] == ["1", "2", "3"]
    paired = views["paired_comparison", False]
    assert (paired["question"], [c["value"] for c in paired["choices"]]) == ("Which is brighter?", ["A", "B", "tie"])
    level = views["level", False]
    assert level["measured"] is True
    assert len(level["notes"]) == 3
    assert "1000" in level["notes"][0]
    assert "65" in level["notes"][1]
    assert (views["rating", False]["scales"], views["instructions", False]["title"]) == (
        [{"name": "bright", "label": "Brightness", "low": 0.0, "high": 100.0, "low_label": "", "high_label": ""}],
        "Hello",
    )
    questions = views["questionnaire", False]["questions"]
    assert [(q["name"], q["kind"], q["optional"]) for q in questions] == [
        ("age", "number", True), ("plays", "choice", False)
    ]  # fmt: skip
    assert questions[1]["choices"] == [{"value": "much", "label": "much"}, {"value": "little", "label": "little"}]
    assert views["consent", False]["agree"] == every.texts("en")["consent_agree"]
    assert views["finish", False]["last"] is True
    assert kind_of_texts(LEVITT) == "afc_3"
    assert kind_of_texts(LINEAR) == "afc_2"
    assert kind_of_texts(LINEAR.model_copy(update={"question": "?"})) == "afc_question"


def given(test: ListeningTest, kind: str, answer: dict[str, Any]) -> dict[str, Any]:
    """The record of an answer to the first page of a type."""
    session = Session(test, 3)
    while session.step is not None and (session.page is None or session.page.type != kind or session.step.training):
        session.pass_over()
    assert session.page is not None
    assert session.step is not None
    return checked(session.page, session.step, answer)


MUSHRA = dict.fromkeys("ABCDE", 50.0)


@pytest.mark.parametrize(
    ("kind", "answer", "kept"),
    [
        ("abx", {"choice": "A", "extra": 1}, {"choice": "A"}),
        ("abx", {"choice": "X"}, None),
        ("abx", {"choice": "A", "comment": "c" * 2000}, {"choice": "A", "comment": "c" * 2000}),
        ("abx", {"choice": "A", "comment": "c" * 2001}, None),
        ("abx", {"choice": "A", "seconds": -0.1}, None),
        ("abx", {"choice": "A", "seconds": 3.2e8}, {"choice": "A"}),
        ("abx", {"choice": "A", "seconds": 3.3e8}, None),
        ("abx", {"choice": "A", "plays": {"A": -1}}, None),
        ("abx", {"choice": "A", "plays": {"A": 1e6, "Z": 1}}, {"choice": "A"}),
        ("abx", {"choice": "A", "plays": {"A": 1e6 + 1}}, None),
        ("abx", {"choice": "A", "heard": {"A": 0.5, "B": 0.5, "X": 1.0}}, {"heard": {"A": 0.5, "B": 0.5, "X": 1.0}}),
        ("abx", {"choice": "A", "heard": {"A": 0.49, "B": 0.5, "X": 1.0}}, None),
        ("abx", {"choice": "A", "heard": {"A": 0.5, "B": 0.5, "X": 1.01}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 0.0, "B": 100.0}}, {"ratings": MUSHRA | {"A": 0.0, "B": 100.0}}),
        ("mushra", {"ratings": MUSHRA | {"A": -0.1}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 100.1}}, None),
        ("mushra", {"ratings": {"A": 1.0}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": True}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 10**400}}, None),
        ("bs1116", {"ratings": {"A": 1.0, "B": 5.0}}, {"ratings": {"A": 1.0, "B": 5.0}}),
        ("bs1116", {"ratings": {"A": 0.9, "B": 5.0}}, None),
        ("bs1116", {"ratings": {"A": 4.9, "B": 4.9}}, None),
        ("rating", {"values": {"bright": 100}}, {"values": {"bright": 100.0}}),
        ("rating", {"values": {}}, None),
        ("questionnaire", {"values": {"plays": "much"}}, {"values": {"plays": "much"}}),
        ("questionnaire", {"values": {"plays": "much", "age": ""}}, {"values": {"plays": "much"}}),
        ("questionnaire", {"values": {"plays": "never", "age": 3}}, None),
        ("questionnaire", {"values": {"age": 3}}, None),
        ("consent", {"agreed": True}, {"agreed": True}),
        ("consent", {"agreed": 1}, None),
        ("level", {"spl_db": 130}, {"spl_db": 130.0}),
        ("level", {"spl_db": 130.1}, None),
        ("ab", {"choice": "same"}, {"choice": "same"}),
        ("ab", {"choice": "A"}, None),
    ],
)
def test_answers_within_their_limits_are_taken(
    every: ListeningTest, kind: str, answer: dict[str, Any], kept: dict[str, Any] | None
) -> None:
    if kept is None:
        with pytest.raises(ListeningError):
            given(every, kind, answer)
        return
    found = given(every, kind, answer)
    assert {key: found[key] for key in kept} == kept
    assert set(found) <= {"seconds", "plays", *answer}
    assert found["seconds"] == answer.get("seconds", 0.0)
    assert "Z" not in found["plays"]


def test_words_of_one_s_own_may_lack_the_places_of_numbers() -> None:
    """A text with another word in braces stopped every listener at the page that sets the level."""
    level = LevelPage(type="level", spl_db=65.0)
    words = {"level_tone": "Ton, {frequenz} Hz", "level_spl": "{spl} dB", "level_headphones": ""}
    stimuli = SimpleNamespace(loudness=SimpleNamespace(target_lufs=-23.0))
    test: Any = SimpleNamespace(texts=lambda language: words, manifest=SimpleNamespace(stimuli=stimuli))
    assert _details(test, level, "de")["notes"] == ["Ton, {frequenz} Hz", "65 dB", ""]


def test_the_level_tone_is_a_whole_number_of_periods(tmp_path: Path) -> None:
    import io

    import soundfile

    page = LevelPage.model_validate({"type": "level", "freq": 997.3})
    loudness = SimpleNamespace(target_lufs=-23.0)
    settings = SimpleNamespace(fs=8000, channels=2, loudness=loudness)
    test = SimpleNamespace(manifest=SimpleNamespace(stimuli=settings))
    sound, fs = soundfile.read(io.BytesIO(tone(test, page)))  # type: ignore[arg-type]
    level = 10 ** ((-23.0 + 3.01 - 10 * math.log10(2)) / 20)
    expected = level * np.sin(2 * np.pi * 1995 / 16000 * np.arange(16000))
    assert (fs, sound.shape) == (8000, (16000, 2))
    np.testing.assert_allclose(sound, np.stack([expected, expected], axis=1), atol=2**-21)


def test_ramps_are_raised_cosines() -> None:
    found = ramped(np.ones((100, 2)), 1000, 0.01)
    rise = np.sin(np.pi / 2 * (np.arange(10) + 0.5) / 10) ** 2
    np.testing.assert_allclose(found[:, 1], np.r_[rise, np.ones(80), rise[::-1]])


def test_words_are_of_the_nearest_language() -> None:
    words = {"en": "colour", "de": "Farbe"}
    assert [in_language(words, x) for x in ("de-CH", "en", "fr")] == ["Farbe", "colour", "colour"]
    pages = SimpleNamespace(texts={"de": {"next": "Weiter!"}, "de-CH": {"next": "Wiiter"}}, title={"fr": "Essai"})
    test = ListeningTest(Path(), Path(), pages, (), "")  # type: ignore[arg-type]
    assert (test.texts("de")["next"], test.texts("de-CH")["next"]) == ("Weiter!", "Wiiter")
    assert test.texts("de-AT")["next"] == "Weiter!"
    assert test.title("de") == "Essai"
    assert ServedTrial("t", 0, "r", ("a", "b")).codes == ("r", "a", "b")
    assert ServedTrial("t", 0, None, ("a", "b")).codes == ("a", "b")


def test_shares_that_must_be_heard() -> None:
    pages = {p["type"]: p for p in fakes.ALL}
    from tonewood.workshop.batch.pages import HeadphonesPage

    assert share_wanted(LEVITT) == 0.5
    assert share_wanted(HeadphonesPage.model_validate({"type": "headphones"})) == 0.5
    assert share_wanted(LevelPage.model_validate(pages["level"])) == 0.0
    assert choices(LINEAR, ("reference", "1", "2")) == ["1", "2"]
    assert choices(LevelPage.model_validate(pages["level"]), ()) == []


# -- results ----------------------------------------------------------------------------------------------------------


def test_rows_are_in_the_manifest_s_order_and_levels_begin_with_the_reference() -> None:
    table = AnswerTable(("d", "p"), {"d": ["a", "b", "c"], "p": ["x", "y"]}, ())
    rows = [{"d": d, "p": p} for d, p in (("c", "x"), ("b|c", "y"), ("a", "y"), ("b", "x"), ("none", "x"))]
    assert [r["d"] for r in _in_order(rows, table)] == ["none", "a", "b", "b|c", "c"]
    page = SimpleNamespace(reference={"d": "b"})
    assert levels_of(table, page) == {"d": ["b", "a", "c"], "p": ["x", "y"]}  # type: ignore[arg-type]
    assert levels_of(table, SimpleNamespace(reference=None))["d"] == ["a", "b", "c"]  # type: ignore[arg-type]
    used = [{"d": "a", "p": "x", "q": "k|l", "repeat": "1"}, {"d": "b", "p": "x", "q": "k|l", "repeat": "2"}]
    assert _used(used, ("d", "p", "q", "repeat")) == ("d", "q")


def test_grades_of_bs1116_are_less_the_hidden_reference() -> None:
    rows = [row("a", 5.0, role="reference", index=3), row("a", 3.5, index=3), row("b", 4.0, role="reference", index=3),
            row("b", 5.0, index=3)]  # fmt: skip
    assert [r["value"] for r in _difference_grades(rows)] == [-1.5, 1.0]


def test_shares_end_at_0_and_1() -> None:
    (mean,) = cell_means([row("a", 1.0, f="x"), row("b", 0.0, f="x")], ("f",), 0.95)
    assert (_share(mean).low, _share(mean).high) == (0.0, 1.0)
    (alone,) = cell_means([row("a", 1.0, f="x")], ("f",), 0.95)
    assert _share(alone).low is None


@pytest.mark.parametrize(("value", "cell"), [(True, 1), (None, ""), (math.nan, ""), (0.0, 0.0), ("", ""), (2.5, 2.5)])
def test_cells_of_the_table(value: Any, cell: Any) -> None:
    assert _cell(value) == cell


def test_names_that_are_given_twice_get_a_number() -> None:
    answers = [SimpleNamespace(path=Path(str(i)), listener=name) for i, name in enumerate(("x", "x", "y", "x"))]
    assert list(_listener_names(answers).values()) == ["x", "x #2", "y", "x #3"]  # type: ignore[arg-type]
    # the work grows with the number of sessions, not with its cube: a test takes 10 000
    many = [SimpleNamespace(path=Path(str(k)), listener="x") for k in range(10_000)]
    assert list(_listener_names(many).values())[-1] == "x #10000"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "text"), [(None, "\N{EN DASH}"), (0.001, "0.001"), (0.00099, "< 0.001"), (0.25, "0.250")]
)
def test_probabilities_in_words(value: float | None, text: str) -> None:
    assert p_text(value) == text
    if value is not None:
        assert _p(value) == (text if text.startswith("<") else f"= {text}")


def test_numbers_in_words() -> None:
    assert [_number(x) for x in (-1.23456, 0.5)] == ["\N{MINUS SIGN}1.23", "0.5"]
    assert [_scalar(x) for x in (2, True, {"scale": 0.5}, {"a": 1, "b": 2}, "x")] == [2.0, None, 0.5, None, None]
    assert [_value(x) for x in (0.25, {"scale": 2.0}, {"fraction": 0.5})] == ["0.25", "2 times", "fraction 0.5"]
    assert _as_level(LEVITT, {"scale": 2.0}, 1.0) is None


def listener(name: str, threshold: float) -> ListenerThreshold:
    return ListenerThreshold(name, 20, 1, None, threshold, 0.1, 5.0, threshold, 0.1, None, 3.0)


def found(page: StaircasePage, mean: float, *bounds: float | None, count: int = 2) -> tuple[Any, PageResults]:
    """Results of a staircase."""
    people = tuple(listener(f"l{i}", mean) for i in range(count))
    fit = Thresholds("%", 0.70711, people, mean, bounds[0], bounds[1], mean, 1.25, 3.0)
    rows = tuple(
        {"listener": "l0", "track": 0, "index": i, "level": level, "right": right, "value": float(right)}
        for i, (level, right) in enumerate(((4.0, True), (4.0, False), (2.0, True), (8.0, True)))
    )
    own = PageResults(1, "staircase", "Stairs", count, (), rows, thresholds=fit)
    factor = SimpleNamespace(path=page.path, levels={"near": 1.0, "far": 1.02, "odd": "word"})
    settings = SimpleNamespace(factors={"pluck": factor}, name="t")
    test = SimpleNamespace(pages=[page], manifest=settings)
    panel = PanelResults(test, 0.95, SimpleNamespace(rows=rows), count, 0, (), (), (own,))  # type: ignore[arg-type]
    return panel, own


@pytest.mark.parametrize(
    ("mean", "bounds", "count", "text"),
    [
        (0.5, (0.4, 0.6), 2, "is 0.5 % of body.detune, at 70.7 % right answers (95 % interval 0.4 to 0.6 %; listeners "
         "differ by a factor of 1.25)."),
        (0.5, (None, 0.6), 2, "95 % interval 0.01 to 0.6 %, beyond the levels at its lower end; "),
        (0.5, (0.4, None), 2, "95 % interval 0.4 to 10 %, beyond the levels at its upper end; "),
        (0.5, (None, None), 2, "95 % interval 0.01 to 10 %, beyond the levels at both ends; "),
        (0.5, (None, None), 1, "(of one listener, without an interval of the mean)."),
        (12.0, (None, None), 2, "lies above the levels that can be presented, which end at 10 %"),
        (0.001, (None, None), 2, "lies below the levels that can be presented, which end at 0.01 %"),
    ],
)  # fmt: skip
def test_a_threshold_in_words(mean: float, bounds: Any, count: int, text: str) -> None:
    panel, own = found(LEVITT, mean, *bounds, count=count)
    assert text in _threshold(panel, own, "95 %")


def test_differences_are_told_in_just_noticeable_ones() -> None:
    """2 % of a threshold of 0.5 %."""
    panel, own = found(LEVITT, 0.5, 0.4, 0.6)
    told = "body.detune 1.02 against 1, 4 just-noticeable differences"
    assert _in_unit(panel, "pluck", "near", "far") == told
    assert _in_unit(panel, "pluck", "near", "none") == _in_unit(panel, "other", "near", "far") == ""
    assert _in_unit(panel, "pluck", "near", "odd") == ""
    beyond, _ = found(LEVITT, 11.0, None, None)
    assert _in_unit(beyond, "pluck", "near", "far") == "body.detune 1.02 against 1"
    page = LEVITT.model_copy(update={"reference": 2.0})
    panel, own = found(page, 0.5, 0.4, 0.6)
    assert "of body.detune, 2.01 instead of 2, at" in _threshold(panel, own, "95 %")
    assert methods(panel).startswith(
        "2 listeners took part; 4 answers were given. Intervals are of 95 %. Thresholds of "
    )
    assert "a 2-down, 1-up staircase (Levitt 1971), 10 reversals in 1 track, 3 intervals" in methods(panel)


def test_numbers_of_listeners_in_words() -> None:
    panel, _ = found(LEVITT, 0.5, 0.4, 0.6)
    assert panel.who == "2 listeners"
    assert replace(panel, simulated=1).who == "2 listeners, 1 of them simulated"
    assert replace(panel, simulated=2).who == "2 simulated listeners"


def test_figures_of_a_staircase_are_its_answers() -> None:
    panel, own = found(LEVITT, 3.0, 2.0, 5.0)
    made = figures_of(panel, own)
    track, wrong = made["tracks"].axes[0].lines[:2]
    assert (track.get_xdata().tolist(), list(track.get_ydata())) == ([1, 2, 3, 4], [4.0, 4.0, 2.0, 8.0])
    assert (wrong.get_xdata().tolist(), wrong.get_ydata().tolist()) == ([2], [4.0])
    assert made["tracks"].axes[0].get_yscale() == "log"
    lines = made["psychometric"].axes[0].lines
    dots = [(float(np.ravel(x.get_xdata())[0]), float(np.ravel(x.get_ydata())[0])) for x in lines[:3]]
    assert dots == [(2.0, 1.0), (4.0, 0.5), (8.0, 1.0)]
    curve = lines[3]
    x = np.asarray(curve.get_xdata())
    assert (x[0], x[-1], len(x)) == (pytest.approx(2.0), pytest.approx(8.0), 200)
    expected = psychometric(np.log(x), math.log(3.0), 3.0, 1 / 3, 0.70711)
    np.testing.assert_allclose(np.asarray(curve.get_ydata()), expected)
    assert lines[5].get_xdata()[0] == 3.0
    assert lines[6].get_ydata()[0] == pytest.approx(1 / 3)


def test_figures_of_means_are_the_means() -> None:
    rows = [row(who, v + 10 * (d == "b"), d=d, p=p)
            for who, v in (("1", 40.0), ("2", 50.0), ("3", 66.0)) for d in "ab" for p in "xy"]  # fmt: skip
    cells = tuple(cell_means(rows, ("d", "p"), 0.95))
    helpers = tuple(cell_means([r | {"role": "anchor35"} for r in rows], ("role",), 0.95))
    own = PageResults(1, "mushra", "M", 3, ("d", "p"), tuple(rows), cells=cells, helpers=helpers)
    panel: Any = SimpleNamespace(simulated=3, listeners=3, confidence=0.95)
    made = figures_of(panel, own)
    axes = made["means"].axes[0]
    assert axes.get_xlim() == (0.0, 100.0)
    line = axes.containers[0].lines
    assert list(line[0].get_xdata()) == [m.mean for m in (*cells, *helpers)]
    segments = line[2][0].get_segments()
    np.testing.assert_allclose([s[:, 0] for s in segments], [(m.low, m.high) for m in (*cells, *helpers)])
    assert [t.get_text() for t in axes.get_yticklabels()] == ["a, x", "a, y", "b, x", "b, y", "role = anchor35"]
    assert axes.get_title().startswith("3 simulated listeners, 95 % intervals")
    crossed = made["interaction"].axes[0].containers
    assert [list(c.lines[0].get_ydata()) for c in crossed] == [[52.0, 52.0], [62.0, 62.0]]
    np.testing.assert_allclose([list(c.lines[0].get_xdata()) for c in crossed], [[0, 1], [0.06, 1.06]])
    bars = [[s[:, 1] for s in c.lines[2][0].get_segments()] for c in crossed]
    np.testing.assert_allclose(np.concatenate(bars), [(m.low, m.high) for m in cells])
    # one listener has no interval
    few = tuple(cell_means(rows[:4], ("d", "p"), 0.95))
    alone = figures_of(panel, replace(own, rows=tuple(rows[:4]), cells=few, helpers=()))
    for name, axis in (("means", 0), ("interaction", 1)):
        shown = alone[name].axes[0].containers
        ends = [s[:, axis].tolist() for c in shown for s in c.lines[2][0].get_segments()]
        assert ends == [[m.mean, m.mean] for m in few]


# -- simulated experiments --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("null", ["no effect", "listeners differ in the factor", "unequal variance"])
def test_simulated_ratings_have_the_stated_means_and_spreads(null: str) -> None:
    """Variances: 36 of listeners, those of their own responses to a level, and of single answers."""
    law: Any = NULLS[null]
    y = ratings(np.random.default_rng(3), 40, 500, null, 3.0).reshape(-1, 3, 3, 2)
    assert y.mean(axis=(0, 2, 3)) == pytest.approx(law["mean"] + np.array([0.0, 3.0, 0.0]), abs=0.35)
    own, residual = np.square(law["own"]), np.square(law["residual"])
    assert y.var(axis=0).mean(axis=(1, 2)) == pytest.approx(36 + own + residual, rel=0.06)
    assert y.var(axis=3, ddof=1).mean(axis=(0, 2)) == pytest.approx(residual, rel=0.06)
    between = y.mean(axis=(2, 3))
    assert np.cov(between, rowvar=False)[0, 1] == pytest.approx(36, rel=0.08)
    assert between.var(axis=0) == pytest.approx(36 + own + residual / 6, rel=0.06)


def test_simulated_ratings_end_at_100() -> None:
    y = ratings(np.random.default_rng(3), 10, 200, "ratings at the ceiling")
    assert np.mean(y == 100.0) == pytest.approx(stats.norm.sf(5 / math.sqrt(36 + 25 + 81)), abs=0.01)
    assert y.shape == (10, 200, 9, 2)


def test_simulated_ratings_of_other_populations() -> None:
    def drawn(name: str, shift: float = 0.0) -> np.ndarray:
        return ratings(np.random.default_rng(4), 40, 500, name, shift).reshape(-1, 3, 3, 2)

    skewed = drawn("skewed differently in each level")
    level = skewed.mean(axis=(2, 3))
    assert level.var(axis=0) == pytest.approx(36 + 64 + 36 / 6, rel=0.08)
    third = np.mean((level - level.mean(axis=0)) ** 3, axis=0)
    assert third == pytest.approx([0, 2 * 8**3, -2 * 8**3], abs=160)
    assert set(np.unique(drawn("three values only"))) == {20.0, 50.0, 80.0}
    tenth = drawn("one listener in ten responds", 2.0)
    assert tenth.mean(axis=(0, 2, 3)) == pytest.approx([50.0, 52.0, 50.0], abs=0.4)
    change = tenth.mean(axis=(2, 3))[:, 2] - tenth.mean(axis=(2, 3))[:, 0]
    assert change.var() == pytest.approx(20**2 * 0.09 + 2 * 36 / 6, rel=0.06)
    assert np.mean(change > 8) == pytest.approx(0.1, abs=0.01)
    heavy = drawn("heavy tails", 5.0)
    assert np.median(heavy, axis=(0, 2, 3)) == pytest.approx([50.0, 55.0, 50.0], abs=0.4)
    own = np.median(np.abs(heavy[..., 0] - heavy[..., 1])) / math.sqrt(2)
    t = np.random.default_rng(0).standard_t(3, (200_000, 2))
    assert own == pytest.approx(5 * np.median(np.abs(t[:, 0] - t[:, 1])) / math.sqrt(2), rel=0.04)


def test_missing_answers_are_those_of_the_law() -> None:
    y = np.arange(3 * 8 * 9 * 2, dtype=float).reshape(3, 8, 9, 2)
    rng = np.random.default_rng(2)
    sets = without(rng, y, "sets of six of nine sounds")
    assert (np.isnan(sets).sum(axis=-1) == 3).all()
    third = without(rng, y, "a third of every fourth listener's")
    there = ~np.isnan(third)
    assert there[:, [1, 2, 3, 5, 6, 7]].all()
    assert np.array_equal(third[:, 1], y[:, 1].mean(axis=-1))
    some = third[:, [0, 4]]
    assert not np.array_equal(some, y[:, [0, 4]].mean(axis=-1), equal_nan=True)
    expected = np.stack([y.mean(axis=-1), y[..., 0], y[..., 1]])[:, there]
    assert (np.abs(expected - third[there]).min(axis=0) == 0).all()  # the mean of those that are left
    many = np.zeros((20, 50, 9, 1))
    assert np.isnan(without(rng, many, "20 % at random")).mean() == pytest.approx(0.2, abs=0.015)


def test_simulated_grades_are_two_answers_a_cell() -> None:
    found = graded(np.random.default_rng(2), 3, 400, "five grades", 1.0)
    assert found.shape == (3, 400, 9, 5)
    assert (found.sum(axis=-1) == 2).all()
    share = found.sum(axis=(0, 1))[:3].sum(axis=0) / (3 * 400 * 3 * 2)
    latent = np.random.default_rng(0)
    many = latent.normal(0, math.hypot(1, 0.7), 200_000) + latent.logistic(size=200_000)
    cuts = np.array([-2.0, -0.5, 0.7, 2.0])
    assert share == pytest.approx(np.bincount(np.searchsorted(cuts, many), minlength=5) / 200_000, abs=0.02)
    higher = found[:, :, 3:6].sum(axis=(0, 1, 2)) @ np.arange(5) - found[:, :, :3].sum(axis=(0, 1, 2)) @ np.arange(5)
    assert higher > 0


def test_simulated_tracks_of_sure_listeners_stay_at_their_thresholds() -> None:
    """At a slope of 1e6 answers are right above the threshold, and two of five below it; no lapses."""
    levels, right = trials(LINEAR, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    (levels,), (right,) = levels, right
    assert right[levels > 3.0].all()
    assert levels[0] == 4.0
    two = LINEAR.model_copy(update={"tracks": 2})
    (both,), _ = trials(two, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    assert np.flatnonzero(both[: len(levels)] != levels).size == 0
    assert len(both) > len(levels)
    quest = StaircasePage.model_validate(
        {"type": "staircase", "path": "a.b", "start": 4.0, "lowest": 0.0, "highest": 10.0, "trials": 12, "tracks": 2}
    )
    (levels,), (right,) = trials(quest, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    assert (levels.shape, levels[0], levels[12]) == ((24,), 4.0, 4.0)
    assert right[levels > 3.0].all()


@pytest.mark.parametrize(
    ("size", "batches"),
    [(1, [4000]), (500, [4000]), (501, [3992, 8]), (1500, [1333, 1333, 1333, 1]), (40_000, [50] * 4),
     (3_000_000, [1] * 200)],
)  # fmt: skip
def test_experiments_are_simulated_in_batches_of_two_million_answers(size: int, batches: list[int]) -> None:
    """4000 experiments, of large ones four batches, 200 at least."""
    assert _batches(size) == batches
    assert all(one * size <= 2_000_000 or one == 1 for one in _batches(size))


# -- the fit of thresholds --------------------------------------------------------------------------------------------


def test_the_likelihood_of_answers_is_summed_over_lapses() -> None:
    """Beta(1, 30) on five lapse rates, each for the range between the middles; two answers right, one wrong."""
    grid = ThresholdGrid(LEVITT)
    lapses = np.array([0.005, 0.02, 0.05, 0.1, 0.2])
    edges = np.r_[0.0, (lapses[1:] + lapses[:-1]) / 2, 0.25]
    prior = stats.beta(1, 30).pdf(lapses) * np.diff(edges)
    found = grid.likelihood(np.array([0.5, 0.5, 2.0]), np.array([True, False, True]))
    assert found.shape == (241, 22)
    for i, j in ((60, 0), (120, 10), (200, 21)):
        p, q = (psychometric(math.log(x), grid.u[i], grid.slopes[j], 1 / 3, LEVITT.share, lapses) for x in (0.5, 2.0))
        assert found[i, j] == pytest.approx(math.log(np.sum(prior * p * (1 - p) * q) / prior.sum()), rel=1e-9)
    np.testing.assert_allclose(grid.slopes, np.geomspace(1.5, 100, 22) / grid.span)


def test_slopes_of_listeners_spread_by_two_fifths() -> None:
    """Where two slopes alone are possible, a listener's is their mean by the law of the population."""
    grid = ThresholdGrid(LEVITT)
    tables = np.full((4, 241, 22), -1000.0)
    tables[:, 110:131, 5], tables[:, 110:131, 11] = 0.0, -0.4
    fit = grid.fit(tables, 0.95)
    logs = np.log(grid.slopes[[5, 11]])
    weight = np.exp([0.0, -0.4]) * np.exp(-0.5 * ((logs - math.log(fit.slope)) / 0.4) ** 2)
    np.testing.assert_allclose(np.log(fit.slopes), weight @ logs / weight.sum(), rtol=1e-6)
    middle = grid.u[120]
    assert fit.mean == pytest.approx(middle, abs=0.01)
    np.testing.assert_allclose(fit.alone, middle, atol=0.01)
    half = 10.5 * (grid.u[1] - grid.u[0])
    np.testing.assert_allclose(fit.alone_intervals - middle, [[-0.95 * half, 0.95 * half]] * 4, rtol=1e-6)
    assert (np.abs(fit.intervals - middle) <= half).all()
    assert fit.interval[0] < fit.mean < fit.interval[1]
    narrow = grid.fit(tables, 0.5)
    np.testing.assert_allclose(narrow.alone_intervals - middle, [[-0.5 * half, 0.5 * half]] * 4, rtol=1e-6)


# -- words of results -------------------------------------------------------------------------------------------------


def detected(**changes: Any) -> Detection:
    values: dict[str, Any] = {
        "cell": {"pluck": "near|far"}, "listeners": 4, "right": 30, "answers": 40, "undecided": 0, "share": 0.75,
        "low": 0.6, "high": 0.9, "p_value": 0.01, "d_prime": 2.0, "d_low": 1.0, "d_high": 3.0, "listener_mean": 0.75,
        "listener_low": 0.6, "listener_high": 0.9, "p_holm": 0.02,
    }  # fmt: skip
    return Detection(**values | changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "pluck near and far (body.detune 1.02 against 1) are told apart (30 of 40 answers, 75 % right, "
             "p by Holm = 0.020; d' = 2.00 (95 % interval 1.00 to 3.00), {jnd} just-noticeable differences by these "
             "answers)."),
        ({"d_high": None}, "d' = 2.00 (95 % interval from 1.00), "),
        ({"d_low": None, "d_high": None}, "d' = 2.00, "),
        ({"d_prime": None}, "p by Holm = 0.020; d' is at least 1.00)."),
        ({"d_prime": None, "d_low": None}, "75 % right, p by Holm = 0.020)."),
        ({"p_holm": 0.051}, "are not shown to be told apart (30 of 40 answers, 75 %, p by Holm = 0.051; "
             "d' is at most 3)."),
        ({"p_holm": 0.5, "d_high": None}, "75 %, p by Holm = 0.500)."),
        ({"share": None}, "pluck near and far: nobody decided."),
        ({"p_holm": 0.049}, "are told apart"),
        ({"cell": {"score": "low"}}, "score low are told apart"),
    ],
)  # fmt: skip
def test_a_pair_in_words(changes: dict[str, Any], text: str) -> None:
    from tonewood.workshop.batch.pages import AbxPage

    page = AbxPage.model_validate({"type": "abx", "pairs": {"pluck": "all"}})
    factor = SimpleNamespace(path="body.detune", levels={"near": 1.0, "far": 1.02})
    test = SimpleNamespace(pages=[page], manifest=SimpleNamespace(factors={"pluck": factor}))
    panel: Any = SimpleNamespace(test=test, confidence=0.95, pages=())
    own = PageResults(1, "abx", "A", 4, ("pluck",), ())
    jnd = 2.0 / sensitivity(2**-0.5, "abx")
    assert text.format(jnd=f"{jnd:.2g}") in _detected(panel, own, detected(**changes), "95 %")


def test_cells_of_pairs_in_words() -> None:
    sure, other = detected(cell={"pluck": "a|b", "score": "low"}, p_holm=0.0004), detected(p_holm=0.05)
    own = PageResults(1, "abx", "A", 4, (), (), detections=(other, sure, other))
    assert _cells(own, 0.05) == (
        "in 1 of 3 cells a pair is told apart by the answers of that cell alone (p by Holm): "
        "pluck a and b, score low (30 of 40 right, p < 0.001)."
    )
    none = replace(own, detections=(other, other))
    assert _cells(none, 0.05).startswith("in none of 2 cells is a pair shown")


def test_cells_are_told_of_pairs_in_several() -> None:
    panel: Any = SimpleNamespace(confidence=0.95)
    own = PageResults(1, "abx", "A", 4, (), (), pairs=(detected(share=None),), detections=(detected(),))
    assert _of_page(panel, own) == ["pluck near and far: nobody decided."]
    _, cells = _of_page(panel, replace(own, detections=(detected(), detected(p_holm=0.06))))
    assert cells.startswith("in 1 of 2 cells")


def linear(*terms: tuple[str, float, float, float, float], at_ends: float | None = None) -> LinearAnalysis:
    made = tuple(ModelTerm(n, ("d",), v, low, high, 9.0, p, p, 0.5, "a") for n, v, low, high, p in terms)
    return LinearAnalysis("", "", True, 10, 5, (), made, (), 3.0, at_ends)


def rated(model: LinearAnalysis, **changes: Any) -> PageResults:
    rows = tuple(
        {"d": d, "role": role} for role, d in (("anchor35", "x"), ("reference", "a"), ("sound", "b"), ("sound", "c"))
    )
    return PageResults(1, "mushra", "M", 5, ("d",), rows, linear=model, **changes)


def told_of(own: PageResults) -> tuple[float, str]:
    panel: Any = SimpleNamespace(test=SimpleNamespace(manifest=SimpleNamespace(factors={})), confidence=0.95, pages=())
    assert own.linear is not None
    p, text = _difference(panel, own, own.linear, own.linear.terms[0])
    return p, text.replace("\N{MINUS SIGN}", "-")


@pytest.mark.parametrize(
    ("term", "text"),
    [
        (("d=b", -7.5, -9.0, -6.0, 0.0004), "b is rated 7.5 points below a (95 % interval -9 to -6, p < 0.001)"),
        (("d=b", 7.5, 6.0, 9.0, 0.049), "b is rated 7.5 points above a (95 % interval 6 to 9, p = 0.049)"),
        (("d=b", 1.0, -2.0, 4.0, 0.051), "no difference between b and a is shown (1 points, 95 % interval -2 to 4, "
         "p = 0.051); one of more than 4 points is unlikely"),
        (("d=b", -1.0, -5.5, 4.0, 0.5), "; one of more than 5.5 points is unlikely"),
        (("d=b", 0.0, 0.0, 0.0, 1.0), "no difference between b and a is shown (every "
         "listener's answers to both are equal)"),
        (("d=b", 2.0, 2.0, 2.0, 0.25), "is shown (2 points, the same for every listener, sign test p = 0.250)"),
        (("d=b", 2.0, 2.0, 2.0, 0.01), "b is rated 2 points above a (the same for every listener, sign test "
         "p = 0.010)"),
    ],
)  # fmt: skip
def test_a_difference_of_ratings_in_words(term: Any, text: str) -> None:
    p, told = told_of(rated(linear(term, ("d=c", 0.0, 0.0, 0.0, 1.0))))
    assert p == term[-1]
    assert told == text if not text.startswith((";", "is shown")) else text in told


def test_a_difference_is_from_the_level_of_the_reference() -> None:
    """A level that one listener rated is left out; the others were said to differ from it, where it stood first."""
    rows = [
        {"listener": str(i), "d": d, "role": "sound", "value": v + i % 3 * (d == "b")}
        for d, v in (("x", 10.0), ("a", 90.0), ("b", 50.0))
        for i in range(1 if d == "x" else 6)
    ]
    model = linear_analysis(rows, ("d",), 0.95, {"d": ["a", "x", "b"]})
    assert model is not None
    assert [(t.name, t.first, round(t.difference, 9)) for t in model.terms] == [("d=b", "a", -39.0)]
    assert told_of(PageResults(1, "mushra", "M", 6, ("d",), tuple(rows), linear=model))[1].startswith(
        "b is rated 39 points below a ("
    )


def test_the_larger_p_of_those_with_and_without_the_screened_is_told() -> None:
    kept = linear(("d=b", -7.5, -9.0, -6.0, 0.001), ("d=c", 0.0, 0.0, 0.0, 1.0))
    every = linear(("d=b", -3.0, -7.0, 1.0, 0.2), ("d=c", 0.0, 0.0, 0.0, 1.0))
    p, told = told_of(rated(kept, everybody=rated(every)))
    assert (p, told.startswith("no difference between b and a is shown (-3 points")) == (0.2, True)
    assert told_of(rated(every, everybody=rated(kept)))[0] == 0.2


def test_shares_and_odds_are_told_where_the_scale_ends() -> None:
    share = Superiority("d", "a", "b", 5, 0.25, 0.1, 0.4, 0.01, 0.02)
    ranks = RankAnalysis((), (), (share,))
    odds = OrdinalAnalysis(5, 5, (OddsTerm("d=b", ("d",), 0.5, 0.25, 1.0, 4.0, 0.03, 0.06),), (), True)
    terms = (("d=b", -7.5, -9.0, -6.0, 0.001), ("d=c", 0.0, 0.0, 0.0, 1.0))
    said = "b is rated above a in 25 % of comparisons (95 % interval 10 to 40 %, p by Holm = 0.020)"
    ratio = "the odds of a higher rating are 0.5 times as large (95 % interval 0.25 to 1, p by Holm = 0.060)"
    _, plain = told_of(rated(linear(*terms, at_ends=END_SHARE), ranks=ranks, odds=odds))
    assert plain.endswith(f"p = 0.001); {ratio}")
    _, bent = told_of(rated(linear(*terms, at_ends=END_SHARE + 0.01), ranks=ranks, odds=odds))
    assert bent.endswith(f"; {said}; {ratio}")
    p, ordinal = told_of(rated(linear(*terms), ranks=ranks, odds=odds, ordinal=True))
    assert (p, ordinal) == (0.02, f"{said}; {ratio}")
    turned = RankAnalysis((), (), (replace(share, first="b", second="a", p_holm=0.051),))
    p, ordinal = told_of(rated(linear(*terms), ranks=turned, ordinal=True))
    assert p == 0.051
    assert ordinal == (
        "no difference between b and a is shown: b is rated above a in 75 % of comparisons (95 % interval 60 to 90 %, "
        "p by Holm = 0.051)"
    )


def test_results_of_too_few_are_said_not_to_be_tested() -> None:
    own = PageResults(1, "mushra", "M", 2, ("d",), ({"value": None}, {"value": 50.0}))
    panel: Any = SimpleNamespace(confidence=0.95, pages=(own,))
    assert summary(panel) == ["Page 1, M: no difference is tested, with answers of 2 listeners; three are needed."]
    (said,) = summary(SimpleNamespace(confidence=0.95, pages=(replace(own, screened=(1,)),)))  # type: ignore[arg-type]
    assert "of 2 listeners, 1 listener left out by the screening; three" in said
    silent = (replace(own, factors=()), replace(own, rows=({"value": None},)))
    assert summary(SimpleNamespace(confidence=0.95, pages=silent)) == []  # type: ignore[arg-type]


def test_results_are_written_without_their_rows() -> None:
    panel, own = found(LEVITT, 0.5, 0.4, 0.6)
    screened = replace(own, page=2, everybody=own)
    data = replace(panel, pages=(own, screened), unfinished=("u",), withdrawn=3).to_dict()
    whole, other = data.pop("pages")
    assert data == {
        "name": "t", "confidence": 0.95, "listeners": 2, "simulated": 0, "unfinished": ["u"], "not_passed": [],
        "withdrawn": 3, "left_out": [],
    }  # fmt: skip
    assert (whole["page"], whole["thresholds"]["mean"], whole["everybody"], "rows" in whole) == (1, 0.5, None, False)
    assert (other["everybody"]["page"], other["everybody"]["rows"]) == (1, ())


# -- sessions and files of answers ------------------------------------------------------------------------------------


def test_steps_are_counted_with_every_attempt_of_a_check(tmp_path: Path) -> None:
    """Six trials of headphones, three of the second attempt so far, then two pairs and the end."""
    pages = [{"type": "headphones"}, {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "group_by": ["pluck"]}]
    session = Session(fakes.made(tmp_path, pages), 1)
    pairs = len(session.test.trials)
    assert session.total == 6 + pairs + 1
    for k in range(9):
        assert session.step is not None
        wrong = next(slot for slot in session.step.slots if slot != session.step.correct)
        session.answer({"choice": wrong if k == 0 else session.step.correct})
        assert session.total == max(6, k + 1) + pairs + 1


def test_training_on_a_staircase_stays_at_its_start(tmp_path: Path) -> None:
    pages = [{"type": "training", "page": 2, "trials": 9}, fakes.STAIRS | {"down": 1}]
    session = Session(fakes.made(tmp_path, pages), 1)
    assert session.total == 9 + 40 + 1
    places = []
    for k in range(9):
        step = session.step
        assert step is not None
        assert session.page_index == 1
        assert (step.training, step.repetition, step.track, step.level) == (True, k + 1, 0, 8.0)
        assert [slot for slot, code in step.slots.items() if code == "changed"] == [step.correct]
        places.append(step.correct)
        if k < 7:
            record = session.answer({"choice": step.correct})
            assert (record["level"], record["right"], record["training"], record["page"]) == (8.0, True, True, 1)
        else:
            session.pass_over()
    assert len(set(places)) > 1
    assert session.incomplete == set()
    step = session.step
    assert step is not None
    assert (step.training, step.page, step.level, session.tracks[1][0].levels) == (False, 1, 8.0, [])
    session.pass_over()
    assert session.incomplete == {1}
    assert session.page is not None
    assert session.page.type == "finish"


def test_names_are_one_line_of_sixty_characters() -> None:
    assert printable(" a\n\x1b b\t" + "c" * 80) == "a b " + "c" * 56
    assert listener_of({"listener": "\n", "token": "0123456789"}) == "01234567"
    assert listener_of({"listener": " x ", "token": "0"}) == "x"
    assert [place_of(x) for x in ({}, {"place": 0}, {"place": 2**31 - 1})] == [0, 0, 2**31 - 1]
    for wrong in (-1, 2**31, True, 1.0, "1"):
        with pytest.raises(ListeningError, match="is no number of a listener"):
            place_of({"place": wrong})


# -- tables, odds and sounds on demand --------------------------------------------------------------------------------


def test_means_of_a_page_are_rows_of_a_table(tmp_path: Path) -> None:
    """Means by factor, and by all where there are several factors; shares, values and thresholds."""
    rows = [row(w, v, d=d, p="x", role="sound") for w, v in (("1", 2.0), ("2", 4.0)) for d in "ab"]
    means = tuple(cell_means(rows, ("d",), 0.95))
    helper = tuple(cell_means([r | {"role": "anchor35"} for r in rows], ("role",), 0.95))
    one = PageResults(2, "mushra", "M", 2, ("d",), (), per_factor=means, cells=means, helpers=helper)
    two = replace(one, page=3, factors=("d", "p"))
    bare = replace(one, page=4, per_factor=(), helpers=())
    pairs = PageResults(
        5, "abx", "A", 4, (), (), detections=(detected(),), by_listener=(detected(cell={"listener": "z"}),)
    )
    scale = PageResults(6, "paired_comparison", "P", 4, (), (), scale=(ScaleValue("near", 0.5, 0.25, 0.75),))
    stairs = found(LEVITT, 0.5, 0.4, 0.6)[1]
    table = AnswerTable(
        ("d",), {"d": ["a", "b"]}, ({"listener": "1", "page": 2, "right": True, "value": 1.5, "d": "a"},)
    )
    panel: Any = SimpleNamespace(table=table, pages=(one, two, bare, pairs, scale, stairs))
    write_tables(panel, tmp_path)
    with (tmp_path / "means.csv").open(newline="") as stream:
        told = list(csv.DictReader(stream))
    assert [(r["page"], r["cell"]) for r in told] == [
        ("2", "d=a"), ("2", "d=b"), ("2", "role=anchor35"),
        ("3", "d=a"), ("3", "d=b"), ("3", "d=a"), ("3", "d=b"), ("3", "role=anchor35"),
        ("4", "d=a"), ("4", "d=b"),
        ("5", "pluck=near|far"), ("5", "listener=z"), ("6", "near"), ("1", "listener=l0"), ("1", "listener=l1"),
    ]  # fmt: skip
    assert [float(told[0][key]) for key in ("mean", "listeners", "answers", "median")] == [3.0, 2, 2, 3.0]
    assert [float(told[10][key]) for key in ("right", "answers", "share", "d_prime", "p_holm")] == [
        30,
        40,
        0.75,
        2.0,
        0.02,
    ]
    assert [float(told[12][key]) for key in ("mean", "low", "high")] == [0.5, 0.25, 0.75]
    assert [told[13][key] for key in ("threshold", "low", "high", "slope", "reversals")] == [
        "0.5",
        "0.1",
        "5.0",
        "3.0",
        "",
    ]
    with (tmp_path / "answers.csv").open(newline="") as stream:
        (answer,) = csv.DictReader(stream)
    assert (answer["right"], answer["value"], answer["d"], answer["page"], answer["heard"]) == (
        "1",
        "1.5",
        "a",
        "2",
        "",
    )
    assert pq.read_table(tmp_path / "means.parquet").num_rows == len(told)
    assert pq.read_table(tmp_path / "answers.parquet").num_rows == 1


def test_odds_of_an_analysis_are_those_of_its_fit() -> None:
    """Two grades at two levels: the ratio of counts with half an answer added; t on listeners - 1 degrees."""
    rng = np.random.default_rng(3)
    counts = np.zeros((9, 2, 2))
    rows = []
    for i in range(9):
        for j in (0, 1):
            for _ in range(4):
                grade = int(rng.random() < (0.3, 0.6)[j])
                counts[i, j, grade] += 1
                rows.append(row(str(i), float(grade), f="xy"[j]))
    found_of = ordinal_analysis(rows, ["f"], 0.9, {"f": ["x", "y"]})
    assert found_of is not None
    (term,), (test,) = found_of.terms, found_of.tests
    share = counts.sum(axis=(0, 1)) / counts.sum()
    a, b = counts.sum(axis=0) + 0.5 * share
    assert (found_of.grades, found_of.listeners, found_of.converged, found_of.notes) == (2, 9, True, ())
    assert (term.name, term.effect, term.df) == ("f=y", ("f",), 8.0)
    assert term.ratio == pytest.approx((b[1] / b[0]) / (a[1] / a[0]), rel=1e-5)
    eta, v, _ = clustered(counts, np.array([[0.0], [1.0]]))
    error = math.sqrt(v[1, 1])
    assert math.log(term.high / term.ratio) == pytest.approx(stats.t.ppf(0.95, 8) * error, rel=1e-5)
    assert math.log(term.ratio / term.low) == pytest.approx(stats.t.ppf(0.95, 8) * error, rel=1e-5)
    p = 2 * stats.t.sf(abs(eta[1]) / error, 8)
    assert (term.p_value, term.p_holm, test.p_value) == pytest.approx((p, p, p), rel=1e-4)
    assert (test.df, test.df2, test.statistic) == pytest.approx((1, 8, (eta[1] / error) ** 2), rel=1e-4)
    # scores are taken re their mean, which the added answers move: n listeners show n - 1 directions at most
    few = np.array([[[3.0, 1, 0], [1, 2, 1], [0, 1, 3]], [[2, 1, 1], [2, 2, 0], [1, 0, 3]]])
    directions = np.linalg.eigvalsh(clustered(few, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), prior=4.0)[1])
    assert abs(directions[-2]) < 1e-9 * directions[-1]
    assert ordinal_analysis([r | {"value": 1.0} for r in rows], ["f"], 0.9, {"f": ["x", "y"]}) is None
    sampled = [r | {"s": str(i % 3)} for i, r in enumerate(rows)]
    assert ordinal_analysis(sampled, ["f", "s"], 0.9, {"f": ["x", "y"]}, ["s"]) is None


class Renders(fakes.fakes.FakeRenderer):
    """Notes what it renders."""

    def __init__(self) -> None:
        super().__init__()
        self.rendered: list[float] = []

    def render(self, condition: Any) -> Any:
        self.rendered.append(condition.overrides["body.detune"])
        return super().render(condition)


def test_both_sounds_of_a_level_are_made_once(tmp_path: Path) -> None:
    """8 % of a detuning of 1 is 1.08; both have one length and one loudness."""
    import io

    import soundfile

    test = fakes.made(tmp_path, [{"type": "instructions"}, fakes.STAIRS])
    renders = Renders()
    pairs = RenderedPairs(test, renders)
    assert pairs.changes() == []
    one = pairs.pair(1, 5.0)
    assert pairs.pair(1, 5.0) is one
    assert renders.rendered == [pytest.approx(1.05)]  # the standard is kept by the batch
    pairs.expect(1, 4.0)
    assert pairs.pair(1, 4.0) is not one
    sounds = {name: soundfile.read(io.BytesIO(raw)) for name, raw in one.items()}
    assert set(sounds) == {"standard", "changed"}
    (standard, fs), (changed, _) = sounds["standard"], sounds["changed"]
    assert (fs, len(standard)) == (48000, len(changed))
    assert loudest(standard[:, None], fs, 0.1) == pytest.approx(-23.0, abs=0.05)
    assert loudest(changed[:, None], fs, 0.1) == pytest.approx(-23.0, abs=0.05)
    assert not np.allclose(standard, changed, atol=1e-3)
    for level in range(70):
        pairs._pairs[1, float(100 + level)] = pairs._pairs[1, 5.0]
    pairs.pair(1, 5.0)
    assert len(pairs._pairs) == 64
    assert next(reversed(pairs._pairs)) == (1, 5.0)
    pairs.close()
    (tmp_path / "out" / "work").rename(tmp_path / "gone")
    assert RenderedPairs(test, renders).changes()[0].startswith("page 2: its sound of the batch is not in ")


@pytest.mark.parametrize(
    ("asked", "language"),
    [("de", "de"), ("de-CH", "de"), ("xx, de-AT;q=0.5", "de"), ("xx,de-AT", "de"), ("", "en"), ("xx", "en")],
)
def test_the_first_language_that_is_known_is_taken(every: ListeningTest, asked: str, language: str) -> None:
    from tonewood.workshop.listening.server import ListeningServer

    assert ListeningServer(every)._language(asked) == language


# -- wiring -----------------------------------------------------------------------------------------------------------


def test_factors_that_go_together_cannot_be_told_apart(rng: np.random.Generator) -> None:
    rows = [row(str(i), float(rng.normal()), a=a, b=a.upper(), c=c) for i in range(5) for a in "xy" for c in "pq"]
    found_of = linear_analysis(rows, ["a", "b", "c"], 0.95, {"a": ["x", "y"], "b": ["X", "Y"], "c": ["p", "q"]})
    assert found_of is not None
    assert [n for n in found_of.notes if "told" in n] == [f"{f} cannot be told from the other factors" for f in "ab"]
    left_out = [n.rpartition(", it has empty cells: ")[2] for n in found_of.notes if "empty" in n]
    assert left_out == ["a : b", "a : c", "b : c"]
    assert found_of.formula == "value ~ c"
    assert [t.name for t in found_of.terms] == ["c=q"]


@pytest.mark.parametrize(
    ("page", "mean", "sd", "slope", "margin"),
    [
        (LEVITT, math.sqrt(0.01 * 10), 0.1 * math.log(1000), 10 / math.log(1000), math.log(1.2)),
        (LINEAR, 5.0, 1.0, 1.0, 1.0),
        (LINEAR.model_copy(update={"steps": []}), 5.0, 1.0, 1.0, 0.5),
        (LEVITT.model_copy(update={"steps": [], "expect": 2.0, "expect_sd": 1.5, "expect_slope": 4.0, "margin": 1.3}),
         2.0, math.log(1.5), 4.0, math.log(1.3)),
        (LEVITT.model_copy(update={"steps": []}), math.sqrt(0.1), 0.1 * math.log(1000), 10 / math.log(1000),
         math.log(1.25)),
    ],
)  # fmt: skip
def test_a_staircase_that_states_nothing_is_planned_with_defaults(
    monkeypatch: pytest.MonkeyPatch, page: StaircasePage, mean: float, sd: float, slope: float, margin: float
) -> None:
    """The middle of the levels, a spread of a tenth of them, a slope of ten over them, the last step."""
    asked: list[Any] = []
    place = "tonewood.workshop.listening.power.threshold_listeners"
    monkeypatch.setattr(place, lambda page, people, *given: asked.append((people, *given)) or 12)
    effect, listeners, stated = _staircase(page, None, 0.05, 0.8)
    ((people, by, alpha, power),) = asked
    assert (people.mean, people.sd, people.slope, by) == pytest.approx((mean, sd, slope, margin))
    assert (listeners, alpha, power) == (12, 0.05, 0.8)
    assert stated is (page.expect is not None)
    by_text = f"by {100 * (math.exp(margin) - 1):.0f} %" if page.ratio else f"by {margin:g}"
    assert effect.startswith(f"a mean threshold other {by_text} than {mean:.3g}, spread between listeners ")


def test_thresholds_of_listeners_are_those_of_the_fit() -> None:
    rng = np.random.default_rng(8)
    rows = []
    for who, threshold in (("q", 0.3), ("p", 0.8)):
        for index in range(60):
            level = float(np.exp(rng.uniform(math.log(0.05), math.log(5))))
            p = psychometric(math.log(level), math.log(threshold), 4.0, 1 / 3, LEVITT.share)
            rows.append({"listener": who, "index": index, "level": level, "right": bool(rng.random() < p), "track": 0})
    quest = LEVITT.model_copy(update={"steps": []})
    fit_of = thresholds(rows[::-1], quest, "%", 0.9)  # in any order
    grid = ThresholdGrid(quest)
    tables = [
        grid.likelihood(np.array([r["level"] for r in own]), np.array([r["right"] for r in own]))
        for own in ([r for r in rows if r["listener"] == who] for who in "pq")
    ]
    fit = grid.fit(np.array(tables), 0.9)
    assert [one.listener for one in fit_of.listeners] == ["p", "q"]
    for one, i in zip(fit_of.listeners, (0, 1), strict=True):
        assert (one.trials, one.tracks, one.reversals) == (60, 1, None)
        told = (one.threshold, one.low, one.high, one.alone, one.alone_low, one.alone_high)
        expected = (fit.listeners[i], *fit.intervals[i], fit.alone[i], *fit.alone_intervals[i])
        np.testing.assert_allclose(np.log(np.array(told, dtype=float)), expected, rtol=1e-9)
        assert one.slope == fit.slopes[i]
        assert one.low < one.threshold < one.high  # type: ignore[operator]
    assert (fit_of.mean, fit_of.spread, fit_of.slope) == pytest.approx(
        (math.exp(fit.mean), math.exp(fit.spread), fit.slope)
    )
    assert (fit_of.low, fit_of.high) == pytest.approx(tuple(np.exp(fit.interval)))
    assert fit_of.median == pytest.approx(np.mean([one.threshold for one in fit_of.listeners]))
    assert (fit_of.unit, fit_of.share, fit_of.correction) == ("%", LEVITT.share, None)
    assert thresholds(rows[:60], quest, "%", 0.9).low is None  # of one listener


def test_trials_of_a_staircase_are_counted_from_one(tmp_path: Path) -> None:
    session = Session(fakes.made(tmp_path, [fakes.STAIRS | {"reversals": 4, "longest": 8, "tracks": 2}]), 1)
    seen: list[tuple[int, int | None]] = []
    while session.step is not None and session.step.track is not None:
        seen.append((session.step.repetition, session.step.track))
        level, track = session.step.level, session.tracks[0][session.step.track]
        assert level == track.level
        session.answer({"choice": session.step.correct})
    assert [repetition for repetition, _ in seen] == list(range(1, 17))
    assert sorted(track for _, track in seen) == [0] * 8 + [1] * 8
    assert {track for _, track in seen[:8]} == {0, 1}  # they take turns


def test_a_reference_that_is_no_number_is_not_told() -> None:
    panel, own = found(LEVITT.model_copy(update={"reference": True}), 0.5, 0.4, 0.6)
    assert "instead of" not in _threshold(panel, own, "95 %")


# -- figures and words of choices, careless listeners ------------------------------------------------------------------


def points_of(axes: Any) -> list[tuple[float, float, float]]:
    """Value and ends of each row of a picture."""
    line, _, (bars, *_) = axes.containers[0].lines
    ends = [segment[:, 0] for segment in bars.get_segments()]
    return [(float(x), *map(float, end)) for x, end in zip(line.get_xdata(), ends, strict=True)]


def test_figures_of_choices_are_shares_and_logits() -> None:
    from tonewood.workshop.batch.pages import AbxPage, AfcPage

    for page, chance in (
        (AbxPage.model_validate({"type": "abx", "pairs": {"pluck": "all"}}), 0.5),
        (AfcPage.model_validate({"type": "afc", "pairs": {"pluck": "all"}}), 1 / 3),
    ):
        panel: Any = SimpleNamespace(test=SimpleNamespace(pages=[page]), confidence=0.9, simulated=1, listeners=4)
        pairs = (detected(), detected(cell={"pluck": "far|near"}, share=0.25, low=0.125, high=0.5))
        axes = figures_of(panel, PageResults(1, page.type, "A", 4, (), (), detections=pairs))["shares"].axes[0]
        assert points_of(axes) == [pytest.approx((0.75, 0.6, 0.9)), pytest.approx((0.25, 0.125, 0.5))]
        assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 1.0), (1.5, -0.5))
        assert list(axes.lines[-1].get_xdata()) == pytest.approx([chance] * 2)
        assert (axes.get_xlabel(), axes.get_title()[:27]) == ("share of right answers", "4 listeners, 90 % intervals")
    scale = (ScaleValue("a", 1.5, 1.0, 2.25), ScaleValue("b", -1.5, -2.0, -1.25))
    made = figures_of(panel, PageResults(1, "paired_comparison", "P", 4, (), (), scale=scale))["scale"].axes[0]
    assert points_of(made) == [(1.5, 1.0, 2.25), (-1.5, -2.0, -1.25)]
    assert [text.get_text() for text in made.get_yticklabels()] == ["a", "b"]
    assert (list(made.lines[-1].get_xdata()), made.get_xlabel()) == ([0.0, 0.0], "Bradley-Terry value, logits")


@pytest.mark.parametrize(
    ("highs", "text"),
    [
        (
            (0.4, 0.9, 2.0),
            "b is chosen more often than a{} (95 % intervals of the Bradley-Terry values do not overlap).",
        ),
        ((0.4, 0.49, 2.0), "b is chosen more often than a and c{} (95 % intervals "),
        ((0.5, 0.9, 2.0), "no level is chosen more often than all others{}: the 95 % intervals overlap."),
        ((0.4999, 0.5, 2.0), "b is chosen more often than a{} (95 % "),
    ],
)
def test_the_level_that_is_chosen_most_in_words(highs: tuple[float, float, float], text: str) -> None:
    """b lies at 1, its interval begins at 0.5; a and c are below."""
    a, c, b = highs
    scale = (ScaleValue("a", 0.1, -1.0, a), ScaleValue("b", 1.0, 0.5, b), ScaleValue("c", 0.2, -1.0, c))
    pages = [{p["type"]: p for p in fakes.ALL}["paired_comparison"] | {"pairs": {"d": "all"}}]
    test = SimpleNamespace(pages=[LEVITT, PairedPage.model_validate(pages[0])])
    for page, question in ((2, " in answer to the question"), (1, "")):
        own = PageResults(page, "paired_comparison", "P", 4, (), (), scale=scale)
        panel: Any = SimpleNamespace(test=test, confidence=0.95, pages=(own,))
        (said,) = summary(panel)
        assert said.startswith(f"Page {page}, P: ")
        assert text.format(question) in said


def test_careless_listeners_rate_at_random() -> None:
    one = simulated(careless=1.0, ratings={"d": {"b": -90.0}})
    slots = {"reference": "r", "A": "s", "B": "r"}
    ratings = np.array([list(one._mushra(slots).values()) for _ in range(800)])
    assert (ratings.min(), ratings.max()) == (pytest.approx(0.0, abs=0.5), pytest.approx(100.0, abs=0.5))
    assert ratings.min() >= 0.0
    assert ratings.max() <= 100.0
    assert ratings.mean(axis=0) == pytest.approx([50.0, 50.0], abs=4.0)
    within = np.array([one._within(5.0, 2.0, 6.0) for _ in range(800)])
    assert (within.min(), within.max(), within.mean()) == pytest.approx((2.0, 6.0, 4.0), abs=0.2)
    grades = np.array([list(one._bs1116(slots).values()) for _ in range(800)])
    assert (grades == 5.0).sum(axis=1).tolist() == [1] * 800
    other = grades.min(axis=1)  # 5 less the difference of two uniform numbers from 0 to 100, in 25ths
    assert other.mean() == pytest.approx(5 - 100 / 3 / 25, abs=0.12)
    assert other.min() == pytest.approx(1.0, abs=0.4)


def test_answers_of_a_file_that_is_not_there_are_none(tmp_path: Path) -> None:
    assert _lines_after_the_first(tmp_path / "none") == 0
    (tmp_path / "a.jsonl").write_text("{}\n{}\n{}\n")
    assert _lines_after_the_first(tmp_path / "a.jsonl") == 2


@pytest.mark.parametrize("levels", ["ab", "abc"])
def test_ratings_that_never_differ_have_no_rank_test(levels: str) -> None:
    rows = [{"listener": who, "d": level, "value": 50.0} for who in "xyz" for level in levels]
    ranks = rank_analysis(rows, ["d"])
    assert ranks.tests == ()
    assert {pair.p_value for pair in ranks.pairs} == {1.0}
    differ = [{**row, "value": float(ord(row["d"]))} for row in rows]  # type: ignore[arg-type]
    assert len(rank_analysis(differ, ["d"]).tests) == (1 if levels == "abc" else 0)


@pytest.mark.parametrize(
    ("base", "shift", "odds"),
    [({}, 0.0, False), ({"ordinal": False}, 0.0, False), ({"ordinal": True}, 0.0, True), ({}, 60.0, True)],
)
def test_odds_are_sought_of_grades_and_where_answers_stand_at_an_end(
    base: dict[str, Any], shift: float, odds: bool
) -> None:
    from tonewood.workshop.listening.results import _rated

    values = np.clip(np.array([[40, 50, 45], [44, 52, 41], [39, 55, 49], [42, 49, 47]]) + shift, 0, 100)
    rows = [
        row(str(i), float(v), f=f, role="sound")
        for i, own in enumerate(values)
        for f, v in zip("abc", own, strict=True)
    ]
    table: Any = SimpleNamespace(factors=["f"], levels={"f": list("abc")})
    page: Any = SimpleNamespace(reference={})
    found = _rated({"page": 1, "kind": "rating", "heading": "H"} | base, rows, table, page, 0.95, (), (0.0, 100.0))
    assert (found.odds is not None) == odds
    assert (found.listeners, found.factors) == (4, ("f",))


@pytest.mark.parametrize(
    ("x", "odds"), [(0.5, math.exp(0.5)), (-800.0, 0.0), (709.9, math.exp(700)), (1e4, math.exp(700))]
)
def test_odds_stay_finite(x: float, odds: float) -> None:
    from tonewood.workshop.listening.ordinal import _odds

    assert _odds(x) == odds
