"""Every system of the study by its name, and a run over some or all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy import linear, nonlinear
from tonewood.lab.accuracy.cases import Case, GuitarCase, a2_case, fabre_case, guitar_case, harp_case
from tonewood.lab.accuracy.nonlinear import NonlinearCase
from tonewood.lab.accuracy.nonlinear_cases import hard_obstacle_case, klosner_case, obstacle_case, tension_case
from tonewood.lab.accuracy.pareto import DECAY, PITCH, WAVEFORM, Headline, Measure, headlines
from tonewood.lab.accuracy.study import Point, Tell, silent

#: name -> maker of the case
SYSTEMS: Mapping[str, Callable[[], Case | NonlinearCase]] = {
    "fabre_guitar": fabre_case,
    "harp": harp_case,
    "harp_proportional": partial(harp_case, "proportional"),
    "harp_block": partial(harp_case, "block"),
    "a2_on_16_modes": a2_case,
    "classical_guitar": guitar_case,
    "tension": tension_case,
    "obstacle": obstacle_case,
    "hard_obstacle": hard_obstacle_case,
    "klosner_d": klosner_case,
}
#: cases that a quick run takes instead: all strings sound, but the poles of two are sought
QUICK: Mapping[str, Callable[[], Case | NonlinearCase]] = {
    "classical_guitar": partial(guitar_case, strings=("E2", "E4")),
}
#: left out of a quick run over all: the other damping cases of the same harp
SLOW_ONLY = ("harp_proportional", "harp_block")
#: about how long each takes beside the others
WEIGHTS = {"classical_guitar": 3.0, "tension": 0.5, "obstacle": 0.5, "hard_obstacle": 0.3, "klosner_d": 0.3}


@dataclass(frozen=True, eq=False)
class Outcome:
    """All points of one system.

    Attributes
    ----------
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


def selected(name: str | None, *, quick: bool = False) -> list[str]:
    """Names of the systems to run.

    Raises
    ------
    TonewoodError : there is no such system.
    """
    if name is None:
        return [n for n in SYSTEMS if not (quick and n in SLOW_ONLY)]
    if name not in SYSTEMS:
        raise TonewoodError(f"is {name!r}; there are {', '.join(SYSTEMS)}", key="--system")
    return [name]


def study(name: str, *, quick: bool = False, tell: Tell = silent) -> Outcome:
    """Every method and every dial on one system."""
    case = (QUICK if quick else SYSTEMS).get(name, SYSTEMS[name])()
    if isinstance(case, NonlinearCase):
        points = nonlinear.study(case, quick=quick, tell=tell)
        measure = PITCH if case.pitch else WAVEFORM
        return Outcome(name, case.title, points[0].note.rpartition("; ")[2], (measure,), tuple(points))
    points = linear.study(case, quick=quick, tell=tell)
    # where there are many strings most methods lose some partials: the chart is of those that all of them have
    measures = (WAVEFORM, PITCH, DECAY) if isinstance(case, GuitarCase) else (PITCH, DECAY, WAVEFORM)
    return Outcome(name, case.title, linear.truth_of(case, points), measures, tuple(points))


def run(name: str | None = None, *, quick: bool = False, tell: Tell = silent) -> Iterator[Outcome]:
    """The systems one after the other, as each is done; `tell` hears of the whole."""
    names = selected(name, quick=quick)
    weights = [WEIGHTS.get(n, 1.0) for n in names]
    done, total = 0.0, sum(weights)
    for n, weight in zip(names, weights, strict=True):
        before = done / total

        def part(share: float, before: float = before, own: float = weight / total) -> None:
            tell(before + own * share)

        yield study(n, quick=quick, tell=part)
        done += weight
