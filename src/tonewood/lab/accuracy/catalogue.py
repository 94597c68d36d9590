"""Every system of the study by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy.linear_cases import Case, a2_case, fabre_case, guitar_case, harp_case
from tonewood.lab.accuracy.nonlinear_cases import (
    NonlinearCase,
    hard_obstacle_case,
    klosner_case,
    obstacle_case,
    tension_case,
)


@dataclass(frozen=True)
class Entry:
    """A case of the study.

    make : the case.
    quick : that of a quick run, if it is another; None: left out of a quick run over all.
    weight : how long it takes, beside the others.
    """

    make: Callable[[], Case | NonlinearCase]
    quick: Callable[[], Case | NonlinearCase] | None
    weight: float = 1.0

    @classmethod
    def of(cls, make: Callable[[], Case | NonlinearCase], weight: float = 1.0) -> Entry:
        """Of one that a quick run takes as it is."""
        return cls(make, make, weight)


#: by name; all strings of the guitar sound in a quick run, but the poles of two are sought
CASES = {
    "fabre_guitar": Entry.of(fabre_case),
    "harp": Entry.of(harp_case),
    "harp_proportional": Entry(partial(harp_case, "proportional"), None),
    "harp_block": Entry(partial(harp_case, "block"), None),
    "a2_on_16_modes": Entry.of(a2_case),
    "classical_guitar": Entry(guitar_case, partial(guitar_case, strings=("E2", "E4")), 3.0),
    "tension": Entry.of(tension_case, 0.5),
    "obstacle": Entry.of(obstacle_case, 0.5),
    "hard_obstacle": Entry.of(hard_obstacle_case, 0.3),
    "klosner_d": Entry.of(klosner_case, 0.3),
}


def selected(name: str | None, *, quick: bool = False) -> list[str]:
    """Names of the systems to run. Raises TonewoodError : there is no such system."""
    if name is None:
        return [n for n, entry in CASES.items() if entry.quick is not None or not quick]
    if name not in CASES:
        raise TonewoodError(f"is {name!r}; there are {', '.join(CASES)}", key="--system")
    return [name]
