"""Directions: x from nut to bridge, y from bass to treble, z out of the soundboard (right-handed)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from tonewood.support.params import Vector

AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def _unit(value: Literal["x", "y", "z"] | Vector) -> Literal["x", "y", "z"] | Vector:
    if isinstance(value, tuple) and abs(math.hypot(*value) - 1.0) > 1e-2:
        raise ValueError(f"has length {math.hypot(*value):.4g}; a direction is x, y, z or a vector of length 1")
    return value


#: ``x``, ``y``, ``z`` or three numbers of length 1 (to 1 %)
Direction = Annotated[Literal["x", "y", "z"] | Vector, AfterValidator(_unit)]


def unit_vector(direction: str | Vector) -> Vector:
    """Return a direction, ``x``, ``y``, ``z`` or three numbers, as three numbers of length 1."""
    if isinstance(direction, str):
        return AXES[direction]
    length = math.hypot(*direction)
    x, y, z = direction
    return (x / length, y / length, z / length)


def polarization_vectors(axis: Vector, polarizations: tuple[str | Vector, ...], tilt_deg: float) -> tuple[Vector, ...]:
    """Directions in which a string moves.

    Each wanted direction is made perpendicular to the string (and the second to the first), then all are turned by
    `tilt_deg` about it, from the first towards the second.

    axis : unit vector from the string's fixed end to its bridge.
    polarizations : one or two directions.
    Raises ValueError : a direction lies along the string, or the two are the same.
    """
    a = np.asarray(unit_vector(axis))
    directions: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
    for direction in polarizations:
        v = np.asarray(unit_vector(direction))
        for other in (a, *directions):
            v = v - (v @ other) * other
        size = math.sqrt(float(v @ v))
        if size < 1e-3:
            raise ValueError("lies along the string, or repeats the other polarization")
        directions.append(v / size)
    first = directions[0]
    second = directions[1] if len(directions) > 1 else np.cross(a, first)
    tilt = math.radians(tilt_deg)
    turned = (math.cos(tilt) * first + math.sin(tilt) * second, math.cos(tilt) * second - math.sin(tilt) * first)
    return tuple((float(v[0]), float(v[1]), float(v[2])) for v in turned[: len(directions)])
