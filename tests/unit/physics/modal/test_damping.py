"""Damping cases against second-order systems solved directly, and against scipy's Riccati solver."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.physics.modal.damping import (
    damping_groups,
    hermitian_mass_inverse,
    phase_collinearity,
    proper_shapes,
    reciprocal_shapes,
    separation,
    with_damping_case,
)
from tonewood.physics.modal.modes import ModalBasis


def body(n, seed, coupling=1.0, spread=1.0):
    """M, C, K of a chain with uneven dashpots."""
    rng = np.random.default_rng(seed)
    M = np.diag(rng.uniform(0.5, 2.0, n))
    k = 100.0 * rng.uniform(0.5, 2.0, n) * spread ** np.arange(n)
    link = np.eye(n) - np.eye(n, k=-1)
    K = link.T @ np.diag(k) @ link
    C = coupling * link.T @ np.diag(rng.uniform(0.0, 2.0, n)) @ link
    return M, C, K


def pairs_of_modes(seed):
    """M, C, K with two pairs of close frequencies and dashpots that couple everything."""
    rng = np.random.default_rng(seed)
    omega = np.array([20.0, 20.8, 40.0, 41.0])
    phi, _ = sla.qr(rng.normal(size=(4, 4)))
    dashpots = phi.T @ np.diag([0.0, 0.2, 1.0, 1.8]) @ phi
    return np.eye(4), phi @ dashpots @ phi.T, phi @ np.diag(omega**2) @ phi.T


def modes_of(M, C, K):
    n = len(M)
    inverse = sla.inv(M)
    values, vectors = sla.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]]))
    up = values.imag > 0
    assert up.sum() == n
    poles, psi = values[up], vectors[:n, up]
    order = np.argsort(np.abs(poles))
    poles, psi = poles[order], psi[:, order]
    norm = np.einsum("ik,ij,jk->k", psi, C, psi) + 2 * poles * np.einsum("ik,ij,jk->k", psi, M, psi)
    return poles, psi, norm


def basis_of(matrices, rows=None):
    poles, psi, norm = modes_of(*matrices)
    rows = range(len(psi)) if rows is None else rows
    return ModalBasis.complex(poles, {f"p{i}": psi[i] for i in rows}, norm=norm)


def test_collinearity_of_known_shapes():
    u = np.array([[1.0, 1.0, 1.0, 0.0], [2.0, 1j, 1 + 1j, 0.0]])
    # real; circular; |1 + 2i| / 3 squared; empty
    np.testing.assert_allclose(phase_collinearity(u), [1.0, 0.0, 5 / 9, 1.0], atol=1e-15)
    np.testing.assert_allclose(phase_collinearity(np.exp(0.7j) * u), phase_collinearity(u), atol=1e-15)


def test_separation_and_groups_of_a_written_example():
    basis = ModalBasis.real([100.0, 101.0, 200.0, 300.0, 305.0], [0.2, 0.2, 0.5, 2.0, 0.0], {"p": np.ones(5)})
    matrix = separation(basis)
    assert matrix[0, 1] == pytest.approx(0.4 / 1.0)
    assert matrix[3, 4] == pytest.approx(4.0 / 5.0)
    assert matrix[4, 3] == 0.0
    assert np.all(np.isinf(np.diag(matrix)))
    groups = damping_groups(basis)
    assert [g.tolist() for g in groups] == [[0, 1], [2], [3, 4]]
    # 4.0 / 100 links 200 and 300 rad/s at a lower threshold
    assert [g.tolist() for g in damping_groups(basis, 0.03)] == [[0, 1], [2, 3, 4]]
    with pytest.raises(ValueError, match="threshold"):
        damping_groups(basis, 0.0)


@pytest.mark.parametrize("case", ["complex", "proportional", "block"])
def test_proportional_damping_is_left_alone(case):
    M, _, K = body(6, 1)
    given = basis_of((M, 0.1 * M + 0.002 * K, K))
    got = with_damping_case(given, case)
    f = np.linspace(0.1, 4.0, 50)
    np.testing.assert_allclose(got.frf(f, "p0", "p3"), given.frf(f, "p0", "p3"), rtol=1e-9)
    assert np.array_equal(got.poles, given.poles)


def test_block_of_all_modes_is_the_complex_case():
    given = basis_of(body(5, 2))
    got = with_damping_case(given, "block", threshold=1e-6)
    assert len(damping_groups(given, 1e-6)) == 1
    np.testing.assert_allclose(got.right * got.left, given.right * given.left, atol=1e-13)


def test_block_of_single_modes_is_the_proportional_case():
    given = basis_of(body(5, 2))
    single, proportional = with_damping_case(given, "block", threshold=1e6), with_damping_case(given, "proportional")
    np.testing.assert_allclose(single.right * single.left, proportional.right * proportional.left, atol=1e-15)


def test_proportional_case_is_the_printed_formula_and_a_real_basis():
    given = basis_of(body(5, 3, coupling=2.0))
    got = with_damping_case(given, "proportional")
    normal, _ = reciprocal_shapes(given)
    root = np.sqrt(2j * given.poles.imag)
    false = (normal * root).real / root
    np.testing.assert_allclose(got.right * got.left, false**2, atol=1e-15)
    np.testing.assert_allclose(phase_collinearity(got.right), 1.0, atol=1e-12)
    # a second-order system with diagonal damping: the same FRF from phi, omega, sigma
    phi = (normal * root).real
    s = 2j * np.pi * np.linspace(0.2, 4.0, 7)
    modal = phi[0] * phi[2] / (s[:, None] ** 2 - 2 * s[:, None] * given.poles.real + np.abs(given.poles) ** 2)
    np.testing.assert_allclose(got.frf(s.imag / (2 * np.pi), "p0", "p2", "receptance"), modal.sum(axis=1), rtol=1e-11)


def test_falsely_complex_modes_are_a_real_basis():
    got = with_damping_case(basis_of(body(5, 3, coupling=2.0)), "proportional")
    assert got.is_real
    assert with_damping_case(got, "proportional") is got
    M, _, K = body(4, 1)
    phi = sla.eigh(K, M)[1]
    given = ModalBasis.real(np.sqrt(sla.eigh(K, M, eigvals_only=True)), 0.1, {"a": phi[0], "b": phi[2]})
    for case in ("proportional", "block"):
        assert with_damping_case(given, case) is given


def test_block_lies_between_the_other_two():
    given = basis_of(pairs_of_modes(4))
    assert [g.tolist() for g in damping_groups(given)] == [[0, 1], [2, 3]]
    f = np.linspace(1.0, 10.0, 4000)
    true = given.frf(f, "p1", "p2")
    error = {
        case: float(sla.norm(with_damping_case(given, case).frf(f, "p1", "p2") - true) / sla.norm(true))
        for case in ("proportional", "block")
    }
    assert error["proportional"] > 0.05
    assert 0 < error["block"] < 0.2 * error["proportional"]


def test_nearest_proper_shapes_solve_the_riccati_equation(rng):
    given = basis_of(body(7, 5, coupling=2.0))
    psi, _ = reciprocal_shapes(given)
    psi = psi[:4, :6]  # fewer points than modes: X X^T is regular
    X, Y = psi.real, psi.imag
    W = sla.solve_continuous_are(np.zeros((4, 4)), X, Y @ Y.T, np.eye(6))
    eye = np.eye(4)
    expected = 0.5 * ((eye + W) @ X + 1j * (eye + sla.inv(W)) @ Y)
    got = proper_shapes(psi).shapes
    np.testing.assert_allclose(got, expected, atol=1e-12)
    np.testing.assert_allclose((got @ got.T).real, 0.0, atol=1e-15)
    # least: no proper neighbour is nearer
    best = sla.norm(got - psi)
    p = proper_shapes(psi)
    for _ in range(20):
        skew = rng.normal(size=(6, 6))
        U = p.U @ sla.expm(1e-3 * (skew - skew.T))
        A = 0.5 * (X + Y @ U.T)
        assert sla.norm(A + 1j * A @ U - psi) >= best


def principal_form(poles, proper):
    """omega, C and phi of q'' + C q' + diag(omega^2) q = phi^T f, y = phi q: the system of these modes (Balmes 1997).

    With Q = I + iU and Pi = 1: M^-1 = 2 Re(Q L Q^T), K^-1 = -2 Re(Q L^-1 Q^T), C = -2 M Re(Q L^2 Q^T) M.
    """
    Q = np.eye(len(poles)) + 1j * proper.U
    first, inverse, second = (2 * ((Q * poles**power) @ Q.T).real for power in (1, -1, 2))
    M = sla.inv(first)
    omega2, V = sla.eigh(sla.inv(-inverse), M)
    return np.sqrt(omega2), -V.T @ M @ second @ M @ V, proper.A @ V


def test_principal_form_gives_back_the_body():
    M, C, K = body(5, 6, coupling=2.0)
    poles, psi, norm = modes_of(M, C, K)
    omega, damping, phi = principal_form(poles, proper_shapes(psi / np.sqrt(norm)))
    np.testing.assert_allclose(omega**2, sla.eigh(K, M, eigvals_only=True), rtol=1e-10)
    np.testing.assert_allclose(phi @ phi.T, sla.inv(M), atol=1e-12)
    np.testing.assert_allclose(M @ phi @ damping @ phi.T @ M, C, atol=1e-10)


def test_group_is_a_second_order_system_with_its_poles():
    given = basis_of(pairs_of_modes(4))
    normal, _ = reciprocal_shapes(given)
    for group in damping_groups(given):
        omega, damping, _ = principal_form(given.poles[group], proper_shapes(normal[:, group]))
        n = len(group)
        values = sla.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -damping]]))
        np.testing.assert_allclose(
            np.sort_complex(values[values.imag > 0]), np.sort_complex(given.poles[group]), rtol=1e-9
        )


def test_hermitian_modal_mass_of_a_known_body():
    M, C, K = body(5, 7, coupling=2.0)
    poles, psi, norm = modes_of(M, C, K)
    np.testing.assert_allclose(hermitian_mass_inverse(psi, poles, norm), sla.inv(psi.conj().T @ M @ psi), rtol=1e-9)
    # M^-1 = psi M_h^-1 psi^H (Eq. 28)
    np.testing.assert_allclose(psi @ hermitian_mass_inverse(psi, poles, norm) @ psi.conj().T, sla.inv(M), atol=1e-12)
    with pytest.raises(ValueError, match="points"):
        hermitian_mass_inverse(psi[:4], poles, norm)


def test_normalisation_does_not_matter():
    given = basis_of(body(5, 8, coupling=2.0))
    factor = np.array([2.0, 1j, 0.3 - 0.4j, -1.0, 5.0])
    scaled = ModalBasis.complex(
        given.poles,
        {p: given.right[i] * factor for i, p in enumerate(given.points)},
        {p: given.left[i] / factor for i, p in enumerate(given.points)},
    )
    for case in ("proportional", "block"):
        a, b = with_damping_case(given, case, 0.4), with_damping_case(scaled, case, 0.4)
        np.testing.assert_allclose(a.right * a.left, b.right * b.left, atol=1e-14)


def test_acoustic_points_keep_their_quarter_period():
    # an undamped plate and cavity: gyroscopic coupling, every mode real but for the quarter period of Eq. 10
    M, K = np.diag([0.031, 2.7e-7]), np.diag([2.2e4, 0.12])
    G = np.array([[0.0, -0.036], [0.036, 0.0]])
    n = 2
    values, vectors = sla.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-sla.inv(M) @ K, -sla.inv(M) @ G]]))
    up = values.imag > 0
    poles, psi = values[up].imag * 1j, vectors[:n, up]
    psi_l = psi * np.array([[1.0], [-1.0]])
    norm = np.einsum("ik,ij,jk->k", psi_l, G, psi) + 2 * poles * np.einsum("ik,ij,jk->k", psi_l, M, psi)
    given = ModalBasis.complex(poles, {"plate": psi[0], "air": psi[1]}, norm=norm, acoustic=("air",))
    assert reciprocal_shapes(given)[1].tolist() == [1.0, -1.0]
    for case in ("proportional", "block"):
        got = with_damping_case(given, case)
        for out, into in (("plate", "plate"), ("air", "plate"), ("plate", "air"), ("air", "air")):
            f = np.array([30.0, 120.0])
            np.testing.assert_allclose(got.frf(f, out, into), given.frf(f, out, into), rtol=1e-9)


def test_shapes_that_are_not_reciprocal_are_refused():
    given = basis_of(body(3, 9))
    skewed = ModalBasis.complex(
        given.poles,
        {p: given.right[i] for i, p in enumerate(given.points)},
        {p: given.left[i] * (1 + 0.1 * i) for i, p in enumerate(given.points)},
    )
    with pytest.raises(ValueError, match="'p1' are not reciprocal"):
        with_damping_case(skewed, "proportional")
    with pytest.raises(ValueError, match="damping case"):
        with_damping_case(given, "hysteretic")
