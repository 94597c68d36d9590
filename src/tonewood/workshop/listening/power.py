"""How many listeners a stated effect needs.

*Differences of means* (ratings, thresholds): a t test of the listeners' own differences, whose standard deviation is
stated. With n listeners its power is that of the noncentral t distribution, n - 1 degrees of freedom and
noncentrality delta sqrt(n) / s.

*Shares of right answers*: an exact binomial test against guessing, one-sided, over all listeners' answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import (
    Bs1116Page,
    MushraPage,
    PairedPage,
    PairPage,
    RatingPage,
    StaircasePage,
    localised,
)
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import CHANCE, sensitivity, task_of

MOST = 10_000
#: standard deviations of listeners' differences where a page states none: points of 100, of grades 1 to 5, of a scale
_SD = {"mushra": 15.0, "bs1116": 0.8}
#: effects where a page states none
_EFFECT = {"mushra": 10.0, "bs1116": 0.5}
_SHARE = 0.70


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


def listeners_for_difference(difference: float, sd: float, alpha: float, power: float) -> int:
    """Listeners with whom a two-sided paired t test finds a difference.

    Raises
    ------
    ListeningError : more than `MOST` are needed.
    """
    from scipy.stats import nct, t

    for n in range(2, MOST + 1):
        limit = float(t.ppf(1 - alpha / 2, n - 1))
        shift = difference * math.sqrt(n) / sd
        if shift > 12.0 + limit or float(nct.sf(limit, n - 1, shift) + nct.cdf(-limit, n - 1, shift)) >= power:
            return n
    raise ListeningError(f"more than {MOST} listeners would be needed for {difference:g} of sd {sd:g}")


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


def power_of(manifest: Manifest, trials: dict[int, int]) -> list[PowerRow]:
    """Listeners that each page needs.

    Parameters
    ----------
    manifest : with the effects that its pages expect, and the probabilities of errors.
    trials : page (from 0) -> trials that a listener gets of one pair on it.
    """
    alpha, power = manifest.power.alpha, manifest.power.power
    rows = []
    for index, page in enumerate(manifest.pages):
        name = localised(getattr(page, "name", ""), manifest.language) or page.type
        number = index + 1
        if isinstance(page, (MushraPage, Bs1116Page, RatingPage)):
            width = 100.0 if not isinstance(page, RatingPage) else page.scales[0].high - page.scales[0].low
            effect = page.expect or _EFFECT.get(page.type, 0.1 * width)
            sd = page.expect_sd or _SD.get(page.type, 0.15 * width)
            n = listeners_for_difference(effect, sd, alpha, power)
            rows.append(PowerRow(number, name, f"{effect:g} points, sd {sd:g}", n, page.expect is not None))
        elif isinstance(page, PairPage):
            task = task_of(page)
            chance = 0.5 if task is None else CHANCE[task]
            share = page.expect or _SHARE
            answers = answers_for_share(share, chance, alpha, power)
            each = max(trials.get(index, 1), 1)
            d = "" if task is None or task == "same" else f", d' = {sensitivity(share, task):.2f}"
            what = "chosen" if isinstance(page, PairedPage) else "right"
            text = f"{100 * share:.0f} % {what}{d}: {answers} answers, {each} a listener"
            rows.append(PowerRow(number, name, text, math.ceil(answers / each), page.expect is not None))
        elif isinstance(page, StaircasePage) and page.expect_sd is not None:
            step = math.log(page.steps[-1]) if page.ratio else page.steps[-1]
            sd = math.log(page.expect_sd) if page.ratio and page.expect_sd > 1 else page.expect_sd
            n = listeners_for_difference(step, sd, alpha, power)
            rows.append(PowerRow(number, name, f"a threshold other by one last step, sd {page.expect_sd:g}", n, True))
    return rows
