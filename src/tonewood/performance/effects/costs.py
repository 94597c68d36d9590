"""Time that steps take on this machine, fitted to the processor's clock while they are made."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tonewood.support.arrays import Floats

#: weight of the declared costs beside the measured times: they decide where nothing was measured
_DECLARED = 1e-4


@dataclass(frozen=True, slots=True)
class Rates:
    """Seconds of the processor.

    mode : per step of one mode.
    running : effect -> per sample in which it runs on any component, besides.
    load : effect -> per sample and unit of its load (`SwitchedEffect.load`), besides.
    """

    mode: float = 0.0
    running: Mapping[str, float] = field(default_factory=dict)
    load: Mapping[str, float] = field(default_factory=dict)


class Costs:
    """Least squares of the times of runs over the modes and effects stepped in them; no rate is negative.

    declared : switched effect -> its declared cost per unit of load, in steps of one mode.
    """

    def __init__(self, declared: Mapping[str, float]):
        self.declared = dict(declared)
        # modes and loads -> samples that were stepped with them, and the seconds that took
        self._runs: dict[tuple[float, ...], list[float]] = {}
        self._rates: Rates | None = None

    def add(self, seconds: float, samples: int, modes: int, loads: Sequence[float]) -> None:
        """Enter a run: how many modes were stepped, and the load of every effect, 0 where it did not run."""
        totals = self._runs.setdefault((modes, *loads), [0.0, 0.0])
        totals[0] += samples
        totals[1] += seconds
        self._rates = None

    def rates(self) -> Rates:
        """Best fit of all runs so far."""
        if self._rates is None:
            self._rates = self._fitted()
        return self._rates

    def _fitted(self) -> Rates:
        zeros = dict.fromkeys(self.declared, 0.0)
        modes, *loads = np.array(list(self._runs), dtype=float).reshape(-1, 1 + len(zeros)).T
        samples, seconds = np.array(list(self._runs.values())).reshape(-1, 2).T
        if not np.any(samples * modes) or not np.any(seconds > 0.0):
            return Rates(0.0, zeros, zeros)
        each = np.stack([modes, *(row for load in loads for row in (load > 0.0, load))])
        steps, squares = each @ samples, (samples * modes) @ modes
        declared = np.array([1.0, *(row for cost in self.declared.values() for row in (0.0, cost))])
        declared *= seconds.sum() / (steps @ declared)
        weight = _DECLARED * np.array([squares] + [steps[0] ** 2 / squares, squares] * len(zeros))
        matrix = (samples * each) @ each.T + np.diag(weight)
        prices = not_negative(matrix, each @ seconds + weight * declared).tolist()
        names = list(zeros)
        return Rates(
            prices[0], dict(zip(names, prices[1::2], strict=True)), dict(zip(names, prices[2::2], strict=True))
        )


def not_negative(matrix: Floats, right: Floats) -> Floats:
    """Minimum of x M x / 2 - b x over x >= 0: the best of all choices of unknowns that are not 0.

    For a few unknowns. `scipy.optimize.nnls` is general, but importing it takes longer than the sums of a short render.

    matrix, right : (n, n) positive definite, and (n,).
    """
    best, least = np.zeros(right.size), 0.0
    scale = 1 / np.sqrt(matrix.diagonal())
    for size in range(1, right.size + 1):
        for chosen in itertools.combinations(range(right.size), size):
            on = np.array(chosen)
            d = scale[on]
            x = np.zeros(right.size)
            x[on] = d * np.linalg.solve(d[:, None] * matrix[on[:, None], on] * d, d * right[on])
            value = -0.5 * float(right @ x)  # of a stationary point
            if np.all(x >= 0.0) and value < least:
                best, least = x, value
    return best
