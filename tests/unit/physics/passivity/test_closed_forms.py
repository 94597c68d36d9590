"""Numbers of the passivity check and of the repair for bodies of one or two modes, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tonewood.errors import PassivityError
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.basis import check_basis, repair_basis
from tonewood.physics.passivity.conditions import check, modal_partners
from tonewood.physics.passivity.repair import repair
from tonewood.physics.passivity.storage import storage_matrix

POLE = -10 + 900j


def one_port(products, poles):
    """Poles and shapes of one port: r = 1, r l the products."""
    lam = np.array(poles, dtype=complex)
    return lam, np.ones((1, lam.size)) + 0j, np.array([products], dtype=complex)


def test_report_of_two_ports_with_a_mode_each_is_the_closed_form():
    """Y = diag(y1, y2): both products have modulus 1/2, so the ports are of equal size."""
    products, dt = np.array([0.3 - 0.4j, -0.3 - 0.4j]), 7e-4
    right, left = np.diag([2.0, 0.1]) + 0j, np.diag(products / [2.0, 0.1])
    report = check([POLE, POLE], right, left, dt=dt, tolerance=1e-8)
    assert (report.n_modes, report.n_ports, report.tolerance, report.dt) == (2, 2, 1e-8, dt)
    assert (report.method, report.conjugate_misfit, report.unstable) == ("pencil", 0.0, ())
    assert (report.right_rank, report.left_rank, report.ranks_agree) == (2, 2, True)
    assert report.direct_term == pytest.approx(np.hypot(0.6, 0.6) / 2)
    assert report.direct_min == pytest.approx(-0.3)
    gain = np.expm1(POLE * dt) / POLE
    assert report.step_compliance_min == pytest.approx(min((products * gain).real) / abs(gain))
    assert check([POLE, POLE], right, left).step_compliance_min is None
    omega = np.linspace(1e-3, 30, 150001)[:, None] * abs(POLE)
    y = (1j * omega * (products / (1j * omega - POLE) + products.conj() / (1j * omega - POLE.conjugate()))).T
    share = y.real.min(axis=0) / np.linalg.norm(y, axis=0)
    assert report.worst == pytest.approx(-share.min(), rel=1e-6)
    band = max(report.violations, key=lambda v: v.size)
    assert band.worst_hz * 2 * np.pi == pytest.approx(omega[share.argmin(), 0], rel=1e-3)
    edges = omega[:-1, 0][np.diff(share < 0)] / (2 * np.pi)
    ends = [e for v in report.violations for e in (v.lower_hz, v.upper_hz) if 0 < e < np.inf]
    assert sorted(ends) == pytest.approx(edges.tolist(), rel=4e-3)
    assert f"{len(report.violations)} band(s), worst {band.lower_hz:.6g} to {band.upper_hz:.6g} Hz" in report.summary()


def test_ranks_of_right_and_left_shapes_are_told_apart():
    right, left = np.eye(2), np.array([[1.0, 1.0], [2.0, 2.0]])
    report = check([POLE, 3 * POLE], right, -1j * left)
    assert (report.right_rank, report.left_rank, report.ranks_agree) == (2, 1, False)
    assert "right shapes (rank 2) and left shapes (rank 1)" in report.summary()


@pytest.mark.parametrize(("tolerance", "direct", "step"), [(0.301, False, False), (0.299, True, True)])
def test_the_tolerance_is_a_share_of_the_sum_of_terms(tolerance, direct, step):
    report = check([POLE, POLE], np.eye(2), np.diag([0.3 - 0.4j, -0.3 - 0.4j]), dt=1e-9, tolerance=tolerance)
    assert report.step_compliance_min == pytest.approx(-0.3, rel=1e-5)
    assert any("direct term" in fault for fault in report.faults) == direct
    assert any("compliance over a step of 1e-09 s" in fault for fault in report.faults) == step


@pytest.mark.parametrize(("apart", "passive"), [(0.0, True), (5e-11, True), (3e-10, False)])
def test_undamped_poles_at_one_frequency_are_judged_together(apart, passive):
    """Residues 0.5 and -0.2 of Y add up to 0.3 where the frequencies agree to 1e-10."""
    report = check(*one_port([-0.5j, 0.2j], [500j, 500j * (1 + apart)]))
    assert report.method == "pencil"
    assert (report.violations == ()) == passive
    if not passive:
        assert [(v.size, v.worst_hz) for v in report.violations] == [pytest.approx((1.0, 500 / (2 * np.pi)))]


def test_an_undamped_pole_without_a_residue_is_no_fault():
    report = check(*one_port([-0.5j, 0.0, -0.4j + 0.1], [400j, 500j, POLE]), tolerance=0.2)
    assert (report.method, report.violations) == ("pencil", ())


@pytest.mark.parametrize(("turn", "size"), [(0.3, np.sin(0.3)), (np.pi / 2, 1.0), (3.0, -np.cos(3.0)), (1e-10, None)])
def test_residue_of_an_undamped_pole_by_its_phase(turn, size):
    """exp(i turn) / 2: the Hermitian part is cos / 2, the skew one sin / 2."""
    report = check(*one_port([-0.5j * np.exp(1j * turn)], [500j]))
    assert [v.size for v in report.violations] == ([] if size is None else [pytest.approx(size, rel=1e-9)])


@pytest.mark.parametrize(("growth", "grows"), [(0.5e-11, False), (2e-11, True)])
def test_a_pole_grows_beyond_the_rounding_of_its_modulus(growth, grows):
    report = check(*one_port([-0.5j], [500 * (1j + growth)]))
    assert bool(report.unstable) == grows
    assert report.passive != grows


@pytest.mark.parametrize(
    ("poles", "products", "passive", "partner"),
    [
        ([-5 + 90j, 90j, 1 + 90j], [-1j, -1j, -1j], [True, True, False], [-1, -1, -1]),
        ([-5 + 90j] * 3, [1j, -1j + 1e-3, 0], [False, False, True], [-1, -1, -1]),
        ([-5, -5, 0, 3], [2, -2, 1, 1], [True, False, True, False], [-1, -1, -1, -1]),
        ([-10, -40], [1, -1], [True, True], [-1, 0]),
        ([-40, -10], [-1, 1], [True, True], [1, -1]),
        ([-40, -10], [1, -1], [True, False], [-1, -1]),
        ([-10, -40, -50], [1, -1, -1], [True, True, False], [-1, 0, -1]),
        ([-10, -20, -40, -50], [1, 1, -1, -1], [True] * 4, [-1, -1, 0, 1]),
        ([-10, -40], [1, -1.01], [True, False], [-1, -1]),
    ],
)
def test_modes_that_are_passive_by_themselves_or_with_a_partner(poles, products, passive, partner):
    found = modal_partners(*one_port(products, poles))
    assert (found[0].tolist(), found[1]) == (passive, partner)


def test_a_residue_between_two_ports_must_be_symmetric():
    right = np.array([[1.0], [0.5]]) + 0j
    for left, passive in ((right * -0.3j, True), (np.array([[-0.3j], [-0.1j]]), False)):
        assert modal_partners(np.array([POLE]), right, left)[0].tolist() == [passive]


def blocks():
    return ModalBasis.real([0.0, 300.0, 500.0], [0.0, 400.0, 3.0], {"p": [1.0, 0.5, 1.0], "q": [0.2, 1.0, -1.0]})


@pytest.mark.parametrize(
    ("change", "passive"),
    [
        ({}, True),
        ({"damping_rate": np.array([0.0, -1e-9, 3.0])}, False),
        ({"stiffness": np.array([-1e-9, 300.0**2, 500.0**2])}, False),
        ({"right": blocks().right * np.array([[1.0], [1.001]])}, True),  # of the point that nothing drives
        ({"right": blocks().right * np.array([[1.001], [1.0]])}, False),
        ({"residual": np.diag([1e-6, -5e-6])}, True),
        ({"residual": np.diag([-5e-6, 1e-6])}, False),
    ],
)
def test_blocks_and_residual_compliance_at_the_driven_points(change, passive):
    basis = replace(blocks(), **change)
    report = check_basis(basis, ["p", "p"], dt=1e-4)
    assert report.passive == passive
    assert (report.n_modes, report.n_ports, report.dt) == (3, 1, 1e-4)


@pytest.mark.parametrize(("share", "passive"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_negative_eigenvalue_of_the_residual_is_compared_with_the_largest_element(share, passive):
    residual = np.diag([2e-6, -share * 2e-6])
    report = check_basis(replace(blocks(), residual=residual), ["p", "q"])
    assert report.passive == passive
    assert passive or f"negative eigenvalue {-share * 2e-6:.3g} m/N beside 2e-06 m/N" in report.summary()


def test_repair_leaves_blocks_and_points_that_are_not_driven():
    basis = replace(blocks(), residual=np.diag([1e-6, -5e-6]))
    left = basis.left.copy()
    left[:, 2] *= np.exp(0.05j)
    mended = repair_basis(replace(basis, left=left), ["p"], max_change=0.2)
    changed = np.argwhere(mended.left != left).tolist()
    assert changed == [[0, 2]]
    assert check_basis(mended, ["p"]).passive
    assert mended.residual[1, 1] == -5e-6
    assert "residual" not in mended.metadata["repair"]
    assert mended.metadata["repair"].startswith("made passive: poles unchanged, right shapes kept, residues moved ")


def nearest(product):
    """b of the real mode -i b nearest to the product in the H2 norm of one port, and the relative distance.

    Impulse responses 2 Re(lambda a exp(lambda t)), whose products integrate in closed form.
    """

    def inner(a, c):
        a, c = POLE * a, POLE * c
        return 2 * (a * np.conj(c) / (-2 * POLE.real) + a * c / (-2 * POLE)).real

    b = inner(product, -1j) / inner(-1j, -1j)
    return b, np.sqrt(inner(product + 1j * b, product + 1j * b) / inner(product, product))


@pytest.mark.parametrize("product", [0.1 - 0.6j, -0.2 - 0.5j])
@pytest.mark.parametrize("unit", [1.0, 3e-3])
def test_repair_of_one_mode_is_the_nearest_real_mode(product, unit):
    b, change = nearest(product)
    poles, right, left = one_port([product], [POLE])
    new = repair(poles, right / unit, left * unit, max_change=change * 1.001)
    np.testing.assert_allclose(new.right * new.left, [[-1j * b]], rtol=1e-4)
    assert new.mobility_change == pytest.approx(change, rel=1e-4)
    assert new.residue_change == pytest.approx(abs(product + 1j * b) / abs(product), rel=1e-4)
    assert (new.pole_change, new.flattening, new.storage.kind) == (0.0, 1.0, "repair")
    assert new.direct_skew == pytest.approx(0.0, abs=1e-12)
    assert f"right shapes kept, residues moved {new.residue_change:.2%}" in new.summary()
    assert f"mobility {new.mobility_change:.2%} (H2), at its peaks {new.peak_error_db:.1f} dB" in new.summary()

    def at_peak(residue):
        w = 1j * POLE.imag
        return w * (residue / (w - POLE) + np.conj(residue) / (w - np.conj(POLE)))

    old, now = at_peak(product), at_peak(-1j * b)
    assert new.peak_level_db == pytest.approx(20 * np.log10(abs(now) / abs(old)), abs=1e-3)
    assert new.peak_error_db == pytest.approx(20 * np.log10(abs(now - old) / abs(old)), abs=1e-3)
    # the storage function of one real mode is its mechanical energy
    exact = storage_matrix(new.poles, new.right, -1j * new.right * abs(new.left) / abs(new.right))
    np.testing.assert_allclose(new.storage.P, exact.P, rtol=1e-3, atol=1e-3 * abs(exact.P).max())
    np.testing.assert_allclose(new.storage.Q, exact.Q, rtol=1e-3, atol=1e-3 * abs(exact.Q).max())
    with pytest.raises(PassivityError, match="more than the"):
        repair(poles, right / unit, left * unit, max_change=change * 0.999)


def test_repair_refuses_lists_without_work_and_those_not_closed():
    poles, right, left = one_port([0.1 - 0.6j, 0.1 - 0.5j], [POLE, 2 * POLE])
    for r, l_ in ((right * [1, 0], left * [0, 1]), (right * 0, left), (right, left * 0)):
        with pytest.raises(PassivityError, match="no mode is both driven and seen"):
            repair(poles, r, l_)
    full = [np.concatenate([a, np.conj(a)], axis=-1) for a in (poles, right, left)]
    for share, refused in ((1 + 1e-5, False), (1.001, True)):
        full[2][0, 3] = np.conj(left[0, 1]) * share
        if refused:
            with pytest.raises(PassivityError, match="conjugates differ"):
                repair(*full, max_change=1.0)
        else:
            assert repair(*full, max_change=1.0).poles.size == 2
    with pytest.raises(PassivityError, match="a pole is undamped"):
        repair([POLE, 900j], right, left)
    assert repair(poles, right, left, max_change=1.0, max_iterations=7).iterations <= 7 + 7 // 5 + 7 // 3
