"""Laws of connections: effect of their forces on gaps and energy, against laws written out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given
from hypothesis import strategies as st

from tonewood.physics.coupling.connections import LinearLaws, Rigid, SpringDashpot
from tonewood.physics.coupling.inverse import scaled_pinv

DT = 1 / 48000


def linear_solve(laws, compliance, residual, dt):
    return LinearLaws.of(laws, dt).solve(compliance, residual)


def random_psd(rng, m, rank=None):
    X = rng.normal(size=(m, rank or m)) * 10.0 ** rng.uniform(-3, 3, size=(m, 1))
    return 1e-6 * X @ X.T


def forces(solve, free, old):
    return solve.constant - solve.G @ (free + solve.gamma * old)


def test_rigid_gaps_close_at_their_offsets(rng):
    Z = random_psd(rng, 4)
    solve = linear_solve([Rigid(b) for b in (0.0, 1e-3, -2e-3, 0.0)], Z, np.zeros((4, 4)), DT)
    free = rng.normal(size=4)
    np.testing.assert_allclose(free + Z @ forces(solve, free, rng.normal(size=4)), [0, 1e-3, -2e-3, 0], atol=1e-9)


def test_rigid_gap_with_residual_gives_way_by_it(rng):
    Z, R = random_psd(rng, 3), random_psd(rng, 3)
    solve = linear_solve([Rigid(1e-3)] * 3, Z, R, DT)
    free, old = rng.normal(size=(2, 3))
    f = forces(solve, free, old)
    new = free + Z @ f
    np.testing.assert_allclose((new + old) / 2 + R @ f, 1e-3, rtol=1e-7, atol=1e-7)


def test_spring_and_dashpot_pull_at_the_middle_of_the_step(rng):
    Z, k, r = random_psd(rng, 2), np.array([1e5, 0.0]), np.array([0.0, 30.0])
    laws = [SpringDashpot(k[0], r[0], 1e-3), SpringDashpot(k[1], r[1])]
    solve = linear_solve(laws, Z, np.zeros((2, 2)), DT)
    free, old = rng.normal(size=(2, 2)) * 1e-3
    f = forces(solve, free, old)
    new = free + Z @ f
    np.testing.assert_allclose(f, -k * ((new + old) / 2 - [1e-3, 0]) - r * (new - old) / DT, rtol=1e-8)


@given(seed=st.integers(0, 10**6), m=st.integers(1, 6), lost=st.integers(0, 2))
def test_no_law_creates_energy(seed, m, lost):
    rng = np.random.default_rng(seed)
    Z = random_psd(rng, m, max(m - lost, 1))
    laws = []
    for _ in range(m):
        size = 10.0 ** rng.uniform(-2, 10)
        laws.append(
            [Rigid(), SpringDashpot(size, 0.0), SpringDashpot(0.0, size * DT), SpringDashpot(size, size * DT)][
                rng.integers(4)
            ]
        )
    solve = linear_solve(laws, Z, np.zeros((m, m)), DT)
    rigid = np.array([isinstance(law, Rigid) for law in laws])
    old = np.where(rigid, 0.0, rng.normal(size=m))
    # free motion from anywhere the ports can go
    free = old + Z @ rng.normal(size=m) * 1e6
    f = forces(solve, free, old)
    new = free + Z @ f
    stored = sum(
        law.stiffness / 2 * (new[j] ** 2 - old[j] ** 2) for j, law in enumerate(laws) if not isinstance(law, Rigid)
    )
    # sizes of the terms that cancel
    scale = float(np.abs(f) @ (np.abs(new) + np.abs(old) + np.abs(free)))
    assert f @ (new - old) + stored <= 1e-9 * scale


def test_a_connection_without_stiffness_and_damping_carries_nothing():
    solve = linear_solve([SpringDashpot(), Rigid()], np.array([[2e-6, 1e-6], [1e-6, 3e-6]]), np.zeros((2, 2)), DT)
    f = forces(solve, np.array([1.0, 1.0]), np.zeros(2))
    assert f[0] == 0.0
    assert f[1] == pytest.approx(-1.0 / 3e-6)


def test_redundant_constraints_share_the_force():
    Z = np.full((3, 3), 2e-6)
    solve = linear_solve([Rigid()] * 3, Z, np.zeros((3, 3)), DT)
    np.testing.assert_allclose(forces(solve, np.ones(3), np.zeros(3)), -1 / 6e-6, rtol=1e-9)


def test_constraint_that_can_do_nothing_is_left_alone():
    solve = linear_solve([Rigid(), Rigid()], np.diag([0.0, 1e-6]), np.zeros((2, 2)), DT)
    np.testing.assert_array_equal(forces(solve, np.array([0.0, 1.0]), np.zeros(2))[0], 0.0)


@given(seed=st.integers(0, 10**6))
def test_scaled_pinv_is_a_pseudo_inverse_at_any_scale(seed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(5, rng.integers(1, 6)))
    scale = 10.0 ** rng.uniform(-6, 6, 5)
    M = scale[:, None] * (X @ X.T) * scale
    G = scaled_pinv(M)
    unit = np.outer(scale, scale)
    np.testing.assert_allclose((M @ G @ M) / unit, M / unit, atol=1e-8 * np.abs(M / unit).max())
    np.testing.assert_allclose(G, G.T, rtol=1e-8, atol=1e-8 * np.abs(G * unit).max() / unit.max())


def test_scaled_pinv_of_a_regular_matrix_is_the_inverse(rng):
    M = random_psd(rng, 4)
    np.testing.assert_allclose(scaled_pinv(M) @ M, np.eye(4), atol=1e-6)
    np.testing.assert_allclose(scaled_pinv(M), sla.inv(M), rtol=1e-5)


@pytest.mark.parametrize("values", [(-1.0, 0.0), (0.0, -1.0), (float("nan"), 0.0)])
def test_negative_stiffness_or_damping_is_refused(values):
    with pytest.raises(ValueError, match="must not be negative"):
        SpringDashpot(*values)
