"""Plates that shear, beside other methods, closed forms and others' finite elements."""

from __future__ import annotations

import csv
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.polynomial import legendre

from tonewood.physics.plate.beams import Beam
from tonewood.physics.plate.outline import circle
from tonewood.physics.plate.plate import CLAMPED, FREE, HINGED, Plate
from tonewood.physics.plate.wood import SPECIES, Wood

SITKA = SPECIES["sitka_spruce"].wood
RING = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.2], [0.0, 0.2]])
#: FEM frequencies by others; not part of this repository
FEM = Path(__file__).parents[5].parent / "shared" / "plates" / "fem_plates.csv"
SCRIPT = Path(__file__).parents[4] / "scripts" / "plates_of_others.py"
needs_fem = pytest.mark.skipif(not FEM.is_file(), reason="others' plates are not here")


def stiff(wood: Wood) -> Wood:
    """The same wood without shear: Kirchhoff's plate."""
    return replace(wood, G_LT=np.inf, G_RT=np.inf)


def legendre_plate(wood: Wood, size: tuple[float, float], h: float, n: int, count: int) -> np.ndarray:
    """Hz, of a free Reissner-Mindlin rectangle: w and both rotations among n x n Legendre polynomials."""
    x, weight = legendre.leggauss(2 * n)
    p = np.array([legendre.legval(x, np.eye(n)[k]) for k in range(n)])
    d = np.array([legendre.legval(x, legendre.legder(np.eye(n)[k])) for k in range(n)]) * np.ones_like(x)
    (mx, cx, kx), (my, cy, ky) = (
        ((p * weight) @ p.T * s / 2, (d * weight) @ p.T, (d * weight) @ d.T * 2 / s) for s in size
    )
    q, cubed, shear = wood.stiffness(), h**3 / 12, 5 / 6 * h * wood.transverse()
    plain = np.kron(mx, my)
    ww = shear[0, 0] * np.kron(kx, my) + shear[1, 1] * np.kron(mx, ky)
    xx = cubed * (q[0, 0] * np.kron(kx, my) + q[2, 2] * np.kron(mx, ky)) + shear[0, 0] * plain
    yy = cubed * (q[1, 1] * np.kron(mx, ky) + q[2, 2] * np.kron(kx, my)) + shear[1, 1] * plain
    xy = cubed * (q[0, 1] * np.kron(cx, cy.T) + q[2, 2] * np.kron(cx.T, cy))
    wx, wy = -shear[0, 0] * np.kron(cx, my), -shear[1, 1] * np.kron(mx, cy)
    k = np.block([[ww, wx, wy], [wx.T, xx, xy], [wy.T, xy.T, yy]])
    m = wood.density * sla.block_diag(h * plain, cubed * plain, cubed * plain)
    values = sla.eigh(k, m, eigvals_only=True, subset_by_index=[3, 2 + count])
    return np.sqrt(values) / (2 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "count"), [(12, 8), pytest.param(22, 30, marks=pytest.mark.validate)], ids=["8 modes", "30 modes"]
)
def test_a_free_rectangle_beside_legendre_polynomials(n: int, count: int) -> None:
    """Within 0.02 % of another basis for w and rotations, which converges quickly for low modes of a thick plate."""
    h = 0.012 if n == 12 else 0.004
    expected = legendre_plate(SITKA, (0.5, 0.2), h, n, count)
    found = Plate([RING], SITKA, h, FREE, size=0.02 if n == 12 else 0.015).modes(count=count + 3).freq[3:]
    assert found == pytest.approx(expected, rel=2e-4)


def hinged(wood: Wood, size: tuple[float, float], h: float, count: int) -> np.ndarray:
    """Hz, Navier's solution: w, beta_x, beta_y = sin sin, cos sin, sin cos; the lowest of three per wave."""
    q, shear, found = wood.stiffness() * h**3 / 12, 5 / 6 * h * wood.transverse(), []
    for m in range(1, 30):
        for n in range(1, 30):
            a, b = m * np.pi / size[0], n * np.pi / size[1]
            s, t = shear[0, 0], shear[1, 1]
            k = np.array(
                [
                    [s * a * a + t * b * b, -s * a, -t * b],
                    [-s * a, q[0, 0] * a * a + q[2, 2] * b * b + s, (q[0, 1] + q[2, 2]) * a * b],
                    [-t * b, (q[0, 1] + q[2, 2]) * a * b, q[1, 1] * b * b + q[2, 2] * a * a + t],
                ]
            )
            mass = wood.density * np.diag([h, h**3 / 12, h**3 / 12])
            found.append(sla.eigh(k, mass, eigvals_only=True)[0])
    return np.sqrt(np.sort(found)[:count]) / (2 * np.pi)


