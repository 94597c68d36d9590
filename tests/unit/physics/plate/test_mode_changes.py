"""Derivatives of modes: a small system against differences, equal eigenvalues against a closed form."""

import numpy as np
import pytest

from tonewood.physics.plate.mode_changes import mode_change

RNG = np.random.default_rng(3)


def system(n=12):
    a, b = RNG.normal(size=(n, n)), RNG.normal(size=(n, n))
    return a @ a.T + np.diag(np.arange(1.0, n + 1) * 8), np.eye(n) + 0.05 * (b @ b.T)


def solve(k, m):
    from scipy.linalg import eigh

    return eigh(k, m)


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
def test_shapes_and_values_with_the_share_of_modes_that_are_not_known(step):
    k, m = system()
    k_rate, m_rate = (0.5 * (x + x.T) for x in RNG.normal(size=(2, 12, 12)))
    m_rate *= 0.02
    values, vectors = solve(k, m)
    inverse = np.linalg.inv(k + 0.5 * m)
    change = mode_change(values[:8], vectors[:, :8], k_rate @ vectors[:, :8], m_rate @ vectors[:, :8], m,
                         lambda f: inverse @ f, 0.5, 3)  # fmt: skip
    (low, a), (high, b) = solve(k - step * k_rate, m - step * m_rate), solve(k + step * k_rate, m + step * m_rate)
    np.testing.assert_allclose(change.values_rate, (high - low)[:3] / (2 * step), rtol=1e-6, atol=100 * step**2)
    signs = [np.sign(np.sum(x[:, :3] * (m @ vectors[:, :3]), axis=0)) for x in (a, b)]
    slope = (b[:, :3] * signs[1] - a[:, :3] * signs[0]) / (2 * step)
    np.testing.assert_allclose(change.vectors_rate, slope, atol=1e-6 + 10 * step**2)


def test_equal_eigenvalues_split_as_the_parameter_splits_them():
    """A square membrane of masses: modes (1, 2) and (2, 1) split by +-1 under a stiffness that couples them."""
    k, m = np.diag([1.0, 4.0, 4.0, 9.0]), np.eye(4)
    rate = np.zeros((4, 4))
    rate[1, 2] = rate[2, 1] = 1.0
    rate[0, 1] = rate[1, 0] = 0.3
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]  # any basis of the pair
    change = mode_change(np.diag(k), turn, rate @ turn, 0 * turn, m, lambda f: np.linalg.inv(k) @ f, 0.0, 3)
    np.testing.assert_allclose(change.values_rate, [0.0, -1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(change.vectors[1:3, 1:]), np.sqrt(0.5) * np.ones((2, 2)), atol=1e-12)
    # the compliance sum of the pair has a derivative whatever its basis: -K^-1 K' K^-1
    for x, values, rates in ((change.vectors, np.diag(k)[:3], change.values_rate),):
        compliance = sum(
            (np.outer(change.vectors_rate[:, i], x[:, i]) + np.outer(x[:, i], change.vectors_rate[:, i])) / values[i]
            - np.outer(x[:, i], x[:, i]) * rates[i] / values[i] ** 2
            for i in range(3)
        )
        inverse = np.linalg.inv(k)
        np.testing.assert_allclose(compliance[:3, :3], (-inverse @ rate @ inverse)[:3, :3], atol=1e-9)
