"""Modes of a whole drawn body, and their derivatives against differences at three step sizes."""

from dataclasses import replace

import numpy as np
import pytest

from tonewood.physics.plate.beams import Beam
from tonewood.physics.plate.body import BodyDrawing, PlateDrawing, body_modes
from tonewood.physics.plate.outline import circle
from tonewood.physics.plate.plate import HINGED
from tonewood.physics.plate.whole_body import Lump, WholeBody, body_change
from tonewood.physics.plate.wood import SPECIES
from tonewood.workshop.design.figures import DrawnResonances

SPRUCE = SPECIES["sitka_spruce"].wood
OUTLINE = np.array([[0.0, 0.0], [0.30, 0.0], [0.30, 0.22], [0.0, 0.22]])
MODES = 8


def drawing(thickness=2.5e-3, height=9e-3, start=0.05, depth=0.09):
    brace = Beam(np.array([start, 0.04]), np.array([0.27, 0.17]), 0.008, np.array([height]), SPRUCE)
    top = PlateDrawing(SPRUCE, thickness, HINGED, (brace,), size=0.025)
    return BodyDrawing(
        outline=OUTLINE, hole=circle(0.03, (0.08, 0.12), 90), top=top, back=None, depth=depth, cavity_to=1000.0,
        end_correction=1.5, air_loss=0.02, extra_loss=0.008, baffled=True, fmax=1500.0,
        points=np.array([[0.2, 0.1], [0.24, 0.06]]), directions=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
        heights=np.array([0.01, 0.01]),
    )  # fmt: skip


def made(lump=0.0, **values):
    return WholeBody(drawing(**values), [Lump(0, 1.0, lump, 0.0, 0.0)] if lump else [])


@pytest.fixture(scope="module")
def solved():
    body = made()
    return body, *body.modes(count=3 * MODES)


def test_modes_are_those_of_the_body_whose_plate_modes_are_left_out(solved):
    body, values, vectors = solved
    found, known = body.described(values[:MODES], vectors[:, :MODES]), body_modes(drawing())
    np.testing.assert_allclose(found.freq, known.freq[:MODES], rtol=2e-4)
    np.testing.assert_allclose(found.loss[:4], known.loss[:4], rtol=0.02)
    assert found.named == known.named()
    assert found.mass == pytest.approx(known.masses[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "steps", "freq_error", "shape_error"),
    [
        ("thickness", 2.5e-3, (1e-4, 3e-5, 1e-5), 1e-6, 1e-4),
        pytest.param("height", 9e-3, (1e-4, 3e-5, 1e-5), 1e-6, 1e-4, marks=pytest.mark.slow),
        pytest.param("depth", 0.09, (1e-4, 3e-5, 1e-5), 1e-6, 1e-4, marks=pytest.mark.slow),
        ("start", 0.05, (1e-3, 3e-4, 1e-4), 1e-3, 1e-3),
    ],
)
def test_derivatives_against_differences_at_three_steps(solved, name, value, steps, freq_error, shape_error):
    body, values, vectors = solved
    small = 1e-5 * value
    change = body_change(
        body, values, vectors, made(**{name: value - small}), made(**{name: value + small}), small, MODES
    )
    for relative in steps:
        step = relative * value
        less, more = (
            b.described(*(a[..., :MODES] for a in b.modes(count=3 * MODES)))
            for b in (made(**{name: value - step}), made(**{name: value + step}))
        )
        for key, error in (
            ("freq", freq_error),
            ("shapes", shape_error),
            ("loss", shape_error),
            ("residual", shape_error),
        ):
            a, b, c, d = (np.abs(getattr(x, key)) for x in (more, less, change.more, change.less))
            rate, theory = (a - b) / (2 * step), (c - d) / (2 * small)
            assert np.abs(rate - theory).max() < error * np.abs(rate).max(), (key, relative)


@pytest.mark.slow
@pytest.mark.parametrize("step", [1e-4, 3e-5, 1e-5])
def test_mobility_changes_as_its_differences(solved, step):
    """|Y| at a point from 60 to 600 Hz, sum over the modes and what they leave out, against differences: 1e-4."""
    body, values, vectors = solved
    name, value, freq = "thickness", 2.5e-3, np.geomspace(60.0, 600.0, 200)
    small = 1e-5 * value
    change = body_change(
        body, values, vectors, made(**{name: value - small}), made(**{name: value + small}), small, MODES
    )
    theory = [20 * np.log10(np.abs(DrawnResonances(x).mobility(0, freq))) for x in (change.less, change.more)]
    less, more = (
        20 * np.log10(np.abs(DrawnResonances(found).mobility(0, freq)))
        for b in (made(**{name: value * (1 - step)}), made(**{name: value * (1 + step)}))
        for found in [b.described(*(a[..., :MODES] for a in b.modes(count=3 * MODES)))]
    )
    rate = (more - less) / (2 * step * value)
    assert np.abs(rate - (theory[1] - theory[0]) / (2 * small)).max() < 1e-4 * np.abs(rate).max()


def test_a_lump_is_its_mass_on_the_modes():
    """Derivative of lambda with respect to a mass m at a point: -lambda phi^2 (Rayleigh)."""
    body = made(lump=0.01)
    values, vectors = body.modes(count=3 * MODES)
    small = 1e-6
    change = body_change(body, values, vectors, made(lump=0.01 - small), made(lump=0.01 + small), small, MODES)
    shapes = body.described(values[:MODES], vectors[:, :MODES]).shapes[0]
    rate = (change.more.freq - change.less.freq) / (2 * small)
    freq = 0.5 * (change.more.freq + change.less.freq)
    np.testing.assert_allclose(rate, -0.5 * freq * shapes**2, rtol=1e-6)


def test_other_unknowns_are_refused(solved):
    body, values, vectors = solved
    other = WholeBody(replace(drawing(), depth=0.0))
    with pytest.raises(ValueError, match="unknowns"):
        body_change(body, values, vectors, other, other, 1.0, 2)
