"""Which effects ran when, the bounds on those left out, and the time saved."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from tonewood.performance.effects.costs import Costs


@dataclass(frozen=True, slots=True)
class Bound:
    """Upper bound on the error while an effect is left out.

    Attributes
    ----------
    cents : error of pitch.
    level : largest sample that is missing, ratio to the loudest sample so far.
    """

    cents: float = 0.0
    level: float = 0.0

    def larger(self, other: Bound) -> Bound:
        """Return the larger of this bound and `other`, cents and level each."""
        return Bound(max(self.cents, other.cents), max(self.level, other.level))


@dataclass(eq=False)
class Spans:
    """Intervals of samples, from start up to stop, in order.

    samples : their total length.
    all : (start, stop) of each.
    """

    samples: int = 0
    all: list[tuple[int, int]] = field(default_factory=list)

    def add(self, start: int, n: int) -> None:
        """Enter n samples, which join the last interval if they follow at once."""
        self.samples += n
        if self.all and self.all[-1][1] == start:
            self.all[-1] = (self.all[-1][0], start + n)
        else:
            self.all.append((start, start + n))


class EffectUsage:
    """Counts the samples in which effects ran.

    fs : Hz.
    loads : switched effect -> component -> its load, in modes.
    declared : switched effect -> its declared cost per unit of load, in steps of one mode.
    """

    def __init__(self, fs: float, loads: Mapping[str, Mapping[str, float]], declared: Mapping[str, float]):
        self.fs, self.loads = fs, loads
        #: samples stepped
        self.samples = 0
        self.costs = Costs({name: declared[name] for name in loads})
        #: (effect, component) -> when it ran
        self.spans: dict[tuple[str, str], Spans] = defaultdict(Spans)
        #: effect -> samples in which it ran on any component
        self.running: dict[str, int] = defaultdict(int)
        #: (effect, component) -> largest bound while it was left out, and at any time
        self.left_out: dict[tuple[str, str], Bound] = {}
        self.largest: dict[tuple[str, str], Bound] = {}

    def count(self, start: int, n: int, running: Mapping[str, Collection[str]], modes: int, seconds: float) -> None:
        """Enter a run of n samples from `start`.

        running : effect -> components on which it ran.
        modes : modes that were stepped.
        seconds : of the processor that its steps took.
        """
        self.samples += n
        for name, components in running.items():
            if components:
                self.running[name] += n
            for component in components:
                self.spans[name, component].add(start, n)
        self.costs.add(seconds, n, modes, [sum(load[c] for c in running[name]) for name, load in self.loads.items()])

    def enter(self, name: str, bounds: Sequence[tuple[str, Bound, bool]]) -> None:
        """Enter bounds of an effect: component, bound, and whether the effect is left out there."""
        for component, bound, left_out in bounds:
            key = name, component
            self.largest[key] = bound.larger(self.largest.get(key, Bound()))
            if left_out:
                self.left_out[key] = bound.larger(self.left_out.get(key, Bound()))

    def forget_times(self) -> None:
        """Keep how long effects ran, and of when only the last interval: for a stream without end."""
        for spans in self.spans.values():
            del spans.all[:-1]

    def seconds(self, samples: int) -> float:
        """Length of some samples, s."""
        return samples / self.fs

    def score_time(self, spans: Spans) -> tuple[tuple[float, float], ...]:
        """(start, stop) of intervals in s of score time, from 0 on."""
        return tuple((max(a / self.fs, 0.0), b / self.fs) for a, b in spans.all if b > 0)

    def saved(self, name: str, component: str) -> float:
        """Seconds of computing that a switched effect would have taken on a component while it was off there.

        The cost of running on any component at all is saved while it runs on none, in shares of the loads.
        """
        rates, loads = self.costs.rates(), self.loads[name]
        off = self.samples - self.spans[name, component].samples
        nowhere = (self.samples - self.running[name]) * rates.running[name] / max(sum(loads.values()), 1)
        return loads[component] * (off * rates.load[name] + nowhere)

    def saved_as_declared(self, cost: float) -> float:
        """Seconds of computing that a declared cost, in steps of one mode per sample, would have taken all the time."""
        return self.samples * cost * self.costs.rates().mode
