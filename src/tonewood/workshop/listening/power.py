"""How many listeners a stated effect needs, by simulating the analysis of the report.

*Ratings*: the listeners' means of the levels of the factor in question are drawn with the spread that the page expects,
or with the covariances of a pilot's answers, and analysed by `tonewood.workshop.listening.strata`; the effect counts as
found where the report says so: p by Holm below alpha. Where the screening left some of a pilot's listeners out, its
listeners are drawn, each with the verdict on them, and both analyses of the report must find the effect. Stated effects
of a MUSHRA page are heard, rated and screened as by a simulated panel (`tonewood.workshop.listening.panel`). Where
sounds are a random sample, they are drawn, too, and the analysis is the quasi-F of listeners and sounds.
*Ordinal scales*: answers are drawn one by one, cut off at the ends of the scale, and the shares of comparisons are
tested, which the report's sentence states. *Paired comparisons*:
listeners' choices, tested by the Bradley-Terry interval. *Right answers*: the exact binomial test of a pair over all
cells, one-sided, whose power is a sum and needs no simulation; listeners are taken for alike. *Staircases*: listeners
take it trial by trial; power is the share of experiments in which the interval of the mean threshold excludes a
threshold that is `margin` away.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.units import counted
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import (
    AnyPage,
    Bs1116Page,
    MushraPage,
    PairPage,
    RatingPage,
    StaircasePage,
    as_pairs,
    localised,
)
from tonewood.workshop.listening import simulations, strata
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import CHANCE, sensitivity, task_of
from tonewood.workshop.listening.means import LIMIT_SCORE, LIMIT_SHARE, unique
from tonewood.workshop.listening.models import share_test
from tonewood.workshop.listening.panel import SimulatedPanel
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


class TooManyListenersError(ListeningError):
    """No number of listeners up to `MOST` is enough."""


@dataclass(frozen=True)
class PowerRow:
    """Listeners that one page needs, with the effect in words; `stated` is False where it is this module's default.

    `listeners` is None where no number up to `MOST` is enough.
    """

    page: int
    name: str
    effect: str
    listeners: int | None
    stated: bool

    def __str__(self) -> str:
        default = "" if self.stated else " (not stated by the page)"
        if self.listeners is None:
            return f"page {self.page}, {self.name}: {self.effect}{default}"
        return f"page {self.page}, {self.name}: {self.listeners} listeners for {self.effect}{default}"


def fewest(power_with: Callable[[int], float], power: float, effect: str) -> int:
    """Fewest listeners, from 3 on, with whom a simulated power is reached.

    Raises
    ------
    TooManyListenersError : more than `MOST` are needed.
    """
    low, high = 2, 4
    while power_with(high) < power:
        if high >= MOST:
            raise TooManyListenersError(f"more than {MOST} listeners would be needed for {effect}")
        low, high = high, min(2 * high, MOST)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_with(middle) >= power else (middle, high)
    return high


@dataclass(frozen=True)
class SoundSpread:
    """A random sample of sounds.

    Attributes
    ----------
    count : number of sounds.
    sounds : covariance (levels, levels) of the sounds' own means of the levels, the same for all listeners.
    pairs : that of the answers of one listener to one sound, beyond both.
    """

    count: int
    sounds: Array
    pairs: Array


def rating_power(
    effects: Sequence[float] | Array,
    covariance: Array,
    listeners: int,
    alpha: float,
    seed: int = 1,
    sampled: SoundSpread | None = None,
) -> Array:
    """Share of simulated experiments in which the report finds each level's difference from the first.

    Parameters
    ----------
    effects : (levels,) points.
    covariance : (levels, levels) of the listeners' means of the levels.
    listeners, alpha : of the experiment, and of its tests.
    seed : of the draws.
    sampled : the sounds, where the manifest's `random` names them.

    Returns
    -------
    shares : (levels - 1,).
    """
    k = len(effects)
    names = [str(i) for i in range(k)]
    rows = strata.contrasts([(name,) for name in names], {"factor": names}).differences["factor",]
    random = np.random.default_rng([seed, listeners])
    most = max(1, 4_000_000 // (listeners * k * (1 if sampled is None else sampled.count)))
    count, found = max(200, min(EXPERIMENTS, most)), np.zeros(k - 1)
    for begin in range(0, count, most):
        n = min(most, count - begin)
        if sampled is None:
            y = np.asarray(effects) + _draws(random, covariance, n, listeners)
        else:
            y = np.asarray(effects) + _draws(random, covariance, n, listeners, 1)
            y = y + _draws(random, sampled.sounds, n, 1, sampled.count)
            y = y + _draws(random, sampled.pairs, n, listeners, sampled.count)
        p = strata.estimated(y, rows, 1 - alpha, sounds=sampled is not None).p_value
        found += (strata.holm(p) < alpha).sum(axis=0)
    return found / count


def screened_found(y: Array, kept: NDArray[np.bool_], alpha: float, *, sounds: bool = False) -> NDArray[np.bool_]:
    """Whether the report finds each level's difference from the first, with all listeners and with those kept.

    Parameters
    ----------
    y : (experiments, listeners, levels) listeners' means, or (experiments, listeners, sounds, levels).
    kept : (experiments, listeners) whether the screening keeps them; fewer than three are not analysed.
    alpha : of the tests.
    sounds : whether `y` has the axis of sounds, a random sample.

    Returns
    -------
    found : (experiments, levels - 1).
    """
    names = [str(i) for i in range(y.shape[-1])]
    rows = strata.contrasts([(name,) for name in names], {"factor": names}).differences["factor",]
    found = np.zeros((len(y), len(rows)), dtype=bool)
    counts = kept.sum(axis=1)
    whole = _differs(y, rows, alpha, sounds)
    for count in np.unique(counts[counts > 2]):
        own = counts == count
        rest = y[own][kept[own]].reshape(np.sum(own), count, *y.shape[2:])
        found[own] = whole[own] & (_differs(rest, rows, alpha, sounds) if count < y.shape[1] else True)
    return found


def _differs(y: Array, rows: Array, alpha: float, sounds: bool) -> NDArray[np.bool_]:
    return np.asarray(strata.holm(strata.estimated(y, rows, 1 - alpha, sounds=sounds).p_value) < alpha)


def screened_power(
    pilot: Array,
    kept: NDArray[np.bool_],
    effects: Array,
    listeners: int,
    alpha: float,
    seed: int = 1,
    sampled: SoundSpread | None = None,
) -> Array:
    """Share of experiments with listeners of a pilot in which the report finds each level's difference from the first.

    Parameters
    ----------
    pilot : (pilot listeners, levels) their means.
    kept : (pilot listeners,) whether the screening kept them.
    effects : (levels,) points, which the pilot's mean effects are moved to.
    listeners, alpha, seed : as for `rating_power`.
    sampled : random sounds; listeners then differ by as much less as single answers of the pilot account for.

    Returns
    -------
    shares : (levels - 1,) found with all listeners and with those who are kept.
    """
    random, n = np.random.default_rng([seed, listeners]), len(pilot)
    own = (pilot - pilot.mean(axis=0)) * math.sqrt(n / (n - 1))
    if sampled is None:
        drawn = random.integers(n, size=(EXPERIMENTS, listeners))
        return np.asarray(screened_found(effects + own[drawn], kept[drawn], alpha).mean(axis=0))
    apart = np.var(own[:, 1:] - own[:, :1], axis=0).sum()
    single = (np.diag(sampled.pairs)[1:] + sampled.pairs[0, 0] - 2 * sampled.pairs[0, 1:]).sum() / sampled.count
    own = own * math.sqrt(max(1 - single / apart, 0.0)) if apart > 0 else own
    found = []
    for size in _batches(listeners * sampled.count * len(effects)):
        drawn = random.integers(n, size=(size, listeners))
        y = effects + own[drawn][:, :, None] + _draws(random, sampled.sounds, size, 1, sampled.count)
        y = y + _draws(random, sampled.pairs, size, listeners, sampled.count)
        found.append(screened_found(y, kept[drawn], alpha, sounds=True))
    return np.asarray(np.concatenate(found).mean(axis=0))


def _batches(size: int) -> list[int]:
    """Numbers of experiments to be simulated at once, of `size` answers each."""
    most = max(1, 2_000_000 // size)
    count = max(200, min(EXPERIMENTS, 4 * most))
    return [min(most, count - begin) for begin in range(0, count, most)]


@dataclass(frozen=True)
class MushraListeners:
    """What listeners of a MUSHRA page hear, as simulated panels do.

    Attributes
    ----------
    effects : (levels,) points by which sounds of a level are heard above the reference, which has the first level.
    sounds, trials, cells : random sounds (1: none), trials of each, and sounds of one level in a trial.
    own_sd, slope_sd, residual_sd, sound_sd : points, of listeners' use of the scale, of their responses to each level,
        of single answers, and of random sounds' differences from the first level.
    """

    effects: Array
    sounds: int
    trials: int
    cells: int
    own_sd: float
    slope_sd: float
    residual_sd: float
    sound_sd: float = 0.0

    @classmethod
    def stated(
        cls, effects: Array, sd: float, sounds: int = 1, trials: int = 1, cells: int = 1, sound_sd: float = 0.0
    ) -> MushraListeners:
        """Listeners whose differences have a standard deviation `sd`.

        Their use of the scale and single answers have the spread of simulated panels, but either at most a quarter of
        the variance; the rest is that of listeners' responses to the levels.
        """
        answers = sounds * trials * cells
        own = min(SimulatedPanel.model_fields["listener_sd"].default, sd / 2)
        single = min(SimulatedPanel.model_fields["residual_sd"].default, sd / 2 * math.sqrt(answers))
        slope = math.sqrt((sd**2 - own**2 - single**2 / answers) / 2)
        return cls(np.asarray(effects, dtype=np.float64), sounds, trials, cells, own, slope, single, sound_sd)

    def drawn(self, random: np.random.Generator, experiments: int, listeners: int) -> tuple[Array, NDArray[np.bool_]]:
        """Draw listeners' means (experiments, listeners, sounds, levels), and whether the screening keeps them.

        The reference is among the first level's sounds. The sound that is heard as best gets 100, the others 100 plus
        what is heard and the listener's own deviation, within the scale. Anchors are not drawn: no listener with such
        spreads takes them for the reference, or rates that of 7 kHz above 90 in many trials.
        """
        k, shape = len(self.effects), (experiments, listeners)
        slopes = random.normal(0, self.slope_sd, (*shape, 1, k)) if self.slope_sd > 0 else np.zeros((*shape, 1, k))
        heard = self.effects + slopes - slopes[..., :1]
        if self.sounds > 1:
            by_sound = random.normal(0, self.sound_sd / math.sqrt(2), (experiments, 1, self.sounds, k))
            heard = heard + by_sound - by_sound[..., :1]
        heard = heard[..., None, None, :] + random.normal(
            0, self.residual_sd, (*shape, self.sounds, self.trials, self.cells, k)
        )
        own = random.normal(0, self.own_sd, (*shape, 1, 1, 1, 1))
        best = heard == heard.max(axis=(-2, -1), keepdims=True)
        rated = np.where(best, 100.0, np.clip(100 + own + heard, 0, 100))
        missed = (rated[..., 0, 0] < LIMIT_SCORE).mean(axis=(-2, -1))
        return rated.mean(axis=(-3, -2)), missed <= LIMIT_SHARE


def mushra_power(people: MushraListeners, listeners: int, alpha: float, seed: int = 1) -> Array:
    """Share of experiments in which the report of a MUSHRA page, with its screening, finds each level's difference.

    Parameters
    ----------
    people : what the listeners hear.
    listeners, alpha, seed : as for `rating_power`.

    Returns
    -------
    shares : (levels - 1,) found with all listeners and with those who are kept.
    """
    random, found = np.random.default_rng([seed, listeners]), []
    for size in _batches(listeners * people.sounds * people.trials * people.cells * len(people.effects)):
        y, kept = people.drawn(random, size, listeners)
        sampled = people.sounds > 1
        found.append(screened_found(y if sampled else y[:, :, 0], kept, alpha, sounds=sampled))
    return np.asarray(np.concatenate(found).mean(axis=0))


def ordinal_power(
    effects: Sequence[float] | Array,
    sd: float,
    cells: int,
    ends: tuple[float, float],
    listeners: int,
    alpha: float,
    seed: int = 1,
) -> Array:
    """Share of simulated experiments in which the report finds each level rated above or below the first.

    Parameters
    ----------
    effects : (levels,) points, from the middle of the scale.
    sd : standard deviation of listeners' differences; half of the variance is that of single answers.
    cells : answers of a listener to each level.
    ends : of the scale.
    listeners, alpha, seed : as for `rating_power`.

    Returns
    -------
    shares : (levels - 1,).
    """
    k, random = len(effects), np.random.default_rng([seed, listeners])
    most = max(1, 2_000_000 // (listeners * k * cells))
    count, found = max(200, min(EXPERIMENTS, 4 * most)), np.zeros(k - 1)
    for begin in range(0, count, most):
        n = min(most, count - begin)
        y = sum(ends) / 2 + np.asarray(effects) + random.normal(0, sd / 2, (n, listeners, 1, k))
        y = np.clip(y + random.normal(0, sd / 2 * math.sqrt(cells), (n, listeners, cells, k)), *ends)
        pairs = [np.sign(y[..., j] - y[..., i]).mean(axis=-1) for i, j in itertools.combinations(range(k), 2)]
        p = share_test(0.5 + 0.5 * np.stack(pairs, axis=1))
        found += (strata.holm(p) < alpha)[:, : k - 1].sum(axis=0)
    return found / count


def stated_spread(sd: float, sound_sd: float, sounds: int, levels: int) -> tuple[Array, SoundSpread]:
    """Covariances of differences with standard deviations `sd` (listeners) and `sound_sd` (random sounds).

    Half of the variance of a listener's difference is that of single answers, of one to each sound.
    """
    one = np.eye(levels)
    return sd**2 / 4 * one, SoundSpread(sounds, sound_sd**2 / 2 * one, sounds * sd**2 / 4 * one)


def _draws(random: np.random.Generator, covariance: Array, *shape: int) -> Array:
    """Normal numbers (*shape, levels) of a covariance matrix, whose negative eigenvalues are taken as 0."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(random.standard_normal((*shape, len(covariance))) @ root.T)


