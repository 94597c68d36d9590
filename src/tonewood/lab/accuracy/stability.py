"""Which methods stay stable where: modes x pluck force x sampling rate, each let go from a pluck and watched.

A run is *stable* if its energy, or its measure of it, never exceeds `GROWTH` times that of the pluck; it *grows* if
it does, and it ends as *NaN* if a number is no longer finite. Undamped and lightly damped systems only: no loss hides
the energy that a method adds. In a linear system the pluck's force is but a scale; it matters where it raises a
string's tension.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product

import numpy as np

from tonewood.lab.accuracy import attacks
from tonewood.lab.accuracy.attacks import Attack, section
from tonewood.lab.accuracy.linear_cases import a2_case
from tonewood.lab.accuracy.nonlinear_cases import STEEL, plucked_steel
from tonewood.lab.accuracy.runs import Scene, run_of
from tonewood.lab.accuracy.timing import Tell, silent
from tonewood.lab.methods import METHODS
from tonewood.lab.string_end import ExactString
from tonewood.lab.systems import string_and_body
from tonewood.lab.tables import markdown
from tonewood.support.plain_values import finite

HEAD = """\
# Can it become unstable?

For readers who ask whether a render can become unstable. No scene that was tried creates energy, at any rate, stiffness
or mass. The first table lists the hardest scenes. Below it, methods of the literature step two systems that start from
rest under a static force. [Theory](theory.md) explains why energy cannot grow. Printed by
`tonewood accuracy --stability --report FILE.md`.

## Attacks"""

STABLE, GROWS, NAN = "stable", "grows", "NaN"
#: energy beyond that of the pluck, as a factor; explicit methods vary by some tens of per cent while they are stable
GROWTH = 2.0
#: looks at the energy per run
_LOOKS = 16

LINEAR = "string on 16 modes"
TENSION = "string of rising tension on 16 modes"

#: methods that step each system, by their names
LINEAR_METHODS = ("held_position", "ab3", "verlet", "p1", "p0", "held_velocity", "linear_position")
TENSION_METHODS = ("tonewood", "verlet")


@dataclass(frozen=True, slots=True)
class Cell:
    """One run.

    system, method : names.
    n_modes : of the string.  force : N.  fs : Hz.
    verdict : stable, grows or NaN.
    growth : largest energy seen, as a factor of that of the pluck; infinite if it was not finite.
    """

    system: str
    method: str
    n_modes: int
    force: float
    fs: float
    verdict: str
    growth: float


@dataclass(frozen=True, slots=True)
class StabilityGrid:
    """All runs, and how long each was in seconds."""

    cells: Sequence[Cell]
    duration: float
    attacks: Sequence[Attack] = ()

    def table(self) -> str:
        """Markdown: one table per system, a row per method, modes and force, a column per sampling rate."""
        text = (
            f"Each run is let go from a pluck and followed for {self.duration:g} s. Stable: the energy never exceeds "
            f"{GROWTH:g} times that of the pluck; NaN: numbers stopped being finite. Stable is not yet accurate: "
            "of modes above half the sampling rate only the energy is right.\n"
        )
        for system in dict.fromkeys(cell.system for cell in self.cells):
            cells = [cell for cell in self.cells if cell.system == system]
            rows: dict[tuple[str, ...], dict[float, str]] = defaultdict(dict)
            for cell in cells:
                rows[METHODS[cell.method].title, str(cell.n_modes), f"{cell.force:g}"][cell.fs] = cell.verdict
            rates = sorted({cell.fs for cell in cells})
            heads = ["method", "string modes", "pluck, N", *(f"{fs / 1e3:g} kHz" for fs in rates)]
            lines = [[*key, *(row.get(fs, "") for fs in rates)] for key, row in rows.items()]
            text += f"\n### {system[0].upper()}{system[1:]}\n\n{markdown(heads, lines)}\n"
        return text

    def markdown(self) -> str:
        """A page of its own."""
        return f"{HEAD}\n\n{section(self.attacks)}\n\n## Methods of the literature\n\n{self.table()}"

    def to_json(self) -> dict[str, object]:
        """Plain data; an infinite growth is null."""
        cells, attacks = ([finite(asdict(one)) for one in results] for results in (self.cells, self.attacks))
        return {"duration_s": self.duration, "growth_limit": GROWTH, "cells": cells, "attacks": attacks}


def run(quick: bool = False, tell: Tell = silent) -> StabilityGrid:
    """Make the whole grid; `tell` hears of the share that is done."""
    duration = 0.05 if quick else 0.25
    makes, cells = [*_linear(quick, duration), *_tension(quick, duration)], []
    for i, make in enumerate(makes):
        cells.append(make())
        tell(0.3 * (i + 1) / len(makes))
    return StabilityGrid(cells, duration, attacks.run(quick=quick, tell=lambda share: tell(0.3 + 0.7 * share)))


def _linear(quick: bool, duration: float) -> Iterator[Callable[[], Cell]]:
    case = a2_case()
    rates = (48e3, 192e3) if quick else (24e3, 48e3, 96e3, 192e3, 384e3, 768e3)
    for n_modes in (48, 228) if quick else (24, 72, 168, 228, 480):
        problem = case.build(_between(string_and_body.A2, n_modes))
        scene = Scene(problem, problem.static(np.array([10.0])))
        for method, fs in product(LINEAR_METHODS, rates):
            yield partial(watched, LINEAR, method, scene, 10.0, fs, duration)


def _tension(quick: bool, duration: float) -> Iterator[Callable[[], Cell]]:
    rates = (48e3, 192e3) if quick else (48e3, 96e3, 192e3, 384e3)
    forces = (0.001, 50.0, 1000.0) if quick else (0.001, 1.0, 10.0, 50.0, 100.0, 1000.0)
    for n_modes in (41, 193) if quick else (21, 62, 143, 193):
        for force in forces:
            scene = plucked_steel(force, _between(STEEL, n_modes))
            for method, fs in product(TENSION_METHODS, rates):
                yield partial(watched, TENSION, method, scene, force, fs, duration)


def _between(string: ExactString, n_modes: int) -> float:
    """A frequency between two partials, Hz; that of the highest mode to keep, which lies above its fixed partial."""
    return 0.5 * (string.held_freq(n_modes) + string.held_freq(n_modes + 1))


def watched(system: str, method: str, scene: Scene, force: float, fs: float, duration: float) -> Cell:
    """Let a scene go under one method and look at its energy."""
    run, growth = run_of(method, scene, fs), 1.0
    run.start()
    first = run.energy()
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_LOOKS):
            finite = run.run(max(round(duration * fs) // _LOOKS, 1))[1]
            now = run.energy() / first if finite else np.inf
            growth = max(growth, float(now)) if np.isfinite(now) else np.inf
            if not np.isfinite(growth):
                break
    verdict = NAN if not np.isfinite(growth) else GROWS if growth > GROWTH else STABLE
    return Cell(system, method, scene.problem.components["string"].n_modes, force, fs, verdict, growth)
