"""Plates against closed forms, Bessel roots, and a Ritz solution with Legendre polynomials made here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.polynomial import legendre
from scipy.optimize import brentq
from scipy.special import iv, ivp, jv, jvp

from tonewood.instrument.contract.svg_path import svg_ring
from tonewood.physics.plate.air import cavity_modes
from tonewood.physics.plate.beams import Beam, line, torsion_constant
from tonewood.physics.plate.outline import area, circle, crossing, guitar_outline, inside, smooth_ring
from tonewood.physics.plate.plate import CLAMPED, FREE, HINGED, Edge, Plate, cell_size
from tonewood.physics.plate.wood import SPECIES, Wood

NU = 0.3
#: D = 1 and rho h = 1 at h = 1
UNIT = Wood(12 * (1 - NU**2), 12 * (1 - NU**2), 6 * (1 - NU), NU, 1.0)
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
#: that does not shear through its thickness: Kirchhoff's plate, whose closed forms these tests have
SPRUCE = replace(SPECIES["european_spruce"].wood, G_LT=np.inf, G_RT=np.inf)


def numbers(rings, edge, count, size=0.125, **more):
    """Frequency parameters omega a^2 sqrt(rho h / D)."""
    return 2 * np.pi * Plate(rings, UNIT, 1.0, edge, size=size, **more).modes(count=count).freq


def legendre_square(clamped: bool, n: int = 16) -> np.ndarray:
    """The same of a square of side 1, by Legendre polynomials in x and y, times (1 - x^2)^2 where it is clamped."""
    x, w = legendre.leggauss(3 * n)
    factor = legendre.poly2leg([1, 0, -2, 0, 1]) if clamped else np.array([1.0])
    rows = [legendre.legmul(factor, np.eye(n)[k]) for k in range(n)]
    f = [np.array([legendre.legval(x, legendre.legder(r, d)) if d else legendre.legval(x, r) for r in rows]) * 2**d
         for d in (0, 1, 2)]  # fmt: skip
    g = {(a, b): (f[a] * w / 2) @ f[b].T for a in (0, 1, 2) for b in (0, 1, 2)}
    k = np.kron(g[2, 2], g[0, 0]) + np.kron(g[0, 0], g[2, 2]) + NU * np.kron(g[2, 0], g[0, 2])
    k += NU * np.kron(g[0, 2], g[2, 0]) + 2 * (1 - NU) * np.kron(g[1, 1], g[1, 1])
    return np.sqrt(np.maximum(sla.eigh(k, np.kron(g[0, 0], g[0, 0]), eigvals_only=True), 0.0))


def bessel_roots(edge: str, highest: float) -> list[float]:
    """lambda^2 of a circular plate of radius 1, modes with nodal diameters twice: A. W. Leissa, NASA SP-160, chapter 2.

    Of w = A J_n(x r) + B I_n(x r) with two conditions on the edge; the determinant of these.
    """

    def form(x, n):
        j, i, dj, di = jv(n, x), iv(n, x), jvp(n, x), ivp(n, x)
        turning = x * dj * i - x * di * j
        if edge == "clamped":
            return turning
        moments = [sign * x * x * f + (1 - NU) * (n * n * f - x * d) for sign, f, d in ((-1, j, dj), (1, i, di))]
        if edge == "hinged":
            return j * moments[1] - i * moments[0]
        forces = [-(x**3) * dj - (1 - NU) * n * n * (x * dj - j), x**3 * di - (1 - NU) * n * n * (x * di - i)]
        return moments[0] * forces[1] - moments[1] * forces[0]

    found, grid = [], np.linspace(1.0, np.sqrt(highest), 400)
    for n in range(12):
        values = form(grid, n)
        for i in np.flatnonzero(values[1:] * values[:-1] < 0):
            root = brentq(form, grid[i], grid[i + 1], args=(n,))
            found += [root**2] * (1 if n == 0 else 2)
    return sorted(found)


@pytest.mark.parametrize("clamped", [True, False])
def test_square(clamped: bool) -> None:
    """First 20 modes within 0.02 %; a clamp by stiff springs lies a little below the clamped plate."""
    skip = 0 if clamped else 3
    expected = legendre_square(clamped)[skip : skip + 20]
    found = numbers([SQUARE], CLAMPED if clamped else FREE, 20 + skip, size=1 / 12)[skip:]
    assert found == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize(("edge", "springs"), [("clamped", CLAMPED), ("hinged", HINGED), ("free", FREE)])
def test_circle(edge: str, springs: Edge) -> None:
    skip = 3 if edge == "free" else 0
    expected = bessel_roots(edge, 140.0)[:12]
    found = numbers([circle(1.0, count=1600)], springs, 12 + skip)[skip:]
    assert found == pytest.approx(expected, rel=2e-4)


def test_the_roots_are_those_that_are_printed() -> None:
    printed = {"clamped": [10.2158, 21.26, 34.88, 39.771], "hinged": [4.935, 13.898, 25.613, 29.72]}
    for edge, values in (printed | {"free": [5.358, 9.003, 12.439, 20.475]}).items():
        assert sorted(set(np.round(bessel_roots(edge, 45.0), 9)))[:4] == pytest.approx(values, rel=2e-4)


def hinged_rectangle(a: float, b: float, h: float, count: int) -> np.ndarray:
    """f_mn = pi/2 sqrt(1/rho h) sqrt(D_L m^4/a^4 + 2 (D_12 + 2 D_66) m^2 n^2/a^2 b^2 + D_R n^4/b^4)."""
    q = SPRUCE.stiffness() * h**3 / 12
    m, n = (g.ravel() / s for g, s in zip(np.mgrid[1:40, 1:40], (a, b), strict=True))
    d = q[0, 0] * m**4 + 2 * (q[0, 1] + 2 * q[2, 2]) * m**2 * n**2 + q[1, 1] * n**4
    return np.sort(np.pi / 2 * np.sqrt(d / (SPRUCE.density * h)))[:count]


def test_hinged_orthotropic_rectangle() -> None:
    ring = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
    found = Plate([ring], SPRUCE, 0.003, HINGED, size=0.01).modes(count=100).freq
    expected = hinged_rectangle(0.4, 0.3, 0.003, 100)
    assert found[:20] == pytest.approx(expected[:20], rel=2e-4)
    assert found == pytest.approx(expected, rel=4e-4)


def test_order_of_convergence() -> None:
    """Eigenvalues of order 2 (p - 1): 4 for p = 3 on a free square."""
    exact = legendre_square(False)[8]
    errors = [numbers([SQUARE], FREE, 12, size=1 / n, degree=3)[8] / exact - 1 for n in (6, 12, 24)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert all(e > 0 for e in errors)  # bounds from above
    assert orders[-1] == pytest.approx(4.0, abs=0.3)


def test_order_of_the_cavity() -> None:
    """Of a second-order problem 2 p = 8, on the rectangle with f = c/2 sqrt(m^2/a^2 + n^2/b^2)."""
    ring = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.3], [0.0, 0.3]])
    m, n = np.mgrid[0:6, 0:6].reshape(2, -1)
    exact = np.sort(343.0 / 2 * np.hypot(m / 0.5, n / 0.3))[1:8]
    errors = [cavity_modes(ring, 0.1, 3000.0, size).freq[:7] / exact - 1 for size in (0.1, 0.05)]
    assert np.abs(errors[1]).max() < 2e-5
    assert np.log2(errors[0][5] / errors[1][5]) > 7.0


def strip(width: float, height: float, e: Wood):
    ring = np.array([[0.0, -0.015], [0.8, -0.015], [0.8, 0.015], [0.0, 0.015]])
    beam = Beam(np.array([0.0, 0.0]), np.array([0.8, 0.0]), width, np.array([height]), e)
    return Plate([ring], e, 0.003, FREE, [beam], size=0.01), beam


def test_an_eccentric_brace_makes_a_composite_beam() -> None:
    """EI of the T section about its own neutral axis (parallel axes); the plate is a strip without Poisson's ratio."""
    e = Wood(10e9, 10e9, 5e9, 0.0, 450.0)
    plate, beam = strip(0.008, 0.010, e)
    areas, heights = np.array([0.03 * 0.003, 0.008 * 0.010]), np.array([0.0, -0.0065])
    middle = (areas @ heights) / areas.sum()
    inertia = 0.03 * 0.003**3 / 12 + 0.008 * 0.010**3 / 12 + areas @ (heights - middle) ** 2
    expected = 4.730041**2 / (2 * np.pi) * np.sqrt(10e9 * inertia / (450.0 * areas.sum())) / 0.8**2
    freq = plate.modes(count=12).freq
    assert np.abs(freq / expected - 1).min() < 2e-3  # the rest is rotary inertia, which lowers it
    assert beam.mass + 0.8 * 0.03 * 0.003 * 450.0 == pytest.approx(plate.mass, rel=1e-9)


