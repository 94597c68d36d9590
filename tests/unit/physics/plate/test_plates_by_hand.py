"""Splines, outlines, woods, beams, sources, banks and bodies of small examples, against SciPy or worked out here."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.interpolate import BSpline
from scipy.sparse import csc_matrix, csr_matrix

from tonewood.physics.plate import plate_parts
from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED, air_matrices, cavity_modes, couple_air
from tonewood.physics.plate.beams import Beam, _across, beam_line, rotations, torsion_constant
from tonewood.physics.plate.block_solve import BlockSolver, _blocks, _positions
from tonewood.physics.plate.body import (
    BodyDrawing,
    PlateDrawing,
    body_modes,
    cell_of,
    first_modes,
    made_plate,
    mouth_of,
    named_modes,
    opening_of,
    point_loads,
)
from tonewood.physics.plate.edge_layer import _depth, _sides
from tonewood.physics.plate.figures import draw_shapes
from tonewood.physics.plate.integrals import integrals
from tonewood.physics.plate.lanczos import lowest
from tonewood.physics.plate.microphones import Bank, _background, _frequencies, microphone, pressure
from tonewood.physics.plate.mode_changes import clusters
from tonewood.physics.plate.outline import (
    area,
    circle,
    crossing,
    guitar_outline,
    inside,
    quadrature,
    refined,
    smooth_ring,
)
from tonewood.physics.plate.plate import CLAMPED, FREE, HINGED, Edge, Plate, cell_size
from tonewood.physics.plate.radiation import Sources, gathered_sources
from tonewood.physics.plate.splines import SplineGrid, line_functions
from tonewood.physics.plate.tracking import followed
from tonewood.physics.plate.two_oscillators import displaced_volumes, pressure_shapes
from tonewood.physics.plate.whole_body import Lump, WholeBody, body_change, with_cells
from tonewood.physics.plate.wood import SPECIES, Wood

SPRUCE = SPECIES["sitka_spruce"].wood
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def splines(x: np.ndarray, cells: int, degree: int, order: int) -> np.ndarray:
    """(n, cells + p) functions on cells of width 1, by SciPy."""
    knots = np.arange(-degree, cells + degree + 1.0)
    every = np.eye(cells + degree)
    return np.array([BSpline(knots, row, degree)(x, nu=order) for row in every]).T


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_functions_of_a_grid_are_products_of_b_splines(degree: int, order: int, rng: np.random.Generator) -> None:
    grid = SplineGrid.over(np.array([[0.1, -0.2], [0.7, 0.21]]), 0.2, degree)
    assert (grid.cells.tolist(), grid.count, grid.alive) == ([3, 2], (3 + degree) * (2 + degree), (degree + 1) ** 2)
    np.testing.assert_allclose(grid.size, [0.2, 0.205])
    points = grid.low + grid.size * grid.cells * rng.uniform(size=(7, 2))
    x, y = ((points - grid.low) / grid.size).T
    for orders in ((order, 0), (0, order), (order, 1)):
        expected = splines(x, 3, degree, orders[0])[:, :, None] * splines(y, 2, degree, orders[1])[:, None]
        expected = expected / 0.2 ** orders[0] / 0.205 ** orders[1]
        got = grid.at(points, orders).toarray()
        np.testing.assert_allclose(got, expected.reshape(7, -1), atol=1e-9 * max(np.abs(expected).max(), 1))
    assert grid.cell_of(np.array([[0.0, 0.5], [0.65, -0.1]])).tolist() == [[0, 1], [2, 0]]
    expected = np.repeat(np.arange(3 + degree), 2 + degree)  # x has more cells
    assert grid.places.tolist() == expected.tolist()
    place = rng.uniform(size=6)
    line = line_functions(place, 5, degree, order).toarray()
    np.testing.assert_allclose(line, splines(5 * place, 5, degree, order) * 5.0**order, atol=1e-9 * 5**order)


def test_integrals_are_those_of_a_fine_sum() -> None:
    """(B a)^T f Q (B b) over a triangle and over whole cells, with two fields and a factor of the place."""
    ring = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.8]])
    grid = SplineGrid.over(ring, 0.25, 2)
    quad = quadrature(grid, [ring], strips=8)
    assert quad.weights.sum() == pytest.approx(0.4, rel=1e-12)
    for i, j in ((1, 0), (0, 1), (2, 1)):  # int x^i y^j = a^(i+1) b^(j+1) i! j! / (i + j + 2)!
        exact = {(1, 0): 0.8 / 6, (0, 1): 0.64 / 6, (2, 1): 2 * 0.64 / 120}[i, j]
        x, y = quad.points.T
        assert quad.weights @ (x**i * y**j) == pytest.approx(exact, rel=1e-9)
    Q = np.array([[2.0, 0.5], [0.5, 3.0]])

    def rows(u, v):
        none = np.zeros_like(u((0, 0)))
        return np.stack(
            [np.concatenate([u((1, 0)), none], axis=-1), np.concatenate([none, v((0, 1))], axis=-1)], axis=-2
        )

    (varied,), (plain,) = (integrals(2, quad, rows, f, [Q]) for f in (lambda p: 1 + p[..., 0], 2.0))
    B = np.stack(
        [
            np.hstack([grid.at(quad.points, (1, 0)).toarray(), 0 * grid.at(quad.points).toarray()]),
            np.hstack([0 * grid.at(quad.points).toarray(), grid.at(quad.points, (0, 1)).toarray()]),
        ]
    )
    for found, factor in ((varied, 1 + quad.points[:, 0]), (plain, np.full(len(quad.points), 2.0))):
        expected = np.einsum("rna,rs,snb,n->ab", B, Q, B, factor * quad.weights)
        np.testing.assert_allclose(found.toarray(), expected, atol=1e-12 * np.abs(expected).max())


def test_points_of_integrals_avoid_holes() -> None:
    hole = circle(0.2, (0.55, 0.5), 64)
    grid = SplineGrid.over(SQUARE, 0.1, 3)
    quad = quadrature(grid, [SQUARE, hole])
    assert quad.weights.sum() == pytest.approx(1 - np.pi * 0.04, rel=1e-4)
    assert np.hypot(*(quad.points - [0.55, 0.5]).T).min() > 0.199
    assert quad.weights.min() > 0
    assert quad.whole == (True, False)
    cells, points, weights = quad.groups[0]
    assert points.shape == (len(cells), 16, 2)
    np.testing.assert_allclose(weights.sum(axis=1), 0.01)
    assert quad.weights @ quad.points[:, 0] == pytest.approx(0.5 - 0.55 * np.pi * 0.04, rel=1e-4)


def test_rings_by_hand() -> None:
    sides = refined(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.4]]), 0.5)
    np.testing.assert_allclose(sides, [[0, 0], [0.5, 0], [1, 0], [1, 0.4], [2 / 3, 0.8 / 3], [1 / 3, 0.4 / 3]])
    assert area(SQUARE * [2.0, 3.0]) == area(SQUARE[::-1] * [2.0, 3.0]) == 6.0
    points = np.array([(0.0, 0.0), (2.0, -0.3), (2.5, 1.0), (1.0, 2.0)])
    ring = smooth_ring(points, 4000)
    assert len(ring) == 4000
    for p in points:
        assert np.hypot(*(ring - p).T).min() < 2e-3
    np.testing.assert_array_equal(ring[0], points[0])
    bend = np.diff(np.vstack([ring[-2:], ring[:2]]), n=2, axis=0)  # the spline goes on smoothly where it closes
    assert np.hypot(*(bend[1] - bend[0])) < 1e-6
    np.testing.assert_allclose(circle(2.0, (1.0, -1.0), 4), np.array([1.0, -1.0]) + np.sqrt(2 * np.pi) * np.array(
        [[1, 0], [0, 1], [-1, 0], [0, -1]]), atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(circle(0.5).mean(axis=0), 0.0, atol=1e-12)
    assert len(circle(0.5)) == 720
    assert crossing(SQUARE, SQUARE + 2.0) is None
    assert crossing(SQUARE, SQUARE + 0.5) == pytest.approx([1.0, 0.5])
    assert crossing(SQUARE, 0.5 * SQUARE + 0.25) is None
    assert inside([[0.5, 0.5]], [SQUARE]).tolist() == [True]
    ring = guitar_outline(0.5, 0.3, 0.2, 0.4)
    for place, width in ((0.090, 0.3), (0.200, 0.2), (0.365, 0.4)):
        near = np.abs(ring[:, 0] - place * 0.5 / 0.485) < 0.002
        assert np.ptp(ring[near, 1]) == pytest.approx(width, rel=0.01)
    np.testing.assert_allclose(np.sort(ring[:, 1]), np.sort(-ring[:, 1]), atol=1e-6)


def test_stiffness_of_a_wood_in_turned_axes() -> None:
    """Engineering constants of an off-axis ply: R. M. Jones, Mechanics of Composite Materials, Eq. 2.97."""
    wood = Wood(10e9, 1e9, 0.7e9, 0.4, 400.0, 0.01, 0.02, 0.03, 0.6e9, 0.05e9)
    S = sla.inv(wood.stiffness())
    assert (1 / S[0, 0], 1 / S[1, 1], 1 / S[2, 2]) == pytest.approx((10e9, 1e9, 0.7e9))
    assert -S[0, 1] / S[0, 0] == pytest.approx(0.4)
    c, s = np.cos(0.5), np.sin(0.5)
    along = c**4 / 10e9 + (1 / 0.7e9 - 2 * 0.4 / 10e9) * s**2 * c**2 + s**4 / 1e9
    shear = 2 * (2 / 10e9 + 2 / 1e9 + 4 * 0.4 / 10e9 - 1 / 0.7e9) * s**2 * c**2 + (s**4 + c**4) / 0.7e9
    mixed = (2 / 10e9 + 0.8 / 10e9 - 1 / 0.7e9) * s * c**3 - (2 / 1e9 + 0.8 / 10e9 - 1 / 0.7e9) * s**3 * c
    S = sla.inv(wood.stiffness(0.5))
    assert (S[0, 0], S[2, 2], S[0, 2]) == pytest.approx((along, shear, mixed))
    k = 1 - 0.16 * 0.1
    lost = (
        np.array([[10e9 * 0.01, 0.4e9 * np.sqrt(2e-4), 0], [0.4e9 * np.sqrt(2e-4), 0.02e9, 0], [0, 0, 0.021e9 * k]]) / k
    )
    np.testing.assert_allclose(wood.losses(), lost)
    np.testing.assert_allclose(wood.losses(np.pi / 2)[:2, :2], lost[[1, 0]][:, [1, 0]], rtol=1e-9)
    np.testing.assert_allclose(wood.transverse(), np.diag([0.6e9, 0.05e9]))
    np.testing.assert_allclose(
        wood.transverse(0.5), [[c * c * 6e8 + s * s * 5e7, c * s * 5.5e8], [c * s * 5.5e8, s * s * 6e8 + c * c * 5e7]]
    )
    assert [w.shears for w in (wood, replace(wood, G_LT=np.inf), replace(wood, G_RT=np.inf))] == [True, False, False]


#: GPa, nu, kg/m^3, and G_LT, G_RT over E_L: a regression of the figures that the module names its sources of
WOODS = {
    "sitka_spruce": (13.0, 0.90, 1.50, 0.372, 440, 0.061, 0.003),
    "engelmann_spruce": (9.79, 1.25, 1.21, 0.422, 350, 0.120, 0.010),
    "european_spruce": (11.5, 0.85, 0.78, 0.37, 430, 0.061, 0.003),
    "western_red_cedar": (8.5, 0.70, 0.74, 0.378, 350, 0.086, 0.005),
    "maple": (12.6, 2.2, 1.63, 0.424, 600, 0.062, 0.021),
    "mahogany": (10.1, 1.5, 1.32, 0.300, 545, 0.086, 0.028),
    "indian_rosewood": (12.8, 0.90, 1.0, 0.36, 830, 0.062, 0.021),
    "brazilian_rosewood": (14.0, 1.0, 1.1, 0.36, 880, 0.062, 0.021),
}


def test_figures_of_woods_are_those_of_the_table() -> None:
    assert list(SPECIES) == list(WOODS)
    for name, (long, across, shear, nu, density, lt, rt) in WOODS.items():
        wood = SPECIES[name].wood
        found = (wood.E_L, wood.E_R, wood.G_LR, wood.nu_LR, wood.density, wood.G_LT, wood.G_RT)
        wanted = (long * 1e9, across * 1e9, shear * 1e9, nu, density, lt * long * 1e9, rt * long * 1e9)
        assert found == pytest.approx(wanted), name
        soft = "spruce" in name or "cedar" in name
        losses = (0.0075, 0.020, 0.018) if soft else (0.010, 0.022, 0.020)
        assert (wood.loss_L, wood.loss_R, wood.loss_shear) == losses


@pytest.mark.parametrize("edge", [CLAMPED, HINGED, Edge(2e6, 300.0)])
def test_frequencies_stay_where_stiffness_and_mass_grow_alike(edge: Edge) -> None:
    """All moduli, springs and the density times 1000: stiff springs that stand for an edge follow the plate's."""
    heavy = Wood(*(1e3 * x for x in (13e9, 0.9e9, 1.5e9)), 0.372, 440e3, G_LT=0.8e12, G_RT=0.04e12)
    light = Wood(13e9, 0.9e9, 1.5e9, 0.372, 440.0, G_LT=0.8e9, G_RT=0.04e9)
    stiffer = replace(edge, k_w=1e3 * edge.k_w, k_theta=1e3 * edge.k_theta)
    ring = SQUARE * [0.3, 0.2]
    freq = [Plate([ring], w, 3e-3, e, size=0.05).modes(count=6).freq for w, e in ((light, edge), (heavy, stiffer))]
    np.testing.assert_allclose(*freq, rtol=1e-7)


