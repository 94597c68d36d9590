"""Sparse matrices of energies: integrals over a plate of products of fields, each sought among the functions of a grid.

Fields may live on grids of different sizes whose cells nest: the integrals run over the cells of the finest. Cells that
lie inside share their points; where the factor is a constant, one of each kind is computed for all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.plate.outline import Quadrature
from tonewood.physics.plate.splines import Order, SplineGrid

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
#: from points (..., 2) to a factor (...,) or one for each row (..., r)
Factor = Callable[[Floats], Floats]
#: a derivative of a field's functions alive on cells, (..., n)
Values = Callable[[Order], Floats]

#: cells that are integrated at a time
_CHUNK = 96


def displacement(w: Values) -> Floats:
    """Rows of w."""
    return w((0, 0))[..., None, :]


def integrals(
    grids: Sequence[SplineGrid],
    quad: Quadrature,
    operator: Callable[..., Floats],
    factor: Factor | Floats | float,
    matrices: Sequence[Floats],
) -> list[Any]:
    """Sparse integrals of (B a)^T diag(factor) Q (B b) dA over all pairs of functions a, b.

    Parameters
    ----------
    grids : of each field; their cells are those of `quad`, or twice as large.
    operator : from `Values` of each field, the rows B (..., r, n) with the functions of all fields, in their order.
    factor : of points, for all rows or for each; or a constant, a number or (r,).
    matrices : Q, each (r, r), with which the factor commutes; one sparse matrix is returned for each.
    """
    parts: list[list[Floats]] = [[] for _ in matrices]
    cells: list[Places] = []
    for (cell, points, weights), whole in zip(quad.groups, quad.whole, strict=True):
        chosen, which = np.arange(len(cell)), np.arange(len(cell))
        if whole and not callable(factor):
            _, chosen, which = np.unique(cell % 2 @ np.array([2, 1]), return_index=True, return_inverse=True)
        for found, element in zip(
            parts, _elements(grids, quad.grid, (cell[chosen], points[chosen], weights[chosen]), operator, factor, matrices),
            strict=True,
        ):  # fmt: skip
            found.append(element[which])
        cells.append(cell)
    every = np.concatenate(cells)
    return [_assembled(grids, quad.grid, every, np.concatenate(part)) for part in parts]


def _elements(
    grids: Sequence[SplineGrid],
    finest: SplineGrid,
    group: tuple[Places, Floats, Floats],
    operator: Callable[..., Floats],
    factor: Factor | Floats | float,
    matrices: Sequence[Floats],
) -> list[Floats]:
    """(cells, n, n) matrices of each cell, for each of the matrices Q."""
    cells, points, weights = group
    out: list[list[Floats]] = [[] for _ in matrices]
    for first in range(0, len(cells), _CHUNK):
        some = slice(first, first + _CHUNK)
        cell, x, w = cells[some], points[some], weights[some]
        ratios = [_ratio(grid, finest) for grid in grids]
        fields = [partial(g.values, cell[:, None, :] // r, x) for g, r in zip(grids, ratios, strict=True)]
        b = operator(*fields)
        f = np.asarray(factor(x) if callable(factor) else factor, dtype=np.float64)
        scaled = (f if f.ndim in (1, 3) else f[..., None]) * w[..., None]
        flat = b.reshape(len(cell), -1, b.shape[-1]).transpose(0, 2, 1)
        weighted = b * scaled[..., None]
        for found, matrix in zip(out, matrices, strict=True):
            found.append(flat @ (matrix @ weighted).reshape(len(cell), -1, b.shape[-1]))
    return [np.concatenate(found) for found in out]


def _ratio(grid: SplineGrid, finest: SplineGrid) -> int:
    return round(float(grid.size[0] / finest.size[0]))


def _assembled(grids: Sequence[SplineGrid], finest: SplineGrid, cells: Places, elements: Floats) -> csr_matrix:
    """Sum of the cells' matrices, fields in their order."""
    from scipy.sparse import bmat, csr_matrix

    blocks: list[list[Any]] = [[None] * len(grids) for _ in grids]
    alive, start = [g.alive for g in grids], np.concatenate([[0], np.cumsum([g.alive for g in grids])])
    for i in range(len(grids)):
        for j in range(i, len(grids)):
            part = elements[:, start[i] : start[i] + alive[i], start[j] : start[j] + alive[j]]
            block = _block(grids[i], grids[j], finest, cells, part)
            blocks[i][j], blocks[j][i] = block, block if i == j else block.T
    return csr_matrix(bmat(blocks, format="csr"))


def _block(row: SplineGrid, column: SplineGrid, finest: SplineGrid, cells: Places, part: Floats) -> csr_matrix:
    """Block of two fields: sums in a table of rows and distances, as functions that meet are close to each other."""
    from scipy.sparse import csr_matrix

    r, c = _ratio(row, finest), _ratio(column, finest)
    if r == c:
        cells, r, c = cells // r, 1, 1
    at_row, at_column = row.index(cells // r), column.index(cells // c)
    (n_row, n_column) = (int(g.cells[1]) + g.degree for g in (row, column))
    # place of a column's function less that of the row's, in cells of the finer of the two grids
    span = (max(r, c)) * (row.degree + 1) + max(r, c)
    width = 2 * span + 1
    i, j = (at_row // n_row, at_row % n_row), (at_column // n_column, at_column % n_column)
    key_row = at_row * width**2 + (span - r * i[0]) * width + span - r * i[1]
    key = key_row[:, :, None] + (c * (j[0] * width + j[1]))[:, None, :]
    table = np.bincount(key.ravel(), weights=part.ravel(), minlength=row.count * width**2)
    used = np.flatnonzero(table)
    rows, rest = np.divmod(used, width**2)
    x, y = np.divmod(rest, width)
    columns = (x - span + r * (rows // n_row)) // c * n_column + (y - span + r * (rows % n_row)) // c
    return csr_matrix((table[used], (rows, columns)), shape=(row.count, column.count))
