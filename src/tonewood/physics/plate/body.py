"""A body from its drawing: top, back, cavity, hole and radiation, as real modes with shapes at named points.

Plates in vacuum (`plate`), then their air (`air`), then their radiation resistance as a diagonal damping (`radiation`):

    eta_k = sum_n (eta_n + extra) U_nk + eta_air (1 - sum_n U_nk) + R_k / omega_k + friction in the hole

U_nk is the share of plate mode n's stiffness in the potential energy of mode k. Every contribution is positive, and so
the body is passive with any number of modes.

Plate modes above `fmax` have a static compliance [R_pp R_pv; R_vp R_vv] between the drawing's points and the volumes of
the cavity's modes. R_vv is in the air's springs; a point moves by R_pv p besides its modes, and the residual at the
points is R_pp - R_pv (I / kappa + R_vv)^-1 R_vp. Static compliances so do not depend on `fmax`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED, AirModes, cavity_modes, couple_air, hole_loss
from tonewood.physics.plate.beams import Beam
from tonewood.physics.plate.outline import area, quadrature
from tonewood.physics.plate.plate import Plate, PlateModes, cell_size
from tonewood.physics.plate.plate_parts import CLAMPED, Edge, Thickness
from tonewood.physics.plate.radiation import Sources, gathered_sources
from tonewood.physics.plate.splines import SplineGrid
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.support.stages import stages

#: coefficients of a plate's displacements
MOST_UNKNOWNS = 25_000
#: frequencies below this share of the fourth are of rigid-body motion
_RIGID = 1e-2
#: m, squares in which a plate's motion is gathered for its sound and its pictures
SOURCE_SIZE = 0.01


@dataclass(frozen=True, eq=False)
class PlateDrawing:
    """A top or a back.

    wood, thickness, edge, beams, grain : see `tonewood.physics.plate.plate.Plate`.
    size : m, of a cell; from the mean thickness and the highest frequency where it is 0.
    """

    wood: Wood
    thickness: float | Thickness
    edge: Edge = CLAMPED
    beams: Sequence[Beam] = ()
    grain: float = 0.0
    size: float = 0.0


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """All that decides on a body's modes.

    outline : (n, 2) m, ring.
    hole : (n, 2) m, ring of the soundhole; None without one.
    top : the plate that strings move.
    back : a second plate; None for a rigid one.
    depth : m, of the cavity; 0 for a plate without air behind it.
    cavity_to : Hz, modes of the cavity below it take part.
    end_correction : of the hole in units of its radius, both ends together.
    air_loss : loss factor of the air's stiffness.
    extra_loss : loss factor added to that of the wood, for glue and edge.
    baffled : whether a rigid plane surrounds the body; else it radiates as in free air.
    fmax : Hz, highest mode.
    points : (p, 2) m, positions on the top.
    directions : (p, 3) unit vectors in which their displacement is counted.
    heights : (p,) m above the top's middle surface; a point at height H moves by -H w_x along x and -H w_y along y.
    """

    outline: Floats
    hole: Floats | None
    top: PlateDrawing
    back: PlateDrawing | None
    depth: float
    cavity_to: float
    end_correction: float
    air_loss: float
    extra_loss: float
    baffled: bool
    fmax: float
    points: Floats
    directions: Floats
    heights: Floats


@dataclass(frozen=True, eq=False)
class BodyModes:
    """Modes of a body, mass-normalised, ascending; all arrays.

    freq : (n,) Hz.
    loss : (n,) loss factors, twice the damping ratio.
    radiation_loss : (n,) share of `loss` that is radiated.
    kinetic : (3, n) shares of plates, hole and cavity in the kinetic energy.
    shapes : (p, n) 1/sqrt(kg) at the drawing's points.
    residual : (p, p) m/N.
    sources : (m, 2) m, centres of small squares of the top and, from `hole_from` on, of the hole.
    areas : (m,) m^2 of these.
    volumes : (m, n) m^3 per unit of each mode's coordinate.
    hole_from : (1,) number of squares of the top.
    back_sources, back_volumes : the same of the back; empty where it is rigid.
    vacuum_freq : (k,) Hz, of the top without air, without rigid-body motion.
    cavity_freq : (l,) Hz, of the cavity with rigid walls.
    masses : (2,) kg, of top and back with their beams.
    """

    freq: Floats
    loss: Floats
    radiation_loss: Floats
    kinetic: Floats
    shapes: Floats
    residual: Floats
    sources: Floats
    areas: Floats
    volumes: Floats
    hole_from: Floats
    back_sources: Floats
    back_volumes: Floats
    vacuum_freq: Floats
    cavity_freq: Floats
    masses: Floats

    def arrays(self) -> dict[str, Floats]:
        """All fields by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def below(self, freq: float) -> BodyModes:
        """Return the modes below `freq` (Hz); the compliance of the others goes into the residual."""
        keep = self.freq < freq
        if keep.all():
            return self
        rest = self.shapes[:, ~keep]
        residual = self.residual + (rest / (2 * np.pi * self.freq[~keep]) ** 2) @ rest.T
        few = {name: getattr(self, name)[..., keep] for name in ("freq", "loss", "radiation_loss", "kinetic", "shapes")}
        return replace(
            self, residual=residual, volumes=self.volumes[:, keep], back_volumes=self.back_volumes[:, keep], **few
        )

    def named(self) -> dict[str, int]:
        """Numbers of the modes that are called A0 and T1.

        Both are modes below 400 Hz in which the cavity's own modes hold less than half of the kinetic energy: A0, where
        there is a hole, the one in whose air there is most of it, T1 the one above A0 with the largest volume displaced
        by the top, over frequency squared. A free plate has neither.
        """
        return named_modes(self.freq, self.kinetic, self.volumes[: int(self.hole_from[0])].sum(axis=0))

    def labels(self) -> tuple[str, ...]:
        """Name of each mode: ``A0``, ``T1``, or the part that holds most of its kinetic energy."""
        parts = np.array(["plate", "hole", "cavity"])[np.argmax(self.kinetic, axis=0)]
        named = {number: name for name, number in self.named().items()}
        return tuple(named.get(k, str(part)) for k, part in enumerate(parts))