@pytest.mark.slow
def test_hinged_plate_has_naviers_frequencies() -> None:
    """40 modes within 0.1 %, of a plate so thick that shear lowers them by up to a fifth."""
    h, size = 0.008, (0.4, 0.3)
    ring = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
    expected = hinged(SITKA, size, h, 40)
    found = Plate([ring], SITKA, h, HINGED, size=0.0125).modes(count=40).freq
    assert found == pytest.approx(expected, rel=1e-3)
    assert expected[-1] < 0.8 * hinged(replace(SITKA, G_LT=1e15, G_RT=1e15), size, h, 40)[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "edge", [pytest.param(FREE, id="free"), pytest.param(CLAMPED, id="clamped", marks=pytest.mark.slow)]
)
def test_a_thin_plate_is_kirchhoffs(edge: object) -> None:
    """h f / h tends to Kirchhoff's with h; at a ten-thousandth of the length nothing locks."""
    apart = []
    for h in (5e-3, 5e-4, 5e-5):
        soft, rigid = (
            Plate([RING], wood, h, edge, size=0.03).modes(count=12).freq[3:] for wood in (SITKA, stiff(SITKA))
        )
        apart.append(np.abs(soft / rigid - 1).max())
    assert apart[0] > 0.02
    assert apart[1] < apart[0] / 5
    assert apart[2] < 5e-4


@pytest.mark.slow
def test_a_free_strip_twists_as_saint_venant_says() -> None:
    """Isotropic strip 20 h wide: J = b h^3 / 3 (1 - 0.630 h / b) but for shear; Kirchhoff's plate has b h^3 / 3."""
    iso = Wood(10e9, 10e9, 10e9 / 2.6, 0.3, 500.0, G_LT=10e9 / 2.6, G_RT=10e9 / 2.6)
    h, width, length = 0.002, 0.04, 0.6
    ring = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    soft, rigid = (Plate([ring], wood, h, FREE, size=0.01).modes(count=12) for wood in (iso, stiff(iso)))
    at = np.array([[0.01, 0.001], [0.01, width - 0.001]])
    first = []
    for modes in (soft, rigid):
        edge = modes.shapes(at)[:, 3:]
        twists = np.flatnonzero(edge[0] * edge[1] < 0)
        first.append(modes.freq[3:][twists[0]])
    assert (first[0] / first[1]) ** 2 == pytest.approx(1 - 0.630 * h / width, abs=3e-3)


@pytest.mark.slow
def test_grain_and_plate_may_be_turned_together() -> None:
    """The shear of a wood turns with its grain, and so does the layer on a free edge."""
    c, s = np.cos(0.5), np.sin(0.5)
    straight = Plate([RING], SITKA, 0.005, FREE, size=0.02).modes(count=15)
    turned = Plate([RING @ [[c, s], [-s, c]]], SITKA, 0.005, FREE, size=0.015, grain=0.5).modes(count=15)
    assert turned.freq[3:] == pytest.approx(straight.freq[3:], rel=3e-4)
    assert turned.loss[3:] == pytest.approx(straight.loss[3:], rel=3e-3)


def test_rigid_motion_has_no_frequency() -> None:
    """Three modes of a free braced plate with a hole lie at 0, and its mass is that of wood and brace."""
    beam = Beam(np.array([0.1, 0.05]), np.array([0.3, 0.16]), 0.008, np.array([0.01]), SITKA)
    hole = circle(0.03, (0.4, 0.1), 60)
    plate = Plate([RING, hole], SITKA, 0.003, FREE, [beam], size=0.03)
    modes = plate.modes(count=6)
    assert modes.freq[2] < 1e-2 * modes.freq[3]
    assert plate.mass == pytest.approx((0.1 - np.pi * 9e-4) * 0.003 * 440 + beam.mass, rel=1e-4)


@pytest.mark.slow
def test_a_brace_keeps_its_offset() -> None:
    """A strip that cannot shear across and one that shears freely: the brace's composite stiffness stays, to shear."""
    e = Wood(10e9, 10e9, 5e9, 0.0, 450.0, G_LT=5e9, G_RT=5e9)
    ring = np.array([[0.0, -0.015], [0.8, -0.015], [0.8, 0.015], [0.0, 0.015]])
    beam = Beam(np.array([0.0, 0.0]), np.array([0.8, 0.0]), 0.008, np.array([0.010]), e)
    soft, rigid = (Plate([ring], wood, 0.003, FREE, [beam], size=0.01).modes(count=12).freq for wood in (e, stiff(e)))
    areas, heights = np.array([0.03 * 0.003, 0.008 * 0.010]), np.array([0.0, -0.0065])
    middle = (areas @ heights) / areas.sum()
    inertia = 0.03 * 0.003**3 / 12 + 0.008 * 0.010**3 / 12 + areas @ (heights - middle) ** 2
    expected = 4.730041**2 / (2 * np.pi) * np.sqrt(10e9 * inertia / (450.0 * areas.sum())) / 0.8**2
    assert np.abs(soft / expected - 1).min() < 3e-3
    assert soft[3:] == pytest.approx(rigid[3:], rel=1.5e-2)


@needs_fem
@pytest.mark.validate
@pytest.mark.parametrize(("factor", "median", "most"), [(1.0, 0.003, 0.010), (5 / 6, 0.0065, 0.02)])
def test_others_finite_elements(factor: float, median: float, most: float) -> None:
    """1,200 free spruce plates, each 24th: median and 95 % of |error|. The elements shear evenly, factor 1."""
    with FEM.open() as file:
        rows = list(csv.DictReader(file))[::24]
    errors = np.abs(runpy.run_path(str(SCRIPT))["fem_errors"](rows, factor))
    assert np.median(errors) < median
    assert np.quantile(errors, 0.95) < most
