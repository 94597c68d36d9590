"""Repair: passive afterwards, near, honest about how near, and stored energy that balances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from random_bodies import DAMPING, body, power_balance
from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import extend
from tonewood.physics.modal.mobility import mobility, port_scale
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.basis import check_basis, repair_basis
from tonewood.physics.passivity.conditions import check
from tonewood.physics.passivity.repair import repair
from tonewood.physics.passivity.storage import storage_matrix


def strict_mobility(modes, scale, omega):
    """Mobility without its direct term, ports scaled, term by term."""
    poles, right, left = extend(*modes)
    gain = poles / (1j * omega[:, None] - poles)
    return np.einsum("ik,wk,jk->wij", right / scale, gain, left / scale)


def h2_distance(one, other, scale):
    """Relative H2 distance by integration over frequency on a mesh refined at every pole."""
    poles = one[0]
    around = np.concatenate([np.sinh(np.linspace(-12, 12, 801))[:, None] * -poles.real / 20 + poles.imag], axis=0)
    omega = np.unique(np.abs(np.concatenate([around.ravel(), np.geomspace(1, 1e8, 4000)])))
    reference, moved = (strict_mobility(m, scale, omega) for m in (one, other))
    squares = [(np.abs(Y) ** 2).sum(axis=(1, 2)) for Y in (moved - reference, reference)]
    over, under = (np.trapezoid(s, omega) for s in squares)
    return np.sqrt(over / under)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(DAMPING))
def test_repaired_bodies_are_passive_and_near(kind, rng):
    given = body(2, DAMPING[kind], n_dof=32).truncated()
    new = repair(*given)
    modes = new.poles, new.right, new.left
    np.testing.assert_array_equal(new.poles, given[0])
    assert not new.before.passive
    assert new.after.passive
    assert check(*modes, dt=1 / 48000).passive
    limits = {"light": 0.03, "medium": 0.08, "heavy": 0.08}
    assert new.mobility_change < limits[kind]
    # the reported distances are the true ones
    scale = port_scale(*given)[:, None]
    assert h2_distance(given, modes, scale) == pytest.approx(new.mobility_change, rel=0.02)
    peaks = given[0].imag
    old_y, new_y = (mobility(m[0], m[1] / scale, m[2] / scale, peaks) for m in (given, modes))
    moved = linalg.norm((new_y - old_y).reshape(peaks.size, -1), axis=1).max()
    largest = linalg.norm(old_y.reshape(peaks.size, -1), axis=1).max()
    assert new.peak_error_db == pytest.approx(20 * np.log10(moved / largest), abs=1e-6)
    # and its storage function closes the power balance
    residual, energy, lost = power_balance(modes, new.storage, rng)
    assert np.abs(residual).max() < 1e-11 * energy.max()
    assert lost.min() >= 0
    # one found from the shapes alone does as well, also for some of the ports
    some = new.poles, new.right[:2], new.left[:2]
    residual, energy, lost = power_balance(some, storage_matrix(*some), rng)
    assert np.abs(residual).max() < 1e-9 * energy.max()


@pytest.mark.parametrize("size", [1e-3, 1e-2])
def test_no_farther_than_a_known_passive_body(size, rng):
    """Left shapes of a passive body are disturbed: that body is at the distance of the disturbance."""
    poles, right, left = body(11, 0.02, n_dof=16, n_ports=2).modes
    noise = rng.standard_normal(left.shape) + 1j * rng.standard_normal(left.shape)
    disturbed = left + size * np.abs(left) * noise
    known = h2_distance((poles, right, disturbed), (poles, right, left), port_scale(poles, right, disturbed)[:, None])
    new = repair(poles, right, disturbed)
    assert not new.before.passive
    assert 0 < new.mobility_change < 1.05 * known


def test_a_passive_body_hardly_moves():
    new = repair(*body(12, 0.03, n_dof=10).modes)
    assert new.before.passive
    assert new.mobility_change < 1e-3


def test_same_answer_every_time_and_in_any_order(rng):
    poles, right, left = body(2, 0.25, n_dof=12).truncated(0.7)
    one = repair(poles, right, left, max_change=1.0)
    again = repair(poles, right, left, max_change=1.0)
    np.testing.assert_array_equal(one.left, again.left)
    order = rng.permutation(poles.size)
    other = repair(poles[order], right[:, order], left[:, order], max_change=1.0)
    assert other.mobility_change == pytest.approx(one.mobility_change, rel=0.02)
    assert check(other.poles, other.right, other.left).passive
    residual, energy, _ = power_balance((other.poles, other.right, other.left), other.storage, rng)
    assert np.abs(residual).max() < 1e-11 * energy.max()


def test_shapes_of_random_phase_are_flattened_when_that_is_nearer():
    rng = np.random.default_rng(0)
    omega = 2 * np.pi * np.sort(rng.uniform(80, 3000, 16))
    zeta = 0.01 * np.exp(0.4 * rng.standard_normal(16))
    shapes = rng.standard_normal((4, 16)) * np.exp(0.1j * rng.standard_normal((4, 16)))
    poles = omega * (1j * np.sqrt(1 - zeta**2) - zeta)
    given = poles, shapes, shapes * (-0.5j / poles.imag)
    new = repair(*given, max_change=0.5)
    assert new.flattening < 1
    assert h2_distance(given, (new.poles, new.right, new.left), port_scale(*given)[:, None]) == pytest.approx(
        new.mobility_change, rel=0.02
    )
    # the plain remedy, real shapes with the same poles, is farther away
    turned = shapes * np.exp(-0.5j * np.angle((shapes**2).sum(axis=0)))
    plain = poles, turned.real + 0j, turned.real * (-0.5j / poles.imag)
    assert check(*plain).passive
    assert new.mobility_change < h2_distance(given, plain, port_scale(*given)[:, None])


def test_refusals():
    poles, right, left = body(2, 0.015).truncated()
    with pytest.raises(PassivityError, match=r"more than the 0\.001 allowed"):
        repair(poles, right, left, max_change=1e-3, max_iterations=50)
    growing = poles.copy()
    growing[2] = -growing[2].conj()
    with pytest.raises(PassivityError, match="grow"):
        repair(growing, right, left)
    with pytest.raises(PassivityError, match="undamped"):
        repair(poles.imag * 1j, right, left)


def test_modes_without_work_at_the_ports_are_kept_at_rest():
    poles, right, left = body(1, 0.015, n_dof=16).truncated()
    right[:, 3], left[:, 5] = 0, 0
    new = repair(poles, right, left)
    np.testing.assert_array_equal(new.left[:, [3, 5]], 0)
    np.testing.assert_array_equal(new.poles, poles)
    assert new.storage.P.shape == (16, 16)


def test_dependent_ports_cost_nothing(rng):
    poles, right, left = body(3, 0.03, n_dof=16, n_ports=2).truncated()
    mix = np.concatenate([np.eye(2), rng.standard_normal((2, 2)), np.zeros((1, 2))])
    one, many = repair(poles, right, left), repair(poles, mix @ right, mix @ left)
    assert many.after.passive
    # the norm weighs the directions differently, that is all
    assert many.mobility_change < 2 * one.mobility_change


def test_a_residual_compliance_with_a_negative_eigenvalue_becomes_the_nearest_without(rng):
    """Nearest in the Frobenius norm: negative eigenvalues are zero, other points stay as they are (Higham 1988)."""
    freq, shapes = 2 * np.pi * np.array([100.0, 210.0, 340.0]), rng.normal(size=(3, 3))
    residual = 1e-6 * np.array([[1.0, 2.0, 0.1], [2.0, 1.0, 0.2], [0.1, 0.2, -4.0]])
    basis = ModalBasis.real(freq, 0.01 * freq, dict(zip("abc", shapes, strict=True)), residual=residual)
    assert any("negative eigenvalue -1e-06 m/N" in fault for fault in check_basis(basis, ["a", "b"]).faults)
    mended = repair_basis(basis, ["a", "b"], max_change=0.1)
    expected = residual.copy()
    expected[:2, :2] = 1.5e-6
    np.testing.assert_allclose(mended.residual, expected, rtol=1e-12, atol=1e-18)
    assert mended.metadata["repair"].endswith("residual compliance by 1e-06 m/N")
    assert check_basis(mended, ["a", "b"]).passive


def test_the_error_that_is_reported_at_peaks_is_that_of_the_mobility():
    poles, right, left = body(2, 0.015, n_dof=16, n_ports=2).truncated()
    new, scale, omega = repair(poles, right, left), port_scale(poles, right, left)[:, None], np.abs(poles.imag)

    def whole(*modes):
        lam, psi, psi_left = extend(*modes)
        s = 1j * omega[:, None]
        return np.einsum("ik,wk,jk->wij", psi / scale, s / (s - lam), psi_left / scale)

    old, made = whole(poles, right, left), whole(new.poles, new.right, new.left)
    size, moved, level = (np.linalg.norm(y, axis=(1, 2)) for y in (old, made - old, made))
    assert new.peak_error_db == pytest.approx(20 * np.log10(moved.max() / size.max()), abs=1e-6)
    change = 20 * np.log10(level / size)
    assert new.peak_level_db == pytest.approx(change[np.argmax(np.abs(change))], abs=1e-6)


def test_repaired_residues_and_direct_term_are_as_reported(rng):
    given = body(2, 0.03, n_dof=16, n_ports=3).truncated()
    new, scale = repair(*given), port_scale(*given)[:, None]
    old, now = (np.einsum("ik,jk->kij", r / scale, l_ / scale) for r, l_ in (given[1:], (new.right, new.left)))
    assert new.residue_change == pytest.approx(linalg.norm(now - old) / linalg.norm(old), rel=1e-9)
    direct = 2 * now.sum(axis=0).real
    assert linalg.norm(direct) < 1e-4 * 2 * np.sum(linalg.norm(now, axis=(1, 2)))
    assert linalg.norm(2 * old.sum(axis=0).real) > 1e-2 * 2 * np.sum(linalg.norm(old, axis=(1, 2)))
    np.testing.assert_allclose(direct, -direct.T, atol=1e-10 * linalg.norm(now))
    assert new.direct_skew == pytest.approx(new.after.direct_term, rel=1e-12)
    assert new.flattening == 0.5  # of 1, 0.5 and 0 the nearest
    assert new.mobility_change < 0.0785  # regression: 0.0773; modes of uneven weight would end at 0.080
    assert "imaginary shapes times 0.5" in new.summary()
    residual, energy, lost = power_balance((new.poles, new.right, new.left), new.storage, rng)
    assert np.abs(residual).max() < 1e-11 * energy.max()
    assert lost.min() >= 0