def named_modes(freq: Floats, kinetic: Floats, top: Floats) -> dict[str, int]:
    """Numbers of A0 and T1, by the rule of `BodyModes.named`.

    freq, kinetic, top : (n,) Hz, (3, n) shares of the energy, (n,) volumes displaced by the top.
    """
    if not freq.all():
        return {}
    low = np.flatnonzero((freq < 400.0) & (kinetic[2] < 0.5))
    numbers = {}
    if low.size and kinetic[1, low].max() > 0:
        numbers["A0"] = int(low[np.argmax(kinetic[1, low])])
        low = low[low > numbers["A0"]]
    if low.size:
        numbers["T1"] = int(low[np.argmax(np.abs(top)[low] / freq[low] ** 2)])
    return numbers


@one_blas_thread
def body_modes(drawing: BodyDrawing) -> BodyModes:
    """Modes of a drawn body up to its `fmax`.

    Raises ValueError : a plate would need more than `MOST_UNKNOWNS` unknowns.
    """
    with stages("modes of the body", 6 if drawing.back is not None else 4) as begin:
        return _body_modes(drawing, begin)


def _body_modes(drawing: BodyDrawing, begin: Callable[[str], None]) -> BodyModes:
    rings = [drawing.outline] if drawing.hole is None else [drawing.outline, drawing.hole]
    top = _solved(rings, drawing.top, drawing.fmax, begin, "top")
    back = None if drawing.back is None else _solved([drawing.outline], drawing.back, drawing.fmax, begin, "back")
    plates = [top] if back is None else [top, back]
    wood = np.concatenate([p.loss for p in plates]) + drawing.extra_loss
    faces = [_face(p) for p in plates]
    mouth = None if drawing.hole is None else mouth_of(drawing.hole)
    loads = point_loads(top.plate, drawing)
    begin("air")
    coupled, cavity_freq, (residual, lever) = _with_air(drawing, plates, faces, mouth, loads)
    n = len(top.freq)
    few = coupled.freq <= drawing.fmax
    keep = np.flatnonzero(few)
    shapes = loads @ top.vectors @ coupled.plates[:n] + lever @ coupled.pressure
    residual = residual + (shapes[:, ~few] / (2 * np.pi * coupled.freq[~few]) ** 2) @ shapes[:, ~few].T
    freq, alone = _without_rounding(coupled.freq[keep]), _without_rounding(top.freq)
    points, areas, squares = gathered_sources(*faces[0], SOURCE_SIZE)
    volumes, hole_from = squares @ coupled.plates[:n, keep], len(points)
    if mouth is not None and drawing.depth > 0:
        disc, disc_areas, _ = gathered_sources(*mouth, np.zeros((len(mouth[1]), 0)), SOURCE_SIZE)
        points, areas = np.vstack([points, disc]), np.concatenate([areas, disc_areas])
        volumes = np.vstack([volumes, np.outer(disc_areas / disc_areas.sum(), coupled.hole[keep])])
    back_points, back_volumes = np.zeros((0, 2)), np.zeros((0, len(keep)))
    if back is not None:
        back_points, _, squares = gathered_sources(*faces[1], SOURCE_SIZE)
        back_volumes = squares @ coupled.plates[n:, keep]
    begin("radiation")
    resistance = Sources(points, volumes, drawing.baffled).resistance(freq)
    if back is not None:
        resistance = resistance + Sources(back_points, back_volumes, drawing.baffled).resistance(freq)
    omega = 2 * np.pi * freq
    radiated = np.where(omega > 0, resistance / np.where(omega > 0, omega, 1.0), 0.0)
    stored = coupled.stored[:, keep]
    rubbed = np.zeros(len(keep))
    if (hole := opening_of(drawing, mouth)) is not None:
        rubbed = hole_loss(coupled.freq[keep], coupled.hole[keep], *hole)
    return BodyModes(
        freq=freq,
        loss=wood @ stored + drawing.air_loss * np.maximum(1 - stored.sum(axis=0), 0.0) + radiated + rubbed,
        radiation_loss=radiated,
        kinetic=coupled.kinetic[:, keep],
        shapes=shapes[:, keep],
        residual=_semidefinite(residual),
        sources=points,
        areas=areas,
        volumes=volumes,
        hole_from=np.array([float(hole_from)]),
        back_sources=back_points,
        back_volumes=back_volumes,
        vacuum_freq=alone[alone > 0],
        cavity_freq=cavity_freq,
        masses=np.array([top.plate.mass, 0.0 if back is None else back.plate.mass]),
    )


