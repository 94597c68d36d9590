"""Means, models, detection, grades, staircases and thresholds against figures worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from listening_by_hand import LEVITT, LINEAR, row
from scipy import optimize, special, stats

from tonewood.workshop.batch.pages import PairedPage, StaircasePage
from tonewood.workshop.listening.cells import cells_of, shared
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import adjusted, detections, sensitivity, share_right, task_of
from tonewood.workshop.listening.means import cell_means, listener_means, screen, student_interval
from tonewood.workshop.listening.models import (
    bradley_terry,
    linear_analysis,
    rank_analysis,
    share_interval,
    share_test,
)
from tonewood.workshop.listening.ordinal import (
    fit_counts,
    grades,
)
from tonewood.workshop.listening.pooling import D, pooled
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.quest import LEVELS, QuestTable, QuestTrack, table_of
from tonewood.workshop.listening.staircase import StaircaseTrack
from tonewood.workshop.listening.table import Key, KeySound, tidy
from tonewood.workshop.listening.thresholds import (
    ThresholdGrid,
    quantile,
    track_of,
)

# -- means, cells and models -------------------------------------------------------------------------------------------


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


# -- detection ---------------------------------------------------------------------------------------------------------


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


# -- grades, psychometric functions, staircases ------------------------------------------------------------------------


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


# -- the fit of thresholds ---------------------------------------------------------------------------------------------


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
