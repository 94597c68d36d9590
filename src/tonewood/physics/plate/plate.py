"""Modes of a braced orthotropic plate of any outline, which bends and shears, by the Ritz method with B-splines.

    2 U = int kappa^T (h^3/12) Q kappa + gamma^T k h G gamma + eps^T h Q eps dA + springs on the edge + beams
    2 T = int rho h w'^2 + rho h^3/12 |beta'|^2 dA + beams
    beta = grad w - gamma,    kappa = (beta_x,x, beta_y,y, beta_x,y + beta_y,x),    eps = (u_x, v_y, u_y + v_x)

A Reissner-Mindlin plate: fibres across it stay straight and turn by beta, which differs from the slope by the shear
strains gamma; G holds the moduli G_LT and G_RT, k = 5/6 is the shear factor of a rectangular section. Not beta but
gamma is sought beside w: a thin plate, whose gamma vanishes, is Kirchhoff's, and nothing locks. A wood
without shear moduli makes Kirchhoff's plate, without gamma and without rotary inertia.

The in-plane motion (u, v) of the plate's middle surface is solved for where there are beams, which hang beside that
surface, and so is the rotation of each beam's sections, which bend and shear; none of these carries mass. The functions
do not know the outline: it limits the integrals, and the edge is held by springs per length, k_w (N/m^2) against w and
k_theta (N) against the turn of the fibres across the edge. Along a free edge gamma falls off within a fraction of the
thickness: functions of its own take that layer (`edge_layer`). Frequencies are upper bounds of those of the plate on
its springs, and move smoothly with every dimension, as nothing is meshed.

Loss factors are those of the energies: eta_k = phi_k^T K'' phi_k / omega_k^2, K'' of the imaginary parts.

Sources: K. Höllig, Finite Element Methods with B-Splines (SIAM, 2003), chapters 3 and 4, without its weight function:
springs hold the edge instead. R. D. Mindlin, J. Appl. Mech. 18 (1951) 31; E. Reissner, J. Appl. Mech. 12 (1945) A69.
gamma beside w: R. Echter, B. Oesterle and M. Bischoff, Comput. Methods Appl. Mech. Eng. 254 (2013) 170.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.plate.beams import Beam, rotations
from tonewood.physics.plate.block_solve import BlockSolver
from tonewood.physics.plate.lanczos import lowest
from tonewood.physics.plate.plate_parts import CLAMPED as CLAMPED
from tonewood.physics.plate.plate_parts import FREE as FREE
from tonewood.physics.plate.plate_parts import HINGED as HINGED
from tonewood.physics.plate.plate_parts import Edge as Edge
from tonewood.physics.plate.plate_parts import Field, PlateParts, Thickness
from tonewood.physics.plate.splines import Order, SplineGrid
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats, Indices

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

#: functions whose energy is below this share of the largest hardly touch the plate and are left out
_LEAST = 1e-9
#: shear factor of a rectangular section
SHEAR_FACTOR = 5 / 6
#: s of the shift -s^2 of the eigenproblem in units of sqrt(D_R / rho h) / S: below 0, as free plates have zero modes
_SHIFT = 20.0


@dataclass(frozen=True, eq=False)
class PlateModes:
    """Modes of a plate in vacuum, mass-normalised.

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


class _Sum:
    """A matrix of all unknowns as a sum of parts: beams' rotations, edge layers, u and v, gamma, and w last.

    size : number of all.
    slots : name -> first unknown of a field.
    """

    def __init__(self, fields: Sequence[Field]):
        counts = [count for _, count in fields]
        starts = np.concatenate([[0], np.cumsum(counts)])
        self.size, self.slots = int(starts[-1]), dict(zip((name for name, _ in fields), map(int, starts), strict=False))
        self._parts: list[tuple[Floats, Indices, Indices]] = []

    def add(self, part: csr_matrix, fields: Sequence[Field]) -> None:
        """Add a matrix of some fields, in their order there."""
        index = np.concatenate([self.slots[name] + np.arange(count) for name, count in fields])
        coo = part.tocoo()
        self._parts.append((coo.data, index[coo.row], index[coo.col]))

    def total(self) -> csr_matrix:
        """The sum."""
        from scipy.sparse import csr_matrix

        data, rows, columns = (np.concatenate(arrays) for arrays in zip(*self._parts, strict=True))
        return csr_matrix((data, (rows, columns)), shape=(self.size, self.size))


