"""Models of ratings and comparisons: linear mixed model, rank analysis, Bradley-Terry scale.

*Mixed model* (statsmodels): value ~ all factors and their interactions of two, with a random intercept of each
listener, by restricted maximum likelihood. Effects are reported as differences from the first level, in points, and as
Cohen's d = difference / sqrt(var listener + var residual). A factor as a whole is tested by Wald's chi^2.

*Rank analysis*: for each factor Friedman's test on the listeners' means of its levels, with Kendall's W as effect size,
and Wilcoxon's signed-rank test of each pair of levels with the matched-pairs rank-biserial correlation, p by Holm. It
asks for no normal distribution and no equal spacing of grades.

*Bradley-Terry*: P(b over a) = 1 / (1 + e^(v_a - v_b)), sum v = 0, by maximum likelihood; a tie is half an answer each.
Intervals are from the information matrix, with every answer independent.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from tonewood.workshop.listening.means import listener_means, unique

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class ModelTerm:
    """One coefficient: difference (points), its interval, p, and Cohen's d."""

    name: str
    difference: float
    low: float
    high: float
    p_value: float
    cohens_d: float


@dataclass(frozen=True)
class FactorTest:
    """Test of a whole factor: statistic, degrees of freedom, p, effect size with its name."""

    name: str
    test: str
    statistic: float
    df: int
    p_value: float
    effect: float | None = None
    effect_name: str = ""


@dataclass(frozen=True)
class MixedModel:
    """A fitted linear mixed model."""

    formula: str
    groups: str
    answers: int
    terms: tuple[ModelTerm, ...]
    tests: tuple[FactorTest, ...]
    listener_sd: float
    residual_sd: float
    converged: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RankPair:
    """Two levels of a factor compared by ranks; r is the matched-pairs rank-biserial correlation."""

    factor: str
    first: str
    second: str
    listeners: int
    p_value: float
    p_holm: float
    r: float


@dataclass(frozen=True)
class RankAnalysis:
    """Friedman's test of each factor and Wilcoxon's of each pair of its levels."""

    tests: tuple[FactorTest, ...]
    pairs: tuple[RankPair, ...]


@dataclass(frozen=True)
class ScaleValue:
    """Value of one level on the Bradley-Terry scale, in logits, with its interval."""

    level: str
    value: float
    low: float
    high: float


def mixed_model(
    rows: Rows, factors: Sequence[str], confidence: float, levels: Mapping[str, Sequence[str]]
) -> MixedModel | None:
    """Fit the mixed model; None where nothing varies, there are fewer than three listeners, or no spread to estimate.

    Parameters
    ----------
    levels : factor -> its levels; differences are from the first that is there.
    """
    from pandas import Categorical, DataFrame
    from scipy.stats import chi2, norm
    from statsmodels.formula.api import mixedlm

    used = [f for f in factors if len({row[f] for row in rows}) > 1]
    if not used or len({row["listener"] for row in rows}) < 3:
        return None
    columns = {name: f"f{i}" for i, name in enumerate(used)}
    data = DataFrame(
        {"value": [row["value"] for row in rows], "listener": [row["listener"] for row in rows]}
        | {
            column: Categorical(given := [str(row[name]) for row in rows], [v for v in levels[name] if v in given])
            for name, column in columns.items()
        }
    )
    formula, notes = _formula(data, columns)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for method in ("lbfgs", "powell", "nm"):  # the first meets singular matrices where a listener's share is small
            try:
                fit = mixedlm(formula, data, groups=data["listener"]).fit(reml=True, method=method)
            except linalg.LinAlgError:
                continue
            if np.all(np.isfinite(fit.bse_fe)):  # rounding decides which search ends where errors are known
                break
        else:
            return None
    notes += [str(w.message).splitlines()[0] for w in caught if "Convergence" in w.category.__name__]
    variance = float(np.asarray(fit.cov_re)[0, 0])
    if variance + float(fit.scale) <= 0:
        return None
    spread = math.sqrt(variance + float(fit.scale))
    z = float(norm.ppf((1 + confidence) / 2))
    names = [n for n in fit.fe_params.index if n != "Intercept"]
    terms = tuple(
        ModelTerm(
            _readable(name, columns), b := float(fit.fe_params[name]), b - z * (s := float(fit.bse_fe[name])),
            b + z * s, float(2 * norm.sf(abs(b / s))), b / spread,
        )
        for name in names
    )  # fmt: skip
    index = list(fit.fe_params.index)
    covariance = np.asarray(fit.cov_params())[: len(index), : len(index)]
    tests = []
    for name, column in columns.items():
        where = [i for i, n in enumerate(index) if n.startswith(f"C({column})") and ":" not in n]
        found = np.asarray(fit.fe_params)[where]
        wald = float(found @ linalg.solve(covariance[np.ix_(where, where)], found))
        tests.append(
            FactorTest(
                name, "Wald chi^2, at the first level of the others", wald, len(found), float(chi2.sf(wald, len(found)))
            )
        )
    shown = formula
    for name, column in columns.items():
        shown = shown.replace(column, name)
    return MixedModel(
        shown, "(1 | listener)", len(rows), terms, tuple(tests), math.sqrt(max(variance, 0.0)),
        math.sqrt(float(fit.scale)), bool(fit.converged), tuple(notes),
    )  # fmt: skip


