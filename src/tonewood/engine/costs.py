"""What steps take on this machine, fitted to the clock while they are made."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.instrument.effects import TENSION_MODULATION

Floats = NDArray[np.float64]

#: weight of the declared costs beside what was measured: they tell where nothing was
_DECLARED = 1e-4


@dataclass(frozen=True, slots=True)
class Rates:
    """Seconds.

    Attributes
    ----------
    mode : of one step of one mode.
    tense : more, of a sample in which any tension rises.
    tense_mode : more, of one step of a mode of a string whose tension rises.
    """

    mode: float = 0.0
    tense: float = 0.0
    tense_mode: float = 0.0


class Costs:
    """Least squares of the times of runs over what was stepped in them; no rate is negative."""

    def __init__(self) -> None:
        # how much was stepped with as many modes, and as many of strings whose tension rose: samples, seconds
        self._runs: dict[tuple[int, int], list[float]] = {}

    def add(self, seconds: float, samples: int, modes: int, tense_modes: int) -> None:
        """Enter a run: how many modes were stepped, and of strings whose tension rose."""
        known = self._runs.setdefault((modes, tense_modes), [0.0, 0.0])
        known[0] += samples
        known[1] += seconds

    def rates(self) -> Rates:
        """Best fit of all runs so far."""
        modes, tense = np.array(list(self._runs), dtype=float).reshape(-1, 2).T
        samples, seconds = np.array(list(self._runs.values())).reshape(-1, 2).T
        if not np.any(samples * modes) or not np.any(seconds > 0.0):
            return Rates()
        each = np.stack([modes, tense > 0.0, tense])
        steps, squares = each @ samples, (samples * modes) @ modes
        declared = np.array([1.0, 0.0, TENSION_MODULATION.cost(1)])
        declared *= seconds.sum() / (steps @ declared)
        weight = _DECLARED * np.array([squares, steps[0] ** 2 / squares, squares])
        found = _not_negative((samples * each) @ each.T + np.diag(weight), each @ seconds + weight * declared)
        return Rates(*(float(rate) for rate in found))


def _not_negative(matrix: Floats, right: Floats) -> Floats:
    """Where x M x / 2 - b x is least with no x below 0: of all choices which are not 0, the best that is allowed.

    For a few unknowns; the general method is in a part of SciPy whose import takes longer than a short render's sums.
    """
    best, least = np.zeros(right.size), 0.0
    scale = 1 / np.sqrt(matrix.diagonal())
    for size in range(1, right.size + 1):
        for chosen in itertools.combinations(range(right.size), size):
            on = np.array(chosen)
            d = scale[on]
            x = np.zeros(right.size)
            x[on] = d * sla.solve(d[:, None] * matrix[on[:, None], on] * d, d * right[on], assume_a="pos")
            value = -0.5 * float(right @ x)  # of a stationary point
            if np.all(x >= 0.0) and value < least:
                best, least = x, value
    return best
