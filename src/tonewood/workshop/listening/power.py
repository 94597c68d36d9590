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
cells, one-sided, whose power is a sum and needs no simulation; listeners are assumed alike. *Staircases*: listeners
are simulated trial by trial; power is the share of experiments in which the interval of the mean threshold excludes a
threshold that is `margin` away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.support.units import counted
from tonewood.workshop.batch import pages
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.listening import simulations
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import CHANCE, sensitivity, task_of
from tonewood.workshop.listening.means import unique
from tonewood.workshop.listening.results import PageResults, PanelResults
from tonewood.workshop.listening.simulated_power import (
    MushraListeners,
    SoundSpread,
    TooManyListenersError,
    answers_for_share,
    choice_power,
    fewest,
    mushra_power,
    ordinal_power,
    rating_power,
    screened_power,
    stated_spread,
    threshold_listeners,
)

#: standard deviations of listeners' differences where a page states none: points of 100, of grades 1 to 5, of a scale
_SD = {"mushra": 15.0, "bs1116": 0.8}
#: effects where a page states none
_EFFECT = {"mushra": 10.0, "bs1116": 0.5}
_SHARE = 0.70
#: slope over the range of levels, where a page states none
_STEEPNESS = 10.0


#: the effect in words, listeners, and whether the page states the effect
Need = tuple[str, int | None, bool]


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
        listeners = "" if self.listeners is None else f"{self.listeners} listeners for "
        default = "" if self.stated else " (not stated by the page)"
        return f"page {self.page}, {self.name}: {listeners}{self.effect}{default}"


def power_of(manifest: Manifest, trials: dict[int, int], pilot: PanelResults | None = None) -> list[PowerRow]:
    """Listeners that each page needs.

    trials : page (from 0) -> trials that a listener gets of one pair on it.
    pilot : results of listeners who took the same pages; their spread, and their effects where a page expects none,
        take the place of the stated ones.
    Raises ListeningError : the pilot's pages are others.
    """
    rows = []
    for index, page in enumerate(manifest.pages):
        name = pages.localised(getattr(page, "name", ""), manifest.language) or page.type
        pilot_page = next((p for p in pilot.pages if p.page == index + 1), None) if pilot is not None else None
        if pilot_page is not None:
            _check_same(manifest, page, pilot_page)
        need: Need | None
        try:
            need = _need(manifest, page, pilot_page, max(trials.get(index, 1), 1))
        except TooManyListenersError as fault:
            need = str(fault), None, getattr(page, "expect", None) is not None or pilot_page is not None
        if need is not None:
            rows.append(PowerRow(index + 1, name, *need))
    return rows


def _check_same(manifest: Manifest, page: pages.AnyPage, pilot: PageResults) -> None:
    """Check that a pilot's page asked the same. Raises ListeningError : it is of another type, or of other factors."""
    other = next((f for f in pilot.factors if f not in (*manifest.choices(), "type")), None)
    if pilot.kind != page.type or other is not None:
        here = page.type if other is None else f"{page.type} without a factor {other}"
        reason = f"page {pilot.page} is {here} in the manifest, and {pilot.kind} in the pilot"
        raise ListeningError(f"{reason}; answers to the same pages are wanted", key="--pilot")


def _need(manifest: Manifest, page: pages.AnyPage, results: PageResults | None, each: int) -> Need | None:
    """Listeners that a page needs; None where nothing is tested."""
    alpha, power = manifest.power.alpha, manifest.power.power
    if isinstance(page, pages.RatingPage) and page.scales[0].ordinal:
        return _graded(manifest, page, results)
    if isinstance(page, (pages.MushraPage, pages.Bs1116Page, pages.RatingPage)):
        return _rated(manifest, page, results)
    if isinstance(page, pages.StaircasePage):
        stated = page.expect_sd is not None or results is not None
        return _staircase(page, results, alpha, power) if stated else None
    if not isinstance(page, pages.PairPage):
        return None
    task = task_of(page)
    seen = _share_of(results)
    share = page.expect or (seen if seen is not None else _SHARE)
    text = f"{100 * share:.0f} % {'chosen' if task is None else 'right'}"
    if task is None:
        n = fewest(lambda k: choice_power(share, each, k, alpha), power, text)
        text += f": {n * each} answers, {each} a listener"
    else:
        (factor, named), *_ = page.pairs.items()
        tests = len(pages.as_pairs(named, manifest.choices()[factor]))
        answers = answers_for_share(share, CHANCE[task], alpha / tests, power)  # Holm's first step
        n = math.ceil(answers / each)
        d = "" if task == "same" else f", d' = {sensitivity(share, task):.2f}"
        text += f"{d}: {answers} answers, {each} a listener, over all cells"
        text += f", of one of {tests} pairs" if tests > 1 else ""
    return text, n, page.expect is not None or seen is not None


