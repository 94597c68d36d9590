"""Which methods stay stable where: modes x pluck force x sampling rate, each let go from a pluck and watched.

A run is *stable* if its energy, or its measure of it, never exceeds `GROWTH` times that of the pluck; it *grows* if
it does, and it ends as *NaN* if a number is no longer finite. Undamped and lightly damped systems only: no loss hides
the energy that a method adds. In a linear system the pluck's force is but a scale; it matters where it raises a
string's tension.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from tonewood.errors import NumericalError
from tonewood.lab.accuracy import attacks
from tonewood.lab.accuracy.attacks import Attack, section
from tonewood.lab.accuracy.cases import a2_case
from tonewood.lab.accuracy.nonlinear import ExplicitRun, NonlinearCase, OwnRun
from tonewood.lab.accuracy.nonlinear_cases import STEEL, tension_case
from tonewood.lab.methods.problem import Problem
from tonewood.lab.methods.scheme import Runner
from tonewood.lab.methods.schemes import build
from tonewood.lab.string_end import ExactString
from tonewood.lab.systems import string_and_body
from tonewood.physics.modal.string_modes import string_basis

HEAD = """\
# Can it become unstable?

No scene tried has made energy, at any rate, stiffness or mass. The table has the hardest ones; below it, methods of the
literature on two systems that are merely let go. Why it is so: [theory](theory.md). Printed by
`tonewood accuracy --stability --report FILE.md`.

## Attacks"""

STABLE, GROWS, NAN = "stable", "grows", "NaN"
#: energy beyond that of the pluck, as a factor; explicit methods vary by some tens of per cent while they are stable
GROWTH = 2.0
#: looks at the energy per run
_LOOKS = 16

LINEAR = "string on 16 modes"
TENSION = "string of rising tension on 16 modes"

#: name in tables -> name of the scheme
LINEAR_METHODS = {
    "ours": "held_position",
    "AB3": "ab3",
    "velocity Verlet": "verlet",
    "P1 force, acceleration level": "p1",
    "P0 force, acceleration level": "p0",
    "velocity level": "held_velocity",
    "linear force, position level": "linear_position",
}
TENSION_METHODS: dict[str, Callable[[NonlinearCase, float], OwnRun | ExplicitRun]] = {
    "ours": OwnRun,
    "velocity Verlet": ExplicitRun,
}