def choice_power(share: float, each: int, listeners: int, alpha: float, seed: int = 1) -> float:
    """Share of simulated experiments in which the Bradley-Terry interval of a pair excludes 0.

    Parameters
    ----------
    share : of choices of one of the two.
    each : choices of a listener.
    listeners, alpha, seed : as for `rating_power`.
    """
    from scipy.special import stdtrit

    chosen = np.random.default_rng([seed, listeners]).binomial(each, share, (EXPERIMENTS, listeners))
    answers = each * listeners + 1  # a tie is added
    mean = (chosen.sum(axis=1) + 0.5) / answers
    squares = np.sum((chosen - each * mean[:, None]) ** 2, axis=1) + (0.5 - mean) ** 2
    error = np.sqrt(listeners / (listeners - 1) * squares) / answers
    value = np.log(mean / (1 - mean)) * mean * (1 - mean)
    return float(np.mean(np.abs(value) > stdtrit(listeners - 1, 1 - alpha / 2) * error))


def threshold_listeners(
    page: StaircasePage, people: simulations.Population, margin: float, alpha: float, power: float, seed: int = 1
) -> int:
    """Listeners with whom the interval of the mean threshold excludes one that is a margin (of u) away.

    Raises
    ------
    TooManyListenersError : more than `MOST` are needed.
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
    raise TooManyListenersError(f"more than {MOST} listeners would be needed for a margin of {margin:g}")


def answers_for_share(share: float, chance: float, alpha: float, power: float) -> int:
    """Fewest answers from which on a one-sided binomial test against guessing has the power.

    The power of an exact test goes up and down with the number of answers; from this number on it stays above.

    Raises
    ------
    TooManyListenersError : more than `MOST` are needed.
    ListeningError : the share is not above guessing.
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
        raise TooManyListenersError(f"more than {MOST} answers would be needed for a share of {share:g}")
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
    rows = []
    for index, page in enumerate(manifest.pages):
        name = localised(getattr(page, "name", ""), manifest.language) or page.type
        number = index + 1
        own = next((p for p in pilot.pages if p.page == number), None) if pilot is not None else None
        try:
            row = _row(manifest, page, number, name, own, max(trials.get(index, 1), 1))
        except TooManyListenersError as fault:
            row = PowerRow(number, name, str(fault), None, getattr(page, "expect", None) is not None or own is not None)
        rows += [] if row is None else [row]
    return rows


