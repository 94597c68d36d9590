"""Values of controllers over time, found by bisection, per kind and channel."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Sequence
from operator import attrgetter

from tonewood.performance.score.note import Control

_time = attrgetter("time")


class History:
    """Controls of one kind on one channel.

    Parameters
    ----------
    controls : of two at the same time the later one in the sequence holds.
    """

    def __init__(self, controls: Sequence[Control] = ()):
        self.controls = sorted(controls, key=_time)
        self._times = [c.time for c in self.controls]

    def at(self, time: float) -> float | None:
        """Value at a time (s), None before the first control."""
        i = bisect_right(self._times, time)
        return self.controls[i - 1].value if i else None

    def between(self, after: float, before: float) -> Sequence[Control]:
        """Controls after one time (s) and before another, neither included."""
        return self.controls[bisect_right(self._times, after) : bisect_left(self._times, before)]


class Controllers:
    """All controls of a score.

    Parameters
    ----------
    controls : in any order; one without a channel holds on all of them, but a channel's own of the same time is kept.
    """

    def __init__(self, controls: Sequence[Control]):
        by_kind: dict[str, dict[int | None, list[Control]]] = defaultdict(lambda: defaultdict(list))
        for control in controls:
            by_kind[control.kind][control.channel].append(control)
        self._histories: dict[tuple[str, int | None], History] = {}
        for kind, by_channel in by_kind.items():
            common = by_channel.get(None, [])
            for channel, changes in by_channel.items():
                self._histories[kind, channel] = History(changes if channel is None else [*common, *changes])

    def at(self, kind: str, channel: int | None, time: float) -> float | None:
        """Value of a controller on a channel at a time (s), None before its first."""
        history = self._histories.get((kind, channel)) or self._histories.get((kind, None))
        return None if history is None else history.at(time)
