"""Power of single analyses by simulated experiments: ratings, grades, choices, right answers, staircases."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import simulations, strata
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.means import LIMIT_SCORE, LIMIT_SHARE
from tonewood.workshop.listening.models import share_test
from tonewood.workshop.listening.panel import SimulatedPanel
from tonewood.workshop.listening.thresholds import ThresholdGrid

#: listeners, or answers, that are tried at most
MOST = 10_000
#: steps of the search for what listeners hear, and listeners drawn in each
_SEARCH, _SEARCHED = 12, 4000
#: simulated experiments: of ratings and choices, and of staircases
EXPERIMENTS, STAIRCASES = 4000, 100


class TooManyListenersError(ListeningError):
    """No number of listeners up to `MOST` is enough."""


def fewest(power_with: Callable[[int], float], power: float, effect: str) -> int:
    """Fewest listeners, from 3 on, with whom a simulated power is reached.

    Raises TooManyListenersError : more than `MOST` are needed.
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

    sounds : covariance (levels, levels) of the sounds' own means of the levels, the same for all listeners.
    pairs : that of the answers of one listener to one sound, beyond both.
    """

    count: int
    sounds: Floats
    pairs: Floats


def rating_power(
    effects: Sequence[float] | Floats,
    covariance: Floats,
    listeners: int,
    alpha: float,
    seed: int = 1,
    sampled: SoundSpread | None = None,
) -> Floats:
    """Share of simulated experiments in which the report finds each level's difference from the first.

    effects : (levels,) points.
    covariance : (levels, levels) of the listeners' means of the levels.
    sampled : the sounds, where the manifest's `random` names them.
    Returns shares : (levels - 1,).
    """
    k = len(effects)
    rows = _differences(k)
    random = np.random.default_rng([seed, listeners])
    batches = _batches(listeners * k * (1 if sampled is None else sampled.count), 4_000_000, 1)
    detected = np.zeros(k - 1)
    for n in batches:
        if sampled is None:
            y = np.asarray(effects) + _draws(random, covariance, n, listeners)
        else:
            y = np.asarray(effects) + _draws(random, covariance, n, listeners, 1)
            y = y + _draws(random, sampled.sounds, n, 1, sampled.count)
            y = y + _draws(random, sampled.pairs, n, listeners, sampled.count)
        p = strata.estimated(y, rows, 1 - alpha, sounds=sampled is not None).p_value
        detected += (strata.holm(p) < alpha).sum(axis=0)
    return detected / sum(batches)


def screened_found(y: Floats, kept: NDArray[np.bool_], alpha: float, *, sounds: bool = False) -> NDArray[np.bool_]:
    """Whether the report finds each level's difference from the first, with all listeners and with those kept.

    y : (experiments, listeners, levels) listeners' means, or (experiments, listeners, sounds, levels).
    kept : (experiments, listeners) whether the screening keeps them; fewer than three are not analysed.
    Returns detected : (experiments, levels - 1).
    """
    rows = _differences(y.shape[-1])
    detected = np.zeros((len(y), len(rows)), dtype=bool)
    counts = kept.sum(axis=1)
    whole = _differs(y, rows, alpha, sounds)
    for count in np.unique(counts[counts > 2]):
        same = counts == count
        rest = y[same][kept[same]].reshape(np.sum(same), count, *y.shape[2:])
        detected[same] = whole[same] & (_differs(rest, rows, alpha, sounds) if count < y.shape[1] else True)
    return detected


def _differences(levels: int) -> Floats:
    """Rows of contrasts (levels - 1, levels): each level less the first."""
    names = [str(i) for i in range(levels)]
    return strata.contrasts([(name,) for name in names], {"factor": names}).differences["factor",]


def _differs(y: Floats, rows: Floats, alpha: float, sounds: bool) -> NDArray[np.bool_]:
    return np.asarray(strata.holm(strata.estimated(y, rows, 1 - alpha, sounds=sounds).p_value) < alpha)


def screened_power(
    pilot: Floats,
    kept: NDArray[np.bool_],
    effects: Floats,
    listeners: int,
    alpha: float,
    seed: int = 1,
    sampled: SoundSpread | None = None,
) -> Floats:
    """Share of experiments with listeners of a pilot in which the report finds each level's difference from the first.

    pilot : (pilot listeners, levels) their means.
    kept : (pilot listeners,) whether the screening kept them.
    effects : (levels,) points, which the pilot's mean effects are moved to.
    sampled : random sounds; listeners then differ by as much less as single answers of the pilot account for.
    Returns shares : (levels - 1,) found with all listeners and with those who are kept.
    """
    random, n = np.random.default_rng([seed, listeners]), len(pilot)
    residuals = (pilot - pilot.mean(axis=0)) * math.sqrt(n / (n - 1))
    if sampled is None:
        drawn = random.integers(n, size=(EXPERIMENTS, listeners))
        return np.asarray(screened_found(effects + residuals[drawn], kept[drawn], alpha).mean(axis=0))
    apart = np.var(residuals[:, 1:] - residuals[:, :1], axis=0).sum()
    single = (np.diag(sampled.pairs)[1:] + sampled.pairs[0, 0] - 2 * sampled.pairs[0, 1:]).sum() / sampled.count
    residuals = residuals * math.sqrt(max(1 - single / apart, 0.0)) if apart > 0 else residuals
    powers = []
    for size in _batches(listeners * sampled.count * len(effects)):
        drawn = random.integers(n, size=(size, listeners))
        y = effects + residuals[drawn][:, :, None] + _draws(random, sampled.sounds, size, 1, sampled.count)
        y = y + _draws(random, sampled.pairs, size, listeners, sampled.count)
        powers.append(screened_found(y, kept[drawn], alpha, sounds=True))
    return np.asarray(np.concatenate(powers).mean(axis=0))


def _batches(size: int, answers: int = 2_000_000, times: int = 4) -> list[int]:
    """Numbers of experiments to be simulated at once, of `size` answers each: `answers` of them, so many times."""
    most = max(1, answers // size)
    count = max(200, min(EXPERIMENTS, times * most))
    return [min(most, count - begin) for begin in range(0, count, most)]


@dataclass(frozen=True)
class MushraListeners:
    """What listeners of a MUSHRA page hear, as simulated panels do.

    effects : (levels,) points by which sounds of a level are heard above the reference, which has the first level.
    sounds, trials, cells : random sounds (1: none), trials of each, and sounds of one level in a trial.
    own_sd, slope_sd, residual_sd, sound_sd : points, of listeners' use of the scale, of their responses to each level,
        of single answers, and of random sounds' differences from the first level.
    """

    effects: Floats
    sounds: int
    trials: int
    cells: int
    own_sd: float
    slope_sd: float
    residual_sd: float
    sound_sd: float = 0.0

    @classmethod
    def stated(
        cls, effects: Floats, sd: float, sounds: int = 1, trials: int = 1, cells: int = 1, sound_sd: float = 0.0
    ) -> MushraListeners:
        """Listeners whose rated differences have these means and, at the largest, the standard deviation `sd`.

        Their use of the scale and single answers have the spread of simulated panels, but either at most a quarter of
        the variance; the rest is that of listeners' responses to the levels. The end of the scale and the 100 points of
        the best sound change means and spreads, so that what is heard is searched for by simulation, from the stated
        figures; where no spread reaches them, the nearest that the search has come to.
        """
        answers = sounds * trials * cells
        listener_sd = min(SimulatedPanel.model_fields["listener_sd"].default, sd / 2)
        single = min(SimulatedPanel.model_fields["residual_sd"].default, sd / 2 * math.sqrt(answers))
        slope = math.sqrt((sd**2 - listener_sd**2 - single**2 / answers) / 2)
        targets = np.asarray(effects, dtype=np.float64)
        people = cls(targets, sounds, trials, cells, listener_sd, slope, single, sound_sd)
        at = int(np.argmax(np.abs(targets)))
        if targets[at] == 0 or sd <= 0:
            return people
        for _ in range(_SEARCH):
            y, _ = replace(people, sound_sd=0.0).drawn(np.random.default_rng(1), 1, _SEARCHED)
            differences = (y - y[..., :1]).mean(axis=(0, 2))
            means, spread = differences.mean(axis=0), float(differences[:, at].std())
            by = np.clip(np.divide(targets, means, out=np.ones_like(targets), where=targets * means > 0), 0.5, 2.0)
            wider = min(max(sd / max(spread, 1e-9), 0.5), 2.0)
            people = replace(
                people, effects=people.effects * by, own_sd=people.own_sd * wider, slope_sd=people.slope_sd * wider,
                residual_sd=people.residual_sd * wider,
            )  # fmt: skip
        return people

    def drawn(self, random: np.random.Generator, experiments: int, listeners: int) -> tuple[Floats, NDArray[np.bool_]]:
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
        by_listener = random.normal(0, self.own_sd, (*shape, 1, 1, 1, 1))
        best = heard == heard.max(axis=(-2, -1), keepdims=True)
        rated = np.where(best, 100.0, np.clip(100 + by_listener + heard, 0, 100))
        missed = (rated[..., 0, 0] < LIMIT_SCORE).mean(axis=(-2, -1))
        return rated.mean(axis=(-3, -2)), missed <= LIMIT_SHARE


def mushra_power(people: MushraListeners, listeners: int, alpha: float, seed: int = 1) -> Floats:
    """Share of experiments in which the report of a MUSHRA page, with its screening, finds each level's difference.

    Returns shares : (levels - 1,) found with all listeners and with those who are kept.
    """
    random, detected = np.random.default_rng([seed, listeners]), []
    for size in _batches(listeners * people.sounds * people.trials * people.cells * len(people.effects)):
        y, kept = people.drawn(random, size, listeners)
        sampled = people.sounds > 1
        detected.append(screened_found(y if sampled else y[:, :, 0], kept, alpha, sounds=sampled))
    return np.asarray(np.concatenate(detected).mean(axis=0))


def ordinal_power(
    effects: Sequence[float] | Floats,
    sd: float,
    cells: int,
    ends: tuple[float, float],
    listeners: int,
    alpha: float,
    seed: int = 1,
) -> Floats:
    """Share of simulated experiments in which the report finds each level rated above or below the first.

    effects : (levels,) points, from the middle of the scale.
    sd : standard deviation of listeners' differences; half of the variance is that of single answers.
    cells : answers of a listener to each level.
    Returns shares : (levels - 1,).
    """
    k, random = len(effects), np.random.default_rng([seed, listeners])
    batches, detected = _batches(listeners * k * cells), np.zeros(k - 1)
    for n in batches:
        y = sum(ends) / 2 + np.asarray(effects) + random.normal(0, sd / 2, (n, listeners, 1, k))
        y = np.clip(y + random.normal(0, sd / 2 * math.sqrt(cells), (n, listeners, cells, k)), *ends)
        pairs = [np.sign(y[..., j] - y[..., i]).mean(axis=-1) for i, j in itertools.combinations(range(k), 2)]
        p = share_test(0.5 + 0.5 * np.stack(pairs, axis=1))
        detected += (strata.holm(p) < alpha)[:, : k - 1].sum(axis=0)
    return detected / sum(batches)


def stated_spread(sd: float, sound_sd: float, sounds: int, levels: int) -> tuple[Floats, SoundSpread]:
    """Covariances of differences with standard deviations `sd` (listeners) and `sound_sd` (random sounds).

    Half of the variance of a listener's difference is that of single answers, of one to each sound.
    """
    one = np.eye(levels)
    return sd**2 / 4 * one, SoundSpread(sounds, sound_sd**2 / 2 * one, sounds * sd**2 / 4 * one)


def _draws(random: np.random.Generator, covariance: Floats, *shape: int) -> Floats:
    """Normal numbers (*shape, levels) of a covariance matrix, whose negative eigenvalues are taken as 0."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(random.standard_normal((*shape, len(covariance))) @ root.T)


