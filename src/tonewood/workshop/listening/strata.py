"""Exact analysis of repeated measures: each effect is tested against the listeners' own differences in it.

Every listener answers every cell (a combination of levels), so an effect is a set of contrasts of the listener's own
cell means, and its test needs no model of the covariance between cells. With z (n, q) the contrasts of n listeners,
orthonormal over the cells, and V the estimated covariance matrix of their mean,

    F = |mean z|^2 / tr V,     df1 = (tr V)^2 / tr V^2,     df2 = (tr V)^2 / sum_k (tr V_k^2 / f_k)

V = V_1 = S / n, f_1 = n - 1 where sounds are fixed: the F of the sums of squares by strata, with the degrees of freedom
of Greenhouse and Geisser, df1 = q eps and df2 = (n - 1) df1. Their estimate of eps is too small in small samples (false
alarms of 3 % with 12 listeners and q = 4); with unbiased estimates of both traces, those of Huynh and Feldt as
corrected by Lecoutre,

    df1 = (n q eps - 2) / (n - 1 - q eps)     at most q,

which is used from n - 1 > q on. Both probabilities are reported. Where m sounds are a random sample, V = V_listeners +
V_sounds - V_both: Satterthwaite's quasi-F of two crossed samples. One difference has its own variance v and
t = mean / sqrt v on df2 degrees of freedom.

Sources: S. W. Greenhouse & S. Geisser, Psychometrika 24 (1959) 95-112; H. Huynh & L. S. Feldt, J. Educ. Stat. 1 (1976)
69-82; B. Lecoutre, J. Educ. Stat. 16 (1991) 371-372; F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114; H. H.
Clark, J. Verbal Learn. Verbal Behav. 12 (1973) 335-359.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: names of the factors of an effect: one for a main effect, two for an interaction
EffectName = tuple[str, ...]
#: covariance matrices (..., q, q) with their degrees of freedom
Parts = list[tuple[Array, Any]]


@dataclass(frozen=True)
class Contrasts:
    """Effects of a set of cells.

    Attributes
    ----------
    bases : effect -> orthonormal contrasts (cells, q), orthogonal to all other effects.
    differences : effect -> rows of contrasts (differences, cells): from the first level, over all cells; for an
        interaction differences of differences.
    names : effect -> name of each difference.
    without : interactions that are left out because cells are empty.
    """

    bases: Mapping[EffectName, Array]
    differences: Mapping[EffectName, Array]
    names: Mapping[EffectName, tuple[str, ...]]
    without: tuple[EffectName, ...] = ()


def contrasts(cells: Sequence[Sequence[str]], levels: Mapping[str, Sequence[str]]) -> Contrasts:
    """Contrasts of main effects and of interactions of two factors.

    Parameters
    ----------
    cells : level of each factor, in the order of `levels`, for each cell that is there.
    levels : factor -> its levels, the first being that of the reference.
    """
    where = {f: np.array([list(levels[f]).index(cell[i]) for cell in cells]) for i, f in enumerate(levels)}
    main: dict[EffectName, Array] = {(f,): coded(where[f], len(levels[f])) for f in levels}
    pairs: dict[EffectName, Array] = {}
    without: list[EffectName] = []
    for a, b in itertools.combinations(levels, 2):
        if len(set(zip(where[a], where[b], strict=True))) < len(levels[a]) * len(levels[b]):
            without.append((a, b))
        else:
            pairs[a, b] = np.einsum("ki,kj->kij", main[a,], main[b,]).reshape(len(cells), -1)
    columns = main | pairs
    bases: dict[EffectName, Array] = {}
    differences: dict[EffectName, Array] = {}
    names: dict[EffectName, tuple[str, ...]] = {}
    for effect, own in columns.items():
        others = np.hstack([np.ones((len(cells), 1)), *(x for e, x in columns.items() if e != effect)])
        free = own - others @ (np.linalg.pinv(others) @ own)
        u, s, _ = np.linalg.svd(free, full_matrices=False)
        if (rank := int(np.sum(s > 1e-9))) < own.shape[1]:
            without.append(effect)
            continue
        bases[effect] = u[:, :rank]
        coefficients = np.linalg.pinv(free)  # of the effect's columns, all others in the model
        rows: Any = steps(len(levels[effect[0]]))
        if len(effect) == 2:
            a, b = effect
            rows = np.kron(rows, steps(len(levels[b])))
            names[effect] = tuple(f"{a}={x} : {b}={y}" for x in levels[a][1:] for y in levels[b][1:])
        else:
            names[effect] = tuple(f"{effect[0]}={x}" for x in levels[effect[0]][1:])
        differences[effect] = rows @ coefficients
    return Contrasts(bases, differences, names, tuple(without))


def coded(where: NDArray[np.int_], n: int) -> Array:
    """Columns (len(where), n - 1) of a factor of n levels that sum to 0 over its levels."""
    return np.vstack([np.eye(n - 1), -np.ones((1, n - 1))])[where]


def steps(n: int) -> Array:
    """Differences (n - 1, n - 1) of the codes of each level and of the first."""
    codes = coded(np.arange(n), n)
    return np.asarray(codes[1:] - codes[0])


@dataclass(frozen=True)
class Tested:
    """Tests of effects in many experiments at once: arrays of one shape.

    `epsilon` and `p_greenhouse` are of Greenhouse and Geisser, without the correction for small samples.
    """

    statistic: Any
    df1: Any
    df2: Any
    p_value: Any
    epsilon: Any
    p_greenhouse: Any


@dataclass(frozen=True)
class Estimated:
    """Differences with their intervals and t tests in many experiments at once: arrays of one shape."""

    difference: Any
    low: Any
    high: Any
    df: Any
    p_value: Any


def tested(y: Array, basis: Array, *, sounds: bool) -> Tested:
    """Test an effect.

    Parameters
    ----------
    y : (..., listeners, cells) means of the listeners' answers, or (..., listeners, sounds, cells); axes in front are
        experiments.
    basis : (cells, q) orthonormal contrasts.
    sounds : whether `y` has the axis of sounds, a random sample.
    """
    parts, mean = _parts(y @ basis, sounds)
    if not sounds:
        return trace_test(mean, parts[0][0], float(parts[0][1]))
    return quasi_test(parts, mean)


def quasi_test(parts: Parts, mean: Array) -> Tested:
    """Satterthwaite's quasi-F of contrasts (..., q); `parts` are covariance matrices with their degrees of freedom."""
    from scipy.special import fdtrc

    total, trace = _total(parts)
    q = mean.shape[-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        square = np.sum(mean**2, axis=-1)
        statistic = np.where(trace > 0, square / trace, np.where(square > 0, np.inf, 0.0))
        df1 = np.where(trace > 0, trace**2 / np.sum(total**2, axis=(-2, -1)), q)
        spread = sum(np.sum(v**2, axis=(-2, -1)) / f for v, f in parts)
        df2 = np.where(trace > 0, trace**2 / spread, 1.0)
    df1, df2 = np.clip(df1, 1.0, q), np.maximum(df2, 1.0)
    p = fdtrc(df1, df2, statistic)
    return Tested(statistic, df1, df2, p, df1 / q, p)


def trace_test(mean: Array, v: Array, f: Any) -> Tested:
    """F of contrasts (..., q) by the trace of their covariance matrix (..., q, q), which has f degrees of freedom."""
    from scipy.special import fdtrc

    q = mean.shape[-1]
    trace = np.trace(v, axis1=-2, axis2=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        square = np.sum(mean**2, axis=-1)
        statistic = np.where(trace > 0, square / trace, np.where(square > 0, np.inf, 0.0))
        df1 = np.clip(np.where(trace > 0, trace**2 / np.sum(v**2, axis=(-2, -1)), q), 1.0, q)
        epsilon, greenhouse = df1 / q, fdtrc(df1, f * df1, statistic)
        if q > 1:
            df1 = np.where(f > q, np.clip(((f + 1) * df1 - 2) / (f - df1), 1.0, q), df1)
    return Tested(statistic, df1, f * df1, fdtrc(df1, f * df1, statistic), epsilon, greenhouse)


def estimated(y: Array, rows: Array, confidence: float, *, sounds: bool) -> Estimated:
    """Estimate differences (rows, cells), each with its own variance; `y` and `sounds` as for `tested`."""
    z = (y @ rows.T)[..., None]
    z = np.moveaxis(z, -2, 0)  # differences first, each with one contrast
    parts, mean = _parts(z, sounds)
    one = quasi_interval(parts, mean, confidence)
    return Estimated(*(np.moveaxis(x, 0, -1) for x in astuple(one)))


def quasi_interval(parts: Parts, mean: Array, confidence: float) -> Estimated:
    """Intervals of differences (..., 1), of variances that are sums of parts (..., 1, 1)."""
    _, v = _total(parts)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = sum(np.sum(x**2, axis=(-2, -1)) / f for x, f in parts)
        df = np.maximum(np.where(v > 0, v**2 / spread, 1.0), 1.0)
    return t_interval(mean[..., 0], v, df, confidence)


def t_interval(value: Array, v: Array, df: Array, confidence: float) -> Estimated:
    """Intervals and t tests of differences (..., rows) with variances v and their degrees of freedom."""
    from scipy.special import stdtr, stdtrit

    with np.errstate(invalid="ignore", divide="ignore"):
        t = np.where(v > 0, np.abs(value) / np.sqrt(v), np.where(np.abs(value) > 0, np.inf, 0.0))
    half = stdtrit(df, (1 + confidence) / 2) * np.sqrt(v)
    return Estimated(value, value - half, value + half, df, 2 * stdtr(df, -t))


def _parts(z: Array, sounds: bool) -> tuple[Parts, Array]:
    """Covariance matrices (..., q, q) of the mean with their degrees of freedom and signs, and the mean (..., q)."""
    if not sounds:
        n = z.shape[-2]
        mean = z.mean(axis=-2)
        d = z - mean[..., None, :]
        return [(np.einsum("...ni,...nj->...ij", d, d) / (n * (n - 1)), n - 1)], mean
    n, m = z.shape[-3:-1]
    mean = z.mean(axis=(-3, -2))
    own, each = z.mean(axis=-2) - mean[..., None, :], z.mean(axis=-3) - mean[..., None, :]
    rest = z - own[..., :, None, :] - each[..., None, :, :] - mean[..., None, None, :]
    both = (n - 1) * (m - 1)
    return [
        (np.einsum("...ni,...nj->...ij", own, own) / (n * (n - 1)), n - 1),
        (np.einsum("...ni,...nj->...ij", each, each) / (m * (m - 1)), m - 1),
        (np.einsum("...nmi,...nmj->...ij", rest, rest) / (n * m * both), both),
    ], mean


def _total(parts: Parts) -> tuple[Array, Array]:
    """V and its trace; with two samples never less than that of either alone, which the true one exceeds."""
    traces = [np.trace(v, axis1=-2, axis2=-1) for v, _ in parts]
    if len(parts) == 1:
        return parts[0][0], traces[0]
    total, trace = parts[0][0] + parts[1][0] - parts[2][0], traces[0] + traces[1] - traces[2]
    for (v, _), own in zip(parts[:2], traces[:2], strict=True):
        less = trace < own
        total, trace = np.where(less[..., None, None], v, total), np.where(less, own, trace)
    return total, trace


def holm(p: Array) -> Array:
    """Adjust probabilities (..., k) of k tests for each other (S. Holm, Scand. J. Stat. 6 (1979) 65-70)."""
    if not p.size:  # too few listeners for any test
        return p
    flat = np.reshape(p, (-1, p.shape[-1]))
    rows, k = np.arange(len(flat))[:, None], flat.shape[1]
    order = np.argsort(flat, axis=1, kind="stable")
    raised = np.minimum(flat[rows, order] * np.arange(k, 0, -1), 1.0)
    adjusted = np.empty_like(flat)
    adjusted[rows, order] = np.maximum.accumulate(raised, axis=1)
    return np.asarray(adjusted.reshape(p.shape))
