"""Linear mixed models by restricted maximum likelihood, with Satterthwaite's degrees of freedom.

    y = X beta + Z u + e,    u ~ N(0, s^2 Lambda Lambda^T),    e ~ N(0, s^2 I)

Lambda is block diagonal: one lower triangular matrix for each group of a random term, its entries theta. beta and s are
profiled out; theta minimizes the REML criterion of D. Bates et al., J. Stat. Softw. 67(1) (2015), equations 39-42. For
a contrast c with variance v = c C c^T, nu = 2 v^2 / (g A g^T), g the gradient of v in theta and s, A twice the inverse
of the criterion's second derivatives; for several contrasts A. Kuznetsova et al., J. Stat. Softw. 82(13) (2017).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: theta below which a variance is 0
_ZERO = 1e-4
#: bound of theta: standard deviations of a group in units of the residual's
_MOST = 1e3
#: slope of the criterion in theta, of a search that has converged
_FLAT = 1e-2


@dataclass(frozen=True)
class RandomTerm:
    """A random term: columns (answers, k) that each group has its own coefficients of, and the groups (answers,)."""

    columns: Array
    groups: NDArray[np.int_]


@dataclass(frozen=True)
class Fitted:
    """A fitted mixed model.

    Attributes
    ----------
    beta, covariance : fixed effects (p,) and their covariance matrix.
    covariances : of the coefficients of each random term (k, k).
    residual_sd : s.
    criterion : the REML criterion.
    singular : whether a variance is 0.
    converged : whether the search ended at a minimum.
    gradients, inverse : of the covariance matrix in (theta, s), and A; for degrees of freedom.
    """

    beta: Array
    covariance: Array
    covariances: tuple[Array, ...]
    residual_sd: float
    criterion: float
    singular: bool
    converged: bool
    gradients: Array
    inverse: Array

    def df(self, contrast: Array) -> float:
        """Satterthwaite's degrees of freedom of one contrast (p,)."""
        v = contrast @ self.covariance @ contrast
        g = np.einsum("i,kij,j->k", contrast, self.gradients, contrast)
        spread = float(g @ self.inverse @ g)
        return float(2 * v**2 / spread) if spread > 0 else np.inf

    def f_test(self, contrasts: Array) -> tuple[float, float]:
        """F of several contrasts (q, p), and the degrees of freedom of its denominator."""
        c = contrasts @ self.covariance @ contrasts.T
        values, vectors = np.linalg.eigh((c + c.T) / 2)
        if values[0] <= 1e-12 * values[-1]:
            return np.nan, np.nan
        turned = vectors.T @ contrasts
        f = float(np.mean((turned @ self.beta) ** 2 / values))
        dfs = np.array([self.df(row) for row in turned])
        if len(dfs) == 1:
            return f, float(dfs[0])
        e = float(np.sum(dfs[dfs > 2] / (dfs[dfs > 2] - 2))) if np.all(np.isfinite(dfs)) else float(len(dfs))
        return f, 2 * e / (e - len(dfs)) if e > len(dfs) else (np.inf if np.all(dfs > 2) else float(dfs.min()))


class _Criterion:
    """The REML criterion of a set of data."""

    def __init__(self, y: Array, x: Array, terms: Sequence[RandomTerm]):
        self.n, self.p = x.shape
        self.shapes = [(int(t.groups.max()) + 1, t.columns.shape[1]) for t in terms]
        blocks = []
        for term, (groups, k) in zip(terms, self.shapes, strict=True):
            z = np.zeros((self.n, groups, k))
            z[np.arange(self.n), term.groups] = term.columns
            blocks.append(z.reshape(self.n, groups * k))
        z = np.hstack(blocks)
        self.zz, self.zx, self.zy = z.T @ z, z.T @ x, z.T @ y
        self.xx, self.xy, self.yy = x.T @ x, x.T @ y, float(y @ y)
        self.start = np.concatenate([np.eye(k)[np.tril_indices(k)] for _, k in self.shapes])
        self.bounds = [(0.0 if i == j else -_MOST, _MOST) for _, k in self.shapes
                       for i, j in zip(*np.tril_indices(k), strict=True)]  # fmt: skip

    def factors(self, theta: Array) -> list[Array]:
        """Lower triangular matrix of each term."""
        found, at = [], 0
        for _, k in self.shapes:
            t = np.zeros((k, k))
            size = k * (k + 1) // 2
            t[np.tril_indices(k)] = theta[at : at + size]
            at += size
            found.append(t)
        return found

    def parts(self, theta: Array) -> tuple[float, float, Array, Array]:
        """Logarithms of the determinants, penalized sum of squares, beta and (R_X^T R_X)^-1."""
        from scipy import linalg

        spread = np.zeros_like(self.zz)
        at = 0
        for (groups, k), t in zip(self.shapes, self.factors(theta), strict=True):
            spread[at : at + groups * k, at : at + groups * k] = np.kron(np.eye(groups), t)
            at += groups * k
        root = linalg.cholesky(spread.T @ self.zz @ spread + np.eye(len(spread)), lower=True, check_finite=False)
        rzx = linalg.solve_triangular(root, spread.T @ self.zx, lower=True, check_finite=False)
        cu = linalg.solve_triangular(root, spread.T @ self.zy, lower=True, check_finite=False)
        information = self.xx - rzx.T @ rzx
        inverse: Array = np.asarray(np.linalg.inv(information))
        right = self.xy - rzx.T @ cu
        beta = inverse @ right
        squares = self.yy - float(cu @ cu) - float(beta @ right)
        logs = 2 * float(np.sum(np.log(np.diag(root)))) + float(np.linalg.slogdet(information)[1])
        return logs, squares, np.asarray(beta), inverse

    def profiled(self, theta: Array) -> float:
        logs, squares, _, _ = self.parts(theta)
        free = self.n - self.p
        return float(logs + free * (1 + float(np.log(2 * np.pi * max(squares, 1e-300) / free))))

    def whole(self, theta: Array, s: float) -> tuple[float, Array]:
        """Criterion of theta and s, and the covariance matrix of beta."""
        logs, squares, _, inverse = self.parts(theta)
        return logs + squares / s**2 + (self.n - self.p) * float(np.log(2 * np.pi * s**2)), s**2 * inverse


