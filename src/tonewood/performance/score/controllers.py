"""Values of controllers over time, found by bisection, per kind and channel."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Sequence
from operator import attrgetter

from tonewood.performance.score.note import Control, Note

_time = attrgetter("time")


class History:
    """Controls of one kind on one channel.

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

    def of(self, note: Note) -> Callable[[str], float | None]:
        """Return the function kind -> value on a note's channel when it begins."""
        return lambda kind: self.at(kind, note.channel, note.time)


def loudness(latest: Callable[[str], float | None]) -> float:
    """Factor on a note's force from its channel's volume (cc7) and expression (cc11) when it begins.

        factor = (cc7 · cc11)²,   controllers from 0 to 1, 1 before the first

    which is the gain of 40 lg(value/127) dB each that General MIDI asks for. A plucked string cannot follow them
    afterwards, and a factor never exceeds 1: the instrument's range of forces holds.

    Parameters
    ----------
    latest : kind of controller -> its value on the note's channel, None before its first.

    Source: General MIDI 2 (MIDI Manufacturers Association 1999), page 8: "Gain in dB = 40 log10(cc7/127) +
    40 log10(cc11/127)".
    """
    volume, expression = latest("cc7"), latest("cc11")
    return ((1.0 if volume is None else volume) * (1.0 if expression is None else expression)) ** 2
