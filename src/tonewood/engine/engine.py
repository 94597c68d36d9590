"""Model, state and timeline in; sound out, on a control grid that output blocks know nothing of.

Every change (a stop, a bend, a damper) takes effect at a multiple of 64 samples counted from sample 0; a finger
tightens its hold at whole samples, and known forces act at any fraction of a sample. Where the engine stops to look
depends on what is played alone, so its samples are the same however they are asked for.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.engine.timeline import Change, Play, Timeline
from tonewood.instrument.assembly import Model
from tonewood.numerics.connections import Connection, Rigid, SpringDashpot, scaled_pinv
from tonewood.numerics.forcing import Piece, compile_force
from tonewood.numerics.kernel import KernelStepper
from tonewood.numerics.modes import ModalBasis
from tonewood.numerics.motion import from_motion, share_velocities, to_motion
from tonewood.numerics.stored_energy import gaps
from tonewood.numerics.system import Compiled, Control, Injection, State, System

Floats = NDArray[np.float64]

#: samples between two points of the control grid
GRID = 64
#: a finger's growing dashpot is followed in this many steps
_HOLD_LEVELS = 3
#: compiled stops that are kept for use again
_CACHE = 96


@dataclass(frozen=True, slots=True)
class Fretting:
    """How a string is held now: stop, bend in cents, added damping (1/s), place of the plucking finger (m)."""

    stop: float = 0.0
    cents: float = 0.0
    added_damping: float = 0.0
    place: float | None = None


@dataclass(frozen=True, slots=True)
class Active:
    """A gesture in progress, and from which sample on its finger damps the string how much (N s/m)."""

    play: Play
    holds: tuple[tuple[int, float], ...] = ()


@dataclass(eq=False)
class Snapshot:
    """All that moves in an engine; restoring it continues bit for bit."""

    state: State
    frettings: dict[str, Fretting]
    active: list[Active]
    injections: list[Injection]
    controls: list[Control]
    holds: dict[str, float]
    next_change: int
    next_play: int


@dataclass(eq=False)
class Ticker:
    """What an engine did, for summaries."""

    exchanges: int = 0
    peak_modes: int = 0
    strings_played: set[str] = field(default_factory=set)


class Engine:
    """Steps one model through one timeline.

    Parameters
    ----------
    model : assembled instrument.
    timeline : what happens.
    precision : ``f64`` or ``f32``.
    """

    def __init__(self, model: Model, timeline: Timeline, *, precision: str = "f64"):
        self.model, self.timeline = model, timeline
        self.system: System = model.system
        self.stepper = KernelStepper(self.system, precision=precision)
        self.state = self.stepper.start()
        self.frettings = {name: Fretting() for name in model.strings}
        self.active: list[Active] = []
        self.injections: list[Injection] = []
        self.controls: list[Control] = []
        self.holds: dict[str, float] = {}
        self.ticker = Ticker()
        self._next_change = self._next_play = 0
        self._compiled: dict[tuple[str, Fretting], dict[str, Compiled]] = {}
        dt = self.system.dt
        self.state.sample = int(np.floor(timeline.start / dt / GRID)) * GRID

    @property
    def done(self) -> bool:
        """Whether nothing more is going to happen than that the instrument rings."""
        return (
            self._next_change >= len(self.timeline.changes)
            and self._next_play >= len(self.timeline.plays)
            and not self.active
        )

    def snapshot(self) -> Snapshot:
        """Copy of all that moves."""
        return Snapshot(
            self.state.copy(), dict(self.frettings), list(self.active), list(self.injections), list(self.controls),
            dict(self.holds), self._next_change, self._next_play,
        )  # fmt: skip

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this engine (or of one with the same model and timeline)."""
        s = copy.copy(snapshot)
        self.state = s.state.copy()
        self.active, self.injections, self.controls = list(s.active), list(s.injections), list(s.controls)
        self._next_change, self._next_play = s.next_change, s.next_play
        changes: dict[str, Compiled] = {}
        laws: dict[str, Connection] = {}
        for name, fretting in s.frettings.items():
            changes |= self._bases(name, fretting)
            laws |= self._laws(name, fretting)
        self.frettings, self.holds = dict(s.frettings), dict(s.holds)
        self.system = self._held(self._woken(_with(self.system, changes, laws)))
        self.stepper.exchange(self.system)

    def advance(self, n_ticks: int) -> Floats:
        """Step n_ticks intervals of the control grid; returns (n_ticks * GRID, n_channels)."""
        out, end = [], self.state.sample + n_ticks * GRID
        while self.state.sample < end:
            self._control()
            steps = min(self._next_event(), end) - self.state.sample
            out.append(self.stepper.run(self.state, steps, self.injections, self.controls)[0])
            self.injections = [i for i in self.injections if i.stop > self.state.sample]
            self.controls = [c for c in self.controls if c.stop > self.state.sample]
        return np.concatenate(out) if out else np.zeros((0, len(self.system.readouts)))

    def _next_event(self) -> int:
        """First sample after now at which something has to be looked at: a grid point, or a finger's next step."""
        now = self.state.sample
        grid = now // GRID * GRID + GRID
        times = []
        # a thing is done at the last grid point before its time
        if self._next_change < len(self.timeline.changes):
            times.append(self._samples(self.timeline.changes[self._next_change].time) - GRID + 1)
        if self._next_play < len(self.timeline.plays):
            times.append(self._samples(self.timeline.plays[self._next_play].start) - GRID + 1)
        times += [self._samples(active.play.stop) for active in self.active]
        due = int(np.ceil(min(times) / GRID)) * GRID if times else grid + 63 * GRID
        steps = [sample for active in self.active for sample, _ in active.holds if sample > now]
        return min([max(due, grid), *steps])

    def _samples(self, time: float) -> float:
        """Time in samples, rid of the rounding that would put it on the wrong side of a grid point."""
        return round(time / self.system.dt, 6)

    def _control(self) -> None:
        """Take what is due: at a grid point bases and injections are exchanged, between them fingers' dashpots only."""
        now = self.state.sample
        if now % GRID == 0:
            self._take(now)
            self._wake()
        self._hold(now)

    def _take(self, now: int) -> None:
        wanted = dict(self.frettings)
        changes, plays = self.timeline.changes, self.timeline.plays
        while self._next_change < len(changes) and self._samples(changes[self._next_change].time) < now + GRID:
            change = changes[self._next_change]
            wanted[change.string] = _changed(wanted[change.string], change)
            self._next_change += 1
        fresh: list[Play] = []
        while self._next_play < len(plays) and self._samples(plays[self._next_play].start) < now + GRID:
            play = plays[self._next_play]
            self._next_play += 1
            fresh.append(play)
            if play.string is not None:
                wanted[play.string] = replace(wanted[play.string], place=play.gesture.from_bridge)
                self.ticker.strings_played.add(play.string)
        moved = {name for name in wanted if wanted[name] != self.frettings[name]}
        if moved:
            self._refret({name: self._playable(name, wanted[name]) for name in moved})
        # a string is held by one finger at a time: a new gesture ends the one before it; a gesture whose string changed
        # under it is compiled anew for what is left of it
        taken = {play.string for play in fresh if play.string is not None}
        again = [a.play for a in self.active if a.play.string in moved - taken]
        self.active = [a for a in self.active if a.play.string not in taken]
        self.injections = [
            _cut(i, now) if _string_of(i.component) in moved | taken else i for i in self.injections
        ]  # fmt: skip
        self.injections = [i for i in self.injections if i.stop > max(now, i.start)]
        self.controls = [c for c in self.controls if _string_of(c.connection) not in moved | taken]
        for play in again + fresh:
            self.injections += self._compile(play, now)
            self.controls += self._moved(play, now)
        self.active += [Active(play, self._hold_steps(play)) for play in fresh]
        self.active = [a for a in self.active if self._samples(a.play.stop) > now]

    def _playable(self, name: str, fretting: Fretting) -> Fretting:
        """The finger's place only where it lies on the string's speaking part."""
        if fretting.place is not None and fretting.place > self.model.strings[name].length(fretting.stop):
            return replace(fretting, place=None)
        return fretting

    def _refret(self, wanted: dict[str, Fretting]) -> None:
        """Give strings other bases and carry their motion over."""
        changes: dict[str, Compiled] = {}
        laws: dict[str, Connection] = {}
        restopped = False
        carried: list[tuple[str, Floats]] = []
        pulls = self._pulls()
        for name, fretting in wanted.items():
            before = self._whole(name, self.frettings[name])
            after = self._whole(name, fretting)
            for component, compiled in self._bases(name, fretting).items():
                old = self.system.compiled[self.system.slot(component)].basis
                modes = np.array(self.system.modes_of(self.state, component), dtype=np.float64)
                if fretting.stop != self.frettings[name].stop:
                    restopped = True
                    q, v = to_motion(before[component], _carried(old, before[component], modes, pulls[component]))
                    transfer = self.model.strings[name].transfer(component, before[component], after[component])
                    q, v = (matrix @ motion for matrix, motion in zip(transfer, (q, v), strict=True))
                    n = compiled.basis.n_modes
                    modes = from_motion(compiled.basis, q[:n], v[:n])
                else:
                    modes = _carried(old, compiled.basis, modes, pulls[component])
                changes[component] = compiled
                carried.append((component, modes))
            if fretting.stop != self.frettings[name].stop:
                laws |= self._laws(name, fretting)
            self.frettings[name] = fretting
        self.system = _with(self.system, changes, laws)
        for component, modes in carried:
            slot = self.system.slot(component)
            start = self.system.offsets[slot]
            self.state.modes[:, start : start + self.system.capacities[slot]] = 0.0
            self.system.modes_of(self.state, component)[:] = modes
        if restopped:
            share_velocities(self.system, self.state)
        self.ticker.exchanges += len(wanted)
        self.stepper.exchange(self.system)

    def _pulls(self) -> dict[str, float]:
        """Component -> force of its bridge on a string's end, as the residual compliance holds it (N)."""
        rigid = np.array([isinstance(c.law, Rigid) for c in self.system.connections], dtype=bool)
        R = self.system.gap_matrix("residual")[np.ix_(rigid, rigid)]
        force = -scaled_pinv(R) @ gaps(self.system, self.state)[rigid]
        held = [c.terms[0].component for c, on in zip(self.system.connections, rigid, strict=True) if on]
        return dict(zip(held, force.tolist(), strict=True))

    def _whole(self, name: str, fretting: Fretting) -> dict[str, ModalBasis]:
        """Bases with the modes that lie above the limit at this tension."""
        compiled = {c: part.basis for c, part in self._bases(name, fretting).items()}
        string = self.model.strings[name]
        if all(basis.n_modes == string.n_modes(fretting.stop) for basis in compiled.values()):
            return compiled
        return string.bases(fretting.stop, bend_cents=fretting.cents, whole=True)

    def _bases(self, name: str, fretting: Fretting) -> dict[str, Compiled]:
        key = (name, fretting)
        if key not in self._compiled:
            string = self.model.strings[name]
            bases = string.bases(
                fretting.stop,
                bend_cents=fretting.cents,
                added_damping=fretting.added_damping,
                pluck_from_bridge=fretting.place,
            )
            if len(self._compiled) >= _CACHE:
                self._compiled.pop(next(iter(self._compiled)))
            self._compiled[key] = {c: self.system.compile(c, basis) for c, basis in bases.items()}
        return self._compiled[key]

    def _compile(self, play: Play, now: int) -> list[Injection]:
        pieces = [Piece(s.start, s.stop, s.c0, s.c1, s.c2) for s in play.gesture.segments]
        if play.string is None or play.gesture.on is not None:
            where = self.model.inputs[play.gesture.on or play.at or ""]
        else:
            weights = self.model.strings[play.string].weights(play.gesture.angle_deg)
            where = tuple((component, "pluck", weight) for component, weight in weights.items())
        out: list[Injection] = []
        for component, point, factor in where:
            basis = self.system.compiled[self.system.slot(component)].basis
            out += compile_force(
                component, basis, point, pieces, self.system.dt, time=play.time, first=now, factor=factor
            )
        return out

    def _laws(self, name: str, fretting: Fretting) -> dict[str, Connection]:
        """Laws of what always touches a string, at its stop."""
        touching = self.model.strings[name].connections(fretting.stop)
        return {c.name: c for c in touching if c.name not in self.model.resting}

    def _moved(self, play: Play, now: int) -> list[Control]:
        """The course of a gesture's partners, sample by sample from `now` until the gesture is looked at as over."""
        dt, out = self.system.dt, []
        for motion in play.gesture.motions:
            if not motion.segments:
                continue
            n = max(math.ceil(self._samples(play.stop) / GRID) * GRID - now, 0)
            # an offset is wanted at both ends of every step, the others as means: at its middle
            if motion.quantity == "offset":
                times = (now + np.arange(n + 1)) * dt - play.time
            else:
                times = (now + np.arange(n) + 0.5) * dt - play.time
            values = motion.course(times)
            out.append(Control(motion.connection, now, **{motion.quantity: values}))
        return out

    def _hold_steps(self, play: Play) -> tuple[tuple[int, float], ...]:
        """The finger's growing dashpot in a few steps, each at the sample where the smooth one passes between them.

        A finger that drags a string along pushes it; steps on the control grid would make the sound depend on the
        phase of the grid by -31 dB.
        """
        hold = play.gesture.hold
        if hold is None or play.string is None:
            return ()
        shares = (np.arange(_HOLD_LEVELS) + 0.5) / _HOLD_LEVELS
        rise = 0.5 - np.sin(np.arcsin(1 - 2 * shares) / 3)  # of the smooth step 3 s^2 - 2 s^3
        times = [*(hold.start + rise * (hold.grown - hold.start)), hold.stop]
        sizes = [*(np.arange(1, _HOLD_LEVELS + 1) / _HOLD_LEVELS * hold.damping), 0.0]
        return tuple(
            (math.floor(self._samples(play.time + t)), float(size)) for t, size in zip(times, sizes, strict=True)
        )

    def _hold(self, now: int) -> None:
        """Set the dashpots of the fingers that hold strings now."""
        wanted: dict[str, float] = {}
        for active in self.active:
            reached = [size for sample, size in active.holds if sample <= now]
            if reached and reached[-1] > 0 and active.play.string is not None:
                wanted[active.play.string] = reached[-1]
        if wanted != self.holds:
            self.holds = wanted
            self.system = self._held(self.system)
            self.stepper.exchange(self.system)

    def _wake(self) -> None:
        """Let connections that gestures move take effect, and those that no gesture moves any more rest."""
        system = self._woken(self.system)
        if system is not self.system:
            self.system = system
            self.stepper.exchange(system)

    def _woken(self, system: System) -> System:
        resting = self.model.resting
        wanted = {m.connection for a in self.active for m in a.play.gesture.motions}
        laws = {}
        for connection in system.connections:
            if connection.name in resting:
                asleep = replace(connection, law=SpringDashpot())
                law = resting[connection.name] if connection.name in wanted else asleep
                if law.law != connection.law:
                    laws[connection.name] = law
        return system.with_laws(laws) if laws else system

    def _held(self, system: System) -> System:
        laws = {}
        for connection in system.connections:
            if connection.name.endswith(".hold"):
                string = connection.name.split(".")[0]
                law = SpringDashpot(damping=self.holds.get(string, 0.0))
                if law != connection.law:
                    laws[connection.name] = replace(connection, law=law)
        return system.with_laws(laws) if laws else system