def plate(edge: Edge = FREE, thickness=3e-3, beams=(), **options) -> Plate:
    return Plate([SQUARE * [0.3, 0.2]], SPRUCE, thickness, edge, beams, **({"size": 0.05} | options))


def test_springs_of_an_edge_hold_and_lose() -> None:
    """On soft springs a plate heaves as a mass, f = sqrt(k P / m) / 2 pi, and loses as the springs do."""
    k = 5.0
    soft, stiff = plate(Edge(k, loss=0.1)), plate(Edge(1e5, 300.0, loss=0.1))
    first = soft.modes(count=3)
    heave = np.sqrt(k * 1.0 / soft.mass) / (2 * np.pi)
    assert np.abs(first.freq / heave - 1).min() < 1e-3
    assert first.loss == pytest.approx(0.1, rel=1e-3)
    lossless = plate(Edge(1e5, 300.0)).modes(count=4)
    more = stiff.modes(count=4)
    np.testing.assert_allclose(more.freq, lossless.freq, rtol=1e-9)
    values, whole = stiff.solution(count=4)
    free = plate(Edge(1e-6, 1e-6))  # without a layer along its edge, as the others
    bent = np.diag(free.stored(whole))
    np.testing.assert_allclose(more.loss - lossless.loss, 0.1 * (1 - bent / values), rtol=1e-4)
    np.testing.assert_allclose(stiff.stored(whole), np.diag(values), atol=1e-6 * values[-1])
    for infinite in (Edge(np.inf, 0.0, loss=0.1), Edge(1e5, np.inf, loss=0.1)):  # stand for an edge that does not move
        np.testing.assert_allclose(
            plate(infinite).modes(count=2).loss, plate(replace(infinite, loss=0.0)).modes(count=2).loss
        )


