"""Held modes against sines in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis

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


def test_what_cannot_be_held_is_refused() -> None:
    with pytest.raises(ValueError, match="real modes with stiffness"):
        HeldModes.of(ModalBasis.real([0.0, 10.0], [0.0, 0.1], {"bridge": [1.0, 1.0]}), "bridge")
    with pytest.raises(ValueError, match="must move in every mode"):
        HeldModes.of(ModalBasis.real([5.0, 10.0], [0.0, 0.1], {"bridge": [1.0, 0.0]}), "bridge")
