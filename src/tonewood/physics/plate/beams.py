"""Braces and bridges: beams on a strip of the plate, whose energies are integrals of the plate's displacement.

With s along the line, n across it, (u, w) the motion of the plate's middle surface along s and out of its plane, H the
plate's thickness, beta = w_s - gamma the turn of its fibres, h the beam's height (below the plate), b its width and
theta(s) the rotation of its section,

    2 U = int EA eps^2 + EI theta_s^2 + k GA (mean w_s - theta)^2 + GJ w_sn^2 ds,   eps = u_s + H/2 beta_s + h/2 theta_s
    2 T = int m w'^2 + m (h^2/12 + e^2) (w_s'^2 + w_n'^2) ds,                       e = (H + h) / 2

Plane sections stay plane but not normal (S. P. Timoshenko, Phil. Mag. 41 (1921) 744; k = 5/6 of a rectangle): wood is
soft in shear, E/G is about 15, so that a brace 15 mm high loses a quarter of its bending stiffness at half a wavelength
of 100 mm. theta is sought among splines of its own and carries no mass.

The integrands are averaged over the beam's width b, as a beam on a line would kink the plate in its plane; that adds
the moment of inertia m b^2/12, too. Saint-Venant torsion, J = l^3 L (1/3 - 0.21 l/L (1 - l^4 / 12 L^4)) of a rectangle
of sides l <= L (W. C. Young, Roark's Formulas, 7th ed. (2002), table 10.1). Crossing beams are not cut through one
another.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from tonewood.physics.plate.splines import SplineGrid, line_functions
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


#: Timoshenko's shear coefficient of a rectangle
_SHEAR = 5 / 6


@dataclass(frozen=True, eq=False)
class Beam:
    """A brace or a bridge of rectangular section.

    start, stop : (2,) m, ends of its axis.
    width : m.
    heights : (n,) m, at n places spread evenly from start to stop, linear between them; one for a constant height.
    wood : of which it is made, its grain along it.
    above : whether it stands on the plate (a bridge) instead of hanging below it (a brace).
    """

    start: Floats
    stop: Floats
    width: float
    heights: Floats
    wood: Wood
    above: bool = False

    @property
    def length(self) -> float:
        """Length of its axis, m."""
        return float(np.hypot(*(self.stop - self.start)))

    def height(self, share: Floats) -> Floats:
        """(n,) m, at shares of the length from 0 (start) to 1 (stop)."""
        return np.interp(share, np.linspace(0.0, 1.0, len(self.heights)), self.heights)

    @property
    def mass(self) -> float:
        """Mass, kg."""
        mean = self.heights[0] if len(self.heights) == 1 else (self.heights[1:] + self.heights[:-1]).mean() / 2
        return float(self.wood.density * self.width * mean * self.length)


def torsion_constant(width: Floats | float, height: Floats) -> Floats:
    """(n,) m^4, Saint-Venant's J of a rectangle."""
    short, long = np.minimum(width, height), np.maximum(width, height)
    ratio = short / long
    return np.asarray(long * short**3 * (1 / 3 - 0.21 * ratio * (1 - ratio**4 / 12)))


@cache
def _gauss(order: int) -> tuple[Floats, Floats]:
    """Points and weights from -1 to 1: short lines ask for them a thousand times in a body."""
    return np.polynomial.legendre.leggauss(order)


def line(start: Floats, stop: Floats, parts: int, order: int = 3) -> tuple[Floats, Floats, Floats]:
    """Gauss points (n, 2), weights (n,) in m and shares of the length (n,) on a straight line in `parts` parts."""
    g, w = _gauss(order)
    share = ((np.arange(parts)[:, None] + (g + 1) / 2) / parts).ravel()
    length = float(np.hypot(*(stop - start)))
    return start + share[:, None] * (stop - start), np.tile(w * length / (2 * parts), parts), share