def test_a_beam_above_is_the_mirror_image_of_one_below() -> None:
    beam = Beam(np.array([0.05, 0.05]), np.array([0.25, 0.15]), 0.008, np.array([0.01]), SPRUCE)
    below, above, inward = (
        plate(Edge(1e5, 100.0, in_plane), beams=[b])
        for b, in_plane in ((beam, 0.0), (replace(beam, above=True), 0.0), (beam, 1e8))
    )
    freq = [p.modes(count=6).freq for p in (below, above, inward)]
    np.testing.assert_allclose(freq[1], freq[0], rtol=1e-6)
    assert np.all(freq[2] > freq[0])  # an edge that is held in its plane stiffens a plate with a brace beside it
    assert freq[2] == pytest.approx(freq[0], rel=0.1)
    assert below.mass == pytest.approx(plate().mass + beam.mass, rel=1e-9)


def test_a_thickness_as_a_function_is_that_thickness() -> None:
    even, sloped = (
        plate(HINGED, lambda p: np.full(p.shape[:-1], 3e-3)),
        plate(HINGED, lambda p: 2e-3 + 0.01 * p[..., 0]),
    )
    np.testing.assert_allclose(even.modes(count=5).freq, plate(HINGED).modes(count=5).freq, rtol=1e-9)
    np.testing.assert_allclose(even.modes(count=5).loss, plate(HINGED).modes(count=5).loss, rtol=1e-9)
    assert sloped.mass == pytest.approx(440.0 * 0.06 * 3.5e-3, rel=1e-9)
    kirchhoff = replace(SPRUCE, G_LT=np.inf)
    pair = [
        Plate([SQUARE * [0.3, 0.2]], kirchhoff, h, HINGED, size=0.05).modes(count=4)
        for h in (3e-3, lambda p: np.full(p.shape[:-1], 3e-3))
    ]
    np.testing.assert_allclose(pair[0].freq, pair[1].freq, rtol=1e-9)
    shearing = plate(HINGED, shear_factor=0.4).modes(count=4).freq
    assert np.all(shearing < plate(HINGED).modes(count=4).freq)
    assert np.all(plate(HINGED).modes(count=4).freq < pair[0].freq)


def test_modes_up_to_a_frequency_are_those_of_a_count() -> None:
    hinged = plate(HINGED)
    eight = hinged.modes(count=8)
    limit = 0.5 * (eight.freq[5] + eight.freq[6])
    np.testing.assert_allclose(hinged.modes(limit).freq, eight.freq[:6], rtol=1e-9)
    points = np.array([[0.1, 0.07], [0.21, 0.12]])
    step = np.array([1e-6, 0.0])
    slope = (eight.shapes(points + step) - eight.shapes(points - step)) / 2e-6
    np.testing.assert_allclose(eight.shapes(points, (1, 0)), slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())
    with pytest.raises(ValueError, match="fmax or count"):
        hinged.modes()


def test_poles_of_high_damping_follow_the_spread_of_delays() -> None:
    """1 / T apart and as wide, up to 2.5 times the highest mode, after the shelf's pole of a body in free air."""
    sources = Sources(np.array([[0.0, 0.0], [0.3, 0.4]]), np.ones((2, 1)))
    spread = np.sqrt(1.25) / SOUND_SPEED - 1.0 / SOUND_SPEED
    for top in (5000.0, 9000.0):
        step = min(1 / spread, 0.3 * top)
        poles = _background(sources, (0.0, 0.0, 1.0), top, 1.0 / SOUND_SPEED)
        expected = 2 * np.pi * step * (1j * (np.arange(int(2.5 * top / step)) + 0.5) - 1)
        np.testing.assert_allclose(poles, expected, rtol=1e-9)
        free = _background(replace(sources, baffled=False), (0.0, 0.0, 1.0), top, 1.0 / SOUND_SPEED)
        np.testing.assert_allclose(free, [-sources.shelf, *expected], rtol=1e-9)
    box = replace(sources, behind=np.array([[0.0, 0.0, -9.0]]), behind_volumes=np.ones((1, 1)))
    few = _background(box, (0.0, 0.0, 1.0), 5000.0, 1.0 / SOUND_SPEED)
    assert few[0] == pytest.approx(2 * np.pi * SOUND_SPEED / 9.0 * (0.5j - 1))


def test_a_beam_by_hand() -> None:
    beam = Beam(np.array([0.1, 0.1]), np.array([0.4, 0.5]), 0.01, np.array([0.002, 0.010, 0.004]), SPRUCE)
    assert beam.length == pytest.approx(0.5)
    np.testing.assert_allclose(beam.height(np.array([0.0, 0.25, 0.5, 1.0])), [0.002, 0.006, 0.010, 0.004])
    assert beam.mass == pytest.approx(440.0 * 0.01 * 0.5 * (0.006 + 0.007) / 2)
    assert replace(beam, heights=np.array([0.008])).mass == pytest.approx(440.0 * 0.01 * 0.5 * 0.008)
    assert torsion_constant(0.3, np.array([0.1]))[0] == torsion_constant(0.1, np.array([0.3]))[0]
    grid = SplineGrid.over(SQUARE, 0.1, 3)
    assert rotations(grid, beam) == 5 + 3
    points, weights, place = beam_line(grid, beam)
    assert weights.sum() == pytest.approx(0.5)
    axis = beam.start + place[:, None] * (beam.stop - beam.start)
    aside = (points - axis) @ [-0.8, 0.6]
    np.testing.assert_allclose((points - axis) @ [0.6, 0.8], 0.0, atol=1e-15)
    assert weights @ aside == pytest.approx(0.0, abs=1e-15)
    assert weights @ aside**2 == pytest.approx(0.5 * 0.01**2 / 12)  # spread evenly over the width
    assert weights @ place == pytest.approx(0.25)
    wide = replace(beam, width=0.25)
    places, shares = _across(grid, wide)
    assert (len(places), shares.sum(), shares @ places**2) == (9, pytest.approx(1.0), pytest.approx(0.25**2 / 12))


