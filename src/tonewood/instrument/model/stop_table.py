"""Nominal pitch and position of each stop of a string; `string_tuning` finds its tension."""

from __future__ import annotations

from functools import cached_property

from tonewood.instrument.model.string_setup import Stopping


class StopTable:
    """Pitch, position and length of a string at its stops; those of whole stops are computed once.

    A stop is at x = L (1 - f_0 / f) from the nut, where the ideal string sounds its pitch. Over real frets it is where
    a string hinged at the stop has the pitch of the fretted string.

    string : name, for errors.
    open_length : L, m; of real frets the length of the scale.
    stopping : its stops, and how they are tuned.
    count : highest stop; 0 for a string that is only played open.
    """

    def __init__(self, string: str, open_length: float, stopping: Stopping):
        self.string, self.open_length, self.stopping, self.count = string, open_length, stopping, stopping.count
        self._places: dict[int, float] = {}

    @cached_property
    def freqs(self) -> tuple[float, ...]:
        """Pitch of the note of every whole stop from 0 (open) on, Hz."""
        return tuple(self.stopping.freq(stop) for stop in range(self.count + 1))

    @cached_property
    def lengths(self) -> tuple[float, ...]:
        """Speaking length at every whole stop, m."""
        return tuple(self.length(stop) for stop in range(self.count + 1))

    def freq(self, stop: float) -> float:
        """Return the pitch of the note of a stop, Hz."""
        whole = int(stop)
        return self.freqs[whole] if whole == stop and 0 <= whole <= self.count else self.stopping.freq(stop)

    def position(self, stop: float) -> float:
        """Return the position of a stop, m from the nut. Raises ValueError : the string has no such stop."""
        if not (0 <= stop <= self.count and (self.stopping.continuous or stop == int(stop))):
            kind = "" if self.stopping.continuous else "whole "
            raise ValueError(f"string {self.string} has {kind}stops from 0 to {self.count}, not {stop:g}")
        if (fretted := self.stopping.fretted) is not None:
            if stop not in self._places:
                self._places[int(stop)] = self.open_length - fretted.length(int(stop))
            return self._places[int(stop)]
        return self.open_length * (1.0 - self.freqs[0] / self.freq(stop))

    def length(self, stop: float) -> float:
        """Return the speaking length at a stop, m."""
        return self.open_length - self.position(stop)

    def end(self, stop: float) -> float:
        """Return the stop that ends the modes: 0 under a soft finger, which leaves the whole string in motion."""
        return stop if self.stopping.finger is None else 0.0
