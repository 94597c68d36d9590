"""Solutions of A x = f with a sparse, symmetric, positive definite A whose unknowns lie along a line.

Unknowns sorted by their position couple with near ones only: in blocks, each with the next alone, A is tridiagonal,

    S_1 = A_11,    S_k = L_k L_k^T,    S_k+1 = A_k+1,k+1 - C_k^T C_k,    C_k = L_k^-1 A_k,k+1,

and a solution takes two solutions with every S_k. These are dense, as those of plates nearly fill up: the functions
of a spline's grid couple with all others of p columns of cells. A is scaled to a diagonal of ones. Where rounding makes
it indefinite, it is solved by sparse factors without sorting.

Source: G. H. Golub and C. F. Van Loan, Matrix Computations, 4th ed. (2013), section 4.5.1.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tonewood.support.arrays import Floats

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

#: least unknowns of a block
_LEAST = 64


class BlockSolver:
    """Factors of a matrix.

    matrix : (n, n) A.
    position : (n,) of each unknown; NaN of those that lie in the middle of the unknowns that they couple with.
    """

    def __init__(self, matrix: csc_matrix, position: Floats):
        from scipy.sparse import csr_matrix, diags

        self._scale = np.asarray(1.0 / np.sqrt(matrix.diagonal()))
        scaled = csr_matrix(diags(self._scale) @ matrix @ diags(self._scale))
        self._order = np.argsort(_positions(scaled, position), kind="stable")
        try:
            self._factor(scaled[self._order][:, self._order])
            self._solve: Callable[[Floats], Floats] = self._by_blocks
        except np.linalg.LinAlgError:
            from scipy.sparse.linalg import splu

            options = {"SymmetricMode": True}
            self._solve = splu(scaled.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve

    def _factor(self, matrix: csr_matrix) -> None:
        from tonewood.support.scipy_linalg import sla

        starts = _blocks(matrix)
        self._blocks = [slice(a, b) for a, b in pairwise(starts)]
        self._below: list[csr_matrix] = []
        self._halves: list[Floats] = []
        added: Floats | float = 0.0
        for now, then in zip(self._blocks, [*self._blocks[1:], slice(0, 0)], strict=True):
            block = matrix[now, now].toarray() - added
            half = sla.cholesky(block, lower=True, overwrite_a=True, check_finite=False)
            between = sla.solve_triangular(half, matrix[now, then].toarray(), lower=True, check_finite=False)
            added = between.T @ between
            self._halves.append(half)
            self._below.append(matrix[then, now])

    def solve(self, forces: Floats) -> Floats:
        """(n, k) A^-1 applied to forces (n, k)."""
        return np.asarray(self._scale[:, None] * self._solve(self._scale[:, None] * forces))

    def _by_blocks(self, forces: Floats) -> Floats:
        from tonewood.support.scipy_linalg import sla

        def once(half: Floats, rest: Floats) -> Floats:
            return np.asarray(sla.cho_solve((half, True), rest, overwrite_b=True, check_finite=False))

        ordered = forces[self._order]
        parts: list[Floats] = []
        for i, (half, block) in enumerate(zip(self._halves, self._blocks, strict=True)):
            parts.append(once(half, ordered[block] - self._below[i - 1] @ parts[-1] if parts else ordered[block]))
        for i in range(len(parts) - 2, -1, -1):
            parts[i] -= once(self._halves[i], self._below[i].T @ parts[i + 1])
        out = np.empty_like(ordered)
        out[self._order] = np.concatenate(parts)
        return out


def _positions(matrix: csr_matrix, position: Floats) -> Floats:
    """(n,) positions; an unknown without one gets the mean position of the unknowns that it couples with."""
    finite = np.isfinite(position)
    couples = abs(matrix) > 0
    total = couples @ np.column_stack([finite, np.where(finite, position, 0.0)])
    return np.where(finite, position, total[:, 1] / np.maximum(total[:, 0], 1.0))


def _blocks(matrix: csr_matrix) -> list[int]:
    """First unknowns of blocks that couple with their neighbours alone, and the number of all."""
    n = matrix.shape[0]
    farthest = np.zeros(n, dtype=np.intp)
    np.maximum.at(farthest, np.repeat(np.arange(n), np.diff(matrix.indptr)), matrix.indices)
    reach = np.maximum.accumulate(farthest) + 1
    starts = [0, min(_LEAST, n)]
    while starts[-1] < n:
        starts.append(min(n, max(int(reach[starts[-1] - 1]), starts[-1] + _LEAST)))
    return starts