def test_layers_have_the_sides_of_a_ring() -> None:
    """delta = 0.32 h of an isotropic plate: sqrt(1 / (12 k)); a square has four sides, a circle one."""
    even = Wood(10e9, 10e9, 10e9 / 2.6, 0.3, 500.0, G_LT=10e9 / 2.6, G_RT=10e9 / 2.6)
    assert _depth(even, 0.7, 5 / 6) == pytest.approx(np.sqrt(1 / 10))
    wood = Wood(10e9, 1e9, 0.7e9, 0.4, 400.0, G_LT=0.6e9, G_RT=0.05e9)
    assert _depth(wood, 0.0, 5 / 6) == pytest.approx(np.sqrt(0.7 / (10 * 0.6)))
    assert _depth(wood, np.pi / 2, 5 / 6) == pytest.approx(np.sqrt(0.7 / (10 * 0.05)))
    grid = SplineGrid.over(SQUARE, 0.25, 3)
    for ring, outer, left in ((SQUARE, True, True), (SQUARE[::-1], True, False), (SQUARE, False, False)):
        sides = _sides(ring, outer, grid, even, 0.0, 5 / 6, lambda p: np.full(len(p), 0.004))
        assert [s.left for s in sides] == [left] * 4
        assert [s.first for s in sides] == [0, 7, 14, 21]  # 4 cells of degree 3
        np.testing.assert_allclose(np.concatenate([s.delta for s in sides]), 0.004 * np.sqrt(0.1))
        inwards = np.array([(s.points[:2].mean(axis=0) + 0.1 * s.normals[0]) for s in sides])
        assert np.all(inside(inwards, [SQUARE]) == outer)
        assert [s.starts.tolist() for s in sides] == [[0.0, 1.0]] * 4
    (whole,) = _sides(circle(1.0, count=40), True, grid, even, 0.0, 5 / 6, lambda p: np.full(len(p), 9.0))
    assert len(whole.points) == 41
    np.testing.assert_allclose(whole.delta, 0.45 * np.ptp(circle(1.0, count=40), axis=0).min() / 12.0)


def test_a_single_source_is_a_point_source_on_a_wall() -> None:
    """p = rho V'' exp(-j k R) / 2 pi R; R = rho omega^2 V^2 / 2 pi c; two of them with sin(k d) / k d."""
    still = [0.0, 0.0]
    source = Sources(np.array([[0.3, 0.4], [9.0, 9.0]]), np.array([[2e-3, -1e-3], still]), labels=("A0", "plate"))
    at, freq = (0.0, 0.0, 1.2), np.array([100.0, 700.0])
    assert source.distances(at)[0] == pytest.approx(1.3)
    k = 2 * np.pi * freq / SOUND_SPEED
    expected = AIR_DENSITY * 2e-3 / (2 * np.pi * 1.3) * np.exp(-1j * k * 1.3)
    np.testing.assert_allclose(source.pressure(at, freq)[0], expected, rtol=1e-12)
    np.testing.assert_allclose(source.pressure(at, freq, 1.3 / SOUND_SPEED)[1], -np.abs(expected) / 2, rtol=1e-9)
    alone = AIR_DENSITY * (2 * np.pi * freq) ** 2 * np.array([2e-3, -1e-3]) ** 2 / (2 * np.pi * SOUND_SPEED)
    np.testing.assert_allclose(source.resistance(freq, exact=True), alone, rtol=1e-9)
    pair = Sources(np.array([[0.0, 0.0], [0.3, 0.0]]), np.array([[1.0], [1.0]]))
    for exact, within in ((True, 1e-12), (False, 1e-5)):
        found = pair.resistance([700.0], exact=exact)[0]
        both = 2 + 2 * np.sin(k[1] * 0.3) / (k[1] * 0.3)
        assert found == pytest.approx(
            AIR_DENSITY * (2 * np.pi * 700) ** 2 / (2 * np.pi * SOUND_SPEED) * both, rel=within
        )
    open_air = replace(pair, baffled=False)
    assert open_air.shelf == pytest.approx(2 * SOUND_SPEED / 0.3)
    assert open_air.shelf_at(np.array([0.0, open_air.shelf])) == pytest.approx([0.5, 0.75])
    corner = open_air.shelf / (2 * np.pi)
    assert open_air.resistance([corner])[0] == pytest.approx(0.75 * pair.resistance([corner])[0], rel=1e-6)
    ratio = open_air.pressure(at, corner) / pair.pressure(at, corner)
    assert ratio[0, 0] == pytest.approx((1j + 0.5) / (1j + 1))
    some = source.of(np.array([False, True]))
    assert (some.volumes.tolist(), some.labels, some.behind_volumes.size) == ([[-1e-3], [0.0]], ("plate",), 0)
    behind = replace(source, labels=(), behind=np.array([[0.0, 0.4, -0.5]]), behind_volumes=np.array([[3.0, 4.0]]))
    assert behind.of(np.array([True, False])).behind_volumes.tolist() == [[3.0]]
    assert behind.distances_behind((0.0, 0.0, 0.0)) == pytest.approx([np.sqrt(0.41)])
    box = replace(behind, baffled=False)
    turned = box.pressure(at, freq) * np.exp(2j * np.pi * freq * 2e-3)
    np.testing.assert_allclose(box.pressure(at, freq, 2e-3), turned, rtol=1e-9)
    many = Sources(np.array([[0.01 * i, 0.0] for i in range(130)]), np.ones((130, 1)))  # more than a block
    apart = 0.01 * np.abs(np.subtract.outer(np.arange(130), np.arange(130)))
    total = np.sinc(k[1] * apart / np.pi).sum() * AIR_DENSITY * (2 * np.pi * 700) ** 2 / (2 * np.pi * SOUND_SPEED)
    assert many.resistance([700.0])[0] == pytest.approx(total, rel=1e-5)


def test_a_bank_is_its_partial_fractions() -> None:
    poles, residues = np.array([-5 + 300j, -40.0]), np.array([[2 - 1j, 3.0], [0.5, 1.0]])
    bank = Bank(poles, residues, 0.0, (0.0, 0.0))
    s = 2j * np.pi * 70.0
    expected = residues[0] / (s - poles[0]) + residues[0].conj() / (s - poles[0].conj()) + residues[1] / (s + 40.0)
    np.testing.assert_allclose(bank.response(70.0), [expected], rtol=1e-12)


def test_pressure_of_a_mode_at_a_microphone() -> None:
    source, pole = Sources(np.array([[0.0, 0.0]]), np.array([[2e-3]])), np.array([-5 + 900j])
    s = 2j * np.pi * np.array([100.0, 143.0])
    found = pressure(source, (0.0, 0.0, 2.0), pole, np.array([[3.0], [-1.0]]), np.array([100.0, 143.0]), 1e-3)
    gain = AIR_DENSITY * 2e-3 / (4 * np.pi) * np.exp(-s * (2.0 / SOUND_SPEED - 1e-3))
    expected = gain * s**2 / ((s - pole[0]) * (s - pole[0].conj()))
    np.testing.assert_allclose(found, np.outer(expected, [3.0, -1.0]), rtol=1e-12)
    freq = _frequencies(2 * np.pi * np.array([-2 + 300j, -1 + 6000j]), 5000.0)
    assert (freq[0], freq[-1], len(freq)) == (pytest.approx(5.0), pytest.approx(5000.0), 1207)
    for off in (-2, -1, -0.5, 0, 0.5, 1, 2):
        assert np.abs(freq - (abs(-2 + 300j) + 2 * off)).min() < 1e-9
    modes = 2 * np.pi * np.array([300.0, 520.0, 800.0]) * (-0.01 + 1j)
    wide = Sources(
        np.array([[0.0, 0.0], [0.2, 0.1]]), 1e-3 * np.array([[1.0, 2.0, -1.0], [2.0, -1.0, 0.5]]), baffled=False
    )
    bank = microphone(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), 10000.0)
    np.testing.assert_array_equal(bank.poles[:3], modes)
    assert bank.poles[3] == pytest.approx(-wide.shelf)
    assert not bank.residues[3].imag.any()
    fitted = _frequencies(modes, 10000.0)
    fitted = fitted[(fitted >= 50.0) & (fitted <= np.abs(modes).max() / (2 * np.pi))]
    wanted = pressure(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), fitted, bank.delay)
    off = 20 * np.log10(1 + np.abs(bank.response(fitted) / wanted - 1))
    assert bank.error_db == pytest.approx((np.median(off), np.percentile(off, 95)), rel=1e-6)
    assert bank.error_db[0] < 0.2
    f = np.geomspace(60, 780, 50)
    exact = pressure(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), f, bank.delay)
    assert np.median(np.abs(bank.response(f) / exact - 1)) < 0.03
    late = microphone(wide, (0.0, 0.0, 1.0), modes, np.ones((1, 3)), 10000.0, delay=0.0)
    assert late.delay == 0.0
    turned = np.exp(-2j * np.pi * f * bank.delay)[:, None]
    assert np.median(np.abs(late.response(f) / (exact * turned) - 1)) < 0.05


