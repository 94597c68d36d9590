"""Simulated experiments: do false alarms, intervals and thresholds hold what they state?

Ratings are drawn as cell means of many experiments at once, and tested by the functions that the report uses; answers
of staircases are drawn trial by trial. `tonewood.workshop.listening.power` counts listeners by the same functions, and
``scripts/statistics.py`` prints the tables of ``docs/statistics.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.detection import CHANCE, Task, sensitivity, shares_of, task_of
from tonewood.workshop.listening.models import linear_analysis
from tonewood.workshop.listening.pooling import D, pooled
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.quest import table_of
from tonewood.workshop.listening.staircase import StaircaseTrack
from tonewood.workshop.listening.thresholds import ThresholdGrid

Array = NDArray[np.float64]
#: populations without an effect: listeners' own deviations in each level, spread of single answers by level, mean
NULLS = {
    "no effect": {"own": (0.0, 0.0, 0.0), "residual": (9.0, 9.0, 9.0), "mean": 60.0},
    "listeners differ in the factor": {"own": (8.0, 8.0, 8.0), "residual": (9.0, 9.0, 9.0), "mean": 60.0},
    "unequal variance": {"own": (2.0, 6.0, 12.0), "residual": (4.0, 9.0, 14.0), "mean": 50.0},
    "ratings at the ceiling": {"own": (5.0, 5.0, 5.0), "residual": (9.0, 9.0, 9.0), "mean": 95.0},
}
_FACTOR, _SOUND = ("a", "b", "c"), ("s0", "s1", "s2")
_LEVELS = {"factor": list(_FACTOR), "sound": list(_SOUND)}
_CELLS = [(f, s) for f in _FACTOR for s in _SOUND]


@dataclass(frozen=True)
class RatingRates:
    """Shares of experiments: false alarms, coverage of a true difference, and fits that did not converge."""

    experiments: int
    test: float
    difference: float
    coverage: float
    interaction: float
    failed: float = 0.0


def ratings(
    random: np.random.Generator, experiments: int, listeners: int, null: str, shift: float = 0.0, repetitions: int = 2
) -> Array:
    """Draw answers (experiments, listeners, 9 cells, repetitions) of three levels and three sounds.

    Parameters
    ----------
    null : name in `NULLS`.
    shift : points by which the second level is higher.
    """
    law: Any = NULLS[null]
    shape = (experiments, listeners)
    own = random.normal(0, 6, (*shape, 1, 1)) + random.normal(0, 1, (*shape, 3, 1)) * np.array(law["own"])[:, None]
    y = law["mean"] + own + np.array([0.0, shift, 0.0])[:, None]
    noise = random.normal(0, 1, (*shape, 3, 3, repetitions)) * np.array(law["residual"])[:, None, None]
    answers = np.clip(np.broadcast_to(y, (*shape, 3, 3))[..., None] + noise, 0.0, 100.0)
    return np.asarray(answers.reshape(*shape, 9, repetitions))


def rating_rates(
    random: np.random.Generator, experiments: int, listeners: int, null: str, confidence: float = 0.95
) -> RatingRates:
    """False alarms and coverage of the exact analysis."""
    contrasts = strata.contrasts(_CELLS, _LEVELS)
    # the shift is kept off the ends of the scale: a true difference is stated only there
    shift = 5.0 if null != "ratings at the ceiling" else 0.0
    alpha = 1 - confidence
    parts = []
    for begin in range(0, experiments, 1000):
        n = min(1000, experiments - begin)
        y = ratings(random, n, listeners, null).mean(axis=-1)
        test = strata.tested(y, contrasts.bases["factor",], sounds=False).p_value < alpha
        cross = strata.tested(y, contrasts.bases["factor", "sound"], sounds=False).p_value < alpha
        term = strata.estimated(y, contrasts.differences["factor",], confidence, sounds=False).p_value[..., 0] < alpha
        y = ratings(random, n, listeners, null, shift).mean(axis=-1)
        one = strata.estimated(y, contrasts.differences["factor",], confidence, sounds=False)
        parts.append([test, term, (one.low[..., 0] <= shift) & (shift <= one.high[..., 0]), cross])
    shares = [float(np.mean(np.concatenate(x))) for x in zip(*parts, strict=True)]
    return RatingRates(experiments, *shares)


def missing_rates(
    random: np.random.Generator, experiments: int, listeners: int, null: str, confidence: float = 0.95
) -> RatingRates:
    """False alarms and coverage of the mixed model: a quarter of the listeners' last third of answers is missing."""
    alpha = 1 - confidence
    rates, failed = [], 0
    shift = 5.0 if null != "ratings at the ceiling" else 0.0
    for _ in range(experiments):
        y = ratings(random, 1, listeners, null, shift)[0]
        rows = [
            {"listener": f"l{i}", "factor": f, "sound": s, "value": float(value)}
            for i in range(listeners)
            for k, (f, s) in enumerate(_CELLS)
            for value in y[i, k]
        ]
        kept = np.ones(len(rows), dtype=bool)
        for i in range(0, listeners, 4):
            kept[random.permutation(18)[:6] + 18 * i] = False
        rows = [row for row, keep in zip(rows, kept, strict=True) if keep]
        found = linear_analysis(rows, ["factor", "sound"], confidence, _LEVELS)
        if found is None or not found.converged:
            failed += 1
            continue
        term = next(t for t in found.terms if t.name == "factor=b")
        other = next(t for t in found.terms if t.name == "factor=c")
        sounds = next(t for t in found.tests if t.name == "sound")
        cross = next(t for t in found.tests if ":" in t.name)
        rates.append(
            [sounds.p_value < alpha, other.p_value < alpha, term.low <= shift <= term.high, cross.p_value < alpha]
        )
    shares = np.mean(np.array(rates, dtype=np.float64), axis=0) if rates else np.full(4, np.nan)
    test, difference, coverage, interaction = (float(x) for x in shares)
    return RatingRates(experiments, test, difference, coverage, interaction, failed / experiments)


