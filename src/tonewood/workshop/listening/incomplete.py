"""Analysis of repeated measures with missing answers: effects tested against the listeners' own differences in them.

The means of the cells that listener i answered, y_i, are modelled as X_i beta and fitted by least squares after a share
theta_i of their mean is taken off each,

    theta_i = 1 - 1 / sqrt(1 + 100 k_i),     k_i cells answered,

so that comparisons within a listener count, and comparisons between listeners only where nothing else tells. This is
generalized least squares for a variance of the listeners' levels that is 100 times that of a cell mean. The covariance
matrix of K^T beta needs no model of the listeners' own differences: it is the sum of squares of the listeners' scores,
each corrected for the fit's own pull (CR2),

    V = sum_i s_i s_i^T,     s_i = K^T Q X_i^T (I - X_i Q X_i^T)^(-1/2) e_i,     Q = (sum_i X_i^T X_i)^-1

with residuals e_i. Its degrees of freedom f are those of Satterthwaite under equal variances: with M the covariance
matrix of all s_i, f = (tr M)^2 / tr M^2 for one contrast, and that over q_e = (tr K^T Q K)^2 / tr (K^T Q K)^2 for
several. A difference has t = K^T beta / sqrt V on f degrees of freedom; an effect F = |K^T beta|^2 / tr V, with the
degrees of freedom of `tonewood.workshop.listening.strata`, f in the place of listeners - 1. Where every listener
answered every cell all results are those of that module. A contrast that cannot be estimated without one of the
listeners has no variance that could be known: f and all that follows from it are NaN.

Sources: R. M. Bell & D. F. McCaffrey, Surv. Methodol. 28 (2002) 169-181; J. E. Pustejovsky & E. Tipton, J. Bus. Econ.
Stat. 36 (2018) 672-683 (CR2, degrees of freedom); E. Brunner, H. Dette & A. Munk, J. Am. Stat. Assoc. 92 (1997)
1494-1502 (F by the trace).
"""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats
from tonewood.workshop.listening.strata import (
    Estimated,
    Parts,
    Tested,
    largest,
    quasi_interval,
    quasi_test,
    t_interval,
    trace_test,
    unrounded,
)

#: variance of the listeners' levels that the weights assume, in units of that of a cell mean
_LEVELS = 100.0
#: eigenvalue of I - H below which a listener alone decides a coefficient
_ALONE = 1e-9


class Clusters:
    """Corrected scores of clusters, and the degrees of freedom of the covariance matrices that they give.

    With R = Q^(1/2) the correction is (I - X_i Q X_i^T)^(-1/2) X_i = X_i R (I - R X_i^T X_i R)^(-1/2) R^-1, so that
    products of columns are all that is needed of a cluster.

    products : (..., clusters, p, p), X_i^T X_i.
    moments : (..., clusters, p), X_i^T e_i.
    inverse : (..., p, p), Q.
    """

    def __init__(self, products: Floats, moments: Floats, inverse: Floats):
        size, axes = np.linalg.eigh(inverse)
        size = np.maximum(size, 1e-14 * np.abs(size).max(axis=-1, keepdims=True))  # rounding, if a cell is nearly empty
        back = np.swapaxes(axes, -1, -2)
        root = ((axes * np.sqrt(size)[..., None, :]) @ back)[..., None, :, :]
        unroot = ((axes / np.sqrt(size)[..., None, :]) @ back)[..., None, :, :]
        values, vectors = np.linalg.eigh(np.eye(inverse.shape[-1]) - root @ products @ root)
        scale = np.where(values > _ALONE, 1 / np.sqrt(np.maximum(values, _ALONE)), 0.0)
        turned = unroot @ (vectors * scale[..., None, :]) @ np.swapaxes(vectors, -1, -2) @ root
        self.inverse = inverse
        self.scores = (turned @ moments[..., None])[..., 0]
        self.products = turned @ products
        self.squares = self.products @ np.swapaxes(turned, -1, -2)
        self._root, self._alone = root[..., 0, :, :], vectors * (values <= _ALONE)[..., None, :]

    def covariance(self, rows: Floats) -> tuple[Floats, Floats]:
        """Covariance matrix V (..., q, q) of K^T beta for K^T (q, p), and its degrees of freedom f."""
        weights = rows @ self.inverse
        scores = self.scores @ np.swapaxes(weights, -1, -2)
        d = weights[..., None, :, :] @ self.squares @ np.swapaxes(weights, -1, -2)[..., None, :, :]
        r = weights[..., None, :, :] @ self.products
        ruled = r @ self.inverse[..., None, :, :] @ np.swapaxes(r, -1, -2)
        total = self.inverse @ np.einsum("...nqa,...nqb->...ab", r, r, optimize=True)
        trace = np.trace(d - ruled, axis1=-2, axis2=-1).sum(axis=-1)
        square = np.sum(d * (d - 2 * ruled), axis=(-3, -2, -1)) + np.sum(
            total * np.swapaxes(total, -1, -2), axis=(-2, -1)
        )
        model = weights @ np.swapaxes(rows, -1, -2)
        size = np.trace(model, axis1=-2, axis2=-1) ** 2 / np.sum(model**2, axis=(-2, -1))
        f = np.maximum(trace**2 / np.maximum(square, 1e-300) / size, 1.0)
        if np.any(self._alone):
            whole = rows @ self._root
            part = np.sum((whole[..., None, :, :] @ self._alone) ** 2, axis=-1)
            alone = part > 1e-6 * np.sum(whole**2, axis=-1)[..., None, :]
            f = np.where(np.any(alone, axis=(-2, -1)), np.nan, f)
        return np.swapaxes(scores, -1, -2) @ scores, f


