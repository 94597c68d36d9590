"""Thresholds and sensitivities: bias, coverage, and values of other programs."""

from __future__ import annotations

import math
from dataclasses import astuple
from pathlib import Path

import listening_fakes as fakes
import listening_studies as studies
import numpy as np
import pytest
from scipy import stats
from statistics_rows import panel, rows_of

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import models, pooling, simulations
from tonewood.workshop.listening.detection import sensitivity, shares_of
from tonewood.workshop.listening.incomplete import CrossedFit, IncompleteFit
from tonewood.workshop.listening.models import bradley_terry, rank_analysis
from tonewood.workshop.listening.panel import simulate
from tonewood.workshop.listening.plain import methods, summary
from tonewood.workshop.listening.quest import QuestTable, QuestTrack, table_of
from tonewood.workshop.listening.results import analyse
from tonewood.workshop.listening.thresholds import thresholds

GUIDE = {
    "type": "staircase", "path": "exciters.pluck.from_bridge", "scale": "percent", "start": 40.0, "ratio": True,
    "lowest": 0.5, "highest": 80.0, "intervals": 3, "unit": "%",
}  # fmt: skip


LEVITT = {"steps": [2.0, 1.4, 1.2], "down": 2, "reversals": 8, "discard": 2}


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
