"""Rising tension, switched on and off string by string with the string's amplitude.

A string is stepped with its tension at rest, bends included, while two bounds are within their budgets: the rise of
its pitch, which follows from its energy (`instrument.contract.effects.rise_of_tension`), and the sidebands that the
beating tension would give to its partials (`effects.sidebands`). That is so at each look, at energies every 1,024
samples and at all every 4,096; a string that others set in motion was 15 % above its budget between two of them. It is
not switched off if its next gesture is so near that the switches would cost more than they save. The next pluck is
foreseen: the static energy of its pull adds to that of the string as amplitudes add, sqrt E <= sqrt E0 + sqrt(F^2 C /
2), and so do partials. The phantom partials (`effects.phantoms`) of a string whose longitudinal motion is coupled
count with its sidebands.

Leaving a rise out takes its potential EA/(8 L) S^2 away. Coming back, the potential would appear without work: the
string pays it from its kinetic energy (a ten-thousandth of it), and the switch waits while there is too little. The
potential of a coupling to the longitudinal motion may be negative; then leaving it out is paid for.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, zip_longest
from typing import Any, cast

import numpy as np

from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect, Norms, rise_of_tension
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Moment, SwitchedEffect, Switching, Watched, next_multiple
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.phantoms import Phantoms
from tonewood.performance.effects.sidebands import Sidebands
from tonewood.performance.effects.switching import clear_memory, motion
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.gestures import places
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.solve import active_potential
from tonewood.physics.coupling.potentials.tension import TensionModulation, stretch_weights
from tonewood.physics.coupling.system import Compiled, State, System
from tonewood.physics.stepping.forcing import Segment
from tonewood.physics.stepping.motion import to_motion
from tonewood.support.arrays import Floats

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
#: a string held aside stretches by 2 E / T, twice as much as one that vibrates, and 1.5 of that are in the bound
_DRAWN = 4 / 3
#: strings as they are held whose sidebands and phantom partials are kept
_KEPT = 128
#: re full scale, the loudest sample before there is any
_SILENT = 1e-150
#: 1/N, of a string without modes
_TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Forms:
    """Energy of a component's modes (x, y) as a quadratic form, sum xx x^2 + xy x y + yy y^2 (J)."""

    xx: Floats
    xy: Floats
    yy: Floats

    @classmethod
    def of(cls, compiled: Compiled) -> Forms:
        """Make them of a component of real modes."""
        basis = compiled.basis
        one, none = np.ones(basis.n_modes), np.zeros(basis.n_modes)
        (qx, vx), (qy, vy) = (to_motion(basis, np.stack(unit)) for unit in ((one, none), (none, one)))
        k = basis.stiffness
        return cls(0.5 * (vx**2 + k * qx**2), vx * vy + k * qx * qy, 0.5 * (vy**2 + k * qy**2))


