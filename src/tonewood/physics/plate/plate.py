"""Modes of a braced orthotropic Kirchhoff plate of any outline by the Rayleigh-Ritz method with B-splines.

    2 U = int kappa^T (h^3/12) Q kappa + eps^T h Q eps dA + springs on the edge + beams
    2 T = int rho h w'^2 dA + beams
    kappa = (w_xx, w_yy, 2 w_xy),    eps = (u_x, v_y, u_y + v_x)

The in-plane motion (u, v) of the plate's middle surface is solved for where there are beams, which hang beside that
surface, and so is the rotation of each beam's sections, which bend and shear; none of these carries mass. The functions
do not know the outline: it limits the integrals, and the edge is held by springs per length, k_w (N/m^2) against w and
k_theta (N) against its slope across the edge. Frequencies are upper bounds of those of the plate on its springs, and
move smoothly with every dimension, as nothing is meshed.

Loss factors are those of the energies: eta_k = phi_k^T K'' phi_k / omega_k^2, K'' of the imaginary parts.

Method: K. Höllig, Finite Element Methods with B-Splines (SIAM, 2003), chapters 3 and 4, without its weight function:
springs hold the edge instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.plate.beams import Beam, beam_line, beam_matrices, line, rotations
from tonewood.physics.plate.outline import Quadrature, quadrature, refined
from tonewood.physics.plate.splines import Order, SplineGrid
from tonewood.physics.plate.wood import Wood

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix
    from scipy.sparse.linalg import SuperLU

Floats = NDArray[np.float64]
#: thickness (m) at points (..., 2)
Thickness = Callable[[Floats], Floats]

#: functions whose mass is below this share of the largest hardly touch the plate and are left out
_LEAST_MASS = 1e-9
#: cells that are integrated at a time
_CHUNK = 96
#: stiff springs that stand for a clamped or hinged edge, in units of D / size^3 and D / size
STIFF = 1e4
#: s of the shift -s^2 of the eigenproblem in units of sqrt(D_R / rho h) / S: below 0, as free plates have zero modes
_SHIFT = 20.0


@dataclass(frozen=True, slots=True)
class Edge:
    """Springs on the outline, per length.

    Attributes
    ----------
    k_w : N/m^2, against displacement; infinite for an edge that does not move.
    k_theta : N, against the slope across the edge; infinite for an edge that does not turn.
    k_in_plane : N/m^2, against displacement in the plate's plane.
    loss : loss factor of the springs.
    """

    k_w: float = 0.0
    k_theta: float = 0.0
    k_in_plane: float = 0.0
    loss: float = 0.0


FREE, HINGED, CLAMPED = Edge(), Edge(np.inf, 0.0), Edge(np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class PlateModes:
    """Modes of a plate in vacuum, mass-normalised.

    Attributes
    ----------
    freq : (n,) Hz.
    loss : (n,) loss factors of wood, braces and edge.
    vectors : (functions, n) shapes of w, 1/sqrt(kg).
    plate : that they are of.
    """

    freq: Floats
    loss: Floats
    vectors: Floats
    plate: Plate

    def shapes(self, points: ArrayLike, order: Order = (0, 0)) -> Floats:
        """(points, n) shapes or their derivatives at points (m, 2)."""
        return np.asarray(self.plate.operator(points, order) @ self.vectors)


class Plate:
    """A plate's matrices.

    Parameters
    ----------
    rings : outline first, then holes, each (n, 2) m. A curved side needs points much closer than `size`: stiff springs
        against displacement alone on the sides of a coarse polygon clamp it (Babuska's paradox).
    wood : of the plate.
    thickness : m, or a function of points.
    edge : springs on the outline.
    beams : braces and bridge.
    size : m, of a cell; see `cell_size`.
    grain : rad, of the plate's grain from x.
    """

    def __init__(
        self,
        rings: Sequence[Floats],
        wood: Wood,
        thickness: float | Thickness,
        edge: Edge = CLAMPED,
        beams: Sequence[Beam] = (),
        *,
        size: float,
        degree: int = 4,
        grain: float = 0.0,
    ):
        from scipy.sparse import csr_matrix

        self.rings, self.wood, self.beams = tuple(rings), wood, tuple(beams)
        self.thickness: Thickness = thickness if callable(thickness) else _constant(thickness)
        self.grid = grid = SplineGrid.over(rings[0], size, degree)
        self.quadrature = quad = quadrature(grid, rings)
        bending = [wood.stiffness(grain), wood.losses(grain)]
        stiffness = integrals(grid, quad, _curvature, lambda x: self.thickness(x) ** 3 / 12, bending)
        (mass,) = integrals(grid, quad, displacement, lambda x: wood.density * self.thickness(x), [np.eye(1)])
        self.fields = 3 if beams else 1
        if beams:
            membrane = integrals(grid, quad, _strain, self.thickness, bending)
            stiffness = [_stacked(m, b) for m, b in zip(membrane, stiffness, strict=True)]
        stiffness = [inner + outer for inner, outer in zip(stiffness, self._edge(edge, quad), strict=True)]
        counts = [rotations(grid, beam) for beam in beams]
        before = sum(counts)
        stiffness = [_stacked(csr_matrix((before, before)), matrix) for matrix in stiffness]
        for i, beam in enumerate(beams):
            points, _, _ = beam_line(grid, beam)
            *own, inertia = beam_matrices(grid, beam, self.thickness(points))
            unknowns = np.concatenate(
                [np.arange(counts[i]) + sum(counts[:i]), np.arange(before, stiffness[0].shape[0])]
            )
            place = csr_matrix(
                (np.ones(len(unknowns)), (unknowns, np.arange(len(unknowns)))), (stiffness[0].shape[0], len(unknowns))
            )
            stiffness = [whole + place @ part @ place.T for whole, part in zip(stiffness, own, strict=True)]
            mass = mass + inertia
        diagonal = mass.diagonal()
        self._keep = np.flatnonzero(diagonal > _LEAST_MASS * diagonal.max())
        # unknowns without mass: rotations of beams, and the motion in the plane
        self._massless = before + (self.fields - 1) * len(self._keep)
        every = np.concatenate([np.arange(before), *(before + self._keep + i * grid.count for i in range(self.fields))])
        self._stiffness: csc_matrix = stiffness[0].tocsr()[every][:, every].tocsc()
        self._losses: csc_matrix = stiffness[1].tocsr()[every][:, every].tocsc()
        self._mass: csc_matrix = mass.tocsr()[self._keep][:, self._keep].tocsc()

    @property
    def functions(self) -> int:
        """Number of functions of each field."""
        return len(self._keep)

    @property
    def mass(self) -> float:
        """Mass with its beams, kg."""
        one = np.ones(self.functions)  # the functions add up to 1 everywhere
        return float(one @ (self._mass @ one))

    @property
    def area(self) -> float:
        """Area without holes, m^2."""
        return float(self.quadrature.weights.sum())

    def operator(self, points: ArrayLike, order: Order = (0, 0)) -> csr_matrix:
        """(points, functions) w or a derivative of it at points (n, 2)."""
        return self.grid.at(points, order)[:, self._keep]

    def modes(self, fmax: float | None = None, count: int | None = None) -> PlateModes:
        """Modes up to `fmax` (Hz), or the first `count`.

        Raises
        ------
        ValueError : neither is given.
        """
        if count is None:
            if fmax is None:
                raise ValueError("fmax or count is wanted")
            count = int(1.15 * self.expected(fmax)) + 15
            while (found := self._solved(count)).freq[-1] < fmax and count < self.functions // 2:
                count = int(1.4 * count)
            few = found.freq <= fmax
            return PlateModes(found.freq[few], found.loss[few], found.vectors[:, few], self)
        return self._solved(count)

    def expected(self, freq: float) -> float:
        """Modes below a frequency (Hz) of the plate without beams: S/2 sqrt(rho h / sqrt(D_L D_R)) f."""
        h = float(np.mean(self.thickness(self.quadrature.points)))
        q = self.wood.stiffness()
        rigidity = np.sqrt(q[0, 0] * q[1, 1]) * h**3 / 12
        return float(self.area / 2 * np.sqrt(self.wood.density * h / rigidity) * freq)

    def residual(self, loads: Floats, modes: PlateModes) -> Floats:
        """(m, m) m/N: compliance between m loads (m, functions) of all modes that `modes` leaves out.

        The difference of two sums over modes of phi phi^T (1 / (omega^2 + s^2) + s^2 / (omega^2 + s^2)^2): all of them
        from the factored stiffness, less those that are kept. It is 1 / omega^2 but for (s / omega)^4, s the shift.
        """
        n, before = self.functions, self._massless
        solve, scale = self._factored
        rhs = np.zeros((before + n, len(loads)))
        rhs[before:] = loads.T
        moved = (scale[:, None] * solve.solve(scale[:, None] * rhs))[before:]
        kept, soft = loads @ modes.vectors, 1 / ((2 * np.pi * modes.freq) ** 2 + self._shift**2)
        rest = loads @ moved + self._shift**2 * (moved.T @ (self._mass @ moved))
        rest = rest - (kept * (soft + self._shift**2 * soft**2)) @ kept.T
        return np.asarray(0.5 * (rest + rest.T))

    @property
    def _shift(self) -> float:
        """Shift s of the eigenproblem, rad/s."""
        h = float(np.mean(self.thickness(self.quadrature.points)))
        return float(_SHIFT * np.sqrt(self.wood.stiffness()[1, 1] * h**2 / 12 / self.wood.density) / self.area)

    @cached_property
    def _factored(self) -> tuple[SuperLU, Floats]:
        """Factors of D (K + s^2 M) D, and D, which gives it a diagonal of ones."""
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu

        shifted = self._stiffness + self._shift**2 * self._full_mass()
        scale = 1.0 / np.sqrt(shifted.diagonal())
        balanced = (diags(scale) @ shifted @ diags(scale)).tocsc()
        options = {"SymmetricMode": True}
        return splu(balanced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options), scale

    def _full_mass(self) -> csc_matrix:
        from scipy.sparse import block_diag, csc_matrix

        if not self._massless:
            return self._mass
        return csc_matrix(block_diag([csc_matrix((self._massless, self._massless)), self._mass]))

    def _solved(self, count: int) -> PlateModes:
        from scipy.sparse import diags
        from scipy.sparse.linalg import LinearOperator, eigsh

        solve, scale = self._factored
        spread = diags(scale)
        k, m = (spread @ self._stiffness @ spread).tocsc(), (spread @ self._full_mass() @ spread).tocsc()
        inverse = LinearOperator(k.shape, matvec=solve.solve, dtype=np.float64)
        # in the range of the mass matrix; a fixed start makes the result repeatable
        start = solve.solve(m @ np.cos(np.arange(k.shape[0], dtype=np.float64) ** 2))
        count = min(count, self.functions - 2)
        values, vectors = eigsh(
            k,
            count,
            m,
            sigma=-(self._shift**2),
            OPinv=inverse,
            v0=start,
            ncv=min(self.functions - 1, int(1.6 * count) + 30),
        )
        order = np.argsort(values)
        values, whole = values[order], scale[:, None] * vectors[:, order]
        shapes = whole[-self.functions :]
        norm = np.sqrt(np.einsum("ij,ij->j", shapes, self._mass @ shapes))
        whole, shapes = whole / norm, shapes / norm
        values = np.maximum(values, 0.0)
        lost = np.einsum("ij,ij->j", whole, self._losses @ whole)
        loss = np.where(values > 1e-6, lost / np.maximum(values, 1e-6), 0.0)
        return PlateModes(np.sqrt(values) / (2 * np.pi), loss, shapes, self)

    def _edge(self, edge: Edge, quad: Quadrature) -> list[csr_matrix]:
        """Stiffness and losses of the springs on the outline; a trace of stiffness holds the plate in its plane."""
        from scipy.sparse import csr_matrix, diags

        grid, size = self.grid, float(self.grid.size.max())
        rigidity = self.wood.stiffness()[0, 0] * float(np.max(self.thickness(self.rings[0]))) ** 3 / 12
        k_w = STIFF * rigidity / size**3 if np.isinf(edge.k_w) else edge.k_w
        k_theta = STIFF * rigidity / size if np.isinf(edge.k_theta) else edge.k_theta
        none = csr_matrix((grid.count, grid.count))
        springs, held = none, none
        if k_w or k_theta or edge.k_in_plane:
            ring = refined(self.rings[0], size / 4)
            sides = [(a, b, *line(a, b, 1)[:2]) for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)]
            points, weights = (np.concatenate([side[i] for side in sides]) for i in (2, 3))
            tangent = np.repeat([(b - a) / np.hypot(*(b - a)) for a, b, _, _ in sides], 3, axis=0)
            value = grid.at(points)
            slope = diags(tangent[:, 1]) @ grid.at(points, (1, 0)) - diags(tangent[:, 0]) @ grid.at(points, (0, 1))
            line_mass = value.T @ diags(weights) @ value
            springs = k_w * line_mass + k_theta * (slope.T @ diags(weights) @ slope)
            # springs that are not finite lose nothing
            held = edge.k_in_plane * line_mass
        lossy = edge.loss * springs if np.isfinite(edge.k_w) and np.isfinite(edge.k_theta) else none
        if self.fields == 1:
            return [springs.tocsr(), lossy.tocsr()]
        extent = float(np.ptp(self.rings[0], axis=0).max())
        weak = 1e-6 * self.wood.E_R * float(np.max(self.thickness(self.rings[0]))) / extent**2
        (trace,) = integrals(grid, quad, displacement, _constant(weak), [np.eye(1)])
        return [_stacked(_twice(held + trace), springs), _stacked(_twice(edge.loss * held), lossy)]


def cell_size(wood: Wood, thickness: float, fmax: float) -> float:
    """Size of cells (m) for modes up to `fmax` (Hz): 0.23 of the wavelength across the grain, at most 20 mm.

    A bare plate needs no more than 0.3; braces, whose forces bend the plate sharply, converge more slowly.
    """
    rigidity = wood.stiffness()[1, 1] * thickness**3 / 12
    wavelength = 2 * np.pi * (rigidity / (wood.density * thickness)) ** 0.25 / np.sqrt(2 * np.pi * fmax)
    return float(min(0.23 * wavelength, 0.02))


def _constant(value: float) -> Thickness:
    return lambda x: np.full(x.shape[:-1], value)


def _curvature(values: Callable[[Order], Floats]) -> Floats:
    return np.stack([values((2, 0)), values((0, 2)), 2 * values((1, 1))], axis=-2)


def _strain(values: Callable[[Order], Floats]) -> Floats:
    x, y = values((1, 0)), values((0, 1))
    none = np.zeros_like(x)
    rows = [np.concatenate(pair, axis=-1) for pair in ((x, none), (none, y), (y, x))]
    return np.stack(rows, axis=-2)


def displacement(values: Callable[[Order], Floats]) -> Floats:
    """Rows of w for `integrals`."""
    return values((0, 0))[..., None, :]


def integrals(
    grid: SplineGrid,
    quad: Quadrature,
    operator: Callable[[Callable[[Order], Floats]], Floats],
    factor: Thickness,
    matrices: Sequence[Floats],
) -> list[Any]:
    """Sparse integrals of factor (B a)^T Q (B b) dA over all pairs of functions a, b.

    Parameters
    ----------
    operator : from a function that gives derivatives of the functions alive on cells, the rows B (..., r, n) there.
    factor : of points.
    matrices : Q, each (r, r); one sparse matrix is returned for each.
    """
    from scipy.sparse import csr_matrix

    rows: list[NDArray[np.intp]] = []
    columns: list[NDArray[np.intp]] = []
    data: list[list[Floats]] = [[] for _ in matrices]
    count = grid.count
    for cells, points, weights in quad.groups:
        for first in range(0, len(cells), _CHUNK):
            some = slice(first, first + _CHUNK)
            cell, x, w = cells[some], points[some], weights[some]
            b = operator(partial(grid.values, cell[:, None, :], x))
            n = b.shape[-1] // grid.alive
            index = np.concatenate([grid.index(cell) + i * count for i in range(n)], axis=-1)
            count_all = n * count
            weighted = b * (w * factor(x))[..., None, None]
            flat = b.reshape(len(cell), -1, b.shape[-1]).transpose(0, 2, 1)
            rows.append(np.repeat(index, index.shape[1], axis=1).ravel())
            columns.append(np.tile(index, (1, index.shape[1])).ravel())
            for found, matrix in zip(data, matrices, strict=True):
                found.append((flat @ (matrix @ weighted).reshape(flat.shape[0], -1, flat.shape[1])).ravel())
    where = (np.concatenate(rows), np.concatenate(columns))
    return [csr_matrix((np.concatenate(d), where), shape=(count_all, count_all)) for d in data]


def _stacked(in_plane: csr_matrix, normal: csr_matrix) -> csr_matrix:
    from scipy.sparse import block_diag, csr_matrix

    return csr_matrix(block_diag([in_plane, normal]))


def _twice(matrix: csr_matrix) -> csr_matrix:
    return _stacked(matrix, matrix)
