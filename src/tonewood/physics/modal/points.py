"""A string's basis with other points, means over a width of it, modes left out, and damping added."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.string_transfer import retuned


def with_points(
    basis: ModalBasis, places: Mapping[str, float], still: Sequence[str], widths: Mapping[str, float]
) -> ModalBasis:
    """Return a basis with points at places (m), points that do not move, and some as means over their widths (m)."""
    basis = with_still_points(basis.with_places(places), still)
    for point, width in widths.items():
        basis = spread(basis, point, width)
    return basis


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
    """Let a point stand for the mean over `width` (m) of the string about it, by a Gauss rule of three points.

    A force spread evenly acts on that mean. The residual compliance stays that of the point.
    """
    if basis.shape is None:
        return basis
    at, i = basis.places[point], basis.index(point)
    offset = 0.5 * width * math.sqrt(0.6)
    mean = (5 * basis.shape(at - offset) + 8 * basis.shape(at) + 5 * basis.shape(at + offset)) / 18
    right, left = basis.right.copy(), basis.left.copy()
    pair = basis.kind == PAIR
    right[i], left[i] = mean, mean * np.where(pair, -0.5j / np.where(pair, basis.poles.imag, 1.0), 1.0)
    return replace(basis, right=right, left=left)


def below(basis: ModalBasis, freq_limit: float) -> ModalBasis:
    """Keep the modes below `freq_limit` (Hz), and put the static compliance of the others into the residual."""
    keep = np.flatnonzero(basis.natural_freq < freq_limit)
    if keep.size == basis.n_modes:
        return basis
    n = basis.n_modes
    arrays = {
        key: value[..., keep]
        for key, value in basis.metadata.items()
        if isinstance(value, np.ndarray) and value.shape[-1:] == (n,)
    }
    return replace(basis.select(keep), metadata={**basis.metadata, **arrays})


def damped(bases: Mapping[str, ModalBasis], added_damping: float) -> dict[str, ModalBasis]:
    """A string's bases with every mode's damping rate raised (1/s)."""
    return {c: retuned(b, np.sqrt(b.stiffness), b.damping_rate + added_damping) for c, b in bases.items()}


def moved(basis: ModalBasis, point: str, position: float, width: float) -> ModalBasis:
    """Put a point at another position (m) on a string; all else, the poles among it, is that of `basis`.

    The basis is the same as one that is made with the point there, and then `spread` where `width` (m) is not 0.
    """
    assert basis.shape is not None
    i, residual, places = basis.points.index(point), basis.residual.copy(), {**basis.places, point: position}
    if (between := basis.residual_at) is not None:
        at, xs = [basis.points.index(name) for name in places], np.array(list(places.values()))
        compliance = between(xs, position)
        if len(at) > 2:  # other points than the bridge: the mean of both, as where they are made together
            added = np.array([name != "bridge" for name in places])
            compliance = np.where(added, 0.5 * (compliance + between(position, xs)), compliance)
        residual[at, i] = residual[i, at] = compliance
    if width:
        return spread(replace(basis, residual=residual, places=places), point, width)
    right, left, pair = basis.right.copy(), basis.left.copy(), basis.kind == PAIR
    right[i] = shape = basis.shape(position)
    left[i] = shape * np.where(pair, -0.5j / np.where(pair, basis.poles.imag, 1.0), 1.0)
    return replace(basis, right=right, left=left, residual=residual, places=places)
