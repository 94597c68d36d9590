"""Coupling of a string's longitudinal motion to its transverse one: it is switched with the string's tension."""

from __future__ import annotations

from collections.abc import Collection

from tonewood.instrument.contract.effects import Effect
from tonewood.performance.effects.base import EffectReport, Foreseen, PlannedEffect, Run, RuntimeEffect, in_decibels
from tonewood.performance.effects.tension import TENSION_MODULATION
from tonewood.performance.effects.usage import EffectUsage


class LongitudinalEffect(RuntimeEffect):
    """Reports on the strings whose longitudinal motion is stepped.

    Whether phantom partials are missing is bounded by `effects.tension`, which switches the coupling.
    """

    def running(self, run: Run) -> Collection[str]:
        """Strings whose coupling is on."""
        switching = run.switchings.get(TENSION_MODULATION.name)
        return () if switching is None else switching.on.intersection(self.plugins)

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """When the coupling was on, and the bound on the error meanwhile.

        Its saving is part of that of the rising tension; of a string that is never coupled, its declared cost.
        """
        out = []
        for name in self.components:
            string = self.model.strings[name]
            if string.longitudinal is None:
                system = self.model.system
                modes = sum(system.compiled[system.slot(c)].basis.n_modes for c in string.components)
                out.append(self._report(name, 0.0, usage.saved_as_declared(self.effect.cost(modes))))
                continue
            bound = usage.left_out.get((TENSION_MODULATION.name, name))
            active = usage.seconds(usage.spans[self.name, name].samples)
            out.append(self._report(name, active, 0.0, None if bound is None else in_decibels(bound.level)))
        return out

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """When the coupling will be on."""
        if not self.chosen:
            return super().plan(foreseen)
        switched = f"as long as its tension rises or its phantom partials pass {self.model.choice.budget_db:g} dB"
        why = self._always or switched
        usage = foreseen.usage
        return [
            PlannedEffect(self.name, name, usage.score_time(usage.spans[self.name, name]), why, None)
            for name in self.components
        ]


#: longitudinal motion of a string; for plugins whose strings have it
LONGITUDINAL = Effect(
    "longitudinal", "motion along the string: partials at sums of transverse ones", "additive",
    "any gesture on the string", "a bound on the phantom partials that the string's partials would "
    "drive; without them it is linear", cost=lambda n: 60.0 * n, title="phantom partials",
    runtime=LongitudinalEffect,
)  # fmt: skip
