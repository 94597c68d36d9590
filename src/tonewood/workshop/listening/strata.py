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

which is used from n - 1 > q on. Both probabilities are reported. One difference has its own variance v and
t = mean / sqrt v on df2 degrees of freedom.

Where m sounds are a random sample, V = A + B - C of listeners, of sounds and of both, and never less than A or B: the
quasi-F of two crossed samples. Satterthwaite's degrees of freedom would have too many false alarms where A and B are
alike, because they grow with the error of both; and far too few where listeners or sounds hardly differ, because V is
then too large by its bound. Instead, as Cochran does,

    1 / df2 = (tr A / f_A + tr B / f_B) / (tr A + tr B),     f_A = (n - 1) q eps_A

(each eps after Lecoutre), and V is divided by the mean that it has in experiments with such variances, over their own.
With A' = A f_A / (f_A - 2) but at least C (an A that is small by chance makes V small, too), B' likewise, and x_f a
chi-square over its f degrees of freedom,

    k = (A' + B' - E min(C, A' x_fA, B' x_fB)) / (A' + B' - C)

(not with fewer than six listeners or sounds, whose variances are known too badly for it).

Means and variances that are rounding errors of the answers count as 0. Where all listeners have one and the same
difference, t and F have no meaning, and p = 2 (1/2)^n is that of the sign test.

Sources: S. W. Greenhouse & S. Geisser, Psychometrika 24 (1959) 95-112; H. Huynh & L. S. Feldt, J. Educ. Stat. 1 (1976)
69-82; B. Lecoutre, J. Educ. Stat. 16 (1991) 371-372; F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114; H. H.
Clark, J. Verbal Learn. Verbal Behav. 12 (1973) 335-359 (quasi-F); W. G. Cochran, Biometrics 20 (1964) 191-195.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats

#: names of the factors of an effect: one for a main effect, two for an interaction
EffectName = tuple[str, ...]
#: covariance matrices (..., q, q) with their degrees of freedom
Parts = list[tuple[Floats, Any]]
#: degrees of freedom of listeners or sounds, of five and of six with some answers missing
_FEW = 4.5
#: share of the largest answer below which means of contrasts are rounding errors
_ROUNDING = 1e-10
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True)
class Contrasts:
    """Effects of a set of cells.

    bases : effect -> orthonormal contrasts (cells, q), orthogonal to all other effects.
    differences : effect -> rows of contrasts (differences, cells): from the first level, over all cells; for an
        interaction differences of differences.
    without : interactions that are left out because cells are empty.
    """

    bases: Mapping[EffectName, Floats]
    differences: Mapping[EffectName, Floats]
    names: Mapping[EffectName, tuple[str, ...]]
    without: tuple[EffectName, ...] = ()


def contrasts(cells: Sequence[Sequence[str]], levels: Mapping[str, Sequence[str]]) -> Contrasts:
    """Contrasts of main effects and of interactions of two factors.

    cells : level of each factor, in the order of `levels`, for each cell that is there.
    levels : factor -> its levels, the first being that of the reference.
    """
    where = {f: np.array([list(levels[f]).index(cell[i]) for cell in cells]) for i, f in enumerate(levels)}
    main: dict[EffectName, Floats] = {(f,): coded(where[f], len(levels[f])) for f in levels}
    pairs: dict[EffectName, Floats] = {}
    without: list[EffectName] = []
    for a, b in itertools.combinations(levels, 2):
        if len(set(zip(where[a], where[b], strict=True))) < len(levels[a]) * len(levels[b]):
            without.append((a, b))
        else:
            pairs[a, b] = np.einsum("ki,kj->kij", main[a,], main[b,]).reshape(len(cells), -1)
    columns = main | pairs
    bases: dict[EffectName, Floats] = {}
    differences: dict[EffectName, Floats] = {}
    names: dict[EffectName, tuple[str, ...]] = {}
    for effect, block in columns.items():
        others = np.hstack([np.ones((len(cells), 1)), *(x for e, x in columns.items() if e != effect)])
        free = block - others @ (np.linalg.pinv(others) @ block)
        u, s, _ = np.linalg.svd(free, full_matrices=False)
        if (rank := int(np.sum(s > 1e-9))) < block.shape[1]:
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