def _without_rounding(freq: Floats) -> Floats:
    """Frequencies, exactly 0 for the rigid-body modes of a body that nothing holds."""
    flexible = freq[3] if len(freq) > 3 else 0.0
    return np.where(freq < _RIGID * flexible, 0.0, freq)


def first_modes(drawing: BodyDrawing, edges: Sequence[Edge], fmax: float = 1500.0) -> list[dict[str, float]]:
    """A0 and T1 (Hz) of the body with its top on each of several edges, from plate modes up to `fmax` (Hz)."""
    typical = drawing.top.thickness if not callable(drawing.top.thickness) else 2.5e-3
    size = drawing.top.size or cell_size(drawing.top.wood, typical, drawing.fmax)
    low, freqs = replace(drawing, fmax=min(fmax, drawing.fmax), points=drawing.points[:1]), []
    low = replace(low, directions=low.directions[:1], heights=low.heights[:1])
    for edge in edges:
        modes = body_modes(replace(low, top=replace(low.top, edge=edge, size=size)))
        freqs.append({name: float(modes.freq[k]) for name, k in modes.named().items()})
    return freqs


def cell_of(outline: Floats, drawn: PlateDrawing, fmax: float) -> float:
    """Size of a plate's cells (m): its own, or that for modes up to `fmax` (Hz)."""
    typical = drawn.thickness if not callable(drawn.thickness) else float(np.mean(drawn.thickness(outline)))
    return drawn.size or cell_size(drawn.wood, typical, fmax)


def made_plate(rings: Sequence[Floats], drawn: PlateDrawing, fmax: float) -> Plate:
    """Matrices of a drawn plate. Raises ValueError : it would need more than `MOST_UNKNOWNS` unknowns."""
    size = cell_of(rings[0], drawn, fmax)
    unknowns = area(rings[0]) / size**2 * ((3 if drawn.beams else 1) + (2 if drawn.wood.shears else 0))
    if unknowns > MOST_UNKNOWNS:
        raise ValueError(
            f"modes to {fmax:g} Hz need cells of {1e3 * size:.2g} mm, some {unknowns:.0f} unknowns, of which "
            f"{MOST_UNKNOWNS} are allowed: a lower fmax or a larger cell is wanted"
        )
    return Plate(rings, drawn.wood, drawn.thickness, drawn.edge, drawn.beams, size=size, grain=drawn.grain)


def _solved(
    rings: Sequence[Floats],
    drawn: PlateDrawing,
    fmax: float,
    begin: Callable[[str], None] = lambda stage: None,
    name: str = "",
) -> PlateModes:
    begin(f"matrices of the {name}")
    plate = made_plate(rings, drawn, fmax)
    begin(f"vibration of the {name}")
    return plate.modes(fmax)