def timoshenko(length: float, height: float, e: Wood, count: int) -> np.ndarray:
    """Hz, of a free Timoshenko beam, w and theta among 20 Legendre polynomials; it turns about its upper face."""
    x, weight = legendre.leggauss(40)
    f = np.array([[legendre.legval(x, legendre.legder(np.eye(20)[k], d) if d else np.eye(20)[k]) for k in range(20)]
                  for d in (0, 1)])  # fmt: skip
    g = {(a, b): (f[a] * weight * length / 2) @ f[b].T * (2 / length) ** (a + b) for a in (0, 1) for b in (0, 1)}
    shear, bend = 5 / 6 * e.G_LR * height, e.E_L * height**3 / 12  # per width
    k = np.block([[shear * g[1, 1], -shear * g[1, 0]], [-shear * g[0, 1], shear * g[0, 0] + bend * g[1, 1]]])
    m = e.density * (height * g[0, 0] + height**3 / 3 * g[1, 1])
    bending = k[:20, :20] - k[:20, 20:] @ sla.pinv(k[20:, 20:]) @ k[20:, :20]
    return np.sqrt(sla.eigh(bending, m, eigvals_only=True)[2 : 2 + count]) / (2 * np.pi)


def test_a_brace_shears() -> None:
    """A beam on a film of wood without weight: Timoshenko's frequencies of bending, far below Euler's."""
    beam_wood, film = Wood(12e9, 12e9, 0.8e9, 0.0, 450.0), Wood(1e3, 1e3, 1e2, 0.0, 0.01)
    ring = np.array([[0.0, -0.005], [0.3, -0.005], [0.3, 0.005], [0.0, 0.005]])
    beam = Beam(np.array([0.0, 0.0]), np.array([0.3, 0.0]), 0.010, np.array([0.015]), beam_wood)
    modes = Plate([ring], film, 1e-5, FREE, [beam], size=0.006).modes(count=32)
    middle = modes.shapes(np.column_stack([np.linspace(0.0, 0.3, 40), np.zeros(40)]))
    aside = modes.shapes(np.column_stack([np.linspace(0.0, 0.3, 40), np.full(40, 0.004)]))
    bends = np.abs(middle).max(axis=0) > 0.7 * np.abs(aside).max(axis=0)  # and does not twist
    expected = timoshenko(0.3, 0.015, beam_wood, 3)
    for freq in expected:
        assert np.abs(modes.freq[bends] / freq - 1).min() < 1e-3
    euler = 4.730041**2 / (2 * np.pi) * np.sqrt(12e9 * 0.015**2 / 12 / 450.0) / 0.3**2
    assert expected[0] < 0.97 * euler


