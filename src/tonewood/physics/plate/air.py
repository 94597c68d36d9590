"""The air of a body: its volume, its hole and the first modes of its cavity, joined to the modes of its plates.

Coordinates: q of the plates' modes (mass 1), Y (m^3 that went out of the hole) and eta_m (m^3, one per mode of the
cavity with rigid walls). With kappa = rho c^2 / V, a_n = int phi_n dS (counted outwards), b_mn = int psi_m phi_n dS and
mean psi_m^2 = 1, all energies are squares,

    2 T = |q'|^2 + (rho L / S) Y'^2 + sum_m (kappa / omega_m^2) eta_m'^2
    2 U = q Omega^2 q + kappa (a q + Y)^2 + sum_m kappa (b_m q + psi_m(hole) Y - eta_m)^2

so that mass and stiffness are symmetric and positive, every mode is real and any truncation is passive. Eliminating
p_m = -kappa (b_m q + psi_m Y - eta_m) gives the cavity's own p_m'' + omega_m^2 p_m = -kappa (b_m q'' + psi_m Y'').
Plate modes that are left out yield to the pressures p by their static compliance C, outwards C p: in place of kappa I
the last two sums have the symmetric positive matrix (I / kappa + C)^-1, and p = -(I / kappa + C)^-1 G x.
With one plate mode and no cavity mode this is the two-oscillator model of O. Christensen and B. B. Vistisen, J. Acoust.
Soc. Am. 68 (1980) 758.

Friction of the air at the edge of the hole, of diameter d and wall t, is a resistance to the mean velocity there,

    r = rho sqrt(8 nu omega) (1 + t / d)   Pa s/m

(U. Ingard, J. Acoust. Soc. Am. 25 (1953) 1037: boundary layers of the wall and of both faces beside the edge).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tonewood.physics.plate.integrals import displacement, integrals
from tonewood.physics.plate.outline import quadrature
from tonewood.physics.plate.splines import SplineGrid
from tonewood.support.arrays import Floats

Pair = tuple[float, float]

#: kg/m^3 and m/s, air at 20 degrees Celsius
AIR_DENSITY, SOUND_SPEED = 1.2, 343.0
#: m^2/s, its kinematic viscosity nu
VISCOSITY = 1.5e-5


@dataclass(frozen=True, eq=False)
class Cavity:
    """Modes of a flat cavity with rigid walls, uniform over its depth.

    freq : (m,) Hz, without the one at 0.
    vectors : (functions, m) shapes psi of mean square 1.
    grid : of their functions.
    volume : m^3.
    """

    freq: Floats
    vectors: Floats
    grid: SplineGrid
    volume: float

    def shapes(self, points: Floats) -> Floats:
        """(n, m) pressure shapes at points (n, 2)."""
        return np.asarray(self.grid.at(points) @ self.vectors)


def cavity_modes(outline: Floats, depth: float, fmax: float, size: float = 0.02) -> Cavity:
    """Modes of the cavity below an outline up to `fmax` (Hz): -lap psi = (omega / c)^2 psi, psi_n = 0 on the walls.

    They do not depend on the depth; those of the last outlines are kept, and cannot be written to.
    """
    shallow = _cavity(np.ascontiguousarray(outline, dtype=np.float64).tobytes(), fmax, size)
    return replace(shallow, volume=shallow.volume * depth)


@lru_cache(maxsize=8)
def _cavity(ring: bytes, fmax: float, size: float) -> Cavity:
    """Cavity of depth 1 m below an outline, the bytes of an (n, 2) array."""
    from tonewood.support.scipy_linalg import sla

    outline = np.frombuffer(ring).reshape(-1, 2)
    grid = SplineGrid.over(outline, size)
    quad = quadrature(grid, [outline])
    (stiffness,) = integrals(1, quad, lambda psi: np.stack([psi((1, 0)), psi((0, 1))], axis=-2), 1.0, [np.eye(2)])
    (mass,) = integrals(1, quad, displacement, 1.0, [np.eye(1)])
    diagonal = mass.diagonal()
    keep = np.flatnonzero(diagonal > 1e-9 * diagonal.max())
    scale = 1 / np.sqrt(diagonal[keep])
    k, m = (a[keep][:, keep].toarray() * np.outer(scale, scale) for a in (stiffness, mass))
    values, shapes = sla.eigh(k, m)
    freq = SOUND_SPEED * np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    few = np.flatnonzero(freq < fmax)[1:]
    area = float(quad.weights.sum())
    vectors = np.zeros((grid.count, len(few)))
    vectors[keep] = scale[:, None] * shapes[:, few] * np.sqrt(area)
    freq = freq[few]
    for array in (freq, vectors):
        array.setflags(write=False)
    return Cavity(freq, vectors, grid, area)


@dataclass(frozen=True, eq=False)
class AirModes:
    """Modes of plates and air together, mass-normalised.

    freq : (n,) Hz, ascending.
    plates : (n_q, n) share of each plate mode q.
    hole : (n,) Y, m^3 per unit of the mode's coordinate; 0 without a hole.
    cavity : (m, n) eta.
    kinetic : (3, n) shares of plates, hole and cavity in the kinetic energy; they add up to 1.
    stored : (n_q, n) share of each plate mode's own stiffness in the potential energy; air holds the rest.
    pressure : (1 + m, n) Pa per unit of the mode's coordinate: mean of the cavity, then of each of its modes.
    """

    freq: Floats
    plates: Floats
    hole: Floats
    cavity: Floats
    kinetic: Floats
    stored: Floats
    pressure: Floats


def air_matrices(
    freq: Floats,
    outward: Floats,
    volume: float,
    hole: tuple[float, float] | None,
    cavity: tuple[Floats, Floats, Floats],
    compliance: Floats | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Mass (n,), a diagonal, stiffness (n, n) and pressures (1 + m, n) of the coordinates q, Y (with a hole) and eta.

    freq, outward : (n_q,) Hz and a_n of the plates' modes.
    volume : m^3.
    hole : area S (m^2) and length L (m) of the air that moves in it; None for a closed body.
    cavity : (m,) Hz, (m, n_q) b and (m,) psi at the hole.
    compliance : (1 + m, 1 + m) m^3/Pa, C of plate modes left out; none where left out.
    """
    from tonewood.support.scipy_linalg import sla

    kappa = AIR_DENSITY * SOUND_SPEED**2 / volume
    cavity_freq, b, at_hole = cavity
    n, m, open_hole = len(freq), len(cavity_freq), int(hole is not None)
    rows = np.zeros((1 + m, n + open_hole + m))
    rows[0, :n], rows[1:, :n] = outward, b
    rows[1:, n + open_hole :] = -np.eye(m)
    mass = np.ones(n + open_hole + m)
    if hole is not None:
        rows[0, n], rows[1:, n] = 1.0, at_hole
        mass[n] = AIR_DENSITY * hole[1] / hole[0]
    mass[n + open_hole :] = kappa / (2 * np.pi * cavity_freq) ** 2
    springs = kappa * rows
    if compliance is not None:
        springs = np.asarray(sla.solve(np.eye(1 + m) / kappa + compliance, rows, assume_a="pos"), dtype=np.float64)
    stiffness = rows.T @ springs
    stiffness = 0.5 * (stiffness + stiffness.T)
    stiffness[np.arange(n), np.arange(n)] += (2 * np.pi * freq) ** 2
    return mass, stiffness, -springs


