"""Points of a string's basis: places that do not move, means over a contact, and a pluck at another place."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tonewood.modal.modes import PAIR, ModalBasis

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def with_still_points(basis: ModalBasis, names: Sequence[str]) -> ModalBasis:
    """Add points that do not move: places behind the stop, on which connections act at other stops."""
    if not names:
        return basis
    rows = np.zeros((len(names), basis.n_modes), dtype=np.complex128)
    return replace(
        basis,
        points=(*basis.points, *names),
        right=np.vstack([basis.right, rows]),
        left=np.vstack([basis.left, rows]),
        residual=np.pad(basis.residual, (0, len(names))),
    )


def spread(basis: ModalBasis, point: str, width: float) -> ModalBasis:
    """Let a point stand for the mean over `width` (m) of the string about it, by a Gauss rule of three places.

    A force spread evenly acts on that mean. The residual compliance stays that of the place.
    """
    if basis.shape is None:
        return basis
    right, left = _with_row(basis, point, _mean(basis.shape, basis.places[point], width))
    return replace(basis, right=right, left=left)


def moved(basis: ModalBasis, point: str, place: float, width: float) -> ModalBasis:
    """Put a point at another place (m) of a string; all else, the poles among it, is that of `basis`.

    The basis is the same as one that is made with the point there, and then `spread` where `width` (m) is not 0.
    """
    assert basis.shape is not None
    right, left = _with_row(basis, point, _mean(basis.shape, place, width) if width else basis.shape(place))
    residual, places = basis.residual.copy(), {**basis.places, point: place}
    if (between := basis.residual_at) is not None:
        i, at = basis.points.index(point), [basis.points.index(name) for name in places]
        xs = np.array(list(places.values()))
        compliance = between(xs, place)
        if len(at) > 2:  # other points than the bridge: the mean of both, as where they are made together
            added = np.array([name != "bridge" for name in places])
            compliance = np.where(added, 0.5 * (compliance + between(place, xs)), compliance)
        residual[at, i] = residual[i, at] = compliance
    return replace(basis, right=right, left=left, residual=residual, places=places)


def _mean(shape: Callable[[float], Floats], at: float, width: float) -> Floats:
    """Shapes of modes, (n_modes,), in the mean over a width (m)."""
    offset = 0.5 * width * math.sqrt(0.6)
    return (5 * shape(at - offset) + 8 * shape(at) + 5 * shape(at + offset)) / 18


def _with_row(basis: ModalBasis, point: str, shape: Floats) -> tuple[Complexes, Complexes]:
    """Right and left shapes of real modes with another shape (n_modes,) of a point."""
    i, pair = basis.points.index(point), basis.kind == PAIR
    right, left = basis.right.copy(), basis.left.copy()
    right[i], left[i] = shape, shape * np.where(pair, -0.5j / np.where(pair, basis.poles.imag, 1.0), 1.0)
    return right, left