def fit(y: Array, x: Array, terms: Sequence[RandomTerm]) -> Fitted:
    """Fit a mixed model.

    Parameters
    ----------
    y : (answers,).
    x : (answers, p) columns of the fixed effects, of full rank.
    terms : the random terms.
    """
    from scipy.optimize import minimize

    scale = float(np.std(y)) or 1.0
    criterion = _Criterion((y - y.mean()) / scale, x, terms)
    options: Any = {"ftol": 1e-15, "gtol": 1e-7, "maxiter": 500}
    best = minimize(
        criterion.profiled, criterion.start, method="L-BFGS-B", jac="3-point", bounds=criterion.bounds, options=options
    )  # fmt: skip
    inside = np.array([b[0] != 0.0 or t > _ZERO for b, t in zip(criterion.bounds, best.x, strict=True)])
    slope = np.where(inside, best.jac, np.minimum(best.jac, 0.0))
    theta = np.where([b[0] == 0.0 for b in criterion.bounds] & (best.x < _ZERO), 0.0, best.x)
    _, squares, beta, inverse = criterion.parts(theta)
    s = float(np.sqrt(max(squares, 0.0) / (criterion.n - criterion.p)))
    on_edge = np.array([b[0] == 0.0 and t == 0 for b, t in zip(criterion.bounds, theta, strict=True)])
    gradients, a = _derivatives(criterion, theta, s, ~on_edge)
    shift = np.linalg.lstsq(x, np.full(len(y), y.mean()), rcond=None)[0]
    return Fitted(
        beta * scale + shift, s**2 * inverse * scale**2,
        tuple((s * scale) ** 2 * t @ t.T for t in criterion.factors(theta)), s * scale,
        criterion.profiled(theta) + 2 * (criterion.n - criterion.p) * float(np.log(scale)), bool(on_edge.any()),
        bool(np.max(np.abs(slope)) < _FLAT), gradients * scale**2, a,
    )  # fmt: skip


def _derivatives(criterion: _Criterion, theta: Array, s: float, free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Gradients of the covariance matrix in the free theta and s, and twice the inverse of the second derivatives."""
    places = np.flatnonzero(free)
    base = np.append(theta[places], s)
    steps = 1e-3 * np.maximum(np.abs(base), 0.05)

    def at(point: Array) -> tuple[float, Array]:
        whole = theta.copy()
        whole[places] = point[:-1]
        return criterion.whole(whole, float(point[-1]))

    k = len(base)
    units = np.diag(steps)
    up, down = [at(base + u) for u in units], [at(base - u) for u in units]
    gradients = np.array([(a[1] - b[1]) / (2 * h) for a, b, h in zip(up, down, steps, strict=True)])
    middle = at(base)[0]
    second: Any = np.zeros((k, k))
    for i in range(k):
        second[i, i] = (up[i][0] - 2 * middle + down[i][0]) / steps[i] ** 2
        for j in range(i):
            corners = [at(base + a * units[i] + b * units[j])[0] for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            second[i, j] = second[j, i] = (corners[0] - corners[1] - corners[2] + corners[3]) / (
                4 * steps[i] * steps[j]
            )
    return gradients, 2 * np.linalg.pinv(second, hermitian=True)
