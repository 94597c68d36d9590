"""The passivity check against closed forms, complete systems, and dense sweeps that share no code with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg, optimize

from random_bodies import DAMPING, body, held_step, solve, state_space
from tonewood.errors import PassivityError
from tonewood.physics.modal.mobility import mobility
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.basis import check_basis
from tonewood.physics.passivity.conditions import TOLERANCE, check, signature_changes


def real_modes(rng, n=30, n_ports=4, zeta=0.01, low=80.0, high=8000.0):
    omega = 2 * np.pi * np.sort(rng.uniform(low, high, n))
    phi = rng.standard_normal((n_ports, n))
    damped = omega * np.sqrt(1 - zeta**2)
    return -zeta * omega + 1j * damped, phi + 0j, phi * (-0.5j / damped)


def smallest_by_sweep(modes, omega):
    """Smallest eigenvalue of the Hermitian part of Y over |Y|, term by term."""
    poles, right, left = modes
    Y = np.zeros((omega.size, right.shape[0], right.shape[0]), dtype=complex)
    for pole, r, l_ in zip(poles, right.T, left.T, strict=True):
        residue = np.outer(r, l_)
        Y += (1j * omega / (1j * omega - pole))[:, None, None] * residue
        if pole.imag:
            Y += (1j * omega / (1j * omega - pole.conj()))[:, None, None] * residue.conj()
    hermitian = 0.5 * (Y + Y.conj().transpose(0, 2, 1))
    values = np.array([linalg.eigvalsh(one)[0] for one in hermitian])
    return values / np.sqrt((np.abs(Y) ** 2).sum(axis=(1, 2)))


def test_real_modes_are_passive_one_by_one(rng):
    for zeta in (0.0, 1e-6, 0.01, 0.9):
        report = check(*real_modes(rng, zeta=zeta), dt=1 / 48000)
        assert report.passive
        assert report.method == "each mode"
        assert report.step_compliance_min >= -1e-12


def test_overdamped_mode_is_passive_as_two_real_poles():
    # q'' + 50 q' + 400 q = f / 0.1: poles -10 and -40
    poles = np.array([-10.0, -40.0])
    right = np.array([[1.0, 1.0], [0.3, 0.3]])
    left = right * np.array([1, -1]) / (0.1 * 30.0)
    report = check(poles, right, left)
    assert report.passive
    assert report.method == "each mode"
    assert not check(poles, right, -left).passive


def test_complete_lists_are_passive():
    for kind, zeta in DAMPING.items():
        for seed in range(3):
            report = check(*body(seed, zeta).modes, dt=1 / 48000)
            assert report.passive, (kind, seed, report.summary())
            assert report.method == "pencil"
            assert report.direct_term < 1e-11


def test_complete_lists_with_real_poles_are_passive():
    modes = body(2, 0.25, n_dof=16).modes
    assert np.sum(modes[0].imag == 0) == 2
    assert check(*modes, dt=1 / 48000).passive


def test_mobility_is_that_of_the_matrices():
    one = body(3, 0.02, n_dof=12)
    omega = 2 * np.pi * np.array([1.0, 90.0, 1234.5, 7000.0, 2e5])
    np.testing.assert_allclose(mobility(*one.modes, omega), one.mobility(omega), rtol=1e-7, atol=1e-12)


def test_structure_with_a_cavity_is_passive():
    # Fabre et al. Eq 8: mass [[Ms, 0], [L^T, Ma]], stiffness [[Ks, -L], [0, Ka]]: left shapes are not the right ones
    one = body(4, 0.02, n_dof=10, n_ports=2, low=80, high=900)
    rng = np.random.default_rng(8)
    n, cavity = 10, 2
    L = rng.standard_normal((n, cavity)) * 0.05
    Ma, Ka, Ca = np.diag([2e-6, 3e-6]), np.diag([1.0, 5.0]), np.diag([1e-5, 2e-5])
    zero = np.zeros((n, cavity))
    M = np.block([[one.M, zero], [L.T, Ma]])
    K = np.block([[one.K, -L], [zero.T, Ka]])
    C = linalg.block_diag(one.C, Ca)
    A = np.block([[np.zeros((12, 12)), np.eye(12)], [-linalg.solve(M, K), -linalg.solve(M, C)]])
    lam, vl, vr = linalg.eig(A, left=True)
    up = np.flatnonzero(lam.imag > 0)
    assert up.size == 12
    # x' = A x + [0; M^-1 D^T] f, and vl^H A = lam vl^H
    right = one.ports @ vr[:n, up]
    force = np.concatenate([np.zeros((12, 2)), linalg.solve(M, np.concatenate([one.ports.T, np.zeros((2, 2))]))])
    left = ((vl[:, up].conj().T @ force) / np.einsum("ik,ik->k", vl[:, up].conj(), vr[:, up])[:, None]).T
    assert check(lam[up], right, left, dt=1 / 48000).passive
    # the sign that reciprocity would give the cavity's work makes a body that is not passive
    wrong = np.block([[one.M, zero], [-L.T, Ma]])
    A = np.block([[np.zeros((12, 12)), np.eye(12)], [-linalg.solve(wrong, K), -linalg.solve(wrong, C)]])
    lam, vl, vr = linalg.eig(A, left=True)
    up = np.flatnonzero(lam.imag > 0)
    right = one.ports @ vr[:n, up]
    left = ((vl[:, up].conj().T @ force) / np.einsum("ik,ik->k", vl[:, up].conj(), vr[:, up])[:, None]).T
    assert not check(lam[up], right, left).passive


@pytest.mark.parametrize("kind", list(DAMPING))
def test_truncated_lists_fail_where_a_dense_sweep_says(kind):
    modes = body(2, DAMPING[kind]).truncated()
    report = check(*modes)
    assert not report.passive
    assert report.direct_min < -1e-5
    highest = 30 * np.abs(modes[0]).max()
    omega = np.unique(np.concatenate([np.geomspace(1e-3 * np.abs(modes[0]).min(), highest, 6001), modes[0].imag]))
    negative = smallest_by_sweep(modes, omega) < -1e-8
    found = np.zeros_like(negative)
    for band in report.violations:
        found |= (omega > band.lower_hz * 2 * np.pi) & (omega < band.upper_hz * 2 * np.pi)
    # only grid points next to an edge of a band may differ
    assert np.sum(negative != found) <= 4 * len(report.violations)


def test_bands_do_not_depend_on_units_of_ports_or_states(rng):
    poles, right, left = body(1, 0.015).truncated()
    expected = check(poles, right, left)
    units, states = np.array([1e-4, 1.0, 1e5])[:, None], rng.uniform(1e-3, 1e3, poles.size)
    got = check(poles, right * units * states, left * units / states)
    assert len(got.violations) == len(expected.violations)
    for a, b in zip(got.violations, expected.violations, strict=True):
        assert a.lower_hz == pytest.approx(b.lower_hz, rel=1e-6)
        assert a.size == pytest.approx(b.size, rel=1e-4)


@given(st.floats(-8, -4), st.floats(-3, 0), st.floats(150, 9000), st.integers(0, 10**6))
def test_narrow_violations_are_found_with_their_edges(log_zeta, log_excess, freq, seed):
    """A weak mode of negative mass in a damped body: Re Y < 0 between the roots of x^2 + g x - excess.

    Near its pole, a mode of strength a adds -a / (2 sigma (1 + x^2)) to Re Y, x = (omega - omega_d) / sigma; there,
    Re Y of the body alone is in proportion to 1 + g x. The tolerated share of |Y|, nearly all imaginary, comes off
    the excess.
    """
    zeta, excess = 10**log_zeta, 10**log_excess
    poles, right, left = real_modes(np.random.default_rng(seed), n=12, n_ports=1, zeta=0.03)
    omega = 2 * np.pi * freq
    around = mobility(poles, right, left, [omega * (1 - zeta), omega, omega * (1 + zeta)])[:, 0, 0]
    below, level, above = around.real
    strength = 2 * zeta * omega * level * (1 + excess)
    modes = (
        np.append(poles, omega * (1j - zeta)),
        np.append(right, [[1.0]], axis=1),
        np.append(left, [[strength * 0.5j / omega]], axis=1),
    )
    report = check(*modes)
    assert len(report.violations) == 1
    band = report.violations[0]
    g = (above - below) / (2 * level)
    half = np.sqrt(excess - TOLERANCE * abs(around[1].imag) / level + g**2 / 4)
    assert band.upper_hz - freq == pytest.approx((half - g / 2) * zeta * freq, rel=0.01, abs=2e-12 * freq)
    assert freq - band.lower_hz == pytest.approx((half + g / 2) * zeta * freq, rel=0.01, abs=2e-12 * freq)


def test_active_bodies_fail_at_the_right_frequency(rng):
    poles, right, left = real_modes(rng, n=8, zeta=0.01)
    grows = poles.copy()
    grows[3] = -poles[3].conjugate()  # negative damping
    report = check(grows, right, left)
    assert [round(f, 6) for f, _ in report.unstable] == [round(poles[3].imag / 2 / np.pi, 6)]
    assert report.unstable[0][1] == pytest.approx(-poles[3].real)
    grows[1] = -0.1 * poles[1].conjugate()
    fastest = max((p for p in grows if p.real > 0), key=lambda p: p.real)
    said = f"2 pole(s) grow, fastest {fastest.imag / 2 / np.pi:.6g} Hz at {fastest.real:.3g} 1/s"
    assert said in check(grows, right, left).faults
    negative = left.copy()
    negative[:, 5] *= -1  # negative mass
    report = check(poles, right, negative)
    centre = poles[5].imag / 2 / np.pi
    assert any(band.lower_hz < centre < band.upper_hz for band in report.violations)
    assert not report.unstable


def test_undamped_poles_need_positive_residues(rng):
    poles, right, left = real_modes(rng, n=6, n_ports=2, zeta=0.0)
    turn = np.exp(0.3j)
    assert check(poles, right * turn, left / turn).passive  # normalisation is free
    bad = left.copy()
    bad[:, 2] *= turn
    report = check(poles, right, bad)
    assert [band.worst_hz for band in report.violations] == pytest.approx([poles[2].imag / 2 / np.pi])
    reversed_sign = left.copy()
    reversed_sign[:, 2] *= -1  # Hermitian, but negative
    report = check(poles, right, reversed_sign)
    assert [band.worst_hz for band in report.violations] == pytest.approx([poles[2].imag / 2 / np.pi])
    # without damping C = 0 the complex modes are those of M and K, found to rounding
    one = body(1, 0.0, n_dof=12)
    assert check(*one.modes).passive


def test_full_lists_must_be_closed_under_conjugation(rng):
    poles, right, left = body(0, 0.015, n_dof=12).truncated()
    full = [np.concatenate([a, np.conj(a)], axis=-1) for a in (poles, right, left)]
    order = rng.permutation(2 * poles.size)
    shuffled = [a[..., order] for a in full]
    half, whole = check(poles, right, left), check(*shuffled)
    assert whole.conjugate_misfit < 1e-12
    assert whole.worst == pytest.approx(half.worst)
    shuffled[2] = shuffled[2].copy()
    shuffled[2][:, 4] *= 1.01
    assert check(*shuffled).conjugate_misfit == pytest.approx(0.01, rel=0.02)
    assert "conjugates" in check(*shuffled).summary()
    assert check(*(a[..., :-1] for a in full)).conjugate_misfit == np.inf


def test_ports_that_are_driven_but_do_not_move(rng):
    poles, right, left = real_modes(rng, n=6, n_ports=2)
    right = np.concatenate([right, np.zeros((1, 6))])
    left = np.concatenate([left, left[:1]])
    report = check(poles, right, left)
    assert (report.right_rank, report.left_rank, report.ranks_agree) == (2, 2, False)
    assert not report.passive
    # a direction that is neither driven nor seen is no fault
    left[2] = 0.0
    assert check(poles, right, left).passive


def test_dependent_ports_are_no_fault(rng):
    one = body(5, 0.02, n_dof=12, n_ports=2)
    poles, right, left = one.modes
    mix = rng.standard_normal((5, 2))
    report = check(poles, mix @ right, mix @ left, dt=1 / 48000)
    assert report.passive, report.summary()
    assert report.right_rank == 2


def test_step_compliance_is_the_displacement_under_a_held_force():
    one = body(6, 0.02, n_dof=8, n_ports=2)
    dt = 1 / 8000
    n = 8
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-linalg.solve(one.M, one.K), -linalg.solve(one.M, one.C)]])
    B = np.concatenate([np.zeros((n, 2)), linalg.solve(one.M, one.ports.T)])
    Z = np.concatenate([one.ports, np.zeros((2, n))], axis=1) @ held_step(A, B, dt)[1]
    A, B, R = state_space(*one.modes)
    np.testing.assert_allclose(R @ held_step(A, B, dt)[1], Z, rtol=1e-8, atol=1e-9 * np.abs(Z).max())
    report = check(*one.modes, dt=dt)
    assert report.step_compliance_min > 0
    poles, right, left = one.modes
    assert check(poles, right, -left, dt=dt).step_compliance_min < 0


def test_one_line_says_where_and_how_much():
    report = check(*body(1, 0.06).truncated())
    with pytest.raises(PassivityError) as caught:
        report.require(file="instrument.yaml", key="body.table")
    line = str(caught.value)
    assert line.startswith("instrument.yaml: body.table: not passive: ")
    assert "Hz" in line
    assert "\n" not in line
    solved = body(1, 0.06).modes
    check(*solved).require()


def test_lists_unfit_to_be_tested():
    assert not check([np.nan + 1j], [[1.0]], [[1.0]]).passive
    with pytest.raises(ValueError, match="do not fit"):
        check([1j, 2j], [[1.0]], [[1.0]])
    empty = check(np.zeros(0), np.zeros((2, 0)), np.zeros((2, 0)), dt=1e-5)
    assert empty.passive


def test_two_equal_pairs_on_one_frequency(rng):
    # coincident poles with shapes that are passive only together: r1 l1 + r2 l2 of a rotated pair of real modes
    omega, sigma = 2 * np.pi * 440.0, 9.0
    phi = rng.standard_normal((3, 2))
    mix = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
    right, left = phi @ mix, phi @ linalg.inv(mix).T * (-0.5j / omega)
    poles = np.full(2, -sigma + 1j * omega)
    report = check(poles, right, left)
    assert report.passive, report.summary()
    assert report.method == "pencil"


def test_solve_helper_matches_a_single_oscillator():
    one = solve(np.array([[0.2]]), np.array([[0.3]]), np.array([[500.0]]), np.eye(1))
    pole = -0.75 + 1j * np.sqrt(2500 - 0.75**2)
    assert one.poles[0] == pytest.approx(pole)
    assert one.modes[1][0, 0] * one.modes[2][0, 0] == pytest.approx(1 / (0.2 * 2j * pole.imag))


def test_a_negative_direct_term_is_named_with_its_size():
    """Y -> 2 Re r l at high frequencies: where that is negative the body is active there, in a band without an end."""
    report = check(np.array([-10 + 900j]), np.array([[1.0 + 0j]]), np.array([[-0.3 + 0.4j]]))
    assert report.direct_min == pytest.approx(-0.6)  # re sum 2 |r| |l| = 1
    assert any("direct term" in fault and "-0.6 " in fault for fault in report.faults)
    assert report.violations[-1].upper_hz == np.inf
    positive = check(np.array([-10 + 900j]), np.array([[1.0 + 0j]]), np.array([[0.3 - 0.4j]]))
    assert not any("direct term" in fault for fault in positive.faults)


@pytest.mark.parametrize("product", [0.3 - 0.4j, -0.2 - 0.4j, 0.4 + 0.1j])
def test_signatures_change_where_the_mobility_of_one_port_has_no_real_part(product):
    """Of one mode with a direct term: Re Y by its two terms, its zeros by bisection."""
    pole = -60 + 900j

    def real_part(w):
        return (1j * w / (1j * w - pole) * product + 1j * w / (1j * w - pole.conjugate()) * np.conj(product)).real

    grid = np.geomspace(1.0, 1e5, 4000)
    at = np.flatnonzero(np.diff(np.sign(real_part(grid))))
    crossings = [optimize.brentq(real_part, grid[i], grid[i + 1], xtol=1e-9) for i in at]
    assert crossings
    changes = signature_changes(np.array([pole]), np.array([[1.0 + 0j]]), np.array([[product]]))
    for w in crossings:
        assert np.abs(changes / w - 1).min() < 1e-6


def test_a_band_ends_where_nothing_was_looked_for_beyond():
    """A mode that gives energy at all frequencies, without a direct term: the band has an end, and the worst a size."""
    report = check(np.array([-30 + 900j, -5 + 400j]), np.ones((1, 2)) + 0j, np.array([[0.5j, -0.3j]]))
    assert report.direct_min == pytest.approx(0.0, abs=1e-12)
    assert np.isfinite([v.upper_hz for v in report.violations]).all()
    assert report.worst == max(v.size for v in report.violations) > 0.5
    assert check(*real_modes(np.random.default_rng(1))).worst == 0.0


def test_rigid_body_modes_need_real_shapes():
    """A phase common to driving and moving turns velocities against forces: no real mass does that."""
    free = ModalBasis.real([0.0, 300.0], [0.0, 3.0], {"p": [1.0, 0.5]})
    assert check_basis(free, ["p"]).passive
    for factor in (1j, np.exp(0.3j)):
        turned = np.array([[factor, 1.0]])
        basis = replace(free, right=free.right * turned, left=free.left * turned)
        assert any("complex shapes" in fault for fault in check_basis(basis, ["p"]).faults)
