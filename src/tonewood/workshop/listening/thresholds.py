"""Thresholds of staircases: from reversals, and from a psychometric function fitted to all trials.

    p(x) = g + (1 - g - l) F(b (u(x) - u(T)) + F^-1(q)),   F(v) = 1 / (1 + e^-v),   q = (P - g) / (1 - g - l)

with the share g of right guesses, the lapse rate l = 0.02, u(x) = x (ln x where steps are ratios), and the threshold T:
the level at which a share P = 2^(-1/down) of the answers is right, the one that the staircase converges to. T and the
slope b maximize the likelihood on a grid; the interval of T holds all values of which the likelihood, maximized over b,
is within chi^2(1)/2 of the maximum. Source: F. A. Wichmann & N. J. Hill, Percept. Psychophys. 63 (2001) 1293-1313.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import CHANCE, task_of
from tonewood.workshop.listening.means import student_interval, unique
from tonewood.workshop.listening.staircase import StaircaseTrack

LAPSES = 0.02
_SLOPES = np.geomspace(0.3, 60.0, 60)  # of the range of levels covered, in units of 1 / range


@dataclass(frozen=True)
class ListenerThreshold:
    """Threshold of one listener.

    Attributes
    ----------
    reversals : mean of the tracks' thresholds, from their reversals; None if no track has them.
    threshold, low, high : of the psychometric function, with its interval; a bound that the trials do not give is None.
    slope : b, per unit of u.
    """

    listener: str
    trials: int
    tracks: int
    reversals: float | None
    threshold: float
    low: float | None
    high: float | None
    slope: float


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of all listeners of a staircase, and their mean with Student's interval (of logarithms for ratios)."""

    unit: str
    share: float
    listeners: tuple[ListenerThreshold, ...]
    mean: float
    low: float | None
    high: float | None
    median: float


def thresholds(rows: Sequence[Mapping[str, Any]], page: StaircasePage, unit: str, confidence: float) -> Thresholds:
    """Thresholds from the answers to one staircase page."""
    found = []
    for who in unique([row["listener"] for row in rows]):
        own = sorted((row for row in rows if row["listener"] == who), key=lambda row: row["index"])
        tracks = [StaircaseTrack(page) for _ in range(page.tracks)]
        for row in own:
            tracks[int(row["track"])].answer(bool(row["right"]))
        ends = [end for track in tracks if (end := track.threshold) is not None]
        levels = np.array([row["level"] for row in own], dtype=np.float64)
        right = np.array([bool(row["right"]) for row in own])
        threshold, low, high, slope = fitted(levels, right, page, confidence)
        reversals = page.mean(ends) if ends else None
        found.append(ListenerThreshold(who, len(own), len(tracks), reversals, threshold, low, high, slope))
    values = [math.log(one.threshold) if page.ratio else one.threshold for one in found]
    middle = float(np.median([one.threshold for one in found]))
    mean, lower, upper = student_interval(values, confidence)
    ends_of = [None if x is None else math.exp(x) if page.ratio else x for x in (mean, lower, upper)]
    return Thresholds(unit, 2.0 ** (-1 / page.down), tuple(found), ends_of[0] or 0.0, ends_of[1], ends_of[2], middle)


def psychometric(u: NDArray[np.float64], threshold: Any, slope: Any, guess: float, share: float) -> Any:
    """Share of right answers at transformed levels u; see the module."""
    q = (share - guess) / (1 - guess - LAPSES)
    return guess + (1 - guess - LAPSES) / (1 + np.exp(-slope * (u - threshold)) * (1 - q) / q)


def fitted(
    levels: NDArray[np.float64], right: NDArray[np.bool_], page: StaircasePage, confidence: float
) -> tuple[float, float | None, float | None, float]:
    """Threshold, bounds of its interval, and slope, from levels (n,) and whether each answer was right (n,)."""
    from scipy.stats import chi2

    u = np.log(levels) if page.ratio else levels
    limits = [math.log(x) if page.ratio else x for x in (page.lowest, page.highest)]
    task = task_of(page)
    assert task is not None
    span = max(float(np.ptp(u)), 1e-9 * (limits[1] - limits[0]))
    low, high = float(u.min()) - span, float(u.max()) + span
    grid = np.linspace(low, high, 601)
    slopes = _SLOPES / span
    at, places = np.unique(u, return_inverse=True)
    hits = np.bincount(places, right, len(at))
    misses = np.bincount(places, ~right, len(at))
    with np.errstate(over="ignore"):
        p = psychometric(at[:, None, None], grid[:, None], slopes, CHANCE[task], 2.0 ** (-1 / page.down))
    p = np.clip(p, 1e-12, 1 - 1e-12)
    likelihood = np.tensordot(hits, np.log(p), 1) + np.tensordot(misses, np.log1p(-p), 1)
    profile = likelihood.max(axis=1)
    best = int(np.argmax(profile))
    inside = np.flatnonzero(profile >= profile[best] - chi2.ppf(confidence, 1) / 2)
    ends = [None if edge in (0, len(grid) - 1) else float(grid[edge]) for edge in (int(inside[0]), int(inside[-1]))]
    back = [None if x is None else math.exp(x) if page.ratio else x for x in (float(grid[best]), *ends)]
    return float(back[0] or 0.0), back[1], back[2], float(slopes[int(np.argmax(likelihood[best]))])
