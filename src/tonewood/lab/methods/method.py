"""Every method, described once: its names, the order it claims, whose it is, and how it steps.

`order` is that of the error of a coupled pole as the step shrinks: if the method's poles approach the true ones as
dt^p, so does a free motion. A step is given as arrays of the compiled loop (`loop_arrays`), as a dense matrix
(`matrices`), or as both, which then come from different code and are compared by the tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tonewood.lab.methods import forms, loop_arrays, matrices
from tonewood.lab.methods.problem import Problem, StepMap
from tonewood.lab.methods.scheme import Scheme
from tonewood.lab.newmark import AVERAGE_ACCELERATION, HHT


@dataclass(frozen=True)
class Method:
    """A linear one- or multi-step method.

    name, title, short : in data; in tables; in cells and on lines.
    order : of the coupled poles' error in dt.
    source : who uses it.
    scheme, matrix : (problem, dt in s) -> its step, as arrays of the compiled loop and as a matrix.
    real : whether it takes real modes only.
    """

    name: str
    title: str
    order: int
    source: str
    scheme: Callable[[Problem, float], Scheme] | None = None
    matrix: Callable[[Problem, float], StepMap] | None = None
    real: bool = False
    short: str = ""

    def arrays(self, problem: Problem, dt: float) -> Scheme:
        """One step of length dt, s, for the compiled loop.

        Raises ValueError : the method is not stepped there, or not with such modes (it takes real ones only).
        """
        if self.scheme is None:
            raise ValueError(f"{self.name} has no arrays")
        return self.scheme(problem, dt)

    def step_matrix(self, problem: Problem, dt: float) -> StepMap:
        """The map of one step of length dt, s.

        Raises ValueError : the method is not given as a matrix, or has no place for parts of the problem.
        """
        if self.matrix is None:
            raise ValueError(f"{self.name} has no matrix")
        return self.matrix(problem, dt)


OURS = "this project"
FABRE = "Fabre, Le Carrou & Chomette 2024"
ANTUNES = "Antunes & Debut 2017"
CHINNAKONDA = "updates of Chinnakonda 2007, constraint of this project"


def _ab3(form: Callable[[Problem], forms.Ode]) -> Callable[[Problem, float], StepMap]:
    return lambda problem, dt: matrices.adams_bashforth_3(form(problem), dt)


def _newmark(name: str, title: str, short: str) -> Method:
    rule = AVERAGE_ACCELERATION if name == "newmark" else HHT
    return Method(
        name, title, 2, "structural dynamics", partial(loop_arrays.newmark, method=rule), real=True, short=short
    )


def _interpolated(degree: int, matrix: Callable[[Problem, float], StepMap] | None = None) -> Method:
    name, order = f"P{degree}", (1, 2, 3)[degree]
    scheme = partial(loop_arrays.interpolated, degree=degree)
    return Method(name.lower(), f"{name}, acceleration constraint", order, CHINNAKONDA, scheme, matrix, short=name)


#: every method, by name
METHODS = {
    m.name: m
    for m in (
        Method("tonewood", "tonewood", 4, OURS, loop_arrays.held_position, short="tonewood"),
        Method(
            "held_position", "tonewood's scheme, a sweep per sample", 4, OURS,
            loop_arrays.held_position, matrices.held_position,
        ),
        Method(
            "held_velocity", "held force, velocity constraint", 2, "velocity-level constraint on the exact flow",
            loop_arrays.held_velocity, matrices.held_velocity, short="velocity level",
        ),
        _interpolated(0, matrices.held_acceleration),
        _interpolated(1),
        _interpolated(2),
        Method(
            "trapezoidal", "trapezoidal, acceleration constraint", 2, CHINNAKONDA, loop_arrays.trapezoidal,
            short="trapezoidal",
        ),
        Method("simpson", "Simpson, acceleration constraint", 3, CHINNAKONDA, loop_arrays.simpson, short="Simpson"),
        Method(
            "linear_position", "P1 constraint force, position constraint", 4, "P1 constraint force on the exact flow",
            loop_arrays.linear_position, matrices.linear_position,
        ),
        Method(
            "ab3", "Adams-Bashforth 3, Udwadia-Kalaba", 3, f"{FABRE}, Eq. 26",
            loop_arrays.adams_bashforth, _ab3(forms.general), short="AB3",
        ),
        Method(
            "ab3_paper", "Adams-Bashforth 3 with 150 string modes, as published", 3, f"{FABRE}, Eq. 26",
            loop_arrays.adams_bashforth,
        ),
        Method("ab3_compact", "Adams-Bashforth 3, compact form", 3, f"{FABRE}, Eq. 31", None, _ab3(forms.compact)),
        Method(
            "ab3_real", "Adams-Bashforth 3, real modes", 3, f"{ANTUNES} with the integrator of {FABRE}",
            None, _ab3(forms.real), True,
        ),
        Method(
            "verlet", "velocity Verlet, Udwadia-Kalaba", 2, ANTUNES,
            loop_arrays.verlet, matrices.velocity_verlet, True, short="Verlet",
        ),
        _newmark("newmark", "Newmark, average acceleration", "Newmark"),
        _newmark("hht", "HHT-alpha (-0.3)", "HHT"),
        Method("superposition", "superposition of coupled modes", 0, "exact at any step", short="superposition"),
    )
}  # fmt: skip


def stability_limit(method: Method, problem: Problem, low: float, high: float, tolerance: float = 1e-6) -> float:
    """Smallest sampling rate, Hz, between `low` and `high` from which the method is stable, to one part in 10^4.

    Stable: spectral radius not above 1 + tolerance; a constraint on accelerations leaves double multipliers at 1,
    which rounding spreads by the root of its own size.
    """

    def stable(fs: float) -> bool:
        return method.step_matrix(problem, 1 / fs).spectral_radius() <= 1 + tolerance

    if stable(low) or not stable(high):
        raise ValueError(f"{method.name}: no limit of stability between {low:g} and {high:g} Hz")
    while high > low * (1 + 1e-4):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return high
