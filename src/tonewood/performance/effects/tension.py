"""Rising tension, switched on and off string by string with the string's amplitude.

A string is stepped with its tension at rest, bends included, while two bounds are within their budgets: the rise of
its pitch and the level of the sound that is missing (`effects.tension_bounds`). That is so at each look, at energies
every 1,024 samples and at all every 4,096; a string that others set in motion was 15 % above its budget between two of
them. It is not switched off if its next gesture is so near that the switches would cost more than they save. The next
pluck is foreseen: the static energy of its pull adds to that of the string as amplitudes add, sqrt E <= sqrt E0 +
sqrt(F^2 C / 2), and so do partials.

Leaving a rise out takes its potential EA/(8 L) S^2 away. Coming back, the potential would appear without work: the
string pays it from its kinetic energy (a ten-thousandth of it), and the switch waits while there is too little. The
potential of a coupling to the longitudinal motion may be negative; then leaving it out is paid for.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect, rise_of_tension
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Moment, SwitchedEffect, Switching, Watched, next_multiple
from tonewood.performance.effects.string_energies import StringEnergies
from tonewood.performance.effects.switching import clear_memory
from tonewood.performance.effects.tension_bounds import TensionBounds
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.solve import active_potential
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import State, System

#: points of the control grid between two looks at energies while some tensions rise and others do not, and between
#: two looks at all bounds, after which tensions may be left out
LOOK, SELDOM = 16, 64
#: s, shortest time for which a rise is left out: two switches and the bounds before them cost some 5 ms, a rise saves
#: some 20 ms/s (a steel guitar's string at 48 kHz)
SHORTEST = 0.3
#: least share of the time of all strings, by their modes, for which rises must be likely to be left out: below it,
#: looking costs as much as leaving out saves (`steel_strings`, scores of examples/scores: at an estimate of 0.5 `auto`
#: took 0.97 to 1.05 times as long as `all`, at 0.6 0.90 to 0.98)
LEAST_IDLE_SHARE = 0.55
#: s, longest time for which a rise goes on without another look at its bound
_LONGEST_UNWATCHED = 0.5
#: share of the budget below which a rise is left out; above the whole of it, it comes back
_LEAVE = 0.9
#: 1/s or s, in place of none
_TINY = 1e-300


class TensionEffect(SwitchedEffect):
    """Decides which strings' tensions rise.

    Its components are strings with axial stiffness. A string whose longitudinal motion is coupled is one of them: the
    coupling is switched with its tension.
    """

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        super().__init__(model, effect, plugins)
        system = model.system
        self.budget = model.choice.budget_cents
        kinds = TensionModulation | GeometricStretch
        self._laws = {p.name: p for p in system.potentials if isinstance(p, kinds)}
        stiff = (name for name in plugins if any(isinstance(p, kinds) for p in model.strings[name].potentials))
        self._strings = tuple(self._laws) if self.chosen else tuple(stiff)
        self.bounds = TensionBounds(model, effect, self._laws)
        # a mass that moves at a string, a hammer on its way, may give its energy to the string at the next moment
        laws = self._laws.values()
        self.energies = StringEnergies(system, [(*law.transverse, *_partners(system, law)) for law in laws])
        self._idle_enough = True

    @property
    def watched(self) -> bool:
        """Whether any rise may be left out, and the score gives time for it."""
        return super().watched and self._idle_enough

    def prepare(self, timeline: Timeline) -> None:
        """Decide from the score whether looking for rises to leave out pays; if not, all rise all the time.

        Of live playing nothing is known beforehand: then they are looked for.
        """
        if super().watched and timeline.plays:
            self._idle_enough = self.idle_share(timeline) >= LEAST_IDLE_SHARE

    def idle_share(self, timeline: Timeline) -> float:
        """Estimate the share of time, by modes of strings, in which the rise will be within the budget of cents.

        A pluck makes a rise by the energy that its force stores on the open string, and that falls as the least damped
        mode's energy. Other gestures are taken to need no rise, and the level of sidebands is left out.
        """
        system, end = self.model.system, max(timeline.stop, _TINY)
        whole = idle = 0.0
        plays: dict[str | None, list[Play]] = {}
        for play in timeline.plays:
            plays.setdefault(play.string, []).append(play)
        for name in self.components:
            load = self.load(name)
            whole += load * end
            rate = self.bounds.damping_rate(name, system)
            per_force = self.bounds.rise_under_force(name, system, Fretting(), 1.0)
            free = 0.0  # time from which on the rise is within the budget
            for play in plays.get(name, []):
                idle += load * max(min(play.start, end) - free - SHORTEST, 0.0)
                force = max((abs(piece.c0) for piece in play.gesture.segments), default=0.0)
                over = per_force * force**2 / max(_LEAVE * self.budget, _TINY)
                free = max(free, play.stop) + (math.log(over) / (2 * max(rate, _TINY)) if over > 1.0 else 0.0)
            idle += load * max(end - free - SHORTEST, 0.0)
        return idle / whole if whole else 0.0

    @property
    def components(self) -> tuple[str, ...]:
        """Strings with axial stiffness."""
        return self._strings

    def next_watch(self, sample: int, switching: Switching) -> int:
        """Return the next look.

        Energies tell when a string's tension has to rise. Where all rise already, or none does, they are looked at
        with everything else.
        """
        if switching.pending:
            return next_multiple(sample, 1)
        return next_multiple(sample, LOOK if self._some(switching) else SELDOM)

    def _some(self, switching: Switching) -> bool:
        """Whether some tensions rise and others do not."""
        return 0 < len(switching.on) < len(self.components)

    def watch(self, moment: Moment, switching: Switching) -> Watched | None:
        """Compare bounds with the budgets: of all strings, of those held otherwise, of those about to be played."""
        on, whole = switching.on, moment.sample % (GRID * SELDOM) == 0
        look = whole or (self._some(switching) and moment.sample % (GRID * LOOK) == 0)
        moved = [name for name in moment.moved if name in self.components]
        fresh = [play for play in moment.fresh if play.string in self.components]
        if not (look or moved or fresh or switching.pending):
            return None
        names = on | switching.pending
        until = {name: sample for name, sample in switching.until.items() if sample > moment.sample}
        staying = {
            name for name in names if not whole or name in moment.busy or name in until or moment.until(name) < SHORTEST
        }
        if len(staying) == len(self.components) and not (fresh or switching.pending):
            return None  # all rise, and none is to be switched off
        energies = self.energies.at(moment.system, moment.state)
        rises = energies * self.bounds.cents_per_joule(moment.system)
        cents = dict(zip(self.components, rises.tolist(), strict=True))
        seen: list[tuple[str, Bound, bool]] = []
        if look or moved:
            others = {name: value for name, value in cents.items() if name not in staying}
            asked = [name for name in others if whole or (name in moved and name not in names)]
            bounds = self.bounds.of_motion(moment, others, asked)
            unasked = (on | switching.pending) - set(asked)
            names = self.wanted(bounds, names) | staying | unasked
            until |= {name: self.next_bound(name, moment, bound) for name, bound in bounds.items() if name in names}
            seen += [(name, bound, name not in names) for name, bound in bounds.items()]
        for play in fresh:
            name = play.string or ""
            # a string that rises goes on: how loud it would be without is not asked for
            bound = self.bounds.foreseen(play, moment, float(energies[self.components.index(name)]), name not in names)
            if bound.cents > self.budget or bound.level > self.budget_level:
                names |= {name}
            seen.append((name, bound, name not in names))
        return Watched(names, seen, until)

    def apply(self, system: System, on: Collection[str], frettings: Mapping[str, Fretting]) -> System:
        """Switch the tensions of these strings on, and all others off."""
        return system.with_potentials([name for name in self._laws if name in on], self._laws)

    def cost(self, moment: Moment, component: str, on: bool) -> float:
        """Potential of a string's rising tension, J, with the sign of the switch; see the module."""
        return (1.0 if on else -1.0) * potential(moment.system, moment.state, component)

    def payers(self, component: str) -> Sequence[str]:
        """Transverse components of the string."""
        return self._laws[component].transverse

    def reset(self, system: System, state: State, changed: Collection[str]) -> None:
        """Forget the additional tensions of the last steps."""
        clear_memory(system, state, changed)

    def load(self, component: str) -> float:
        """Modes of the open string."""
        system = self.model.system
        return sum(system.compiled[system.slot(c)].basis.n_modes for c in self.model.strings[component].components)

    def why(self, usage: EffectUsage, component: str) -> str:
        """By how much the tension rises, against the budget."""
        if self.model.choice.mode != "auto":
            return super().why(usage, component)
        if not self._idle_enough:
            return "the score leaves hardly any time in which it could be left out"
        bound = usage.largest.get((self.name, component), Bound())
        rises = f"its tension rises by up to {bound.cents:.2g} cents" if bound.cents < 1e9 else "a gesture moves it"
        return f"{rises}; the budget is {self.model.choice.budget_cents:g}"

    @property
    def budget_level(self) -> float:
        """Ratio to the loudest sample of the sound that may be missing at the outputs."""
        return self.share * 10 ** (self.model.choice.budget_db / 20)

    def wanted(self, bounds: Mapping[str, Bound], on: Collection[str]) -> frozenset[str]:
        """Strings whose tension is to rise: those beyond a budget, or beyond 0.9 of it if they rise now.

        bounds : string -> bound without its rise.
        on : those that rise now.
        """

        def beyond(bound: Bound, share: float) -> bool:
            return bound.cents > share * self.budget or bound.level > share * self.budget_level

        return frozenset(name for name, bound in bounds.items() if beyond(bound, _LEAVE if name in on else 1.0))

    def next_bound(self, name: str, moment: Moment, bound: Bound) -> int:
        """Sample before which a bound is not worth another look: half the time in which it may fall to the budget.

        The rise follows the string's energy, and the sidebands its power 3/2; energy falls as exp(-2 s t), s the least
        damping rate of its modes. Where it falls faster, the tension rises for longer than it has to.
        """
        level = bound.level / self.budget_level if bound.level < math.inf else 0.0
        over = max(bound.cents / self.budget, level ** (2 / 3), 1.0) if self.budget > 0.0 else math.inf
        rate = self.bounds.damping_rate(name, moment.system)
        seconds = min(math.log(over) / (4.0 * max(rate, _TINY)), _LONGEST_UNWATCHED)
        return moment.sample + int(seconds / moment.system.dt)


