"""Storage functions against mechanical energy and against the power balance of exactly solved motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from random_bodies import body, mechanical_storage, power_balance, solve
from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import extend
from tonewood.physics.passivity.storage import _of_riccati, storage_matrix


def states_of(one, u, v):
    """Full modal state of displacements and velocities, from u = sum 2 Re(r z), v = sum 2 Re(lambda r z)."""
    lam, psi, _ = extend(one.poles, one.shapes, one.shapes)
    return linalg.solve(np.concatenate([psi, psi * lam]), np.concatenate([u, v]))


def test_energy_of_real_modes_is_mechanical(rng):
    # proportional damping; modes normalised at random
    base = body(7, 0.0, n_dof=10, n_ports=3)
    one = solve(base.M, 0.4 * base.M + 1e-6 * base.K, base.K, base.ports)
    turn = rng.uniform(0.1, 5.0, 10) * np.exp(1j * rng.uniform(0, 6, 10))
    shapes = (one.shapes / one.shapes[np.abs(one.shapes).argmax(axis=0), np.arange(10)]).real * turn
    norm = np.einsum("ik,ij,jk->k", shapes, one.C, shapes) + 2 * one.poles * np.einsum(
        "ik,ij,jk->k", shapes, one.M, shapes
    )
    storage = storage_matrix(one.poles, one.ports @ shapes, one.ports @ shapes / norm)
    assert storage.kind == "modal"
    u, v = rng.standard_normal(10) * 1e-4, rng.standard_normal(10)
    lam, psi, _ = extend(one.poles, shapes, shapes)
    z = linalg.solve(np.concatenate([psi, psi * lam]), np.concatenate([u, v]))
    assert storage.energy(z) == pytest.approx(0.5 * (v @ one.M @ v + u @ one.K @ u), rel=1e-8)
    assert storage.dissipation(z) == pytest.approx(v @ one.C @ v, rel=1e-8)


def test_energy_of_a_complete_list_is_mechanical(rng):
    one = body(8, 0.03, n_dof=12)
    storage = mechanical_storage(one.poles, one.shapes, one.shapes * one.norm, one.M, one.C, one.K)
    u, v = rng.standard_normal(12) * 1e-4, rng.standard_normal(12)
    z = states_of(one, u, v)
    assert storage.energy(z) == pytest.approx(0.5 * (v @ one.M @ v + u @ one.K @ u), rel=1e-9)
    assert storage.dissipation(z) == pytest.approx(v @ one.C @ v, rel=1e-9)
    with pytest.raises(PassivityError, match="not the complete list"):
        mechanical_storage(one.poles[:9], one.shapes[:, :9], (one.shapes * one.norm)[:, :9], one.M, one.C, one.K)


@pytest.mark.parametrize(("zeta", "n_dof"), [(0.003, 20), (0.06, 20), (0.25, 16)])
def test_storage_of_complex_modes_balances(zeta, n_dof, rng):
    modes = body(2, zeta, n_dof=n_dof).modes
    storage = storage_matrix(*modes)
    assert storage.kind == "riccati"
    residual, energy, lost = power_balance(modes, storage, rng)
    assert np.abs(residual).max() < 1e-10 * energy.max()
    assert energy.min() > 0
    assert lost.min() > 0


def test_a_wrong_loss_or_force_breaks_the_balance(rng):
    modes = body(2, 0.06, n_dof=12).modes
    storage = storage_matrix(*modes)
    object.__setattr__(storage, "Q", storage.Q * 1.001)
    residual, energy, _ = power_balance(modes, storage, rng)
    assert np.abs(residual).max() > 1e-7 * energy.max()


def test_mixed_real_modes_balance(rng):
    # a damped and an undamped pair, an overdamped mode as two real poles, and a massless real mode
    wd = 2 * np.pi * np.array([200.0, 310.0])
    poles = np.concatenate([[-20 + 1j * wd[0], 1j * wd[1]], [-50.0, -900.0, -300.0]])
    phi = rng.standard_normal((2, 4))
    right = np.concatenate([phi[:, :2], phi[:, [2]], 2 * phi[:, [2]], phi[:, [3]]], axis=1) + 0j
    left = right * np.array([-0.5j / wd[0], -0.5j / wd[1], 1 / 850, -0.25 / 850, 1e-3])
    storage = storage_matrix(poles, right, left)
    residual, energy, lost = power_balance((poles, right, left), storage, rng, duration=2e-2)
    assert np.abs(residual).max() < 1e-11 * energy.max()
    assert lost.min() >= 0
    assert linalg.eigvalsh(storage.P)[0] > -1e-9


@pytest.mark.parametrize("silent", [("right",), ("left",), ("right", "left")])
def test_modes_that_no_port_drives_or_sees_store_nothing(silent):
    poles = np.array([-5 + 900j, -40 + 2000j, -30.0])
    right = np.array([[0.3, 1.0, 0.0], [0.8, -0.2, 0.0]]) + 0j
    left = right * np.array([-0.5j / 900, -0.5j / 2000, 0.0])
    (right if "right" in silent else left)[:, 1] = 0.0
    if len(silent) == 2:
        left[:, 1] = 0.0
    storage = storage_matrix(poles, right, left)
    alone = storage_matrix(poles[:1], right[:, :1], left[:, :1])
    states = [0, 3]  # and conjugate
    np.testing.assert_allclose(storage.P[np.ix_(states, states)], alone.P, rtol=1e-12)
    others = [k for k in range(len(storage.P)) if k not in states]
    assert not storage.P[others].any()


def test_undamped_complex_modes_are_stored_too(rng):
    modes = body(1, 0.0, n_dof=8).modes
    turn = np.exp(1j * rng.uniform(0, 6, 8))
    modes = (modes[0].imag * 1j, modes[1] * turn, modes[2] / turn)
    residual, energy, lost = power_balance(modes, storage_matrix(*modes), rng)
    assert np.abs(residual).max() < 1e-9 * energy.max()
    np.testing.assert_allclose(lost, 0.0, atol=1e-9 * energy.max())


def test_no_storage_for_a_list_that_is_not_passive():
    with pytest.raises(PassivityError, match="no storage function"):
        storage_matrix(*body(1, 0.015).truncated())
    poles, right, left = body(1, 0.015, n_dof=12).modes
    with pytest.raises(PassivityError, match="no storage function"):
        storage_matrix(poles, right, -left)
    with pytest.raises(PassivityError, match="undamped mode is not passive by itself"):
        storage_matrix(np.array([500j]), np.ones((1, 1)) + 0j, np.array([[0.5j]]))
    # a pole that grows or stays where it is, beside one that is well: whatever the shapes
    for odd in (3.0 + 800j, 0.0):
        with pytest.raises(PassivityError, match="grows, or is zero"):
            storage_matrix(np.array([-5 + 900j, odd]), np.ones((1, 2)), np.array([[0.1 - 0.5j, 0.1 - 0.5j]]))


def test_a_port_without_stiffness_has_no_storage_function():
    """Two modes whose static compliances cancel: H(0) = 0, while the port moves and is driven."""
    poles = np.array([-4 + 500j, -9 + 800j])
    products = np.array([0.02 - 1.0j, -0.02 + 0.0j])  # without a direct term
    fast = poles[1]
    products[1] += 1j * (-(products[0] / poles[0]).real * abs(fast) ** 2 + 0.02 * fast.real) / fast.imag
    assert abs((products / poles).real.sum()) < 1e-15
    with pytest.raises(PassivityError, match="mass or stiffness at the ports is singular"):
        _of_riccati(poles, np.ones((1, 2)) + 0j, products[None])
