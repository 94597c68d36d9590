"""From a model's readouts to the channels of a sound: gain, pan, equalizer and delay of each output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.model.assembly import Model
from tonewood.sound.equalizer import Equalizer

Floats = NDArray[np.float64]


class Routing:
    """Scales readouts to full scale, gives them to channels, filters these by the equalizer of their output, and delays them by whole frames.

    Parameters
    ----------
    model : with its output groups.
    fs : sampling rate, Hz.
    gain_db : of all channels.

    Attributes
    ----------
    channels : names, ``GROUP.CHANNEL`` where there are several groups.
    scale : (n_channels,) 1 per unit of each readout.
    delays : (n_channels,) frames, the nearest to those of the outputs.
    equalizer : of the channels.
    memory : (longest delay, n_channels) the latest frames that came in.
    """

    def __init__(self, model: Model, fs: float, gain_db: float = 0.0):
        groups = model.outputs
        alone = len(groups) == 1
        self.channels = tuple(name if alone else f"{group.name}.{name}" for group in groups for name in group.channels)
        columns = [i for group in groups for i in group.readouts]
        self.whole = columns == list(range(len(model.system.readouts)))
        self._columns: slice | list[int] = slice(None) if self.whole else columns
        gain = 10 ** (gain_db / 20)
        self.scale = np.array([gain * factor / group.full_scale for group in groups for factor in group.gains])
        self.equalizer = Equalizer([group.equalizer for group in groups for _ in group.channels], fs)
        self.delays = [round(group.delay * fs) for group in groups for _ in group.channels]
        self.memory: Floats = np.zeros((max(self.delays, default=0), len(columns)))

    def scaled(self, readouts: Floats) -> Floats:
        """(n, n_channels) from (n, n_readouts), at the engine's rate."""
        return np.asarray(readouts[:, self._columns] * self.scale)

    def finished(self, sound: Floats) -> Floats:
        """(n, n_channels) frames behind their equalizers, each channel as late as its output says; the last ones stay in `memory`."""
        sound, longest = self.equalizer(sound), len(self.memory)
        if not longest:
            return sound
        whole = np.concatenate([self.memory, sound])
        self.memory = whole[len(whole) - longest :].copy()
        return np.column_stack([whole[longest - delay : len(whole) - delay, j] for j, delay in enumerate(self.delays)])