def _row(
    manifest: Manifest, page: AnyPage, number: int, name: str, own: PageResults | None, each: int
) -> PowerRow | None:
    """Listeners that a page needs; None where nothing is tested."""
    alpha, power = manifest.power.alpha, manifest.power.power
    if isinstance(page, RatingPage) and page.scales[0].ordinal:
        return _graded(manifest, page, number, name, own)
    if isinstance(page, (MushraPage, Bs1116Page, RatingPage)):
        return _rated(manifest, page, number, name, own)
    if isinstance(page, StaircasePage):
        stated = page.expect_sd is not None or own is not None
        return _staircase(page, number, name, own, alpha, power) if stated else None
    if not isinstance(page, PairPage):
        return None
    task = task_of(page)
    seen = _share_of(own)
    share = page.expect or (seen if seen is not None else _SHARE)
    text = f"{100 * share:.0f} % {'chosen' if task is None else 'right'}"
    if task is None:
        n = fewest(lambda k: choice_power(share, each, k, alpha), power, text)
        text += f": {n * each} answers, {each} a listener"
    else:
        (factor, named), *_ = page.pairs.items()
        tests = len(as_pairs(named, manifest.choices()[factor]))
        answers = answers_for_share(share, CHANCE[task], alpha / tests, power)  # Holm's first step
        n = math.ceil(answers / each)
        d = "" if task == "same" else f", d' = {sensitivity(share, task):.2f}"
        text += f"{d}: {answers} answers, {each} a listener, over all cells"
        text += f", of one of {tests} pairs" if tests > 1 else ""
    return PowerRow(number, name, text, n, page.expect is not None or seen is not None)


