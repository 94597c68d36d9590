"""Simulated experiments: do false alarms, intervals, thresholds and power hold what the report states?

Ratings are drawn as cell means of many experiments at once, and tested by the functions that the report uses; answers
of staircases are drawn trial by trial. `scripts/statistics.py` prints the tables of ``docs/statistics.md`` with them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.detection import Task, sensitivity, shares_of
from tonewood.workshop.listening.incomplete import CrossedFit, IncompleteFit
from tonewood.workshop.listening.models import ScaleValue, bradley_terry, superiorities
from tonewood.workshop.listening.ordinal import clustered, fit_counts
from tonewood.workshop.listening.pooling import D, pooled
from tonewood.workshop.listening.simulations import Population, likelihoods
from tonewood.workshop.listening.thresholds import ThresholdGrid

#: populations without an effect: listeners' own deviations in each level, spread of single answers by level, mean
NULLS = {
    "no effect": {"own": (0.0, 0.0, 0.0), "residual": (9.0, 9.0, 9.0), "mean": 60.0},
    "listeners differ in the factor": {"own": (8.0, 8.0, 8.0), "residual": (9.0, 9.0, 9.0), "mean": 60.0},
    "unequal variance": {"own": (2.0, 6.0, 12.0), "residual": (4.0, 9.0, 14.0), "mean": 50.0},
    "ratings at the ceiling": {"own": (5.0, 5.0, 5.0), "residual": (9.0, 9.0, 9.0), "mean": 95.0},
}
#: which answers are missing: a share of all; a third of every fourth listener's; three of nine sounds of each listener
GAPS: dict[str, float | str] = {
    "5 % at random": 0.05,
    "10 % at random": 0.1,
    "20 % at random": 0.2,
    "a third of every fourth listener's": "third",
    "sets of six of nine sounds": "sets",
}
#: populations that the analyses were not chosen on; answers of these have no ends
OTHERS = ("heavy tails", "skewed differently in each level", "three values only", "one listener in ten responds")
_FACTOR, _SOUND = ("a", "b", "c"), ("s0", "s1", "s2")
_LEVELS = {"factor": list(_FACTOR), "sound": list(_SOUND)}
_CELLS = [(f, s) for f in _FACTOR for s in _SOUND]


def _shares(parts: Sequence[Sequence[Any]]) -> tuple[float, ...]:
    """Means of arrays that experiments gave in parts: one row a part, one column a figure."""
    return tuple(float(np.mean(np.concatenate(x))) for x in zip(*parts, strict=True))


def _means(rows: Sequence[Sequence[Any]]) -> tuple[float, ...]:
    """Means of figures: one row an experiment."""
    return tuple(float(x) for x in np.mean(np.array(rows, dtype=np.float64), axis=0))


@dataclass(frozen=True)
class RatingRates:
    """Shares of experiments: false alarms of factor, two differences, interaction; coverage of the first difference."""

    test: float
    difference: float
    other: float
    interaction: float
    coverage: float


def ratings(
    random: np.random.Generator, experiments: int, listeners: int, null: str, shift: float = 0.0, repetitions: int = 2
) -> Floats:
    """Draw answers (experiments, listeners, 9 cells, repetitions) of three levels and three sounds.

    null : name in `NULLS` or `OTHERS`.
    shift : points by which the second level is higher.
    """
    if null in OTHERS:
        return _others(random, (experiments, listeners), null, shift, repetitions)
    law: Any = NULLS[null]
    shape = (experiments, listeners)
    by_listener = (
        random.normal(0, 6, (*shape, 1, 1)) + random.normal(0, 1, (*shape, 3, 1)) * np.array(law["own"])[:, None]
    )
    y = law["mean"] + by_listener + np.array([0.0, shift, 0.0])[:, None]
    noise = random.normal(0, 1, (*shape, 3, 3, repetitions)) * np.array(law["residual"])[:, None, None]
    answers = np.clip(np.broadcast_to(y, (*shape, 3, 3))[..., None] + noise, 0.0, 100.0)
    return np.asarray(answers.reshape(*shape, 9, repetitions))


def _others(random: np.random.Generator, shape: tuple[int, int], name: str, shift: float, repetitions: int) -> Floats:
    """Answers of `OTHERS`, as `ratings` draws them.

    *Heavy tails*: listeners' responses to a level of 4 times, single answers of 5 times Student's t with 3 degrees of
    freedom. *Skewed*: listeners' responses are normal in the first level, 8 (x - 1) in the second and 8 (1 - x) in the
    third with exponential x. *Three values*: answers below 50 by more than a listener's own limit of 4 to 16 points are
    20, those above it by more than that 80, all others 50. *One in ten*: a tenth of the listeners, drawn for each of
    the last two levels, rates it 18 points above the mean of all, the others 2 below.
    """
    each = (*shape, 3, 3, repetitions)
    means = 50 + random.normal(0, 6, (*shape, 1, 1)) + np.array([0.0, shift, 0.0])[:, None]
    if name == "heavy tails":
        y = (means + 4 * random.standard_t(3, (*shape, 3, 1)))[..., None] + 5 * random.standard_t(3, each)
    elif name == "three values only":
        y = (means + random.normal(0, 8, (*shape, 3, 1)))[..., None] + random.normal(0, 9, each)
        limit = random.uniform(4, 16, (*shape, 1, 1, 1))
        y = np.where(y > 50 + limit, 80.0, np.where(y < 50 - limit, 20.0, 50.0))
    elif name == "one listener in ten responds":
        means[..., 1:, :] += np.where(random.random((*shape, 2, 1)) < 0.1, 18.0, -2.0)
        y = means[..., None] + random.normal(0, 6, each)
    else:
        x = random.exponential(1, (*shape, 3)) - 1
        x[..., 0], x[..., 2] = random.standard_normal(shape), -x[..., 2]
        y = (means + 8 * x[..., None])[..., None] + random.normal(0, 6, each)
    return np.asarray(y.reshape(*shape, 9, repetitions))


def without(random: np.random.Generator, answers: Floats, gaps: str) -> Floats:
    """Cell means (experiments, listeners, 9) of the answers that are left, NaN where none is.

    answers : (experiments, listeners, 9, repetitions).
    gaps : name in `GAPS`.
    """
    law, shape = GAPS[gaps], answers.shape
    if isinstance(law, float):
        gone = random.random(shape) < law
    elif law == "sets":
        gone = np.argsort(random.random(shape[:3]), axis=-1)[..., None] < np.array([3] * shape[3])
    else:
        each = shape[2] * shape[3]
        gone = np.argsort(random.random((*shape[:2], each)), axis=-1) < each // 3
        gone[:, np.arange(shape[1]) % 4 != 0] = False
        gone = gone.reshape(shape)
    count = np.sum(~gone, axis=-1)
    return np.where(count > 0, np.sum(answers, axis=-1, where=~gone) / np.maximum(count, 1), np.nan)


def rating_rates(
    random: np.random.Generator, experiments: int, listeners: int, null: str, gaps: str = "", confidence: float = 0.95
) -> RatingRates:
    """False alarms and coverage of the analysis of complete answers, or of those that `gaps` leaves."""
    contrasts = strata.contrasts(_CELLS, _LEVELS)
    design = np.hstack([np.ones((9, 1)), *contrasts.bases.values()])
    # the shift is kept off the ends of the scale: a true difference is stated only there
    shift = 5.0 if null != "ratings at the ceiling" else 0.0
    true = shift
    if null == "three values only":
        many = ratings(np.random.default_rng(0), 1, 200_000, null, shift)[0].mean(axis=(0, 2)).reshape(3, 3)
        true = float(many[1].mean() - many[0].mean())
    alpha = 1 - confidence

    def analysed(y: Floats) -> tuple[Callable[[Floats], strata.Tested], Callable[[Floats], strata.Estimated]]:
        if not gaps:
            means = y.mean(axis=-1)
            return (
                lambda basis: strata.tested(means, basis, sounds=False),
                lambda rows: strata.estimated(means, rows, confidence, sounds=False),
            )
        fit = IncompleteFit(without(random, y, gaps), design)
        return fit.tested, lambda rows: fit.estimated(rows, confidence)

    parts = []
    for begin in range(0, experiments, 500):
        n = min(500, experiments - begin)
        tested, estimated = analysed(ratings(random, n, listeners, null))
        main, cross = (tested(contrasts.bases[e]).p_value < alpha for e in (("factor",), ("factor", "sound")))
        terms = estimated(contrasts.differences["factor",]).p_value < alpha
        one = analysed(ratings(random, n, listeners, null, shift))[1](contrasts.differences["factor",])
        covered = (one.low[:, 0] <= true) & (true <= one.high[:, 0])
        parts.append([main, terms[:, 0], terms[:, 1], cross, covered])
    return RatingRates(*_shares(parts))


#: standard deviations of the responses of listeners and of sounds to each level, where sounds are a random sample
SPREADS = {"listeners and sounds differ": (5.0, 5.0), "sounds differ": (0.0, 5.0), "listeners differ": (5.0, 0.0),
           "neither differs": (0.0, 0.0)}  # fmt: skip


def sampled_rates(
    random: np.random.Generator, experiments: int, listeners: int, sounds: int, missing: float, spread: str
) -> tuple[float, float, float]:
    """False alarms of a factor of three levels and of its first difference, and coverage, where sounds are a sample.

    Single answers have a standard deviation of 9 points, one for each sound and level; the second level is 5 points
    higher where coverage is asked for.

    spread : name in `SPREADS`.
    """
    contrasts = strata.contrasts([(f,) for f in _FACTOR], {"factor": list(_FACTOR)})
    basis, own = contrasts.bases["factor",], SPREADS[spread]

    def fit(n: int, shift: float) -> CrossedFit:
        y = np.array([50.0, 50.0 + shift, 50.0]) + random.normal(0, 9, (n, listeners, sounds, 3))
        y += random.normal(0, own[0], (n, listeners, 1, 3)) + random.normal(0, own[1], (n, 1, sounds, 3))
        y[random.random(y.shape) < missing] = np.nan
        return CrossedFit(y, np.hstack([np.ones((3, 1)), basis]))

    parts, rows = [], contrasts.differences["factor",]
    for begin in range(0, experiments, 100):
        n = min(100, experiments - begin)
        null, one = fit(n, 0.0), fit(n, 5.0).estimated(rows, 0.95)
        alarms = null.tested(basis).p_value < 0.05, null.estimated(rows, 0.95).p_value[:, 0] < 0.05
        parts.append([*alarms, (one.low[:, 0] <= 5.0) & (one.high[:, 0] >= 5.0)])
    factor, difference, covered = _shares(parts)
    return factor, difference, covered


#: cuts between grades of the latent answers: a scale that is used in the middle, and one near its upper end
CUTS = {"five grades": (-2.0, -0.5, 0.7, 2.0), "five grades, half of the answers the highest": (-4.0, -3.0, -1.5, 0.0)}


def graded(random: np.random.Generator, experiments: int, listeners: int, cuts: str, shift: float) -> Floats:
    """Draw counts (experiments, listeners, 9 cells, grades) of two answers each.

    Latent answers are logistic, with deviations of listeners of 1 and of their responses to each level of 0.7.

    cuts : name in `CUTS`.
    shift : by which the second level is higher (logits of one listener).
    """
    shape = (experiments, listeners)
    latent = random.normal(0, 1, (*shape, 1, 1, 1)) + random.normal(0, 0.7, (*shape, 3, 1, 1))
    latent = latent + np.array([0.0, shift, 0.0])[:, None, None] + random.logistic(size=(*shape, 3, 3, 2))
    grade = np.searchsorted(CUTS[cuts], latent).reshape(*shape, 9, 2)
    return np.stack([np.sum(grade == k, axis=-1) for k in range(5)], axis=-1).astype(np.float64)


def odds_rates(random: np.random.Generator, experiments: int, listeners: int, cuts: str) -> tuple[float, ...]:
    """False alarms of factor, first difference and interaction, coverage of log odds, their bias, and failures.

    The true log odds of a population are those of 40,000 listeners. A search that does not end is a false alarm, an
    interval that misses, and a failure.
    """
    contrasts = strata.contrasts(_CELLS, _LEVELS)
    x = np.hstack(list(contrasts.bases.values()))
    first = contrasts.differences["factor",][0]
    many = graded(np.random.default_rng(0), 1, 40_000, cuts, 1.0)[0].sum(axis=0)
    true = float(first @ x @ fit_counts(many, x)[0])

    def difference(eta: Floats, v: Floats) -> strata.Estimated:
        return strata.t_interval(eta @ first, first @ v @ first, np.full(len(eta), listeners - 1.0), 0.95)

    parts = []
    for begin in range(0, experiments, 200):
        n = min(200, experiments - begin)
        eta, v, done = clustered(graded(random, n, listeners, cuts, 0.0), x)
        main, cross = (
            strata.trace_test(eta @ basis, basis.T @ v @ basis, listeners - 1.0).p_value < 0.05
            for basis in (contrasts.bases["factor",], contrasts.bases["factor", "sound"])
        )
        factor = difference(eta, v).p_value < 0.05
        eta, v, also = clustered(graded(random, n, listeners, cuts, 1.0), x)
        one = difference(eta, v)
        covered = also & (one.low <= true) & (true <= one.high)
        parts.append(
            [main | ~done, factor | ~done, cross | ~done, covered, one.difference / true - 1, (~done + 0.0 + ~also) / 2]
        )
    return _shares(parts)


def choice_rates(
    random: np.random.Generator, experiments: int, listeners: int, each: int, sd: float
) -> tuple[float, float]:
    """Paired comparisons of three levels: how often one is said to be chosen more than another, and coverage.

    each : answers of a listener to each pair.
    sd : standard deviation of listeners' own values of the levels (logits). Without an effect their mean is 0;
        coverage is of a value of 0.8 for listeners who are alike.
    """
    pairs = list(itertools.combinations(range(3), 2))

    def scale(mean: Floats, spread: float) -> list[ScaleValue]:
        thresholds = mean + spread * random.standard_normal((listeners, 3))
        rows = [
            {"listener": str(i), "f": f"{a}|{b}", "value": float(random.random() < 1 / (1 + np.exp(v[a] - v[b])))}
            for i, v in enumerate(thresholds) for a, b in pairs for _ in range(each)
        ]  # fmt: skip
        return sorted(bradley_terry(rows, "f", 0.95), key=lambda one: one.level)

    rows = []
    for _ in range(experiments):
        choices = scale(np.zeros(3), sd)
        best = max(choices, key=lambda one: one.value)
        last = scale(np.array([-0.4, -0.4, 0.8]), 0.0)[2]
        rows.append((any(one.high < best.low for one in choices), last.low <= 0.8 <= last.high))
    alarms, covered = _means(rows)
    return alarms, covered


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
        true, counts, tables = likelihoods(grid, people, listeners, random)
        fit = grid.fit(tables, 0.95)
        inside = (fit.intervals[:, 0] <= true) & (true <= fit.intervals[:, 1])
        low, high = fit.interval
        errors = fit.mean - centre, float(np.mean(fit.listeners - true)), (high - low) / 2
        rows.append((float(np.mean(counts)), low <= centre <= high, float(np.mean(inside)), *errors))
    count, covered, covered_listener, *logs = _means(rows)
    mean, listener, width = (float(np.expm1(x)) for x in logs)
    return ThresholdRates(experiments, count, mean, covered, listener, covered_listener, width)


def sensitivity_rates(
    random: np.random.Generator, experiments: int, listeners: int, answers: int, task: Task, mean: float, sd: float
) -> tuple[float, float, float]:
    """Mean d' of a population: mean estimate, mean of the d' of pooled shares, and coverage of the interval."""
    shares = shares_of(task)
    population = np.maximum(mean + sd * np.random.default_rng(0).standard_normal(200_000), 0.0).mean()
    rows = []
    for _ in range(experiments):
        d_primes = np.maximum(mean + sd * random.standard_normal(listeners), 0.0)
        right = random.binomial(answers, np.interp(d_primes, D, shares)).astype(np.float64)
        value, low, high = pooled(right, np.full(listeners, float(answers)), shares, 0.95)
        together = min(float(right.sum()) / (listeners * answers), 1 - 1e-6)
        rows.append((value, sensitivity(together, task), float(low <= population <= high)))
    a, b, c = _means(rows)
    return a / population - 1, b / population - 1, c


def power_had(random: np.random.Generator, experiments: int, listeners: int, shift: float, sd: float) -> float:
    """Share of experiments, drawn answer by answer, in which the report finds the second of three levels.

    shift : points by which the second level is higher.
    sd : standard deviation of the listeners' differences, from their own responses and single answers in halves.
    """
    contrasts = strata.contrasts(_CELLS, _LEVELS)
    part = sd / 2  # of the level's mean: own response and mean of six answers; var of a difference = 4 part^2
    by_listener = random.normal(0, 6, (experiments, listeners, 1, 1)) + random.normal(
        0, part, (experiments, listeners, 3, 1)
    )
    y = 50 + by_listener + np.array([0.0, shift, 0.0])[:, None]
    y = y + random.normal(0, part * np.sqrt(3), (experiments, listeners, 3, 3))
    p = strata.estimated(
        y.reshape(experiments, listeners, 9), contrasts.differences["factor",], 0.95, sounds=False
    ).p_value
    return float(np.mean(strata.holm(p)[:, 0] < 0.05))


def power_had_by_sounds(
    random: np.random.Generator, experiments: int, listeners: int, sounds: int, shift: float, sd: float, sound_sd: float
) -> float:
    """Share of experiments, drawn answer by answer, in which the report finds one of two levels; sounds are a sample.

    shift : points by which the second level is higher.
    sd : standard deviation of the listeners' differences, half of whose variance is that of single answers.
    """
    rows = strata.contrasts([("a",), ("b",)], {"factor": ["a", "b"]}).differences["factor",]
    detected = 0.0
    for _ in range(experiments):
        y = np.array([50.0, 50.0 + shift]) + random.normal(0, sd / 2, (listeners, 1, 2))
        y = y + random.normal(0, sound_sd / np.sqrt(2), (1, sounds, 2)) + random.normal(0, 6, (listeners, 1, 1))
        y = y + random.normal(0, sd / 2 * np.sqrt(sounds), (listeners, sounds, 2))
        detected += float(strata.estimated(y, rows, 0.95, sounds=True).p_value[0] < 0.05)
    return detected / experiments


def power_had_by_shares(
    random: np.random.Generator, experiments: int, listeners: int, shift: float, sd: float
) -> float:
    """Share of experiments on an ordinal scale of 1 to 5 in which the report finds the second of three levels.

    shift : points by which the second of three levels is higher; the scale cuts answers off.
    sd : standard deviation of listeners' differences, half of whose variance is that of single answers, to six sounds.
    """
    detected = 0
    for _ in range(experiments):
        by_listener = random.normal(3.0, sd / 2, (listeners, 1, 3)) + np.array([0.0, shift, 0.0])
        y = np.clip(by_listener + random.normal(0, sd / 2 * np.sqrt(6), (listeners, 6, 3)), 1, 5)
        rows = [
            {"listener": str(i), "sound": str(j), "factor": _FACTOR[k], "value": float(v)}
            for (i, j, k), v in np.ndenumerate(y)
        ]
        detected += superiorities(rows, ["factor", "sound"], 0.95)[0].p_holm < 0.05
    return detected / experiments


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
        low, high = grid.fit(likelihoods(grid, people, listeners, random)[2], 0.95).interval
        count += not low <= centre + margin <= high
    return count / experiments
