"""Modes of a body that changes in small steps, each followed by its shape.

Modes of different symmetry pass each other without a gap, and close ones veer: the n-th frequency of a list is then
another mode than it was a step before.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.plate.body import BodyModes

Floats = NDArray[np.float64]


def followed(steps: Sequence[BodyModes], count: int) -> Floats:
    """(steps, count) Hz: frequencies of the first step's first modes, in all steps.

    From one step to the next modes are paired so that the correlations |u v| / |u| |v| of the volumes they displace add
    up to the most.
    """
    from scipy.optimize import linear_sum_assignment

    chosen = np.arange(count)
    rows = [steps[0].freq[:count]]
    for before, after in pairwise(steps):
        u, v = before.volumes[:, chosen], after.volumes
        alike = np.abs(u.T @ v) / np.sqrt(np.outer((u**2).sum(axis=0), (v**2).sum(axis=0)))
        _, chosen = linear_sum_assignment(-alike)
        rows.append(after.freq[chosen])
    return np.array(rows)
