"""Discrimination: shares of right answers, and the sensitivity d' behind them.

d' is the distance of the two sounds' means on the listener's decision axis, in standard deviations. How a share of
right answers p follows from it depends on the task (phi, Phi: the standard normal density and distribution):

    2 or 3 intervals, "which has more": p = int phi(z - d') Phi(z)^(m-1) dz                          (Green & Birdsall)
    3 intervals, odd one out:           p = 2 int_0^inf [Phi(-z sqrt 3 + d' sqrt(2/3)) + Phi(-z sqrt 3 - d' sqrt(2/3))]
                                            phi(z) dz                                                        (Frijters)
    ABX, or reference and 2 intervals:  p = Phi(a) Phi(b) + Phi(-a) Phi(-b),  a = d'/sqrt 2, b = d'/sqrt 6
    same or different:                  H = Phi((d' - k)/sqrt 2) + Phi((-d' - k)/sqrt 2),  F = 2 Phi(-k/sqrt 2)

with the hit rate H ("different" of different sounds), the false-alarm rate F ("different" of equal ones) and the
listener's criterion k: so d' does not depend on how readily somebody says "different". The last two are the
differencing models of N. A. Macmillan & C. D. Creelman, Detection Theory, 2nd ed. (2005), chapter 9; the odd one
out is J. E. R. Frijters, Br. J. Math. Stat. Psychol. 32 (1979) 229-241.

Shares have exact (Clopper-Pearson) intervals, in which every answer counts as independent; those of one listener's d'
follow from them. Over several listeners the listeners' shares are averaged with Student's interval, and d' is that of
their population (`tonewood.workshop.listening.pooling`); None where the answers put no upper bound on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy.special import ndtr, ndtri

from tonewood.workshop.batch.pages import AbPage, AbxPage, AfcPage, AnyPage, StaircasePage
from tonewood.workshop.listening import pooling
from tonewood.workshop.listening.means import listener_means, student_interval, unique
from tonewood.workshop.listening.strata import holm

Task = Literal["more_2", "more_3", "odd_3", "abx", "same"]
#: share of right answers of somebody who guesses
CHANCE: Mapping[str, float] = {"more_2": 1 / 2, "more_3": 1 / 3, "odd_3": 1 / 3, "abx": 1 / 2, "same": 1 / 2}
#: d' beyond which shares are 1 to rounding
_LARGEST = 12.0


@dataclass(frozen=True)
class Detection:
    """Answers to one pair of levels, or of one listener to it.

    cell : column -> level; with ``listener`` for one listener.
    right, answers, undecided : numbers; undecided answers are not among the others.
    share, low, high : of right answers, with its exact interval.
    p_value, p_holm : probability of as many right answers by guessing (binomial test, one-sided), and adjusted for the
        other tests of the same table.
    d_prime, d_low, d_high : sensitivity, with its interval; None where no share gives it.
    listener_mean, listener_low, listener_high : mean of the listeners' shares, with Student's interval.
    """

    cell: dict[str, str]
    listeners: int
    right: int
    answers: int
    undecided: int
    share: float | None
    low: float | None
    high: float | None
    p_value: float | None
    d_prime: float | None
    d_low: float | None
    d_high: float | None
    listener_mean: float | None
    listener_low: float | None
    listener_high: float | None
    p_holm: float | None = None


def task_of(page: AnyPage) -> Task | None:
    """The task of a page whose answers are right or wrong."""
    if isinstance(page, AbPage):
        return "same"
    if isinstance(page, AbxPage):
        return "abx"
    if isinstance(page, (AfcPage, StaircasePage)):
        if page.question:
            return "more_2" if page.intervals == 2 else "more_3"
        return "odd_3" if page.intervals == 3 else "abx"
    return None


def chance_of(page: StaircasePage) -> float:
    """Share of right answers of somebody who guesses on a page."""
    task = task_of(page)
    assert task is not None
    return CHANCE[task]


def share_right(d_prime: float, task: Task) -> float:
    """Share of right answers at a sensitivity; for ``same`` that of an unbiased listener (largest over criteria)."""
    z, w = _nodes()
    if task == "abx":
        a, b = d_prime / math.sqrt(2), d_prime / math.sqrt(6)
        return float(ndtr(a) * ndtr(b) + ndtr(-a) * ndtr(-b))
    if task == "odd_3":
        d, half = d_prime * math.sqrt(2 / 3), z > 0
        return float(2 * np.sum((w * (ndtr(-z * math.sqrt(3) + d) + ndtr(-z * math.sqrt(3) - d)))[half]))
    if task == "same":
        k = np.linspace(0.0, d_prime + 4.0, 2001)
        return float(np.max((_different(d_prime, k) + 1 - _different(0.0, k)) / 2))
    return float(np.sum(w * ndtr(z + d_prime) ** (1 if task == "more_2" else 2)))


def sensitivity(share: float, task: Task) -> float:
    """D' that gives a share of right answers: 0 at or below chance, inf at 1."""
    from scipy.optimize import brentq

    if task == "more_2" and CHANCE[task] < share < 1:
        return math.sqrt(2) * float(ndtri(share))
    if share <= CHANCE[task]:
        return 0.0
    if share >= share_right(_LARGEST, task):
        return math.inf
    return float(brentq(lambda d: share_right(d, task) - share, 0.0, _LARGEST, xtol=1e-10))


