"""A string's basis with its pluck at another place, made from the one that it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tonewood.instrument.string_bases import spread
from tonewood.modal.modes import PAIR, ModalBasis


def moved(basis: ModalBasis, point: str, place: float, width: float) -> ModalBasis:
    """Put a point at another place (m) of a string; all else, the poles among it, is that of `basis`.

    The basis is the same as one that is made with the point there, and then `spread` where `width` (m) is not 0.
    """
    assert basis.shape is not None
    i, residual, places = basis.points.index(point), basis.residual.copy(), {**basis.places, point: place}
    if (between := basis.residual_at) is not None:
        at, xs = [basis.points.index(name) for name in places], np.array(list(places.values()))
        compliance = between(xs, place)
        if len(at) > 2:  # other points than the bridge: the mean of both, as where they are made together
            added = np.array([name != "bridge" for name in places])
            compliance = np.where(added, 0.5 * (compliance + between(place, xs)), compliance)
        residual[at, i] = residual[i, at] = compliance
    if width:
        return spread(replace(basis, residual=residual, places=places), point, width)
    right, left, pair = basis.right.copy(), basis.left.copy(), basis.kind == PAIR
    right[i] = shape = basis.shape(place)
    left[i] = shape * np.where(pair, -0.5j / np.where(pair, basis.poles.imag, 1.0), 1.0)
    return replace(basis, right=right, left=left, residual=residual, places=places)
