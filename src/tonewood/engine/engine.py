"""Model, state and timeline in; sound out, on a control grid that output blocks know nothing of.

Every change (a stop, a bend, a damper) takes effect at a multiple of 64 samples counted from sample 0; a finger
tightens its hold at whole samples, and known forces act at any fraction of a sample. Where the engine stops to look
depends on what is played alone, so its samples are the same however they are asked for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.blas import one_blas_thread
from tonewood.coupling.connections import Connection
from tonewood.coupling.system import Compiled, Control, Injection, State, System
from tonewood.engine.books import Books
from tonewood.engine.fretting import Fingerboard, Fretting, pulls
from tonewood.engine.gestures import Active, courses, cut, forces, hold_steps, quasi_static, samples
from tonewood.engine.ledger import Ledger
from tonewood.engine.sleeping import Asleep, Sleeper
from tonewood.engine.surroundings import Surroundings, holds_at, string_of
from tonewood.engine.switching import LOOK, SELDOM, TensionSwitch, affordable, may_rest, string_energy
from tonewood.engine.timeline import GRID, Play, Timeline
from tonewood.instrument.assembly import Model
from tonewood.stepping.kernel import KernelStepper
from tonewood.stepping.motion import share_velocities

__all__ = ["GRID", "Engine", "Snapshot", "Ticker"]

Floats = NDArray[np.float64]


@dataclass(eq=False)
class Snapshot:
    """All that moves in an engine; restoring it continues bit for bit."""

    state: State
    frettings: dict[str, Fretting]
    active: list[Active]
    injections: list[Injection]
    controls: list[Control]
    holds: dict[str, float]
    tense: frozenset[str]
    awaited: frozenset[str]
    asleep: Asleep
    next_change: int
    next_play: int


@dataclass(eq=False)
class Ticker:
    """What an engine did, for summaries; seconds of the processor in steps and between them."""

    exchanges: int = 0
    peak_modes: int = 0
    strings_played: set[str] = field(default_factory=set)
    stepping_s: float = 0.0
    control_s: float = 0.0


class Engine:
    """Steps one model through one timeline.

    Parameters
    ----------
    model : assembled instrument.
    timeline : what happens.
    energy : keep an account of energy, in `books`; slower by far, with the same samples.
    """

    def __init__(self, model: Model, timeline: Timeline, *, energy: bool = False):
        self.model, self.timeline = model, timeline
        self.switch = TensionSwitch(model)
        #: strings whose tension rises now, and those that are to as soon as they can afford it
        self.tense = frozenset(() if self.switch.enabled else self.switch.strings)
        self.awaited: frozenset[str] = frozenset()
        self.system: System = model.system.with_tensions(self.tense)
        self.dt = self.system.dt
        self.stepper = KernelStepper(self.system)
        self.state = self.stepper.start()
        self.fingerboard, self.surroundings = Fingerboard(model), Surroundings(model)
        self.sleeper = Sleeper(model, self.fingerboard, timeline)
        self.frettings = {name: Fretting() for name in model.strings}
        self.active: list[Active] = []
        self.injections: list[Injection] = []
        self.controls: list[Control] = []
        self.holds: dict[str, float] = {}
        self._unheard: list[Floats] = []
        #: look only: no tension rises, but the ledger tells when it would
        self.watching = False
        self.ticker, self.ledger = Ticker(), Ledger(model)
        self._next_change = self._next_play = 0
        self._change_samples = [samples(change.time, self.dt) for change in timeline.changes]
        self._play_samples = [samples(play.start, self.dt) for play in timeline.plays]
        self._dampers = all(model.choice.keeps(e, "dampers") for e in model.exciters.values())
        self.state.sample = int(np.floor(timeline.start / self.dt / GRID)) * GRID
        self.sleeper.state.last = self.state.sample
        self.books = Books(self.system, self.state, model) if energy else None

    @property
    def done(self) -> bool:
        """Whether nothing more is going to happen than that the instrument rings."""
        return (
            self._next_change >= len(self._change_samples)
            and self._next_play >= len(self._play_samples)
            and not self.active
        )

    def snapshot(self) -> Snapshot:
        """Copy of all that moves; an account of energy begins anew where it is restored."""
        return Snapshot(
            self.state.copy(), dict(self.frettings), list(self.active), list(self.injections), list(self.controls),
            dict(self.holds), self.tense, self.awaited, self.sleeper.state.copy(), self._next_change, self._next_play,
        )  # fmt: skip

    @one_blas_thread
    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this engine (or of one with the same model and timeline)."""
        s = snapshot
        self.state, self.frettings, self.holds = s.state.copy(), dict(s.frettings), dict(s.holds)
        self.active, self.injections, self.controls = list(s.active), list(s.injections), list(s.controls)
        self.tense, self.awaited = s.tense, s.awaited
        self._next_change, self._next_play = s.next_change, s.next_play
        self.sleeper.state = s.asleep.copy()
        system = self._fretted(self.system.with_tensions(s.tense), self.frettings, self.frettings)
        changes: dict[str, Compiled] = {}
        for name, level in self.sleeper.sleeping.items():
            changes |= self.sleeper.compiled(name, self.frettings[name], level)
        system = system.with_compiled(changes) if changes else system
        self.system = self.surroundings.held(self.surroundings.woken(system, self.active), self.holds)
        if self.books:
            self.books = Books(self.system, self.state, self.model)

    @one_blas_thread
    def advance(self, n_ticks: int) -> Floats:
        """Step n_ticks intervals of the control grid; returns (n_ticks * GRID, n_channels)."""
        out, end = [], self.state.sample + n_ticks * GRID
        while self.state.sample < end:
            began = time.thread_time()
            self._control()
            steps = min(self._next_event(), end) - self.state.sample
            before = self.state.copy() if self.books else None
            if self.system is not self.stepper.system:
                self.stepper.exchange(self.system)
            ready = time.thread_time()
            pushes: Floats | None = None
            if self.books:
                sound, pushes = self.stepper.run(self.state, steps, self.injections, self.controls)
                acted = np.flatnonzero(np.any(pushes, axis=0))
            else:
                sound, acted = self.stepper.advance(self.state, steps, self.injections, self.controls)
            stepped = time.thread_time()
            if self.books and before and pushes is not None:
                self.books.follow(before, self.state, pushes, self.injections, self.controls, self.active)
            added = quasi_static(self.active, self.model, self.system, self.state.sample - steps, steps)
            if added is not None:
                sound = sound + added
            out.append(sound)
            touched = self.ledger.count(
                self.state.sample - steps,
                steps,
                acted,
                self.tense,
                self.holds,
                self.system,
                self._missing,
                stepped - ready,
            )
            self._unheard.append(sound)
            self.sleeper.state.touched |= touched
            self.injections = [i for i in self.injections if i.stop > self.state.sample]
            self.controls = [c for c in self.controls if c.stop > self.state.sample]
            self.ticker.stepping_s += stepped - ready
            self.ticker.control_s += ready - began + time.thread_time() - stepped
        self._hear()
        return np.concatenate(out) if out else np.zeros((0, len(self.system.readouts)))

    def _hear(self) -> None:
        """Tell the sleeper what has sounded since it was last told."""
        if (self.sleeper.worthwhile or self.switch.enabled) and self._unheard:
            self.sleeper.heard(np.concatenate(self._unheard))
        self._unheard = []

    @property
    def _look(self) -> int:
        """Samples between looks at the strings."""
        return GRID * (LOOK if self.tense else SELDOM)

    @property
    def _missing(self) -> dict[str, tuple[int, int]]:
        """Strings that sleep -> their level, and how many modes do."""
        sleeper = self.sleeper
        return {n: (level, sleeper.missing(n, self.frettings[n], level)) for n, level in sleeper.sleeping.items()}

    @property
    def _sleeps(self) -> bool:
        return self.sleeper.promising(self.state.sample, self._pending * self.dt)

    @property
    def _pending(self) -> float:
        """Sample at which the next change or gesture is due; infinite if none is."""
        changes, plays = self._change_samples, self._play_samples
        change = changes[self._next_change] if self._next_change < len(changes) else math.inf
        return min(change, plays[self._next_play]) if self._next_play < len(plays) else change

    def _next_event(self) -> int:
        """First sample after now at which something has to be looked at: a grid point, or a finger's next step."""
        now = self.state.sample
        grid = now // GRID * GRID + GRID
        times = [grid + 63 * GRID, *(active.stop for active in self.active)]
        if self._pending < math.inf:
            # a thing is done at the last grid point before its time, which need not be a whole sample
            times.append(self._pending // GRID * GRID)
        if self.switch.enabled:
            times.append(grid if self.awaited else now // self._look * self._look + self._look)
        if self._sleeps:
            times.append(self.sleeper.state.following)
        due = math.ceil(min(times) / GRID) * GRID
        steps = [sample for active in self.active for sample, _ in active.holds if sample > now]
        # back to the grid first: the kernel counts from where a run begins
        return min([max(due, grid) if now % GRID == 0 else grid, *steps])

    def _control(self) -> None:
        """Take what is due: at a grid point bases and injections are exchanged, between them fingers' dashpots only."""
        now = self.state.sample
        if now % GRID == 0:
            before = len(self.active)
            moved, fresh = self._take(now)
            over = len(self.active) < before + len(fresh)
            self._exchange(self.surroundings.woken(self.system, self.active), "partners that come and go")
            if self.switch.enabled:
                self._switch(now, moved, fresh)
            if (fresh or over or now >= self.sleeper.state.following) and self._sleeps:
                self._look_after_sleepers(now, fresh)
        wanted = holds_at(self.active, now)
        if wanted != self.holds:
            self.holds = wanted
            self._exchange(self.surroundings.held(self.system, wanted), "holds")

    def _switch(self, now: int, moved: Collection[str], fresh: Sequence[Play]) -> None:
        """Let tensions rise that gestures or what moves call for, and leave out those that do not matter."""
        switch = self.switch
        whole, look = now % (GRID * SELDOM) == 0, now % self._look == 0
        moved = [name for name in moved if name in switch.strings]
        fresh = [play for play in fresh if play.string in switch.strings]
        if not (whole or look or moved or fresh or self.awaited):
            return
        energies = dict(zip(switch.strings, switch.energies(self.system, self.state).tolist(), strict=True))
        wanted = self.tense | self.awaited
        self._hear()
        peak = self.sleeper.state.peak
        if whole or look or moved:
            names = switch.strings if whole else moved
            cents, levels = switch.bounds(self.system, self.state, self.frettings, energies, peak, names)
            busy = {a.play.string or "" for a in self.active} if whole else switch.strings
            wanted = switch.wanted(cents, levels, wanted, busy)
            self.ledger.rises(cents, levels, wanted)
        for play in fresh:
            name = play.string or ""
            rise, level = switch.foreseen(play, self.system, self.state, self.frettings[name], energies[name], peak)
            if rise > switch.budget or level > switch.budget_level:
                wanted |= {name}
            self.ledger.rise(name, rise, level, name not in wanted)
        if self.watching:
            self.tense = wanted
            return
        admitted = {name for name in wanted - self.tense if affordable(self.system, self.state, name)}
        resting = {name for name in self.tense - wanted if may_rest(self.system, self.state, name)}
        tense = (self.tense - resting) | admitted
        self.awaited = wanted - tense
        if tense != self.tense:
            if self.system.tensions:
                self.state.tension[[name in tense ^ self.tense for name in self.switch.strings]] = 0.0
            self.tense = tense
            self._exchange(self.system.with_tensions(tense), "tension let rise or left out")

    def _take(self, now: int) -> tuple[Collection[str], list[Play]]:
        """Hold strings as they are due to be held, and begin the gestures due to begin; both are returned."""
        moved, fresh = self._due(now)
        if moved or fresh:
            self._touch(moved, fresh, now)
        self.active = [a for a in self.active if a.stop > now]
        return moved.keys(), fresh

    def _touch(self, moved: Mapping[str, Fretting], fresh: Sequence[Play], now: int) -> None:
        """Hold strings otherwise, and begin gestures."""
        taken = {play.string for play in fresh if play.string is not None}
        called = taken | moved.keys()
        if risen := {name: 0 for name in self.sleeper.sleeping if name in called}:
            self._rest(risen)
        if moved:
            self._refret(moved)
        # a string is held by one finger at a time: a new gesture ends the one before it; a gesture whose string changed
        # under it is compiled anew for what is left of it
        again = [a.play for a in self.active if a.play.string in moved.keys() - taken]
        self.active = [a for a in self.active if a.play.string not in taken]
        self.injections = [cut(i, now) if string_of(i.component) in called else i for i in self.injections]
        self.injections = [i for i in self.injections if i.stop > max(now, i.start)]
        self.controls = [c for c in self.controls if string_of(c.connection) not in called]
        for play in (*again, *fresh):
            self.injections += forces(play, self.model, self.system, now)
            self.controls += courses(play, self.dt, now)
        for play in fresh:
            holds = hold_steps(play, self.dt) if self._dampers else ()
            self.active.append(Active(play, samples(play.stop, self.dt), holds))

    def _due(self, now: int) -> tuple[dict[str, Fretting], list[Play]]:
        """Strings that are to be held otherwise, and gestures that begin, before the next point of the grid."""
        wanted: dict[str, Fretting] = {}
        changes, plays = self.timeline.changes, self.timeline.plays
        while self._next_change < len(changes) and self._change_samples[self._next_change] < now + GRID:
            change = changes[self._next_change]
            before = wanted.get(change.string, self.frettings[change.string])
            wanted[change.string] = before.changed(change)
            self._next_change += 1
        fresh: list[Play] = []
        while self._next_play < len(plays) and self._play_samples[self._next_play] < now + GRID:
            play = plays[self._next_play]
            self._next_play += 1
            fresh.append(play)
            if play.string is not None:
                before = wanted.get(play.string, self.frettings[play.string])
                wanted[play.string] = replace(before, place=play.gesture.from_bridge)
                self.ticker.strings_played.add(play.string)
        frettings = {name: self.fingerboard.playable(name, fretting) for name, fretting in wanted.items()}
        return {name: fretting for name, fretting in frettings.items() if fretting != self.frettings[name]}, fresh

    def _refret(self, wanted: Mapping[str, Fretting]) -> None:
        """Give strings other bases and carry their motion over."""
        carried: dict[str, Floats] = {}
        restopped = {}
        pull = pulls(self.system, self.state)
        for name, fretting in wanted.items():
            before = self.frettings[name]
            components = self.model.strings[name].components
            modes = {c: np.array(self.system.modes_of(self.state, c), dtype=np.float64) for c in components}
            carried |= self.fingerboard.carried(name, before, fretting, modes, pull)
            if fretting.stop != before.stop:
                restopped[name] = fretting
        self.frettings |= wanted
        self.system = self._fretted(self.system, wanted, restopped)
        self._put(carried)
        if restopped:
            share_velocities(self.system, self.state)
        self.ticker.exchanges += len(wanted)
        if self.books:
            self.books.changed("stops, bends and dampers", self.system, self.state)

    def _put(self, carried: Mapping[str, Floats]) -> None:
        """Write the motion of components that have other bases now."""
        for component, modes in carried.items():
            slot = self.system.slot(component)
            start = self.system.offsets[slot]
            self.state.modes[:, start : start + self.system.capacities[slot]] = 0.0
            self.system.modes_of(self.state, component)[:] = modes

    def _look_after_sleepers(self, now: int, fresh: Sequence[Play]) -> None:
        """Let bands of strings fall asleep that are not heard, and wake those that might be."""
        self._hear()
        plays = [active.play for active in self.active]
        if self.sleeper.shaken(now, plays):
            wanted = self.sleeper.all_awake(now)
        else:
            busy = {play.string or "" for play in plays} | set(self.holds)
            wanted = self.sleeper.look(now, self.system, self.state, self.frettings, busy, self.tense, fresh)
        self.sleeper.state.touched = False
        self.ledger.unheard = self.sleeper.largest
        if wanted:
            self._rest(wanted)

    def _rest(self, levels: Mapping[str, int]) -> None:
        """Take strings to other levels of sleep."""
        changes: dict[str, Compiled] = {}
        carried: dict[str, Floats] = {}
        stored = {
            name: sum(string_energy(self.system, self.state, name))
            for name in levels
            if name in self.tense and not self.watching
        }
        deeper = {name for name, level in levels.items() if level > self.sleeper.state.level[name]}
        for name, level in levels.items():
            modes = {
                c: np.array(self.system.modes_of(self.state, c), dtype=np.float64)
                for c in self.model.strings[name].components
            }
            carried |= self.sleeper.carried(name, self.frettings[name], level, modes)
            changes |= self.sleeper.compiled(name, self.frettings[name], level)
            self.sleeper.moved(name, level)
        self.system = self.system.with_compiled(changes)
        self._put(carried)
        if deeper:
            joints = [string_of(c.name) in deeper and c.name.endswith(".bridge") for c in self.system.connections]
            share_velocities(self.system, self.state, np.array(joints, dtype=bool))
        # a string's stretch is not quite the same for fewer modes: what it takes more is paid, or waited for
        poor = set()
        for name, before in stored.items():
            if not affordable(self.system, self.state, name, before - string_energy(self.system, self.state, name)[0]):
                poor.add(name)
        if poor:
            self.tense -= poor
            self.awaited |= poor
            self.system = self.system.with_tensions(self.tense)
        self.ticker.exchanges += len(levels)
        if self.books:
            self.books.changed("strings that sleep and wake", self.system, self.state)

    def _fretted(self, system: System, frettings: Mapping[str, Fretting], restopped: Mapping[str, Fretting]) -> System:
        """A system with strings held like this; `restopped` ones get the laws of their stop, too."""
        changes: dict[str, Compiled] = {}
        laws: dict[str, Connection] = {}
        for name, fretting in frettings.items():
            changes |= self.fingerboard.bases(name, fretting)
        for name, fretting in restopped.items():
            laws |= self.fingerboard.laws(name, fretting)
        changed = system.with_compiled(changes)
        return changed.with_laws(laws) if laws else changed

    def _exchange(self, system: System, why: str) -> None:
        if system is not self.system:
            self.system = system
            if self.books:
                self.books.changed(why, system, self.state)
