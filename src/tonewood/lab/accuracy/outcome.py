"""Results of a study, error against time: points, which of them are on the front, the time for the same error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from tonewood.support.plain_values import finite

#: method and dial of the line that is called ours
OURS, DIAL = "tonewood", "fs"
#: Hz, the rate at which ours is compared with the others
USUAL_RATE = 48e3


@dataclass(frozen=True, slots=True)
class Point:
    """One method with one value of its dial on one system.

    system, method : names; methods are those of `METHODS`.
    dial, value : parameter varied along the line, and its value here.
    fs : Hz.  n_modes : stepped.
    stable : stable, grows or NaN.
    cents_median, cents_worst, cents_20, decay_median, decay_worst, lost : see `measures.PoleErrors`.
    waveform, spectral_db, spurious_db : see `measures.WaveErrors`.
    energy : drift of the undamped system's energy within 1 s, relative.
    seconds, seconds_low, seconds_high : of computing per second of sound: median, 10th and 90th percentile.
    note : further remarks.
    """

    system: str
    method: str
    dial: str
    value: str
    fs: float
    n_modes: int
    stable: str
    cents_median: float = np.nan
    cents_worst: float = np.nan
    cents_20: float = np.nan
    decay_median: float = np.nan
    decay_worst: float = np.nan
    lost: int = 0
    waveform: float = np.nan
    spectral_db: float = np.nan
    spurious_db: float = np.nan
    energy: float = np.nan
    seconds: float = np.nan
    seconds_low: float = np.nan
    seconds_high: float = np.nan
    note: str = ""

    def to_dict(self) -> dict[str, object]:
        """Fields for JSON; unknown ones are None."""
        return {key: finite(value) for key, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class Measure:
    """One kind of error.

    name : short.  title : with its unit, for an axis.
    of : point -> error, nan where it is not known.
    """

    name: str
    title: str
    of: Callable[[Point], float]


def _of_all(name: str) -> Callable[[Point], float]:
    """Error of partials; a method that has lost some of them has no error to speak of."""
    return lambda p: float(getattr(p, name)) if not p.lost else np.nan


PITCH = Measure("pitch", "worst pitch error of the partials, cents", _of_all("cents_worst"))
DECAY = Measure("decay", "worst error of the partials' decay rates, relative", _of_all("decay_worst"))
WAVEFORM = Measure("waveform", "error of the waveform, relative", lambda p: p.waveform)
MEASURES: Mapping[str, Measure] = {m.name: m for m in (PITCH, DECAY, WAVEFORM)}


def line(points: Sequence[Point], method: str, measure: Measure) -> list[tuple[float, float]]:
    """(seconds, error) of a method's stable points along its own dial, cheapest first."""
    pairs = [
        (p.seconds, measure.of(p)) for p in points if p.method == method and p.dial == DIAL and p.stable == "stable"
    ]
    return sorted((s, e) for s, e in pairs if np.isfinite(s) and np.isfinite(e) and s > 0)


def front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points of a line that no cheaper point betters: times rise, errors fall."""
    out: list[tuple[float, float]] = []
    for seconds, error in sorted(points):
        if not out or error < out[-1][1]:
            out.append((seconds, error))
    return out


def seconds_at(points: Sequence[tuple[float, float]], error: float) -> float | None:
    """Seconds at which a Pareto line reaches an error, None where it never does.

    Between two points log time is linear in log error; a method whose cheapest point is better still costs that point.
    """
    best = front(points)
    if not best or error < best[-1][1]:
        return None
    if error >= best[0][1]:
        return best[0][0]
    for (s0, e0), (s1, e1) in pairwise(best):
        if e1 <= error:
            if e1 <= 0:
                return s1
            share = np.log(e0 / error) / np.log(e0 / e1)
            return float(np.exp(np.log(s0) + share * np.log(s1 / s0)))
    return None


@dataclass(frozen=True, slots=True)
class Headline:
    """One method against ours on one system by one measure.

    method, measure : names.
    error : of ours at 48 kHz.
    ratio : time of the method at that error / time of ours; None: not reached.
    best : smallest error of the method; None where no point of it is stable, or all of them have lost partials.
    ratio_at_best : time of the method at its smallest error / time of ours at the same error; None where ours does not
        reach it.
    stable : whether any point of the method is.
    """

    method: str
    measure: str
    error: float
    ratio: float | None
    best: float | None
    ratio_at_best: float | None
    stable: bool = True

    @property
    def text(self) -> str:
        """For a table."""
        if self.best is None:
            return "partials lost" if self.stable else "not stable"
        return "not reached" if self.ratio is None else f"{self.ratio:.3g}"


def usual(points: Sequence[Point], measure: Measure) -> Point | None:
    """Our point at 48 kHz; in a study far from audio rates the middle one."""
    ours = [
        p
        for p in points
        if p.method == OURS and p.dial == DIAL and np.isfinite(p.seconds) and np.isfinite(measure.of(p))
    ]
    nearest = min(ours, key=lambda p: abs(np.log(p.fs / USUAL_RATE)), default=None)
    if nearest is None or nearest.fs > USUAL_RATE / 2:
        return nearest
    return sorted(ours, key=lambda p: p.fs)[len(ours) // 2]


def headlines(points: Sequence[Point], measure: Measure) -> list[Headline]:
    """Every other method of the points against ours, in the order of the points."""
    ours = usual(points, measure)
    if ours is None:
        return []
    error, our_line = measure.of(ours), line(points, OURS, measure)
    out = []
    for method in dict.fromkeys(p.method for p in points if p.method != OURS and p.dial == DIAL):
        theirs = front(line(points, method, measure))
        reached = seconds_at(theirs, error)
        at_best = seconds_at(our_line, theirs[-1][1]) if theirs else None
        out.append(
            Headline(
                method,
                measure.name,
                error,
                None if reached is None else reached / ours.seconds,
                theirs[-1][1] if theirs else None,
                None if at_best is None else theirs[-1][0] / at_best,
                any(p.stable == "stable" for p in points if p.method == method),
            )
        )
    return out


@dataclass(frozen=True, eq=False)
class Outcome:
    """All points of one system.

    name, title : of the system.
    truth : where its reference comes from.
    measures : by which the methods are compared, the first one on the chart.
    points : in the order they were made.
    """

    name: str
    title: str
    truth: str
    measures: tuple[Measure, ...]
    points: tuple[Point, ...]

    @cached_property
    def headlines(self) -> Mapping[str, Sequence[Headline]]:
        """By measure."""
        return {m.name: headlines(self.points, m) for m in self.measures}
