"""Held modes against sines in closed form; condensed components against the whole ones, alone and coupled."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.modal.held_modes import HeldModes, condensed
from tonewood.modal.modes import ModalBasis
from tonewood.modal.string_modes import string_basis

Floats = NDArray[np.float64]
LENGTH, TENSION, DENSITY, STIFFNESS = 0.65, 73.9, 3.61e-3, 40e-6


def string(n_modes: int = 60, stiffness: float = STIFFNESS) -> ModalBasis:
    made = string_basis(LENGTH, TENSION, DENSITY, stiffness, lambda w, k: 1e-3 + 2e-3 * (k / 300) ** 2, n_modes=n_modes)
    return made.with_places({"pluck": 0.12})


@pytest.mark.parametrize("stiffness", [0.0, STIFFNESS])
def test_a_held_string_has_the_frequencies_and_end_forces_of_its_sines(stiffness: float) -> None:
    held = HeldModes.of(string(stiffness=stiffness), "bridge")
    k = np.arange(1, 60) * np.pi / LENGTH
    exact = np.sqrt((TENSION * k**2 + stiffness * k**4) / DENSITY)
    np.testing.assert_allclose(held.freq_rad, exact, rtol=1e-10)
    # u = sqrt(2 / mu L) sin kx pulls its end with T u' - EI u'''
    force = (TENSION * k + stiffness * k**3) * np.sqrt(2 / (DENSITY * LENGTH))
    np.testing.assert_allclose(held.force, force, rtol=1e-9)


def test_held_modes_are_orthonormal_and_leave_the_point_at_rest() -> None:
    basis = string()
    held = HeldModes.of(basis, "bridge")
    u = held.vectors
    np.testing.assert_allclose(u @ u.T, np.eye(59), atol=1e-11)
    assert np.abs(u @ basis.right[0].real).max() < 1e-9 * np.abs(basis.right[0]).max()
    np.testing.assert_allclose(u @ (basis.stiffness[:, None] * u.T), np.diag(held.freq_rad**2), rtol=1e-9, atol=1e-2)


def energy(basis: ModalBasis, q: Floats, velocity: Floats) -> tuple[float, float]:
    return float(basis.stiffness @ q**2), float(velocity @ velocity)


@pytest.mark.parametrize("n_held", [-1, 0, 7, 31, 59])
def test_leaving_modes_out_never_adds_energy_and_taking_them_back_none(n_held: int, rng: np.random.Generator) -> None:
    basis = string()
    part = condensed(basis, HeldModes.of(basis, "bridge"), n_held)
    for _ in range(20):
        q, v = rng.standard_normal(60) / np.arange(1, 61) ** 1.5, rng.standard_normal(60)
        fewer = part.reduce(q, v)
        before, after = energy(basis, q, v), energy(part.basis, *fewer)
        assert after[0] <= before[0] * (1 + 1e-12)
        assert after[1] <= before[1] * (1 + 1e-12)
        again = part.expand(*fewer)
        assert energy(basis, *again) == pytest.approx(after, rel=1e-11)
        if n_held >= 0:
            assert part.basis.right[0].real @ fewer[0] == pytest.approx(basis.right[0].real @ q, rel=1e-9)


@pytest.mark.parametrize("n_held", [-1, 0, 7, 31])
def test_static_compliance_stays_between_all_points(n_held: int) -> None:
    basis = string()
    part = condensed(basis, HeldModes.of(basis, "bridge"), n_held)
    assert part.basis.n_modes == n_held + 1
    np.testing.assert_allclose(part.basis.static_compliance(), basis.static_compliance(), rtol=1e-12)
    assert sla.eigvalsh(part.basis.residual)[0] >= -1e-12 * part.basis.residual.max()


def test_nothing_left_out_is_the_whole_component() -> None:
    basis = string()
    held = HeldModes.of(basis, "bridge")
    part = condensed(basis, held, held.n_modes)
    np.testing.assert_allclose(part.basis.stiffness, basis.stiffness, rtol=1e-9)
    np.testing.assert_allclose(np.abs(part.basis.right), np.abs(basis.right), rtol=1e-7)
    # the pairs of decay rates are fixed by the held modes, but for one of their combinations
    np.testing.assert_allclose(part.basis.damping_rate, basis.damping_rate, rtol=2e-2)


def coupled_poles(basis: ModalBasis) -> NDArray[np.complex128]:
    """Poles of the string with its bridge on a plate's mode and a spring, by eigenvalues in physical coordinates."""
    a = basis.right[0].real
    n = basis.n_modes
    # string modes and two oscillators that share the bridge: displacement b = a q = c r, eliminated by null space
    c = np.array([1 / np.sqrt(0.1), 1 / np.sqrt(0.03)])
    omega, sigma = 2 * np.pi * np.array([101.0, 437.0]), np.array([12.0, 25.0])
    free = sla.null_space(np.concatenate([a, -c])[None])
    K = free.T @ (np.concatenate([basis.stiffness, omega**2])[:, None] * free)
    C = free.T @ (2 * np.concatenate([basis.damping_rate, sigma])[:, None] * free)
    size = n + 1
    poles = sla.eigvals(np.block([[np.zeros((size, size)), np.eye(size)], [-K, -C]]))
    poles = poles[poles.imag > 0]
    return poles[np.argsort(poles.imag)]


def test_coupled_partials_keep_pitch_and_decay_up_to_the_highest_mode_kept() -> None:
    basis = string(100)
    held = HeldModes.of(basis, "bridge")
    whole = coupled_poles(basis)
    for n_held in (15, 31, 63):
        part = coupled_poles(condensed(basis, held, n_held).basis)
        cents = 1200 * np.log2(part.imag / whole[: len(part)].imag)
        decay = part.real / whole[: len(part)].real - 1
        assert np.abs(cents).max() < 2e-2  # a light body, with a mode among the partials
        assert np.abs(decay).max() < 2e-3
        # dropping free modes and adding their static compliance, the usual way, is far off
        folded = coupled_poles(basis.select(np.arange(n_held + 1)))
        assert np.abs(1200 * np.log2(folded.imag / whole[: len(folded)].imag)).max() > 1.0


def test_forms_of_the_shapes_follow_the_modes() -> None:
    basis = string()
    part = condensed(basis, HeldModes.of(basis, "bridge"), 15).basis
    a, b = (np.asarray(part.metadata[key]) for key in ("tension_part", "bending_part"))
    np.testing.assert_allclose(TENSION * a + STIFFNESS * b, part.stiffness, rtol=1e-9)


def test_what_cannot_be_held_is_refused() -> None:
    basis = string(8)
    with pytest.raises(ValueError, match="7 held modes, not 8"):
        condensed(basis, HeldModes.of(basis, "bridge"), 8)
    with pytest.raises(ValueError, match="real modes with stiffness"):
        HeldModes.of(ModalBasis.real([0.0, 10.0], [0.0, 0.1], {"bridge": [1.0, 1.0]}), "bridge")
    with pytest.raises(ValueError, match="must move in every mode"):
        HeldModes.of(ModalBasis.real([5.0, 10.0], [0.0, 0.1], {"bridge": [1.0, 0.0]}), "bridge")
