"""Stop changes: energies of whole subspaces of motions, by eigenvalues, and fields by quadrature."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.modal.string_transfer import retuned, string_transfer

# length, tension, linear density, bending stiffness: a wound nylon string, a stiff one, a gut-like one
STRINGS = {
    "A2": (0.65, 73.9, 3.61e-3, 40e-6),
    "G3": (0.65, 58.3, 0.90e-3, 310e-6),
    "harp": (0.523, 36.9, 5.53e-4, 1.49e-4),
}


def basis(name: str, semitones: float = 0.0, freq_upper: float = 12000.0) -> ModalBasis:
    length, tension, mu, ei = STRINGS[name]
    return string_basis(length * 2 ** (-semitones / 12), tension, mu, ei, lambda w, k: 0 * w, freq_upper=freq_upper)


def growth(matrix: NDArray[np.float64], old: NDArray[np.float64], new: NDArray[np.float64]) -> float:
    """Largest energy after / energy before over all motions."""
    return float(sla.eigh(matrix.T @ (new[:, None] * matrix), np.diag(old), eigvals_only=True)[-1])


@pytest.mark.parametrize("name", STRINGS)
@pytest.mark.parametrize(("before", "after"), [(0, 1), (0, 5), (0, 12), (1, 0), (12, 0), (5, 7), (7, 5)])
def test_no_motion_gains_energy(name: str, before: int, after: int) -> None:
    old, new = basis(name, before), basis(name, after)
    displacement, velocity = string_transfer(old, new)
    at_rest = sla.null_space(old.right[0].real[None])  # motions that leave the bridge alone

    within = at_rest.T @ (old.stiffness[:, None] * at_rest)
    held = displacement @ at_rest
    potential = float(sla.eigh(held.T @ (new.stiffness[:, None] * held), within, eigvals_only=True)[-1])
    kinetic = float(sla.eigvalsh((velocity @ at_rest).T @ (velocity @ at_rest))[-1])
    assert potential <= 1 + 1e-9
    assert kinetic <= 1 + 1e-9

    # with the bridge displaced, only pressing the string down does work: at most T d^2 / 2 (1 / L' - 1 / L)
    worst = growth(displacement, old.stiffness, new.stiffness)
    ratio = 2 ** ((after - before) / 12)
    assert worst <= max(ratio, 1.0) + 1e-9
    # the bridge's ramp among the sines that are kept
    assert sla.eigvalsh(velocity.T @ velocity)[-1] < 1.02


@pytest.mark.parametrize(("before", "after"), [(0, 7), (7, 0)])
def test_the_bridge_keeps_its_motion(before: int, after: int) -> None:
    old, new = basis("G3", before), basis("G3", after)
    for matrix in string_transfer(old, new):
        np.testing.assert_allclose(new.right[0].real @ matrix, old.right[0].real, rtol=0, atol=1e-10)


def field(b: ModalBasis, q: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    assert b.shape is not None
    shape: Callable[[float], NDArray[np.float64]] = b.shape
    return np.array([shape(v) @ q for v in x])


def test_a_shortened_string_takes_over_its_field_less_a_straight_line(rng: np.random.Generator) -> None:
    old, new = basis("A2"), basis("A2", 4)
    length = STRINGS["A2"][0] * 2 ** (-4 / 12)
    q = rng.standard_normal(old.n_modes) / (1 + np.arange(old.n_modes)) ** 3
    displacement, _ = string_transfer(old, new)
    x = np.linspace(0, length, 41)
    whole = field(old, q, x)
    expected = whole - whole[-1] * x / length
    assert np.abs(field(new, displacement @ q, x) - expected).max() < 3e-3 * np.abs(expected).max()


def test_displacement_there_and_back_is_the_projection_by_quadrature(rng: np.random.Generator) -> None:
    """Coefficients of the longer string against its sines, by numerical integration of the kinked field."""
    old, new = basis("harp", 5, 6000.0), basis("harp", 0, 6000.0)
    L, T, _, ei = STRINGS["harp"]
    short = L * 2 ** (-5 / 12)
    q = rng.standard_normal(old.n_modes) / (1 + np.arange(old.n_modes)) ** 2
    n = 20001
    x = np.linspace(0, short, n)
    k_old = np.arange(1, old.n_modes) * np.pi / short
    coefficients = np.asarray(old.metadata["vec"]) @ q
    slope = -coefficients[0] / short + np.cos(np.outer(x, k_old)) @ (k_old * coefficients[1:])
    bend = -np.sin(np.outer(x, k_old)) @ (k_old**2 * coefficients[1:])
    k = np.arange(1, new.n_modes) * np.pi / L
    # energy product of field and sine on the old length; the part beyond it is at rest
    product = T * np.trapezoid(slope[:, None] * k * np.cos(np.outer(x, k)), x, axis=0)
    product += ei * np.trapezoid(bend[:, None] * -(k**2) * np.sin(np.outer(x, k)), x, axis=0)
    expected = product / (L / 2 * (T * k**2 + ei * k**4))
    got = np.asarray(new.metadata["vec"]) @ string_transfer(old, new)[0] @ q
    np.testing.assert_allclose(got[1:], expected, atol=1e-7 * np.abs(expected).max())
    assert got[0] == pytest.approx(coefficients[0], rel=1e-9)


def test_staying_changes_nothing() -> None:
    b = basis("A2", 3)
    for matrix in string_transfer(b, b):
        np.testing.assert_allclose(matrix, np.eye(b.n_modes), atol=1e-9)


def test_retuned_keeps_shapes_and_places() -> None:
    b = basis("A2")
    placed = b.with_places({"pluck": 0.1})
    new = retuned(placed, np.sqrt(b.stiffness) * 1.01, b.damping_rate + 3.0)
    np.testing.assert_allclose(new.natural_freq, b.natural_freq * 1.01)
    np.testing.assert_allclose(new.damping_rate, 3.0)
    np.testing.assert_array_equal(new.right, placed.right)
    assert new.places == placed.places
    assert new.with_places({"more": 0.2}).residual.shape == (3, 3)
