"""QUEST+: the next level is that of least expected entropy of all parameters of the psychometric function.

With pi_k the probability of parameter set k, p_ik that of a right answer at level i, and q = 1 - p, m_i = sum_k pi_k
p_ik,

    E_i = sum over right and wrong of  m_i log m_i - sum_k pi_k p_ik (log p_ik + log pi_k)

up to the sign of all terms. Posterior and entropies need two products of tables with pi, so that many listeners can be
simulated at once. Levels within 1e-9 of the least entropy count as equal, and the first of them is taken: rounding does
not decide.

Source: A. B. Watson, QUEST+: A general multidimensional Bayesian adaptive psychometric method, J. Vision 17(3):10
(2017).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import chance_of
from tonewood.workshop.listening.psychometric import psychometric

#: levels that may be presented, and steps of the thresholds' grid
LEVELS, THRESHOLDS = 41, 61
#: slopes, in units of 1 / range of u, and lapse rates that are thought possible
SLOPES = np.geomspace(3.0, 60.0, 7)
LAPSE_RATES = np.array([0.01, 0.04, 0.08])
_EQUAL = 1e-9


class QuestTable:
    """Probabilities of right answers (levels, parameter sets), and the products that entropies need.

    right : (levels, sets) probabilities strictly between 0 and 1.
    prior : (sets,) of the parameter sets.
    """

    def __init__(self, right: Floats, prior: Floats):
        self.right = right
        self.prior = prior / prior.sum()
        wrong = 1 - right
        self.information = right * np.log(right) + wrong * np.log(wrong)

    def entropies(self, posterior: Floats) -> Floats:
        """Expected entropies (..., levels) after one more answer; posterior (..., sets)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            entropies = np.where(posterior > 0, posterior * np.log(posterior), 0.0)
        mean = np.clip(posterior @ self.right.T, 1e-300, 1 - 1e-16)
        response = mean * np.log(mean) + (1 - mean) * np.log1p(-mean)
        return np.asarray(response - posterior @ self.information.T - entropies.sum(axis=-1)[..., None])

    def best(self, posterior: Floats) -> NDArray[np.int_]:
        """Index (...) of the level to present."""
        e = self.entropies(posterior)
        return np.asarray(np.argmax(e <= e.min(axis=-1, keepdims=True) + _EQUAL, axis=-1))

    def updated(self, posterior: Floats, level: Any, right: Any) -> Floats:
        """Posterior after answers (...) at levels (...)."""
        p = self.right[level]
        new = posterior * np.where(np.asarray(right)[..., None], p, 1 - p)
        return np.asarray(new / new.sum(axis=-1, keepdims=True))


@lru_cache(maxsize=16)
def table_of(page: StaircasePage) -> tuple[Floats, QuestTable]:
    """Levels (41,) of a page, and its table."""
    low, high = page.transformed(page.lowest), page.transformed(page.highest)
    u = np.linspace(low, high, LEVELS)
    t, b, lapse = np.meshgrid(np.linspace(low, high, THRESHOLDS), SLOPES / (high - low), LAPSE_RATES, indexing="ij")
    right = psychometric(u[:, None], t.ravel(), b.ravel(), chance_of(page), page.share, lapse.ravel())
    return u, QuestTable(np.clip(right, 1e-9, 1 - 1e-9), np.ones(t.size))


@dataclass
class QuestTrack:
    """One track of QUEST+, at the level of its next trial; `StaircaseTrack` is the other method.

    level : of the next trial; the first is the page's `start`.
    """

    page: StaircasePage
    level: float = 0.0
    levels: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    _posterior: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        u, table = table_of(self.page)
        self._posterior = table.prior
        self.level = self._at(int(np.argmin(np.abs(u - self.page.transformed(self.page.start)))))

    @property
    def done(self) -> bool:
        """Whether it has its trials."""
        return len(self.levels) >= self.page.trials

    def step_after(self, right: bool) -> float:
        """The level that an answer would lead to."""
        return self._next(right)[0]

    def answer(self, right: bool) -> None:
        """Take the answer to a trial at `level`."""
        self.levels.append(self.level)
        self.right.append(right)
        self.level, self._posterior = self._next(right)

    def _next(self, right: bool) -> tuple[float, Floats]:
        u, table = table_of(self.page)
        here = int(np.argmin(np.abs(u - self.page.transformed(self.level))))
        posterior = table.updated(self._posterior, here, right)
        return self._at(int(table.best(posterior))), posterior

    def _at(self, index: int) -> float:
        """A level of the grid, with ten digits."""
        u = float(table_of(self.page)[0][index])
        return float(f"{math.exp(u) if self.page.ratio else u:.10g}")