def test_air_of_one_plate_mode_and_one_of_the_cavity_by_hand() -> None:
    kappa, w = AIR_DENSITY * SOUND_SPEED**2 / 0.02, 2 * np.pi * 200.0
    cavity = (np.array([400.0]), np.array([[0.3]]), np.array([0.7]))
    mass, stiffness, pressures = air_matrices(np.array([200.0]), np.array([0.5]), 0.02, (0.005, 0.06), cavity)
    np.testing.assert_allclose(mass, [1.0, AIR_DENSITY * 0.06 / 0.005, kappa / (2 * np.pi * 400) ** 2])
    rows = np.array([[0.5, 1.0, 0.0], [0.3, 0.7, -1.0]])
    np.testing.assert_allclose(stiffness, kappa * rows.T @ rows + np.diag([w * w, 0, 0]))
    np.testing.assert_allclose(pressures, -kappa * rows)
    modes = couple_air(np.array([200.0]), np.array([0.5]), 0.02, (0.005, 0.06), cavity)
    values, vectors = sla.eigh(stiffness, np.diag(mass))
    np.testing.assert_allclose(modes.freq, np.sqrt(np.abs(values)) / (2 * np.pi), atol=1e-4)
    got = np.vstack([modes.plates, modes.hole, modes.cavity])
    np.testing.assert_allclose(np.abs(got), np.abs(vectors), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(modes.kinetic, mass[:, None] * vectors**2, atol=1e-9)
    np.testing.assert_allclose(modes.stored[0, 1:], (w * vectors[0, 1:]) ** 2 / values[1:], rtol=1e-6)
    np.testing.assert_allclose(modes.pressure, pressures @ got, rtol=1e-9)
    shut = couple_air(np.array([200.0]), np.array([0.5]), 0.02, None, (np.zeros(0), np.zeros((0, 1)), np.zeros(0)))
    assert (shut.hole.tolist(), shut.kinetic.tolist()) == ([0.0], [[1.0], [0.0], [0.0]])


def test_shapes_of_a_cavity_have_a_mean_square_of_one() -> None:
    ring = SQUARE * [0.5, 0.3]
    cavity = cavity_modes(ring, 0.1, 900.0)
    c = SOUND_SPEED / 2
    m, n = np.array([[1, 0, 1, 2, 2], [0, 1, 1, 0, 1]])
    np.testing.assert_allclose(cavity.freq, c * np.hypot(m / 0.5, n / 0.3), rtol=1e-4)
    assert cavity.volume == pytest.approx(0.015)
    points = np.array([[0.0, 0.1], [0.25, 0.1], [0.5, 0.0]])
    first = cavity.shapes(points)[:, 0]
    np.testing.assert_allclose(first / first[0], [1.0, 0.0, -1.0], atol=1e-3)
    assert abs(first[0]) == pytest.approx(np.sqrt(2.0), rel=1e-3)  # cos^2 has a mean of 1/2
    assert cavity_modes(ring, 0.2, 900.0).volume == pytest.approx(0.03)
    with pytest.raises(ValueError, match="read-only"):
        cavity.freq[0] = 1.0


def test_volumes_and_pressures_of_two_oscillators_by_hand() -> None:
    freq, loss = np.array([60.0, 100.0, 200.0, 950.0, 1000.0]), np.array([0.03, 0.03, 0.03, 0.02, 0.001])
    bridge, signs = np.array([1.0, 1.3, 3.5, 1.0, 2.0]), np.array([[1, 1, 1, -1, 1], [1, 1, 1, 1, -1.0]])
    heard = pressure_shapes(freq, loss, bridge, (1, 2), 0.013, 3.0, 0.004, signs)
    volumes = displaced_volumes((100.0, 200.0), (1.3, 3.5), 0.013)
    assert heard[:, 0].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(heard[:, 1:3], [AIR_DENSITY * np.array(volumes) / (12 * np.pi)] * 2)
    above = np.sqrt(AIR_DENSITY * SOUND_SPEED * np.array([0.004, 0.001]) / (4 * np.pi * 2 * np.pi * freq[3:])) / 3
    np.testing.assert_allclose(heard[:, 3:], signs[:, 3:] * above)
    total = 1.3**2 + 3.5**2
    shut = (1.69 * 1e4 + 12.25 * 4e4) / total
    hole = 5e4 - shut
    A = np.sqrt((2 * np.pi) ** 2 * (shut - 4e8 / hole) / (total * AIR_DENSITY * SOUND_SPEED**2 / 0.013))
    assert volumes == pytest.approx((A * 1.3 * 1e4 / (1e4 - hole), A * 3.5 * 4e4 / (4e4 - hole)))
    for freqs, shapes in (((100.0, 200.0), (0.0, 1.0)), ((100.0, 200.0), (1.0, 0.0))):
        with pytest.raises(ValueError, match=r"modes at 100\.0 and 200\.0 Hz"):
            displaced_volumes(freqs, shapes, 0.013)


def test_runs_of_equal_eigenvalues() -> None:
    found = clusters(np.array([1.0, 1.0 + 5e-10, 2.0, 2.0 + 5e-9, 3.0]))
    assert [(s.start, s.stop) for s in found] == [(0, 2), (2, 3), (3, 4), (4, 5)]
    assert clusters(np.zeros(0)) == []
    assert [(s.start, s.stop) for s in clusters(np.array([0.0, 1e-22, 1.0]))] == [(0, 2), (2, 3)]


def test_blocks_couple_with_their_neighbours_alone() -> None:
    band = csr_matrix(np.eye(200) + np.eye(200, k=30) + np.eye(200, k=-30))
    assert _blocks(band) == [0, 64, 128, 192, 200]
    wide = csr_matrix(np.eye(200) + np.eye(200, k=90) + np.eye(200, k=-90))
    assert _blocks(wide) == [0, 64, 154, 200]
    assert _blocks(csr_matrix(np.eye(5))) == [0, 5]
    matrix = csr_matrix(np.array([[1.0, 0, 1], [0, 1, 1], [1, 1, 1]]))
    assert _positions(matrix, np.array([2.0, 5.0, np.nan])).tolist() == [2.0, 5.0, 3.5]
    diagonal = np.array([4.0, 9.0])
    np.testing.assert_allclose(
        BlockSolver(csc_matrix(np.diag(diagonal)), np.zeros(2)).solve(np.ones((2, 1)))[:, 0], 1 / diagonal
    )


@pytest.mark.parametrize("n", [60, 900])
def test_lowest_modes_are_those_of_the_dense_problem(n: int) -> None:
    """A chain with one mass in five missing: dense below 700 unknowns, by Lanczos beyond."""
    k = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    m = np.where(np.arange(n) % 5 == 0, 0.0, 1.0 + 0.1 * np.cos(np.arange(n)))
    light, heavy = np.flatnonzero(m == 0), np.flatnonzero(m)
    condensed = k[np.ix_(heavy, heavy)] - k[np.ix_(heavy, light)] @ sla.solve(
        k[np.ix_(light, light)], k[np.ix_(light, heavy)]
    )
    exact = sla.eigh(condensed, np.diag(m[heavy]), eigvals_only=True)
    shift = 0.3 * exact[5]
    inverse = sla.inv(k + shift * np.diag(m))
    mass = csc_matrix(np.diag(m))
    values, vectors = lowest(lambda f: inverse @ f, mass, shift, count=7)
    np.testing.assert_allclose(values, exact[:7], rtol=1e-8)
    np.testing.assert_allclose(vectors.T @ (m[:, None] * vectors), np.eye(7), atol=1e-7)
    np.testing.assert_allclose(k @ vectors, values * (m[:, None] * vectors), atol=1e-6 * np.abs(k @ vectors).max())
    limit = 0.5 * (exact[9] + exact[10])
    assert len(lowest(lambda f: inverse @ f, mass, shift, below=limit)[0]) == 10


def test_names_of_the_first_modes() -> None:
    """A0 has most of its energy in the hole, T1 above it the largest volume over f^2, both below 400 Hz."""
    freq = np.array([90.0, 100.0, 180.0, 250.0, 390.0, 410.0])
    kinetic = np.array([[0.8, 0.2, 0.9, 0.9, 0.4, 0.1], [0.2, 0.8, 0.1, 0.1, 0.0, 0.9], [0.0, 0.0, 0.0, 0.0, 0.6, 0.0]])
    top = np.array([9.0, 1.0, 3.0, -7.0, 99.0, 99.0])
    assert named_modes(freq, kinetic, top) == {"A0": 1, "T1": 3}
    assert named_modes(freq, kinetic * [[1], [0], [1]], top) == {"T1": 0}
    assert named_modes(np.array([0.0, 100.0]), kinetic[:, :2], top[:2]) == {}
    assert named_modes(freq[4:], kinetic[:, 4:], top[4:]) == {}
    assert named_modes(np.array([399.0, 400.0]), kinetic[:, [1, 1]], top[:2]) == {"A0": 0}


def drawing(**changes) -> BodyDrawing:
    top = PlateDrawing(SPRUCE, 2.5e-3, HINGED, size=0.04)
    plain = BodyDrawing(
        outline=SQUARE * [0.30, 0.22], hole=circle(0.03, (0.08, 0.12), 90), top=top, back=None, depth=0.09,
        cavity_to=1000.0, end_correction=1.5, air_loss=0.0, extra_loss=0.0, baffled=True, fmax=900.0,
        points=np.array([[0.2, 0.1], [0.24, 0.06]]), directions=np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]),
        heights=np.array([0.0, 0.01]),
    )  # fmt: skip
    return replace(plain, **changes)


