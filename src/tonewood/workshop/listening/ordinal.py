"""Cumulative logit model of grades: which level is graded higher, without distances between grades.

    P(grade <= k in cell c) = 1 / (1 + exp(eta_c - alpha_k)),     alpha_1 < ... < alpha_(K-1)

so that exp(eta_c - eta_d) is the ratio of the odds of a grade above k in two cells, the same for each k (proportional
odds). The estimates are those of maximum likelihood over all answers, with `PRIOR` answers added to each cell that are
distributed as all answers are, which takes off what maximum likelihood is too large by in small samples. Where all
answers to a cell stand at one end of the scale its odds are infinite, and differences from it are not stated. Answers
of a listener belong together: the covariance matrix is the sandwich of the n listeners' scores s_i (gradients of their
log likelihoods, less the mean), with the expected information J of all (with the observed one false alarms are fewer),

    V = n / (n - 1) J^-1 (sum_i s_i s_i^T) J^-1

on n - 1 degrees of freedom; effects are tested as in `tonewood.workshop.listening.strata`. The odds are those of the
population of listeners and not of one listener. Values of a scale without grades are grouped at their quantiles into
at most `GRADES` grades; those at an end of the scale stay grades of their own.

Sources: P. McCullagh, J. R. Stat. Soc. B 42 (1980) 109-142; K.-Y. Liang & S. L. Zeger, Biometrika 73 (1986) 13-22
(sandwich over clusters).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.cells import Rows, cells_of

#: most grades of a scale; answers that are added to each cell
GRADES, PRIOR = 20, 0.5
_STEPS, _SMALL = 60, 1e-9


@dataclass(frozen=True)
class OddsTerm:
    """Ratio of the odds of a higher grade at one level and at the reference level, over all cells of other factors."""

    name: str
    effect: tuple[str, ...]
    ratio: float
    low: float
    high: float
    df: float
    p_value: float
    p_holm: float


@dataclass(frozen=True)
class OddsTest:
    """F of a whole factor or interaction on the scale of log odds."""

    name: str
    statistic: float
    df: float
    df2: float
    p_value: float


@dataclass(frozen=True)
class OrdinalAnalysis:
    """Odds of higher grades and their tests.

    terms, tests : differences and effects whose odds are finite.
    notes : effects that are left out, and why.
    """

    grades: int
    listeners: int
    terms: tuple[OddsTerm, ...]
    tests: tuple[OddsTest, ...]
    converged: bool
    notes: tuple[str, ...] = ()


def fit_counts(counts: Floats, x: Floats, prior: float = PRIOR) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Fit tables of counts.

    counts : (..., cells, grades), no grade without an answer in the table with the most answers.
    x : (cells, p) columns without a constant.
    Returns beta : (..., p).
    alpha : (..., grades - 1).
    converged : (...) whether the search by Fisher's scoring ended.
    """
    n = _filled(counts, prior)
    total, cuts = n.sum(axis=-1), counts.shape[-1] - 1
    below = np.cumsum(n.sum(axis=-2), axis=-1)
    alpha = np.log(below[..., :-1]) - np.log(below[..., -1:] - below[..., :-1])
    point = np.concatenate([alpha, np.zeros((*alpha.shape[:-1], x.shape[1]))], axis=-1)
    done = np.zeros(counts.shape[:-2], dtype=bool)
    for _ in range(_STEPS):
        score, information = _scored(n, total, x, point, cuts)
        step = np.linalg.solve(information, score[..., None])[..., 0]
        likelihood = _likelihood(n, x, point, cuts)
        for _ in range(20):  # a whole step may lead far beyond the maximum, or change the order of cuts
            less = _likelihood(n, x, point + step, cuts) < likelihood - 1e-9 * np.abs(likelihood)
            if not less.any():
                break
            step = np.where(less[..., None], step / 2, step)
        point = point + step
        done = np.max(np.abs(step), axis=-1) < 1e-7
        if done.all():
            break
    return point[..., cuts:], point[..., :cuts], done


def _shares(x: Floats, point: Floats, cuts: int) -> tuple[Floats, Floats]:
    """P(grade <= k), from 0 to 1, and P(grade = k) at (alpha, beta); nearly 0 where cuts are out of order."""
    eta = point[..., cuts:] @ x.T
    inner = 1 / (1 + np.exp(np.clip(eta[..., None] - point[..., None, :cuts], -500, 500)))
    zero = np.zeros((*inner.shape[:-1], 1))
    f = np.concatenate([zero, inner, zero + 1], axis=-1)
    return f, np.maximum(np.diff(f, axis=-1), 1e-300)


def _likelihood(n: Floats, x: Floats, point: Floats, cuts: int) -> Floats:
    """Logarithm of the likelihood."""
    return np.asarray(np.sum(n * np.log(_shares(x, point, cuts)[1]), axis=(-2, -1)))


def _scored(n: Floats, total: Floats, x: Floats, point: Floats, cuts: int) -> tuple[Floats, Floats]:
    """Gradient and expected second derivatives of the logarithm of the likelihood in (alpha, beta)."""
    f, p = _shares(x, point, cuts)
    slope = f[..., 1:-1] * (1 - f[..., 1:-1])
    ratio, lean = n / p, 1 - f[..., 1:] - f[..., :-1]
    of_alpha = np.sum(slope * (ratio[..., :-1] - ratio[..., 1:]), axis=-2)
    of_eta = -np.sum(n * lean, axis=-1)
    weight = total[..., None]
    aa = np.zeros((*point.shape[:-1], cuts, cuts))
    at = np.arange(cuts)
    aa[..., at, at] = np.sum(weight * slope**2 * (1 / p[..., :-1] + 1 / p[..., 1:]), axis=-2)
    beside = -np.sum(weight * slope[..., :-1] * slope[..., 1:] / p[..., 1:-1], axis=-2)
    aa[..., at[:-1], at[1:]] = aa[..., at[1:], at[:-1]] = beside
    ac = -weight * slope * (f[..., 2:] - f[..., :-2])
    ab = np.swapaxes(ac, -1, -2) @ x
    bb = np.swapaxes(x * (total * np.sum(p * lean**2, axis=-1))[..., None], -1, -2) @ x
    top = np.concatenate([aa, ab], axis=-1)
    information = np.concatenate([top, np.concatenate([np.swapaxes(ab, -1, -2), bb], axis=-1)], axis=-2)
    return np.concatenate([of_alpha, of_eta @ x], axis=-1), information


