"""Model, state and timeline to samples, on a control grid that does not depend on output blocks.

Every change (a stop, a bend, a damper, an effect switched) takes effect at a multiple of 64 samples counted from sample
0; a finger tightens its hold at whole samples, and known forces act at any fraction of a sample. The points at which
the engine stops depend only on the timeline, so its samples do not depend on the blocks in which they are asked for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects import runtime_effects
from tonewood.performance.effects.base import Moment, Run, SwitchedEffect, Switching
from tonewood.performance.effects.gesture_connections import GestureConnections, holds_at
from tonewood.performance.effects.switching import switch
from tonewood.performance.effects.usage import EffectUsage
from tonewood.performance.engine.in_progress import GesturesInProgress
from tonewood.performance.engine.schedule import Schedule
from tonewood.performance.player.fretting import FrettedBases, Fretting, at_rest, bridge_forces
from tonewood.performance.player.gestures import quasi_static
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.potentials.solve import cut_excess
from tonewood.physics.coupling.system import Compiled, State, System
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import share_velocities
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.support.units import decibel

__all__ = ["GRID", "Counters", "Engine", "Snapshot"]

if TYPE_CHECKING:
    from tonewood.performance.engine.energy_budget import EnergyBudget


#: points of the control grid after which the engine stops at the latest
_LONGEST = 64
#: steps that an energy budget makes again at most where a potential acts
_PIECE = 16


@dataclass(eq=False)
class Snapshot:
    """All that moves in an engine; restoring it continues bit for bit."""

    state: State
    frettings: dict[str, Fretting]
    gestures: GesturesInProgress
    switchings: dict[str, Switching]
    peak: Floats
    recent: Floats
    schedule: Schedule


@dataclass(eq=False)
class Counters:
    """Counts of the work that an engine did.

    exchanges : bases of strings that were exchanged.
    strings_played : names.
    stepping_s, control_s : seconds of the processor in steps and between them.
    """

    exchanges: int = 0
    strings_played: set[str] = field(default_factory=set)
    stepping_s: float = 0.0
    control_s: float = 0.0


class Engine:
    """Steps one model through one timeline.

    model : assembled instrument.
    timeline : changes and gestures.
    energy : keep an `energy_budget`; many times slower, with the same samples.
    system, state : system that is stepped, and its motion.
    effects : of the model.
    switchings : switched effect -> components on which it runs: all that moves of it.
    usage : of the effects: when they ran and were left out.
    peak : (n_readouts,) largest sample of each readout so far, where any effect is watched.
    recent : (n_readouts,) that of the last run.
    tail_level : dB re the peak at which the sound counts as decayed after the last event.
    only_watch : do not switch effects, but count them in `usage` as if they were.
    """

    def __init__(self, model: Model, timeline: Timeline, *, energy: bool = False):
        self.model, self.timeline = model, timeline
        for name in timeline.stops.keys() | timeline.bent.keys():
            model.strings[name].tuning.prepare(timeline.stops.get(name, ()), timeline.bent.get(name, ()))
        self.effects = runtime_effects(model)
        switched = [effect for effect in self.effects if isinstance(effect, SwitchedEffect)]
        for effect in switched:
            effect.prepare(timeline)
        self.switchings = {effect.name: effect.start() for effect in switched}
        self._switched = [effect for effect in switched if effect.chosen]
        self._watched = [effect for effect in switched if effect.watched]
        self.only_watch = False
        self.frettings = {name: at_rest(string) for name, string in model.strings.items()}
        self.fingerboard, self.connections = FrettedBases(model), GestureConnections(model)
        self.system: System = self._with_effects(
            self.fingerboard.fretted(model.system, {n: f for n, f in self.frettings.items() if f != Fretting()}, {})
        )
        self.dt = self.system.dt
        self.stepper = KernelStepper(self.system)
        self.state = self.stepper.start()
        self.peak = np.zeros(len(model.system.readouts))
        self.recent, self.tail_level = self.peak.copy(), -math.inf
        self.gestures = GesturesInProgress()
        self.counters = Counters()
        self.usage = EffectUsage(
            model.fs,
            {effect.name: {c: effect.load(c) for c in effect.components} for effect in self._switched},
            {effect.name: effect.effect.cost(1) for effect in self._switched},
        )
        self._compiled: tuple[Compiled, ...] = ()
        self._modes = 0
        self.schedule = Schedule(self.dt, model.strings)
        self.schedule.add(timeline.changes, timeline.plays)
        self._dampers = all(model.choice.keeps(e, "dampers") for e in model.exciters.values())
        self.state.sample = int(np.floor(timeline.start / self.dt / GRID)) * GRID
        self.energy_budget: EnergyBudget | None = self._new_budget() if energy else None

    def _new_budget(self) -> EnergyBudget:
        from tonewood.performance.engine.energy_budget import EnergyBudget  # few renders keep one

        return EnergyBudget(self.system, self.state, self.model)

    @property
    def done(self) -> bool:
        """Whether every change and gesture is over: the instrument only rings."""
        return self.schedule.done and not self.gestures.active

    def running(self, effect: str) -> frozenset[str]:
        """Components on which a switched effect runs now."""
        return self.switchings[effect].on

    def snapshot(self) -> Snapshot:
        """Copy all that moves; an energy budget begins anew where the copy is restored."""
        return Snapshot(
            self.state.copy(), dict(self.frettings), self.gestures.copy(), dict(self.switchings), self.peak.copy(),
            self.recent.copy(), self.schedule.copy(),
        )  # fmt: skip

    @one_blas_thread
    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this engine, or of one with the same model and timeline."""
        s = snapshot
        self.state, self.frettings, self.gestures = s.state.copy(), dict(s.frettings), s.gestures.copy()
        self.switchings, self.peak, self.recent = dict(s.switchings), s.peak.copy(), s.recent.copy()
        self.schedule = s.schedule.copy()
        system = self._with_effects(self.fingerboard.fretted(self.system, self.frettings, self.frettings))
        moved = self.connections.with_moved(system, self.gestures.active)
        self.system = self.connections.with_holds(moved, self.gestures.holds)
        if self.energy_budget:
            self.energy_budget = self._new_budget()

    def follow_timeline(self) -> None:
        """Take what begins from now on from this engine's timeline, after the `restore` of another one's snapshot."""
        self.schedule = Schedule(self.dt, self.model.strings)
        self.schedule.add(self.timeline.changes, self.timeline.plays)
        self.schedule.take(self.state.sample)

    @one_blas_thread
    def advance(self, n_ticks: int) -> Floats:
        """Step n_ticks intervals of the control grid; returns (n_ticks * GRID, n_channels)."""
        out, end = [], self.state.sample + n_ticks * GRID
        while self.state.sample < end:
            began = time.thread_time()
            self._control()
            start = self.state.sample
            steps = min(self._next_event(), end) - start
            if self.energy_budget:  # it makes the motion again from the forces: rounding must not grow long
                steps = min(steps, GRID)
            before = self.state.copy() if self.energy_budget else None
            self.gestures.reach(start + steps)
            if self.system is not self.stepper.system:
                self.stepper.exchange(self.system)
            ready = time.thread_time()
            forces: Floats | None = None
            if self.energy_budget:
                sound, forces = self.stepper.run(self.state, steps, self.gestures.injections, self.gestures.controls)
                acted = np.flatnonzero(np.any(forces, axis=0))
            else:
                sound, acted = self.stepper.advance(self.state, steps, self.gestures.injections, self.gestures.controls)
            stepped = time.thread_time()
            if before and forces is not None:
                self._book(before, forces)
            added = quasi_static(self.gestures.active, self.model, self.system, start, steps)
            if added is not None:
                sound = sound + added
            out.append(sound)
            if self._watched:
                # the rows of channels in one piece: several times quicker
                self.recent = np.abs(np.ascontiguousarray(sound.T)).max(axis=1)
                np.maximum(self.peak, self.recent, out=self.peak)
            self._count(start, steps, acted, stepped - ready)
            self.gestures.end(self.state.sample)
            self.counters.stepping_s += stepped - ready
            self.counters.control_s += ready - began + time.thread_time() - stepped
        return np.concatenate(out) if out else np.zeros((0, len(self.system.readouts)))

    def _book(self, before: State, forces: Floats) -> None:
        """Enter a run into the energy budget.

        Where potentials act rounding grows faster: the run is stepped again from a copy, in pieces short enough.
        """
        if (budget := self.energy_budget) is None:
            return
        while self.system.potentials.two_way and before.sample + _PIECE < self.state.sample:
            after = before.copy()
            _, piece = self.stepper.run(after, _PIECE, self.gestures.injections, self.gestures.controls)
            budget.follow(before, after, piece, self.gestures)
            before, forces = after, forces[_PIECE:]
        budget.follow(before, self.state, forces, self.gestures)

    def _count(self, start: int, n: int, acted: NDArray[np.intp], seconds: float) -> None:
        """Enter a run into the usage of effects."""
        plays = [active.play for active in self.gestures.active]
        run = Run(start, n, self.system, acted, self.gestures.holds.keys(), self.switchings, plays)
        running = {effect.name: effect.running(run) for effect in self.effects}
        if self.system.compiled is not self._compiled:
            self._compiled = self.system.compiled
            self._modes = sum(compiled.basis.n_modes for compiled in self._compiled)
        self.usage.count(start, n, running, self._modes, seconds)

    def _next_event(self) -> int:
        """First sample after now at which the engine has to stop: a grid point, or the next step of a finger's hold."""
        now = self.state.sample
        grid = now // GRID * GRID + GRID
        times = [grid + (_LONGEST - 1) * GRID, *(active.stop for active in self.gestures.active)]
        if (due := self.schedule.next_due) < math.inf:
            # a change is made at the last grid point before its time, which need not be a whole sample
            times.append(due // GRID * GRID)
        times += [effect.next_watch(now, self.switchings[effect.name]) for effect in self._watched]
        until = math.ceil(min(times) / GRID) * GRID
        steps = [sample for active in self.gestures.active for sample, _ in active.holds if sample > now]
        # back to the grid first: the kernel counts from where a run begins
        return min([max(until, grid) if now % GRID == 0 else grid, *steps])

    def _control(self) -> None:
        """Make the changes that are due: at a grid point bases, injections and effects, else fingers' dashpots only."""
        now = self.state.sample
        if now % GRID == 0:
            moved, fresh = self._take(now)
            self._exchange(self.connections.with_moved(self.system, self.gestures.active), "partners that come and go")
            if self._watched:
                self._switch(moved, fresh)
        holds = holds_at(self.gestures.active, now)
        if holds != self.gestures.holds:
            self.gestures.holds = holds
            self._exchange(self.connections.with_holds(self.system, holds), "holds")

    def _switch(self, moved: Collection[str], fresh: Sequence[Play]) -> None:
        """Switch effects on where they are wanted, and off where the bound on the error is within the budget."""
        busy = self.gestures.strings
        for effect in self._watched:
            before = self.switchings[effect.name]
            moment = Moment(self.system, self.state, self.frettings, self.peak, moved, fresh, busy, self._until)
            decision = effect.watch(moment, before)
            if decision is None:
                continue
            self.usage.enter(effect.name, decision.bounds)
            if self.only_watch:
                self.switchings[effect.name] = Switching(decision.wanted, until=decision.until)
                continue
            after = switch(effect, moment, before, decision)
            self.switchings[effect.name] = after
            if after.on != before.on:
                effect.reset(self.system, self.state, after.on ^ before.on)
                self._exchange(effect.apply(self.system, after.on, self.frettings), f"{effect.name} switched")

    def _until(self, string: str) -> float:
        """Seconds until the next change of a string or gesture on it, or until the sound has decayed to `tail_level`.

        After the last event the sound is taken to have fallen from its peak by so many dB per second, and to go on so.
        """
        now = self.state.sample
        if (following := self.schedule.next_of(string, now + GRID)) < math.inf:
            return (following - now) * self.dt
        since = now * self.dt - self.schedule.stop
        heard = self.peak > 0.0
        level = decibel(float((self.recent[heard] / self.peak[heard]).max(initial=0.0)))
        if since <= 0.0 or level >= 0.0 or self.tail_level == -math.inf:
            return math.inf
        return since * max(level - self.tail_level, 0.0) / -level if level > -math.inf else 0.0

    def _with_effects(self, system: System) -> System:
        """A system with every switched effect as it is; switches that are only watched stay as they began."""
        for effect in self._switched:
            switching = effect.start() if self.only_watch else self.switchings[effect.name]
            system = effect.apply(system, switching.on, self.frettings)
        return system

    def _take(self, now: int) -> tuple[Collection[str], list[Play]]:
        """Do the changes and begin the gestures that are due; returns the strings that changed, and the gestures."""
        moved, fresh = self._due(now)
        if moved or fresh:
            if moved:
                self._refret(moved)
            self.gestures.begin(fresh, moved.keys(), self.model, self.system, now, dampers=self._dampers)
        self.gestures.active = [a for a in self.gestures.active if a.stop > now]
        return moved.keys(), fresh

    def _due(self, now: int) -> tuple[dict[str, Fretting], list[Play]]:
        """Changes of strings and gestures that are due before the next point of the grid."""
        latest: dict[str, Fretting] = {}
        changes, fresh = self.schedule.take(now + GRID)
        for change in changes:
            before = latest.get(change.string, self.frettings[change.string])
            latest[change.string] = before.changed(change)
        for play in fresh:
            if play.string is not None:
                before = latest.get(play.string, self.frettings[play.string])
                if (position := play.gesture.from_bridge) is not None:
                    before = replace(before, place=position, width=play.gesture.width)
                latest[play.string] = before
                self.counters.strings_played.add(play.string)
        frettings = {name: self.fingerboard.playable(name, fretting) for name, fretting in latest.items()}
        return {name: fretting for name, fretting in frettings.items() if fretting != self.frettings[name]}, fresh

    def _refret(self, changes: Mapping[str, Fretting]) -> None:
        """Exchange the bases of strings, and project their motion to the new ones."""
        carried: dict[str, Floats] = {}
        restopped = {}
        bridge_force = bridge_forces(self.system, self.state)
        for name, fretting in changes.items():
            before = self.frettings[name]
            components = self.model.strings[name].components
            modes = {c: np.array(self.system.modes_of(self.state, c), dtype=np.float64) for c in components}
            carried |= self.fingerboard.carried(name, before, fretting, modes, bridge_force)
            if fretting.stop != before.stop:
                restopped[name] = fretting
        self.frettings |= changes
        self.system = self.fingerboard.fretted(self.system, changes, restopped)
        if restopped:
            self.system = self._with_effects(self.system)
        for component, motion in carried.items():
            self.system.room_of(self.state, component)[:] = 0.0
            self.system.modes_of(self.state, component)[:] = motion
        if restopped:
            share_velocities(self.system, self.state)
        cut_excess(self.system, self.state, carried.keys())
        self.counters.exchanges += len(changes)
        if self.energy_budget:
            self.energy_budget.changed("stops, bends and dampers", self.system, self.state)

    def _exchange(self, system: System, why: str) -> None:
        if system is not self.system:
            self.system = system
            if self.energy_budget:
                self.energy_budget.changed(why, system, self.state)
