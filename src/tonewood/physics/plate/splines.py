"""Uniform tensor-product B-splines on a grid of square cells: the functions in which displacement is sought.

A function of degree p spans p + 1 cells and has p - 1 continuous derivatives, so that the bending energy of a Kirchhoff
plate exists for p >= 2. The grid covers a drawing's outline; the outline itself only limits the integrals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tonewood.support.arrays import Floats, Indices

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

#: orders of the derivatives along x and y
Order = tuple[int, int]


@cache
def _pieces(degree: int, order: int) -> Floats:
    """(p + 1, p + 1) a derivative on one cell, of width 1: row k, powers of t, is of the k-th function alive there.

    De Boor's recursion, N_q = ((t + q - k) N_{q-1, k-1} + (k + 1 - t) N_{q-1, k}) / q, from the piecewise constant one.
    """
    rows = np.zeros((degree + 1, degree + 1))
    rows[0, 0] = 1.0
    for q in range(1, degree + 1):
        times_t = np.zeros_like(rows)
        times_t[:, 1:] = rows[:, :-1]
        raised = np.zeros_like(rows)
        for k in range(q):
            raised[k + 1] += ((q - k - 1) * rows[k] + times_t[k]) / q
            raised[k] += ((k + 1) * rows[k] - times_t[k]) / q
        rows = raised
    for _ in range(order):
        rows = np.hstack([rows[:, 1:] * np.arange(1, degree + 1), np.zeros((degree + 1, 1))])
    return rows


@dataclass(frozen=True, eq=False)
class SplineGrid:
    """Functions of degree p on n_x by n_y cells.

    low : (2,) m, corner of the first cell.
    size : (2,) m, of a cell.
    cells : (2,) number of cells along x and y.
    degree : p of the functions.
    """

    low: Floats
    size: Floats
    cells: Indices
    degree: int

    @classmethod
    def over(cls, points: Floats, size: float, degree: int = 4) -> SplineGrid:
        """Cover the box of some points (n, 2) with cells of about `size` m."""
        low, high = points.min(axis=0), points.max(axis=0)
        cells = np.maximum(1, np.round((high - low) / size)).astype(np.intp)
        return cls(low, (high - low) / cells, cells, degree)

    @property
    def count(self) -> int:
        """Number of functions, (n_x + p) (n_y + p)."""
        return int(np.prod(self.cells + self.degree))

    @property
    def alive(self) -> int:
        """Functions that do not vanish on a cell, (p + 1)^2."""
        return (self.degree + 1) ** 2

    @property
    def places(self) -> Floats:
        """(count,) position of each function along the side with more cells, in cells."""
        return np.asarray(np.indices(tuple(self.cells + self.degree))[np.argmax(self.cells)].ravel(), dtype=np.float64)

    def cell_of(self, points: Floats) -> Indices:
        """(..., 2) cell of each point (..., 2), the nearest one outside of the grid."""
        return np.clip(np.floor((points - self.low) / self.size).astype(np.intp), 0, self.cells - 1)

    def values(self, cell: Indices, points: Floats, order: Order = (0, 0)) -> Floats:
        """(..., (p + 1)^2) a derivative of the functions alive on a cell, at points (..., 2) of that cell."""
        factors = []
        for axis in (0, 1):
            t = (points[..., axis] - self.low[axis]) / self.size[axis] - cell[..., axis]
            powers = t[..., None] ** np.arange(self.degree + 1)
            factor = powers @ _pieces(self.degree, order[axis]).T
            factors.append(factor / self.size[axis] ** order[axis])
        x, y = factors
        return np.asarray((x[..., :, None] * y[..., None, :]).reshape(*x.shape[:-1], self.alive))

    def index(self, cell: Indices) -> Indices:
        """(..., (p + 1)^2) numbers of the functions alive on a cell."""
        k = np.arange(self.degree + 1)
        x, y = cell[..., 0, None] + k, cell[..., 1, None] + k
        numbers = x[..., :, None] * (self.cells[1] + self.degree) + y[..., None, :]
        return np.asarray(numbers.reshape(*cell.shape[:-1], self.alive))

    def at(self, points: ArrayLike, order: Order = (0, 0)) -> csr_matrix:
        """(n, count) sparse: a derivative of every function at points (n, 2)."""
        from scipy.sparse import csr_matrix

        p = np.atleast_2d(np.asarray(points, dtype=np.float64))
        cell = self.cell_of(p)
        values, index = self.values(cell, p, order), self.index(cell)
        rows = np.repeat(np.arange(len(p)), self.alive)
        return csr_matrix((values.ravel(), (rows, index.ravel())), shape=(len(p), self.count))


def line_functions(position: Floats, parts: int, degree: int, order: int = 0) -> csr_matrix:
    """(n, parts + p) sparse: a derivative of every function on `parts` cells; a row for each position from 0 to 1."""
    from scipy.sparse import csr_matrix

    cell = np.clip(np.floor(position * parts).astype(np.intp), 0, parts - 1)
    powers = (position * parts - cell)[:, None] ** np.arange(degree + 1)
    values = powers @ _pieces(degree, order).T * float(parts) ** order
    index = cell[:, None] + np.arange(degree + 1)
    rows = np.repeat(np.arange(len(position)), degree + 1)
    return csr_matrix((values.ravel(), (rows, index.ravel())), shape=(len(position), parts + degree))
