"""How many listeners a stated effect needs, by simulating the analysis of the report.

*Ratings*: the listeners' means of the levels of the factor in question are drawn with the spread that the page expects,
or with the covariances of a pilot's answers, and analysed by `tonewood.workshop.listening.strata`; the effect counts as
found where the report says so: p by Holm below alpha. *Paired comparisons*: listeners' choices, tested by the
Bradley-Terry interval. *Right answers*: the exact binomial test of the report, one-sided, whose power is a sum and
needs no simulation. *Staircases*: listeners take it trial by trial; power is the share of experiments in which the
interval of the mean threshold excludes a threshold that is `margin` away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import (
    Bs1116Page,
    MushraPage,
    PairPage,
    RatingPage,
    StaircasePage,
    localised,
)
from tonewood.workshop.listening import simulations, strata
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import CHANCE, sensitivity, task_of
from tonewood.workshop.listening.means import unique
from tonewood.workshop.listening.results import PageResults, PanelResults
from tonewood.workshop.listening.thresholds import ThresholdGrid

Array = NDArray[np.float64]
MOST = 10_000
#: simulated experiments: of ratings and choices, and of staircases
EXPERIMENTS, STAIRCASES = 4000, 100
#: standard deviations of listeners' differences where a page states none: points of 100, of grades 1 to 5, of a scale
_SD = {"mushra": 15.0, "bs1116": 0.8}
#: effects where a page states none
_EFFECT = {"mushra": 10.0, "bs1116": 0.5}
_SHARE = 0.70
#: slope over the range of levels, where a page states none
_STEEPNESS = 10.0


@dataclass(frozen=True)
class PowerRow:
    """Listeners that one page needs, with the effect in words; `stated` is False where it is this module's default."""

    page: int
    name: str
    effect: str
    listeners: int
    stated: bool

    def __str__(self) -> str:
        default = "" if self.stated else " (not stated by the page)"
        return f"page {self.page}, {self.name}: {self.listeners} listeners for {self.effect}{default}"


def fewest(power_with: Callable[[int], float], power: float, effect: str) -> int:
    """Fewest listeners, from 3 on, with whom a simulated power is reached.

    Raises
    ------
    ListeningError : more than `MOST` are needed.
    """
    low, high = 2, 4
    while power_with(high) < power:
        low, high = high, 2 * high
        if high > MOST:
            raise ListeningError(f"more than {MOST} listeners would be needed for {effect}")
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_with(middle) >= power else (middle, high)
    return high


