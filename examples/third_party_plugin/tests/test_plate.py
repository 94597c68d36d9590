"""The plate against closed forms, and the zither through tonewood's own front door."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
import tonewood.authoring as ta

SPRUCE = {
    "length": 0.5, "width": 0.3, "thickness": 0.004, "density": 420.0, "young_modulus": 9e9, "damping_ratio": 0.01,
    "points": {"p": {"x": 0.21, "y": 0.13}, "q": {"x": 0.1, "y": 0.2}},
}  # fmt: skip


def plate(**changes: object) -> ta.Body:
    return tw.list_plugins()["rectangular_plate"].from_values({**SPRUCE, **changes}, key="body")


def test_found_by_name() -> None:
    assert "rectangular_plate" in tw.list_plugins()
    assert "plate_zither" in tw.list_instruments()


def test_lowest_mode_of_a_square_plate() -> None:
    """omega_11 = 2 pi^2 sqrt(D / rho h) / a^2, and its mass is a quarter of the plate's."""
    basis = plate(length=0.3, width=0.3, points={"c": {"x": 0.15, "y": 0.15}}).basis(2000.0)
    rigidity = 9e9 * 0.004**3 / (12 * (1 - 0.3**2))
    expected = 2 * np.pi**2 * np.sqrt(rigidity / (420 * 0.004)) / 0.3**2
    assert np.sqrt(basis.stiffness[0]) == pytest.approx(expected)
    assert basis.right[0, 0].real ** -2 == pytest.approx(420 * 0.004 * 0.3**2 / 4)


def test_mean_mobility_is_that_of_an_endless_plate() -> None:
    """Mean of Re Y over frequency and place: 1 / (8 sqrt(D rho h)), Cremer & Heckl, Structure-borne Sound, IV.3.

    Less the modes that supported edges take from the count, a share P / (2 k S) of perimeter, wavenumber and area.
    """
    rng = np.random.default_rng(1)
    points = {f"p{i}": {"x": x, "y": y} for i, (x, y) in enumerate(rng.uniform((0, 0), (0.5, 0.3), (200, 2)))}
    basis = plate(points=points).basis(12000.0)
    freq = np.linspace(2000.0, 6000.0, 400)
    mean = np.mean([basis.frf(freq, name, name).real for name in points])
    mass, rigidity = 420 * 0.004, 9e9 * 0.004**3 / (12 * (1 - 0.3**2))
    k = np.sqrt(2 * np.pi * freq / np.sqrt(rigidity / mass))
    expected = np.mean(1 - 1.6 / (2 * k * 0.15)) / (8 * np.sqrt(rigidity * mass))
    assert mean == pytest.approx(expected, rel=0.04)


def test_reciprocal() -> None:
    basis = plate().basis(3000.0)
    freq = np.linspace(50.0, 3000.0, 50)
    np.testing.assert_allclose(basis.frf(freq, "p", "q"), basis.frf(freq, "q", "p"))


def test_a_place_off_the_plate() -> None:
    with pytest.raises(ta.BundleError, match=r"body\.points\.p: \(0\.6, 0\.1\) m does not lie on the plate"):
        plate(points={"p": {"x": 0.6, "y": 0.1}}).basis(1000.0)


def test_the_zither_is_in_tune_and_sounds() -> None:
    zither = tw.load_instrument("plate_zither")
    model = ta.assemble(zither, 48000)
    for string in model.strings.values():
        tuned = string.tuned()
        assert tuned is not None
        assert abs(tuned.error_cents) < 1.0
    audio = tw.render(tw.Score([tw.Note(0.0, 0.5, string="D3", stop=0, force=2.0)]), zither, max_duration=0.3)
    assert 0.01 < np.abs(audio.samples).max() < 1.0
