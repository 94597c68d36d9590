"""Modes as a table and as figures: of a basis, a body and an instrument, for notebooks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.support.plotting import mobility_figure, points_figure
from tonewood.support.tables import table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Hz, highest mode of a body that is shown, and range of a mobility where modes set none
SHOWN_TO, _LOWEST = 20000.0, 20.0
#: points of a curve beside those at the modes
_POINTS = 3000
#: points of which a mobility is drawn where none are named
_MOST_POINTS = 6


class Modal(Protocol):
    """Attributes of a modal basis that are shown."""

    @property
    def n_modes(self) -> int:
        """Number of modes."""

    @property
    def natural_freq(self) -> NDArray[np.float64]:
        """(n_modes,) Hz."""

    @property
    def damping_rate(self) -> NDArray[np.float64]:
        """(n_modes,) 1/s."""

    @property
    def points(self) -> tuple[str, ...]:
        """Names of points."""

    def residues(self, point: str) -> NDArray[np.float64]:
        """(n_modes,) 1/kg."""

    def frf(self, freq: ArrayLike, output: str, input: str) -> NDArray[np.complex128]:
        """(n,) (m/s)/N."""


class ModalViews(ABC):
    """Tables and figures of modes, for classes that have some."""

    @abstractmethod
    def _viewed(self) -> tuple[Modal, Mapping[str, str]]:
        """Modes, and label -> point at which mobility is of interest."""

    def _view_title(self) -> str:
        return ""

    def modes(self) -> Any:
        """Tabulate the modes by frequency.

        Returns
        -------
        A `pandas.DataFrame` where pandas is installed, else a `tonewood.support.tables.Table`, with the columns
        ``freq`` (Hz, natural frequency), ``q``, ``t60`` (s) and per point ``residue_POINT``, phi^2 (1/kg), the inverse
        of the modal mass there.
        """
        basis, points = self._viewed()
        order = np.argsort(basis.natural_freq, kind="stable")
        q, decay = _q_and_t60(basis)
        columns = {"freq": basis.natural_freq, "q": q, "t60": decay}
        columns |= {f"residue_{point}": basis.residues(point) for point in dict.fromkeys(points.values())}
        return table({name: [float(v) for v in values[order]] for name, values in columns.items()})

    def plot_mobility(self, *points: str) -> Figure:
        """Draw the driving-point mobility, dB re 1 (m/s)/N, at points by their names; by default at six at most."""
        basis, labels = self._viewed()
        shown = {point: labels.get(point, point) for point in points}
        if not shown:
            names = list(labels)
            shown = {n: labels[n] for n in names[:: max(1, -(-len(names) // _MOST_POINTS))]}
        natural_freq = basis.natural_freq[basis.natural_freq > 0]
        low, high = (
            (natural_freq.min() / 2, min(natural_freq.max() * 1.5, SHOWN_TO))
            if natural_freq.size
            else (_LOWEST, SHOWN_TO)
        )
        freq = np.unique(
            np.concatenate(
                [np.geomspace(low, high, _POINTS), natural_freq[(natural_freq >= low) & (natural_freq <= high)]]
            )
        )
        curves = {label: basis.frf(freq, point, point) for label, point in shown.items()}
        return mobility_figure(freq, curves, heading=self._view_title(), of="at")

    def plot_modes(self) -> Figure:
        """Draw a point per mode over frequency: Q, and the largest residue phi^2 (1/kg) of all points."""
        basis, points = self._viewed()
        largest = np.max([basis.residues(point) for point in dict.fromkeys(points.values())], axis=0, initial=0.0)
        rows = {"Q": _q_and_t60(basis)[0], "residue, 1/kg": largest}
        return points_figure(basis.natural_freq, rows, heading=self._view_title())

    def plot_decay(self) -> Figure:
        """Draw T60 = ln(1000) / sigma of each mode over frequency, s."""
        basis, _ = self._viewed()
        return points_figure(basis.natural_freq, {"T60, s": _q_and_t60(basis)[1]}, heading=self._view_title())


def _q_and_t60(basis: Modal) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n_modes,) Q = omega / 2 sigma, and T60 in s; infinite without damping."""
    with np.errstate(divide="ignore", invalid="ignore"):
        q = np.where(basis.damping_rate > 0, np.pi * basis.natural_freq / basis.damping_rate, np.inf)
        decay = np.where(basis.damping_rate > 0, np.log(1000.0) / basis.damping_rate, np.inf)
    return q, decay
