"""Phi functions, flows and states added by polynomial forces, against scipy's matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given
from hypothesis import strategies as st

from assembled import uneven
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply, flow, impulse_series, moments, phi, powers, real_form

DT = 1 / 48000


def phi_by_expm(order, z):
    """phi_0 .. phi_order from the exponential of one bidiagonal matrix."""
    big = np.diag(np.ones(order), 1).astype(complex)
    big[0, 0] = z
    return sla.expm(big)[0]


@pytest.mark.parametrize("z", [0.0, 1e-12, -1e-6 + 1e-6j, 0.3j, -0.999, 0.9999j, 1.0001j, 3.0j, -4.0 + 30j, -50.0])
def test_phi_functions_to_rounding(z):
    ours = phi(3, np.array([z]))[:, 0]
    np.testing.assert_allclose(ours, phi_by_expm(3, z), rtol=4e-14, atol=0)


def test_phi_functions_far_out():
    # expm loses digits here; the recurrence is its own closed form
    z = np.array([-1e3 + 1e3j, 1e3j, -2e4])
    ours = phi(2, z)
    np.testing.assert_allclose(ours[0], np.exp(z), rtol=1e-15)
    np.testing.assert_allclose(ours[1], (np.exp(z) - 1) / z, rtol=1e-14)
    np.testing.assert_allclose(ours[2], ((np.exp(z) - 1) / z - 1) / z, rtol=1e-14)


def test_phi_is_continuous_where_the_series_ends():
    angles = np.exp(1j * np.linspace(0, np.pi, 9))
    inside, outside = phi(3, 0.9999999999 * angles), phi(3, 1.0000000001 * angles)
    np.testing.assert_allclose(inside, outside, rtol=1e-9)


OMEGA_STEPS = [0.0, 1e-4, 0.5, np.pi * 0.9, np.pi, 40.0, 1e3]
ZETAS = [0.0, 1e-3, 0.5, 0.7, 0.999, 1.0, 1.001, 10.0]


@pytest.mark.parametrize("x", OMEGA_STEPS)
@pytest.mark.parametrize("zeta", ZETAS)
def test_flow_of_one_mode_is_its_exponential(x, zeta):
    omega = x / DT
    sigma = zeta * omega if x else zeta * 100.0
    basis = ModalBasis.real([omega], [sigma], {"a": [1.0]})
    form = real_form(basis)
    # scaled time and velocities keep scipy's own rounding small
    scale = np.diag([1.0, 1.0 if x == 0 else 1 / omega])
    A = scale @ np.array([[0, 1.0], [-(omega**2), -2 * sigma]]) @ sla.inv(scale)
    exact = sla.expm(A * DT)
    to_motion = np.stack([form.C[0, 0], form.C[0, 0] @ form.A[0]])
    ours = scale @ to_motion @ flow(basis, DT)[0, 0] @ sla.inv(scale @ to_motion)
    np.testing.assert_allclose(ours, exact, atol=2e-13 * max(1.0, x) * max(1.0, zeta))


def test_flow_of_random_complex_modes_is_that_of_the_matrices():
    part = uneven(4, seed=2, zeta=0.3)
    basis = part.complex_basis()
    form, (A, B) = real_form(basis), part.state_matrices(np.eye(4))
    dt = 7e-4
    E, exact = flow(basis, dt)[0], sla.expm(A * dt)
    # displacement after a step that follows a velocity kick at each dof
    ours = np.einsum("imx,mxy,jmy->ij", form.C, E, form.B)
    np.testing.assert_allclose(ours, (exact @ B)[:4], rtol=1e-9, atol=1e-12 * np.abs(exact @ B)[:4].max())


def test_real_form_has_the_same_response():
    basis = uneven(4, seed=9, zeta=0.4).complex_basis()
    form = real_form(basis)
    s = 2j * np.pi * 30.0
    state = np.array([sla.solve(s * np.eye(2) - A, b) for A, b in zip(form.A, form.B[1], strict=True)])
    np.testing.assert_allclose(np.sum(form.C[2] * state), basis.frf([30.0], "n2", "n1", "receptance")[0], rtol=1e-12)


def driven_exactly(A, B, start, stop, dt, coefficients, x):
    """(dt, x) flow with F = c0 + c1 tau + c2 tau^2 on [start, stop], by exponentials of an augmented matrix."""
    n = len(A)
    big = np.zeros((n + 3, n + 3))
    big[:n, :n], big[:n, n] = A, B
    big[n, n + 1] = big[n + 1, n + 2] = 1.0
    c0, c1, c2 = coefficients
    x = sla.expm(A * start) @ x
    x = (sla.expm(big * (stop - start)) @ np.concatenate([x, [c0, c1, 2 * c2]]))[:n]
    return sla.expm(A * (dt - stop)) @ x


def added(basis, start, stop, coefficients, dt=DT):
    """(n_modes, 2) of a force c0 + c1 (t - start) + c2 (t - start)^2 at the first point over a step."""
    series = impulse_series(basis, real_form(basis), 0, dt)
    (row,) = moments(np.array([start]), np.array([stop]), np.array(coefficients)[:, None], dt, len(series))
    return (row @ series.reshape(len(row), -1)).reshape(-1, 2)


@given(
    x=st.sampled_from([0.0, 1e-3, 0.3, 2.0, 9.0]),
    zeta=st.sampled_from([0.0, 0.01, 0.71, 1.0, 3.0]),
    ends=st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted),
    c=st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_what_a_polynomial_force_adds_is_exact(x, zeta, ends, c):
    omega, dt = x / DT, DT
    sigma = zeta * omega if x else 30.0 * zeta
    basis = ModalBasis.real([omega], [sigma], {"a": [1.0]})
    start, stop = ends[0] * dt, ends[1] * dt
    coefficients = (c[0], c[1] / dt, c[2] / dt**2)
    A = np.array([[0.0, 1.0], [-(omega**2), -2 * sigma]])
    # time in steps, velocity in m per step
    scale = np.diag([1.0, dt])
    expected = driven_exactly(
        scale @ A @ sla.inv(scale) * dt, np.array([0.0, dt**2]), ends[0], ends[1], 1.0, c, np.zeros(2)
    )
    form = real_form(basis)
    to_motion = np.stack([form.C[0, 0], form.C[0, 0] @ form.A[0] * dt])
    np.testing.assert_allclose(to_motion @ added(basis, start, stop, coefficients)[0], expected, atol=1e-13 * dt**2)


def test_pieces_add_up_to_the_whole():
    basis = ModalBasis.real([3e4, 1e3, 0.0], [10.0, 2e3, 1.0], {"a": [1.0, 2.0, 3.0]})
    whole = added(basis, 0.0, DT, (1.0, 2.0 / DT, -3.0 / DT**2))
    split = 0.37 * DT
    rest = (1 + 2 * 0.37 - 3 * 0.37**2, (2 - 6 * 0.37) / DT, -3 / DT**2)
    parts = added(basis, 0.0, split, (1.0, 2.0 / DT, -3.0 / DT**2)) + added(basis, split, DT, rest)
    np.testing.assert_allclose(parts, whole, rtol=1e-12, atol=1e-16 * np.abs(whole).max())


def test_constant_piece_is_the_step_of_a_held_force():
    basis = ModalBasis.real([3e4, 2e5], [10.0, 5e5], {"a": [1.0, 2.0]})
    B = real_form(basis).B[0]
    held = apply(DT * flow(basis, DT)[1], B)
    np.testing.assert_allclose(added(basis, 0.0, DT, (1.0, 0.0, 0.0)), held, rtol=1e-13)


@pytest.mark.parametrize(("dt", "ends"), [(DT, (0.21, 0.83)), (20 * DT, (0.21, 0.83)), (2.8 * DT, (0.0, 1.0))])
def test_what_strings_get_is_what_phi_functions_say(dt, ends):
    """Pairs up to 0.45 of the sampling rate, just before a second cell is full, and far beyond it."""
    basis = ModalBasis.real(2 * np.pi * np.geomspace(20, 21600, 40), np.geomspace(0.1, 900, 40), {"a": np.ones(40)})
    start, stop, c = ends[0] * dt, ends[1] * dt, (1.0, -3.0 / dt, 5.0 / dt**2)
    d = stop - start
    _, p1, p2, p3 = phi(3, basis.poles * d)
    z = np.exp(basis.poles * (dt - stop)) * d * (c[0] * p1 + d * c[1] * p2 + 2 * d**2 * c[2] * p3) * basis.left[0]
    np.testing.assert_allclose(added(basis, start, stop, c, dt) @ [1.0, 1j], z, rtol=1e-12)


def test_powers_are_repeated_steps():
    rng = np.random.default_rng(3)
    blocks, x = rng.standard_normal((5, 2, 2)), rng.standard_normal((3, 5, 2))
    expected = [x]
    for _ in range(10):
        expected.append(np.einsum("mxy,pmy->pmx", blocks, expected[-1]))
    np.testing.assert_allclose(powers(blocks, x, 11), expected, rtol=1e-12, atol=1e-12)
    assert powers(blocks, x, 1).shape == (1, 3, 5, 2)
