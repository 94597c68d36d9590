"""Thresholds of staircases, of each listener and of the population, from all trials.

Listener i answers by the psychometric function of `tonewood.workshop.listening.psychometric` with threshold T_i, slope
b_i and lapse rate l_i. In the population

    u(T) ~ N(mu, tau^2),    ln b ~ N(m, 0.4^2),    l ~ Beta(1, 30) on a grid

The likelihood of each listener is summed over slopes and lapses. With flat priors of mu and tau and a wide one of m
the posterior of (mu, tau, m) is summed on a grid: the mean threshold and its
interval are the median and percentiles of mu, those of each listener the median and percentiles of T_i. A listener with
few trials is thereby drawn towards the others. The threshold of a listener alone, with no others, has a flat prior.

Reversals of a staircase lie above the level that Levitt's argument names, the more so the larger the steps and the
shallower the function. `reversals` is the mean of the tracks' reversals less the mean error of as many simulated
tracks of listeners of this population.

Sources: R. E. Kass & D. Steffey, J. Am. Stat. Assoc. 84 (1989) 717-726 (hierarchical models); H. H. Schuett et al.,
Vision Res. 122 (2016) 105-123 (prior of lapses).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import chance_of
from tonewood.workshop.listening.means import unique
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.quest import QuestTrack
from tonewood.workshop.listening.staircase import StaircaseTrack

#: points of the grids: thresholds, means, standard deviations
_POINTS, _MEANS, _SPREADS = 241, 121, 40
#: standard deviation of ln b between listeners, and the grid of ln b
SLOPE_SD = 0.4
_LAPSES = np.array([0.005, 0.02, 0.05, 0.1, 0.2])
_LAPSE_PRIOR = 30 * (1 - _LAPSES) ** 29 * np.array([0.0125, 0.0225, 0.04, 0.075, 0.1])
#: simulated tracks from which the error of reversals is estimated
_TRACKS = 200
#: most rounds between slope and thresholds of the population
_ROUNDS = 6


@dataclass(frozen=True)
class ListenerThreshold:
    """Threshold of one listener.

    reversals : mean of the tracks' thresholds from their reversals, corrected; None if no track has them.
    threshold, low, high : of the hierarchical fit; a bound at the end of the levels is None.
    alone, alone_low, alone_high : of this listener's answers alone.
    slope : b, per unit of u.
    """

    listener: str
    trials: int
    tracks: int
    reversals: float | None
    threshold: float
    low: float | None
    high: float | None
    alone: float
    alone_low: float | None
    alone_high: float | None
    slope: float


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of all listeners of a staircase, and the mean of the population (of logarithms for ratios).

    `spread` is the standard deviation between listeners (a ratio where steps are ratios), `slope` that of a typical
    listener per unit of u, `correction` the mean error of reversals that is taken off (a ratio, or a difference).
    """

    unit: str
    share: float
    listeners: tuple[ListenerThreshold, ...]
    mean: float
    low: float | None
    high: float | None
    median: float
    spread: float
    slope: float
    correction: float | None = None


AdaptiveTrack = StaircaseTrack | QuestTrack


def track_of(page: StaircasePage) -> AdaptiveTrack:
    """A new track of a page, of its method."""
    return QuestTrack(page) if page.adaptive == "quest_plus" else StaircaseTrack(page)


def thresholds(rows: Sequence[Mapping[str, Any]], page: StaircasePage, unit: str, confidence: float) -> Thresholds:
    """Thresholds from the answers to one staircase page."""
    who = unique([row["listener"] for row in rows])
    grid = ThresholdGrid(page)
    tables, reversals, counts = [], [], []
    for name in who:
        trials = sorted((row for row in rows if row["listener"] == name), key=lambda row: row["index"])
        levels = np.array([row["level"] for row in trials], dtype=np.float64)
        right = np.array([bool(row["right"]) for row in trials])
        tables.append(grid.likelihood(levels, right))
        ends = []
        if page.adaptive == "levitt":
            tracks = [StaircaseTrack(page) for _ in range(page.tracks)]
            for row in trials:
                tracks[int(row["track"])].answer(bool(row["right"]))
            ends = [end for track in tracks if (end := track.threshold) is not None]
        reversals.append(page.transformed(page.mean(ends)) if ends else None)
        counts.append(len(trials))
    fit = grid.fit(np.array(tables), confidence)
    error = _error_of_reversals(page, fit) if any(x is not None for x in reversals) else None
    estimates = [
        ListenerThreshold(
            name, counts[i], page.tracks, None if (r := reversals[i]) is None else page.level_of(r - (error or 0.0)),
            page.level_of(fit.listeners[i]), grid.bound(fit.intervals[i, 0]), grid.bound(fit.intervals[i, 1]),
            page.level_of(fit.alone[i]), grid.bound(fit.alone_intervals[i, 0]), grid.bound(fit.alone_intervals[i, 1]),
            float(fit.slopes[i]),
        )
        for i, name in enumerate(who)
    ]  # fmt: skip
    middle = float(np.median([one.threshold for one in estimates]))
    low, high = (grid.bound(x) if len(who) > 1 else None for x in fit.interval)
    return Thresholds(
        unit, page.share, tuple(estimates), page.level_of(fit.mean), low, high, middle,
        math.exp(fit.spread) if page.ratio else fit.spread, fit.slope,
        None if error is None else math.exp(error) if page.ratio else error,
    )  # fmt: skip