class IncompleteFit:
    """Least squares fit of incomplete cell means, for any number of experiments at once.

    y : (..., listeners, cells) means of the listeners' answers, NaN where one is missing.
    x : (cells, p) columns of the model, of full rank over the answers.
    """

    def __init__(self, y: Floats, x: Floats):
        there = ~np.isnan(y)
        count = there.sum(axis=-1)
        theta = 1 - 1 / np.sqrt(1 + _LEVELS * count)
        share = (theta / np.maximum(count, 1))[..., None]
        centred = np.where(there, y, 0.0)
        centred = np.where(there, centred - share * centred.sum(axis=-1, keepdims=True), 0.0)
        design: Any = there[..., None] * x
        design = there[..., None] * (design - share[..., None] * design.sum(axis=-2, keepdims=True))
        inverse = np.linalg.inv((np.swapaxes(design, -1, -2) @ design).sum(axis=-3))
        self.x, self.scale = x, largest(y, 2)
        self.beta = np.einsum("...pq,...ncq,...nc->...p", inverse, design, centred, optimize=True)
        residuals = centred - (design @ self.beta[..., None, :, None])[..., 0]
        turned = np.swapaxes(design, -1, -2)
        self.clusters = Clusters(turned @ design, (turned @ residuals[..., None])[..., 0], inverse)

    def tested(self, basis: Floats) -> Tested:
        """Test an effect of orthonormal contrasts (cells, q) of the modelled cell means."""
        rows = basis.T @ self.x
        ((v, f),), mean = unrounded([self.clusters.covariance(rows)], self.beta @ rows.T, self.scale)
        return trace_test(mean, v, f)

    def estimated(self, differences: Floats, confidence: float) -> Estimated:
        """Estimate differences (rows, cells) of the modelled cell means, each with its own variance."""
        rows = differences @ self.x
        each = [unrounded([self.clusters.covariance(row[None])], self.beta @ row[:, None], self.scale) for row in rows]
        v, df, mean = (
            np.stack(x, axis=-1)
            for x in zip(*((v[..., 0, 0], f, mean[..., 0]) for ((v, f),), mean in each), strict=True)
        )
        return t_interval(mean, v, df, confidence)


