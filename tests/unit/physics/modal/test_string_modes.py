"""The string basis against closed forms: static shape, free-end frequencies, Green's function."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.physics.modal.string_modes import held_string_compliance, string_basis

A2 = {"length": 0.65, "tension": 73.9, "linear_density": 3.61e-3, "bending_stiffness": 4e-5}


def lossless(omega, k):
    return np.zeros_like(omega)


def test_static_law_fixes_the_sign_of_the_ramp_coupling():
    basis = string_basis(**A2, loss=lossless, n_modes=60).with_places({"at": 0.2})
    # a force at the free bridge end turns the string into a straight line, whatever its stiffness
    assert basis.static_compliance()[0, 1] == pytest.approx((0.65 - 0.2) / 73.9, rel=1e-9)
    assert basis.static_compliance()[0, 0] == pytest.approx(0.65 / 73.9, rel=1e-9)


def test_static_compliance_between_inner_places_is_the_closed_form():
    basis = string_basis(**A2, loss=lossless, n_modes=40).with_places({"a": 0.2, "b": 0.31})
    ramp = (0.65 - 0.2) * (0.65 - 0.31) / 0.65 / 73.9
    expected = ramp + held_string_compliance(0.2, 0.31, 0.65, 73.9, 4e-5)
    assert basis.static_compliance()[1, 2] == pytest.approx(expected, rel=1e-9)


def test_held_string_compliance_is_the_sum_over_sines():
    k = np.arange(1, 200_001) * np.pi / 0.65
    series = 2 / 0.65 * np.sum(np.sin(k * 0.1) * np.sin(k * 0.4) / (73.9 * k**2 + 4e-5 * k**4))
    assert held_string_compliance(0.1, 0.4, 0.65, 73.9, 4e-5) == pytest.approx(series, rel=1e-10)
    # near an end and near each other the stiffness counts, by 1 to 60 %
    for x, y in ((0.02, 0.02), (0.003, 0.004), (0.001, 0.0012), (0.6495, 0.649)):
        series = 2 / 0.65 * np.sum(np.sin(k * x) * np.sin(k * y) / (73.9 * k**2 + 4e-4 * k**4))
        assert held_string_compliance(x, y, 0.65, 73.9, 4e-4) == pytest.approx(series, rel=1e-8)
    assert held_string_compliance(0.4, 0.1, 0.65, 73.9, 0.0) == pytest.approx(0.1 * 0.25 / 0.65 / 73.9, rel=1e-14)


def test_free_end_frequencies_of_the_ideal_string():
    basis = string_basis(0.65, 73.9, 3.61e-3, 0.0, lossless, n_modes=120)
    c = np.sqrt(73.9 / 3.61e-3)
    expected = (2 * np.arange(1, 21) - 1) * c / (4 * 0.65)
    # Ritz values lie above and fall towards the true ones
    error = basis.natural_freq[:20] / expected - 1
    assert np.all(error > -1e-10)
    assert np.all(error < 2e-5)
    finer = string_basis(0.65, 73.9, 3.61e-3, 0.0, lossless, n_modes=240).natural_freq[:20] / expected - 1
    assert np.all(finer < error / 6)  # third order in the number of modes


def test_modes_are_orthonormal_in_the_mass():
    basis = string_basis(**A2, loss=lossless, n_modes=30)
    x, w = np.polynomial.legendre.leggauss(200)
    shapes = np.array([basis.shape(0.325 * (1 + xi)) for xi in x])
    gram = 3.61e-3 * 0.325 * (shapes * w[:, None]).T @ shapes
    np.testing.assert_allclose(gram, np.eye(30), atol=1e-10)


def test_residual_at_the_bridge_is_exactly_zero():
    basis = string_basis(**A2, loss=lossless, n_modes=25).with_places({"x": 0.3})
    assert np.all(basis.residual[0] == 0.0)
    assert basis.residual[1, 1] > 0


def test_every_mode_lies_below_the_limit_and_one_more_would_not():
    basis = string_basis(**A2, loss=lossless, freq_upper=20000.0)
    larger = string_basis(**A2, loss=lossless, n_modes=basis.n_modes + 1)
    assert basis.natural_freq[-1] <= 20000.0 < larger.natural_freq[-1]


def test_parts_of_the_frequency():
    basis = string_basis(**A2, loss=lossless, n_modes=25)
    parts = 73.9 * basis.metadata["tension_part"] + 4e-5 * basis.metadata["bending_part"]
    np.testing.assert_allclose(parts, basis.stiffness, rtol=1e-10)


@pytest.mark.parametrize("n_modes", [1, 2, 3, 40, 300])
@pytest.mark.parametrize("stiffness", [0.0, 4e-5, 4e-2])
def test_modes_are_those_of_the_dense_eigenproblem(n_modes, stiffness):
    length, tension, density = 0.65, 73.9, 3.61e-3
    basis = string_basis(length, tension, density, stiffness, lossless, n_modes=n_modes)
    k = np.arange(1, n_modes) * np.pi / length
    K = np.diag(np.concatenate([[tension / length], length / 2 * (tension * k**2 + stiffness * k**4)]))
    M = density * np.diag(np.concatenate([[length / 3], np.full(n_modes - 1, length / 2)]))
    M[0, 1:] = M[1:, 0] = density / k
    scale = 1 / np.sqrt(np.diag(K))
    inverse = sla.eigvalsh(scale[:, None] * M * scale)[::-1]
    np.testing.assert_allclose(1 / basis.stiffness, inverse, rtol=1e-11)
    vec = basis.metadata["vec"]
    np.testing.assert_allclose(vec.T @ M @ vec, np.eye(n_modes), atol=1e-11)
    np.testing.assert_allclose(vec.T @ K @ vec / basis.stiffness, np.eye(n_modes), atol=1e-8)
    assert np.all(vec[0] > 0)  # the sign of a mode is that of its motion at the bridge


@pytest.mark.parametrize("bad", [{"freq_upper": 20.0}, {"n_modes": 0}, {}, {"freq_upper": 1e4, "n_modes": 3}])
def test_impossible_requests_are_refused(bad):
    with pytest.raises(ValueError, match="string"):
        string_basis(**A2, loss=lossless, **bad)
