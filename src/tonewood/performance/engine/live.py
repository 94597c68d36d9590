"""Notes as they come to actions of hands: the causal counterpart of `playing`.

Every action is entered at the next point of the control grid, GRID samples apart, so that the samples depend only on
the actions and on the samples after which they came:

- A note begins at that point with the preparation of its gesture, shortened to `ramp`; it sounds when this is over.
- One thing is done at a point, so that none costs more than a block has time for: notes first, `spacing` points apart
  (twice that after one in an unusual way), then slides and strings let go, ends of notes, bends.
- A bend follows its wheel at no more than the greatest rate, one string at a time: the farthest from its wheel.
- A gesture that lasts as long as its note (a bow's stroke) is continued `_CONTINUED` s ahead while the key is down.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from tonewood.errors import ScoreError, TonewoodError
from tonewood.instrument.contract.gestures import Event, Place
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_number
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.hands import LET_GO_AFTER, damping, laid_on, let_go, not_live, touch_at_end
from tonewood.performance.player.live_dampers import LiveDampers
from tonewood.performance.player.live_state import LiveCounters, PlayedString, Voice
from tonewood.performance.player.note_events import event_values, exciter_of, force_of, gripped, hurried, is_where_asked
from tonewood.performance.player.playing import BEND_RATE, playable
from tonewood.performance.player.techniques import stop_course, touch_course
from tonewood.performance.player.timeline import Change, Play
from tonewood.performance.player.variation import Deviates, touched
from tonewood.performance.score.causal import PEDALLED, CausalAssignment, Sounding
from tonewood.performance.score.note import Dropped, Note, ignored_name
from tonewood.support.validation_messages import did_you_mean

#: s, by which a gesture that lasts as long as its note is known ahead, and the shortest note
_CONTINUED, _SHORTEST = 0.25, 0.02
#: compiled ways to hold a string that are kept, besides those of `prepare`
_ROOM = 256
#: notes of one key that were struck and not released; more of them release the first
_STRUCK = 8
#: points of the grid that are stepped at once while nothing is to be done
_IDLE = 64
#: m, to which places that controllers ask for are rounded: bases of strings are made once per place
_GRAIN = 5e-3


class LivePlayer:
    """Plays an engine's instrument from notes and controllers as they come.

    Parameters
    ----------
    model, engine : to play; the engine's timeline is empty.
    ramp : s, longest preparation of a pluck.
    spacing : points of the control grid between beginnings of notes that come together.
    channel_per_string : notes of the first channel go to the first string, and so on.
    capo : stop at which all strings are held that no finger stops, 0 for none. Stops of notes are counted from the nut.
    """

    def __init__(
        self,
        model: Model,
        engine: Engine,
        *,
        ramp: float,
        spacing: int = 2,
        channel_per_string: bool = False,
        capo: int = 0,
    ):
        self.model, self.engine = model, engine
        self.ramp, self.spacing, self.capo = ramp, spacing, capo
        self.counters = LiveCounters()
        self.counters.ignored.update(not_live(model))
        self._assignment = CausalAssignment(
            playable(model, capo), channel_per_string=channel_per_string, tuning=model.instrument.tuning
        )
        engine.fingerboard.room = max(engine.fingerboard.room, _ROOM)
        self.dampers = LiveDampers(model)
        engine.schedule.add(laid_on(engine.timeline.start, model))
        self._keys = {float(note_number(k)): name for k, name in model.playing.keyswitches.items()}
        self._lines = {name: PlayedString(stop=float(capo)) for name in model.strings}
        if capo:
            engine.schedule.add([Change(0.0, name, stop=capo) for name in model.strings])
        self._waiting: deque[Voice] = deque()
        self._held: dict[tuple[int, float], list[Voice]] = {}
        self._pedalled: dict[tuple[int, float], Voice] = {}
        self._ending: list[Voice] = []
        #: notes that the pedal holds, released before their dampers were off the strings for the shortest time
        self._falling: list[Voice] = []
        #: (string, stop, values) of ways to pluck that are compiled while nothing else is to be done
        self._to_compile: deque[tuple[str, int, Mapping[str, float]]] = deque()
        self._controls: dict[tuple[int, str], float] = {}
        self._techniques: dict[int, str] = {}
        #: technique -> whether its gesture lasts as long as the note
        self._sustained: dict[str, bool] = {}
        self._free_at = self._bend_at = 0
        self._number = 0
        self._read = frozenset({*model.playing.controls, *model.playing.switches, "cc7", "cc11", "cc64"})
        self._read |= self.dampers.kinds

    def note_on(self, note: Note) -> Voice | None:
        """Begin a note at the next point of the grid; None if it is a keyswitch or cannot be played.

        Raises
        ------
        ScoreError : the instrument has no such technique.
        """
        channel = note.channel or 0
        if note.note in self._keys and note.string is None:
            self._techniques[channel] = self._keys[note.note]
            return None
        voice = Voice(self._number, self._with_technique(note))
        self._number += 1
        if note.note is not None:
            if (before := self._pedalled.pop((channel, note.note), None)) is not None:
                self._end(before)
            held = self._held.setdefault((channel, note.note), [])
            held.append(voice)
            if len(held) > _STRUCK:
                self.release(held[0])
        self._waiting.append(voice)
        return voice

    def note_off(self, note: float, channel: int = 0) -> bool:
        """Release the key that was struck first of those of this pitch on the channel; whether there was one."""
        held = self._held.get((channel, note))
        if not held:
            return False
        self.release(held[0])
        return True

    def release(self, voice: Voice) -> None:
        """Release the key of a note; the pedal may hold it on."""
        if not voice.key_down:
            return
        voice.key_down = False
        channel, key = voice.note.channel or 0, voice.note.note
        if key is not None:
            held = self._held[channel, key]
            held.remove(voice)
            if not held:
                del self._held[channel, key]
        if voice.string is not None and not self._is_young(voice, self.engine.state.sample):
            self.dampers.release(voice.string)
        if self._controls.get((channel, "cc64"), 0.0) >= 0.5 and key is not None:
            if (before := self._pedalled.get((channel, key))) is not None:
                self._end(before)
            voice.pedalled = True
            self._pedalled[channel, key] = voice
            self._falling.append(voice)
        else:
            self._ending.append(voice)

    def control(self, kind: str, value: float, channel: int = 0) -> None:
        """Move a controller, ``ccN`` or ``channel_pressure``, to a value from 0 to 1."""
        if kind not in self._read:
            self.counters.ignored[ignored_name(kind)] += 1
            return
        self._controls[channel, kind] = value
        if kind in self.dampers.kinds:
            self.dampers.control(kind, value, channel)
        if kind == "cc64" and value < 0.5:
            self.lift_pedal(channel)
        moved = self.model.playing.controls.get(kind)
        if moved is not None and moved.parameter == f"{self.model.default_exciter}.from_bridge":
            # while nothing else is to be done; the samples do not depend on it
            place = {"from_bridge": _rounded(moved.value(value))}
            self._to_compile = deque((name, stop, place) for name, stop in self._places())

    def lift_pedal(self, channel: int) -> None:
        """End the notes that only the pedal holds."""
        for at in [at for at in self._pedalled if at[0] == channel]:
            self._end(self._pedalled.pop(at))

    def bend(self, cents: float, channel: int | None = None) -> None:
        """Bend the notes of a channel, or all, to so many cents above their pitches; rounded to a whole one."""
        for at in range(16) if channel is None else (channel,):
            self._controls[at, "bend"] = round(cents)
        for line in self._lines.values():
            if line.voice is not None and channel in (None, line.voice.note.channel or 0):
                line.wanted = self._cents(line.voice)

    def all_off(self, channel: int | None = None, *, pedalled: bool = False) -> None:
        """Release all keys of a channel, or of all; with `pedalled` also the notes that the pedal holds."""
        for at in [at for at in self._held if channel in (None, at[0])]:
            for voice in list(self._held.get(at, ())):
                self.release(voice)
        for at in [at for at in self._pedalled if pedalled and channel in (None, at[0])]:
            self._end(self._pedalled.pop(at))

    @property
    def idle_points(self) -> int:
        """Points of the grid that may be stepped at once: 1 where something is to be done at the next."""
        busy = (
            self._waiting
            or self._ending
            or self._falling
            or self._to_compile
            or self.dampers.pending
            or any(
                line.later or line.cents != line.wanted or self._is_sustained(line.voice)
                for line in self._lines.values()
            )
        )
        return 1 if busy else _IDLE

    @property
    def n_sounding(self) -> int:
        """Strings with a note whose key or pedal is held."""
        return sum(line.voice is not None for line in self._lines.values())

    def tick(self) -> None:
        """Enter into the engine's schedule the events due at the point of the grid that it has reached."""
        now = self.engine.state.sample
        for line in self._lines.values():
            if self._is_sustained(line.voice):
                self._continue(line.voice, now)
        self._let_fall(now)
        self.engine.schedule.add([replace(change, time=now * self.engine.dt) for change in self.dampers.pending])
        self.dampers.pending.clear()
        if self._waiting and now >= self._free_at:
            self._begin(now)
        elif not self._follow(now) and not self._end_one(now) and now >= self._bend_at and not self._bend_one(now):
            self._compile_one(now)

    def _follow(self, now: int) -> bool:
        """Make one change that was planned: of a slide, or to let a damped string go; whether there was one."""
        due = [line for line in self._lines.values() if line.later and line.later[0][0] <= now]
        if not due:
            return False
        line = min(due, key=lambda line: line.later[0][0])
        _, change = line.later.popleft()
        line.stop = line.stop if change.stop is None else change.stop
        if change.cents is not None:
            line.cents = line.wanted = change.cents
        self._change(now, change)
        return True

    def _let_fall(self, now: int) -> None:
        """Let the dampers fall of notes that are released and held by the pedal, as far as it lets them."""
        for voice in list(self._falling):
            if voice in self._waiting or (voice.string is not None and self._is_young(voice, now)):
                continue
            self._falling.remove(voice)
            if voice.string is not None:
                self.dampers.release(voice.string)

    def _end_one(self, now: int) -> bool:
        """End the first of the notes that were let go; whether there was one that sounds."""
        for voice in list(self._ending):
            if voice in self._waiting or (voice.string is not None and self._is_young(voice, now)):
                continue
            self._ending.remove(voice)
            if voice.string is not None:
                self._finish(voice, now)
                return True
        return False

    def _with_technique(self, note: Note) -> Note:
        """The note with the technique that it names, or that keys and controllers ask for."""
        channel = note.channel or 0
        technique = note.technique or self._techniques.get(channel)
        for kind, name in self.model.playing.switches.items():
            if note.technique is None and self._controls.get((channel, kind), 0.0) >= 0.5:
                technique = name
        if technique is not None and technique not in self.model.exciters:
            names = f"{did_you_mean(technique, self.model.exciters)}there are {', '.join(self.model.exciters)}"
            raise ScoreError(f"there is no technique {technique!r}; {names}")
        volume = self._controls.get((channel, "cc7"), 1.0) * self._controls.get((channel, "cc11"), 1.0)
        force = force_of(note, self.model, volume**2)
        return replace(note, technique=technique, force=force, velocity_midi=None if force else note.velocity_midi)

    def _cents(self, voice: Voice) -> float:
        own = voice.assigned.cents if voice.assigned is not None else 0.0
        return own + self._controls.get((voice.note.channel or 0, "bend"), 0.0)

    def _end(self, voice: Voice) -> None:
        voice.key_down = voice.pedalled = False
        self._ending.append(voice)

    def _drop(self, voice: Voice, drop: Dropped) -> None:
        self.counters.dropped[drop.reason] += 1
        self.counters.latest.append(replace(drop, time=self.engine.state.sample * self.engine.dt))
        if voice.note.note is not None and voice.key_down:
            self.release(voice)

    def _begin(self, now: int) -> None:
        """Begin the first of the notes that wait; those that came with it already have their strings."""
        fresh = [voice for voice in self._waiting if voice.assigned is None and not self._tapped(voice, now)]
        sounding = {name: self._sounding(line) for name, line in self._lines.items() if line.voice is not None}
        waiting = [voice.assigned for voice in self._waiting if voice.assigned is not None]
        taken = {own.string: Sounding(own.stop - self.capo, 1.0) for own in waiting}
        # the hand counts from the capo
        notes = [
            n if n.stop is None else replace(n, stop=max(n.stop - self.capo, 0.0)) for n in (v.note for v in fresh)
        ]
        assigned, dropped = self._assignment.assign(notes, sounding | taken)
        lost = {i for i, _ in dropped}
        kept = [voice for i, voice in enumerate(fresh) if i not in lost]
        for voice, own in zip(kept, assigned, strict=True):
            voice.assigned = replace(own, stop=own.stop + self.capo)
        for i, drop in dropped:
            self._drop(fresh[i], drop)
        self._waiting = deque(voice for voice in self._waiting if voice.assigned is not None)
        while self._waiting:
            voice = self._waiting.popleft()
            if self._started(voice, now):
                # a string that is held in an unusual way takes longer to compute
                wait = self.spacing * GRID * (1 if self._is_plain(voice) else 2)
                self._free_at = now + wait
                self._bend_at = max(self._bend_at, self._free_at)
                break

    def _is_plain(self, voice: Voice) -> bool:
        """Whether a note has the default technique and place, and a stop's pitch, as `prepare` compiles them."""
        usual = voice.note.technique in (None, self.model.default_exciter) and "from_bridge" not in voice.event.values
        return usual and voice.assigned is not None and voice.assigned.cents == 0.0

    def _sounding(self, line: PlayedString) -> Sounding:
        voice = line.voice
        weight = 0.0 if voice is None else 1.0 if voice.key_down else PEDALLED if voice.pedalled else 0.0
        return Sounding(line.stop - self.capo, weight)

    def _tapped(self, voice: Voice, now: int) -> bool:
        """Play a gesture on a point of the body."""
        exciter = exciter_of(voice.note, self.model)
        if exciter.at is None:
            return False
        values = {} if voice.note.force is None else {"force": voice.note.force}
        gesture = exciter.gesture(Event(values), Place(exciter.at))
        self.engine.schedule.add(plays=[Play(now * self.engine.dt - gesture.start, gesture, at=exciter.at)])
        self.counters.notes += 1
        return True

    def _started(self, voice: Voice, now: int) -> bool:
        """Begin a note on its string; whether it can be played there."""
        own, model = voice.assigned, self.model
        assert own is not None
        line, channel = self._lines[own.string], voice.note.channel or 0
        string, exciter = model.strings[own.string], exciter_of(voice.note, model, own.string)
        values = event_values(voice.note, model, lambda kind: self._controls.get((channel, kind)))
        if "from_bridge" in values:
            values["from_bridge"] = _rounded(values["from_bridge"])
        if (seed := model.playing.variation.seed) is not None:
            drawn = Deviates.of(seed, voice.number)
            values = touched(values, exciter, string.length(own.stop), drawn, model.playing.variation)
        event = Event(values, string.freq(own.stop), _CONTINUED, own.stop, line.stop, string.length(line.stop))
        try:
            is_where_asked(event, own, model, "live")
            place = model.place(own.string, own.stop, una_corda=self.dampers.una_corda)
            gesture = gripped(hurried(exciter.gesture(event, place), self.ramp))
        except TonewoodError as fault:
            self._drop(voice, Dropped(0.0, voice.note.note, voice.note.channel, fault.reason))
            return False
        if line.voice is not None:
            self.counters.cut += line.voice.key_down or line.voice.pedalled
            line.voice.string = None
        play = Play(now * self.engine.dt - gesture.start, gesture, string=own.string)
        voice.string, voice.began, voice.play, voice.event = own.string, now, play, event
        self.counters.notes += 1
        line.voice, line.stop = voice, own.stop
        # the bend follows while the pluck is prepared
        line.cents, line.wanted = own.cents, self._cents(voice)
        line.later.clear()
        tick = GRID * self.engine.dt
        course = stop_course(play, own.stop, string.stopping.continuous, tick)
        stops = course or [(play.start, own.stop)]
        changes = [Change(play.start, own.string, stop=stops[0][1], cents=line.cents, added_damping=0.0, touches=())]
        later = [Change(time, own.string, touches=t) for time, t in touch_course(play, tick)]
        later += [Change(time, own.string, stop=stop) for time, stop in stops[1:]]
        for change in sorted(later, key=lambda c: c.time):
            line.later.append((math.floor(change.time / tick + 1e-6) * GRID, change))
        self.dampers.press(own.string)
        for change in (*changes, *self.dampers.pending):
            self._change(now, change)
        self.dampers.pending.clear()
        self.engine.schedule.add(plays=[play, *self._of_others(voice, play)])
        return True

    def _of_others(self, voice: Voice, play: Play) -> list[Play]:
        """Return gestures by known forces on the other strings of a key; a hammer of the first meets them itself."""
        own, out = voice.assigned, []
        assert own is not None
        if play.gesture.on is None and not play.gesture.motions:
            for name in self.model.groups[own.string][1:]:
                exciter, place = exciter_of(voice.note, self.model, name), self.model.place(name, own.stop)
                gesture = gripped(hurried(exciter.gesture(voice.event, place), self.ramp))
                out.append(replace(play, gesture=gesture, string=name))
        return out

    def _change(self, now: int, change: Change) -> None:
        strings = (change.string,) if change.damper is not None else self.model.groups[change.string]
        self.engine.schedule.add([replace(change, time=now * self.engine.dt, string=name) for name in strings])

    def _is_sustained(self, voice: Voice | None) -> bool:
        """Whether a note's gesture lasts until its key is released."""
        if voice is None or voice.play is None or voice.assigned is None:
            return False
        name = voice.note.technique or self.model.default_exciter
        if name not in self._sustained:
            place = self.model.place(voice.assigned.string, voice.assigned.stop)
            longer = replace(voice.event, duration=2 * _CONTINUED)
            again = self.model.exciter(name, voice.assigned.string).gesture(longer, place)
            self._sustained[name] = again.stop > voice.play.gesture.stop
        return self._sustained[name]

    def _is_young(self, voice: Voice, now: int) -> bool:
        return (now - voice.began) * self.engine.dt < _SHORTEST

    def _finish(self, voice: Voice, now: int) -> None:
        """Damp the string of a note, or end the gesture that lasts as long as the note."""
        if voice.string is None:
            return
        line, end, time = self._lines[voice.string], self.model.playing.note_end, now * self.engine.dt
        self.dampers.release(voice.string)
        if self._is_sustained(voice):
            self._continue(voice, now, until=now)
            voice.play = None
        if end.kind == "ring" or self.dampers.has(voice.string):
            line.voice = None
        else:
            self._change(now, Change(time, voice.string, added_damping=damping(end)))
            self.engine.schedule.add(plays=touch_at_end(voice.assigned, voice.play, time, self.model))
            free = math.ceil(LET_GO_AFTER * end.t60 / (GRID * self.engine.dt)) * GRID
            line.later.append((now + free, let_go(time, voice.string, self.capo, end)))
            line.voice, line.wanted = None, line.cents

    def _continue(self, voice: Voice | None, now: int, until: int | None = None) -> None:
        """Give a gesture that lasts as long as its note another `_CONTINUED` s, or end it."""
        assert voice is not None
        assert voice.play is not None
        dt = self.engine.dt
        ahead = voice.play.time + voice.event.duration - now * dt
        if until is None and ahead > _CONTINUED / 2:
            return
        last = now if until is not None else now + _CONTINUED / dt
        event = replace(voice.event, duration=max(last * dt - voice.play.time, _SHORTEST))
        assigned = voice.assigned
        assert assigned is not None
        place = self.model.place(assigned.string, assigned.stop)
        gesture = exciter_of(voice.note, self.model, assigned.string).gesture(event, place)
        voice.event, voice.play = event, replace(voice.play, gesture=gesture)
        self.engine.schedule.add(plays=[voice.play])

    def _compile_one(self, now: int) -> None:
        if self._to_compile:
            self._compile(*self._to_compile.popleft())
            self._bend_at = now + 2 * self.spacing * GRID

    def _bend_one(self, now: int) -> bool:
        """Take the bend of the string that is farthest from where it is wanted a step on; whether there was one."""
        bent = {
            name: line for name, line in self._lines.items() if line.voice is not None and line.cents != line.wanted
        }
        if not bent:
            return False
        name = max(bent, key=lambda name: abs(bent[name].wanted - bent[name].cents))
        line, step = bent[name], BEND_RATE * 2 * self.spacing * GRID * self.engine.dt
        way = line.wanted - line.cents
        line.cents = line.wanted if abs(way) <= step else line.cents + math.copysign(step, way)
        self._change(now, Change(0.0, name, cents=line.cents))
        self._bend_at = now + 2 * self.spacing * GRID
        return True

    def prepare(self) -> None:
        """Compile how strings are held at every stop by the default technique, and damped.

        Without this a note takes up to 10 ms more the first time that its stop is played.
        """
        for name, stop in self._places():
            fretting = self._compile(name, stop, {})
            under = replace(fretting, damper=1.0) if self.model.strings[name].damper else None
            damped = replace(fretting, added_damping=damping(self.model.playing.note_end))
            for way in (fretting, under or damped):
                self.engine.fingerboard.prepare(name, way)

    def _places(self) -> list[tuple[str, int]]:
        strings = self.model.strings.items()
        return [(name, stop) for name, string in strings for stop in range(self.capo, string.n_stops + 1)]

    def _compile(self, name: str, stop: int, values: Mapping[str, float]) -> Fretting:
        """Compile how a string is held at a stop when it is plucked with some values of the default technique."""
        string, fingerboard = self.model.strings[name], self.engine.fingerboard
        event = Event(values, string.freq(stop), _CONTINUED, stop, 0.0, string.length(0.0))
        gesture = self.model.exciter(self.model.default_exciter, name).gesture(event, self.model.place(name, stop))
        held = Fretting(float(stop), place=gesture.from_bridge, width=gesture.width)
        fretting = fingerboard.playable(name, held)
        bases = fingerboard.bases(name, fretting)
        for component in () if gesture.on else string.weights(gesture.angle_deg):
            bases[component].impulses("pluck")
        return fretting


def _rounded(place: float) -> float:
    return round(place / _GRAIN) * _GRAIN
