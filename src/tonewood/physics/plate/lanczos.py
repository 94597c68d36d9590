"""Lowest modes of K x = lambda M x with a sparse, factored K: block Lanczos with shift and inverse.

The operator (K + s^2 M)^-1 M is symmetric in the inner product of M, and its largest eigenvalues
theta = 1 / (lambda + s^2) are those of the lowest modes. M may be semidefinite: the subspace starts in the range of the
operator, in which no vector is without mass. Blocks let one pass over the factors serve many vectors; every vector is
made orthogonal to all before it.

Source: G. H. Golub and C. F. Van Loan, Matrix Computations, 4th ed. (2013), section 10.3.6; T. Ericsson and A. Ruhe,
Math. Comp. 35 (1980) 1251.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from tonewood.support.arrays import Floats

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


#: vectors in a block
BLOCK = 16
#: largest residual of a pair that counts as converged, of its theta; the eigenvalue is then exact to its square
_TOLERANCE = 1e-7
#: unknowns up to which a dense problem is quicker
_DENSE = 700


def lowest(
    solve: Callable[[Floats], Floats], mass: csc_matrix, shift: float, *, count: int = 0, below: float = 0.0
) -> tuple[Floats, Floats]:
    """Eigenvalues (m,) lambda, ascending, and vectors (n, m) with x^T M x = 1.

    solve : (K + shift M)^-1 applied to (n, k).
    mass : M, symmetric and semidefinite.
    shift : s^2 > 0.
    count : number of pairs; 0 for all below `below`.
    below : upper limit of lambda, where `count` is 0.
    """
    from tonewood.support.scipy_linalg import sla

    n = mass.shape[0]
    if n <= _DENSE:
        return _dense(solve, mass, shift, count, below)
    room = 12 * BLOCK
    whole, heavy = (np.empty((n, room), order="F") for _ in range(2))
    projected = np.zeros((room, room))
    block = _orthonormal(solve(np.asarray(mass @ _start(n))), mass)
    size, check = 0, max(count, 2 * BLOCK)
    while True:
        width = block.shape[1]
        if size + width > room:
            room *= 2
            whole, heavy = (_wider(a, room) for a in (whole, heavy))
            projected = np.pad(projected, (0, room - len(projected)))
        new = slice(size, size + width)
        whole[:, new], heavy[:, new] = block, mass @ block
        size += width
        step, rows = solve(heavy[:, new]), np.zeros((size, width))
        for _ in range(2):
            part = heavy[:, :size].T @ step
            step, rows = step - whole[:, :size] @ part, rows + part
        projected[:size, new], projected[new, :size] = rows, rows.T
        block = _orthonormal(step, mass)
        if size <= check and block.shape[1]:
            continue
        theta, inside = (a[..., ::-1] for a in sla.eigh(projected[:size, :size]))
        number = count or int(np.count_nonzero(1 / theta[theta > 0] - shift <= below)) + 1
        number = min(number, size)
        tail = np.asarray((mass @ block).T @ step)
        residual = np.linalg.norm(tail @ inside[size - width :, :number], axis=0)
        if not block.shape[1] or (number < size and np.all(residual < _TOLERANCE * theta[:number])):
            values = 1 / theta[:number] - shift
            keep = values <= below if not count else np.ones(number, dtype=bool)
            return values[keep], np.asarray(whole[:, :size] @ inside[:, :number][:, keep])
        check = size + (3 if np.mean(residual < _TOLERANCE * theta[:number]) < 0.8 else 1) * BLOCK - 1


def _wider(array: Floats, room: int) -> Floats:
    out = np.empty((len(array), room), order="F")
    out[:, : array.shape[1]] = array
    return out


def _start(n: int) -> Floats:
    """Numbers (n, BLOCK) without a pattern, the same in every run."""
    return np.asarray(np.cos((1.0 + np.arange(n, dtype=np.float64))[:, None] ** 2 * np.sqrt(2.0 + np.arange(BLOCK))))


def _orthonormal(block: Floats, mass: csc_matrix) -> Floats:
    """(n, m) basis of the block's span, M-orthonormal; directions without mass or twice in it are left out."""
    for _ in range(2):
        gram = np.asarray(block.T @ (mass @ block))
        values, turn = np.linalg.eigh(0.5 * (gram + gram.T))
        good = values > 1e-20 * max(float(values.max(initial=0.0)), 1e-300)
        block = block @ (turn[:, good] / np.sqrt(values[good]))
    return np.asarray(block)


def _dense(
    solve: Callable[[Floats], Floats], mass: csc_matrix, shift: float, count: int, below: float
) -> tuple[Floats, Floats]:
    """The same from the dense matrix R^T (K + s^2 M)^-1 R, M = R R^T."""
    from tonewood.support.scipy_linalg import sla

    values, turn = sla.eigh(mass.toarray())
    some = values > 1e-13 * values[-1]
    root = turn[:, some] * np.sqrt(values[some])
    moved = solve(root)
    flexible = root.T @ moved
    theta, inside = (a[..., ::-1] for a in sla.eigh(0.5 * (flexible + flexible.T)))
    eigenvalues = 1 / theta[theta > 1e-14 * theta[0]] - shift
    number = min(count, len(eigenvalues)) if count else int(np.count_nonzero(eigenvalues <= below))
    return eigenvalues[:number], np.asarray(moved @ (inside[:, :number] / theta[:number]))