class CrossedFit:
    """The same where sounds are a random sample, too: levels of listeners and of sounds are taken off.

    With A, B and D the covariance matrices by clusters of n listeners, of m sounds and of their N pairs,

        C = (D - a A - b B) / (1 - a - b),     a = (n - 1) / (N - 1),     b = (m - 1) / (N - 1),     V = A + B - C.

    C is that of answers within a pair: where no answer is missing V is that of the quasi-F. With fewer than n + m pairs
    C is not known, and V = A + B, which is too large.

    y : (..., listeners, sounds, cells) means, NaN where one is missing; axes in front are experiments.
    x : (cells, p) columns of the model.
    """

    def __init__(self, y: Floats, x: Floats):
        there = ~np.isnan(y)
        columns: Any = np.broadcast_to(x, (*y.shape, x.shape[1]))
        data = there[..., None] * np.concatenate([columns, np.where(there, y, 0.0)[..., None]], axis=-1)
        left = there[..., None] * (data - _levels(there, data))
        design = left[..., :-1]
        turned = np.einsum("...nmci,...nmcj->...ij", design, data, optimize=True)
        inverse = np.linalg.inv(turned[..., :-1])
        self.x, self.beta, self.scale = x, (inverse @ turned[..., -1:])[..., 0], largest(y, 3)
        moments = design * (left[..., -1] - (design @ self.beta[..., None, None, :, None])[..., 0])[..., None]
        of_pairs = np.swapaxes(design, -1, -2) @ design, moments.sum(axis=-2)
        flat = [part.reshape(*y.shape[:-3], -1, *part.shape[y.ndim - 1 :]) for part in of_pairs]
        first = y.ndim - 3
        parts = [[part.sum(axis=first + 1) for part in of_pairs], [part.sum(axis=first) for part in of_pairs], flat]
        self.clusters = [Clusters(products, sums, inverse) for products, sums in parts]
        pairs: Any = there.any(axis=-1)
        self.counts = tuple(
            x.sum(axis=-1) for x in (pairs.any(axis=-1), pairs.any(axis=-2), pairs.reshape(*y.shape[:-3], -1))
        )

    def _parts(self, rows: Floats) -> Parts:
        (a, fa), (b, fb), (d, _) = (one.covariance(rows) for one in self.clusters)
        n, m, pairs = self.counts
        enough = pairs >= n + m
        of_a, of_b = (n - 1) / (pairs - 1), (m - 1) / (pairs - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            c = (d - of_a[..., None, None] * a - of_b[..., None, None] * b) / (1 - of_a - of_b)[..., None, None]
        c = np.where(enough[..., None, None], c, 0.0)
        return [(a, fa), (b, fb), (c, np.maximum(pairs - n - m + 1, 1))]

    def tested(self, basis: Floats) -> Tested:
        """Test an effect of orthonormal contrasts (cells, q) of the modelled cell means."""
        rows = basis.T @ self.x
        return quasi_test(*unrounded(self._parts(rows), self.beta @ rows.T, self.scale))

    def estimated(self, differences: Floats, confidence: float) -> Estimated:
        """Estimate differences (rows, cells) of the modelled cell means, each with its own variance."""
        each = [
            quasi_interval(*unrounded(self._parts(row[None]), self.beta @ row[:, None], self.scale), confidence)
            for row in differences @ self.x
        ]
        return Estimated(*(np.stack(x, axis=-1) for x in zip(*map(astuple, each), strict=True)))


def _levels(there: NDArray[np.bool_], data: Floats) -> Floats:
    """Levels of listeners and of sounds in columns (..., listeners, sounds, cells, columns), as predictions."""
    count = there.sum(axis=-1).astype(np.float64)
    n, m = count.shape[-2:]
    normal = np.zeros((*count.shape[:-2], n + m, n + m))
    at, also = np.arange(n), n + np.arange(m)
    normal[..., at, at], normal[..., also, also] = count.sum(axis=-1), count.sum(axis=-2)
    normal[..., :n, n:], normal[..., n:, :n] = count, np.swapaxes(count, -1, -2)
    sums = np.concatenate([data.sum(axis=(-3, -2)), data.sum(axis=(-4, -2))], axis=-2)
    solution = np.linalg.solve(normal + np.eye(n + m) / _LEVELS, sums)
    return np.asarray(solution[..., :n, None, None, :] + solution[..., None, n:, None, :])