@pytest.fixture(scope="module")
def modes():
    return body_modes(drawing())


def test_numbers_of_a_drawn_body_fit_together(modes) -> None:
    n, hole = len(modes.freq), int(modes.hole_from[0])
    whole = 0.3 * 0.22 - np.pi * 0.0009
    assert modes.masses == pytest.approx([whole * 2.5e-3 * SPRUCE.density, 0.0], rel=1e-3)
    assert modes.areas[:hole].sum() == pytest.approx(whole, rel=1e-3)
    assert modes.areas[hole:].sum() == pytest.approx(np.pi * 0.0009, rel=1e-3)
    assert len(modes.sources) == len(modes.areas) == len(modes.volumes)
    np.testing.assert_allclose(modes.kinetic.sum(axis=0), 1.0, rtol=1e-9)
    assert (modes.volumes.shape[1], modes.shapes.shape, modes.back_volumes.shape) == (n, (2, n), (0, n))
    assert np.all(modes.freq <= 900.0)
    assert list(modes.arrays())[:3] == ["freq", "loss", "radiation_loss"]
    omega = 2 * np.pi * modes.freq
    heard = Sources(modes.sources, modes.volumes).resistance(modes.freq) / omega
    np.testing.assert_allclose(modes.radiation_loss, heard, rtol=1e-6)
    assert modes.labels()[modes.named()["A0"]] == "A0"
    assert modes.cavity_freq == pytest.approx([SOUND_SPEED / 0.6, SOUND_SPEED / 0.44, 1000 * 0.9654], rel=0.02)
    free = replace(modes, freq=np.append(0.0, modes.freq[1:]))
    assert free.named() == {}
    parts = np.array(["plate", "hole", "cavity"])[np.argmax(modes.kinetic, axis=0)]
    assert free.labels() == tuple(parts)


def test_losses_are_added_by_their_shares_of_the_energy(modes) -> None:
    glued, airy = body_modes(drawing(extra_loss=0.01)), body_modes(drawing(air_loss=0.02))
    plates, air = (glued.loss - modes.loss) / 0.01, (airy.loss - modes.loss) / 0.02
    np.testing.assert_allclose(plates + air, 1.0, rtol=1e-6)
    assert plates.min() > 0
    assert air.min() > 0
    open_air = body_modes(drawing(baffled=False))
    shelf = replace(Sources(modes.sources, modes.volumes), baffled=False)
    heard = shelf.resistance(modes.freq) / (2 * np.pi * modes.freq)
    np.testing.assert_allclose(modes.loss - open_air.loss, modes.radiation_loss - heard, rtol=1e-4, atol=1e-9)


def test_static_compliance_does_not_depend_on_the_highest_mode(modes) -> None:
    def static(of):
        return (of.shapes / (2 * np.pi * of.freq) ** 2) @ of.shapes.T + of.residual

    low = body_modes(drawing(fmax=450.0))
    assert len(low.freq) < len(modes.freq)
    np.testing.assert_allclose(static(low), static(modes), rtol=1e-3)
    few = modes.below(300.0)
    assert few.freq.tolist() == modes.freq[modes.freq < 300.0].tolist()
    np.testing.assert_allclose(static(few), static(modes), rtol=1e-9)
    for name in ("loss", "radiation_loss", "kinetic", "shapes", "volumes"):
        np.testing.assert_array_equal(getattr(few, name), getattr(modes, name)[..., : len(few.freq)])
    assert modes.below(1e4) is modes


def test_a_plate_without_air_has_its_own_modes() -> None:
    bare = body_modes(drawing(depth=0.0, hole=None))
    plate = Plate([SQUARE * [0.30, 0.22]], SPRUCE, 2.5e-3, HINGED, size=0.04).modes(900.0)
    np.testing.assert_allclose(bare.freq, plate.freq, rtol=1e-9)
    np.testing.assert_allclose(bare.vacuum_freq, plate.freq, rtol=1e-9)
    np.testing.assert_allclose(bare.loss - bare.radiation_loss, plate.loss, rtol=1e-9)
    np.testing.assert_allclose(np.abs(bare.shapes[0]), np.abs(plate.shapes([[0.2, 0.1]])[0]), rtol=1e-6, atol=1e-9)
    assert (bare.cavity_freq.size, bare.kinetic[0].min(), int(bare.hole_from[0])) == (0, 1.0, len(bare.sources))
    free = body_modes(drawing(depth=0.0, hole=None, top=PlateDrawing(SPRUCE, 2.5e-3, FREE, size=0.04)))
    assert free.freq[:3].tolist() == [0.0] * 3
    assert free.freq[3] > 0
    assert free.vacuum_freq[0] == pytest.approx(free.freq[3])
    assert not free.loss[:3].any()