def sensitivity_same_different(hits: float, false_alarms: float) -> float:
    """D' of a same-different task by the differencing model; rates strictly between 0 and 1."""
    from scipy.optimize import brentq

    k = -math.sqrt(2) * float(ndtri(false_alarms / 2))
    if hits <= false_alarms:
        return 0.0
    return float(brentq(lambda d: float(_different(d, k)) - hits, 0.0, 2 * _LARGEST, xtol=1e-10))


def _different(d_prime: float, k: Any) -> Any:
    """Probability of the answer "different" to two sounds d' apart, at a criterion k."""
    return ndtr((d_prime - k) / math.sqrt(2)) + ndtr((-d_prime - k) / math.sqrt(2))


@cache
def _nodes() -> tuple[Any, Any]:
    """Points and weights of int phi(z) f(z) dz: trapezoids over [-9, 9], no point at 0."""
    step = 18 / 4000
    z = -9 + step * (np.arange(4000) + 0.5)
    return z, step * np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)


def detections(rows: Sequence[Mapping[str, Any]], by: Sequence[str], task: Task, confidence: float) -> list[Detection]:
    """Discrimination in each cell of some columns."""
    cells: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault(tuple(str(row[name]) for name in by), []).append(row)
    return [_detection(dict(zip(by, k, strict=True)), inside, task, confidence) for k, inside in cells.items()]


def adjusted(detections: Sequence[Detection]) -> tuple[Detection, ...]:
    """The same with p by Holm over all of them."""
    tests = [one.p_value for one in detections if one.p_value is not None]
    p = iter(holm(np.array(tests)))
    return tuple(one if one.p_value is None else replace(one, p_holm=float(next(p))) for one in detections)


def _detection(cell: dict[str, str], rows: list[Mapping[str, Any]], task: Task, confidence: float) -> Detection:
    from scipy.stats import binomtest

    decided = [row for row in rows if row["value"] is not None]
    right, n = int(sum(row["value"] for row in decided)), len(decided)
    share = low = high = p_value = d = d_low = d_high = None
    mean = mean_low = mean_high = None
    if n:
        share = right / n
        interval = binomtest(right, n).proportion_ci(confidence, method="exact")
        low, high = float(interval.low), float(interval.high)
        p_value = float(binomtest(right, n, CHANCE[task], alternative="greater").pvalue)
        of = unique([row["listener"] for row in decided])
        if len(of) > 1:
            d, d_low, d_high = _pooled(decided, of, task, confidence)
        elif task == "same":
            d, d_low, d_high = _same_different(decided, confidence)
        else:
            d, d_low, d_high = (_finite(sensitivity(x, task)) for x in (share, low, high))
        mean, mean_low, mean_high = student_interval(list(listener_means(decided).values()), confidence)
    who = unique([row["listener"] for row in rows])
    return Detection(
        cell, len(who), right, n, len(rows) - n, share, low, high, p_value, d, d_low, d_high, mean, mean_low, mean_high
    )


def _pooled(
    rows: list[Mapping[str, Any]], who: list[Any], task: Task, confidence: float
) -> tuple[float | None, float | None, float | None]:
    """D' of the population of several listeners."""
    where = np.array([who.index(row["listener"]) for row in rows])
    right = np.array([bool(row["value"]) for row in rows])
    if task != "same":
        return pooling.pooled(np.bincount(where, right), np.bincount(where, right >= 0), shares_of(task), confidence)
    said_different = np.array([row["response"] == "different" for row in rows])
    differed = said_different == right
    if differed.all() or not differed.any():
        return None, None, None
    hits, different, alarms, same = (
        np.bincount(where, x, len(who))
        for x in (said_different & differed, differed, said_different & ~differed, ~differed)
    )
    return pooling.pooled_same_different(hits, different, alarms, same, confidence)


@cache
def shares_of(task: Task) -> Any:
    """Shares of right answers at the sensitivities of `pooling.D`."""
    return np.array([share_right(float(d), task) for d in pooling.D])


def _same_different(
    rows: list[Mapping[str, Any]], confidence: float, draws: int = 500
) -> tuple[float | None, float | None, float | None]:
    """D' from pooled hits and false alarms, with percentiles of a bootstrap of both counts."""
    different = [row for row in rows if (row["response"] == "different") == bool(row["right"])]
    n, m = len(different), len(rows) - len(different)
    if n == 0 or m == 0:
        return None, None, None
    hits = sum(row["response"] == "different" for row in different)
    alarms = sum(row["response"] == "different" for row in rows) - hits
    rate = _log_linear(n, m)
    random = np.random.default_rng(1)
    h, f = rate(hits, alarms)
    counts = np.column_stack([random.binomial(n, h, draws), random.binomial(m, f, draws)])
    pairs, which = np.unique(counts, axis=0, return_inverse=True)
    drawn = np.array([sensitivity_same_different(*rate(int(a), int(b))) for a, b in pairs])[which.ravel()]
    tail = 50 * (1 - confidence)
    low, high = np.percentile(drawn, [tail, 100 - tail])
    return sensitivity_same_different(h, f), float(low), float(high)


def _log_linear(n: int, m: int) -> Callable[[int, int], tuple[float, float]]:
    """Rates of counts of n and m, half an answer added to each side, so that none is 0 or 1."""
    return lambda hits, alarms: ((hits + 0.5) / (n + 1), (alarms + 0.5) / (m + 1))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
