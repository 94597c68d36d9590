"""Component modes against the hand-worked examples of Klosner & Ranlet (1978) and the matrices they come from."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.component_modes import fixed_base_modes, free_free_modes

Floats = NDArray[np.float64]

#: problem C, in units of k and m: a massless foot, 2k, 2m, k, m
M_C = np.diag([0.0, 2.0, 1.0])
K_C = np.array([[2.0, -2.0, 0.0], [-2.0, 3.0, -1.0], [0.0, -1.0, 1.0]])


def _normalised(shapes: Floats) -> Floats:
    return shapes / shapes[0]


def test_fixed_base_modes_of_problem_c() -> None:
    modes = fixed_base_modes(M_C, K_C, [0])
    np.testing.assert_allclose(modes.omega**2, [0.5, 2.0])
    np.testing.assert_allclose(_normalised(modes.shapes), [[1, 1], [2, -1]], atol=1e-14)
    np.testing.assert_allclose(modes.constraint, [[1], [1]])
    np.testing.assert_allclose(modes.transformation[0], [1, 0, 0])


def test_free_free_modes_of_problem_c() -> None:
    modes = free_free_modes(M_C, K_C)
    np.testing.assert_allclose(modes.omega**2, [0.0, 1.5, np.inf])
    np.testing.assert_allclose(_normalised(modes.shapes), [[1, 1, 1], [1, 1, 0], [1, -2, 0]], atol=1e-14)
    # of unit modal mass; the massless one of unit modal stiffness
    np.testing.assert_allclose(modes.shapes.T @ K_C @ modes.shapes, np.diag([0.0, 1.5, 1.0]), atol=1e-14)
    np.testing.assert_allclose(modes.shapes.T @ M_C @ modes.shapes, np.diag([1.0, 1.0, 0.0]), atol=1e-14)


def test_free_free_modes_of_problem_a() -> None:
    modes = free_free_modes(np.diag([0.0, 3.0]), [[2.0, -2.0], [-2.0, 2.0]])
    assert modes.omega[0] == 0.0
    assert np.isinf(modes.omega[1])
    np.testing.assert_allclose(_normalised(modes.shapes), [[1, 1], [1, 0]], atol=1e-14)


def _chain(n: int) -> tuple[Floats, Floats, Floats]:
    K = np.diag([1.0] + [2.0] * (n - 2) + [1.0]) - np.eye(n, k=1) - np.eye(n, k=-1)
    M = np.diag(np.linspace(1.0, 2.0, n))
    return M, 0.02 * K + 0.01 * M, 30 * K


@pytest.mark.parametrize("interface", [[0], [0, 5], [3]])
def test_complete_sets_answer_like_the_matrices(interface: list[int]) -> None:
    M, C, K = _chain(6)
    points = {"a": np.eye(6)[interface[0]], "b": np.eye(6)[4]}
    freq = np.array([0.2, 1.1])
    expected = [sla.inv(-((2 * np.pi * f) ** 2) * M + 2j * np.pi * f * C + K)[interface[0], 4] for f in freq]
    basis = fixed_base_modes(M, K, interface).basis(points, C)
    np.testing.assert_allclose(basis.frf(freq, "a", "b", "receptance"), expected, rtol=1e-10)
    expected = [sla.inv(-((2 * np.pi * f) ** 2) * M + K)[interface[0], 4] for f in freq]
    free = free_free_modes(M, K).basis(points)
    np.testing.assert_allclose(free.frf(freq, "a", "b", "receptance"), expected, rtol=1e-10)


@pytest.mark.parametrize("massless", [0, 2])
def test_massless_dofs_anywhere(massless: int) -> None:
    M, _, K = _chain(6)
    M[massless, massless] = 0.0
    points = {"a": np.eye(6)[0], "b": np.eye(6)[4]}
    freq = np.array([0.2, 1.1])
    expected = [sla.inv(-((2 * np.pi * f) ** 2) * M + K)[0, 4] for f in freq]
    for basis in (fixed_base_modes(M, K, [0]).basis(points), free_free_modes(M, K).basis(points)):
        np.testing.assert_allclose(basis.frf(freq, "a", "b", "receptance"), expected, rtol=1e-9)


def test_truncation_keeps_what_must_stay() -> None:
    M, _, K = _chain(6)
    M[0, 0] = 0.0
    few = free_free_modes(M, K, 2)
    assert few.omega.size == 3
    assert np.isinf(few.omega[-1])
    reduced = fixed_base_modes(M, K, [0], 1)
    assert reduced.transformation.shape == (6, 2)
    # rigid-body motion and static response to the interface survive any truncation
    np.testing.assert_allclose(reduced.transformation[:, 0], 1.0, rtol=1e-12)


def test_a_foot_that_leaves_the_body_loose_is_refused() -> None:
    with pytest.raises(ValueError, match="without strain"):
        fixed_base_modes(np.eye(3), np.diag([1.0, 1.0, 0.0]), [0])
