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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.plate.beams import Beam, beam_line, beam_matrices, rotations
from tonewood.physics.plate.block_solve import BlockSolver
from tonewood.physics.plate.edge_layer import layer_matrices
from tonewood.physics.plate.integrals import Values, displacement, integrals
from tonewood.physics.plate.lanczos import lowest
from tonewood.physics.plate.outline import quadrature, refined
from tonewood.physics.plate.splines import Order, SplineGrid
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats, Indices

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

#: name and number of unknowns
Field = tuple[str, int]
#: thickness (m) at points (..., 2)
Thickness = Callable[[Floats], Floats]

#: functions whose energy is below this share of the largest hardly touch the plate and are left out
_LEAST = 1e-9
#: share of its diagonal by which the stiffness in the plane is raised, against rigid motion
_TRACE = 1e-9
#: shear factor of a rectangular section
SHEAR_FACTOR = 5 / 6
#: stiff springs that stand for a clamped or hinged edge, in units of D / size^3 and D / size
STIFF = 1e4
#: functions of a grid up to which results are kept, and how many of each kind: a search changes one part at a time
_KEPT_COUNT, _KEPT = 1500, {"points": 4, "plate": 4, "beam": 100}
_RESULTS: dict[str, dict[Any, Any]] = {kind: {} for kind in _KEPT}
#: s of the shift -s^2 of the eigenproblem in units of sqrt(D_R / rho h) / S: below 0, as free plates have zero modes
_SHIFT = 20.0


