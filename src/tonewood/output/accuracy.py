"""Three settings of accuracy, and the decimation filter of oversampled renders.

``tonewood accuracy`` measures the cost of each and its error against `reference`; docs/accuracy.md has the figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.output.options import AccuracyName

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One setting.

    Attributes
    ----------
    name : of the setting.
    oversampling : ratio of the engine's rate to that of the sound.
    as_asked : whether the bundle's own oversampling is applied in addition.
    freq_limit : Hz, no mode is stepped above it; None is 0.45 of the engine's rate.
    """

    name: AccuracyName
    oversampling: int = 1
    as_asked: bool = True
    freq_limit: float | None = None


#: for quick listening; for music; reference for the errors of the others
LEVELS: Mapping[AccuracyName, Accuracy] = {
    level.name: level
    for level in (
        Accuracy("draft", as_asked=False, freq_limit=10e3),
        Accuracy("standard"),
        Accuracy("reference", 4),
    )
}


class Decimator:
    """Streams a sound to a lower rate by a linear-phase filter, without delay: flat to 0.45 of that rate, then -110 dB.

    Parameters
    ----------
    factor : ratio of the rates; 1 leaves the sound as it is.
    n_channels : columns.
    """

    def __init__(self, factor: int, n_channels: int):
        self.factor = factor
        self._taps = np.ones(1)
        if factor > 1:
            from scipy.signal import firwin, kaiserord

            # transition from 0.9 to 1.0 of the lower Nyquist frequency
            length, beta = kaiserord(110.0, 0.1 / factor)
            half = -(-(length // 2) // factor) * factor
            self._taps = firwin(2 * half + 1, 0.95 / factor, window=("kaiser", beta))
        self.memory: Floats = np.zeros((len(self._taps) - 1, n_channels))

    @property
    def lead(self) -> int:
        """Look-ahead in frames of the lower rate: so many come out before the first frame that went in."""
        return (len(self._taps) - 1) // 2 // self.factor

    def __call__(self, sound: Floats) -> Floats:
        """(n / factor, n_channels) from (n, n_channels); n is a multiple of the factor."""
        if self.factor == 1:
            return sound
        joined = np.concatenate([self.memory, sound])
        self.memory = joined[len(joined) - len(self.memory) :]
        windows = np.lib.stride_tricks.sliding_window_view(joined, len(self._taps), axis=0)[:: self.factor]
        # einsum, whose sums do not depend on the number of frames
        return np.asarray(np.einsum("nct,t->nc", windows, self._taps))