def coded(where: NDArray[np.int_], n: int) -> Floats:
    """Columns (len(where), n - 1) of a factor of n levels that sum to 0 over its levels."""
    return np.vstack([np.eye(n - 1), -np.ones((1, n - 1))])[where]


def steps(n: int) -> Floats:
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


def tested(y: Floats, basis: Floats, *, sounds: bool) -> Tested:
    """Test an effect.

    y : (..., listeners, cells) means of the listeners' answers, or (..., listeners, sounds, cells); axes in front are
        experiments.
    basis : (cells, q) orthonormal contrasts.
    sounds : whether `y` has the axis of sounds, a random sample.
    """
    parts, mean = unrounded(*_parts(y @ basis, sounds), largest(y, 2 + sounds))
    if not sounds:
        return trace_test(mean, parts[0][0], float(parts[0][1]))
    return quasi_test(parts, mean)


def quasi_test(parts: Parts, mean: Floats) -> Tested:
    """F of contrasts (..., q) over two crossed samples; `parts` are covariance matrices with degrees of freedom."""
    from scipy.special import fdtrc

    trace, df1, df2 = _joined(parts)
    statistic = _ratio(np.sum(mean**2, axis=-1), trace)
    p = np.where(np.isinf(statistic), _of_signs(df2), fdtrc(df1, df2, statistic))
    return Tested(statistic, df1, df2, p, df1 / mean.shape[-1], p)


def trace_test(mean: Floats, v: Floats, f: Any) -> Tested:
    """F of contrasts (..., q) by the trace of their covariance matrix (..., q, q), which has f degrees of freedom."""
    from scipy.special import fdtrc

    statistic = _ratio(np.sum(mean**2, axis=-1), np.trace(v, axis1=-2, axis2=-1))
    df1, plain = _dimensions(v, f)
    p, greenhouse = (np.where(np.isinf(statistic), _of_signs(f), fdtrc(x, f * x, statistic)) for x in (df1, plain))
    return Tested(statistic, df1, f * df1, p, plain / mean.shape[-1], greenhouse)


