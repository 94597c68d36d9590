"""An energy account as plain arrays: for JSON, for plots, for checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class EnergyTrace:
    """Energy over k intervals; all in J, each interval from the end of the one before.

    time : (k,) s, end of each interval.
    steps : (k,) steps in each.
    dt : s, one step.
    initial : name -> energy stored at the beginning.
    stored : component or connection -> (k,) energy stored at the end of each interval.
        ``STRING.stretch`` alone may be negative: it is the strain energy of the whole string less that of its
        longitudinal modes, which stands in ``STRING.longitudinal``.
    supplied : exciter -> (k,) work of its known forces in each interval.
    booked : label -> (k,) energy put in between steps, before or in the interval: bends, stops, impacts.
    lost : component or connection -> (k,) energy dissipated in each interval; ``COMPONENT.sound`` is radiated.
    residual : (k,) difference that the terms leave: rounding.
    """

    time: Floats
    steps: NDArray[np.int64]
    dt: float
    initial: Mapping[str, float]
    stored: Mapping[str, Floats]
    supplied: Mapping[str, Floats]
    booked: Mapping[str, Floats]
    lost: Mapping[str, Floats]
    residual: Floats

    @property
    def total(self) -> Floats:
        """(k,) all that is stored, J."""
        return _sum(self.stored, self.time.size)

    @property
    def peak(self) -> float:
        """Largest stored energy of the whole run, J."""
        return float(max(self.total.max(initial=0.0), sum(self.initial.values())))

    @property
    def power_in(self) -> Floats:
        """(k,) W, mean power of exciters and of booked changes."""
        into = _sum(self.supplied, self.time.size) + _sum(self.booked, self.time.size)
        return np.asarray(into / (self.steps * self.dt))

    @property
    def power_lost(self) -> Floats:
        """(k,) W, mean dissipated power."""
        return np.asarray(_sum(self.lost, self.time.size) / (self.steps * self.dt))

    @property
    def worst_residual(self) -> float:
        """Largest |residual| of one interval, as a share of the peak."""
        return float(np.abs(self.residual).max(initial=0.0) / self.peak) if self.peak > 0 else 0.0

    @property
    def worst_cumulative_residual(self) -> float:
        """Largest |sum of residuals| up to any time, as a share of the peak."""
        return float(np.abs(np.cumsum(self.residual)).max(initial=0.0) / self.peak) if self.peak > 0 else 0.0

    def balance(self) -> dict[str, float]:
        """In short: largest stored energy, J, and how far the account stays open, as shares of it."""
        return {
            "peak_J": self.peak,
            "worst_residual": self.worst_residual,
            "worst_cumulative_residual": self.worst_cumulative_residual,
        }

    def to_dict(self) -> dict[str, object]:
        """Lists and numbers for JSON."""
        return {
            "schema": "tonewood-energy/1",
            "unit": "J",
            "dt": self.dt,
            "time": self.time.tolist(),
            "steps": self.steps.tolist(),
            "initial": dict(self.initial),
            "stored": {name: values.tolist() for name, values in self.stored.items()},
            "supplied": {name: values.tolist() for name, values in self.supplied.items()},
            "booked": {name: values.tolist() for name, values in self.booked.items()},
            "lost": {name: values.tolist() for name, values in self.lost.items()},
            "power_in": self.power_in.tolist(),
            "power_lost": self.power_lost.tolist(),
            "residual": self.residual.tolist(),
            "peak": self.peak,
            "worst_residual": self.worst_residual,
            "worst_cumulative_residual": self.worst_cumulative_residual,
        }

    def plot(self, file: str | Path | BinaryIO) -> None:
        """Draw stored energy, powers and the balance residual into a picture; needs matplotlib.

        A stream open for writing gets a PNG; a file name decides by its suffix.
        """
        from tonewood.support.plotting import COLOURS, LINE, figure, legend

        chart, axes = figure(3, heights=[4.0, 4.0, 4.0], sharex=True)
        above, middle, below = axes[:, 0]
        shown = sorted(self.stored, key=lambda name: -float(self.stored[name].max(initial=0.0)))
        for i, name in enumerate(shown[:12]):
            above.plot(self.time, self.stored[name], lw=0.5 * LINE, color=COLOURS[i % 6], label=name)
        above.plot(self.time, self.total, "k", lw=LINE, label="all")
        above.set(ylabel="stored energy, J", yscale="log")
        above.set_ylim(max(self.peak, 1e-300) * 1e-9, max(self.peak, 1e-300) * 2)
        legend(above, ncols=3, loc="lower right")
        middle.plot(self.time, self.power_in, lw=0.5 * LINE, color=COLOURS[0], label="put in")
        middle.plot(self.time, self.power_lost, lw=0.5 * LINE, color=COLOURS[1], label="dissipated")
        middle.set_ylabel("power, W")
        middle.set_yscale("symlog", linthresh=max(float(np.abs(self.power_lost).max(initial=0.0)) * 1e-3, 1e-300))
        legend(middle)
        scale = self.peak or 1.0
        below.semilogy(self.time, np.abs(self.residual) / scale, lw=0.3 * LINE, color=COLOURS[0], label="each interval")
        total = np.abs(np.cumsum(self.residual)) / scale
        below.semilogy(self.time, total, lw=0.5 * LINE, color=COLOURS[1], label="summed up")
        below.set(xlabel="time, s", ylabel="balance residual\n/ peak energy")
        legend(below)
        chart.savefig(file, dpi=110)


def _sum(values: Mapping[str, Floats], size: int) -> Floats:
    return np.asarray(sum(values.values(), np.zeros(size)))