@dataclass(frozen=True)
class Population:
    """Listeners of a staircase: mean threshold, standard deviation of u, slope and spread of ln b, lapse rate."""

    mean: float
    sd: float
    slope: float
    slope_sd: float = 0.3
    lapses: float = 0.02


def trials(
    page: StaircasePage, thresholds: Array, slopes: Array, lapses: float, random: np.random.Generator
) -> tuple[list[Array], list[NDArray[np.bool_]]]:
    """Let listeners take a staircase.

    Parameters
    ----------
    page : of the staircase.
    thresholds : (listeners,) transformed.
    slopes : (listeners,) per unit of u.
    lapses : lapse rate.
    random : source of the answers.

    Returns
    -------
    levels : of each listener (trials,), all tracks.
    right : of each listener (trials,).
    """
    task = task_of(page)
    assert task is not None
    guess = CHANCE[task]
    if page.adaptive == "quest_plus":
        n = len(thresholds)
        u, table = table_of(page)
        levels, rights = np.empty((n, page.tracks, page.trials)), np.empty((n, page.tracks, page.trials), dtype=bool)
        first = int(np.argmin(np.abs(u - page.transformed(page.start))))
        for k in range(page.tracks):
            posterior, at = np.tile(table.prior, (n, 1)), np.full(n, first)
            for j in range(page.trials):
                p = psychometric(u[at], thresholds, slopes, guess, page.share, lapses)
                right = random.random(n) < p
                levels[:, k, j], rights[:, k, j] = u[at], right
                posterior = table.updated(posterior, at, right)
                at = table.best(posterior)
        back = np.exp(levels) if page.ratio else levels
        return list(back.reshape(n, -1)), list(rights.reshape(n, -1))
    found, answers = [], []
    for t, b in zip(thresholds, slopes, strict=True):
        own: list[float] = []
        right_of: list[bool] = []
        for _ in range(page.tracks):
            track = StaircaseTrack(page)
            while not track.done:
                p = float(psychometric(page.transformed(track.level), t, b, guess, page.share, lapses))
                track.answer(bool(random.random() < p))
            own, right_of = own + track.levels, right_of + track.right
        found.append(np.array(own))
        answers.append(np.array(right_of))
    return found, answers


@dataclass(frozen=True)
class ThresholdRates:
    """Bias of thresholds as a share, coverage of intervals, and the half width of the mean's interval as a share."""

    experiments: int
    trials: float
    bias_mean: float
    coverage_mean: float
    bias_listener: float
    coverage_listener: float
    half_width: float