def test_a_back_adds_its_mass_and_its_volume() -> None:
    back = PlateDrawing(SPECIES["mahogany"].wood, 3e-3, HINGED, size=0.04)
    both, rigid = body_modes(drawing(back=back, fmax=500.0)), body_modes(drawing(fmax=500.0))
    assert both.masses[1] == pytest.approx(0.3 * 0.22 * 3e-3 * 545.0, rel=1e-4)
    assert both.masses[0] == rigid.masses[0]
    assert both.back_volumes.shape == (len(both.back_sources), len(both.freq))
    assert both.freq[0] < rigid.freq[0]  # a wall that yields makes the air softer
    np.testing.assert_allclose(both.kinetic.sum(axis=0), 1.0, rtol=1e-9)
    heard = sum(
        Sources(p, v).resistance(both.freq)
        for p, v in ((both.sources, both.volumes), (both.back_sources, both.back_volumes))
    )
    np.testing.assert_allclose(both.radiation_loss, heard / (2 * np.pi * both.freq), rtol=1e-6)


def test_parts_of_a_drawing_by_hand() -> None:
    body = drawing()
    points, weights = mouth_of(body.hole)
    assert weights.sum() == pytest.approx(np.pi * 0.0009, rel=1e-3)
    assert opening_of(body, (points, weights)) == (pytest.approx(np.pi * 0.0009, rel=1e-3), 2.5e-3)
    assert opening_of(body, None) is None
    sloped = replace(body, top=replace(body.top, thickness=lambda p: 2e-3 + 0.01 * p[..., 0]))
    assert opening_of(sloped, (points, weights))[1] == pytest.approx(2.8e-3, rel=0.02)
    plate = made_plate([body.outline], body.top, 900.0)
    load = point_loads(plate, body)
    w = np.random.default_rng(1).normal(size=plate.functions)
    at, step = body.points[1], 1e-6
    value = plate.operator([at]) @ w
    beside = np.array([step, 0.0])
    slope = (plate.operator([at + beside]) @ w - plate.operator([at - beside]) @ w) / (2 * step)
    assert load[0] @ w == pytest.approx((plate.operator([body.points[0]]) @ w)[0])
    assert load[1] @ w == pytest.approx((0.8 * value - 0.01 * 0.6 * slope)[0], rel=1e-6)
    assert cell_of(body.outline, body.top, 900.0) == 0.04
    auto = replace(body.top, size=0.0)
    assert cell_of(body.outline, auto, 4000.0) == cell_size(SPRUCE, 2.5e-3, 4000.0)
    varied = replace(auto, thickness=lambda p: 2e-3 + 0.01 * p[..., 0])  # 2 to 5 mm, mean over the ring's corners
    assert cell_of(body.outline, varied, 4000.0) == cell_size(SPRUCE, 3.5e-3, 4000.0)
    # three fields a cell (w and two shear strains), five with beams
    fine = replace(body.top, size=np.sqrt(0.3 * 0.22 * 3 / 25_001))
    with pytest.raises(ValueError, match="some 25001 unknowns, of which 25000 are allowed"):
        made_plate([body.outline], fine, 900.0)
    low, high = first_modes(replace(body, fmax=700.0), [Edge(1e4, 0.0), CLAMPED])
    assert low["T1"] < high["T1"]
    named = body_modes(drawing(fmax=700.0, top=replace(body.top, edge=CLAMPED)))
    assert high == pytest.approx({name: named.freq[k] for name, k in named.named().items()})


def test_lumps_on_a_whole_body_by_hand() -> None:
    """Mass, spring and dashpot at point 1 counted half: Rayleigh's quotient to first order, and 2 sigma = d phi^2."""
    body = WholeBody(drawing())
    values, vectors = body.modes(count=6)
    plain = body.described(values, vectors)
    lump = Lump(1, 0.5, 1e-5, 30.0, 0.02)
    loaded = WholeBody(drawing(), [lump])
    assert loaded.mass == pytest.approx(body.mass + 1e-5)
    assert body.size == loaded.size
    phi = 0.5 * plain.shapes[1]
    moved = values + phi**2 * (30.0 - values * 1e-5)
    np.testing.assert_allclose(loaded.modes(count=6)[0], moved, rtol=2e-5)
    damped = WholeBody(drawing(), [Lump(1, 0.5, 0.0, 0.0, 0.02)]).described(values, vectors)
    np.testing.assert_allclose(damped.loss - plain.loss, 0.02 * phi**2 / np.sqrt(values), rtol=1e-9)
    np.testing.assert_allclose(plain.freq, np.sqrt(values) / (2 * np.pi))
    assert not body.described(values, vectors, residual=False).residual.any()
    static = (plain.shapes / values) @ plain.shapes.T + plain.residual
    more = body.described(*body.modes(count=20))
    np.testing.assert_allclose(
        (more.shapes / (2 * np.pi * more.freq) ** 2) @ more.shapes.T + more.residual, static, rtol=1e-4
    )
    f = np.random.default_rng(2).normal(size=(body.size, 2))
    y = body.solve(f)
    back = body.stiffness(y) + body.shift * (body.mass_matrix @ y)
    np.testing.assert_allclose(back, f, atol=1e-5 * np.abs(f).max())  # 1.0 to 1.5e-6 by the kernel of BLAS
    below = body.modes(below=0.5 * (plain.freq[3] + plain.freq[4]))[0]
    np.testing.assert_allclose(below, values[:4], rtol=1e-6)
    omega = np.sqrt(values)
    radiated, swept = body._radiated(omega, vectors)
    (top,), (opening, shares) = body.plates, mouth_of(body.drawing.hole)
    motion = top.operator(top.quadrature.points) @ vectors[: top.stiffness.shape[0]][-top.functions :]
    points, _, volumes = gathered_sources(top.quadrature.points, top.quadrature.weights, motion, 0.02)
    np.testing.assert_allclose(swept, top.quadrature.weights @ motion, rtol=1e-9, atol=1e-12)
    disc, parts, _ = gathered_sources(opening, shares, np.zeros((len(shares), 0)), 0.02)
    flow = vectors[top.stiffness.shape[0]]
    points, volumes = np.vstack([points, disc]), np.vstack([volumes, np.outer(parts / parts.sum(), flow)])
    apart = np.hypot(*(points[:, None] - points).T)
    for k, w in enumerate(omega):
        total = volumes[:, k] @ np.sinc(w / SOUND_SPEED * apart / np.pi) @ volumes[:, k]
        assert radiated[k] == pytest.approx(AIR_DENSITY * w**2 / (2 * np.pi * SOUND_SPEED) * total, rel=1e-9)
    fixed = with_cells(replace(drawing(), top=replace(drawing().top, size=0.0)), 1000.0)
    assert (fixed.fmax, fixed.top.size, fixed.back) == (1000.0, cell_size(SPRUCE, 2.5e-3, 1000.0), None)


