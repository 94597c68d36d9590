"""Every method, described once: its names, the order it claims, whether it takes real modes only, and how it steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tonewood.lab.methods import loop_arrays
from tonewood.lab.methods.problem import Problem
from tonewood.lab.methods.scheme import Scheme, multipliers
from tonewood.lab.newmark import AVERAGE_ACCELERATION, HHT


@dataclass(frozen=True)
class Method:
    """A linear one- or multi-step method.

    name, title, short : in data; in tables; in cells and on lines.
    order : of the error of a coupled pole as the step shrinks: if the poles approach the true ones as dt^p, so does a
        free motion.
    arrays : (problem, dt in s) -> arrays of its step in the compiled loop; ValueError if modes have to be real.
    real : whether it takes real modes only.
    """

    name: str
    title: str
    short: str
    order: int
    arrays: Callable[[Problem, float], Scheme]
    real: bool = False


def _no_step(problem: Problem, dt: float) -> Scheme:
    raise ValueError("superposition takes no steps")


_ACCELERATION = "acceleration constraint"
_METHODS = (
    Method("tonewood", "tonewood", "tonewood", 4, loop_arrays.held_position),
    Method("held_position", "tonewood's scheme, a sweep per sample", "one sweep", 4, loop_arrays.held_position),
    Method("held_velocity", "held force, velocity constraint", "velocity level", 2, loop_arrays.held_velocity),
    *(
        Method(f"p{p}", f"P{p}, {_ACCELERATION}", f"P{p}", p + 1, partial(loop_arrays.interpolated, degree=p))
        for p in range(3)
    ),
    Method("trapezoidal", f"trapezoidal, {_ACCELERATION}", "trapezoidal", 2, loop_arrays.trapezoidal),
    Method("simpson", f"Simpson, {_ACCELERATION}", "Simpson", 3, loop_arrays.simpson),
    Method(
        "linear_position", "P1 constraint force, position constraint", "P1, position", 4, loop_arrays.linear_position,
    ),
    Method("ab3", "Adams-Bashforth 3, Udwadia-Kalaba", "AB3", 3, loop_arrays.adams_bashforth),
    Method(
        "ab3_paper", "Adams-Bashforth 3 with 150 string modes, as published", "AB3, 150 modes", 3,
        loop_arrays.adams_bashforth,
    ),
    Method("verlet", "velocity Verlet, Udwadia-Kalaba", "Verlet", 2, loop_arrays.verlet, real=True),
    Method(
        "newmark", "Newmark, average acceleration", "Newmark", 2,
        partial(loop_arrays.newmark, method=AVERAGE_ACCELERATION), real=True,
    ),
    Method("hht", "HHT-alpha (-0.3)", "HHT", 2, partial(loop_arrays.newmark, method=HHT), real=True),
    Method("superposition", "superposition of coupled modes", "superposition", 0, _no_step),
)  # fmt: skip
#: every method, by name
METHODS = {m.name: m for m in _METHODS}


def stability_limit(method: Method, problem: Problem, low: float, high: float) -> float:
    """Smallest sampling rate, Hz, between `low` and `high` from which the method is stable, to one part in 10^4.

    Stable: spectral radius not above 1 + 1e-6; a constraint on accelerations leaves double multipliers at 1,
    which rounding spreads by the root of its own size.
    """

    def stable(fs: float) -> bool:
        return float(np.abs(multipliers(method.arrays(problem, 1 / fs))).max()) <= 1 + 1e-6

    if stable(low) or not stable(high):
        raise ValueError(f"{method.name}: no limit of stability between {low:g} and {high:g} Hz")
    while high > low * (1 + 1e-4):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return high
