"""Lowest modes of K x = lambda M x with a sparse, factored K: block Lanczos with shift and inverse.

The operator (K + s^2 M)^-1 M is symmetric in the inner product of M, and its largest eigenvalues
theta = 1 / (lambda + s^2) are those of the lowest modes. M may be semidefinite: the subspace starts in the range of the
operator, in which no vector is without mass. Blocks let one pass over the factors serve many vectors.

Source: G. H. Golub and C. F. Van Loan, Matrix Computations, 4th ed. (2013), section 10.3.6; T. Ericsson and A. Ruhe,
Math. Comp. 35 (1980) 1251.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Floats = NDArray[np.float64]

#: vectors in a block
BLOCK = 24
#: largest residual of a pair that counts as converged, of its theta; eigenvalues are then exact to its square
_TOLERANCE = 1e-8
#: unknowns up to which dense matrices are quicker
_DENSE = 700


def lowest(
    solve: Callable[[Floats], Floats], mass: csr_matrix, shift: float, *, count: int = 0, below: float = 0.0
) -> tuple[Floats, Floats]:
    """Eigenvalues (m,) lambda, ascending, and vectors (n, m) with x^T M x = 1.

    Parameters
    ----------
    solve : (K + shift M)^-1 applied to (n, k).
    mass : M, symmetric and semidefinite.
    shift : s^2 > 0.
    count : number of pairs; 0 for all below `below`.
    below : upper limit of lambda, where `count` is 0.
    """
    from scipy.linalg import eigh

    n = mass.shape[0]
    if n <= _DENSE:
        return _dense(solve, mass, shift, count, below)
    wanted = lambda theta: count or int(np.count_nonzero(1 / theta - shift <= below)) + 1  # noqa: E731
    block = _orthonormal(solve(mass @ _start(n)), mass)
    basis, spread = [block], [np.asarray(mass @ block)]
    projected: Floats = np.zeros((0, 0))
    while True:
        step = solve(spread[-1])
        whole, heavy = np.hstack(basis), np.hstack(spread)
        rows = heavy.T @ step
        step = step - whole @ rows
        again = heavy.T @ step
        step, rows = step - whole @ again, rows + again
        size, width = whole.shape[1], block.shape[1]
        grown = np.zeros((size, size))
        grown[: size - width, : size - width] = projected
        grown[:, size - width :] = rows
        grown[size - width :] = rows.T
        projected = grown
        block = _orthonormal(step, mass)
        tail = np.asarray((mass @ block).T @ step)
        if size > max(count, 2 * BLOCK) or not block.shape[1]:
            theta, inside = eigh(projected)
            theta, inside = theta[::-1], inside[:, ::-1]
            positive = theta > 0
            number = min(wanted(theta[positive]), size)
            residual = np.linalg.norm(tail @ inside[-width:, :number], axis=0)
            if not block.shape[1] or (number < size // 2 and np.all(residual < _TOLERANCE * theta[:number])):
                values = 1 / theta[:number] - shift
                keep = values <= below if not count else np.ones(number, dtype=bool)
                return values[keep], np.asarray(whole @ inside[:, :number][:, keep])
        basis.append(block)
        spread.append(np.asarray(mass @ block))


def _start(n: int) -> Floats:
    """Numbers (n, BLOCK) without a pattern, the same in every run."""
    return np.cos((1.0 + np.arange(n, dtype=np.float64))[:, None] ** 2 * np.sqrt(2.0 + np.arange(BLOCK)))


def _orthonormal(block: Floats, mass: csr_matrix) -> Floats:
    """(n, m) basis of the block's span, M-orthonormal; directions without mass or twice in it are left out."""
    for _ in range(2):
        gram = np.asarray(block.T @ (mass @ block))
        values, turn = np.linalg.eigh(0.5 * (gram + gram.T))
        good = values > 1e-20 * values[-1] if len(values) else np.zeros(0, dtype=bool)
        good &= values > 0
        block = block @ (turn[:, good] / np.sqrt(values[good]))
    return np.asarray(block)


def _dense(
    solve: Callable[[Floats], Floats], mass: csr_matrix, shift: float, count: int, below: float
) -> tuple[Floats, Floats]:
    """The same by a dense problem: M y = theta (K + s^2 M) y in the range of M."""
    from scipy.linalg import eigh

    heavy = mass.toarray()
    values, turn = eigh(heavy)
    root = turn[:, values > 1e-13 * values[-1]] * np.sqrt(values[values > 1e-13 * values[-1]])
    moved = solve(root)
    flexible = root.T @ moved
    theta, inside = eigh(0.5 * (flexible + flexible.T))
    theta, inside = theta[::-1], inside[:, ::-1]
    good = theta > 1e-14 * theta[0]
    found = 1 / theta[good] - shift
    number = min(count, len(found)) if count else int(np.count_nonzero(found <= below))
    return found[:number], np.asarray(moved @ (inside[:, :number] / theta[:number] ** 1.0)) if number else moved[:, :0]
