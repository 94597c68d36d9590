"""The protocol of effects, by which the engine, its snapshots, the usage of effects and the plan use any of them.

An effect is declared by a plugin (`instrument.contract.effects.Effect`). For one model the engine makes a
`RuntimeEffect` of it, which says when the effect ran, when it was left out, and why. One that is switched on and off
while the engine steps is a `SwitchedEffect`:

========  ===========================================================================================================
watch     Look at the motion, and return the components on which the effect is wanted, with bounds on the error without.
apply     Return the system with the effect on some components and off on the others; `cost` gives its energy.
report    Say how long the effect ran and was left out, with the bound on the error.
plan      The same of a render that is foreseen; `load` gives the cost of its steps.
restore   Nothing to do: all that moves is a `Switching`, a plain value that the engine owns and copies.
========  ===========================================================================================================

An effect object itself does not change after it is made; it may keep results computed from the model.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import PluginError
from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.contract_checks import check_results, number, want
from tonewood.instrument.contract.effects import Effect
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.system import State, System
from tonewood.support.arrays import Floats
from tonewood.support.units import decibel

#: an amplitude ratio that is as good as silence: -400 dB
_SILENCE = 1e-20


@dataclass(frozen=True, slots=True)
class Switching:
    """State of a switched effect: a plain value, owned by the engine and copied with its snapshots.

    Attributes
    ----------
    on : components on which the effect runs.
    pending : components on which it is wanted, but which cannot pay for the switch yet.
    until : component -> sample before which it stays on unwatched, since its bound is far above the budget.
    """

    on: frozenset[str] = frozenset()
    pending: frozenset[str] = frozenset()
    until: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Watched:
    """Result of `SwitchedEffect.watch`.

    Attributes
    ----------
    wanted : components on which the effect is to run from now on.
    bounds : component, bound on the error without the effect, and whether it is left out; in order.
    until : of `Switching`.
    """

    wanted: frozenset[str]
    bounds: Sequence[tuple[str, Bound, bool]] = ()
    until: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Moment:
    """Data that an effect may read at one point of the control grid; effects change nothing of it.

    Attributes
    ----------
    system, state : system that is stepped, and its motion; `state.sample` is now.
    frettings : string -> how it is held.
    peak : (n_readouts,) largest sample of each readout so far.
    moved : strings that are held otherwise from now on.
    fresh : gestures that begin now.
    busy : strings on which a gesture acts.
    until : string -> s until its next change or gesture, or until the sound has decayed, as estimated.
    """

    system: System
    state: State
    frettings: Mapping[str, Fretting]
    peak: Floats
    moved: Collection[str] = ()
    fresh: Sequence[Play] = ()
    busy: Collection[str] = ()
    until: Callable[[str], float] = lambda string: math.inf

    @property
    def sample(self) -> int:
        """Now."""
        return self.state.sample


@dataclass(frozen=True, eq=False)
class Run:
    """Steps that were made without a look between them.

    start, n : first sample, and how many.
    system : that was stepped.
    acted : connections that had a force; linear ones may be left out.
    held : strings that a gesture's finger held.
    switchings : effect -> state of its switches.
    plays : gestures in progress.
    """

    start: int
    n: int
    system: System
    acted: NDArray[np.intp]
    held: Collection[str]
    switchings: Mapping[str, Switching]
    plays: Sequence[Play] = ()


@dataclass(frozen=True, slots=True)
class EffectReport:
    """One effect on one component in a render.

    Attributes
    ----------
    name : of the effect.
    component : string, ``body``, part or output group.
    seconds_active : of sound while it was stepped; of a contact or a finger, while it touched.
    seconds_saved : of computing, from the times of steps in this render; from the declared costs where none were made.
    bound : on the error of leaving it out, in `unit`; None where it was never left out, or by choice, unwatched.
        Nothing is lost by leaving out contacts that touch nothing: there it is 0.
    unit : dB re the loudest sample, or cents.
    bound_db : of an effect in cents, besides `bound`: level of the sound missing at the outputs, dB re the loudest
        sample; None as there.
    title : the effect in words.
    """

    name: str
    component: str
    seconds_active: float
    seconds_saved: float
    bound: float | None
    unit: str
    bound_db: float | None = None
    title: str = ""


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """One effect on one component in a render that is foreseen.

    name : of the effect.
    component : string, ``body``, part or output group.
    spans_s : (start, stop) of the times it will run, s of score time; of a contact, when it will touch.
    why : one line.
    predicted_s : of computing, None where its share is not known.
    """

    name: str
    component: str
    spans_s: tuple[tuple[float, float], ...]
    why: str
    predicted_s: float | None

    @property
    def seconds(self) -> float:
        """How long it will run, s of sound."""
        return sum(stop - start for start, stop in self.spans_s)


@dataclass(frozen=True, eq=False)
class Foreseen:
    """A sketch of a render, as `RuntimeEffect.plan` sees it.

    usage : of the effects in the sketch.
    seconds : of sound.
    computing : (effect, component) -> s of computing that its steps will take.
    """

    usage: EffectUsage
    seconds: float
    computing: Mapping[tuple[str, str], float]


def _fault(effect: Any, reason: str) -> PluginError:
    """Error of an effect's class, with the key of the first plugin that declares it."""
    plugin = next(iter(getattr(effect, "plugins", {}).values()), None)
    named = f"effect {effect.effect.name!r}: " if hasattr(effect, "effect") else ""
    return PluginError(named + reason, file=plugin and plugin.files.manifest, key=plugin and plugin.key)


