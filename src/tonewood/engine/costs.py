"""What steps take on this machine, fitted to the clock while they are made."""

from __future__ import annotations

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
        self._products, self._times, self._steps = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        self._seconds = 0.0

    def add(self, seconds: float, samples: int, modes: int, tense_modes: int) -> None:
        """Enter a run: how many modes were stepped, and of strings whose tension rose."""
        each = np.array([modes, float(tense_modes > 0), tense_modes])
        self._products += samples * np.outer(each, each)
        self._times += seconds * each
        self._steps += samples * each
        self._seconds += seconds

    def rates(self) -> Rates:
        """Best fit of all runs so far."""
        from scipy.optimize import nnls

        if not self._products[0, 0] or self._seconds <= 0.0:
            return Rates()
        declared = np.array([1.0, 0.0, TENSION_MODULATION.cost(1)])
        declared *= self._seconds / (self._steps @ declared)
        of_modes = self._products[0, 0]
        weight = _DECLARED * np.array([of_modes, self._steps[0] ** 2 / of_modes, of_modes])
        root = sla.cholesky(self._products + np.diag(weight))
        found = nnls(root, sla.solve_triangular(root, self._times + weight * declared, trans="T"))[0]
        return Rates(*(float(rate) for rate in found))