def threshold_rates(
    random: np.random.Generator, experiments: int, listeners: int, page: StaircasePage, people: Population
) -> ThresholdRates:
    """Bias and coverage of the hierarchical fit of a staircase with ratios."""
    grid = ThresholdGrid(page)
    centre = page.transformed(people.mean)
    rows: list[Sequence[float]] = []
    for _ in range(experiments):
        true = centre + people.sd * random.standard_normal(listeners)
        slopes = people.slope * np.exp(people.slope_sd * random.standard_normal(listeners))
        levels, right = trials(page, true, slopes, people.lapses, random)
        tables = np.array([grid.likelihood(x, r) for x, r in zip(levels, right, strict=True)])
        fit = grid.fit(tables, 0.95)
        inside = (fit.intervals[:, 0] <= true) & (true <= fit.intervals[:, 1])
        rows.append(
            (
                float(np.mean([len(x) for x in levels])), fit.mean - centre,
                float(fit.interval[0] <= centre <= fit.interval[1]), float(np.mean(fit.listeners - true)),
                float(np.mean(inside)), (fit.interval[1] - fit.interval[0]) / 2,
            )
        )  # fmt: skip
    count, mean, covered, own, inside_share, width = (float(x) for x in np.mean(np.array(rows), axis=0))
    return ThresholdRates(
        experiments, count, float(np.expm1(mean)), covered, float(np.expm1(own)), inside_share, float(np.expm1(width))
    )


def sensitivity_rates(
    random: np.random.Generator, experiments: int, listeners: int, answers: int, task: Task, mean: float, sd: float
) -> tuple[float, float, float]:
    """Mean d' of a population: mean estimate, mean of the d' of pooled shares, and coverage of the interval."""
    shares = shares_of(task)
    population = np.maximum(mean + sd * np.random.default_rng(0).standard_normal(200_000), 0.0).mean()
    rows = []
    for _ in range(experiments):
        own = np.maximum(mean + sd * random.standard_normal(listeners), 0.0)
        right = random.binomial(answers, np.interp(own, D, shares)).astype(np.float64)
        value, low, high = pooled(right, np.full(listeners, float(answers)), shares, 0.95)
        together = min(float(right.sum()) / (listeners * answers), 1 - 1e-6)
        rows.append((value, sensitivity(together, task), float(low <= population <= high)))
    a, b, c = (float(x) for x in np.mean(np.array(rows), axis=0))
    return a / population - 1, b / population - 1, c


def power_had(random: np.random.Generator, experiments: int, listeners: int, shift: float, sd: float) -> float:
    """Share of experiments, drawn answer by answer, in which the report finds the second of three levels.

    Parameters
    ----------
    random : source of the answers.
    experiments, listeners : numbers of them.
    shift : points by which the second level is higher.
    sd : standard deviation of the listeners' differences, from their own responses and single answers in halves.
    """
    contrasts = strata.contrasts(_CELLS, _LEVELS)
    part = sd / 2  # of the level's mean: own response and mean of six answers; var of a difference = 4 part^2
    own = random.normal(0, 6, (experiments, listeners, 1, 1)) + random.normal(0, part, (experiments, listeners, 3, 1))
    y = 50 + own + np.array([0.0, shift, 0.0])[:, None]
    y = y + random.normal(0, part * np.sqrt(3), (experiments, listeners, 3, 3))
    p = strata.estimated(
        y.reshape(experiments, listeners, 9), contrasts.differences["factor",], 0.95, sounds=False
    ).p_value
    return float(np.mean(strata.holm(p)[:, 0] < 0.05))


def excluded(
    random: np.random.Generator,
    experiments: int,
    listeners: int,
    page: StaircasePage,
    people: Population,
    margin: float,
) -> float:
    """Share of experiments in which the interval of the mean threshold excludes one that is a margin (of u) higher."""
    grid, centre, count = ThresholdGrid(page), page.transformed(people.mean), 0
    for _ in range(experiments):
        true = centre + people.sd * random.standard_normal(listeners)
        slopes = people.slope * np.exp(people.slope_sd * random.standard_normal(listeners))
        levels, right = trials(page, true, slopes, people.lapses, random)
        tables = np.array([grid.likelihood(x, r) for x, r in zip(levels, right, strict=True)])
        low, high = grid.fit(tables, 0.95).interval
        count += not low <= centre + margin <= high
    return count / experiments