def _face(modes: PlateModes) -> tuple[Floats, Floats, Floats]:
    """Points, weights and shapes of a plate at its points of integration."""
    quad = modes.plate.quadrature
    return quad.points, quad.weights, modes.shapes(quad.points)


def mouth_of(ring: Floats) -> tuple[Floats, Floats]:
    """Points and weights of integrals over a hole."""
    quad = quadrature(SplineGrid.over(ring, float(np.ptp(ring, axis=0).max()) / 4, degree=2), [ring])
    return quad.points, quad.weights


def opening_of(drawing: BodyDrawing, mouth: tuple[Floats, Floats] | None) -> tuple[float, float] | None:
    """Area of the soundhole (m^2) and thickness of the top there (m); None without one."""
    if mouth is None:
        return None
    thick = drawing.top.thickness
    return float(mouth[1].sum()), thick if not callable(thick) else float(np.mean(thick(mouth[0])))


def _with_air(
    drawing: BodyDrawing,
    plates: Sequence[PlateModes],
    faces: Sequence[tuple[Floats, Floats, Floats]],
    mouth: tuple[Floats, Floats] | None,
    loads: Floats,
) -> tuple[AirModes, Floats, tuple[Floats, Floats]]:
    """Join the plates' modes to their air.

    Returns modes; (m,) Hz of the cavity; for the plate modes left out, the residual (p, p) m/N and the displacement of
        the points (p,) per pressure of each of the cavity's modes, m/Pa.
    """
    from tonewood.support.scipy_linalg import sla

    freq, top = np.concatenate([p.freq for p in plates]), plates[0]
    if drawing.depth == 0:
        n = len(freq)
        order = np.argsort(freq)
        alone = np.eye(n)[:, order]
        kinetic = np.zeros((3, n))
        kinetic[0] = 1.0
        modes = AirModes(freq[order], alone, np.zeros(n), np.zeros((0, n)), kinetic, alone**2, np.zeros((0, n)))
        return modes, np.zeros(0), (top.plate.residual(loads, top), np.zeros((len(loads), 0)))
    cavity = cavity_modes(drawing.outline, drawing.depth, drawing.cavity_to)
    m = len(cavity.freq)
    swept = [np.vstack([weights, weights * cavity.shapes(points).T]) for points, weights, _ in faces]
    outward, b = np.split(np.hstack([w @ shapes for w, (_, _, shapes) in zip(swept, faces, strict=True)]), [1])
    at_hole, hole = np.zeros(m), None
    if mouth is not None and (opening := opening_of(drawing, mouth)) is not None:
        at_hole = mouth[1] @ cavity.shapes(mouth[0]) / opening[0]
        hole = (opening[0], opening[1] + drawing.end_correction * float(np.sqrt(opening[0] / np.pi)))
    volumes = [w @ modes.plate.operator(points) for w, modes, (points, _, _) in zip(swept, plates, faces, strict=True)]
    rest = top.plate.residual(np.vstack([loads, volumes[0]]), top)
    points = len(loads)
    compliance, lever = rest[points:, points:], rest[:points, points:]
    for back, swept_by in zip(plates[1:], volumes[1:], strict=True):
        compliance = compliance + back.plate.residual(swept_by, back)
    modes = couple_air(freq, outward[0], cavity.volume, hole, (cavity.freq, b, at_hole), compliance)
    stiff = np.eye(1 + m) * cavity.volume / (AIR_DENSITY * SOUND_SPEED**2) + compliance
    added = lever @ sla.solve(stiff, lever.T, assume_a="pos")
    return modes, cavity.freq, (rest[:points, :points] - added, lever)


def point_loads(plate: Plate, drawing: BodyDrawing) -> Floats:
    """(p, functions) displacement of the drawing's points: z w - H (x w_x + y w_y)."""
    x, y, z = (drawing.directions[:, i, None] for i in range(3))
    w, w_x, w_y = (plate.operator(drawing.points, order).toarray() for order in ((0, 0), (1, 0), (0, 1)))
    return np.asarray(z * w - drawing.heights[:, None] * (x * w_x + y * w_y))


def _semidefinite(matrix: Floats) -> Floats:
    """Matrix without its negative eigenvalues, which are rounding."""
    from tonewood.support.scipy_linalg import sla

    if not len(matrix):
        return matrix
    values, vectors = sla.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
