"""From a model's readouts to the channels of a sound: conversion, gain, pan, equalizer and delay of each output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate, pairwise

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.contract.conversion import Converter
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.output_assembly import OutputGroup
from tonewood.sound.equalizer import Equalizer
from tonewood.support.arrays import Floats

#: of the delays, of the equalizers, then of every converter
Memory = tuple[Floats, ...]


def columns_of(outputs: Sequence[OutputGroup], *, in_room: bool) -> list[list[int]]:
    """Channel of the dry sound for each channel, an entry per output group.

    In a room a group of one channel becomes two: two microphones hear it.
    """
    edges = accumulate((len(group.channels) for group in outputs), initial=0)
    groups = [list(range(first, last)) for first, last in pairwise(edges)]
    return [2 * group if in_room and len(group) == 1 else group for group in groups]


def _fault(model: Model, group: str) -> Callable[[str], BundleError]:
    """Make errors of an output group's pickup."""
    return partial(BundleError, file=model.instrument.folder / MANIFEST, key=f"outputs.{group}")


class Routing:
    """Converts readouts, scales them to full scale, gives them to channels, filters these and delays them by frames.

    model : with its output groups.
    fs : sampling rate, Hz.
    gain_db : of all channels.
    channels : names, ``GROUP.CHANNEL`` where there are several groups.
    scale : (n_channels,) 1 per unit of each channel.
    delays, longest_delay : (n_channels,) frames, the nearest to those of the outputs, and the largest.
    plain : whether channels are the readouts, scaled.
    """

    def __init__(self, model: Model, fs: float, gain_db: float = 0.0):
        groups = model.outputs
        alone = len(groups) == 1
        self.channels = tuple(name if alone else f"{group.name}.{name}" for group in groups for name in group.channels)
        self._converters = {
            i: Converter(group.conversion, model.system.dt, len(set(group.columns)), _fault(model, group.name))
            for i, group in enumerate(groups)
            if group.conversion is not None
        }
        self._groups = [(list(group.readouts), list(group.columns)) for group in groups]
        columns = [rows[i] for rows, chosen in self._groups for i in chosen] if not self._converters else []
        whole = columns == list(range(len(model.system.readouts)))
        self._columns: slice | list[int] = slice(None) if whole else columns
        gain = 10 ** (gain_db / 20)
        self.scale = np.array([gain * factor / group.full_scale for group in groups for factor in group.gains])
        self._equalizer = Equalizer([group.equalizer for group in groups for _ in group.channels], fs)
        self.delays = [round(group.delay * fs) for group in groups for _ in group.channels]
        self.longest_delay = max(self.delays, default=0)
        self._late: Floats = np.zeros((self.longest_delay, len(self.channels)))
        self.plain = whole and not any(self.delays) and not self._equalizer

    @property
    def memory(self) -> Memory:
        """Return a copy of all that moves: the frames that are due, the equalizers' and the circuits' states."""
        return (
            self._late.copy(),
            self._equalizer.memory.copy(),
            *(converter.memory.copy() for converter in self._converters.values()),
        )

    @memory.setter
    def memory(self, value: Memory) -> None:
        self._late, self._equalizer.memory = value[0].copy(), value[1].copy()
        for converter, part in zip(self._converters.values(), value[2:], strict=True):
            converter.memory = part.copy()

    def scaled(self, readouts: Floats) -> Floats:
        """(n, n_channels) from (n, n_readouts), at the engine's rate."""
        if not self._converters:
            return np.asarray(readouts[:, self._columns] * self.scale)
        parts = []
        for i, (rows, columns) in enumerate(self._groups):
            part = readouts[:, rows]
            parts.append((self._converters[i](part) if i in self._converters else part)[:, columns])
        return np.asarray(np.concatenate(parts, axis=1) * self.scale)

    def finished(self, sound: Floats) -> Floats:
        """(n, n_channels) frames behind their equalizers, each as late as its output says; the last are kept."""
        sound, longest = self._equalizer(sound), self.longest_delay
        if not longest:
            return sound
        whole = np.concatenate([self._late, sound])
        self._late = whole[len(whole) - longest :].copy()
        return np.column_stack([whole[longest - delay : len(whole) - delay, j] for j, delay in enumerate(self.delays)])
