"""Lumps on a component: against mobilities in parallel, computed from the component without them."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.physics.modal.loaded import loaded
from tonewood.physics.modal.modes import PAIR, ModalBasis

FREQ = np.geomspace(20.0, 2000.0, 300)
S = 2j * np.pi * FREQ


def component(residual=None, freq=(80.0, 210.0, 212.0, 640.0, 1500.0)):
    """Two points; the first mode is overdamped."""
    rng = np.random.default_rng(4)
    omega = 2 * np.pi * np.array(freq)
    zeta = np.array([1.5, 0.01, 0.02, 0.03, 0.001])[: omega.size]
    points = {name: rng.normal(size=omega.size) for name in "ab"}
    return ModalBasis.real(omega, zeta * omega, points, residual=residual)


def complex_component():
    """Its underdamped modes, their shapes turned against each other, and two first-order ones."""
    real = component()
    kept = real.select(np.flatnonzero(real.kind == PAIR), fold=False)
    turn = np.exp(0.3j * np.arange(kept.n_modes))
    right, left = (dict(zip("ab", shapes * turn**k, strict=True)) for shapes, k in ((kept.right, 1), (kept.left, -1)))
    for side, shapes in ((right, (0.02, 0.02)), (left, (0.02, -0.02))):
        side.update({name: np.append(shape, shapes) for name, shape in side.items()})
    return ModalBasis.complex(np.append(kept.poles, (-300.0, -500.0)), right, left)


def in_parallel(basis, impedance):
    """(2, 2, n) mobility with lumps of impedance Z = f / v on both points: Y (1 + Z Y)^-1."""
    Y = np.array([[basis.frf(FREQ, i, j) for j in "ab"] for i in "ab"])
    out = np.empty_like(Y)
    for n in range(FREQ.size):
        Z = np.diag(impedance[:, n])
        out[..., n] = Y[..., n] @ sla.inv(np.eye(2) + Z @ Y[..., n])
    return out


def close(basis, wanted, tolerance):
    found = np.array([[basis.frf(FREQ, i, j) for j in "ab"] for i in "ab"])
    assert np.abs(found - wanted).max() < tolerance * np.abs(wanted).max()


@pytest.mark.parametrize("make", [component, complex_component])
def test_mobilities_add_up_in_parallel(make):
    basis = make()
    mass, damping, stiffness = np.array([[0.02, 0.0], [0.4, 3.0], [0.0, 2e4]])
    impedance = mass[:, None] * S + damping[:, None] + stiffness[:, None] / S
    close(loaded(basis, np.eye(2), mass, damping, stiffness), in_parallel(basis, impedance), 1e-10)


def test_a_mass_lies_on_the_residual_compliance():
    basis = component(residual=[[3e-7, 1e-7], [1e-7, 2e-7]])
    made = loaded(basis, np.eye(2), [0.02, 0.01], [0.0, 0.0], [1e3, 0.0])
    impedance = np.array([0.02 * S + 1e3 / S, 0.01 * S])
    close(made, in_parallel(basis, impedance), 1e-5)


def test_a_spring_acts_on_the_modes_alone_as_a_connection_does():
    """y = Y_modes f + R f, and the spring sees the first part."""
    R = np.array([[3e-7, 1e-7], [1e-7, 2e-7]])
    made = loaded(component(residual=R), np.eye(2), 0.0, 0.0, [1e5, 0.0])
    wanted = in_parallel(component(), np.array([1e5 / S, 0 * S])) + R[..., None] * S
    close(made, wanted, 1e-5)


def test_rigid_body_modes_of_a_suspended_bar():
    """A free mass on a spring: sqrt(k/m), and a factor of a direction counts twice."""
    bar = ModalBasis.real([0.0, 3000.0], [0.0, 3.0], {"a": [1.0, 0.0]}, modal_mass=0.5)
    made = loaded(bar, [[0.6]], 0.0, 0.0, 800.0)
    assert np.sort(made.natural_freq)[0] == pytest.approx(np.sqrt(0.36 * 800.0 / 0.5) / (2 * np.pi), rel=1e-9)


def test_nothing_negative():
    with pytest.raises(ValueError, match="must not be negative"):
        loaded(component(), np.eye(2), [-0.01, 0.0], 0.0, 0.0)
