"""Sensitivity of a population from the answers of several listeners.

d' is a curved function of the share of right answers: the d' of a pooled share lies below the mean d' of listeners who
differ, and the mean of single d' is infinite where one listener is always right. Here the d' of listeners are normal
with mean mu and standard deviation tau, cut off below 0, and the likelihood of all counts is summed over them,

    L(mu, tau) = prod_i  int_0^inf  P(right_i | d) N(d; mu, tau) dd / int_0^inf N(d; mu, tau) dd.

The estimate is the population's mean d' at the greatest likelihood; its interval holds every mean whose likelihood,
maximized over the rest, is within t^2 / 2 of it (t of Student's distribution, listeners - 1). A bound or an estimate at
the upper end of the means that are tried is None: the answers do not limit d' there. In the same-different
task the listeners' criteria are normal, too; their mean and spread are those of greatest likelihood.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tonewood.support.arrays import Floats

#: one number a listener
Counts = NDArray[np.float64] | NDArray[np.intp]
D = np.linspace(0.0, 8.0, 161)
_MU, _TAU = np.linspace(-3.0, 6.0, 121), np.geomspace(0.05, 3.0, 30)
_CRITERIA = np.linspace(0.1, 6.0, 60)


@cache
def _population() -> tuple[Floats, Floats]:
    """Weights (means x spreads, d) of the populations, and the mean d' of each."""
    mu, tau = (x.ravel() for x in np.meshgrid(_MU, _TAU, indexing="ij"))
    x = ((D - mu[:, None]) / tau[:, None]) ** 2 / 2
    weights = np.exp(-(x - x.min(axis=1, keepdims=True)))
    weights[:, 0] /= 2  # the trapezoid at the end of the integral
    weights /= weights.sum(axis=1, keepdims=True)
    return weights, weights @ D


Pooled = tuple[float | None, float, float | None]


def pooled(right: Counts, answers: Counts, shares: Floats, confidence: float) -> Pooled:
    """Mean d' of a population with its interval.

    right, answers : (listeners,) counts.
    shares : (161,) of right answers at `D`.
    """
    p = np.clip(shares, 1e-12, 1 - 1e-12)
    hits, misses = np.asarray(right, dtype=np.float64), np.asarray(answers - right, dtype=np.float64)
    return _estimate(hits[:, None] * np.log(p) + misses[:, None] * np.log1p(-p), confidence)


def pooled_same_different(hits: Counts, different: Counts, alarms: Counts, same: Counts, confidence: float) -> Pooled:
    """Mean d' of a population by the differencing model of the same-different task.

    hits, different : (listeners,) answers "different" to different sounds, and their trials.
    alarms, same : the same of equal sounds.
    """
    d, k = D[:, None], _CRITERIA
    h = np.clip(ndtr((d - k) / np.sqrt(2)) + ndtr((-d - k) / np.sqrt(2)), 1e-12, 1 - 1e-12)
    f = np.clip(2 * ndtr(-k / np.sqrt(2)), 1e-12, 1 - 1e-12)
    logs = (
        hits[:, None, None] * np.log(h) + (different - hits)[:, None, None] * np.log1p(-h)
        + alarms[:, None, None] * np.log(f) + (same - alarms)[:, None, None] * np.log1p(-f)
    )  # fmt: skip
    most = logs.max(axis=(1, 2), keepdims=True)
    like = np.exp(logs - most)
    weights, _ = _population()
    best, estimate = -np.inf, like.sum(axis=2)
    for centre in np.linspace(0.4, 4.0, 13):
        for spread in (0.05, 0.2, 0.4, 0.7, 1.1):
            law = np.exp(-(((k - centre) / spread) ** 2) / 2)
            mean = like @ (law / law.sum())
            value = float(np.max(np.sum(np.log(mean @ weights.T + 1e-300), axis=0)))
            if value > best:
                best, estimate = value, mean
    return _estimate(np.log(estimate + 1e-300), confidence)


def _estimate(logs: Floats, confidence: float) -> Pooled:
    """Estimate and interval from the listeners' logarithms of likelihoods (listeners, d)."""
    from scipy.special import stdtrit

    weights, means = _population()
    like = np.exp(logs - logs.max(axis=1, keepdims=True))
    total = np.sum(np.log(like @ weights.T + 1e-300), axis=0)
    best = int(np.argmax(total))
    t = float(stdtrit(max(len(logs) - 1, 1), (1 + confidence) / 2))
    inside = means[total >= total[best] - t**2 / 2]
    end, high = float(means[len(_TAU) * (len(_MU) - 1)]), float(inside.max())
    value = float(means[best])
    return value if value < end else None, float(inside.min()), high if high < end else None