def couple_air(
    freq: Floats,
    outward: Floats,
    volume: float,
    hole: tuple[float, float] | None,
    cavity: tuple[Floats, Floats, Floats],
    compliance: Floats | None = None,
) -> AirModes:
    """Modes of plates with their air; parameters as those of `air_matrices`."""
    from tonewood.support.scipy_linalg import sla

    mass, stiffness, pressure = air_matrices(freq, outward, volume, hole, cavity, compliance)
    scale = 1 / np.sqrt(mass)
    values, vectors = sla.eigh(stiffness * np.outer(scale, scale))
    squares = vectors**2
    shapes = scale[:, None] * vectors
    n, open_hole = len(freq), int(hole is not None)
    values = np.maximum(values, 0.0)
    parts = [squares[:n], squares[n : n + open_hole], squares[n + open_hole :]]
    stored = (shapes[:n] * (2 * np.pi * freq)[:, None]) ** 2 / np.maximum(values, 1e-12)
    return AirModes(
        np.sqrt(values) / (2 * np.pi),
        shapes[:n],
        shapes[n] if open_hole else np.zeros(len(values)),
        shapes[n + open_hole :],
        np.array([part.sum(axis=0) for part in parts]),
        stored,
        pressure @ shapes,
    )


def hole_loss(freq: Floats, flow: Floats, opening: float, wall: float) -> Floats:
    """(n,) loss factors of modes by friction in a round hole, r Y^2 / (S omega).

    freq, flow : (n,) Hz and Y of each mode.
    opening, wall : m^2 and m, area S of the hole and thickness t.
    """
    omega = np.maximum(2 * np.pi * freq, 1e-9)
    resistance = AIR_DENSITY * np.sqrt(8 * VISCOSITY * omega) * (1 + wall / np.sqrt(4 * opening / np.pi))
    return np.asarray(resistance * flow**2 / (opening * omega))
