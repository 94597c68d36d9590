"""Track the modes of a body by their shapes while the body changes in small steps.

Modes of different symmetry cross, and close ones veer. The n-th frequency of a list can then belong to another mode
than it did one step before.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tonewood.physics.plate.body import BodyModes
from tonewood.support.arrays import Floats


def followed(steps: Sequence[BodyModes], count: int) -> Floats:
    """(steps, count) Hz: frequencies of the first step's first modes, in all steps.

    From one step to the next, modes are paired so that the sum of the correlations |u v| / |u| |v| of the volumes that
    they displace is largest.
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
