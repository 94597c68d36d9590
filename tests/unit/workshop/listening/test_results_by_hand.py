"""Rows and figures of results against figures worked out by hand."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import listening_fakes as fakes
import numpy as np
import pyarrow.parquet as pq
import pytest
from listening_by_hand import LEVITT, LINEAR, detected, found, row, simulated
from scipy import stats

from tonewood.workshop.batch.pages import PairedPage, StaircasePage
from tonewood.workshop.listening.answer_file import _lines_after_the_first
from tonewood.workshop.listening.figures import figures_of
from tonewood.workshop.listening.means import cell_means
from tonewood.workshop.listening.models import (
    ScaleValue,
    linear_analysis,
    rank_analysis,
)
from tonewood.workshop.listening.ordinal import (
    clustered,
    ordinal_analysis,
)
from tonewood.workshop.listening.plain import (
    _as_level,
    _in_unit,
    _number,
    _p,
    _scalar,
    _threshold,
    _value,
    methods,
    summary,
)
from tonewood.workshop.listening.power import (
    _staircase,
)
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.report import p_text
from tonewood.workshop.listening.results import (
    PageResults,
    _difference_grades,
    _in_order,
    _share,
    _used,
    levels_of,
    write_tables,
)
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.table import AnswerTable, _cell, _listener_names
from tonewood.workshop.listening.thresholds import (
    ThresholdGrid,
    thresholds,
)

# -- results -----------------------------------------------------------------------------------------------------------


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


# -- tables, odds and sounds on demand ---------------------------------------------------------------------------------


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


# -- wiring ------------------------------------------------------------------------------------------------------------


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
