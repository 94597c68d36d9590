"""Every system of the study by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy.linear_cases import LinearCase, a2_case, fabre_case, guitar_case, harp_case
from tonewood.lab.accuracy.nonlinear_cases import (
    NonlinearCase,
    hard_obstacle_case,
    klosner_case,
    obstacle_case,
    tension_case,
)

Make = Callable[[], LinearCase | NonlinearCase]


@dataclass(frozen=True)
class Entry:
    """A case of the study.

    make : the case.
    quick : that of a quick run; None: left out of a quick run over all.
    weight : how long it takes, beside the others.
    """

    make: Make
    quick: Make | None
    weight: float = 1.0


#: by name; all strings of the guitar sound in a quick run, but the poles of two are sought
CASES = {
    "fabre_guitar": Entry(fabre_case, fabre_case),
    "harp": Entry(harp_case, harp_case),
    "harp_proportional": Entry(partial(harp_case, "proportional"), None),
    "harp_block": Entry(partial(harp_case, "block"), None),
    "a2_on_16_modes": Entry(a2_case, a2_case),
    "classical_guitar": Entry(guitar_case, partial(guitar_case, strings=("E2", "E4")), 3.0),
    "tension": Entry(tension_case, tension_case, 0.5),
    "obstacle": Entry(obstacle_case, obstacle_case, 0.5),
    "hard_obstacle": Entry(hard_obstacle_case, hard_obstacle_case, 0.3),
    "klosner_d": Entry(klosner_case, klosner_case, 0.3),
}


def selected(name: str | None, *, quick: bool = False) -> list[str]:
    """Names of the systems to run. Raises TonewoodError : there is no such system."""
    if name is None:
        return [n for n, entry in CASES.items() if entry.quick is not None or not quick]
    if name not in CASES:
        raise TonewoodError(f"is {name!r}; there are {', '.join(CASES)}", key="--system")
    return [name]