def test_losses_of_a_whole_body_are_added_by_their_shares() -> None:
    body = WholeBody(drawing())
    values, vectors = body.modes(count=5)
    described = {
        name: WholeBody(drawing(**change)).described(values, vectors, residual=False)
        for name, change in (("plain", {}), ("glue", {"extra_loss": 0.01}), ("air", {"air_loss": 0.02}),
                             ("open", {"baffled": False}))
    }  # fmt: skip
    plain = described["plain"].loss
    glue, air = (described["glue"].loss - plain) / 0.01, (described["air"].loss - plain) / 0.02
    wood = vectors[: body.plates[0].stiffness.shape[0]]
    stored = np.einsum("ij,ij->j", wood, body.plates[0].stiffness @ wood) / values
    np.testing.assert_allclose(glue, stored, rtol=1e-6)
    np.testing.assert_allclose(air, 1 - stored, rtol=1e-6, atol=1e-9)
    heard = body._radiated(np.sqrt(values), vectors)[0] - WholeBody(drawing(baffled=False))._radiated(
        np.sqrt(values), vectors
    )[0]  # fmt: skip
    np.testing.assert_allclose(plain - described["open"].loss, heard / np.sqrt(values), rtol=1e-6, atol=1e-12)
    known = body_modes(drawing())
    np.testing.assert_allclose(plain, known.loss[:5], rtol=0.02)
    same = body_change(body, values, vectors, body, body, 1e-3, 3, residual=False)
    for side in (same.less, same.more):
        np.testing.assert_allclose(side.freq, described["plain"].freq[:3], rtol=1e-12)
        np.testing.assert_allclose(side.loss, plain[:3], rtol=1e-9)
    assert same.step == 1e-3
    back = PlateDrawing(SPECIES["mahogany"].wood, 3e-3)
    fixed = with_cells(drawing(back=back), 1200.0)
    assert fixed.back.size == cell_size(back.wood, 3e-3, 1200.0)


def test_results_that_are_kept_are_those_made_anew() -> None:
    """Plates of one grid that differ in one number each, with what was kept of the others and without."""
    beam = Beam(np.array([0.05, 0.05]), np.array([0.25, 0.15]), 0.008, np.array([0.01]), SPRUCE)
    moved = (
        replace(beam, start=np.array([0.06, 0.05])), replace(beam, stop=np.array([0.25, 0.14])),
        replace(beam, width=0.009), replace(beam, heights=np.array([0.011])), replace(beam, above=True),
        replace(beam, wood=SPECIES["maple"].wood),
    )  # fmt: skip
    springs, thin = Edge(1e5, 100.0), replace(SPRUCE, G_LT=np.inf)  # most do not shear, which takes less time
    variants = [
        {}, {"thickness": 3.1e-3}, {"grain": 0.2}, {"edge": Edge(2e5, 100.0)}, {"edge": FREE}, {"beams": [beam]},
        {"edge": Edge(1e5, 200.0)}, {"wood": replace(thin, E_L=12e9)}, {"beams": [beam, moved[0]]},
        *({"beams": [b]} for b in moved), {"wood": SPRUCE}, {"wood": SPRUCE, "shear_factor": 0.7},
    ]  # fmt: skip

    def freq(change):
        given = {"wood": thin, "thickness": 3e-3, "edge": springs, "size": 0.1} | change
        return Plate([SQUARE * [0.3, 0.2]], **given).modes(count=6).freq

    together = [freq(change) for change in variants]
    for change, found in zip(variants, together, strict=True):
        for kept in plate_parts._RESULTS.values():
            kept.clear()
        np.testing.assert_allclose(freq(change), found, rtol=1e-9, atol=1e-6)
    assert len({tuple(np.round(f, 6)) for f in together}) == len(variants) - 1  # mirrored beams sound alike


def test_names_of_the_package_are_those_of_its_modules() -> None:
    from tonewood.physics import plate as package

    for name in package.__all__:
        value = getattr(package, name)
        assert getattr(value, "__module__", "tonewood.physics.plate").startswith("tonewood.physics.plate")
    assert (package.SOUND_SPEED, package.Beam, package.body_modes) == (SOUND_SPEED, Beam, body_modes)
    with pytest.raises(AttributeError, match="no attribute 'Plates'"):
        _ = package.Plates


def test_modes_are_followed_where_they_cross() -> None:
    """Two shapes exchange their places between the second step and the third, and change their signs."""
    u, v, w = np.eye(3)
    steps = [
        SimpleNamespace(freq=np.array([100.0, 110.0, 300.0]), volumes=np.stack([u, v, w], axis=1)),
        SimpleNamespace(freq=np.array([104.0, 106.0, 300.0]), volumes=np.stack([u + 0.3 * v, v - 0.3 * u, w], axis=1)),
        SimpleNamespace(freq=np.array([103.0, 109.0, 300.0]), volumes=np.stack([-v, 50 * u, w], axis=1)),
    ]
    assert followed(steps, 2).tolist() == [[100.0, 110.0], [104.0, 106.0], [109.0, 103.0]]
    assert followed(steps[:1], 1).tolist() == [[100.0]]


def test_pictures_of_shapes_show_height_flow_and_names() -> None:
    from matplotlib.figure import Figure

    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0.05, 0.95, 7), np.linspace(0.05, 0.95, 7)))
    points = np.vstack([np.column_stack([x, y]), [[0.5, 0.5]]])
    hole = circle(0.06, (0.5, 0.5), 12)
    points = np.vstack([points[np.hypot(*(points - 0.5).T) > 0.1], [[0.5, 0.5]]])
    areas = np.full(len(points), 0.02)
    heights = np.column_stack([points[:, 0] - 0.3, points[:, 1] - 0.5])
    heights[-1] = 3.0, -2.0
    sources = Sources(points, heights * areas[:, None], areas=areas, rings=(SQUARE, hole), labels=("A0", "plate"))
    axes = Figure().subplots(1, 3)
    draw_shapes(axes, sources, np.array([98.7, 181.2]), np.array([33.4, 51.6]))
    assert [ax.get_title() for ax in axes] == ["A0 99 Hz, Q 33", "181 Hz, Q 52", ""]
    assert [ax.yaxis_inverted() for ax in axes] == [True, True, False]
    assert [len(ax.lines) for ax in axes] == [2, 2, 0]
    assert [ax.patches[0].get_facecolor()[:3] for ax in axes[:2]] == [
        pytest.approx((0xF0 / 255, 0xB7 / 255, 0xA0 / 255)), pytest.approx((0xA6 / 255, 0xCD / 255, 0xE3 / 255)),
    ]  # fmt: skip
    still = replace(sources, volumes=0.0 * sources.volumes)
    (ax,) = Figure().subplots(1, 1, squeeze=False)[0]
    draw_shapes([ax], still, np.array([50.0]), np.array([9.0]))
    assert not ax.collections[0].get_array().any()  # a mode that does not move is white, and no number is missing
    for ax, column in zip(axes[:2], heights[:-1].T, strict=True):
        mesh = next(c for c in ax.collections if c.get_array() is not None and len(c.get_array()) == len(points) - 1)
        largest = np.quantile(np.abs(column), 0.99)
        np.testing.assert_allclose(mesh.get_array(), np.clip(column / largest, -1, 1))
        assert mesh.get_clim() == (-1.2, 1.2)
        np.testing.assert_allclose(ax.lines[0].get_xdata(), [*SQUARE[:, 1], SQUARE[0, 1]])
        np.testing.assert_allclose(ax.lines[0].get_ydata(), [*SQUARE[:, 0], SQUARE[0, 0]])