@dataclass(frozen=True, slots=True)
class Edge:
    """Springs on the outline, per length.

    k_w : N/m^2, against displacement; infinite for an edge that does not move.
    k_theta : N, against the turn across the edge; infinite for an edge that does not turn.
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
        self.rings, self.wood, self.beams = tuple(rings), wood, tuple(beams)
        self._given, self._layered = thickness, layers_of or wood
        self.grain, self.shear_factor = grain, shear_factor
        self.grid = SplineGrid.over(rings[0], size, degree)
        self.quadrature = self._kept("points", rings, lambda: quadrature(self.grid, rings))
        plate = (*rings, thickness, wood, edge, grain, shear_factor, self._layered, bool(beams))
        layers, bare, springs = self._kept(
            "plate", plate, lambda: (self._layers(edge), self._plate(), [*self._membrane(), *self._edge(edge)])
        )
        sections = [(f"beam {i}", rotations(self.grid, beam)) for i, beam in enumerate(beams)]
        in_plane = self._in_plane if beams else []
        fields = [*sections, *(fields[0] for _, _, _, fields in layers), *in_plane, *self._bending]
        stiffness, losses, mass = sums = [_Sum(fields) for _ in range(3)]
        for part, matrix in zip(sums, bare, strict=True):
            part.add(matrix, self._bending)
        for *matrices, own in layers:
            for part, matrix in zip(sums, matrices, strict=True):
                part.add(matrix, own)
        for matrix, lossy, own in springs:
            stiffness.add(matrix, own)
            losses.add(lossy, own)
        for section, beam in zip(sections, beams, strict=True):
            matrix, lossy, inertia = self._of_beam(beam)
            stiffness.add(matrix, [section, *self._in_plane, *self._bending])
            losses.add(lossy, [section, *self._in_plane, *self._bending])
            mass.add(inertia, self._bending[-1:])
        totals = [part.total() for part in sums]
        keep = _kept(totals[0].diagonal(), totals[2].diagonal(), stiffness.slots, [*in_plane, *self._bending])
        self._keep = keep[keep >= stiffness.slots["w"]] - stiffness.slots["w"]
        first = stiffness.slots[[*in_plane, *self._bending][0][0]]
        self.places = np.where(keep < first, np.nan, self.grid.places[(keep - first) % self.grid.count])
        self.stiffness: csc_matrix
        self.losses: csc_matrix
        self.mass_matrix: csc_matrix
        self.stiffness, self.losses, self.mass_matrix = (m[keep][:, keep].tocsc() for m in totals)
        self.functions = len(self._keep)

    def _of_beam(self, beam: Beam) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
        def make() -> tuple[csr_matrix, csr_matrix, csr_matrix]:
            return beam_matrices(self.grid, beam, self.thickness(beam_line(self.grid, beam)[0]), self.wood.shears)

        parts = (beam.start, beam.stop, beam.heights, self._given, beam.width, beam.wood, beam.above, self.wood.shears)
        matrices: tuple[csr_matrix, csr_matrix, csr_matrix] = self._kept("beam", parts, make)
        return matrices

    def _kept(self, kind: str, parts: Sequence[Any], make: Callable[[], Any]) -> Any:
        """Result of `make`, which depends on the grid and on `parts`; kept for plates of the same grid."""
        if any(map(callable, parts)) or self.grid.count > _KEPT_COUNT:
            return make()
        grid, kept = (self.grid.low, self.grid.size, self.grid.cells, self.grid.degree), _RESULTS[kind]
        key = tuple(x.tobytes() if isinstance(x, np.ndarray) else x for x in (*grid, *parts))
        result = kept.get(key)
        if result is None:
            result = make()
            while len(kept) >= _KEPT[kind]:
                kept.pop(next(iter(kept)), None)
            kept[key] = result
        return result

    @property
    def _bending(self) -> list[Field]:
        rotation = [(name, self.grid.count) for name in ("gamma_x", "gamma_y")] if self.wood.shears else []
        return [*rotation, ("w", self.grid.count)]

    @property
    def _in_plane(self) -> list[Field]:
        return [("u", self.grid.count), ("v", self.grid.count)]

    def thickness(self, points: Floats) -> Floats:
        """(...,) m at points (..., 2)."""
        return self._given(points) if callable(self._given) else np.full(points.shape[:-1], self._given)

    def _plate(self) -> list[csr_matrix]:
        """Stiffness, losses and mass of the bare plate, of gamma and w."""
        wood, grain, thickness = self.wood, self.grain, self._given
        bend = [wood.stiffness(grain), wood.losses(grain)]
        if not wood.shears:
            cubed = (lambda x: thickness(x) ** 3 / 12) if callable(thickness) else thickness**3 / 12
            heavy = (lambda x: wood.density * thickness(x)) if callable(thickness) else wood.density * thickness
            mass = integrals(1, self.quadrature, displacement, heavy, [np.eye(1)])
            return [*integrals(1, self.quadrature, _curvature, cubed, bend), *mass]
        shear = self.shear_factor * wood.transverse(grain)
        both = [_block(bend[0], shear), _block(bend[1], wood.loss_shear * shear)]

        def factors(h: Floats | float, powers: Sequence[int]) -> Floats:
            return np.stack([np.asarray(h) ** 3 / 12 if n == 3 else np.asarray(h) for n in powers], axis=-1)

        def factor(powers: Sequence[int]) -> Thickness | Floats:
            return (lambda x: factors(thickness(x), powers)) if callable(thickness) else factors(thickness, powers)

        stiffness = integrals(3, self.quadrature, _bending, factor((3, 3, 3, 1, 1)), both)
        return [*stiffness, *integrals(3, self.quadrature, _motion, factor((3, 3, 1)), [wood.density * np.eye(3)])]

    def _membrane(self) -> list[tuple[csr_matrix, csr_matrix, list[Field]]]:
        """Stiffness and losses in the plane, with a trace of stiffness that holds the plate there."""
        from scipy.sparse import diags

        if not self.beams:
            return []
        matrices = [self.wood.stiffness(self.grain), self.wood.losses(self.grain)]
        part, loss = integrals(2, self.quadrature, _strain, self._given, matrices)
        return [(part + diags(_TRACE * part.diagonal()), loss, self._in_plane)]

    def _layers(self, edge: Edge) -> list[tuple[csr_matrix, csr_matrix, csr_matrix, list[Field]]]:
        """Layers of gamma along free edges: the outline's where nothing holds it, and those of the holes."""
        if not self.wood.shears:
            return []
        outer = not (edge.k_w or edge.k_theta)
        n_bending = sum(count for _, count in self._bending)
        layers: list[tuple[csr_matrix, csr_matrix, csr_matrix, list[Field]]] = []
        for ring, around in [(ring, k == 0) for k, ring in enumerate(self.rings) if k or outer]:
            woods = (self.wood, self._layered)
            parts = layer_matrices(self.grid, ring, around, woods, self.grain, self.shear_factor, self.thickness)
            bending = (f"layer {len(layers)}", parts[0].shape[0] - n_bending)
            layers.append((*parts, [bending, *self._bending]))
        return layers

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
        h = float(np.mean(self.thickness(self.quadrature.points)))
        return float(_SHIFT * np.sqrt(self.wood.stiffness()[1, 1] * h**2 / 12 / self.wood.density) / self.area)

    @cached_property
    def _solver(self) -> BlockSolver:
        """Of K + s^2 M."""
        return BlockSolver(self.stiffness + self.shift**2 * self.mass_matrix, self.places)

    def _edge(self, edge: Edge) -> list[tuple[csr_matrix, csr_matrix, list[Field]]]:
        """Stiffness and losses of the springs on the outline.

        An edge that does not move keeps its fibres from turning along it, too: there gamma has no part along the edge.
        """
        from scipy.sparse import csr_matrix, diags, hstack

        if not (edge.k_w or edge.k_theta or edge.k_in_plane):
            return []
        size = float(self.grid.size.max())
        rigidity = self.wood.stiffness()[0, 0] * float(np.max(self.thickness(self.rings[0]))) ** 3 / 12
        k_w = STIFF * rigidity / size**3 if np.isinf(edge.k_w) else edge.k_w
        k_theta = STIFF * rigidity / size if np.isinf(edge.k_theta) else edge.k_theta
        ring = refined(self.rings[0], size / 4)
        step = np.roll(ring, -1, axis=0) - ring
        length = np.hypot(*step.T)
        g, w = np.polynomial.legendre.leggauss(3)
        points = (ring[:, None] + step[:, None] * (g[:, None] + 1) / 2).reshape(-1, 2)
        weights, tangent = np.outer(length, w / 2).ravel(), np.repeat(step / length[:, None], 3, axis=0)
        value = self.grid.at(points)
        w_n = diags(tangent[:, 1]) @ self.grid.at(points, (1, 0)) - diags(tangent[:, 0]) @ self.grid.at(points, (0, 1))
        t_x, t_y, weighted = diags(tangent[:, 0]) @ value, diags(tangent[:, 1]) @ value, diags(weights)
        turn = hstack([-t_y, t_x, w_n]).tocsr() if self.wood.shears else w_n
        springs = k_theta * (turn.T @ weighted @ turn)
        line_mass = value.T @ weighted @ value
        rigid = self._spread(k_w * line_mass)
        if np.isinf(edge.k_w) and self.wood.shears:
            slip = hstack([t_x, t_y, csr_matrix(value.shape)]).tocsr()
            rigid = rigid + STIFF * rigidity / size * (slip.T @ weighted @ slip)
        springs = springs + rigid
        # springs that are not finite lose nothing
        lossy = edge.loss * springs if np.isfinite(edge.k_w) and np.isfinite(edge.k_theta) else 0.0 * springs
        terms = [(springs, lossy, self._bending)]
        if self.beams and edge.k_in_plane:
            stiffness = edge.k_in_plane * line_mass
            terms += [(stiffness, edge.loss * stiffness, [field]) for field in self._in_plane]
        return terms

    def _spread(self, matrix: csr_matrix) -> csr_matrix:
        """Matrix of gamma and w from one of w."""
        from scipy.sparse import block_diag, csr_matrix

        if not self.wood.shears:
            return matrix
        none = csr_matrix((2 * self.grid.count, 2 * self.grid.count))
        return csr_matrix(block_diag([none, matrix]))


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


