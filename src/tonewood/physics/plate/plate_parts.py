"""Parts of a plate's energies as matrices: the bare plate, its edge layers, motion in its plane, springs, beams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tonewood.physics.plate.beams import Beam, beam_line, beam_matrices
from tonewood.physics.plate.edge_layer import layer_matrices
from tonewood.physics.plate.integrals import Values, displacement, integrals
from tonewood.physics.plate.outline import quadrature, refined
from tonewood.physics.plate.splines import SplineGrid
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

#: name and number of unknowns
Field = tuple[str, int]
#: thickness (m) at points (..., 2)
Thickness = Callable[[Floats], Floats]

#: share of its diagonal by which the stiffness in the plane is raised, against rigid motion
_TRACE = 1e-9
#: stiff springs that stand for a clamped or hinged edge, in units of D / size^3 and D / size
STIFF = 1e4
#: functions of a grid up to which results are kept, and how many of each kind: a search changes one part at a time
_KEPT_COUNT, _KEPT = 1500, {"points": 4, "plate": 4, "beam": 100}
_RESULTS: dict[str, dict[Any, Any]] = {kind: {} for kind in _KEPT}


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


class Part(NamedTuple):
    """Matrices of one part of a plate.

    fields : of their rows and columns, in this order.
    matrices : stiffness, losses, and mass where the part has one.
    """

    fields: list[Field]
    matrices: tuple[csr_matrix, ...]


class PlateParts:
    """Matrices of the parts of a plate on one grid; results are kept for plates of the same grid.

    grid : of the functions.
    beams : whether the plate has any: then it moves in its plane, too.
    rings, wood, thickness, grain, shear_factor, layered : as of `Plate`; `layered` is its `layers_of`.
    """

    def __init__(
        self,
        grid: SplineGrid,
        rings: Sequence[Floats],
        wood: Wood,
        thickness: float | Thickness,
        *,
        beams: bool,
        grain: float,
        shear_factor: float,
        layered: Wood,
    ):
        self.grid, self.rings, self.wood, self.beams = grid, tuple(rings), wood, beams
        self.grain, self.shear_factor = grain, shear_factor
        self._thickness, self._layered = thickness, layered
        self.quadrature = self._kept("points", rings, lambda: quadrature(grid, rings))
        rotation = [(name, grid.count) for name in ("gamma_x", "gamma_y")] if wood.shears else []
        self.bending: list[Field] = [*rotation, ("w", grid.count)]
        self.in_plane: list[Field] = [("u", grid.count), ("v", grid.count)]

    def without_beams(self, edge: Edge) -> list[Part]:
        """All parts but the beams."""
        plate = (
            *self.rings, self._thickness, self.wood, edge, self.grain, self.shear_factor, self._layered, self.beams,
        )  # fmt: skip
        parts: list[Part] = self._kept(
            "plate", plate, lambda: [self._plate(), *self._layers(edge), *self._membrane(), *self._edge(edge)]
        )
        return parts

    def beam(self, beam: Beam) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
        """Stiffness and losses, and mass of w alone, as `beam_matrices`."""

        def make() -> tuple[csr_matrix, csr_matrix, csr_matrix]:
            return beam_matrices(self.grid, beam, self.thickness(beam_line(self.grid, beam)[0]), self.wood.shears)

        parts = (
            beam.start,
            beam.stop,
            beam.heights,
            self._thickness,
            beam.width,
            beam.wood,
            beam.above,
            self.wood.shears,
        )
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

    def thickness(self, points: Floats) -> Floats:
        """(...,) m at points (..., 2)."""
        return self._thickness(points) if callable(self._thickness) else np.full(points.shape[:-1], self._thickness)

    def _plate(self) -> Part:
        """The bare plate, in gamma and w."""
        wood, grain, thickness = self.wood, self.grain, self._thickness
        bend = [wood.stiffness(grain), wood.losses(grain)]
        if not wood.shears:
            cubed = (lambda x: thickness(x) ** 3 / 12) if callable(thickness) else thickness**3 / 12
            heavy = (lambda x: wood.density * thickness(x)) if callable(thickness) else wood.density * thickness
            mass = integrals(1, self.quadrature, displacement, heavy, [np.eye(1)])
            return Part(self.bending, (*integrals(1, self.quadrature, _curvature, cubed, bend), *mass))
        shear = self.shear_factor * wood.transverse(grain)
        both = [_block(bend[0], shear), _block(bend[1], wood.loss_shear * shear)]

        def factors(h: Floats | float, powers: Sequence[int]) -> Floats:
            return np.stack([np.asarray(h) ** 3 / 12 if n == 3 else np.asarray(h) for n in powers], axis=-1)

        def factor(powers: Sequence[int]) -> Thickness | Floats:
            return (lambda x: factors(thickness(x), powers)) if callable(thickness) else factors(thickness, powers)

        stiffness = integrals(3, self.quadrature, _bending, factor((3, 3, 3, 1, 1)), both)
        mass = integrals(3, self.quadrature, _motion, factor((3, 3, 1)), [wood.density * np.eye(3)])
        return Part(self.bending, (*stiffness, *mass))

    def _membrane(self) -> list[Part]:
        """Motion in the plane, with a trace of stiffness that holds the plate there."""
        from scipy.sparse import diags

        if not self.beams:
            return []
        matrices = [self.wood.stiffness(self.grain), self.wood.losses(self.grain)]
        part, loss = integrals(2, self.quadrature, _strain, self._thickness, matrices)
        return [Part(self.in_plane, (part + diags(_TRACE * part.diagonal()), loss))]

    def _layers(self, edge: Edge) -> list[Part]:
        """Layers of gamma along free edges: the outline's where nothing holds it, and those of the holes."""
        if not self.wood.shears:
            return []
        outer = not (edge.k_w or edge.k_theta)
        n_bending = sum(count for _, count in self.bending)
        layers: list[Part] = []
        for ring, around in [(ring, k == 0) for k, ring in enumerate(self.rings) if k or outer]:
            woods = (self.wood, self._layered)
            parts = layer_matrices(self.grid, ring, around, woods, self.grain, self.shear_factor, self.thickness)
            bending = (f"layer {len(layers)}", parts[0].shape[0] - n_bending)
            layers.append(Part([bending, *self.bending], parts))
        return layers

    def _edge(self, edge: Edge) -> list[Part]:
        """Springs on the outline.

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
        parts = [Part(self.bending, (springs, lossy))]
        if self.beams and edge.k_in_plane:
            stiffness = edge.k_in_plane * line_mass
            parts += [Part([field], (stiffness, edge.loss * stiffness)) for field in self.in_plane]
        return parts

    def _spread(self, matrix: csr_matrix) -> csr_matrix:
        """Matrix of gamma and w from one of w."""
        from scipy.sparse import block_diag, csr_matrix

        if not self.wood.shears:
            return matrix
        none = csr_matrix((2 * self.grid.count, 2 * self.grid.count))
        return csr_matrix(block_diag([none, matrix]))


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
