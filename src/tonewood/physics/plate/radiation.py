"""Sound of moving surfaces in a plane: pressure by the Rayleigh integral, and the power that they radiate.

    p(r, t) = rho / 2 pi  sum_i  Q_i''(t - R_i / c) / R_i,    R_i = |r - r_i|

Q_i'' is the volume acceleration (m^3/s^2) of a small cell of the plate or of the hole; the plane about it is rigid. The
formula holds at any distance, unlike that of the far field, which is several dB off at 1 m from a soundboard.
Source: Lord Rayleigh, The Theory of Sound, vol. 2 (1896), section 278.

An instrument in free air radiates into the whole space at low frequencies. A first-order shelf on the pressure stands
for it, from 1/2 at omega << c/a to 1 at omega >> c/a, a half the body's length,

    H(s) = (s + omega_b / 2) / (s + omega_b),    omega_b = c / a,

and (1/2 + k^2) / (1 + k^2), k = omega / omega_b, on the power: half of a pressure in twice the space. A back is heard
through the rest of it, 1 - H(s), so that at low frequencies all volumes add up to a source in free air. It is no
calculation of diffraction about the box.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED
from tonewood.support.arrays import Complexes, Floats

#: rows of a block of distances between sources
_ROWS = 128


@dataclass(frozen=True, eq=False)
class Sources:
    """Small volume sources of modes, in the plane z = 0.

    points : (n, 2) m.
    volumes : (n, modes) m^3 displaced by each cell per unit of the mode's coordinate, counted towards +z.
    baffled : whether the plane about them is rigid; else the shelf of this module stands for free air.
    areas : (n,) m^2 of the cells; empty where they are not known.
    rings : outline of the plate and its holes, each (m, 2) m, for pictures.
    behind, behind_volumes : (m, 3) m and (m, modes) m^3, the same of a back, counted outwards; not heard where baffled.
    labels : name of each mode, in its order: ``A0``, ``T1``, or the part that holds most of its kinetic energy.
    """

    points: Floats
    volumes: Floats
    baffled: bool = True
    areas: Floats = field(default_factory=lambda: np.zeros(0))
    rings: tuple[Floats, ...] = ()
    labels: tuple[str, ...] = ()
    behind: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    behind_volumes: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def of(self, modes: NDArray[np.bool_]) -> Sources:
        """Return the sources of some of the modes (n_modes,)."""
        named = tuple(label for label, one in zip(self.labels, modes, strict=True) if one) if self.labels else ()
        behind = self.behind_volumes[:, modes] if self.behind_volumes.size else self.behind_volumes
        return replace(self, volumes=self.volumes[:, modes], labels=named, behind_volumes=behind)

    @property
    def shelf(self) -> float:
        """omega_b, rad/s."""
        return float(2 * SOUND_SPEED / np.ptp(self.points, axis=0).max())

    def distances(self, at: ArrayLike) -> Floats:
        """(n,) m, of every source from a position (3,)."""
        x, y, z = np.asarray(at, dtype=np.float64)
        return np.asarray(np.sqrt((self.points[:, 0] - x) ** 2 + (self.points[:, 1] - y) ** 2 + z**2))

    def distances_behind(self, at: ArrayLike) -> Floats:
        """(m,) m, of the squares of the back from a position (3,)."""
        return np.asarray(np.sqrt(((self.behind - np.asarray(at, dtype=np.float64)) ** 2).sum(axis=1)))

    def pressure(self, at: ArrayLike, freq: ArrayLike, delay: float = 0.0) -> Complexes:
        """(modes, n_freq) Pa at a position (3,) m per unit acceleration of each mode, `delay` (s) taken out."""
        r, omega = self.distances(at), 2 * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64))
        weights = AIR_DENSITY / (2 * np.pi) * self.volumes / r[:, None]
        out = weights.T @ np.exp(-1j * np.outer(r / SOUND_SPEED - delay, omega))
        if self.baffled:
            return np.asarray(out)
        shelf = self.shelf_at(np.asarray(1j * omega))
        out = out * shelf
        if len(self.behind):
            r = self.distances_behind(at)
            weights = AIR_DENSITY / (2 * np.pi) * self.behind_volumes / r[:, None]
            out += (1 - shelf) * (weights.T @ np.exp(-1j * np.outer(r / SOUND_SPEED - delay, omega)))
        return np.asarray(out)

    def shelf_at(self, s: Complexes) -> Complexes:
        """The shelf H(s)."""
        return np.asarray((s + self.shelf / 2) / (s + self.shelf))

    def resistance(self, freq: ArrayLike, *, exact: bool = False) -> Floats:
        """(modes,) N s/m, radiation resistance of each mode at its own frequency (Hz).

        R = rho omega^2 / (2 pi c)  sum_ij V_i V_j sin(k r_ij) / (k r_ij): 1/2 R |q'|^2 is the power of one mode at a
        time. It is 2 sigma of a mode of mass 1, if cross terms between modes are left out. `exact` computes in double
        precision, for differences.
        """
        from scipy.spatial.distance import cdist

        omega = 2 * np.pi * np.asarray(freq, dtype=np.float64)
        kind: Any = np.float64 if exact else np.float32
        points, volumes = self.points, self.volumes.astype(kind)
        out = np.zeros(len(omega))
        for first in range(0, len(points), _ROWS):  # half of the symmetric sum, in blocks that a cache holds
            some = slice(first, first + _ROWS)
            apart = np.maximum(cdist(points[some], points[first:]), 1e-9).astype(kind)
            twice = np.full(apart.shape[1], 2.0, dtype=kind)
            twice[: len(apart)] = 1.0
            for k, w in enumerate(omega):  # single precision: its error is below 1e-6 of the resistance of a piston
                angle = apart * kind(w / SOUND_SPEED)
                kernel = np.sin(angle)
                np.divide(kernel, angle, out=kernel, where=angle > 0)
                out[k] += float(volumes[some, k] @ (kernel @ (twice * volumes[first:, k])))
        out = omega**2 * np.maximum(out, 0.0)
        out *= AIR_DENSITY / (2 * np.pi * SOUND_SPEED)
        square = (omega / self.shelf) ** 2
        return np.asarray(out if self.baffled else out * (0.5 + square) / (1 + square))


def gathered_sources(points: Floats, weights: Floats, shapes: Floats, size: float) -> tuple[Floats, Floats, Floats]:
    """Sums over squares of `size` m of many points of integration.

    Returns points (n, 2) m, centre of the area in each square; area (n,) m^2; volumes (n, modes), sum of weight and
        shape.
    """
    from scipy.sparse import csr_matrix

    cell = np.floor((points - points.min(axis=0)) / size).astype(np.intp)
    _, which = np.unique(cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1], return_inverse=True)
    total = csr_matrix((weights, (which, np.arange(len(weights)))))
    area = np.asarray(total.sum(axis=1)).ravel()
    return np.asarray(total @ points) / area[:, None], area, np.asarray(total @ shapes)
