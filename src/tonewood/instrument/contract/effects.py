"""Effects: parts of the physics that a render may leave out, declared by the plugin that adds them, with error bounds.

An *additive* effect adds sound: its bound is the largest sample it can add, in dB re the loudest one. A *detuning*
effect moves partials: its bound is in cents. The two budgets, ``budget_db`` and ``budget_cents``, are compared with
their own bounds only. An effect may be left out while its bound is within its budget. The bound is computed from the
motion while the effect is left out, and from the score for the gesture that is about to begin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

#: cents per relative change of frequency
_CENTS = 1200.0 / math.log(2.0)


@dataclass(frozen=True, slots=True)
class Norms:
    """Upper bounds on the motion that an effect acts on; foreseen from the score or computed from the motion.

    Attributes
    ----------
    level : amplitude at the outputs of the sound left out, ratio to the loudest sample.
    energy : J, of the string.
    tension, axial_stiffness : N, of the string.
    length : m, speaking.
    """

    level: float = 0.0
    energy: float = 0.0
    tension: float = 1.0
    axial_stiffness: float = 0.0
    length: float = 1.0


def level_db(norms: Norms) -> float:
    """Level of the sound left out, in dB re the loudest sample."""
    return 20 * math.log10(norms.level) if norms.level > 0 else -math.inf


def rise_of_tension(norms: Norms) -> float:
    """Upper bound on the rise of pitch of a string of energy E by its stretch, cents, mean over a period.

    With the mean S = int u_x^2 dx = E / T (half of the energy is potential), dT = EA S / (2 L) and df/f = dT / 2T;
    half as much again for a partial's own share, whose tension pulls in phase with it.
    """
    rise = norms.axial_stiffness * norms.energy / (2 * norms.length * norms.tension)
    return 1.5 * _CENTS * rise / (2 * norms.tension)


def nothing(n: int) -> float:
    """Cost of an effect that takes no steps of its own: 0."""
    return 0.0


def modes(n: int) -> float:
    """Cost of stepping n modes: n."""
    return float(n)


@dataclass(frozen=True, slots=True)
class Effect:
    """Declaration of something that may be left out.

    Attributes
    ----------
    name : the word for it in ``effects: [names]``.
    adds : the sound or motion that it adds, one line.
    kind : ``additive`` or ``detuning``.
    before : when the score calls for it, one line.
    during : the quantity watched while it is left out, one line.
    bound : largest error of leaving it out: dB re the loudest sample, or cents.
    cost : time per sample, in units of one mode stepped linearly; given the number of modes or of points.
    basic : whether it belongs to the plain instrument, which ``none`` and lists of names do not reduce.
    title : in words, for summaries; the name if empty.
    runtime : makes of (model, effect, component -> plugin) the object that the engine steps, counts and reports: a
        `RuntimeEffect`, or a `SwitchedEffect` that is switched on and off while the engine steps; see
        `tonewood.performance.effects.base`. None for effects that always run, and for contacts.
    """

    name: str
    adds: str
    kind: Literal["additive", "detuning"]
    before: str
    during: str
    bound: Callable[[Norms], float] = level_db
    cost: Callable[[int], float] = modes
    basic: bool = False
    title: str = ""
    runtime: Callable[..., Any] | None = None

    @property
    def unit(self) -> str:
        """Unit of the bound."""
        return "dB" if self.kind == "additive" else "cents"


def _second_planes(*arguments: Any) -> Any:
    """Make the effect of second planes, whose class stands above this module."""
    return import_module("tonewood.performance.effects.unswitched").SecondPolarizationEffect(*arguments)


SECOND_POLARIZATION = Effect(
    "second_polarization", "motion across the first plane: two decays in one sound", "additive",
    "always, where a string has two planes", "nothing: it is stepped or not from the beginning",
    runtime=_second_planes,
)  # fmt: skip
BODY_MODES = Effect(
    "body_modes", "resonances of the body", "additive", "always", "nothing: all are stepped", basic=True
)
OUTPUTS = Effect(
    "outputs", "pickups and microphones", "additive", "somebody records them: only outputs asked for are made",
    "nothing", basic=True,
)  # fmt: skip


def contact_effect(name: str, adds: str, *, basic: bool = False) -> Effect:
    """Return the effect of a contact, left out while a bound on the motion excludes touch: nothing is lost by that.

    Parameters
    ----------
    name : the word for it in ``effects: [names]``.
    adds : the contact in words, one line.
    basic : whether it belongs to the plain instrument.
    """
    return Effect(
        name, adds, "additive", "always watched", "a bound on the string's motion at each point until the next look",
        cost=lambda n: 0.5 * n, basic=basic,
    )  # fmt: skip