class TensionEffect(SwitchedEffect):
    """Decides which strings' tensions rise.

    Its components are strings with axial stiffness. A string whose longitudinal motion is coupled is one of them: the
    coupling is switched with its tension.
    """

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        super().__init__(model, effect, plugins)
        system = model.system
        self.budget = model.choice.budget_cents
        laws = [p for p in system.potentials if isinstance(p, TensionModulation | GeometricStretch)]
        self._laws = {t.name: t for t in laws}
        kinds = TensionModulation | GeometricStretch
        stiff = (name for name in plugins if any(isinstance(p, kinds) for p in model.strings[name].potentials))
        self._strings = tuple(self._laws) if self.chosen else tuple(stiff)
        #: strings whose longitudinal motion is coupled
        self.longitudinal = {g.name: g for g in laws if isinstance(g, GeometricStretch)}
        # a mass that moves at a string, a hammer on its way, may give its energy to the string at the next moment
        parts = [(i, c) for i, t in enumerate(laws) for c in (*t.transverse, *_partners(system, t))]
        self._slots = [system.slot(c) for _, c in parts]
        self._owner = np.array([i for i, _ in parts], dtype=np.intp)
        self._planes = {t.name: [system.slot(c) for c in t.transverse] for t in laws}
        # computed once: tension and length, responses, bounds of strings as they are held
        self._held: dict[str, tuple[tuple[Compiled, ...], float, float]] = {}
        self._response: BridgeResponse | None = None
        self._phantoms: dict[tuple[str, Fretting], Phantoms] = {}
        self._sidebands: dict[tuple[str, Fretting], Sidebands] = {}
        # the forms of all components in one array, in the order of `_slots`, each with its room in the state
        self._places = np.concatenate(
            [np.zeros(0, dtype=np.intp)]
            + [np.arange(system.capacities[s]) + system.offsets[s] for s in self._slots]
        )  # fmt: skip
        sizes = [system.capacities[s] for s in self._slots]
        self._starts = np.cumsum([0, *sizes[:-1]]).astype(np.intp)
        self._forms = np.zeros((3, len(self._places)))
        self._formed: list[Compiled | None] = [None] * len(self._slots)
        # the modes that they describe, and the rise of its strings per joule, cents: `Effect.bound` is proportional
        self._compiled: Sequence[Compiled] = ()
        self._rising: list[tuple[Compiled, ...]] = [()] * len(self.components)
        self._per_joule = np.zeros(len(self.components))
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
        self._follow(system)
        whole = idle = 0.0
        plays: dict[str | None, list[Play]] = {}
        for play in timeline.plays:
            plays.setdefault(play.string, []).append(play)
        for name, per_joule in zip(self.components, self._per_joule, strict=True):
            load = self.load(name)
            whole += load * end
            rate = min(float(system.compiled[slot].basis.damping_rate.min()) for slot in self._planes[name])
            per_force = _DRAWN * per_joule * 0.5 * self.compliance(name, system, Fretting())
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
        wanted = on | switching.pending
        until = {name: sample for name, sample in switching.until.items() if sample > moment.sample}
        staying = {
            name
            for name in wanted
            if not whole or name in moment.busy or name in until or moment.until(name) < SHORTEST
        }
        if len(staying) == len(self.components) and not (fresh or switching.pending):
            return None  # all rise, and none is to be switched off
        energies = self.energies(moment.system, moment.state)
        cents = dict(zip(self.components, (energies * self._per_joule).tolist(), strict=True))
        seen: list[tuple[str, Bound, bool]] = []
        if look or moved:
            others = {name: value for name, value in cents.items() if name not in staying}
            asked = [name for name in others if whole or (name in moved and name not in wanted)]
            bounds = self.bounds(moment, others, asked)
            unasked = (on | switching.pending) - set(asked)
            wanted = self.wanted(bounds, wanted) | staying | unasked
            until |= {name: self.next_bound(name, moment, bound) for name, bound in bounds.items() if name in wanted}
            seen += [(name, bound, name not in wanted) for name, bound in bounds.items()]
        for play in fresh:
            name = play.string or ""
            # a string that rises goes on: how loud it would be without is not asked for
            bound = self.foreseen(play, moment, float(energies[self.components.index(name)]), name not in wanted)
            if bound.cents > self.budget or bound.level > self.budget_level:
                wanted |= {name}
            seen.append((name, bound, name not in wanted))
        return Watched(wanted, seen, until)

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

    def energies(self, system: System, state: State) -> Floats:
        """(n_strings,) J, energy of each string's modes, and of the masses that move at it."""
        if system.compiled is not self._compiled:
            self._follow(system)
        x, y = state.modes[:, self._places]
        xx, xy, yy = self._forms
        each = np.add.reduceat((xx * x + xy * y) * x + yy * y * y, self._starts)
        return np.asarray(np.bincount(self._owner, each, len(self.components)), dtype=np.float64)

    def _follow(self, system: System) -> None:
        """Keep up with a system that is stepped from now on: energies of its modes, and cents per joule."""
        for i, slot in enumerate(self._slots):
            compiled = system.compiled[slot]
            if self._formed[i] is not compiled:
                start, n = self._starts[i], compiled.basis.n_modes
                forms = Forms.of(compiled)
                self._forms[:, start : start + system.capacities[slot]] = 0.0
                self._forms[:, start : start + n] = forms.xx, forms.xy, forms.yy
                self._formed[i] = compiled
        for i, name in enumerate(self.components):
            planes = tuple(system.compiled[slot] for slot in self._planes[name])
            if any(a is not b for a, b in zip_longest(self._rising[i], planes)):
                self._rising[i], self._per_joule[i] = planes, self.rise(name, system, 1.0)
        self._compiled = system.compiled

    @property
    def budget_level(self) -> float:
        """Ratio to the loudest sample of the sound that may be missing at the outputs."""
        return self.share * 10 ** (self.model.choice.budget_db / 20)

    def bounds(self, moment: Moment, cents: Mapping[str, float], names: Collection[str]) -> dict[str, Bound]:
        """Bound on the error of leaving out strings' rise: cents, and levels of `names`.

        The strings with the least level share the budget: a string's level is the sum of its own and of all lower
        ones. A string beyond the budget of cents is not looked at further, its level is infinite.

        cents : string -> mean rise of its pitch.
        """
        system, state, peak = moment.system, moment.state, np.maximum(moment.peak, _SILENT)
        cents = dict(cents)
        alone: dict[str, float] = {}
        for name in names:
            if cents[name] > self.budget or cents[name] == 0.0:  # beyond the budget, or at rest
                alone[name] = math.inf if cents[name] else 0.0
                continue
            moving = {c: motion(system, state, c) for c in self._laws[name].transverse}
            alone[name] = self.sidebands(name, system, moment.frettings[name]).level(moving, peak)
            if name in self.longitudinal:
                phantoms = self.phantoms(name, system, moment.frettings[name])
                slopes = phantoms.slopes(moving)
                cents[name] += phantoms.cents(slopes)
                alone[name] += phantoms.level(slopes, peak)
        quietest = sorted(alone, key=lambda name: alone[name])
        levels = dict(zip(quietest, accumulate(alone[name] for name in quietest), strict=True))
        return {name: Bound(cents[name], levels.get(name, 0.0)) for name in cents}

    def sidebands(self, name: str, system: System, fretting: Fretting) -> Sidebands:
        """Sidebands of a string as it is held now."""
        # the places where it is touched and plucked change none of them
        key = name, replace(fretting, place=None, touches=())
        if key not in self._sidebands:
            if len(self._sidebands) >= _KEPT:
                del self._sidebands[next(iter(self._sidebands))]
            compiled = {c: system.compiled[system.slot(c)] for c in self._laws[name].transverse}
            tension, length = self._tension_and_length(name, system)
            rise = self._laws[name].axial_stiffness / (4 * length * tension**2)
            self._sidebands[key] = Sidebands.of(compiled, rise, system, self._responses())
        return self._sidebands[key]

    def phantoms(self, name: str, system: System, fretting: Fretting) -> Phantoms:
        """Phantom partials of a string as it is held now."""
        key = name, fretting
        if key not in self._phantoms:
            if len(self._phantoms) >= _KEPT:
                del self._phantoms[next(iter(self._phantoms))]
            law = self.longitudinal[name]
            compiled = {c: system.compiled[system.slot(c)] for c in law.components}
            tension, _ = self._tension_and_length(name, system)
            self._phantoms[key] = Phantoms.of(law, compiled, tension, self._responses())
        return self._phantoms[key]

    def _responses(self) -> BridgeResponse:
        """From strings' ends to outputs; found when first wanted."""
        if self._response is None:
            self._response = BridgeResponse(self.model)
        return self._response

    def rise(self, name: str, system: System, energy: float) -> float:
        """Largest mean rise of a string's tension at an energy (J), in cents of its pitch, as it is stepped now."""
        tension, length = self._tension_and_length(name, system)
        stiffness = self._laws[name].axial_stiffness
        return self.effect.bound(Norms(energy=energy, tension=tension, axial_stiffness=stiffness, length=length))

    def _tension_and_length(self, name: str, system: System) -> tuple[float, float]:
        """Tension (N), bends included, and speaking length (m) of a string as it is stepped.

        The tension is the least that any mode's frequency gives: a tension dT raises the square w^2 of the frequency by
        a dT, and a stiff string has w^2 = T a + EI b.
        """
        law = self._laws[name]
        compiled = tuple(system.compiled[slot] for slot in self._planes[name])
        entry = self._held.get(name)
        if entry is None or any(a is not b for a, b in zip(entry[0], compiled, strict=True)):
            parts = [part.basis for part in compiled]
            per_newton = [cast(Floats, stretch_weights(basis)) / basis.stiffness for basis in parts]
            length = law.length if isinstance(law, TensionModulation) and law.length else parts[0].metadata["length"]
            tension = 1.0 / float(np.max(np.concatenate(per_newton), initial=_TINY))
            self._held[name] = entry = compiled, tension, float(cast(float, length))
        return entry[1], entry[2]

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
        slots = self._planes[name]
        rate = min(float(moment.system.compiled[slot].basis.damping_rate.min()) for slot in slots)
        seconds = min(math.log(over) / (4.0 * max(rate, _TINY)), _LONGEST_UNWATCHED)
        return moment.sample + int(seconds / moment.system.dt)

    def foreseen(self, play: Play, moment: Moment, energy: float, levels: bool = True) -> Bound:
        """Bound after a gesture on a string of `energy` (J); infinite if unknown, or its level if not asked for."""
        gesture, name, system = play.gesture, play.string or "", moment.system
        if gesture.motions or gesture.on is not None or not gesture.segments or name in self.longitudinal:
            return Bound(math.inf, math.inf)  # the phantom partials that a pluck will drive are not known beforehand
        fretting = moment.frettings[name]
        force = max(largest(s) for s in gesture.segments)
        compliance = self.compliance(name, system, fretting)
        foreseen = (math.sqrt(max(energy, 0.0)) + force * math.sqrt(0.5 * compliance)) ** 2
        cents = _DRAWN * self.rise(name, system, foreseen)
        if cents > self.budget or not levels:
            return Bound(cents, math.inf)
        components = self._laws[name].transverse
        plucked = dict.fromkeys(components, np.zeros(0))
        for component, point, factor in places(play, self.model):
            basis = system.compiled[system.slot(component)].basis
            plucked[component] = force * factor * basis.right[basis.index(point)].real / basis.stiffness
        moving = {c: motion(system, moment.state, c) for c in components}
        level = self.sidebands(name, system, fretting).level(moving, np.maximum(moment.peak, _SILENT), plucked)
        return Bound(cents, level)

    def compliance(self, name: str, system: System, fretting: Fretting) -> float:
        """Static compliance of a string between fixed ends where it is plucked, x (L - x) / (T L) in m/N."""
        tension, length = self._tension_and_length(name, system)
        pluck = self.model.strings[name].pluck_from_bridge
        x = min(pluck, 0.9 * length) if fretting.place is None else fretting.place
        return x * (length - x) / (tension * length)