class Plate:
    """A plate's matrices.

    rings : outline first, then holes, each (n, 2) m. A curved side needs points much closer than `size`: stiff springs
        against displacement alone on the sides of a coarse polygon clamp it (Babuska's paradox).
    wood : of the plate.
    thickness : m, or a function of points.
    edge : springs on the outline.
    beams : braces and bridge.
    size : m, of a cell; see `cell_size`.
    grain : rad, of the plate's grain from x.
    shear_factor : k.
    layers_of : wood whose edge layers the functions have; that of the plate where left out.
    stiffness, losses, mass_matrix : (n, n) K, K'' and M of all unknowns, those of w last.
    functions : number of functions of w.
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
        shear_factor: float = SHEAR_FACTOR,
        layers_of: Wood | None = None,
    ):
        self.wood, self.grid = wood, SplineGrid.over(rings[0], size, degree)
        self.parts = PlateParts(
            self.grid, rings, wood, thickness, beams=bool(beams), grain=grain, shear_factor=shear_factor,
            layered=layers_of or wood,
        )  # fmt: skip
        self.quadrature, bending = self.parts.quadrature, self.parts.bending
        in_plane = self.parts.in_plane if beams else []
        parts = self.parts.without_beams(edge)
        sections = [(f"beam {i}", rotations(self.grid, beam)) for i, beam in enumerate(beams)]
        layers = [field for part in parts for field in part.fields if field[0].startswith("layer")]
        stiffness, losses, mass = sums = [_Sum([*sections, *layers, *in_plane, *bending]) for _ in range(3)]
        for part in parts:
            for total, matrix in zip(sums, part.matrices, strict=False):  # springs have no mass
                total.add(matrix, part.fields)
        for section, beam in zip(sections, beams, strict=True):
            matrix, lossy, inertia = self.parts.beam(beam)
            stiffness.add(matrix, [section, *in_plane, *bending])
            losses.add(lossy, [section, *in_plane, *bending])
            mass.add(inertia, bending[-1:])
        totals = [total.total() for total in sums]
        keep = _kept(totals[0].diagonal(), totals[2].diagonal(), stiffness.slots, [*in_plane, *bending])
        self._keep = keep[keep >= stiffness.slots["w"]] - stiffness.slots["w"]
        first = stiffness.slots[[*in_plane, *bending][0][0]]
        self.places = np.where(keep < first, np.nan, self.grid.places[(keep - first) % self.grid.count])
        self.stiffness: csc_matrix
        self.losses: csc_matrix
        self.mass_matrix: csc_matrix
        self.stiffness, self.losses, self.mass_matrix = (m[keep][:, keep].tocsc() for m in totals)
        self.functions = len(self._keep)

    @property
    def mass(self) -> float:
        """Mass with its beams, kg."""
        one = np.ones(self.functions)  # the functions add up to 1 everywhere
        return float(one @ (self.mass_matrix[-self.functions :, -self.functions :] @ one))

    @property
    def area(self) -> float:
        """Area without holes, m^2."""
        return float(self.quadrature.weights.sum())

    def operator(self, points: ArrayLike, order: Order = (0, 0)) -> csr_matrix:
        """(points, functions) w or a derivative of it at points (n, 2)."""
        return self.grid.at(points, order)[:, self._keep]

    def modes(self, fmax: float | None = None, count: int | None = None) -> PlateModes:
        """Modes up to `fmax` (Hz), or the first `count`. Raises ValueError : neither is given."""
        values, whole = self.solution(fmax, count)
        lost = np.einsum("ij,ij->j", whole, self.losses @ whole)
        loss = np.where(values > 1e-6, lost / np.maximum(values, 1e-6), 0.0)
        return PlateModes(np.sqrt(values) / (2 * np.pi), loss, whole[-self.functions :], self)

    def solution(self, fmax: float | None = None, count: int | None = None) -> tuple[Floats, Floats]:
        """(n,) omega^2 and (unknowns, n) mass-normalised vectors of all unknowns; as `modes`.

        Raises ValueError : neither is given.
        """
        if count is None and fmax is None:
            raise ValueError("fmax or count is wanted")
        limit = (2 * np.pi * (fmax or 0.0)) ** 2
        values, vectors = lowest(self._solver.solve, self.mass_matrix, self.shift**2, count=count or 0, below=limit)
        return np.maximum(values, 0.0), vectors

    def stored(self, vectors: Floats) -> Floats:
        """(n, n) products v^T K v of vectors (unknowns, n) of `solution`."""
        return np.asarray(vectors.T @ (self.stiffness @ vectors))

    def residual(self, loads: Floats, modes: PlateModes) -> Floats:
        """(m, m) m/N: compliance between m loads (m, functions) of all modes that `modes` leaves out.

        The difference of two sums over modes of phi phi^T (1 / (omega^2 + s^2) + s^2 / (omega^2 + s^2)^2): all of them
        from the factored stiffness, less those that are kept. It is 1 / omega^2 but for (s / omega)^4, s the shift.
        """
        rhs = np.zeros((self.stiffness.shape[0], len(loads)))
        rhs[-self.functions :] = loads.T
        moved = self._solver.solve(rhs)
        kept, soft = loads @ modes.vectors, 1 / ((2 * np.pi * modes.freq) ** 2 + self.shift**2)
        rest = loads @ moved[-self.functions :] + self.shift**2 * (moved.T @ (self.mass_matrix @ moved))
        rest = rest - (kept * (soft + self.shift**2 * soft**2)) @ kept.T
        return np.asarray(0.5 * (rest + rest.T))

    @property
    def shift(self) -> float:
        """Shift s of the eigenproblem, rad/s."""
        h = float(np.mean(self.parts.thickness(self.quadrature.points)))
        return float(_SHIFT * np.sqrt(self.wood.stiffness()[1, 1] * h**2 / 12 / self.wood.density) / self.area)

    @cached_property
    def _solver(self) -> BlockSolver:
        """Of K + s^2 M."""
        return BlockSolver(self.stiffness + self.shift**2 * self.mass_matrix, self.places)


def cell_size(wood: Wood, thickness: float, fmax: float) -> float:
    """Size of cells (m) for modes up to `fmax` (Hz): 0.3 of the wavelength across the grain, at most 20 mm.

    The wavelength is that of a plate that does not shear. A bare plate needs no more; a braced one converges slowly, as
    braces bend and shear the plate sharply.
    """
    rigidity = wood.stiffness()[1, 1] * thickness**3 / 12
    wavelength = 2 * np.pi * (rigidity / (wood.density * thickness)) ** 0.25 / np.sqrt(2 * np.pi * fmax)
    return float(min(0.3 * wavelength, 0.02))


def _kept(stiffness: Floats, mass: Floats, slots: Mapping[str, int], fields: Sequence[Field]) -> Indices:
    """Unknowns whose functions touch the plate, by their energy beside that of others of their field."""
    keep = [np.arange(slots[fields[0][0]])]
    for name, count in fields:
        share = (mass if name == "w" else stiffness)[slots[name] : slots[name] + count]
        keep.append(slots[name] + np.flatnonzero(share > _LEAST * share.max()))
    return np.concatenate(keep)
