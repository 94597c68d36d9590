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


SECOND_POLARIZATION = Effect(
    "second_polarization", "motion across the first plane: two decays in one sound", "additive",
    "always, where a string has two planes", "nothing: it is stepped or not from the beginning",
)  # fmt: skip
#: rising tension of a string; for plugins whose strings have it
TENSION_MODULATION = Effect(
    "tension_modulation", "tension that rises with amplitude: glides, turning planes", "detuning",
    "a gesture's force bends the string so far that its tension would rise by more than the budget; every gesture that "
    "moves a mass, a bow or a finger",
    "the string's energy, which bounds the mean rise of its tension; its partials, which bound the sidebands",
    bound=rise_of_tension, cost=lambda n: 8.0 * n, title="rising tension",
)  # fmt: skip
#: longitudinal motion of a string; for plugins whose strings have it
LONGITUDINAL = Effect(
    "longitudinal", "motion along the string: partials at sums of transverse ones", "additive",
    "any gesture on the string", "a bound on the phantom partials that the string's partials would "
    "drive; without them it is linear", cost=lambda n: 60.0 * n, title="phantom partials",
)  # fmt: skip
#: motion along a string that the transverse one drives one way; for plugins whose strings have it
PHANTOM_PARTIALS = Effect(
    "phantom_partials", "motion along the string, driven one way: partials at sums of transverse ones", "additive",
    "any gesture on the string", "a bound on the phantom partials that the string's partials would drive",
    cost=lambda n: 2.0 * n, title="phantom partials",
)  # fmt: skip
#: a finger that quiets the string while it draws it; for exciters whose gestures have a `ta.Hold`
DAMPERS = Effect(
    "dampers", "fingers that quiet a string while they draw it", "additive", "from touch to release of each pluck",
    "nothing: no finger is on the string otherwise", cost=nothing,
)  # fmt: skip
#: noises of a hand between notes; for exciters that `playing.noises` names
FRETTING_NOISE = Effect(
    "fretting_noise", "fingers that press a string to a stop, or leave it", "additive",
    "a note's stop is another one than before", "nothing: no finger moves otherwise",
)  # fmt: skip
TOUCH_NOISE = Effect(
    "touch_noise", "fingers that fall on a string to end a note", "additive", "each note that is damped",
    "nothing: no finger moves otherwise",
)  # fmt: skip
SQUEAK = Effect(
    "squeak", "fingers that rub the windings of a string as the hand slides", "additive",
    "a note's stop lies far from the last one on a wound string", "nothing: no finger moves otherwise",
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
