"""A drawn body as one eigenproblem: plates, their air and lumps fixed to the top, in the coordinates of the splines.

The unknowns are those of the plates, the volume Y that went out of the hole and eta_m of the cavity's modes; energies
are those of `tonewood.physics.plate.air`,

    K = K_plates + kappa P^T P + sum_l k_l c_l c_l^T,    M = M_plates + (rho L / S) Y^2 + (kappa / omega_m^2) eta_m^2
                                                             + sum_l m_l c_l c_l^T,

rows P of the volumes that the cavity's modes are compressed by. No plate mode is left out, so that matrices, modes and
their derivatives belong to one smooth function of the drawing; `body.body_modes` leaves modes out and keeps their
static compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED, cavity_modes, hole_loss
from tonewood.physics.plate.block_solve import BlockSolver
from tonewood.physics.plate.body import BodyDrawing, cell_of, made_plate, mouth_of, named_modes, opening_of, point_loads
from tonewood.physics.plate.lanczos import lowest
from tonewood.physics.plate.mode_changes import ModeChange, mode_change
from tonewood.physics.plate.radiation import Sources, gathered_sources
from tonewood.support.arrays import Floats

#: m, squares in which a plate's motion is gathered for its sound
_SQUARE = 0.02


@dataclass(frozen=True, slots=True)
class Lump:
    """A mass, a spring and a dashpot fixed to one of the drawing's points.

    point : number of the point.
    factor : its displacement per displacement of the point along its own direction.
    mass, stiffness, damping : kg, N/m, N s/m.
    """

    point: int
    factor: float
    mass: float
    stiffness: float
    damping: float


@dataclass(frozen=True, eq=False)
class LowModes:
    """Lowest modes of a body, mass-normalised.

    freq : (n,) Hz.
    loss : (n,) loss factors.
    shapes : (p, n) 1/sqrt(kg) at the drawing's points.
    residual : (p, p) m/N, static compliance of all other modes; zeros where it was not asked for.
    mass : kg, of plates and lumps.
    named : numbers of A0 and T1.
    """

    freq: Floats
    loss: Floats
    shapes: Floats
    residual: Floats
    mass: float
    named: dict[str, int]


class WholeBody:
    """Matrices of a drawn body.

    drawing : with cells of a size given in its plates, so that bodies of similar drawings have the same unknowns.
    lumps : fixed to its points.
    """

    def __init__(self, drawing: BodyDrawing, lumps: Sequence[Lump] = ()):
        from scipy.sparse import block_diag, csc_matrix, diags

        self.drawing, self.lumps = drawing, tuple(lumps)
        rings = [drawing.outline] if drawing.hole is None else [drawing.outline, drawing.hole]
        self.plates = [made_plate(rings, drawing.top, drawing.fmax)]
        if drawing.back is not None:
            self.plates.append(made_plate([drawing.outline], drawing.back, drawing.fmax))
        sizes = [plate.stiffness.shape[0] for plate in self.plates]
        self._starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.mouth = None if drawing.hole is None or drawing.depth == 0 else mouth_of(drawing.hole)
        self.opening = opening_of(drawing, self.mouth)
        air_mass, self.pressed, self.kappa = self._air()
        self.size = int(self._starts[-1]) + len(air_mass)
        air = diags(air_mass)
        self.loads = self._placed(0, point_loads(self.plates[0], drawing))
        k = block_diag([*(p.stiffness for p in self.plates), 0.0 * air])
        m = block_diag([*(p.mass_matrix for p in self.plates), air])
        for lump in self.lumps:
            row = csc_matrix(lump.factor * self.loads[lump.point])
            k, m = k + lump.stiffness * (row.T @ row), m + lump.mass * (row.T @ row)
        self.flexible, self.mass_matrix = csc_matrix(k), csc_matrix(m)
        self.losses = csc_matrix(block_diag([*(p.losses for p in self.plates), 0.0 * air]))

    @property
    def mass(self) -> float:
        """Mass of plates with their beams and of lumps, kg."""
        return float(sum(p.mass for p in self.plates) + sum(lump.mass for lump in self.lumps))

    def _air(self) -> tuple[Floats, Floats, float]:
        """(k,) masses of Y and eta, (1 + m, size) P, and kappa, Pa/m^3."""
        drawing, plates = self.drawing, int(self._starts[-1])
        if drawing.depth == 0:
            return np.zeros(0), np.zeros((0, plates)), 0.0
        cavity = cavity_modes(drawing.outline, 1.0, drawing.cavity_to)
        kappa = AIR_DENSITY * SOUND_SPEED**2 / (cavity.volume * drawing.depth)
        m, hole = len(cavity.freq), int(self.mouth is not None)
        rows = np.zeros((1 + m, plates + hole + m))
        for i, plate in enumerate(self.plates):
            points, weights = plate.quadrature.points, plate.quadrature.weights
            swept = np.vstack([weights, weights * cavity.shapes(points).T]) @ plate.operator(points)
            rows[:, :plates] += self._placed(i, swept, plates)
        mass = kappa / (2 * np.pi * cavity.freq) ** 2
        if self.mouth is not None and self.opening is not None:
            rows[0, plates] = 1.0
            rows[1:, plates] = self.mouth[1] @ cavity.shapes(self.mouth[0]) / self.opening[0]
            length = self.opening[1] + drawing.end_correction * float(np.sqrt(self.opening[0] / np.pi))
            mass = np.concatenate([[AIR_DENSITY * length / self.opening[0]], mass])
        rows[1:, plates + hole :] = -np.eye(m)
        return mass, rows, kappa

    def _placed(self, i: int, rows: Floats, size: int | None = None) -> Floats:
        """Rows (k, functions) of w of plate i, among all unknowns."""
        out = np.zeros((len(rows), self.size if size is None else size))
        stop = int(self._starts[i + 1])
        out[:, stop - rows.shape[1] : stop] = rows
        return out

    def _w(self, i: int, vectors: Floats) -> Floats:
        stop = int(self._starts[i + 1])
        return vectors[stop - self.plates[i].functions : stop]

    def stiffness(self, vectors: Floats) -> Floats:
        """(n, k) K applied to vectors (n, k)."""
        return np.asarray(self.flexible @ vectors + self.kappa * (self.pressed.T @ (self.pressed @ vectors)))

    @property
    def shift(self) -> float:
        """s^2 of `solve`, 1/s^2."""
        return self.plates[0].shift ** 2

    @cached_property
    def _solver(self) -> tuple[BlockSolver, Floats, Floats]:
        """Of K - kappa P^T P + s^2 M, and what the air adds to its solution."""
        places = np.full(self.size, self._starts[-1], dtype=np.float64)
        for first, plate in zip(self._starts, self.plates, strict=False):
            places[first : first + len(plate.places)] = first + plate.places  # one plate after the other
        whole = BlockSolver(self.flexible + self.shift * self.mass_matrix, places)
        moved = whole.solve(self.pressed.T)
        small = np.eye(len(self.pressed)) / self.kappa + self.pressed @ moved if self.kappa else np.zeros((0, 0))
        return whole, moved, small

    def solve(self, forces: Floats) -> Floats:
        """(n, k) (K + s^2 M)^-1 applied to forces (n, k)."""
        whole, moved, small = self._solver
        y = whole.solve(forces)
        return y - moved @ np.linalg.solve(small, self.pressed @ y) if len(small) else y

    def modes(self, *, below: float = 0.0, count: int = 0) -> tuple[Floats, Floats]:
        """(m,) omega^2 and (n, m) shapes of the modes below `below` (Hz), or of the first `count`."""
        return lowest(self.solve, self.mass_matrix, self.shift, count=count, below=(2 * np.pi * below) ** 2)

    def described(self, values: Floats, vectors: Floats, residual: bool = True) -> LowModes:
        """Frequencies, losses, shapes at points and what is left out, of modes of this body.

        values, vectors : (m,) omega^2 and (n, m).
        residual : whether the residual is wanted, which takes a factorisation.
        """
        values = np.maximum(values, 0.0)
        omega = np.sqrt(values)
        safe = np.where(omega > 1.0, omega, np.inf)
        shapes = self.loads @ vectors
        radiated, swept = self._radiated(omega, vectors)
        wooden, total = vectors[: self._starts[-1]], int(self._starts[-1])
        stored = np.einsum("ij,ij->j", wooden, self.flexible[:total, :total] @ wooden)
        lost = np.einsum("ij,ij->j", vectors, self.losses @ vectors) + self.drawing.extra_loss * stored
        loss = (lost + self.drawing.air_loss * np.maximum(values - stored, 0.0)) / safe**2 + radiated / safe
        air = vectors[total:] ** 2 * self.mass_matrix.diagonal()[total:, None]
        hole = int(self.mouth is not None)
        kinetic = np.array([1 - air.sum(axis=0), air[:hole].sum(axis=0), air[hole:].sum(axis=0)])
        if self.opening is not None and hole:
            loss = loss + hole_loss(omega / (2 * np.pi), vectors[total], *self.opening)
        for lump in self.lumps:
            loss = loss + lump.damping * (lump.factor * shapes[lump.point]) ** 2 / safe
        freq = np.where(omega > 1.0, omega, 0.0) / (2 * np.pi)
        rest = self._residual(values, shapes) if residual else np.zeros((len(shapes), len(shapes)))
        return LowModes(freq, loss, shapes, rest, self.mass, named_modes(freq, kinetic, swept))

    def _residual(self, values: Floats, shapes: Floats) -> Floats:
        """(p, p) m/N of the modes left out, as `Plate.residual`."""
        moved, s = self.solve(self.loads.T), self.shift
        soft = 1 / (values + s)
        whole = self.loads @ moved + s * (moved.T @ (self.mass_matrix @ moved))
        whole = whole - (shapes * (soft + s * soft**2)) @ shapes.T
        return np.asarray(0.5 * (whole + whole.T))

    def _radiated(self, omega: Floats, vectors: Floats) -> tuple[Floats, Floats]:
        """(m,) 1/s radiation resistances, and (m,) volumes of the top."""
        total, swept = np.zeros(len(omega)), np.zeros(len(omega))
        for i, plate in enumerate(self.plates):
            points, weights, shapes = plate.quadrature.points, plate.quadrature.weights, plate.operator
            places, _, volumes = gathered_sources(points, weights, shapes(points) @ self._w(i, vectors), _SQUARE)
            if i == 0:
                swept = volumes.sum(axis=0)
                if self.mouth is not None:
                    none = np.zeros((len(self.mouth[1]), 0))
                    disc, areas, _ = gathered_sources(*self.mouth, none, _SQUARE)
                    flow = vectors[self._starts[-1]]
                    places = np.vstack([places, disc])
                    volumes = np.vstack([volumes, np.outer(areas / areas.sum(), flow)])
            total = total + Sources(places, volumes, self.drawing.baffled).resistance(omega / (2 * np.pi), exact=True)
        return total, swept


def with_cells(drawing: BodyDrawing, fmax: float) -> BodyDrawing:
    """Return a drawing whose plates have cells of a fixed size, those for modes up to `fmax` (Hz)."""
    top = replace(drawing.top, size=cell_of(drawing.outline, drawing.top, fmax))
    back = drawing.back and replace(drawing.back, size=cell_of(drawing.outline, drawing.back, fmax))
    return replace(drawing, fmax=fmax, top=top, back=back)


@dataclass(frozen=True, eq=False)
class BodyChange:
    """A body's modes on both sides of a parameter's value, to first order: centre -+ step times the derivatives."""

    less: LowModes
    more: LowModes
    step: float


def body_change(
    body: WholeBody,
    values: Floats,
    vectors: Floats,
    less: WholeBody,
    more: WholeBody,
    step: float,
    count: int,
    residual: bool = True,
) -> BodyChange:
    """Modes of a body at p - step and p + step to first order; their difference over 2 step is the derivative.

    Derivatives of the matrices are central differences of matrices that are polynomials of most parameters; those of
    eigenvalues and shapes are `mode_change`; of all that follows from these, directional differences.

    values, vectors : modes of `body`, more than `count`.
    less, more : bodies at p - step and p + step, with the same unknowns.
    count : number of modes wanted.
    residual : as in `WholeBody.described`.
    Raises ValueError : the bodies do not have the same unknowns.
    """
    if not less.size == body.size == more.size:
        raise ValueError("the drawing's unknowns change with this parameter")
    change: ModeChange = mode_change(
        values,
        vectors,
        (more.stiffness(vectors) - less.stiffness(vectors)) / (2 * step),
        np.asarray(more.mass_matrix @ vectors - less.mass_matrix @ vectors) / (2 * step),
        body.mass_matrix,
        body.solve,
        body.shift,
        count,
    )

    def beside(other: WholeBody, by: float) -> LowModes:
        moved = (values[:count] + by * change.values_rate, change.vectors + by * change.vectors_rate)
        return other.described(*moved, residual)

    return BodyChange(beside(less, -step), beside(more, step), step)
