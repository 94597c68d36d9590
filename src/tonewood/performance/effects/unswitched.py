"""Effects that are not switched: second planes, fingers on strings, contacts, outputs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tonewood.instrument.contract.base import Exciter, Plugin
from tonewood.instrument.contract.effects import Effect, nothing
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import EffectReport, Foreseen, PlannedEffect, Run, RuntimeEffect
from tonewood.performance.effects.usage import EffectUsage
from tonewood.physics.coupling.connections import SpringDashpot

#: steps of one mode that take as long as compiling a gesture: a force on a few hundred modes at a place of its own
GESTURE_COST = 3e6


class SecondPolarizationEffect(RuntimeEffect):
    """The second plane of strings that have two in their bundle."""

    @property
    def components(self) -> tuple[str, ...]:
        """Strings with two planes."""
        return tuple(name for name in self.plugins if len(self.model.instrument.polarizations(name)) > 1)

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """Report the effect; its declared cost is saved where it is left out."""
        reports = super().report(usage)
        if self.chosen:
            return reports
        system, out = self.model.system, []
        for report in reports:
            components = self.model.strings[report.component].components
            modes = sum(system.compiled[system.slot(c)].basis.n_modes for c in components)
            out.append(self._report(report.component, 0.0, usage.saved_as_declared(self.effect.cost(modes))))
        return out


class PickupEffect(RuntimeEffect):
    """Output groups: those that are recorded run, the others are not in the model."""

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """Recorded groups ran all the time."""
        recorded, whole = {group.name for group in self.model.outputs}, usage.seconds(usage.samples)
        return [self._report(name, whole if name in recorded else 0.0) for name in self.components]

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """Recorded groups will run all the time."""
        recorded, whole = {group.name for group in self.model.outputs}, ((0.0, foreseen.seconds),)
        out = []
        for name in self.components:
            spans, why = (whole, "it is recorded") if name in recorded else ((), "it is not recorded")
            out.append(PlannedEffect(self.name, name, spans, why, None))
        return out


class OccasionalEffect(RuntimeEffect):
    """Effect of parts that act on strings now and then; base of fingers and contacts.

    Nothing is lost while it does not act: its bound is 0.
    """

    why = ""
    why_not = ""

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """How long it acted on each string; a part that is left out by choice did not."""
        out = []
        for name in self.strings(usage):
            samples = usage.spans[self.name, name].samples
            out.append(self._report(name, usage.seconds(samples), bound=0.0 if samples < usage.samples else None))
        return out + ([] if self.chosen else [self._report(part, 0.0) for part in self.plugins])

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """When it will act."""
        if not self.chosen:
            return super().plan(foreseen)
        out = []
        for name in self.strings(foreseen.usage):
            spans = foreseen.usage.score_time(foreseen.usage.spans[self.name, name])
            why = self.why if spans else self.why_not or self.why  # a finger may touch before score time 0 alone
            out.append(PlannedEffect(self.name, name, spans, why, None))
        return out

    def strings(self, usage: EffectUsage) -> list[str]:
        """Strings on which it may have acted."""
        return [name for name in self.model.strings if usage.spans[self.name, name].samples]


class DamperEffect(OccasionalEffect):
    """Fingers that quiet a string while they draw it."""

    why = "fingers touch the string to pluck it"

    def running(self, run: Run) -> Collection[str]:
        """Strings that are held."""
        return run.held


class GestureEffect(OccasionalEffect):
    """Gestures that a player makes besides those of the notes: a hand's noises.

    Compiling a gesture takes longer than its few ms of steps.
    """

    def running(self, run: Run) -> Collection[str]:
        """Strings and points of the body on which such a gesture is in progress."""
        return {play.string or play.at or "" for play in run.plays if play.exciter in self.plugins}

    def strings(self, usage: EffectUsage) -> list[str]:
        """Strings and points of the body on which they acted."""
        points = [e.at for e in self.plugins.values() if isinstance(e, Exciter) and e.at is not None]
        places = [*self.model.strings, *dict.fromkeys(points)]
        return [name for name in places if usage.spans[self.name, name].samples]

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """When they will act, and the time that will take."""
        out = super().plan(foreseen)
        if not self.chosen:
            return out
        each = GESTURE_COST * foreseen.usage.costs.rates().mode
        return [replace(p, why=self.effect.before, predicted_s=len(p.spans_s) * each) for p in out]


class ContactEffect(OccasionalEffect):
    """Contacts of strings with parts of the instrument: the kernel passes over those that nothing can touch."""

    why = "the string reaches it"
    why_not = "watched; the string does not reach it"

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        super().__init__(model, effect, plugins)
        # columns of the forces of each string's contacts with these parts
        columns: dict[str, list[int]] = defaultdict(list)
        for j, connection in enumerate(model.system.connections):
            law = model.resting.get(connection.name, connection).law
            if connection.part in plugins and not isinstance(law, SpringDashpot):
                columns[connection.owner].append(j)
        self._columns = {string: np.array(numbers) for string, numbers in columns.items()}

    def running(self, run: Run) -> Collection[str]:
        """Strings that touched a part."""
        if not run.acted.size or not run.system.elimination.others.laws:
            return ()
        acting = np.zeros(len(run.system.connections), dtype=bool)
        acting[run.acted] = True
        return [string for string, columns in self._columns.items() if acting[columns].any()]

    def strings(self, usage: EffectUsage) -> list[str]:
        """Strings that have contacts with these parts."""
        return list(self._columns)


#: a finger that quiets the string while it draws it; for exciters whose gestures have a `ta.Hold`
DAMPERS = Effect(
    "dampers", "fingers that quiet a string while they draw it", "additive", "from touch to release of each pluck",
    "nothing: no finger is on the string otherwise", cost=nothing,
    runtime=DamperEffect,
)  # fmt: skip
#: noises of a hand between notes, and of keys; for exciters that `playing.noises` names
FRETTING_NOISE = Effect(
    "fretting_noise", "fingers that press a string to a stop, or leave it", "additive",
    "a note's stop is another one than before", "nothing: no finger moves otherwise",
    runtime=GestureEffect,
)  # fmt: skip
TOUCH_NOISE = Effect(
    "touch_noise", "fingers that fall on a string to end a note", "additive", "each note that is damped",
    "nothing: no finger moves otherwise",
    runtime=GestureEffect,
)  # fmt: skip
SQUEAK = Effect(
    "squeak", "fingers that rub the windings of a string as the hand slides", "additive",
    "a note's stop lies far from the last one on a wound string", "nothing: no finger moves otherwise",
    runtime=GestureEffect,
)  # fmt: skip
KEY_NOISE = Effect(
    "key_noise", "keys that meet their felts, and shanks of hammers", "additive",
    "each note, and each key that comes up",
    "nothing: no key moves otherwise",
    runtime=GestureEffect,
)  # fmt: skip