def _filled(counts: Floats, prior: float) -> Floats:
    """Counts with `prior` answers added to each cell, distributed as all answers are."""
    share = counts.sum(axis=-2, keepdims=True) + _SMALL
    return np.asarray(counts + prior * share / share.sum(axis=-1, keepdims=True))


def clustered(counts: Floats, x: Floats, prior: float = PRIOR) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Log odds (..., cells), their covariance matrix by listeners, and whether the search ended.

    counts : (..., listeners, cells, grades); axes in front are experiments.
    x : (cells, p) columns without a constant.
    """
    whole, n = counts.sum(axis=-3), counts.shape[-3]
    beta, alpha, done = fit_counts(whole, x, prior)
    point, cuts, filled = np.concatenate([alpha, beta], axis=-1), alpha.shape[-1], _filled(whole, prior)
    _, information = _scored(filled, filled.sum(axis=-1), x, point, cuts)
    each = np.broadcast_to(point[..., None, :], (*counts.shape[:-2], point.shape[-1]))
    score, _ = _scored(counts, counts.sum(axis=-1), x, each, cuts)
    score = score - score.mean(axis=-2, keepdims=True)
    influence = np.linalg.solve(information[..., None, :, :], score[..., None])[..., cuts:, 0] @ x.T
    return beta @ x.T, n / (n - 1) * np.swapaxes(influence, -1, -2) @ influence, done


def ordinal_analysis(
    rows: Rows,
    factors: Sequence[str],
    confidence: float,
    levels: Mapping[str, Sequence[str]],
    random: Sequence[str] = (),
    ends: tuple[float, float] | None = None,
) -> OrdinalAnalysis | None:
    """Estimate and test odds of higher grades; the parameters are those of `models.linear_analysis`.

    None where no fixed factor varies, listeners are fewer than three, all answers are the same, or sounds are a random
    sample.
    """
    data = cells_of(rows, factors, levels, random)
    if data is None or data.sampled:
        return None
    grade = grades(data.value, ends)
    contrasts = strata.contrasts(data.cells, data.levels)
    if grade.max() < 1 or not contrasts.bases:
        return None
    n, k = len(data.who), int(grade.max()) + 1
    shape = (n, len(data.cells), k)
    flat = np.ravel_multi_index((data.listener, data.cell, grade), shape)
    counts = np.bincount(flat, minlength=math.prod(shape)).reshape(shape).astype(np.float64)
    eta, v, converged = clustered(counts, data.design(contrasts)[:, 1:])
    whole = counts.sum(axis=0)
    extreme = np.max(whole[:, [0, -1]], axis=1) == whole.sum(axis=1)
    terms, tests, left = [], [], []
    for effect, basis in contrasts.bases.items():
        if np.any(np.abs(basis[extreme]) > _SMALL):
            left.append(" : ".join(effect))
        else:
            f = strata.trace_test(eta @ basis, basis.T @ v @ basis, float(n - 1))
            tests.append(OddsTest(" : ".join(effect), float(f.statistic), float(f.df1), float(f.df2), float(f.p_value)))
        differences = contrasts.differences[effect]
        finite = ~np.any(np.abs(differences[:, extreme]) > _SMALL, axis=1)
        variances: Any = np.einsum("ij,jk,ik->i", differences, v, differences)
        one = strata.t_interval(differences @ eta, variances, np.full(len(differences), n - 1.0), confidence)
        adjusted = strata.holm(one.p_value)
        terms += [
            OddsTerm(
                name, effect, _odds(one.difference[i]), _odds(one.low[i]), _odds(one.high[i]), n - 1.0,
                float(one.p_value[i]), float(adjusted[i]),
            )
            for i, name in enumerate(contrasts.names[effect]) if finite[i]
        ]  # fmt: skip
    notes = [
        f"all answers to {', '.join(cell)} stand at one end of the scale" for cell in np.array(data.cells)[extreme]
    ]
    if left:
        notes.append(f"odds are therefore not stated of: {', '.join(left)}, where the difference is from such answers")
    return OrdinalAnalysis(k, n, tuple(terms), tuple(tests), bool(converged), tuple(notes))


def _odds(x: float) -> float:
    return math.exp(min(x, 700.0))


def grades(values: Floats, ends: tuple[float, float] | None) -> NDArray[np.int_]:
    """Grade of each value, from 0; more than `GRADES` values are grouped at their quantiles."""
    every = np.unique(values)
    if len(every) > GRADES:
        inside = values if ends is None else values[(values > ends[0]) & (values < ends[1])]
        cuts = np.unique(np.quantile(inside, np.linspace(0, 1, GRADES - 1), method="inverted_cdf"))[1:]
        low = np.unique(values[values <= ends[0]])[:1] if ends is not None else cuts[:0]
        high = np.unique(values[values >= ends[1]])[:1] if ends is not None else cuts[:0]
        every = np.concatenate([low, cuts, high])
    return np.asarray(np.unique(np.searchsorted(every, values), return_inverse=True)[1])