def _partners(system: System, law: TensionModulation | GeometricStretch) -> list[str]:
    """Components that touch a string: hammers, fingers, rings."""
    there = [n for n in system.names if system.layout.owners.get(n) == law.name and n not in law.components]
    return [n for n in there if system.compiled[system.slot(n)].basis.is_real]


def potential(system: System, state: State, name: str) -> float:
    """Energy that a string's rising tension stores besides its modes when it is on, J.

    Without longitudinal motion psi^2 / 2, which is EA/(8 L) S^2 where it was off; with it, the energy of the coupling,
    which may be negative.
    """
    active = active_potential(system, system.potentials.index(name))
    x = {slot: np.asarray(system.modes_of(state, system.names[slot]).T, dtype=np.float64) for slot in active.slots}
    memory = state.potentials if state.potentials.size else system.start().potentials
    return active.joined.stored(active.y(x), memory[active.memory])


#: rising tension of a string; for plugins whose strings have it
TENSION_MODULATION = Effect(
    "tension_modulation", "tension that rises with amplitude: glides, turning planes", "detuning",
    "a gesture's force bends the string so far that its tension would rise by more than the budget; every gesture that "
    "moves a mass, a bow or a finger",
    "the string's energy, which bounds the mean rise of its tension; its partials, which bound the sidebands",
    bound=rise_of_tension, cost=lambda n: 8.0 * n, title="rising tension",
    runtime=TensionEffect,
)  # fmt: skip
