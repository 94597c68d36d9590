"""Outlines of plates: closed rings of points, the area inside of them, and the points of integrals over it.

A ring is an (n, 2) array, m, closed from its last point to its first. The first ring of a plate is its outline, the
others are holes. Coordinates: x nut to bridge, y bass to treble.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.plate.splines import SplineGrid
from tonewood.support.arrays import Floats, Indices

#: a classical guitar's outline, made up: x (m from the neck joint) and half of the width there (m), neck to tail
_HALF = np.array(
    [
        (0.0, 0.0), (0.002, 0.060), (0.028, 0.112), (0.090, 0.139), (0.150, 0.128), (0.200, 0.1185), (0.250, 0.1285),
        (0.310, 0.163), (0.365, 0.1825), (0.420, 0.168), (0.462, 0.116), (0.482, 0.052), (0.485, 0.0),
    ]
)  # fmt: skip
#: its length, and where its upper bout, waist and lower bout are widest or narrowest (m)
_LENGTH, _BOUTS = 0.485, (0.090, 0.200, 0.365)
#: points that are compared with a ring at once
_AT_ONCE = 256


def circle(radius: float, centre: ArrayLike = (0.0, 0.0), count: int = 720) -> Floats:
    """(count, 2) polygon with the area of a circle."""
    angle = 2 * np.pi * np.arange(count) / count
    r = radius * np.sqrt(2 * np.pi / count / np.sin(2 * np.pi / count))
    return np.asarray(np.asarray(centre) + r * np.column_stack([np.cos(angle), np.sin(angle)]))


def guitar_outline(length: float, upper: float, waist: float, lower: float, count: int = 1280) -> Floats:
    """(count, 2) outline of a guitar from its length and three widths, m; x is 0 at the neck joint.

    The shape is made up: a periodic cubic spline over chord length through points that are scaled to the four sizes.
    """
    scale = [size / (2 * half) for size, half in ((upper, 0.139), (waist, 0.1185), (lower, 0.1825))]
    half = _HALF * [length / _LENGTH, 1.0]
    half[:, 1] *= np.interp(_HALF[:, 0], _BOUTS, scale)
    return smooth_ring(np.vstack([half, half[-2:0:-1] * [1.0, -1.0]]), count)


def smooth_ring(points: ArrayLike, count: int = 1280) -> Floats:
    """(count, 2) periodic cubic spline over chord length through points (n, 2)."""
    from scipy.interpolate import CubicSpline

    p = np.asarray(points, dtype=np.float64)
    closed = np.vstack([p, p[:1]])
    chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    spline = CubicSpline(chord, closed, bc_type="periodic")
    return np.asarray(spline(np.linspace(0.0, chord[-1], count + 1)[:-1]))


def refined(ring: Floats, spacing: float) -> Floats:
    """Ring with points added on its sides, none longer than `spacing` m."""
    after = np.roll(ring, -1, axis=0)
    parts = np.maximum(1, np.ceil(np.hypot(*(after - ring).T) / spacing)).astype(int)
    return np.vstack([a + (b - a) * np.arange(n)[:, None] / n for a, b, n in zip(ring, after, parts, strict=True)])


def area(ring: Floats) -> float:
    """Area of a ring, m^2, by the sum of its triangles; positive whichever way it runs."""
    x, y = ring.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def inside(points: ArrayLike, rings: Sequence[Floats]) -> NDArray[np.bool_]:
    """(n,) whether points (n, 2) lie inside the first ring and in none of the others, by the even-odd rule."""
    p = np.atleast_2d(np.asarray(points, dtype=np.float64))
    odd = np.zeros(len(p), dtype=bool)
    for ring in rings:
        a, b = ring, np.roll(ring, -1, axis=0)
        rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
        for first in range(0, len(p), _AT_ONCE):
            x, y = p[first : first + _AT_ONCE].T[:, :, None]
            level = (a[:, 1] > y) != (b[:, 1] > y)
            left = x < a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
            odd[first : first + _AT_ONCE] ^= (np.count_nonzero(level & left, axis=1) % 2).astype(bool)
    return odd


def crossing(ring: Floats, other: Floats | None = None) -> Floats | None:
    """Return the first point (2,) at which a ring crosses itself or `other`; None if there is none."""
    a, b = ring, np.roll(ring, -1, axis=0)
    c, d = (a, b) if other is None else (other, np.roll(other, -1, axis=0))
    for i in range(len(a)):
        later = slice(i + 2, len(c) - (i == 0)) if other is None else slice(None)
        p, q = c[later], d[later]
        side, across = b[i] - a[i], q - p
        turn = side[0] * across[:, 1] - side[1] * across[:, 0]
        gap = p - a[i]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (gap[:, 0] * across[:, 1] - gap[:, 1] * across[:, 0]) / turn
            t = (gap[:, 0] * side[1] - gap[:, 1] * side[0]) / turn
        hit = (turn != 0) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        if hit.any():
            return np.asarray(a[i] + s[np.argmax(hit)] * side)
    return None


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Points and weights of integrals over a plate, in groups of cells with the same number of points.

    groups : (cells (n, 2), points (n, q, 2) in m, weights (n, q) in m^2), weights of unused points 0.
    grid : of its cells.
    whole : (groups,) whether the cells of a group lie inside, with the same points and weights in each.
    """

    groups: tuple[tuple[Indices, Floats, Floats], ...]
    grid: SplineGrid
    whole: tuple[bool, ...]

    @property
    def points(self) -> Floats:
        """(n, 2) all points, m."""
        return np.concatenate([p[w > 0] for _, p, w in self.groups])

    @property
    def weights(self) -> Floats:
        """(n,) their weights, m^2."""
        return np.concatenate([w[w > 0] for _, _, w in self.groups])