@pytest.mark.parametrize("parts", [1, 4])
def test_lines_are_integrated_exactly(parts: int) -> None:
    """Polynomials of degree 5 along a slanted line, by three points in each part."""
    start, stop = np.array([0.1, -0.2]), np.array([0.5, 0.1])
    points, weights, place = line(start, stop, parts)
    assert weights.sum() == pytest.approx(0.5)
    np.testing.assert_allclose(points, start + place[:, None] * (stop - start))
    for k in range(6):
        assert weights @ place**k == pytest.approx(0.5 / (k + 1), rel=1e-12)


def test_cells_follow_the_wavelength_across_the_grain() -> None:
    """omega = k^2 sqrt(D / rho h): 0.3 of 2 pi / k, no more than 20 mm."""
    h, k = 0.003, 2 * np.pi / 0.05
    fmax = k**2 * np.sqrt(SPRUCE.stiffness()[1, 1] * h**3 / 12 / (SPRUCE.density * h)) / (2 * np.pi)
    assert cell_size(SPRUCE, h, fmax) == pytest.approx(0.3 * 0.05, rel=1e-9)
    assert cell_size(SPRUCE, h, 1.0) == 0.02


def test_torsion_constant() -> None:
    """Timoshenko & Goodier, Theory of Elasticity, 3rd ed. (1970), section 109: J = 0.1406, 0.229 and 0.312 l^3 L."""
    found = torsion_constant(1.0, np.array([1.0, 2.0, 10.0])) / np.array([1.0, 2.0, 10.0])
    assert found == pytest.approx([0.1406, 0.229, 0.312], rel=3e-3)


def brace(start, stop, height=0.012):
    return Beam(np.array(start), np.array(stop), 0.008, np.array([height]), SPRUCE)


def test_axes_may_be_exchanged() -> None:
    ring = smooth_ring([(0.0, -0.1), (0.3, -0.13), (0.34, 0.02), (0.2, 0.14), (-0.02, 0.08)], 200)
    one = Plate([ring], SPRUCE, 0.0025, Edge(1e8, 100.0), [brace((0.05, -0.05), (0.2, 0.09))], size=0.03)
    turned = Plate(
        [ring[:, ::-1]],
        SPRUCE,
        0.0025,
        Edge(1e8, 100.0),
        [brace((-0.05, 0.05), (0.09, 0.2))],
        size=0.03,
        grain=np.pi / 2,
    )
    assert turned.modes(count=12).freq == pytest.approx(one.modes(count=12).freq, rel=2e-3)


