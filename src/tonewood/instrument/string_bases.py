"""Bases of a string with named points, with a pluck of some width, below a limit, and damped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tonewood.modal.modes import PAIR, ModalBasis
from tonewood.modal.string_transfer import retuned


def damped(bases: Mapping[str, ModalBasis], added_damping: float) -> dict[str, ModalBasis]:
    """A string's bases with every mode's damping rate raised (1/s)."""
    return {c: retuned(b, np.sqrt(b.stiffness), b.damping_rate + added_damping) for c, b in bases.items()}


def with_points(basis: ModalBasis, places: Mapping[str, float], still: Sequence[str], width: float) -> ModalBasis:
    """Return a basis with points at places (m), points that do not move, and ``pluck`` as a mean over a width (m)."""
    basis = with_still_points(basis.with_places(places), still)
    return spread(basis, "pluck", width) if width else basis


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
