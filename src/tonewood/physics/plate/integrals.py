"""Sparse matrices of energies: integrals over a plate of products of fields, each sought among the functions of a grid.

Cells that lie inside share their points; where the factor is a constant, the matrix of one is that of all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tonewood.physics.plate.outline import Quadrature
from tonewood.physics.plate.splines import Order, SplineGrid
from tonewood.support.arrays import Floats, Indices

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

#: from points (..., 2) to a factor (...,) or one for each row (..., r)
Weighting = Callable[[Floats], Floats]
#: a derivative of a field's functions alive on cells, (..., n)
Values = Callable[[Order], Floats]

#: cells that are integrated at a time
_CHUNK = 96


def displacement(w: Values) -> Floats:
    """Rows of w."""
    return w((0, 0))[..., None, :]


def integrals(
    fields: int,
    quad: Quadrature,
    operator: Callable[..., Floats],
    factor: Weighting | Floats | float,
    matrices: Sequence[Floats],
) -> list[Any]:
    """Sparse integrals of (B a)^T diag(factor) Q (B b) dA over all pairs of functions a, b.

    fields : number of fields, each a sum of the functions of the grid of `quad`.
    operator : from `Values` of each field, the rows B (..., r, n) with the functions of all fields, in their order.
    factor : of points, for all rows or for each; or a constant, a number or (r,).
    matrices : Q, each (r, r), with which the factor commutes; one sparse matrix is returned for each.
    """
    parts: list[list[Floats]] = [[] for _ in matrices]
    cells: list[Indices] = []
    for (cell, points, weights), whole in zip(quad.groups, quad.whole, strict=True):
        chosen, which = np.arange(len(cell)), np.arange(len(cell))
        if whole and not callable(factor):
            chosen, which = chosen[:1], np.zeros_like(which)
        group = (cell[chosen], points[chosen], weights[chosen])
        elements = _elements(quad.grid, fields, group, operator, factor, matrices)
        for total, element in zip(parts, elements, strict=True):
            total.append(element[which])
        cells.append(cell)
    every = np.concatenate(cells)
    return [_assembled(quad.grid, fields, every, np.concatenate(part)) for part in parts]


def _elements(
    grid: SplineGrid,
    fields: int,
    group: tuple[Indices, Floats, Floats],
    operator: Callable[..., Floats],
    factor: Weighting | Floats | float,
    matrices: Sequence[Floats],
) -> list[Floats]:
    """(cells, n, n) matrices of each cell, for each of the matrices Q."""
    cells, points, weights = group
    out: list[list[Floats]] = [[] for _ in matrices]
    for first in range(0, len(cells), _CHUNK):
        some = slice(first, first + _CHUNK)
        cell, x, w = cells[some], points[some], weights[some]
        b = operator(*[partial(grid.values, cell[:, None, :], x)] * fields)
        f = np.asarray(factor(x) if callable(factor) else factor, dtype=np.float64)
        scaled = (f if f.ndim in (1, 3) else f[..., None]) * w[..., None]
        flat = b.reshape(len(cell), -1, b.shape[-1]).transpose(0, 2, 1)
        weighted = b * scaled[..., None]
        for column, matrix in zip(out, matrices, strict=True):
            column.append(flat @ (matrix @ weighted).reshape(len(cell), -1, b.shape[-1]))
    return [np.concatenate(column) for column in out]


def _assembled(grid: SplineGrid, fields: int, cells: Indices, elements: Floats) -> csr_matrix:
    """Sum of the cells' matrices, fields in their order."""
    from scipy.sparse import bmat

    blocks: list[list[Any]] = [[None] * fields for _ in range(fields)]
    spots = [slice(k * grid.alive, (k + 1) * grid.alive) for k in range(fields)]
    for i in range(fields):
        for j in range(i, fields):
            block = _block(grid, cells, elements[:, spots[i], spots[j]])
            blocks[i][j], blocks[j][i] = block, block if i == j else block.T
    whole: csr_matrix = bmat(blocks).tocsr()
    return whole


def _block(grid: SplineGrid, cells: Indices, part: Floats) -> csr_matrix:
    """Block of two fields: sums in a table of rows and distances, as functions that meet are at most p apart."""
    from scipy.sparse import csr_matrix

    row, p, n = grid.index(cells), grid.degree, int(grid.cells[1]) + grid.degree
    width = 2 * p + 1
    x, y = row // n, row % n
    key = (row * width**2 - x * width - y + p * (width + 1))[:, :, None] + (x * width + y)[:, None, :]
    table = np.bincount(key.ravel(), weights=part.ravel(), minlength=grid.count * width**2)
    used = np.flatnonzero(table)
    rows, rest = np.divmod(used, width**2)
    columns = rows + (rest // width - p) * n + rest % width - p
    return csr_matrix((table[used], (rows, columns)), shape=(grid.count, grid.count))
