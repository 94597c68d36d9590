"""Hands of a player who does one thing at a point of the control grid: strings, gestures, bends and ends of notes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.dampers import Dampers
from tonewood.performance.player.hands import laid_on, touch_at_end
from tonewood.performance.player.strokes import (
    BEND_RATE,
    ended,
    exciter_of,
    gripped,
    hurried,
    is_where_asked,
    stopped,
    stroke,
    tapped,
)
from tonewood.performance.player.timeline import GRID, Change, Play, Timeline
from tonewood.performance.player.variation import Deviates
from tonewood.performance.player.voices import PlayedString, Voice
from tonewood.performance.score.assignment import PEDALLED
from tonewood.performance.score.fingering import Sounding

#: s, by which a gesture that lasts as long as its note is known ahead, and the shortest note
CONTINUED, _SHORTEST = 0.25, 0.02


class PacedHands:
    """Hands on the strings of one instrument.

    Parameters
    ----------
    model : the instrument.
    ramp : s, longest preparation of a gesture that was not known early enough.
    spacing : points of the control grid between beginnings of notes that come together.
    capo : stop at which all strings are held that no finger stops.

    Attributes
    ----------
    lines : first string of a key, or any other -> its voice, stop and bend.
    dampers : of the keys.
    changes, plays : that are decided and not taken yet, in the order in which they are made at one sample.
    now : sample of the next point of the control grid.
    """

    def __init__(self, model: Model, ramp: float, spacing: int, capo: int):
        self.model, self.dt, self.tick = model, 1.0 / model.fs, GRID / model.fs
        self.ramp, self.spacing, self.capo, self.now = ramp, spacing, capo, 0
        self.dampers = Dampers(model)
        self.lines = {name: PlayedString(stop=float(capo)) for name in model.strings}
        self.changes = laid_on(0.0, model) + [Change(0.0, name, stop=capo) for name in model.strings if capo]
        self.plays: list[Play] = []
        #: technique -> whether its gesture lasts as long as the note, and the seconds for which it is prepared
        self._sustained: dict[str, bool] = {}
        self._preparations: dict[str, float] = {}

    def taken(self) -> Timeline:
        """Take the decided changes and gestures."""
        timeline, self.changes, self.plays = Timeline(self.changes, self.plays), [], []
        return timeline

    @property
    def idle(self) -> bool:
        """Whether nothing is to be done at the next point."""
        return not self.dampers.stirred and not any(
            line.later or line.cents != line.wanted or self.is_sustained(line.voice) for line in self.lines.values()
        )

    def sounding(self) -> dict[str, Sounding]:
        """Return string -> note on it, for the left hand; its stops count from the capo."""
        out = {}
        for name, line in self.lines.items():
            if (voice := line.voice) is not None:
                weight = 1.0 if voice.key_down else PEDALLED if voice.pedalled else 0.0
                out[name] = Sounding(line.stop - self.capo, weight)
        return out

    def preparation(self, technique: str | None) -> float:
        """Return for how long the gestures of a technique are prepared, s."""
        name = technique or self.model.default_exciter
        if name not in self._preparations:
            string = next(iter(self.model.groups))
            at = self.model.exciters[name].at
            event = Event({}, self.model.strings[string].freq(0), CONTINUED)
            place = self.model.place(string, 0.0) if at is None else Place(at)
            self._preparations[name] = -self.model.exciter(name, string).gesture(event, place).start
        return self._preparations[name]

    def is_sustained(self, voice: Voice | None) -> bool:
        """Whether a note's gesture lasts until its key is released."""
        if voice is None or voice.play is None or voice.assigned is None:
            return False
        name = voice.note.technique or self.model.default_exciter
        if name not in self._sustained:
            longer = self._gesture(voice, replace(voice.event, duration=2 * CONTINUED))
            self._sustained[name] = longer.stop > voice.play.gesture.stop
        return self._sustained[name]

    def is_young(self, voice: Voice) -> bool:
        """Whether a note began less than the shortest note ago."""
        return (self.now - voice.began) * self.dt < _SHORTEST

    def tap(self, voice: Voice) -> bool:
        """Play a gesture on a point of the body, if the note asks for one; whether it does."""
        play = tapped(voice.note, self.model)
        if play is not None:
            self.plays.append(replace(play, time=max(voice.time, self.now * self.dt - play.gesture.start)))
        return play is not None

    def begin(self, voice: Voice, values: Mapping[str, float], bend: float) -> None:
        """Begin a note on the string that it was assigned to.

        Parameters
        ----------
        values : of its exciter's parameters.
        bend : cents, of its channel.

        Raises
        ------
        TonewoodError : it cannot be played there.
        """
        own, model, begin = voice.assigned, self.model, self.now * self.dt
        assert own is not None
        line, variation = self.lines[own.string], model.playing.variation
        drawn = None if variation.seed is None else Deviates.of(variation.seed, voice.number)
        plays: list[Play] = []
        for name in model.groups[own.string]:
            event, play = stroke(
                own, name, model, values, held=line.stop, duration=CONTINUED,
                una_corda=self.dampers.una_corda, drawn=drawn,
            )  # fmt: skip
            if not plays:
                is_where_asked(event, own, model, "live")
                voice.event = event
            gesture = gripped(hurried(play.gesture, max(self.ramp, voice.time - begin)))
            time = max(voice.time, begin - gesture.start)
            plays.append(replace(play, time=time, gesture=gesture))
            # a hammer or bow of the first string meets the others of its key, too; known forces act on each of them
            if gesture.on is not None or gesture.motions:
                break
        voice.string, voice.began, voice.play = own.string, self.now, plays[0]
        if line.voice is not None:
            line.voice.string = None
        line.voice, line.stop = voice, own.stop
        # the bend follows while the pluck is prepared
        line.cents, line.wanted = own.cents, own.cents + bend
        line.later.clear()
        first, *later = stopped(own, plays[0], own.string, model, own.cents)
        for change in sorted(later, key=lambda c: c.time):
            line.later.append((math.floor(change.time / self.tick + 1e-6) * GRID, change))
        self.dampers.press(own.string)
        self._change(first, max(first.time, begin) if voice.time > begin else begin)
        self.changes += self.dampers.moved(begin)
        self.plays += plays

    def finish(self, voice: Voice) -> None:
        """Damp the string of a note, or end the gesture that lasts as long as the note."""
        assert voice.string is not None
        line, time = self.lines[voice.string], self.now * self.dt
        self.dampers.release(voice.string)
        if self.is_sustained(voice):
            self.go_on(voice, until=self.now)
            voice.play = None
        line.voice = None
        if end := ended(time, voice.string, self.model, self.capo):
            damped, free = end
            self._change(damped, time)
            self.plays += touch_at_end(voice.assigned, voice.play, time, self.model)
            line.later.append((self.now + math.ceil(round((free.time - time) / self.tick, 6)) * GRID, free))
            line.wanted = line.cents

    def go_on(self, voice: Voice, until: int | None = None) -> None:
        """Give a gesture that lasts as long as its note another `CONTINUED` s, or end it at a sample."""
        assert voice.play is not None
        ahead = voice.play.time + voice.event.duration - self.now * self.dt
        if until is None and ahead > CONTINUED / 2:
            return
        last = self.now if until is not None else self.now + CONTINUED / self.dt
        voice.event = replace(voice.event, duration=max(last * self.dt - voice.play.time, _SHORTEST))
        voice.play = replace(voice.play, gesture=self._gesture(voice, voice.event))
        self.plays.append(voice.play)

    def follow(self) -> bool:
        """Make one change that was planned: of a slide, or to let a damped string go; whether there was one."""
        due = [line for line in self.lines.values() if line.later and line.later[0][0] <= self.now]
        if not due:
            return False
        line = min(due, key=lambda line: line.later[0][0])
        _, change = line.later.popleft()
        line.stop = line.stop if change.stop is None else change.stop
        if change.cents is not None:
            line.cents = line.wanted = change.cents
        self._change(change, self.now * self.dt)
        return True

    def bend_one(self) -> bool:
        """Take the bend of the string that is farthest from where it is wanted a step on; whether there was one."""
        bent = {name: line for name, line in self.lines.items() if line.voice is not None and line.cents != line.wanted}
        if not bent:
            return False
        name = max(bent, key=lambda name: abs(bent[name].wanted - bent[name].cents))
        line, step = bent[name], BEND_RATE * 2 * self.spacing * GRID * self.dt
        way = line.wanted - line.cents
        line.cents = line.wanted if abs(way) <= step else line.cents + math.copysign(step, way)
        self._change(Change(0.0, name, cents=line.cents), self.now * self.dt)
        return True

    def move_dampers(self) -> None:
        """Move the dampers that keys and pedals have stirred."""
        if self.dampers.stirred:
            self.changes += self.dampers.moved(self.now * self.dt)

    def _gesture(self, voice: Voice, event: Event) -> Gesture:
        """Gesture of a note that sounds, with another event."""
        assert voice.assigned is not None
        place = self.model.place(voice.assigned.string, voice.assigned.stop)
        return exciter_of(voice.note, self.model, voice.assigned.string).gesture(event, place)

    def _change(self, change: Change, time: float) -> None:
        """Change all strings of a key at a time (s)."""
        names = self.model.groups[change.string]
        self.changes += (replace(change, time=time, string=name) for name in names)
