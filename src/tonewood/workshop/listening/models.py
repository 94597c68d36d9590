"""Models of ratings and comparisons: linear analysis, ranks and shares of preference, Bradley-Terry scale.

*Linear analysis*: main effects over all cells and interactions of two factors. Where every listener answered every
cell, each effect is tested against the listeners' own differences in it (`tonewood.workshop.listening.strata`). Where
answers are missing, the cell means that are there are fitted, and tested against the same differences between listeners
(`tonewood.workshop.listening.incomplete`).

*Rank analysis*: for each factor Friedman's test on the listeners' means of its levels, over the cells of the other
factors that a listener rated at all levels that are compared, with Kendall's W as effect size, and Wilcoxon's
signed-rank test of each pair of levels with the matched-pairs rank-biserial correlation, p by Holm. It
asks for no normal distribution. *Superiority* asks for no equal spacing of grades either: the share of comparisons
within a listener, all else equal, in which one level is rated above another (a tie counts half), with Student's
interval of the listeners' shares. Where all n listeners have the same share, an unseen part of the listeners of up to
1 - (alpha / 2)^(1 / n) may have any other (Clopper and Pearson's bound), and p is that of the sign test. Any rising
change of the scale leaves the share as it is, and so does a scale that ends.

*Bradley-Terry*: P(b over a) = 1 / (1 + e^(v_a - v_b)), sum v = 0, by maximum likelihood; a tie is half an answer each.
One tie is added to each pair of levels that was compared: values stay finite where one always wins, and listeners who
all agree do not make an interval without width. Answers of a listener belong together: the covariance matrix is the
sandwich of the listeners' scores, n / (n - 1) times, with Student's t on n - 1 degrees of freedom (the added ties count
in the sum as one listener); of a single listener it is that of independent answers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.cells import Cells, Rows, cells_of
from tonewood.workshop.listening.incomplete import CrossedFit, IncompleteFit
from tonewood.workshop.listening.means import student_interval, unique

#: share of answers at an end of the scale beyond which differences of means mislead
END_SHARE = 0.15
#: random sounds below which the report warns
FEW_SOUNDS = 6
#: share of the largest rating below which means differ by rounding errors
_ROUNDING = 1e-10


@dataclass(frozen=True)
class ModelTerm:
    """One difference from the reference level, over all cells of the other factors (points).

    `p_holm` is adjusted for the differences of the same effect; Cohen's d is the difference over the standard deviation
    of answers within a cell, infinite where they have none; `first` is the reference level, empty for an interaction.
    """

    name: str
    effect: tuple[str, ...]
    difference: float
    low: float
    high: float
    df: float
    p_value: float
    p_holm: float
    cohens_d: float
    first: str


@dataclass(frozen=True)
class FactorTest:
    """Test of a whole factor or interaction: statistic, degrees of freedom, p, effect size with its name.

    `df2` is that of an F's denominator, `p_greenhouse` the probability without the correction for small samples.
    """

    name: str
    test: str
    statistic: float
    df: float
    p_value: float
    effect: float | None = None
    effect_name: str = ""
    df2: float | None = None
    p_greenhouse: float | None = None


@dataclass(frozen=True)
class LinearAnalysis:
    """Differences of means and their tests.

    cell_sd : standard deviation of answers within a cell, over listeners and repetitions.
    at_ends : share of answers at the ends of the scale; None for a scale without ends.
    """

    formula: str
    method: str
    exact: bool
    answers: int
    listeners: int
    random: tuple[str, ...]
    terms: tuple[ModelTerm, ...]
    tests: tuple[FactorTest, ...]
    cell_sd: float
    at_ends: float | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Superiority:
    """Share of comparisons in which `second` is rated above `first`, with its interval and the test against a half.

    `p_holm` is adjusted for the pairs of the same factor.
    """

    factor: str
    first: str
    second: str
    listeners: int
    share: float
    low: float
    high: float
    p_value: float
    p_holm: float


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
    """Friedman's test of each factor, Wilcoxon's of each pair of its levels, and shares of preference."""

    tests: tuple[FactorTest, ...]
    pairs: tuple[RankPair, ...]
    superiority: tuple[Superiority, ...] = ()


@dataclass(frozen=True)
class ScaleValue:
    """Value of one level on the Bradley-Terry scale, in logits, with its interval."""

    level: str
    value: float
    low: float
    high: float


def linear_analysis(
    rows: Rows,
    factors: Sequence[str],
    confidence: float,
    levels: Mapping[str, Sequence[str]],
    random: Sequence[str] = (),
    ends: tuple[float, float] | None = None,
) -> LinearAnalysis | None:
    """Estimate and test differences of means; None where no fixed factor varies or listeners are fewer than three.

    random : factors whose levels are a random sample of many (of notes, of pieces).
    """
    data = cells_of(rows, factors, levels, random)
    if data is None:
        return None
    sampled = data.sampled
    contrasts = strata.contrasts(data.cells, data.levels)
    notes = [f"interaction left out, it has empty cells: {' : '.join(e)}" for e in contrasts.without if len(e) > 1]
    if data.single:
        notes.append(f"left out, rated by one listener only: {', '.join(data.single)}")
    notes += [f"{e[0]} cannot be told from the other factors" for e in contrasts.without if len(e) == 1]
    if not contrasts.bases:
        return None
    cell_sd = data.cell_sd()
    spread = cell_sd > _ROUNDING * float(np.max(np.abs(data.value)))
    at_ends = None if ends is None else float(np.mean((data.value <= ends[0]) | (data.value >= ends[1])))
    estimates, tests, method = _fitted(data, contrasts, confidence)
    if not data.complete:
        without = f"{int(np.sum(np.isnan(data.means)))} of {data.means.size} cells of listeners have no answer"
        notes.append(f"{without}: differences allow for that, means per factor do not")
    if sampled and len(data.sounds) < FEW_SOUNDS:
        notes.append(
            f"{len(data.sounds)} sounds are few for a random sample: with fewer than {FEW_SOUNDS}, between 1 and 6.5 % "
            "of tests at 5 % are false alarms"
        )
    terms, alone, alike = [], [], []
    for effect, one in estimates.items():
        indices = np.flatnonzero(np.isfinite(one.p_value))
        names, first = contrasts.names[effect], data.levels[effect[0]][0] if len(effect) == 1 else ""
        alone += [name for i, name in enumerate(names) if i not in indices]
        alike += [names[i] for i in indices if one.low[i] == one.high[i] and one.difference[i] != 0]
        for i, p in zip(indices, strata.holm(one.p_value[indices]), strict=True):
            arrays = one.difference, one.low, one.high, one.df, one.p_value
            difference, low, high, df, p_value = (float(x[i]) for x in arrays)
            d = difference / cell_sd if spread else math.copysign(math.inf, difference) if difference else 0.0
            terms.append(ModelTerm(names[i], effect, difference, low, high, df, p_value, float(p), d, first))
    if alone:
        alone += [" : ".join(e) for e, t in tests.items() if not np.isfinite(t.p_value)]
        notes.append(f"not stated, because one listener or sound alone decides it: {', '.join(alone)}")
    if alike:
        notes.append(
            "all listeners have the same difference, so that its interval has no width and p is that of the sign test: "
            + ", ".join(alike)
        )
    named = [
        FactorTest(
            " : ".join(e), "F", float(t.statistic), float(t.df1), float(t.p_value), df2=float(t.df2),
            p_greenhouse=None if sampled else float(t.p_greenhouse),
        )
        for e, t in tests.items() if np.isfinite(t.p_value)
    ]  # fmt: skip
    formula = "value ~ " + " + ".join(":".join(effect) for effect in contrasts.bases)
    return LinearAnalysis(
        formula, method, data.complete, len(data.value), len(data.who), sampled, tuple(terms), tuple(named), cell_sd,
        at_ends, tuple(notes),
    )  # fmt: skip


def _fitted(
    data: Cells, contrasts: strata.Contrasts, confidence: float
) -> tuple[dict[strata.EffectName, strata.Estimated], dict[strata.EffectName, strata.Tested], str]:
    """Differences and tests of each effect, and the method in words."""
    sounds = bool(data.sampled)
    y = data.means if sounds else data.means[:, 0]
    estimated: Callable[[Floats, float], strata.Estimated]
    tested: Callable[[Floats], strata.Tested]
    if data.complete:
        estimated, tested = partial(strata.estimated, y, sounds=sounds), partial(strata.tested, y, sounds=sounds)
        words = (
            "quasi-F of listeners and sounds (Clark 1973) with degrees of freedom after Cochran (1964)"
            if sounds
            else "Greenhouse-Geisser degrees of freedom as corrected by Huynh and Feldt"
        )
        method = f"analysis of variance by strata, {words}; each difference against its own spread over the listeners"
    else:
        fit = (CrossedFit if sounds else IncompleteFit)(y, data.design(contrasts))
        estimated, tested = fit.estimated, fit.tested
        of = "listeners and of sounds" if sounds else "listeners"
        words = (
            "joined as in the quasi-F of both (Clark 1973), with degrees of freedom after Cochran (1964)"
            if sounds
            else "F by the trace, with degrees of freedom as corrected by Huynh and Feldt"
        )
        method = (
            f"least squares of the listeners' cell means, some missing, with variances that are robust by clusters of "
            f"{of} (CR2) and Satterthwaite's degrees of freedom (Bell and McCaffrey 2002); {words}"
        )
    differences = {e: estimated(rows, confidence) for e, rows in contrasts.differences.items()}
    return differences, {e: tested(basis) for e, basis in contrasts.bases.items()}, method


def rank_analysis(rows: Rows, factors: Sequence[str], confidence: float = 0.95) -> RankAnalysis:
    """Rank tests of each factor: of all its levels and of each pair, over the cells that a listener rated at all."""
    from scipy.stats import friedmanchisquare, wilcoxon

    tests, pairs = [], []
    error = _ROUNDING * max((abs(row["value"]) for row in rows), default=0.0) or 1.0
    for factor in factors:
        levels, cells = unique([str(row[factor]) for row in rows]), _by_listener(rows, factors, factor)
        table = np.round(_compared(cells, levels) / error)  # what differs by rounding errors is equal
        if len(levels) > 2 and len(table) > 2 and np.any(np.ptp(table, axis=1) > 0):
            test = friedmanchisquare(*table.T)
            w = float(test.statistic) / (len(table) * (len(levels) - 1))
            figures = float(test.statistic), len(levels) - 1, float(test.pvalue), w
            tests.append(FactorTest(factor, "Friedman chi^2", *figures, "Kendall's W"))
        raw = []
        for a, b in itertools.combinations(levels, 2):
            change = np.round(np.diff(_compared(cells, (a, b)))[:, 0] / error)
            if (n := len(change)) > 2:
                p = float(wilcoxon(change).pvalue) if np.any(change) else 1.0
                raw.append((a, b, n, p, _rank_biserial(change)))
        holm = strata.holm(np.array([p for _, _, _, p, _ in raw]))
        pairs += [RankPair(factor, a, b, n, p, float(q), r) for (a, b, n, p, r), q in zip(raw, holm, strict=True)]
    return RankAnalysis(tuple(tests), tuple(pairs), tuple(superiorities(rows, factors, confidence)))


def _by_listener(rows: Rows, factors: Sequence[str], factor: str) -> dict[tuple[str, ...], dict[str, list[float]]]:
    """Values by listener and cell of the other factors, then by level of `factor`."""
    cells: dict[tuple[str, ...], dict[str, list[float]]] = {}
    for row in rows:
        key = (str(row["listener"]), *_cell(row, factors, factor))
        cells.setdefault(key, {}).setdefault(str(row[factor]), []).append(float(row["value"]))
    return cells


def _compared(cells: Mapping[tuple[str, ...], Mapping[str, list[float]]], levels: Sequence[str]) -> Floats:
    """Means (listeners, levels) over the cells that a listener rated at all of these levels: all else is equal."""
    by_listener: dict[str, list[list[float]]] = {}
    for (who, *_), values in cells.items():
        if all(level in values for level in levels):
            by_listener.setdefault(who, []).append([float(np.mean(values[level])) for level in levels])
    return np.array([np.mean(means, axis=0) for means in by_listener.values()]).reshape(-1, len(levels))


def superiorities(rows: Rows, factors: Sequence[str], confidence: float) -> list[Superiority]:
    """Shares of preference of each pair of levels."""
    comparisons = []
    for factor in factors:
        cells, pairs = _by_listener(rows, factors, factor), []
        for a, b in itertools.combinations(unique([str(row[factor]) for row in rows]), 2):
            shares: dict[str, list[float]] = {}
            for (who, *_), values in cells.items():
                if a in values and b in values:
                    over = np.sign(np.subtract.outer(values[b], values[a]))
                    shares.setdefault(who, []).append(float(0.5 + 0.5 * over.mean()))
            if len(shares) >= 3:
                each = np.round([np.mean(s) for s in shares.values()], 12)
                pairs.append((a, b, len(each), *share_interval(each, confidence)))
        adjusted = strata.holm(np.array([pair[-1] for pair in pairs]))
        comparisons += [Superiority(factor, *pair, float(p)) for pair, p in zip(pairs, adjusted, strict=True)]
    return comparisons


def share_interval(shares: Floats, confidence: float) -> tuple[float, float, float, float]:
    """Mean of listeners' shares (n,), its interval, and p against a half."""
    n, mean, p = len(shares), float(np.mean(shares)), float(share_test(shares))
    if np.ptp(shares) == 0:
        unseen = 1 - ((1 - confidence) / 2) ** (1 / n)
        return mean, mean * (1 - unseen), mean + unseen * (1 - mean), p
    _, low, high = student_interval(list(shares), confidence)
    return mean, max(float(low or 0.0), 0.0), min(float(high or 0.0), 1.0), p