def _rated(
    manifest: Manifest, page: MushraPage | Bs1116Page | RatingPage, number: int, name: str, own: PageResults | None
) -> PowerRow:
    alpha, power = manifest.power.alpha, manifest.power.power
    width = 100.0 if not isinstance(page, RatingPage) else page.scales[0].high - page.scales[0].low
    effect = page.expect or _EFFECT.get(page.type, 0.1 * width)
    sd = page.expect_sd or _SD.get(page.type, 0.15 * width)
    reference, sounds = getattr(page, "reference", None) or {}, _sounds(manifest)
    k = _levels(manifest, page)
    effects, covariance = np.zeros(k), sd**2 / 2 * np.eye(k)
    text, sampled = f"{effect:g} points, sd {sd:g}", None
    if sounds > 1:
        sound_sd = page.expect_sound_sd or sd
        covariance, sampled = stated_spread(sd, sound_sd, sounds, k)
        text += f", {sounds} random sounds with sd {sound_sd:g}"
    found = None if own is None else _pilot_means(own.everybody or own, reference, manifest.random)
    out = set() if own is None else {one.listener for one in own.screened}
    pilot, who = (None, []) if found is None else found
    kept = np.array([name not in out for name in who])
    people = None
    if isinstance(page, MushraPage) and pilot is None:
        effects[1] = -effect  # below the reference
        people = MushraListeners.stated(
            effects, sd, sounds, *_trials(manifest, page, k, sounds), 0.0 if sampled is None else sound_sd
        )
        y, stays = people.drawn(np.random.default_rng(1), 1, 2000)
        mean = float((y[..., 1] - y[..., 0]).mean())
        text += f", as heard (rated {mean:.3g}; {100 * np.mean(~stays):.0f} % of listeners left out by the screening)"
    if pilot is not None:
        covariance, sampled = _pilot_spread(pilot, sounds)
        k = pilot.shape[2]
        effects = np.zeros(k)
        if page.expect is None:
            means = pilot.mean(axis=(0, 1))
            effects = means - means[0]
            effect = float(effects[np.argmax(np.abs(effects))])
        text = f"{effect:.3g} points, spread of {len(pilot)} listeners of a pilot"
        text += f" and {sounds} random sounds" if sampled is not None else ""
        if not kept.all():
            text += f", {np.sum(~kept)} of whom the screening left out"
    at = int(np.argmax(np.abs(effects[1:]))) if np.any(effects) else 0
    if not np.any(effects):
        effects[1] = effect
    text += f", {k} levels" if k > 2 else ""
    if sampled is not None:  # the sounds alone, heard without error
        alone = replace(sampled, pairs=np.zeros((k, k)))
        if rating_power(effects, np.zeros((k, k)), 50, alpha, sampled=alone)[at] < power:
            raise TooManyListenersError(f"no number of listeners is enough for {text}; more sounds are needed")

    def reached(m: int) -> float:
        if people is not None:
            return float(mushra_power(people, m, alpha)[at])
        if pilot is not None and not kept.all():
            return float(screened_power(pilot.mean(axis=1), kept, effects, m, alpha, sampled=sampled)[at])
        return float(rating_power(effects, covariance, m, alpha, sampled=sampled)[at])

    n = fewest(reached, power, text)
    return PowerRow(number, name, text, n, page.expect is not None or pilot is not None)


