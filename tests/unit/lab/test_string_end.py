"""The exact string end against series of modes, limits and symmetry."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.lab.assembled import Matrices
from tonewood.lab.string_end import ExactString, coupled_pole

STIFF = ExactString(0.64, 8.86, 7.96e-4, 3.09e-4, 0.5)
IDEAL = ExactString(0.64, 8.86, 7.96e-4)


def series(string, s, n=20_000):
    """End stiffness from fixed-base sines and the ramp: T/L + mu L s^2/3 - sum (b s^2)^2 / (m s^2 + k)."""
    k = np.arange(1, n + 1) * np.pi / string.length
    inertia = string.linear_density * (s**2 + 2 * string.sigma0 * s)
    held = string.length / 2 * (string.tension * k**2 + string.bending_stiffness * k**4 + inertia)
    return string.tension / string.length + inertia * string.length / 3 - np.sum((inertia / k) ** 2 / held)


@pytest.mark.parametrize("string", [STIFF, IDEAL])
@pytest.mark.parametrize("s", [10.0 + 0j, -0.3 + 300j, 5.0 + 2000j, -1.0 + 30000j])
def test_end_stiffness_is_the_sum_over_modes(string, s):
    assert 1 / string.end_receptance(s) == pytest.approx(series(string, s), rel=2e-4)


def test_ideal_string_is_the_coth():
    s = -0.4 + 800j
    c = np.sqrt(8.86 / 7.96e-4)
    assert IDEAL.end_receptance(s) == pytest.approx(np.tanh(s * 0.64 / c) / (IDEAL.impedance * s), rel=1e-13)
    nearly = ExactString(0.64, 8.86, 7.96e-4, 1e-12)
    assert nearly.end_receptance(s) == pytest.approx(IDEAL.end_receptance(s), rel=1e-5)


def test_static_end_is_the_straight_line():
    slow = 1e-3 + 0j
    string = ExactString(0.64, 8.86, 7.96e-4, 3.09e-4)
    assert string.end_receptance(slow) == pytest.approx(0.64 / 8.86, rel=1e-9)
    assert string.transfer(slow, 0.16) == pytest.approx(0.75, rel=1e-9)


@pytest.mark.parametrize("string", [STIFF, IDEAL])
def test_transfer_satisfies_the_string_equation(string):
    s, x, h = -1 + 500j, 0.2, 2e-3
    u = np.array([string.transfer(s, x + i * h) for i in (-2, -1, 0, 1, 2)])
    second = (-u[0] + 16 * u[1] - 30 * u[2] + 16 * u[3] - u[4]) / (12 * h**2)
    fourth = (u[0] - 4 * u[1] + 6 * u[2] - 4 * u[3] + u[4]) / h**4
    inertia = string.linear_density * (s**2 + 2 * string.sigma0 * s) * u[2]
    left = string.bending_stiffness * fourth - string.tension * second + inertia
    assert abs(left) < 1e-4 * abs(inertia)
    assert string.transfer(s, 0.0) == pytest.approx(1.0, abs=1e-12)
    assert abs(string.transfer(s, string.length)) < 1e-12


def test_coupled_pole_on_a_spring_and_on_a_wall():
    # a very stiff spring: the held string, n f0 sqrt(1 + B n^2)
    for n in (1, 7):
        pole = coupled_pole(STIFF, lambda s: 1e-12, n)
        assert abs(pole) == pytest.approx(2 * np.pi * STIFF.held_freq(n), rel=1e-8)
        assert pole.real == pytest.approx(-0.5, rel=1e-6)
    # ideal string on a spring k: tan(w L / c) = -Z0 w / k
    k = 2e4
    pole = coupled_pole(IDEAL, lambda s: 1 / k, 3)
    w = pole.imag
    assert abs(pole.real) < 1e-6
    assert np.tan(w * 0.64 / np.sqrt(8.86 / 7.96e-4)) == pytest.approx(-IDEAL.impedance * w / k, rel=1e-8)


def test_an_assembled_string_on_a_body_that_does_not_move_has_the_frequencies_of_one_that_is_held():
    """f_n = n f0 sqrt(1 + B n^2); the direction of a force is the shape of the sines at its place."""
    heavy = Matrices(np.array([[1e6]]), np.zeros((1, 1)), np.array([[1e14]]))
    whole, pluck = STIFF.assembled(12, heavy, np.array([1.0]), 0.25)
    squares = sla.eigh(whole.K, whole.M, eigvals_only=True)
    held = [STIFF.held_freq(n) for n in range(1, 7)]
    found = np.sqrt(squares) / (2 * np.pi)
    assert [found[np.argmin(np.abs(found - f))] for f in held] == pytest.approx(held, rel=1e-5)
    np.testing.assert_allclose(pluck, [*np.sin(np.arange(1, 13) * np.pi / 4), 0.75], atol=1e-12)
    np.testing.assert_allclose(whole.C[:12, :12], 2 * STIFF.sigma0 * whole.M[:12, :12])