def _rated(
    manifest: Manifest, page: pages.MushraPage | pages.Bs1116Page | pages.RatingPage, results: PageResults | None
) -> Need:
    alpha, power = manifest.power.alpha, manifest.power.power
    width = 100.0 if not isinstance(page, pages.RatingPage) else page.scales[0].high - page.scales[0].low
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
    pilot, who = _pilot_means(None if results is None else results.everybody or results, reference, manifest.random)
    out = set() if results is None else {one.listener for one in results.screened}
    kept = np.array([name not in out for name in who])
    people = None
    if isinstance(page, pages.MushraPage) and pilot is None:
        effects[1] = -effect  # below the reference
        people = MushraListeners.stated(
            effects, sd, sounds, *_trials(manifest, page, k, sounds), 0.0 if sampled is None else sound_sd
        )
        y, stays = people.drawn(np.random.default_rng(1), 1, 4000)
        mean = float((y[..., 1] - y[..., 0]).mean())
        if sounds == 1 and abs(mean + effect) > 0.1 * effect:
            text += f" (with such a spread the mean of ratings is {-mean:.3g})"
        text += f", {100 * np.mean(~stays):.0f} % of listeners left out by the screening"
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

    return text, fewest(reached, power, text), page.expect is not None or pilot is not None


def _trials(manifest: Manifest, page: pages.MushraPage, levels: int, sounds: int) -> tuple[int, int]:
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


def _levels(manifest: Manifest, page: pages.MushraPage | pages.Bs1116Page | pages.RatingPage) -> int:
    """Number of levels of the first factor that a page varies, that of its reference."""
    choices, reference = manifest.choices(), getattr(page, "reference", None) or {}
    varied = [f for f, levels in choices.items() if f not in (*page.group_by, *manifest.random) and len(levels) > 1]
    return len(choices[min(varied, key=lambda f: f not in reference)]) if varied else 2


def _graded(manifest: Manifest, page: pages.RatingPage, results: PageResults | None) -> Need:
    """Listeners that the first scale of a page needs, which is ordinal."""
    alpha, power, scale = manifest.power.alpha, manifest.power.power, page.scales[0]
    width, k = scale.high - scale.low, _levels(manifest, page)
    effect, sd = page.expect or 0.1 * width, page.expect_sd or 0.15 * width
    effects, sounds = np.zeros(k), math.prod(len(x) for x in manifest.choices().values())
    spread = f"sd {sd:g}"
    pilot, _ = _pilot_means(results, {}, ())
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
    return text, n, page.expect is not None or pilot is not None


def _sounds(manifest: Manifest) -> int:
    """Number of random sounds: combinations of the levels of the factors that are a sample."""
    if manifest.conditions is not None:
        return len({tuple(row.get(f) for f in manifest.random) for row in manifest.conditions})
    choices = manifest.choices()
    return math.prod(len(choices[f]) for f in manifest.random)


def _pilot_means(
    results: PageResults | None, reference: Mapping[str, str], random: Sequence[str]
) -> tuple[Floats | None, list[str]]:
    """Means (listeners, random sounds, levels) of the levels of a page's first factor, and the listeners who have all.

    None with fewer than three such listeners or two levels, or without a pilot.
    """
    factor = None if results is None else next((f for f in results.factors if f not in random), None)
    if results is None or factor is None:
        return None, []
    sampled = [f for f in random if f in results.factors]
    rows = [row for row in results.rows if row["role"] in ("sound", "reference") and row["value"] is not None]
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
        return None, []
    return np.array(means).reshape(len(means), len(sounds), len(levels)), list(whole)


def _pilot_spread(pilot: Floats, count: int) -> tuple[Floats, SoundSpread | None]:
    """Covariances of listeners, and of `count` random sounds, from means (listeners, sounds, levels)."""
    n, m, _ = pilot.shape
    listeners = np.cov(pilot.mean(axis=1), rowvar=False)
    if m < 2 or count < 2:
        return listeners, None
    rest = pilot - pilot.mean(axis=1, keepdims=True) - pilot.mean(axis=0, keepdims=True) + pilot.mean(axis=(0, 1))
    pairs = np.einsum("nmi,nmj->ij", rest, rest) / ((n - 1) * (m - 1))
    sounds = np.cov(pilot.mean(axis=0), rowvar=False)
    return listeners - pairs / m, SoundSpread(count, sounds - pairs / n, pairs)


def _share_of(results: PageResults | None) -> float | None:
    """Largest share of right answers of a pilot's page."""
    shares = [d.share for d in results.pairs if d.share is not None] if results is not None else []
    return max(shares) if shares else None


def _staircase(page: pages.StaircasePage, results: PageResults | None, alpha: float, power: float) -> Need:
    span = page.transformed(page.highest) - page.transformed(page.lowest)
    slope = page.expect_slope or _STEEPNESS / span
    sd = page.transformed(page.expect_sd) if page.expect_sd is not None else 0.1 * span
    middle = page.level_of(page.transformed(page.lowest) + 0.5 * span)
    mean = page.expect or middle
    seen = None if results is None else results.thresholds
    if seen is not None and len(seen.listeners) > 2:  # of fewer the spread is not known
        mean, slope, sd = seen.mean, seen.slope, page.transformed(seen.spread)
    last = page.steps[-1] if page.steps else (1.25 if page.ratio else 0.05 * span)
    margin = page.margin or last
    people = simulations.Population(mean, sd, slope)
    n = threshold_listeners(page, people, page.transformed(margin), alpha, power)
    by = f"by {100 * (margin - 1):.0f} %" if page.ratio else f"by {margin:g}"
    text = f"a mean threshold other {by} than {mean:.3g}, spread between listeners {page.level_of(sd):.3g}"
    return text, n, page.expect is not None or (seen is not None and len(seen.listeners) > 2)