def _next_watch(effect: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    number(value, "a sample", arguments["sample"], above=True)
    want(value == int(value) and int(value) % GRID == 0, value, f"a multiple of {GRID} (ta.next_multiple)")


def _watched(effect: Any, value: Any, arguments: Mapping[str, Any]) -> None:
    if value is None:
        return
    want(isinstance(value, Watched), value, "a ta.Watched or None")
    components = set(effect.components)
    for component in value.wanted:
        want(component in components, component, f"one of {', '.join(sorted(components))}", "wanted")
    for entry in value.bounds:
        fits = isinstance(entry, tuple) and len(entry) == 3 and isinstance(entry[1], Bound)
        want(fits, entry, "(component, ta.Bound, whether it is left out)", "bounds")
        want(entry[0] in components, entry[0], f"one of {', '.join(sorted(components))}", "bounds")
        for name in ("level", "cents"):
            size = getattr(entry[1], name)
            want(size == math.inf or (size >= 0.0), size, "0 or more", f"bound.{name}")


def _reports(kind: type) -> Callable[[Any, Any, Mapping[str, Any]], None]:
    def verify(effect: Any, value: Any, arguments: Mapping[str, Any]) -> None:
        fits = isinstance(value, list) and all(isinstance(one, kind) for one in value)
        want(fits, value, f"a list of {kind.__name__}")

    return verify


#: method of an effect -> check of its result
_CHECKS: dict[str, Any] = {
    "next_watch": _next_watch,
    "watch": _watched,
    "start": lambda e, v, a: want(isinstance(v, Switching), v, "a ta.Switching"),
    "apply": lambda e, v, a: want(isinstance(v, System), v, "the system"),
    "cost": lambda e, v, a: number(v, "an energy in J"),
    "load": lambda e, v, a: number(v, "a number of modes, 0 or more,", 0.0),
    "report": _reports(EffectReport),
    "plan": _reports(PlannedEffect),
}


class RuntimeEffect:
    """One declared effect in one model. This base class is an effect that always runs on all its components.

    Parameters
    ----------
    model : in which it runs.
    effect : as it is declared.
    plugins : string, ``body``, part or output group -> the plugin that declares it.
    """

    def __init_subclass__(cls, **options: Any):
        """Check the results of the methods that the class defines; see `instrument.contract.contract_checks`."""
        super().__init_subclass__(**options)
        check_results(cls, _CHECKS, _fault)

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        self.model, self.effect, self.plugins = model, effect, plugins
        #: whether it may run at all; an effect left out by choice is not in the model
        self.chosen = effect.name in model.choice.names

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def components(self) -> tuple[str, ...]:
        """Names that it is reported for: strings, parts, output groups or ``body``."""
        return tuple(self.plugins)

    def running(self, run: Run) -> Collection[str]:
        """Return the components on which it ran, if that is counted run by run."""
        return ()

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """Report how long it ran and was left out, and the bound, from the `usage` of all effects."""
        whole = usage.seconds(usage.samples) if self.chosen else 0.0
        return [self._report(component, whole) for component in self.components]

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """Return when it will run, and why, from the sketch of a render, `foreseen`."""
        spans, why = (((0.0, foreseen.seconds),), self.effect.before) if self.chosen else ((), self._left_out)
        return [PlannedEffect(self.name, component, spans, why, None) for component in self.components]

    @property
    def _always(self) -> str:
        """Why it always runs by choice, where effects are not switched: empty for ``auto``."""
        return {"auto": "", "all": "always: effects are all"}.get(
            self.model.choice.mode, "always: it is among those named"
        )

    @property
    def _left_out(self) -> str:
        mode = self.model.choice.mode
        return f"left out: effects are {'named one by one' if mode == 'list' else mode}"

    def _report(
        self,
        component: str,
        seconds_active: float,
        saved: float = 0.0,
        bound: float | None = None,
        bound_db: float | None = None,
    ) -> EffectReport:
        title = self.effect.title or self.name.replace("_", " ")
        return EffectReport(self.name, component, seconds_active, saved, bound, self.effect.unit, bound_db, title)


class SwitchedEffect(RuntimeEffect, ABC):
    """An effect that is switched on and off, component by component, while the engine steps.

    With effects ``auto`` it begins off everywhere and is watched; otherwise it runs all the time.

    Attributes
    ----------
    share : of the additive budget; the switched effects of a model have equal ones.
    """

    share = 1.0

    @property
    def watched(self) -> bool:
        """Whether there is anything to switch."""
        return self.model.choice.mode == "auto" and self.chosen and bool(self.components)

    def prepare(self, timeline: Timeline) -> None:
        """Read the score, as `timeline`, before the first step; does nothing by default."""

    def start(self) -> Switching:
        """Return the state before anything has moved."""
        return Switching(frozenset(self.components if self.chosen and not self.watched else ()))

    @abstractmethod
    def next_watch(self, sample: int, switching: Switching) -> int:
        """Return the first sample after `sample` at which `watch` has to be called, whatever is played.

        It is a multiple of `GRID`, 64 samples; `switching` is the state of the effect now.
        """

    @abstractmethod
    def watch(self, moment: Moment, switching: Switching) -> Watched | None:
        """Say on which components the effect is wanted; None to leave everything as it is.

        Called at every point of the control grid at which the engine stops: those of `next_watch`, and wherever a
        string is held otherwise or a gesture begins or ends. The decision must not depend on calls at other points.

        Parameters
        ----------
        moment : the system, its motion, and the events at this point.
        switching : state of the effect now.
        """

    @abstractmethod
    def apply(self, system: System, on: Collection[str], frettings: Mapping[str, Fretting]) -> System:
        """Return the system with the effect on these components and off all others; itself if it is so already.

        Parameters
        ----------
        system : to be changed.
        on : components.
        frettings : string -> its stop and how it is held.
        """

    def cost(self, moment: Moment, component: str, on: bool) -> float:
        """Return the energy that switching a component on (or off) at a `moment` would add, J; below 0 it is lost."""
        return 0.0

    def payers(self, component: str) -> Sequence[str]:
        """Return the components of the system whose kinetic energy pays for a switch of `component`; real modes."""
        return ()

    def reset(self, system: System, state: State, changed: Collection[str]) -> None:
        """Clear the memory in the state of components that are switched now, in place.

        Parameters
        ----------
        system, state : before the switch.
        changed : components.
        """

    def load(self, component: str) -> float:
        """Return the size of the effect on a component, in modes: its cost per sample grows with it."""
        return 0.0

    def running(self, run: Run) -> Collection[str]:
        """Return the components on which it is on."""
        return run.switchings[self.name].on

    def report(self, usage: EffectUsage) -> list[EffectReport]:
        """Report when it was on and left out, and the bound."""
        out = []
        for component in self.components:
            spans, bound = usage.spans[self.name, component], usage.left_out.get((self.name, component))
            cents, level = (None, None) if bound is None else (bound.cents, in_decibels(bound.level))
            if self.effect.kind == "additive":
                first, second = 0.0 if bound is not None and bound.level == 0.0 else level, None
            else:
                first, second = cents, level
            if self.chosen:
                saved = usage.saved(self.name, component)
            else:
                saved = usage.saved_as_declared(self.effect.cost(round(self.load(component))))
            out.append(self._report(component, usage.seconds(spans.samples), saved, first, second))
        return out

    def plan(self, foreseen: Foreseen) -> list[PlannedEffect]:
        """Return when it will be on, why, and the time of its steps, from a sketch, `foreseen`."""
        if not self.chosen:
            return super().plan(foreseen)
        out = []
        for component in self.components:
            key = self.name, component
            spans = foreseen.usage.score_time(foreseen.usage.spans[key])
            out.append(
                PlannedEffect(
                    self.name, component, spans, self.why(foreseen.usage, component), foreseen.computing.get(key, 0.0)
                )
            )
        return out

    def why(self, usage: EffectUsage, component: str) -> str:
        """Return a line for the plan: why it will run on a `component` as its `usage` foresees."""
        return self._always or self.effect.before


def next_multiple(sample: int, points: int) -> int:
    """Return the first sample after `sample` that is a multiple of so many `points` of the control grid."""
    step = GRID * points
    return sample // step * step + step


def in_decibels(level: float) -> float:
    """Level of an amplitude ratio in dB, -400 at least."""
    return decibel(max(level, _SILENCE))
