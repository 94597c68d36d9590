"""Bounds on the error of leaving a string's rising tension out, in cents and in level.

The rise of the pitch follows from the string's energy (`instrument.contract.effects.rise_of_tension`), the level of the
sidebands that the beating tension would give to its partials from these (`effects.sidebands`). Where the longitudinal
motion of the string is coupled, its phantom partials (`effects.phantoms`) count with the sidebands.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import accumulate, zip_longest
from typing import cast

import numpy as np

from tonewood.instrument.contract.effects import Effect, Norms
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Moment
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.phantoms import Phantoms
from tonewood.performance.effects.sidebands import Sidebands
from tonewood.performance.effects.switching import motion
from tonewood.performance.effects.usage import Bound
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.gestures import places
from tonewood.performance.player.timeline import Play
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.tension import TensionModulation, stretch_weights
from tonewood.physics.coupling.system import Compiled, System
from tonewood.physics.stepping.forcing import Segment
from tonewood.support.arrays import Floats

#: a string held aside stretches by 2 E / T, twice as much as one that vibrates, and 1.5 of that are in the bound
_DRAWN = 4 / 3
#: strings as they are held whose sidebands and phantom partials are kept
_KEPT = 128
#: re full scale, the loudest sample before there is any
_SILENT = 1e-150
#: 1/N, of a string without modes
_TINY = 1e-300


class TensionBounds:
    """Bounds for the strings of a model; results are kept for strings as they are held.

    effect : whose `bound` gives cents.
    laws : string -> its potential.
    """

    def __init__(self, model: Model, effect: Effect, laws: Mapping[str, TensionModulation | GeometricStretch]):
        self.model, self.effect, self._laws = model, effect, laws
        self.budget = model.choice.budget_cents
        self._planes = {name: [model.system.slot(c) for c in law.transverse] for name, law in laws.items()}
        self._tensions: dict[str, tuple[tuple[Compiled, ...], float, float]] = {}
        self._response: BridgeResponse | None = None
        self._phantoms: dict[tuple[str, Fretting], Phantoms] = {}
        self._sidebands: dict[tuple[str, Fretting], Sidebands] = {}
        self._compiled: tuple[Compiled, ...] = ()
        self._rising: list[tuple[Compiled, ...]] = [()] * len(laws)
        self._per_joule = np.zeros(len(laws))

    def damping_rate(self, name: str, system: System) -> float:
        """Return the least damping rate of a string's modes, 1/s."""
        return min(float(system.compiled[slot].basis.damping_rate.min()) for slot in self._planes[name])

    def cents_per_joule(self, system: System) -> Floats:
        """(n_strings,) rise of each string's pitch per joule of its energy: `Effect.bound` is proportional."""
        if system.compiled is not self._compiled:
            for i, name in enumerate(self._laws):
                planes = tuple(system.compiled[slot] for slot in self._planes[name])
                if any(a is not b for a, b in zip_longest(self._rising[i], planes)):
                    self._rising[i], self._per_joule[i] = planes, self.rise(name, system, 1.0)
            self._compiled = system.compiled
        return self._per_joule

    def rise(self, name: str, system: System, energy: float) -> float:
        """Return the largest mean rise of a string's tension at an energy (J), in cents of its pitch."""
        tension, length = self._tension_and_length(name, system)
        stiffness = self._laws[name].axial_stiffness
        return self.effect.bound(Norms(energy=energy, tension=tension, axial_stiffness=stiffness, length=length))

    def rise_under_force(self, name: str, system: System, fretting: Fretting, force: float) -> float:
        """Return the largest rise, cents, by the energy alone that a force (N) of a pluck stores on a string."""
        return _DRAWN * self.rise(name, system, 0.5 * self._compliance(name, system, fretting) * force**2)

    def of_motion(self, moment: Moment, cents: Mapping[str, float], names: Collection[str]) -> dict[str, Bound]:
        """Bound the error of leaving out strings' rise: cents, and levels of `names`.

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
            if isinstance(law := self._laws[name], GeometricStretch):
                phantoms = self._phantoms_of(law, system, moment.frettings[name])
                slopes = phantoms.slopes(moving)
                cents[name] += phantoms.cents(slopes)
                alone[name] += float(phantoms.level(slopes, peak))
        quietest = sorted(alone, key=lambda name: alone[name])
        levels = dict(zip(quietest, accumulate(alone[name] for name in quietest), strict=True))
        return {name: Bound(cents[name], levels.get(name, 0.0)) for name in cents}

    def foreseen(self, play: Play, moment: Moment, energy: float, levels: bool = True) -> Bound:
        """Bound the error after a gesture on a string of `energy` (J).

        It is infinite where nothing is known beforehand; so is its level where that is not asked for.
        """
        gesture, name, system = play.gesture, play.string or "", moment.system
        law = self._laws[name]
        if gesture.motions or gesture.on is not None or not gesture.segments or isinstance(law, GeometricStretch):
            return Bound(math.inf, math.inf)  # the phantom partials that a pluck will drive are not known beforehand
        fretting = moment.frettings[name]
        force = max(largest(s) for s in gesture.segments)
        compliance = self._compliance(name, system, fretting)
        foreseen = (math.sqrt(max(energy, 0.0)) + force * math.sqrt(0.5 * compliance)) ** 2
        cents = _DRAWN * self.rise(name, system, foreseen)
        if cents > self.budget or not levels:
            return Bound(cents, math.inf)
        plucked = dict.fromkeys(law.transverse, np.zeros(0))
        for component, point, factor in places(play, self.model):
            basis = system.compiled[system.slot(component)].basis
            plucked[component] = force * factor * basis.right[basis.index(point)].real / basis.stiffness
        moving = {c: motion(system, moment.state, c) for c in law.transverse}
        level = self.sidebands(name, system, fretting).level(moving, np.maximum(moment.peak, _SILENT), plucked)
        return Bound(cents, level)

    def sidebands(self, name: str, system: System, fretting: Fretting) -> Sidebands:
        """Return the sidebands of a string as it is held now."""
        # touching and plucking elsewhere changes none of them
        key = name, replace(fretting, place=None, touches=())
        if key not in self._sidebands:
            if len(self._sidebands) >= _KEPT:
                del self._sidebands[next(iter(self._sidebands))]
            compiled = {c: system.compiled[system.slot(c)] for c in self._laws[name].transverse}
            tension, length = self._tension_and_length(name, system)
            rise = self._laws[name].axial_stiffness / (4 * length * tension**2)
            self._sidebands[key] = Sidebands.of(compiled, rise, system, self._responses())
        return self._sidebands[key]

    def _phantoms_of(self, law: GeometricStretch, system: System, fretting: Fretting) -> Phantoms:
        """Phantom partials of a string as it is held now."""
        key = law.name, fretting
        if key not in self._phantoms:
            if len(self._phantoms) >= _KEPT:
                del self._phantoms[next(iter(self._phantoms))]
            compiled = {c: system.compiled[system.slot(c)] for c in law.components}
            tension, _ = self._tension_and_length(law.name, system)
            self._phantoms[key] = Phantoms.of(law, compiled, tension, self._responses())
        return self._phantoms[key]

    def _responses(self) -> BridgeResponse:
        """From strings' ends to outputs; computed when first needed."""
        if self._response is None:
            self._response = BridgeResponse(self.model)
        return self._response

    def _tension_and_length(self, name: str, system: System) -> tuple[float, float]:
        """Tension (N), bends included, and speaking length (m) of a string as it is stepped.

        The tension is the least that any mode's frequency gives: a tension dT raises the square w^2 of the frequency by
        a dT, and a stiff string has w^2 = T a + EI b.
        """
        law = self._laws[name]
        compiled = tuple(system.compiled[slot] for slot in self._planes[name])
        entry = self._tensions.get(name)
        if entry is None or any(a is not b for a, b in zip(entry[0], compiled, strict=True)):
            parts = [part.basis for part in compiled]
            per_newton = [cast(Floats, stretch_weights(basis)) / basis.stiffness for basis in parts]
            length = law.length if isinstance(law, TensionModulation) and law.length else parts[0].metadata["length"]
            tension = 1.0 / float(np.max(np.concatenate(per_newton), initial=_TINY))
            self._tensions[name] = entry = compiled, tension, float(cast(float, length))
        return entry[1], entry[2]

    def _compliance(self, name: str, system: System, fretting: Fretting) -> float:
        """Static compliance of a string between fixed ends where it is plucked, x (L - x) / (T L) in m/N."""
        tension, length = self._tension_and_length(name, system)
        pluck = self.model.strings[name].places.pluck
        x = min(pluck, 0.9 * length) if fretting.place is None else fretting.place
        return x * (length - x) / (tension * length)


def largest(piece: Segment) -> float:
    """Largest |F| of a piece of force, N."""
    length = piece.stop - piece.start
    extremum = -piece.c1 / (2 * piece.c2) if piece.c2 else 0.0
    times = np.array([0.0, length, extremum if 0.0 < extremum < length else 0.0])
    return float(np.max(np.abs(piece.c0 + times * (piece.c1 + times * piece.c2))))