def _formula(data: Any, columns: Mapping[str, str]) -> tuple[str, list[str]]:
    """Formula with interactions of two; without them where cells are empty."""
    terms = [f"C({c})" for c in columns.values()]
    pairs = list(itertools.combinations(columns.values(), 2))
    whole = [(a, b) for a, b in pairs if len(data[[a, b]].drop_duplicates()) == data[a].nunique() * data[b].nunique()]
    notes = [] if len(whole) == len(pairs) else ["interactions with empty cells are left out"]
    return "value ~ " + " + ".join([*terms, *(f"C({a}):C({b})" for a, b in whole)]), notes


def _readable(name: str, columns: Mapping[str, str]) -> str:
    """``C(f0)[T.near]:C(f1)[T.low]`` as ``damping=near : score=low``."""
    parts = []
    for part in name.split(":"):
        column, _, level = part.partition("[T.")
        factor = next((f for f, c in columns.items() if column == f"C({c})"), column)
        parts.append(f"{factor}={level.rstrip(']')}")
    return " : ".join(parts)


def rank_analysis(rows: Rows, factors: Sequence[str]) -> RankAnalysis:
    """Rank tests of each factor, on listeners who rated all its levels, in cells of the others that have all."""
    from scipy.stats import friedmanchisquare, wilcoxon

    tests, pairs = [], []
    for factor in factors:
        levels = unique([str(row[factor]) for row in rows])
        cells: dict[tuple[str, ...], set[str]] = {}
        for row in rows:
            cells.setdefault(_cell(row, factors, factor), set()).add(str(row[factor]))
        whole = [row for row in rows if len(cells[_cell(row, factors, factor)]) == len(levels)]
        means = [listener_means([row for row in whole if str(row[factor]) == level]) for level in levels]
        who = [w for w in means[0] if all(w in m for m in means)]
        if len(levels) < 2 or len(who) < 3:
            continue
        table = np.array([[m[w] for m in means] for w in who])
        if len(levels) > 2 and np.ptp(table) > 0:
            found = friedmanchisquare(*table.T)
            w = float(found.statistic) / (len(who) * (len(levels) - 1))
            tests.append(
                FactorTest(
                    factor,
                    "Friedman chi^2",
                    float(found.statistic),
                    len(levels) - 1,
                    float(found.pvalue),
                    w,
                    "Kendall's W",
                )
            )
        raw = []
        for a, b in itertools.combinations(range(len(levels)), 2):
            change = table[:, b] - table[:, a]
            p = float(wilcoxon(change).pvalue) if np.any(change) else 1.0
            raw.append((levels[a], levels[b], p, _rank_biserial(change)))
        order = np.argsort([p for _, _, p, _ in raw])
        holm, worst = np.empty(len(raw)), 0.0
        for rank, i in enumerate(order):
            worst = max(worst, min(1.0, (len(raw) - rank) * raw[i][2]))
            holm[i] = worst
        pairs += [RankPair(factor, a, b, len(who), p, float(q), r) for (a, b, p, r), q in zip(raw, holm, strict=True)]
    return RankAnalysis(tuple(tests), tuple(pairs))


def _cell(row: Mapping[str, Any], factors: Sequence[str], but: str) -> tuple[str, ...]:
    """Levels of all factors but one."""
    return tuple(str(row[name]) for name in factors if name != but)


def _rank_biserial(change: Any) -> float:
    """(sum of positive ranks - sum of negative ranks) / sum of all."""
    from scipy.stats import rankdata

    nonzero = change[change != 0]
    if not len(nonzero):
        return 0.0
    ranks = rankdata(np.abs(nonzero))
    return float(np.sum(ranks * np.sign(nonzero)) / np.sum(ranks))


def bradley_terry(rows: Rows, factor: str, confidence: float) -> tuple[ScaleValue, ...]:
    """Values of a factor's levels from paired comparisons; rows have ``a|b`` there, and the share of b as value."""
    from scipy.stats import norm

    pairs = [tuple(str(row[factor]).split("|")) for row in rows]
    levels = unique([level for pair in pairs for level in pair])
    n = len(levels)
    design = np.zeros((len(rows), n))
    for i, (a, b) in enumerate(pairs):
        design[i, levels.index(b)], design[i, levels.index(a)] = 1.0, -1.0
    y = np.array([row["value"] for row in rows], dtype=np.float64)
    prior = 1e-3  # of all levels: finite values where one always wins
    value = np.zeros(n)
    for _ in range(100):
        p = 1 / (1 + np.exp(-design @ value))
        information = design.T @ ((p * (1 - p))[:, None] * design) + prior * np.eye(n) + np.ones((n, n)) / n
        step = linalg.solve(information, design.T @ (y - p) - prior * value)
        value += step
        if np.max(np.abs(step)) < 1e-10:
            break
    covariance = linalg.inv(information) - np.ones((n, n)) / (n * (1 + prior))
    half = float(norm.ppf((1 + confidence) / 2)) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        ScaleValue(level, float(v), float(v - h), float(v + h)) for level, v, h in zip(levels, value, half, strict=True)
    )