def _ratio(size: Floats, error: Floats) -> Floats:
    """A statistic: inf for a size without an error, 0 for neither."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(error > 0, size / error, np.where(size > 0, np.inf, 0.0)))


def _dimensions(v: Floats, f: Any) -> tuple[Floats, Floats]:
    """Lecoutre's, and Greenhouse and Geisser's, q eps of matrices (..., q, q) with f degrees of freedom."""
    q = v.shape[-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        trace, square = np.trace(v, axis1=-2, axis2=-1), np.sum(v**2, axis=(-2, -1))
        plain = np.clip(np.where(trace > 0, trace**2 / square, q), 1.0, q)
        if q == 1:
            return plain, plain
        return np.where(f > q, np.clip(((f + 1) * plain - 2) / (f - plain), 1.0, q), plain), plain


def estimated(y: Floats, rows: Floats, confidence: float, *, sounds: bool) -> Estimated:
    """Estimate differences (rows, cells), each with its own variance; `y` and `sounds` as for `tested`."""
    z = (y @ rows.T)[..., None]
    z = np.moveaxis(z, -2, 0)  # differences first, each with one contrast
    parts, mean = unrounded(*_parts(z, sounds), largest(y, 2 + sounds))
    if sounds:
        one = quasi_interval(parts, mean, confidence)
    else:
        v = parts[0][0][..., 0, 0]
        one = t_interval(mean[..., 0], v, np.full(v.shape, float(parts[0][1])), confidence)
    return Estimated(*(np.moveaxis(x, 0, -1) for x in astuple(one)))


def quasi_interval(parts: Parts, mean: Floats, confidence: float) -> Estimated:
    """Intervals of differences (..., 1) over two crossed samples, of `parts` (..., 1, 1)."""
    v, _, df = _joined(parts)
    return t_interval(mean[..., 0], v, df, confidence)


def t_interval(value: Floats, v: Floats, df: Floats, confidence: float) -> Estimated:
    """Intervals and t tests of differences (..., rows) with variances v and their degrees of freedom."""
    from scipy.special import stdtr, stdtrit

    t = _ratio(np.abs(value), np.sqrt(np.maximum(v, 0.0)))
    half = stdtrit(df, (1 + confidence) / 2) * np.sqrt(np.maximum(v, 0.0))
    p = np.where(np.isinf(t), _of_signs(df), 2 * stdtr(df, -t))
    return Estimated(value, value - half, value + half, df, p)


def _of_signs(f: Any) -> Any:
    """Probability that f + 1 listeners without a difference have one of the same sign."""
    return np.minimum(2 * 0.5 ** (np.asarray(f) + 1), 1.0)


def largest(y: Floats, axes: int) -> Floats:
    """Largest absolute answer over the last `axes` axes of y, in which some may be NaN."""
    return np.asarray(np.max(np.abs(y), axis=tuple(range(-axes, 0)), where=~np.isnan(y), initial=0.0))


def unrounded(parts: Parts, mean: Floats, scale: Floats) -> tuple[Parts, Floats]:
    """Covariance matrices (..., q, q) and means (..., q) with 0 for rounding errors of answers of a `scale` (...)."""
    least = (_ROUNDING * scale)[..., None]

    def kept(v: Floats) -> Floats:
        small = np.trace(v, axis1=-2, axis2=-1) <= least[..., 0] ** 2
        return np.where(small[..., None, None], 0.0, v) if np.any(small) else v

    return [(kept(v), f) for v, f in parts], np.where(np.abs(mean) <= least, 0.0, mean)


def _parts(z: Floats, sounds: bool) -> tuple[Parts, Floats]:
    """Covariance matrices (..., q, q) of the mean with their degrees of freedom and signs, and the mean (..., q)."""
    if not sounds:
        n = z.shape[-2]
        mean = z.mean(axis=-2)
        d = z - mean[..., None, :]
        return [(np.einsum("...ni,...nj->...ij", d, d) / (n * (n - 1)), n - 1)], mean
    n, m = z.shape[-3:-1]
    mean = z.mean(axis=(-3, -2))
    listeners, each = z.mean(axis=-2) - mean[..., None, :], z.mean(axis=-3) - mean[..., None, :]
    rest = z - listeners[..., :, None, :] - each[..., None, :, :] - mean[..., None, None, :]
    both = (n - 1) * (m - 1)
    return [
        (np.einsum("...ni,...nj->...ij", listeners, listeners) / (n * (n - 1)), n - 1),
        (np.einsum("...ni,...nj->...ij", each, each) / (m * (m - 1)), m - 1),
        (np.einsum("...nmi,...nmj->...ij", rest, rest) / (n * m * both), both),
    ], mean


def _joined(parts: Parts) -> tuple[Floats, Floats, Floats]:
    """Trace of V over k, and both degrees of freedom, of two crossed samples; see the module."""
    a, b, c = (np.maximum(np.trace(v, axis1=-2, axis2=-1), 0.0) for v, _ in parts)
    one, two = (f * _dimensions(v, f)[0] for v, f in parts[:2])
    least = np.minimum(np.minimum(a, b), c)
    with np.errstate(invalid="ignore", divide="ignore"):
        df2 = np.where(a + b > 0, (a + b) / (a / one + b / two), 1.0)
        each = np.where(a + b > 0, (a + b) / (a / parts[0][1] + b / parts[1][1]), 1.0)
        high, other = (np.maximum(x * f / np.maximum(f - 2, 1), c) for x, f in ((a, one), (b, two)))
        k = (high + other - _least(c, high, one, other, two)) / (high + other - c)
    few = np.minimum(parts[0][1], parts[1][1]) < _FEW
    total = parts[0][0] + parts[1][0] - parts[2][0]
    for (v, _), bound in zip(parts[:2], (b <= least, a <= least), strict=True):
        total = np.where((bound & (c > least))[..., None, None], v, total)
    trace = (a + b - least) / np.where(few | ~(k > 0), 1.0, k)
    return trace, _dimensions(total, each)[0], np.maximum(df2, 1.0)


def _least(c: Floats, a: Floats, fa: Any, b: Floats, fb: Any) -> Floats:
    """E min(c, a x_fa, b x_fb): the integral from 0 to c of the probability that both are larger."""
    from scipy.special import gammaincc

    x = c[..., None] * (_NODES + 1) / 2
    fa, fb = np.asarray(fa)[..., None] / 2, np.asarray(fb)[..., None] / 2
    both = gammaincc(fa, fa * x / a[..., None]) * gammaincc(fb, fb * x / b[..., None])
    return np.asarray(c * (both @ _WEIGHTS) / 2)


def holm(p: Floats) -> Floats:
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
