"""Changes and gestures in the order in which they are due; more may be added while the engine steps."""

from __future__ import annotations

import bisect
import math
from collections.abc import Collection, Iterable
from typing import Generic, TypeVar

from tonewood.performance.player.gestures import samples
from tonewood.performance.player.timeline import Change, Play

T = TypeVar("T")

#: entries that are over before they are removed from the lists
_FORGET = 1024


class Schedule:
    """Changes and gestures that an engine still has to make.

    dt : s, length of a step.
    strings : their names.
    stop : s, when the last of all that was added is over.
    """

    def __init__(self, dt: float, strings: Collection[str]):
        self.dt, self.stop = dt, 0.0
        self._taken = -math.inf
        self._changes: _Line[Change] = _Line()
        self._plays: _Line[Play] = _Line()
        #: string -> samples at which it is changed or played
        self._due: dict[str, list[float]] = {name: [] for name in strings}

    def add(self, changes: Iterable[Change] = (), plays: Iterable[Play] = ()) -> None:
        """Add changes and gestures; of those due at the same sample the first added is done first."""
        for change in changes:
            self.stop = max(self.stop, change.time)
            self._enter(self._changes.add(samples(change.time, self.dt), change), change.string)
        for play in plays:
            self.stop = max(self.stop, play.stop)
            self._enter(self._plays.add(samples(play.start, self.dt), play), play.string)

    def _enter(self, sample: float, string: str | None) -> None:
        if string is None:
            return
        due = self._due[string]
        bisect.insort(due, sample)
        if len(due) >= 2 * _FORGET:
            del due[: bisect.bisect_left(due, self._taken)]

    @property
    def done(self) -> bool:
        """Whether nothing is left to begin."""
        return self.next_due == math.inf

    @property
    def next_due(self) -> float:
        """Sample at which the next change or gesture is due; infinite if none is."""
        return min(self._changes.next_due, self._plays.next_due)

    def take(self, before: int) -> tuple[list[Change], list[Play]]:
        """Take changes and gestures that are due before a sample; they are not given again."""
        self._taken = before
        return self._changes.take(before), self._plays.take(before)

    def next_of(self, string: str, sample: int) -> float:
        """First sample, from `sample` on, at which a string is changed or played; infinite if there is none."""
        due = self._due[string]
        following = bisect.bisect_left(due, sample)
        return due[following] if following < len(due) else math.inf

    def copy(self) -> Schedule:
        """Copy with the changes and gestures still due."""
        other = Schedule(self.dt, ())
        other.stop, other._taken = self.stop, self._taken
        other._changes, other._plays = self._changes.copy(), self._plays.copy()
        other._due = {name: list(due) for name, due in self._due.items()}
        return other


class _Line(Generic[T]):
    """Entries in the order of their samples; those that were taken are removed now and then."""

    def __init__(self) -> None:
        self._samples: list[float] = []
        self._entries: list[T] = []
        self._taken = 0

    def add(self, sample: float, entry: T) -> float:
        """Enter one behind those of the same sample; returns the sample."""
        index = bisect.bisect_right(self._samples, sample, lo=self._taken)
        self._samples.insert(index, sample)
        self._entries.insert(index, entry)
        return sample

    @property
    def next_due(self) -> float:
        """Sample of the next entry; infinite if there is none."""
        return self._samples[self._taken] if self._taken < len(self._samples) else math.inf

    def take(self, before: int) -> list[T]:
        """Entries before a sample."""
        first = self._taken
        while self._taken < len(self._samples) and self._samples[self._taken] < before:
            self._taken += 1
        entries = self._entries[first : self._taken]
        if self._taken > _FORGET:
            del self._samples[: self._taken], self._entries[: self._taken]
            self._taken = 0
        return entries

    def copy(self) -> _Line[T]:
        """Copy of those that are left."""
        other: _Line[T] = _Line()
        other._samples, other._entries = self._samples[self._taken :], self._entries[self._taken :]
        return other