def choice_power(share: float, each: int, listeners: int, alpha: float, seed: int = 1) -> float:
    """Share of simulated experiments in which the Bradley-Terry interval of a pair excludes 0.

    share : of choices of one of the two.
    each : choices of a listener.
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

    Raises TooManyListenersError : more than `MOST` are needed.
    """
    random = np.random.default_rng(seed)
    pool, grid, centre = 200, ThresholdGrid(page), page.transformed(people.mean)
    _, _, tables = simulations.likelihoods(grid, people, pool, random)
    spread = float(np.std(grid.fit(tables, 1 - alpha).alone))
    n = max(3, math.ceil((2.8 * spread / margin) ** 2))
    while n <= MOST:
        drawn = random.integers(pool, size=(STAIRCASES, n))
        intervals = [grid.fit(tables[listeners], 1 - alpha).interval for listeners in drawn]
        if np.mean([not low <= centre + margin <= high for low, high in intervals]) >= power:
            return n
        n = max(n + 1, math.ceil(1.15 * n))
    raise TooManyListenersError(f"more than {MOST} listeners would be needed for a margin of {margin:g}")


def answers_for_share(share: float, chance: float, alpha: float, power: float) -> int:
    """Fewest answers from which on a one-sided binomial test against guessing has the power.

    The power of an exact test goes up and down with the number of answers; from this number on it stays above.

    Raises TooManyListenersError : more than `MOST` are needed.
    Raises ListeningError : the share is not above guessing.
    """
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