@dataclass(frozen=True, slots=True)
class Cell:
    """One run.

    Attributes
    ----------
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

    def verdicts(self, method: str) -> list[str]:
        """Verdicts of one method."""
        return [cell.verdict for cell in self.cells if cell.method == method]

    def table(self) -> str:
        """Markdown: one table per system, a row per method, modes and force, a column per sampling rate."""
        lines = [
            f"Each run is let go from a pluck and followed for {self.duration:g} s. Stable: the energy never exceeds "
            f"{GROWTH:g} times that of the pluck; NaN: numbers stopped being finite. Stable is not yet accurate: "
            "of modes above half the sampling rate only the energy is right."
        ]
        for system in dict.fromkeys(cell.system for cell in self.cells):
            rows: dict[tuple[str, int, float], dict[float, str]] = defaultdict(dict)
            for cell in self.cells:
                if cell.system == system:
                    rows[cell.method, cell.n_modes, cell.force][cell.fs] = cell.verdict
            rates = sorted({fs for row in rows.values() for fs in row})
            heads = ["method", "string modes", "pluck, N", *(f"{fs / 1e3:g} kHz" for fs in rates)]
            lines += ["", f"### {system[0].upper()}{system[1:]}", "", _row(heads), _row(["---"] * len(heads))]
            for (method, n_modes, force), row in rows.items():
                lines.append(_row([method, str(n_modes), f"{force:g}", *(row.get(fs, "") for fs in rates)]))
        return "\n".join(lines) + "\n"

    def markdown(self) -> str:
        """A page of its own."""
        head = f"{HEAD}\n\n{section(self.attacks)}\n\n## Methods of the literature\n\n"
        return head + self.table()

    def to_json(self) -> dict[str, object]:
        """Plain data; an infinite growth is null."""
        cells = [asdict(cell) | {"growth": cell.growth if np.isfinite(cell.growth) else None} for cell in self.cells]
        attacks = [asdict(a) | {"residual": a.residual if np.isfinite(a.residual) else None} for a in self.attacks]
        return {"duration_s": self.duration, "growth_limit": GROWTH, "cells": cells, "attacks": attacks}


def run(quick: bool = False, tell: Callable[[float], None] | None = None) -> StabilityGrid:
    """Make the whole grid; `tell` hears of the share that is done."""
    duration = 0.05 if quick else 0.25
    makes = [*_linear(quick, duration), *_tension(quick, duration)]
    cells = []
    for i, make in enumerate(makes):
        cells.append(make())
        if tell is not None:
            tell(0.3 * (i + 1) / len(makes))
    made = attacks.run(quick=quick, tell=None if tell is None else lambda share: tell(0.3 + 0.7 * share))
    return StabilityGrid(cells, duration, made)


def _linear(quick: bool, duration: float) -> Iterator[Callable[[], Cell]]:
    case = a2_case()
    rates = (48e3, 192e3) if quick else (24e3, 48e3, 96e3, 192e3, 384e3, 768e3)
    for n_modes in (48, 228) if quick else (24, 72, 168, 228, 480):
        flat = case.build(_between(string_and_body.A2, n_modes))
        for label, scheme in LINEAR_METHODS.items():
            for fs in rates:
                yield partial(linear_cell, flat, label, scheme, 10.0, fs, duration)


def linear_cell(flat: Problem, label: str, scheme: str, force: float, fs: float, duration: float) -> Cell:
    """A linear system under one scheme of `schemes.SCHEMES`."""
    x = flat.static(np.array([force]))
    n_modes = flat.components["string"].n_modes
    runner = Runner(build(scheme, flat, 1 / fs))
    runner.start(x)
    first, growth = flat.energy(x), 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_LOOKS):
            bad = runner.run(max(round(duration * fs) // _LOOKS, 1))[1]
            growth = _larger(growth, flat.energy(runner.x) / first if bad < 0 else np.inf)
    return Cell(LINEAR, label, n_modes, force, fs, _verdict(growth), growth)


def _tension(quick: bool, duration: float) -> Iterator[Callable[[], Cell]]:
    rates = (48e3, 192e3) if quick else (48e3, 96e3, 192e3, 384e3)
    forces = (0.001, 50.0, 1000.0) if quick else (0.001, 1.0, 10.0, 50.0, 100.0, 1000.0)
    for n_modes in (41, 193) if quick else (21, 62, 143, 193):
        for force in forces:
            case = _plucked_steel(n_modes, force)
            for label, make in TENSION_METHODS.items():
                for fs in rates:
                    yield partial(tension_cell, case, label, make, force, fs, duration)


def _plucked_steel(n_modes: int, force: float) -> NonlinearCase:
    case = tension_case()
    string = string_basis(
        STEEL.length, STEEL.tension, STEEL.linear_density, STEEL.bending_stiffness,
        lambda omega, k: np.zeros_like(omega), freq_upper=_between(STEEL, n_modes),
    ).with_places({"pluck": 0.2 * STEEL.length})  # fmt: skip
    problem = replace(case.problem, components={**case.problem.components, "string": string})
    return replace(case, problem=problem, start=lambda flat: flat.static(np.array([force])))


def _between(string: ExactString, n_modes: int) -> float:
    """A frequency between two partials, Hz; that of the highest mode to keep, which lies above its fixed partial."""
    return 0.5 * (string.held_freq(n_modes) + string.held_freq(n_modes + 1))


def tension_cell(
    case: NonlinearCase,
    label: str,
    make: Callable[[NonlinearCase, float], OwnRun | ExplicitRun],
    force: float,
    fs: float,
    duration: float,
) -> Cell:
    """A string whose tension rises."""
    n_modes = case.problem.components["string"].n_modes
    runner = make(case, fs)
    runner.start()
    first, growth = runner.energy(), 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_LOOKS):
            try:
                finite = runner.run(max(round(duration * fs) // _LOOKS, 1))[1]
            except NumericalError:
                finite = False
            growth = _larger(growth, runner.energy() / first if finite else np.inf)
            if not np.isfinite(growth):
                break
    return Cell(TENSION, label, n_modes, force, fs, _verdict(growth), growth)


def _larger(growth: float, now: float) -> float:
    return max(growth, float(now)) if np.isfinite(now) else float("inf")


def _verdict(growth: float) -> str:
    if not np.isfinite(growth):
        return NAN
    return GROWS if growth > GROWTH else STABLE


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