def _trials(manifest: Manifest, page: MushraPage, levels: int, sounds: int) -> tuple[int, int]:
    """Trials of a listener with each random sound, and sounds of one level in a trial."""
    choices = manifest.choices()
    rows = manifest.conditions
    grouped = [f for f in page.group_by if f in choices]
    trials = math.prod(len(choices[f]) for f in grouped)
    conditions = math.prod(len(x) for x in choices.values())
    if rows is not None:
        trials, conditions = len({tuple(row.get(f) for f in grouped) for row in rows}), len(rows)
    cells = max(1, round(conditions / (trials * levels)))
    trials = min(trials * manifest.repeats, page.subset or trials * manifest.repeats)
    if any(f not in page.group_by for f in manifest.random):  # sounds within a trial
        cells = max(1, cells // sounds)
    return max(1, round(trials / sounds)), cells


def _levels(manifest: Manifest, page: MushraPage | Bs1116Page | RatingPage) -> int:
    """Number of levels of the first factor that a page varies, that of its reference."""
    choices, reference = manifest.choices(), getattr(page, "reference", None) or {}
    varied = [f for f, levels in choices.items() if f not in (*page.group_by, *manifest.random) and len(levels) > 1]
    return len(choices[min(varied, key=lambda f: f not in reference)]) if varied else 2


def _graded(manifest: Manifest, page: RatingPage, number: int, name: str, own: PageResults | None) -> PowerRow:
    """Listeners that the first scale of a page needs, which is ordinal."""
    alpha, power, scale = manifest.power.alpha, manifest.power.power, page.scales[0]
    width, k = scale.high - scale.low, _levels(manifest, page)
    effect, sd = page.expect or 0.1 * width, page.expect_sd or 0.15 * width
    effects, sounds = np.zeros(k), math.prod(len(x) for x in manifest.choices().values())
    spread = f"sd {sd:g}"
    found = None if own is None else _pilot_means(own, {}, ())
    pilot = None if found is None else found[0]
    if pilot is not None:
        k = pilot.shape[2]
        means = pilot.mean(axis=(0, 1))
        effects = means - means[0] if page.expect is None else np.zeros(k)
        apart = pilot.mean(axis=1)[:, 1:] - pilot.mean(axis=1)[:, :1]
        sd = float(np.sqrt(np.mean(np.var(apart, axis=0, ddof=1))))
        effect = page.expect or float(effects[np.argmax(np.abs(effects))])
        spread = f"spread of {len(pilot)} listeners of a pilot"
    at = int(np.argmax(np.abs(effects[1:])))
    if not np.any(effects):
        effects[1] = effect
    sounds = len(manifest.conditions) if manifest.conditions is not None else sounds
    cells, ends = max(1, sounds // k), (scale.low, scale.high)
    text = f"{effect:.3g} of {width:g} points, {spread}, by shares of comparisons in {counted(cells, 'sound')}"
    n = fewest(lambda m: float(ordinal_power(effects, sd, cells, ends, m, alpha)[at]), power, text)
    return PowerRow(number, name, text, n, page.expect is not None or pilot is not None)


def _sounds(manifest: Manifest) -> int:
    """Number of random sounds: combinations of the levels of the factors that are a sample."""
    if manifest.conditions is not None:
        return len({tuple(row.get(f) for f in manifest.random) for row in manifest.conditions})
    choices = manifest.choices()
    return math.prod(len(choices[f]) for f in manifest.random)


def _pilot_means(
    own: PageResults, reference: Mapping[str, str], random: Sequence[str]
) -> tuple[Array, list[str]] | None:
    """Means (listeners, random sounds, levels) of the levels of a page's first factor, of listeners who have all.

    The names of these listeners are returned, too.

    None with fewer than three such listeners or two levels.
    """
    factor = next((f for f in own.factors if f not in random), None)
    if factor is None:
        return None
    sampled = [f for f in random if f in own.factors]
    rows = [row for row in own.rows if row["role"] in ("sound", "reference") and row["value"] is not None]
    first = reference.get(factor)
    levels = sorted(unique([str(row[factor]) for row in rows]), key=lambda level: level != first)
    sounds = unique([tuple(str(row[f]) for f in sampled) for row in rows])
    values: dict[Any, dict[tuple[int, int], list[float]]] = {}
    for row in rows:
        cell = sounds.index(tuple(str(row[f]) for f in sampled)), levels.index(str(row[factor]))
        values.setdefault(row["listener"], {}).setdefault(cell, []).append(float(row["value"]))
    cells = [(i, j) for i in range(len(sounds)) for j in range(len(levels))]
    whole = {name: of for name, of in values.items() if len(of) == len(cells)}
    means = [[np.mean(of[cell]) for cell in cells] for of in whole.values()]
    if len(means) < 3 or len(levels) < 2:
        return None
    return np.array(means).reshape(len(means), len(sounds), len(levels)), list(whole)


def _pilot_spread(pilot: Array, count: int) -> tuple[Array, SoundSpread | None]:
    """Covariances of listeners, and of `count` random sounds, from means (listeners, sounds, levels)."""
    n, m, _ = pilot.shape
    listeners = np.cov(pilot.mean(axis=1), rowvar=False)
    if m < 2 or count < 2:
        return listeners, None
    rest = pilot - pilot.mean(axis=1, keepdims=True) - pilot.mean(axis=0, keepdims=True) + pilot.mean(axis=(0, 1))
    pairs = np.einsum("nmi,nmj->ij", rest, rest) / ((n - 1) * (m - 1))
    sounds = np.cov(pilot.mean(axis=0), rowvar=False)
    return listeners - pairs / m, SoundSpread(count, sounds - pairs / n, pairs)


def _share_of(own: PageResults | None) -> float | None:
    """Largest share of right answers of a pilot's page."""
    shares = [d.share for d in own.pairs if d.share is not None] if own is not None else []
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