def _partners(system: System, law: TensionModulation | GeometricStretch) -> list[str]:
    """Components that touch a string: hammers, fingers, rings."""
    there = [n for n in system.names if system.owners.get(n) == law.name and n not in law.components]
    return [n for n in there if system.compiled[system.slot(n)].basis.is_real]


def potential(system: System, state: State, name: str) -> float:
    """Energy that a string's rising tension stores besides its modes when it is on, J.

    Without longitudinal motion psi^2 / 2, which is EA/(8 L) S^2 where it was off; with it, the energy of the coupling,
    which may be negative.
    """
    active = active_potential(system, system.potential(name))
    x = {slot: np.asarray(system.modes_of(state, system.names[slot]).T, dtype=np.float64) for slot in active.slots}
    memory = state.potentials if state.potentials.size else system.start().potentials
    return active.joined.stored(active.y(x), memory[active.memory])


def largest(piece: Segment) -> float:
    """Largest |F| of a piece of force, N."""
    length = piece.stop - piece.start
    extremum = -piece.c1 / (2 * piece.c2) if piece.c2 else 0.0
    times = np.array([0.0, length, extremum if 0.0 < extremum < length else 0.0])
    return float(np.max(np.abs(piece.c0 + times * (piece.c1 + times * piece.c2))))


#: rising tension of a string; for plugins whose strings have it
TENSION_MODULATION = Effect(
    "tension_modulation", "tension that rises with amplitude: glides, turning planes", "detuning",
    "a gesture's force bends the string so far that its tension would rise by more than the budget; every gesture that "
    "moves a mass, a bow or a finger",
    "the string's energy, which bounds the mean rise of its tension; its partials, which bound the sidebands",
    bound=rise_of_tension, cost=lambda n: 8.0 * n, title="rising tension",
    runtime=TensionEffect,
)  # fmt: skip