def test_grain_may_be_turned_with_the_plate() -> None:
    """A plate turned by 30 degrees with its grain has the same modes; the grid is another one."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    ring = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
    straight = Plate([ring], SPRUCE, 0.003, FREE, size=0.02).modes(count=15)
    turned = Plate([ring @ [[c, s], [-s, c]]], SPRUCE, 0.003, FREE, size=0.02, grain=np.pi / 6).modes(count=15)
    assert turned.freq[3:] == pytest.approx(straight.freq[3:], rel=1e-4)
    assert turned.loss[3:] == pytest.approx(straight.loss[3:], rel=1e-3)


def test_loss_factors_are_those_of_the_strains() -> None:
    """A hinged rectangle's energies are known; bending along the grain alone loses as E_L does."""
    ring = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
    modes = Plate([ring], SPRUCE, 0.003, HINGED, size=0.02).modes(count=1)
    q, loss = SPRUCE.stiffness(), SPRUCE.losses()
    kappa = np.array([1 / 0.4**2, 1 / 0.3**2])
    twist = 2 / (0.4 * 0.3)
    energy, lost = (kappa @ m[:2, :2] @ kappa + m[2, 2] * twist**2 for m in (q, loss))
    assert modes.loss[0] == pytest.approx(lost / energy, rel=1e-4)


@pytest.mark.slow
def test_a_brace_moves_the_modes_smoothly() -> None:
    """In steps of 1.5 mm over more than a cell, scatter about a polynomial of degree 6 below 0.2 cent."""
    ring = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2]])
    place = np.arange(0.09, 0.115, 0.0015)
    freq = np.array(
        [
            Plate([ring], SPRUCE, 0.0025, CLAMPED, [brace((x, 0.01), (x, 0.19), 0.003)], size=0.02).modes(count=4).freq
            for x in place
        ]
    )
    for f in freq.T:
        cents = 1200 * np.log2(f / f[0])
        assert np.ptp(cents) > 2.0
        t = (place - place.mean()) / np.ptp(place)
        assert np.abs(cents - np.polyval(np.polyfit(t, cents, 6), t)).max() < 0.2


def test_residual_completes_the_static_compliance() -> None:
    """Load at the middle of a hinged square: w = 0.01160 P a^2 / D (Timoshenko & Woinowsky-Krieger 1959, table 23)."""
    plate = Plate([SQUARE], UNIT, 1.0, HINGED, size=1 / 16)
    modes = plate.modes(count=6)
    loads = plate.operator([[0.5, 0.5], [0.3, 0.4]]).toarray()
    rest = plate.residual(loads, modes)
    kept = loads @ modes.vectors
    whole = (kept / (2 * np.pi * modes.freq) ** 2) @ kept.T + rest
    assert whole[0, 0] == pytest.approx(0.01160, rel=4e-3)
    assert rest[0, 0] > 0.02 * whole[0, 0]
    assert sla.eigvalsh(rest).min() > 0


def test_outlines() -> None:
    ring = guitar_outline(0.485, 0.278, 0.237, 0.365)
    assert np.ptp(ring, axis=0) == pytest.approx([0.485, 0.365], abs=1e-3)
    assert crossing(ring[::8]) is None
    assert area(circle(0.3, count=50)) == pytest.approx(np.pi * 0.09, rel=1e-12)
    bow = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    assert crossing(bow) == pytest.approx([0.5, 0.5])
    hole = circle(0.1, (0.5, 0.5))
    assert inside([[0.5, 0.5], [0.2, 0.2], [1.2, 0.5]], [SQUARE, hole]).tolist() == [False, True, False]


def test_areas_are_integrated() -> None:
    rings = [guitar_outline(0.485, 0.278, 0.237, 0.365), circle(0.0425, (0.155, 0.0))]
    plate = Plate(rings, SPRUCE, 0.0025, FREE, size=0.03)
    assert plate.area == pytest.approx(area(rings[0]) - area(rings[1]), rel=2e-5)
    assert plate.mass == pytest.approx(plate.area * 0.0025 * SPRUCE.density, rel=1e-6)


def test_paths_of_drawings() -> None:
    square = svg_ring("M 10 10 h 80 v 80 H10 z")
    assert area(square) == pytest.approx(6400.0)
    k = 40 * 4 / 3 * np.tan(np.pi / 8)  # four cubic curves that draw a circle to 3e-4
    disc = svg_ring(
        f"m 90,50 c 0,{k} {k - 40 + 0},40 -40,40 S 10,{50 + k} 10,50 S {50 - k},10 50,10 S 90,{50 - k} 90,50 Z"
    )
    assert area(disc) == pytest.approx(np.pi * 1600, rel=2e-3)
    for bad in ("M 0 0 A 1 1 0 0 0 2 2", "M 0 0 L 1", "M 0 0 L 1 1", ""):
        with pytest.raises(ValueError, match="path"):
            svg_ring(bad)
