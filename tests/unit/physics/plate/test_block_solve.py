"""Block solutions beside dense ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_matrix

from tonewood.physics.plate.block_solve import BlockSolver


def laplacian(wide: int, long: int) -> np.ndarray:
    """A membrane's matrix on a grid, numbered across first."""
    a, b = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1) for n in (wide, long))
    return np.kron(np.eye(long), a) + np.kron(b, np.eye(wide))


@pytest.mark.parametrize("unknown", [0, 20])
def test_solutions_are_those_of_the_dense_matrix(rng: np.random.Generator, unknown: int) -> None:
    """Two separate parts in any order, some of their places unknown, with diagonals over eight decades."""
    one, two = laplacian(7, 60), laplacian(4, 50)
    n = len(one) + len(two)
    matrix = np.zeros((n, n))
    matrix[: len(one), : len(one)], matrix[len(one) :, len(one) :] = one, two
    place = np.concatenate([np.repeat(np.arange(60.0), 7), 100 + np.repeat(np.arange(50.0), 4)])
    place[rng.permutation(n)[:unknown]] = np.nan
    order, scale = rng.permutation(n), 10 ** rng.uniform(-4, 4, n)
    mixed = (scale[:, None] * matrix * scale)[np.ix_(order, order)]
    forces = scale[order, None] * rng.standard_normal((n, 3))
    solution = BlockSolver(csc_matrix(mixed), place[order]).solve(forces)
    wanted = np.linalg.solve(matrix, (forces / scale[order, None])[np.argsort(order)])[order] / scale[order, None]
    np.testing.assert_allclose(solution * scale[order, None], wanted * scale[order, None], rtol=1e-9, atol=1e-9)


def test_an_indefinite_matrix_is_solved(rng: np.random.Generator) -> None:
    """One eigenvalue below zero, which has no Cholesky factors."""
    matrix = laplacian(3, 40) - 0.6 * np.eye(120)
    assert np.linalg.eigvalsh(matrix)[0] < 0
    forces = rng.standard_normal((120, 2))
    solution = BlockSolver(csc_matrix(matrix), np.repeat(np.arange(40.0), 3)).solve(forces)
    np.testing.assert_allclose(matrix @ solution, forces, atol=1e-9)