def _block(first: Floats, second: Floats) -> Floats:
    n = len(first)
    out = np.zeros((n + len(second), n + len(second)))
    out[:n, :n], out[n:, n:] = first, second
    return out


def _curvature(w: Values) -> Floats:
    return np.stack([w((2, 0)), w((0, 2)), 2 * w((1, 1))], axis=-2)


def _bending(gamma_x: Values, gamma_y: Values, w: Values) -> Floats:
    """Rows kappa and gamma of the functions of gamma_x, gamma_y and w."""
    x, y, value = gamma_x((1, 0)), gamma_x((0, 1)), gamma_x((0, 0))
    none, still = np.zeros_like(x), np.zeros_like(w((0, 0)))
    rows = [(-x, none, w((2, 0))), (none, -y, w((0, 2))), (-y, -x, 2 * w((1, 1))), (value, none, still),
            (none, value, still)]  # fmt: skip
    return np.stack([np.concatenate(row, axis=-1) for row in rows], axis=-2)


def _motion(gamma_x: Values, gamma_y: Values, w: Values) -> Floats:
    """Rows beta and w of the same."""
    value = gamma_x((0, 0))
    none = np.zeros_like(value)
    rows = [(-value, none, w((1, 0))), (none, -value, w((0, 1))), (none, none, w((0, 0)))]
    return np.stack([np.concatenate(row, axis=-1) for row in rows], axis=-2)


def _strain(u: Values, v: Values) -> Floats:
    x, y = u((1, 0)), u((0, 1))
    none = np.zeros_like(x)
    rows = [np.concatenate(pair, axis=-1) for pair in ((x, none), (none, y), (y, x))]
    return np.stack(rows, axis=-2)