def share_test(shares: Floats) -> Floats:
    """Probabilities (...) of listeners' shares (..., n) against a half: Student's, or the sign test of equal shares."""
    from scipy.special import stdtr

    n, mean = shares.shape[-1], shares.mean(axis=-1)
    alike, error = np.ptp(shares, axis=-1) == 0, shares.std(axis=-1, ddof=1) / math.sqrt(n)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2 * stdtr(n - 1, -np.abs(mean - 0.5) / error)
    return np.asarray(np.where(alike, np.where(mean == 0.5, 1.0, 2 * 0.5**n), p))


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
    from scipy.stats import t as student

    pairs = [tuple(str(row[factor]).split("|")) for row in rows]
    ties = unique([tuple(sorted(pair)) for pair in pairs])
    pairs += ties
    levels = unique([level for pair in pairs for level in pair])
    n = len(levels)
    design = np.zeros((len(pairs), n))
    for i, (a, b) in enumerate(pairs):
        design[i, levels.index(b)], design[i, levels.index(a)] = 1.0, -1.0
    y = np.array([row["value"] for row in rows] + [0.5] * len(ties), dtype=np.float64)
    prior = 1e-6  # of all levels, some of which may not be compared with the others
    value = np.zeros(n)
    for _ in range(100):
        p = 1 / (1 + np.exp(-design @ value))
        information = design.T @ ((p * (1 - p))[:, None] * design) + prior * np.eye(n) + np.ones((n, n)) / n
        step = np.linalg.solve(information, design.T @ (y - p) - prior * value)
        value += step
        if np.max(np.abs(step)) < 1e-10:
            break
    inverse = np.linalg.inv(information)
    who, of = np.unique([str(row["listener"]) for row in rows], return_inverse=True)
    if len(who) > 1:
        scores = np.zeros((len(who) + 1, n))
        np.add.at(scores, np.append(of, [len(who)] * len(ties)), design * (y - p)[:, None])
        covariance = len(who) / (len(who) - 1) * (inverse @ scores.T @ scores @ inverse)
        quantile = float(student.ppf((1 + confidence) / 2, len(who) - 1))
    else:
        covariance = inverse - np.ones((n, n)) / (n * (1 + prior))
        quantile = float(norm.ppf((1 + confidence) / 2))
    half = quantile * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        ScaleValue(level, float(v), float(v - h), float(v + h)) for level, v, h in zip(levels, value, half, strict=True)
    )