@dataclass(frozen=True)
class PopulationFit:
    """A hierarchical fit, in transformed levels u; arrays have an entry for each listener.

    mean, interval, spread, slope : mu, its interval, tau and b of the population.
    listeners, intervals : (n,) and (n, 2) thresholds in the population.
    alone, alone_intervals : thresholds of each listener's answers alone.
    slopes : (n,) of each listener.
    """

    mean: float
    interval: tuple[float, float]
    spread: float
    slope: float
    listeners: Floats
    intervals: Floats
    alone: Floats
    alone_intervals: Floats
    slopes: Floats


class ThresholdGrid:
    """Grids on which the likelihoods of a page's answers are summed."""

    def __init__(self, page: StaircasePage):
        self.page = page
        low, high = page.transformed(page.lowest), page.transformed(page.highest)
        self.span = high - low
        self.limits = (low, high)
        self.u = np.linspace(low - 0.25 * self.span, high + 0.25 * self.span, _POINTS)
        self.slopes = np.geomspace(1.5, 100.0, 22) / self.span
        self.guess = chance_of(page)
        self._logs: dict[float, tuple[Floats, Floats]] = {}

    def likelihood(self, levels: Floats, right: NDArray[np.bool_]) -> Floats:
        """Logarithm of the likelihood (thresholds, slopes) of one listener's answers, summed over lapse rates."""
        x = np.log(levels) if self.page.ratio else levels
        at, places = np.unique(x, return_inverse=True)
        hits = np.bincount(places, right, len(at))
        misses = np.bincount(places, ~right, len(at))
        logs = np.log(_LAPSE_PRIOR / _LAPSE_PRIOR.sum())[:, None, None]
        for level, hit, miss in zip(at, hits, misses, strict=True):
            right_of, wrong_of = self._answers(float(level))
            logs = logs + hit * right_of + miss * wrong_of
        most = logs.max(axis=0)
        return np.asarray(most + np.log(np.sum(np.exp(logs - most), axis=0)))

    def _answers(self, level: float) -> tuple[Floats, Floats]:
        """Logarithms of probabilities (lapse rates, thresholds, slopes) of right and wrong answers; kept by level."""
        if level not in self._logs:
            p = psychometric(
                level, self.u[:, None], self.slopes, self.guess, self.page.share, _LAPSES[:, None, None]
            )  # fmt: skip
            p = np.clip(p, 1e-9, 1 - 1e-9)
            self._logs[level] = np.log(p), np.log1p(-p)
        return self._logs[level]

    def fit(self, tables: Floats, confidence: float) -> PopulationFit:
        """Fit the population to likelihoods (listeners, thresholds, slopes)."""
        like = np.exp(tables - tables.max(axis=(1, 2), keepdims=True))
        logs = np.log(self.slopes)
        centres = np.linspace(logs[0], logs[-1], 45)
        weights = np.exp(-0.5 * ((logs - centres[:, None]) / SLOPE_SD) ** 2)
        weights /= weights.sum(axis=1, keepdims=True)
        start = like @ weights.T  # (listeners, thresholds, centres)
        penalty = 0.5 * ((centres - math.log(10.0 / self.span)) / 1.5) ** 2
        likelihood, best = start.mean(axis=2), -1
        for _ in range(_ROUNDS):  # m of greatest likelihood under the population's thresholds, and these again
            mu, tau = self._grids(likelihood)
            kernel = self._kernel(mu, tau)
            peak = np.argmax(np.sum(np.log(likelihood @ kernel.T + 1e-300), axis=0))
            evidence = np.sum(np.log(np.einsum("ntc,t->nc", start, kernel[peak]) + 1e-300), axis=0) - penalty
            last, best = best, int(np.argmax(evidence))
            if best == last:
                break
            likelihood = start[..., best]
        near = np.flatnonzero(evidence > evidence[best] - 5.0)
        near = near[:: max(1, len(near) // 8)]
        shares = np.array([start[..., c] @ kernel.T + 1e-300 for c in near])  # (slopes, listeners, means x spreads)
        logs_of = np.sum(np.log(shares), axis=1) - penalty[near, None]
        joint = np.exp(logs_of - logs_of.max())
        joint /= joint.sum()
        posterior = joint.sum(axis=0).reshape(len(mu), len(tau))
        mean, spread = quantile(mu, posterior.sum(axis=1), 0.5), quantile(tau, posterior.sum(axis=0), 0.5)
        tail = (1 - confidence) / 2
        of_mean = posterior.sum(axis=1)
        interval = (quantile(mu, of_mean, tail), quantile(mu, of_mean, 1 - tail))
        each, alone = np.empty((len(likelihood), 3)), np.empty((len(likelihood), 3))
        mixed = sum((w / p) @ kernel * start[..., c] for w, p, c in zip(joint, shares, near, strict=True))
        weight = joint.sum(axis=1)
        likelihood = start[..., near] @ weight
        best = int(near[int(np.argmin(np.abs(np.cumsum(weight) - 0.5)))])
        levels = (0.5, tail, 1 - tail)
        slopes = np.empty(len(likelihood))
        for i in range(len(likelihood)):
            each[i] = [quantile(self.u, mixed[i], q) for q in levels]
            alone[i] = [quantile(self.u, likelihood[i], q) for q in levels]
            at = int(np.argmin(np.abs(self.u - each[i, 0])))
            share = like[i, at] * weights[best]
            slopes[i] = math.exp(float(share @ logs / share.sum()))
        return PopulationFit(
            mean, interval, spread, math.exp(float(centres[best])), each[:, 0], each[:, 1:], alone[:, 0], alone[:, 1:],
            slopes,
        )  # fmt: skip

    def _grids(self, likelihood: Floats) -> tuple[Floats, Floats]:
        """Grids of mu and tau for the listeners' likelihoods (listeners, thresholds)."""
        n = len(likelihood)
        means = (likelihood @ self.u) / likelihood.sum(axis=1)
        errors = np.sqrt(np.maximum((likelihood @ self.u**2) / likelihood.sum(axis=1) - means**2, 0.0))
        step = self.u[1] - self.u[0]
        wide = max(float(np.std(means)), float(np.median(errors)) / math.sqrt(n), 2 * step)
        reach = (6.0 if n > 3 else 10.0) * wide * math.sqrt(max(1.0, 4.0 / n))
        middle = float(np.median(means))
        mu = np.linspace(max(middle - reach, self.u[0]), min(middle + reach, self.u[-1]), _MEANS)
        return mu, np.linspace(0.25 * step, 4.0 * wide, _SPREADS)

    def _normal(self, mu: Any, tau: Any) -> Floats:
        """Normal weights over the thresholds' grid that sum to 1, with the width of a step added."""
        step = self.u[1] - self.u[0]
        x = (self.u - np.asarray(mu)[..., None]) / np.sqrt(np.asarray(tau)[..., None] ** 2 + step**2 / 4)
        density = np.exp(-0.5 * np.minimum(x**2, 1400.0))
        return np.asarray(density / density.sum(axis=-1, keepdims=True))

    def _kernel(self, mu: Floats, tau: Floats) -> Floats:
        a, b = np.meshgrid(mu, tau, indexing="ij")
        return self._normal(a.ravel(), b.ravel())

    def bound(self, u: float) -> float | None:
        """A bound as a level; None beyond the levels that can be presented."""
        return self.page.level_of(u) if self.limits[0] <= u <= self.limits[1] else None


def quantile(x: Floats, weights: Floats, q: float) -> float:
    """Quantile of a density given at equally spaced points."""
    total = np.cumsum(weights)
    centred = (total - weights / 2) / total[-1]
    return float(np.interp(q, centred, x))


def _error_of_reversals(page: StaircasePage, fit: PopulationFit) -> float:
    """Mean of reversals less thresholds, over simulated tracks of listeners of a population."""
    random, guess, errors = np.random.default_rng(20), chance_of(page), []
    for _ in range(_TRACKS):
        threshold = fit.mean + fit.spread * random.standard_normal()
        track = StaircaseTrack(page)
        while not track.done:
            p = psychometric(page.transformed(track.level), threshold, fit.slope, guess, page.share)
            track.answer(bool(random.random() < p))
        if track.threshold is not None:
            errors.append(page.transformed(track.threshold) - threshold)
    return float(np.mean(errors)) if errors else 0.0
