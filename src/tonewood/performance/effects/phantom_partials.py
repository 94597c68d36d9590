"""Phantom partials that are driven one way, switched on and off string by string.

They run from any gesture on a string until bounds on the missing sound (`effects.phantoms`, from the string's
partials and the body's response) come to the budget over all strings without them: those of the strings of a key are
added up, those of several keys in power, since their partials are at other frequencies: the sum is an estimate. Strings
that are not played are in it, whatever their energy: a bass string of a piano makes phantom partials of little motion.
After gestures and changes of pedals motion spreads from string to string within milliseconds. For a while they then run
on all strings without a look: looks that are frequent enough take longer than that.

Up to 24 strings may be in unison on a light body, which passes their motion on from one to another between two looks at
any time. Their bounds are all added up, and if they are wanted on one string they run on all.

The transverse motion is the same on or off, so that a switch costs no energy.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import is_not
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Moment, SwitchedEffect, Switching, Watched, next_multiple
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.phantoms import Phantoms
from tonewood.performance.effects.switching import clear_memory
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.timeline import GRID, Timeline
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.system import Compiled, State, System
from tonewood.physics.modal.string_modes import string_basis
from tonewood.support.arrays import Floats

#: s between two looks; s for which motion spreads to other strings after a gesture or a change of pedals
_LOOK, _SPREAD = 0.04, 0.15
#: share of that below which they are left out; above the whole of it, they come back
_LEAVE = 0.9
#: strings up to which they run on all or on none: a light body passes motion on within milliseconds. Of a piano's many
#: strings, others than those of a key are damped or move far less
_FEW = 24
#: re full scale, the loudest sample before there is any
_SILENT = 1e-150


@dataclass(frozen=True, eq=False)
class _Group:
    """Strings that have one bound.

    names : (n_strings,) of the strings.
    rooms : component of the bound's string -> (n_strings, n_modes), where the modes of theirs are in a state.
    forms : component -> (3, n_strings, n_modes) a, b, c of q = a x, q' = b x + c y (`ModalBasis.motion`).
    """

    names: Sequence[str]
    bound: Phantoms
    rooms: Mapping[str, NDArray[np.intp]]
    forms: Mapping[str, Floats]

    @classmethod
    def of(
        cls, system: System, names: Sequence[str], bound: Phantoms, components: Mapping[str, Sequence[str]]
    ) -> _Group:
        """Make it of the strings' components that stand in the place of each one of the bound's string."""
        rooms, forms = {}, {}
        for component, others in components.items():
            slots, n = [system.slot(other) for other in others], bound.parts[component].n_modes
            rooms[component] = np.array([system.layout.offsets[slot] + np.arange(n) for slot in slots])
            forms[component] = np.stack([system.compiled[slot].basis.motion[:3] for slot in slots], axis=1)
        return cls(names, bound, rooms, forms)

    def levels(self, state: State, peak: Floats) -> Floats:
        """(n_strings,) largest sample that is missing without each, re the loudest one."""
        moved = {}
        for component, rooms in self.rooms.items():
            (x, y), (a, b, c) = state.modes[:, rooms], self.forms[component]
            moved[component] = a * x, b * x + c * y
        levels = self.bound.level(self.bound.slopes(moved), peak)
        return np.where(np.isfinite(levels), levels, math.inf)


class PhantomPartialsEffect(SwitchedEffect):
    """Decides which strings' longitudinal forces act."""

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        super().__init__(model, effect, plugins)
        self._laws = {p.name: p for p in model.system.potentials if isinstance(p, DrivenLongitudinal)}
        self._few = len(self._laws) <= _FEW
        self._look = max(1, round(_LOOK / (GRID * model.system.dt)))
        self._response: BridgeResponse | None = None
        self._bounds: dict[tuple[str, float], Phantoms] = {}
        self._slots = [model.system.slot(c) for name in self._laws for c in self._planes(name)]
        self._compiled: list[Compiled] = []
        self._groups: list[_Group] = []

    @property
    def components(self) -> tuple[str, ...]:
        """Strings whose longitudinal motion is driven."""
        return tuple(self._laws) if self.chosen else tuple(self.plugins)

    @property
    def budget(self) -> float:
        """Ratio to the loudest sample of the sound that may be missing at the outputs."""
        return self.share * 10 ** (self.model.choice.budget_db / 20)

    def prepare(self, timeline: Timeline) -> None:
        """Find the bounds of the strings that will be played; of all where nothing of that is known."""
        if self.watched:
            plays = {play.string for play in timeline.plays if play.string is not None}
            for name in {self._alike(name) for name in self._laws if not plays or name in plays}:
                self._bound(self.model.system, name, 0.0)

    def next_watch(self, sample: int, switching: Switching) -> int:
        """Every 40 ms."""
        return next_multiple(sample, self._look)

    def watch(self, moment: Moment, switching: Switching) -> Watched | None:
        """Wanted on all while motion spreads, then where a gesture acts and where the bound is beyond the budget.

        `Switching.until` holds, for no component, the sample until which motion spreads.
        """
        until = switching.until
        if moment.fresh or moment.moved:
            until = {"": moment.sample + round(_SPREAD / moment.system.dt)}
        if moment.sample < until.get("", 0):
            same = until == switching.until and self._laws.keys() == switching.on
            return None if same else Watched(frozenset(self._laws), until=until)
        if moment.sample % (GRID * self._look):
            return None
        staying = self._moved(moment.busy)
        peak = np.maximum(moment.peak, _SILENT)
        levels = {name: level for name, level in self._levels(moment, peak).items() if name not in staying}
        # levels of the strings of a key add up, and so do those of few strings; those of several keys in power
        names, missing, power = set(staying), dict.fromkeys(("", *self._laws), 0.0), 0.0
        for name, level in sorted(levels.items(), key=lambda item: item[1]):
            key = "" if self._few else self.model.strings[name].group[0]
            more = power + level * (level + 2 * missing[key])
            if math.sqrt(more) > self.budget * (_LEAVE if name in switching.on else 1.0):
                names.add(name)
            else:
                missing[key], power = missing[key] + level, more
        if self._few and names:
            names = set(self._laws)
        bounds = [(name, Bound(level=level), name not in names) for name, level in levels.items()]
        return Watched(frozenset(names), bounds, until)

    def _moved(self, played: Iterable[str | None]) -> set[str]:
        """Strings that gestures on these move at once: those of their keys, or all where there are few."""
        strings = [string for string in played if string]
        if strings and self._few:
            return set(self._laws)
        return {name for string in strings for name in self.model.strings[string].group} & self._laws.keys()

    def apply(self, system: System, on: Collection[str], frettings: Mapping[str, Fretting]) -> System:
        """Switch the forces of these strings on, and all others off."""
        return system.with_potentials(on, self._laws)

    def reset(self, system: System, state: State, changed: Collection[str]) -> None:
        """Clear the state of the longitudinal modes."""
        clear_memory(system, state, changed)

    def load(self, component: str) -> float:
        """Modes that drive."""
        system = self.model.system
        parts = (system.compiled[system.slot(c)].potentials.get(component) for c in self._planes(component))
        return float(sum(part.weights.shape[1] for part in parts if part is not None))

    def why(self, usage: EffectUsage, component: str) -> str:
        """One line."""
        if self.model.choice.mode != "auto":
            return super().why(usage, component)
        return f"from a gesture until the missing sound is below {self.model.choice.budget_db:g} dB"

    def _planes(self, name: str) -> Sequence[str]:
        return [p.component for p in self.model.strings[name].polarizations]

    def _levels(self, moment: Moment, peak: Floats) -> dict[str, float]:
        """Bound on the largest sample that is missing without it, re the loudest one, of each string."""
        compiled = [moment.system.compiled[slot] for slot in self._slots]
        if len(compiled) != len(self._compiled) or any(map(is_not, compiled, self._compiled)):
            self._compiled, self._groups = compiled, self._grouped(moment)
        levels = dict.fromkeys(self._laws, math.inf)
        for group in self._groups:
            levels.update(zip(group.names, group.levels(moment.state, peak).tolist(), strict=True))
        return levels

    def _grouped(self, moment: Moment) -> list[_Group]:
        """Strings that have one bound as they are held now; without those of which a bend has moved modes away.

        The bound is that of the string as it was when that was made.
        """
        system, groups = moment.system, dict[tuple[str, float], list[str]]()
        for name in self._laws:
            key = self._alike(name), moment.frettings[name].stop
            parts = self._bound(system, *key).parts
            planes = zip(self._planes(key[0]), self._planes(name), strict=True)
            if all(parts[a].n_modes == system.compiled[system.slot(b)].basis.n_modes for a, b in planes):
                groups.setdefault(key, []).append(name)
        alike = []
        for (like, stop), names in groups.items():
            components = dict(zip(self._planes(like), zip(*map(self._planes, names), strict=True), strict=True))
            alike.append(_Group.of(system, names, self._bound(system, like, stop), components))
        return alike

    def _alike(self, name: str) -> str:
        """The first string of its key if that is the same but for some cents, else itself."""
        first = self.model.strings[name].group[0]
        pair = [self.model.strings[s] for s in (first, name)]
        system, bounds = self.model.system, []
        for s in pair:
            sizes = [system.compiled[system.slot(c)].basis.n_modes for c in self._planes(s.name)]
            bounds.append((s.resonator.parameters, sizes, s.name in self._laws))
        return first if bounds[0] == bounds[1] else name

    def _bound(self, system: System, name: str, stop: float) -> Phantoms:
        """The bound of a string at a stop: that of the string whose motion along itself is coupled both ways."""
        key = name, stop
        if key not in self._bounds:
            if self._response is None:
                self._response = BridgeResponse(self.model)
            law, component, planes = self._laws[name], f"{name}.longitudinal", self._planes(name)
            compiled = {c: system.compiled[system.slot(c)] for c in planes}
            metadata = compiled[planes[0]].basis.metadata
            lengthwise = string_basis(
                cast(float, metadata["length"]), law.axial_stiffness, cast(float, metadata["linear_density"]), 0.0,
                lambda freq_rad, k: np.full_like(freq_rad, law.loss), freq_upper=0.45 / system.dt,
            )  # fmt: skip
            stretch = GeometricStretch(name, tuple(planes), component, law.axial_stiffness, law.freq_coupled)
            shares = {
                c: replace(part, potentials={name: stretch.share(c, part.basis, part.dt)})
                for c, part in compiled.items()
            }
            shares[component] = replace(compiled[planes[0]], basis=lengthwise)
            self._bounds[key] = Phantoms.of(stretch, shares, self.model.strings[name].tension(stop), self._response)
        return self._bounds[key]


#: motion along a string that the transverse one drives one way; for plugins whose strings have it
PHANTOM_PARTIALS = Effect(
    "phantom_partials", "motion along the string, driven one way: partials at sums of transverse ones", "additive",
    "any gesture on the string", "a bound on the phantom partials that the string's partials would drive",
    cost=lambda n: 2.0 * n, title="phantom partials",
    runtime=PhantomPartialsEffect,
)  # fmt: skip