def quadrature(grid: SplineGrid, rings: Sequence[Floats], strips: int = 4) -> Quadrature:
    """Points of integrals over the area inside the rings.

    Cells away from the rings take (p + 1)^2 Gauss points. Cells that a ring may cut are scanned along y at p + 1 Gauss
    abscissae in each of `strips` parts of their width; each part of a scan line inside takes p + 1 Gauss points.
    """
    g, w = np.polynomial.legendre.leggauss(grid.degree + 1)
    g, w = (g + 1) / 2, w / 2
    cut = _near_rings(grid, rings)
    centres = grid.low + grid.size * (np.indices(tuple(grid.cells)).transpose(1, 2, 0) + 0.5)
    whole = np.argwhere(~cut & inside(centres.reshape(-1, 2), rings).reshape(cut.shape))
    tensor = np.stack(np.meshgrid(g, g, indexing="ij"), axis=-1).reshape(-1, 2)
    points = grid.low + grid.size * (whole[:, None, :] + tensor)
    weights = np.tile(np.outer(w, w).ravel() * grid.size.prod(), (len(whole), 1))
    groups = [(whole, points, weights)] if len(whole) else []
    same = [True] * len(groups)
    points_of: dict[tuple[int, int], list[Floats]] = {}
    places = [((s + a) / strips, b / strips) for s in range(strips) for a, b in zip(g, w, strict=True)]
    for i in np.flatnonzero(cut.any(axis=1)):
        for position, share in places:
            x = grid.low[0] + grid.size[0] * (i + position)
            for start, stop in (_scan(rings, x) - grid.low[1]) / grid.size[1]:
                for j in range(max(0, int(np.floor(start))), min(int(grid.cells[1]), int(np.ceil(stop)))):
                    if cut[i, j] and (length := min(stop, j + 1) - max(start, j)) > 0:
                        y = grid.low[1] + grid.size[1] * (max(start, j) + length * g)
                        rows = np.column_stack([np.full_like(y, x), y, share * length * w * grid.size.prod()])
                        points_of.setdefault((int(i), j), []).append(rows)
    if points_of:
        blocks = [np.concatenate(rows) for rows in points_of.values()]
        most = max(map(len, blocks))
        padded = np.array([np.vstack([b, np.tile([*b[0, :2], 0.0], (most - len(b), 1))]) for b in blocks])
        groups.append((np.array(list(points_of)), padded[..., :2], padded[..., 2]))
        same.append(False)
    return Quadrature(tuple(groups), grid, tuple(same))


def _scan(rings: Sequence[Floats], x: float) -> Floats:
    """(n, 2) intervals of y inside the rings on the line at x, m."""
    crossings = []
    for ring in rings:
        a, b = ring, np.roll(ring, -1, axis=0)
        hit = (a[:, 0] > x) != (b[:, 0] > x)
        a, b = a[hit], b[hit]
        crossings.append(a[:, 1] + (x - a[:, 0]) * (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0]))
    return np.sort(np.concatenate(crossings)).reshape(-1, 2)


def _near_rings(grid: SplineGrid, rings: Sequence[Floats]) -> NDArray[np.bool_]:
    """(n_x, n_y) cells within a tenth of a cell of a ring."""
    near = np.zeros(tuple(grid.cells), dtype=bool)
    steps = 0.1 * grid.size * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    for ring in rings:
        samples = refined(ring, float(grid.size.min()) / 12)
        x, y = grid.cell_of((samples[:, None, :] + steps).reshape(-1, 2)).T
        near[x, y] = True
    return near
