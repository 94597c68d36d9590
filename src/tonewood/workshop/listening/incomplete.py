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
answered every cell all results are those of that module.

Sources: R. M. Bell & D. F. McCaffrey, Surv. Methodol. 28 (2002) 169-181; J. E. Pustejovsky & E. Tipton, J. Bus. Econ.
Stat. 36 (2018) 672-683 (CR2, degrees of freedom); E. Brunner, H. Dette & A. Munk, J. Am. Stat. Assoc. 92 (1997)
1494-1502 (F by the trace).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.workshop.listening.strata import Estimated, Tested, t_interval, trace_test

Array = NDArray[np.float64]
#: variance of the listeners' levels that the weights assume, in units of that of a cell mean
_LEVELS = 100.0
#: eigenvalue of I - H below which a listener alone decides a coefficient
_ALONE = 1e-9


class IncompleteFit:
    """Least squares fit of incomplete cell means, for any number of experiments at once.

    Parameters
    ----------
    y : (..., listeners, cells) means of the listeners' answers, NaN where one is missing.
    x : (cells, p) columns of the model, of full rank over the answers.
    """

    def __init__(self, y: Array, x: Array):
        there = ~np.isnan(y)
        count = there.sum(axis=-1)
        theta = 1 - 1 / np.sqrt(1 + _LEVELS * count)
        share = (theta / np.maximum(count, 1))[..., None]
        own = np.where(there, y, 0.0)
        own = np.where(there, own - share * own.sum(axis=-1, keepdims=True), 0.0)
        design: Any = there[..., None] * x
        design = there[..., None] * (design - share[..., None] * design.sum(axis=-2, keepdims=True))
        turned = np.swapaxes(design, -1, -2)
        self.x = x
        self.inverse = np.linalg.inv((turned @ design).sum(axis=-3))
        self.beta = np.einsum("...pq,...ncq,...nc->...p", self.inverse, design, own, optimize=True)
        left = own - (design @ self.beta[..., None, :, None])[..., 0]
        hat = design @ self.inverse[..., None, :, :] @ turned
        values, vectors = np.linalg.eigh(np.eye(len(x)) - hat)
        root = np.where(values > _ALONE, 1 / np.sqrt(np.maximum(values, _ALONE)), 0.0)
        corrected = (vectors * root[..., None, :]) @ (np.swapaxes(vectors, -1, -2) @ design)
        back = np.swapaxes(corrected, -1, -2)
        self.scores = (back @ left[..., None])[..., 0]
        self.squares, self.products = back @ corrected, back @ design

    def _moments(self, weights: Array) -> tuple[Array, Array]:
        """Degrees of freedom of the trace of V for K^T Q (..., q, p), and q_e."""
        d = weights[..., None, :, :] @ self.squares @ np.swapaxes(weights, -1, -2)[..., None, :, :]
        r = weights[..., None, :, :] @ self.products
        ruled = r @ self.inverse[..., None, :, :] @ np.swapaxes(r, -1, -2)
        total = self.inverse @ np.einsum("...nqa,...nqb->...ab", r, r, optimize=True)
        trace = np.trace(d - ruled, axis1=-2, axis2=-1).sum(axis=-1)
        square = np.sum(d * (d - 2 * ruled), axis=(-3, -2, -1)) + np.sum(
            total * np.swapaxes(total, -1, -2), axis=(-2, -1)
        )
        model = weights @ np.linalg.inv(self.inverse) @ np.swapaxes(weights, -1, -2)
        size = np.trace(model, axis1=-2, axis2=-1) ** 2 / np.sum(model**2, axis=(-2, -1))
        return trace**2 / np.maximum(square, 1e-300), size

    def tested(self, basis: Array) -> Tested:
        """Test an effect of orthonormal contrasts (cells, q) of the modelled cell means."""
        rows = basis.T @ self.x
        weights = rows @ self.inverse
        scores = self.scores @ np.swapaxes(weights, -1, -2)
        v = np.swapaxes(scores, -1, -2) @ scores
        whole, size = self._moments(weights)
        return trace_test(self.beta @ rows.T, v, np.maximum(whole / size, 1.0))

    def estimated(self, differences: Array, confidence: float) -> Estimated:
        """Estimate differences (rows, cells) of the modelled cell means, each with its own variance."""
        rows = differences @ self.x
        weights = rows @ self.inverse
        v = np.sum((self.scores @ np.swapaxes(weights, -1, -2)) ** 2, axis=-2)
        df = np.stack([self._moments(weights[..., i : i + 1, :])[0] for i in range(len(rows))], axis=-1)
        return t_interval(self.beta @ rows.T, v, np.maximum(df, 1.0), confidence)