def beam_matrices(
    grid: SplineGrid, beam: Beam, thickness: Floats | float, shears: bool
) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
    """Stiffness and losses of one beam in the fields (theta, u, v, gamma_x, gamma_y, w), and mass (N, N) of w.

    thickness : m, of the plate, or at the points of `beam_line`.
    shears : whether the plate has the fields gamma.
    Returns two (r + 5N, r + 5N) matrices, r = `rotations`, (r + 3N) without gamma, and one (N, N).
    """
    from scipy.sparse import csr_matrix, diags, eye, hstack, kron, vstack

    points, weights, share = beam_line(grid, beam)
    c, s = (beam.stop - beam.start) / beam.length
    height, wood, b = beam.height(share), beam.wood, beam.width
    below = 1.0 if not beam.above else -1.0
    w_x, w_y, w_xx, w_xy, w_yy = (grid.at(points, d) for d in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
    w_s, w_n = c * w_x + s * w_y, c * w_y - s * w_x
    w_ss = c * c * w_xx + 2 * c * s * w_xy + s * s * w_yy
    w_sn = c * s * (w_yy - w_xx) + (c * c - s * s) * w_xy
    theta, theta_s = (line_functions(share, _parts(grid, beam), grid.degree, order) for order in (0, 1))
    theta_s = csr_matrix(theta_s / beam.length)
    half = diags(np.broadcast_to(below * thickness / 2, share.shape))
    turned_s = [-half @ (c * w_s), -half @ (s * w_s)] if shears else []
    strain = hstack([diags(below * height / 2) @ theta_s, c * w_s, s * w_s, *turned_s, half @ w_ss])
    none = csr_matrix(w_s.shape)
    others = [none] * (2 + len(turned_s))
    bend, twist = hstack([theta_s, *others, none]), hstack([csr_matrix(theta.shape), *others, w_sn])
    # mean over the width, in which the section stays plane
    lines = _across(grid, beam)[1]
    mean = kron(np.outer(np.ones(len(lines)), lines), eye(len(share) // len(lines)))
    shear = hstack([-theta, *others, csr_matrix(mean @ w_s)])

    long = [wood.E_L * b * height, wood.E_L * b * height**3 / 12]
    cross = [wood.G_LR * torsion_constant(b, height), _SHEAR * wood.G_LR * b * height]

    def integral(factors: list[Floats], operator: csr_matrix) -> csr_matrix:
        return csr_matrix(operator.T @ diags(np.concatenate([weights * f for f in factors])) @ operator)

    m, offset = wood.density * b * height, (height + thickness) / 2
    turning = m * (height**2 / 12 + offset**2)
    mass = integral([m, turning, turning], vstack([grid.at(points), w_s, w_n]).tocsr())
    straight, sheared = integral(long, vstack([strain, bend]).tocsr()), integral(cross, vstack([twist, shear]).tocsr())
    return straight + sheared, wood.loss_L * straight + wood.loss_shear * sheared, mass


def rotations(grid: SplineGrid, beam: Beam) -> int:
    """Number of functions in which the rotation of a beam's section is sought."""
    return _parts(grid, beam) + grid.degree


def _parts(grid: SplineGrid, beam: Beam) -> int:
    return max(2, int(np.ceil(beam.length / grid.size.min())))


def beam_line(grid: SplineGrid, beam: Beam) -> tuple[Floats, Floats, Floats]:
    """Points (n, 2), weights (n,) in m and shares of the length (n,) for a beam's integrals, spread over its width.

    Parts along it are at most half a cell long; the same lines of points run through all of them, see `_across`.
    """
    middle, weights, share = line(beam.start, beam.stop, max(2, int(np.ceil(2 * beam.length / grid.size.min()))))
    g, w = _across(grid, beam)
    c, s = (beam.stop - beam.start) / beam.length
    points = middle + g[:, None, None] * np.array([-s, c])
    return points.reshape(-1, 2), np.outer(w, weights).ravel(), np.tile(share, len(g))


def _across(grid: SplineGrid, beam: Beam) -> tuple[Floats, Floats]:
    """Places from the axis (m) and weights, 1 in all, of lines on a beam: Gauss points of parts up to a cell wide."""
    parts = int(np.ceil(beam.width / grid.size.min()))
    g, w = np.polynomial.legendre.leggauss(3)
    places = (np.arange(parts)[:, None] + (g + 1) / 2) / parts - 0.5
    return beam.width * places.ravel(), np.tile(w / (2 * parts), parts)
