"""Modes of a table that a bundle gives another frequency and Q, such as those estimated from recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.support.params import Parameters, quantity

#: largest ratio between `near` and the frequency of the table's mode
_FAR = 1.05


class MovedMode(Parameters):
    """Another frequency and Q of one mode of a table; its modal mass and shape stay, so its stiffness changes."""

    near: float = quantity("Hz", low=1e-3, high=1e6, doc="frequency in the table, within 5 %")
    freq: float = quantity("Hz", low=1e-3, high=1e6, doc="frequency of the mode from now on")
    q: float = quantity("1", low=0.5001, high=1e6, doc="Q of the mode from now on")


def with_moved_modes(freq: Floats, q: Floats, moved: Sequence[MovedMode]) -> tuple[Floats, Floats]:
    """Return the frequencies and Q of a table with those of some modes replaced.

    Parameters
    ----------
    freq, q : (n,) Hz and 1, of the table.
    moved : new figures; each is for the mode of the table that is nearest to its `near`.

    Returns
    -------
    freq, q : (n,) new arrays.

    Raises
    ------
    ValueError : no mode lies within 5 % of `near`, or two entries are for the same mode.
    """
    freq, q, at = freq.copy(), q.copy(), []
    for mode in moved:
        nearest = int(np.argmin(np.abs(np.log(freq / mode.near)))) if len(freq) else -1
        if nearest in at:
            raise ValueError(f"two entries are for the mode near {mode.near:g} Hz")
        if nearest < 0 or not 1 / _FAR < freq[nearest] / mode.near < _FAR:
            where = "there is none" if nearest < 0 else f"the nearest is at {freq[nearest]:.4g} Hz"
            raise ValueError(f"no mode of the table lies within 5 % of {mode.near:g} Hz; {where}")
        at.append(nearest)
    for i, mode in zip(at, moved, strict=True):
        freq[i], q[i] = mode.freq, mode.q
    return freq, q