def _with(system: System, bases: dict[str, Compiled], laws: dict[str, Connection]) -> System:
    changed = system.with_compiled(bases)
    return changed.with_laws(laws) if laws else changed


def _changed(fretting: Fretting, change: Change) -> Fretting:
    return replace(
        fretting,
        stop=fretting.stop if change.stop is None else change.stop,
        cents=fretting.cents if change.cents is None else change.cents,
        added_damping=fretting.added_damping if change.added_damping is None else change.added_damping,
    )


def _carried(old: ModalBasis, new: ModalBasis, modes: Floats, pull: float) -> Floats:
    """Numbers of the same shapes at other frequencies or decay rates.

    Modes that leave the basis take their energy along and leave their compliance in the residual. Modes that come
    back are bent as the residual was under the `pull` on the string's end (N), so that no energy comes with them.
    """
    n = min(old.n_modes, new.n_modes)
    if old.n_modes == new.n_modes and np.array_equal(old.poles, new.poles):
        return modes
    q, v = to_motion(old, modes)
    full_q, full_v = np.zeros(new.n_modes), np.zeros(new.n_modes)
    full_q[:n], full_v[:n] = q[:n], v[:n]
    if new.n_modes > n:
        end, old_end = new.index("bridge"), old.index("bridge")
        shape = new.right[end, n:].real
        static = shape / new.stiffness[n:]
        softer = old.residual[old_end, old_end] - new.residual[end, end]
        full_q[n:] = static * (pull * softer / (shape @ static))
    return from_motion(new, full_q, full_v)


def _string_of(name: str) -> str:
    """STRING of ``STRING.y`` and ``STRING.PART.NAME``."""
    return name.partition(".")[0]


def _cut(injection: Injection, sample: int) -> Injection:
    keep = max(0, min(sample - injection.start, injection.values.shape[1]))
    return replace(injection, values=injection.values[:, :keep])
