"""Grids, woods, edges, beams, layers and eigenvalues of plates, by values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from plates_by_hand import SPRUCE, SQUARE
from scipy.interpolate import BSpline
from scipy.sparse import csc_matrix, csr_matrix

from tonewood.physics.plate.air import SOUND_SPEED
from tonewood.physics.plate.beams import Beam, _across, beam_line, rotations, torsion_constant
from tonewood.physics.plate.block_solve import BlockSolver, _blocks, _positions
from tonewood.physics.plate.body import (
    named_modes,
)
from tonewood.physics.plate.edge_layer import _depth, _sides
from tonewood.physics.plate.integrals import integrals
from tonewood.physics.plate.lanczos import lowest
from tonewood.physics.plate.microphones import _background
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
from tonewood.physics.plate.plate import CLAMPED, FREE, HINGED, Edge, Plate
from tonewood.physics.plate.radiation import Sources
from tonewood.physics.plate.splines import SplineGrid, line_functions
from tonewood.physics.plate.wood import SPECIES, Wood

# -- plates ------------------------------------------------------------------------------------------------------------


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


# -- eigenvalues -------------------------------------------------------------------------------------------------------


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