def rating_power(
    effects: Sequence[float] | Array, covariance: Array, listeners: int, alpha: float, seed: int = 1
) -> Array:
    """Share of simulated experiments in which the report finds each level's difference from the first.

    Parameters
    ----------
    effects : (levels,) points.
    covariance : (levels, levels) of the listeners' means of the levels.
    listeners, alpha : of the experiment, and of its tests.
    seed : of the draws.

    Returns
    -------
    shares : (levels - 1,).
    """
    names = [str(i) for i in range(len(effects))]
    contrasts = strata.contrasts([(name,) for name in names], {"factor": names})
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    random = np.random.default_rng([seed, listeners])
    count = max(200, min(EXPERIMENTS, 4_000_000 // (listeners * len(effects))))
    y = np.asarray(effects) + random.standard_normal((count, listeners, len(effects))) @ root.T
    p = strata.estimated(y, contrasts.differences["factor",], 1 - alpha, sounds=False).p_value
    return np.asarray((strata.holm(p) < alpha).mean(axis=0))


def choice_power(share: float, each: int, listeners: int, alpha: float, seed: int = 1) -> float:
    """Share of simulated experiments in which the Bradley-Terry interval of a pair excludes 0.

    Parameters
    ----------
    share : of choices of one of the two.
    each : choices of a listener.
    listeners, alpha, seed : as for `rating_power`.
    """
    from scipy.special import stdtrit

    chosen = np.random.default_rng([seed, listeners]).binomial(each, share, (EXPERIMENTS, listeners)) / each
    mean = np.clip(chosen.mean(axis=1), 0.5 / (each * listeners), 1 - 0.5 / (each * listeners))
    error = np.sqrt(listeners / (listeners - 1) * np.sum((chosen - mean[:, None]) ** 2, axis=1)) / listeners
    value = np.log(mean / (1 - mean)) * mean * (1 - mean)
    return float(np.mean(np.abs(value) > stdtrit(listeners - 1, 1 - alpha / 2) * error))


def threshold_listeners(
    page: StaircasePage, people: simulations.Population, margin: float, alpha: float, power: float, seed: int = 1
) -> int:
    """Listeners with whom the interval of the mean threshold excludes one that is a margin (of u) away.

    Raises
    ------
    ListeningError : more than `MOST` are needed.
    """
    random = np.random.default_rng(seed)
    pool, grid, centre = 200, ThresholdGrid(page), page.transformed(people.mean)
    true = centre + people.sd * random.standard_normal(pool)
    slopes = people.slope * np.exp(people.slope_sd * random.standard_normal(pool))
    levels, right = simulations.trials(page, true, slopes, people.lapses, random)
    tables = np.array([grid.likelihood(x, r) for x, r in zip(levels, right, strict=True)])
    spread = float(np.std(grid.fit(tables, 1 - alpha).alone))
    n = max(3, math.ceil((2.8 * spread / margin) ** 2))
    while n <= MOST:
        drawn = random.integers(pool, size=(STAIRCASES, n))
        intervals = [grid.fit(tables[own], 1 - alpha).interval for own in drawn]
        if np.mean([not low <= centre + margin <= high for low, high in intervals]) >= power:
            return n
        n = max(n + 1, math.ceil(1.15 * n))
    raise ListeningError(f"more than {MOST} listeners would be needed for a margin of {margin:g}")


def answers_for_share(share: float, chance: float, alpha: float, power: float) -> int:
    """Fewest answers from which on a one-sided binomial test against guessing has the power.

    The power of an exact test goes up and down with the number of answers; from this number on it stays above.

    Raises
    ------
    ListeningError : more than `MOST` are needed, or the share is not above guessing.
    """
    import numpy as np
    from scipy.stats import binom

    if share <= chance:
        raise ListeningError(f"a share of {share:g} is not above guessing ({chance:.3g})")
    n = np.arange(1, MOST + 1)
    fewest = binom.isf(alpha, n, chance) + 1
    short = np.flatnonzero(binom.sf(fewest - 1, n, share) < power)
    last = int(short[-1]) + 2 if short.size else 1
    if last > MOST:
        raise ListeningError(f"more than {MOST} answers would be needed for a share of {share:g}")
    return last


def power_of(manifest: Manifest, trials: dict[int, int], pilot: PanelResults | None = None) -> list[PowerRow]:
    """Listeners that each page needs.

    Parameters
    ----------
    manifest : with the effects that its pages expect, and the probabilities of errors.
    trials : page (from 0) -> trials that a listener gets of one pair on it.
    pilot : results of listeners who took the same pages; their spread, and their effects where a page expects none,
        take the place of the stated ones.
    """
    alpha, power = manifest.power.alpha, manifest.power.power
    rows = []
    for index, page in enumerate(manifest.pages):
        name = localised(getattr(page, "name", ""), manifest.language) or page.type
        number = index + 1
        own = next((p for p in pilot.pages if p.page == number), None) if pilot is not None else None
        if isinstance(page, (MushraPage, Bs1116Page, RatingPage)):
            rows.append(_rated(manifest, page, number, name, own))
        elif isinstance(page, PairPage):
            task = task_of(page)
            chance = 0.5 if task is None else CHANCE[task]
            seen = _share_of(own)
            share = page.expect or (seen if seen is not None else _SHARE)
            each = max(trials.get(index, 1), 1)
            text = f"{100 * share:.0f} % {'chosen' if task is None else 'right'}"
            if task is None:
                n = fewest(lambda k, s=share, e=each: choice_power(s, e, k, alpha), power, text)  # type: ignore[misc]
                text += f": {n * each} answers, {each} a listener"
            else:
                answers = answers_for_share(share, chance, alpha, power)
                n = math.ceil(answers / each)
                d = "" if task == "same" else f", d' = {sensitivity(share, task):.2f}"
                text += f"{d}: {answers} answers, {each} a listener"
            rows.append(PowerRow(number, name, text, n, page.expect is not None or seen is not None))
        elif isinstance(page, StaircasePage) and (page.expect_sd is not None or own is not None):
            rows.append(_staircase(page, number, name, own, alpha, power))
    return rows


def _rated(
    manifest: Manifest, page: MushraPage | Bs1116Page | RatingPage, number: int, name: str, own: PageResults | None
) -> PowerRow:
    alpha, power = manifest.power.alpha, manifest.power.power
    width = 100.0 if not isinstance(page, RatingPage) else page.scales[0].high - page.scales[0].low
    effect = page.expect or _EFFECT.get(page.type, 0.1 * width)
    sd = page.expect_sd or _SD.get(page.type, 0.15 * width)
    reference = getattr(page, "reference", None) or {}
    varied = [f for f, levels in manifest.choices().items() if f not in page.group_by and len(levels) > 1]
    varied.sort(key=lambda f: f not in reference)
    k = len(manifest.choices()[varied[0]]) if varied else 2
    effects, covariance = np.zeros(k), sd**2 / 2 * np.eye(k)
    text = f"{effect:g} points, sd {sd:g}"
    pilot = None if own is None or not own.factors else _listener_levels(own, reference.get(own.factors[0]))
    if pilot is not None and pilot.shape[0] > 2:
        covariance, k = np.atleast_2d(np.cov(pilot, rowvar=False)), pilot.shape[1]
        effects = np.zeros(k)
        if page.expect is None:
            effects = pilot.mean(axis=0) - pilot.mean(axis=0)[0]
            effect = float(effects[np.argmax(np.abs(effects))])
        text = f"{effect:.3g} points, spread of {len(pilot)} listeners of a pilot"
    at = int(np.argmax(np.abs(effects[1:]))) if np.any(effects) else 0
    if not np.any(effects):
        effects[1] = effect
    text += f", {k} levels" if k > 2 else ""
    n = fewest(lambda m: float(rating_power(effects, covariance, m, alpha)[at]), power, text)
    return PowerRow(number, name, text, n, page.expect is not None or pilot is not None)


def _listener_levels(own: PageResults, first: str | None) -> Array:
    """Means (listeners, levels) of the levels of a page's first factor, of listeners who have all."""
    rows = [row for row in own.rows if row["role"] in ("sound", "reference") and row["value"] is not None]
    factor = own.factors[0]
    levels = sorted(unique([str(row[factor]) for row in rows]), key=lambda level: level != first)
    values: dict[Any, list[list[float]]] = {}
    for row in rows:
        of = values.setdefault(row["listener"], [[] for _ in levels])
        of[levels.index(str(row[factor]))].append(float(row["value"]))
    return np.array([[np.mean(x) for x in of] for of in values.values() if all(of)])


def _share_of(own: PageResults | None) -> float | None:
    """Largest share of right answers of a pilot's page."""
    shares = [d.share for d in own.detections if d.share is not None] if own is not None else []
    return max(shares) if shares else None


def _staircase(
    page: StaircasePage, number: int, name: str, own: PageResults | None, alpha: float, power: float
) -> PowerRow:
    span = page.transformed(page.highest) - page.transformed(page.lowest)
    slope = page.expect_slope or _STEEPNESS / span
    sd = page.transformed(page.expect_sd) if page.expect_sd is not None else 0.1 * span
    middle = page.level_of(page.transformed(page.lowest) + 0.5 * span)
    mean = page.expect or middle
    if own is not None and (seen := own.thresholds) is not None:
        mean, slope, sd = seen.mean, seen.slope, page.transformed(seen.spread)
    last = page.steps[-1] if page.steps else (1.25 if page.ratio else 0.05 * span)
    margin = page.margin or last
    n = threshold_listeners(
        page, simulations.Population(mean, sd, slope), page.transformed(margin), alpha, power
    )  # fmt: skip
    by = f"by {100 * (margin - 1):.0f} %" if page.ratio else f"by {margin:g}"
    text = f"a mean threshold other {by} than {mean:.3g}, spread between listeners {page.level_of(sd):.3g}"
    return PowerRow(number, name, text, n, page.expect is not None or own is not None)
