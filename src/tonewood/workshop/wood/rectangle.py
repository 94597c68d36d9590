"""Frequencies of a free rectangular plate for any constants of its wood, quickly.

The stiffness of a plate is linear in Q11, Q22, Q12, Q66 of plane stress and in G_LT, G_RT. Each one's share is
computed once (`tonewood.physics.plate.plate.Plate`) between the lowest modes of a nominal wood; the frequencies of
another wood, or of another thickness with the same mass, are those of a small dense matrix: within 1 % for a board
that differs from the nominal wood as boards do. Where more is wanted, the wood found is the nominal one of a second
pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tonewood.physics.plate.plate import FREE, Plate
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats

#: modes of the nominal wood in which those of others are sought
_BASIS = 48
#: m from both edges of a corner where a sensor stands
SENSOR_AT = 0.01


def stiffness_constants(wood: Wood) -> Floats:
    """(6,) Pa: Q11, Q22, Q12, Q66, G_LT, G_RT."""
    q = wood.stiffness()
    return np.array([q[0, 0], q[1, 1], q[0, 1], q[2, 2], wood.G_LT, wood.G_RT])


def wood_with(constants: Floats, density: float) -> Wood:
    """Wood of such constants."""
    q11, q22, q12, q66, long, rolling = map(float, constants)
    return Wood(q11 - q12**2 / q22, q22 - q12**2 / q11, q66, q12 / q22, density, G_LT=long, G_RT=rolling)


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A free rectangular plate, its length along the grain.

    length, width, thickness : m.
    mass : kg.
    nominal : wood about which others are sought.
    parts : (6, n, n) 1/s^2, share of each constant of the nominal wood in the stiffness between the lowest modes.
    corner : (n,) 1/sqrt(kg), their shapes where a sensor stands, 10 mm from both edges of a corner.
    """

    length: float
    width: float
    thickness: float
    mass: float
    nominal: Wood
    parts: Floats
    corner: Floats

    @classmethod
    def of(cls, length: float, width: float, thickness: float, mass: float, nominal: Wood) -> Rectangle:
        """Compute the shares; some seconds."""
        density = mass / (length * width * thickness)
        nominal = replace(nominal, density=density)
        ring = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])

        def plate_of(wood: Wood) -> Plate:
            return Plate([ring], wood, thickness, FREE, size=length / 18, layers_of=nominal)

        base, constants = plate_of(nominal), stiffness_constants(nominal)
        _, vectors = base.solution(count=_BASIS)
        whole = base.stored(vectors)
        parts = []
        for i in range(len(constants)):
            more = constants * np.where(np.arange(len(constants)) == i, 1.5, 1.0)
            parts.append(2 * (plate_of(wood_with(more, density)).stored(vectors) - whole))
        corner = base.operator([[SENSOR_AT, SENSOR_AT]]) @ vectors[-base.functions :]
        return cls(length, width, thickness, mass, nominal, np.array(parts), np.asarray(corner)[0])

    def solution(self, wood: Wood, thickness: float | None = None, sensor: float = 0.0) -> tuple[Floats, Floats]:
        """Frequencies (n,), Hz, without rigid-body motion, and shares (6, n) of each constant in their energy.

        A sensor of mass m adds m phi phi^T to the mass matrix, which is 1; the problem is solved in the coordinates
        that make it 1 again.

        thickness : m, if not that of the plate; its mass stays.
        sensor : kg, mass of a sensor at a corner.
        """
        ratio = (thickness or self.thickness) / self.thickness
        factors = stiffness_constants(wood) / stiffness_constants(self.nominal) * ratio ** np.array([3, 3, 3, 3, 1, 1])
        size = float(self.corner @ self.corner)
        less = (1 - 1 / np.sqrt(1 + sensor * size)) / size
        whitened = np.eye(self.corner.size) - less * np.outer(self.corner, self.corner)
        values, vectors = np.linalg.eigh(whitened @ np.tensordot(factors, self.parts, 1) @ whitened)
        values, vectors = values[3:], whitened @ vectors[:, 3:]
        energy = np.einsum("ik,cij,jk->ck", vectors, self.parts, vectors) * factors[:, None]
        return np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi), energy / values
