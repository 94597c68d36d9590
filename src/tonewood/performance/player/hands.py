"""Hands on strings: notes begin, bend and end, each action at its own time or at a player's pace.

`Hands` know the notes of a score: an action has its exact time, and the gesture of the next note on the string ends the
one before. `PacedHands` learn of notes as they come and act at points of the control grid, one action at a point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.between_notes import laid_on, touch_at_end
from tonewood.performance.player.dampers import UNA_CORDA, Dampers, damper_changes
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
    values_of,
)
from tonewood.performance.player.timeline import GRID, Change, Play, Timeline
from tonewood.performance.player.variation import Deviates
from tonewood.performance.player.voices import CONTINUED, PlayedString, Voice
from tonewood.performance.score.assignment import PEDALLED, Assigned
from tonewood.performance.score.controllers import History
from tonewood.performance.score.fingering import Sounding
from tonewood.performance.score.note import Control

#: s, the shortest note
_SHORTEST = 0.02


class Hands:
    """Hands that act at exact times on the strings of one instrument; each string's notes come in the order of time.

    model : the instrument.
    capo : stop at which all strings are held that no finger stops.
    pedals : moves of pedals, in order.
    source : name of what is played, for errors.
    strings : first string of a key, or any other -> its voice, stop and bend.
    changes, plays : that are decided and not taken yet, in the order in which they are made at one sample.
    n_moved : notes that are played at another place than asked for.
    """

    def __init__(self, model: Model, capo: int = 0, pedals: Sequence[Control] = (), source: str = "score"):
        self.model, self.capo, self.tick, self._source = model, capo, GRID / model.fs, source
        self.strings = {name: PlayedString(stop=float(capo)) for name in model.strings}
        self.changes: list[Change] = []
        self.plays: list[Play] = []
        self.n_moved = 0
        self._pedals = pedals
        self._una_corda = History([move for move in pedals if move.kind == UNA_CORDA])
        #: (time, whether it goes down, first string) of keys
        self._pressed: list[tuple[float, bool, str]] = []

    def begin(self, voice: Voice, values: Mapping[str, float], bend: float = 0.0) -> Play:
        """Begin a note on the string that it was assigned to; the note before on this string ends.

        values : of its exciter's parameters.
        bend : cents, of its channel now, where its course is not known.
        Returns The gesture on the first string of its key.
        Raises TonewoodError : it cannot be played there.
        """
        assigned, model = voice.assigned, self.model
        assert assigned is not None
        string, variation = self.strings[assigned.string], model.playing.variation
        drawn = None if variation.seed is None else Deviates.of(variation.seed, voice.number)
        plays: list[Play] = []
        for name in model.groups[assigned.string]:
            exciter = exciter_of(voice.note, model, assigned.string)
            with values_of(assigned.note, values, exciter, f"string {assigned.string}", self._source):
                event, play = stroke(
                    assigned, name, model, values, stop_before=string.stop, duration=voice.duration,
                    una_corda=self._has_una_corda(voice), drawn=drawn,
                )  # fmt: skip
            if not plays:
                self.n_moved += not is_where_asked(event, assigned, model, self._source)
                voice.event = event
            plays.append(self._prepared(play, voice, string.voice))
            # a hammer or bow of the first string meets the others of its key, too; known forces act on each of them
            if play.gesture.on is not None or play.gesture.motions:
                break
        voice.string, voice.play = assigned.string, plays[0]
        self._lay(voice, assigned, plays[0], bend)
        string.voice, string.stop = voice, assigned.stop
        self.plays += plays
        return plays[0]

    def finish(self, voice: Voice, following: float = math.inf) -> None:
        """Bend the string of a note with its channel, and damp it at the note's end.

        following : s, when the next gesture on the string begins.
        """
        assigned, play = voice.assigned, voice.play
        assert assigned is not None
        assert play is not None
        for bend in voice.bends.between(play.start, assigned.end):
            self._change(Change(bend.time, assigned.string, cents=assigned.cents + bend.value))
        if math.isfinite(assigned.end):
            for change in ended(assigned.end, assigned.string, self.model, self.capo, following):
                self._change(change)
        # a key that is struck again does not come up in between
        up = min(voice.note.key_up, following)
        if up > play.start:
            self._pressed += [(play.start, True, assigned.string), (up, False, assigned.string)]

    def taken(self) -> Timeline:
        """Take the decided changes and gestures, those of dampers last."""
        changes = self.changes + damper_changes(self.model, self._pedals, self._pressed)
        timeline, self.changes, self.plays, self._pressed = Timeline(changes, self.plays), [], [], []
        return timeline

    def _has_una_corda(self, voice: Voice) -> bool:
        return (self._una_corda.at(voice.note.time) or 0.0) >= 0.5

    def _prepared(self, play: Play, voice: Voice, before: Voice | None) -> Play:
        """Return the gesture of a note, prepared in the time that there is after the note before."""
        if before is None or before.play is None:
            return play
        return replace(play, gesture=hurried(play.gesture, play.time - before.play.stop))

    def _lay(self, voice: Voice, assigned: Assigned, play: Play, bend: float) -> None:
        """Stop a string for a note's gesture."""
        if (before := self.strings[assigned.string].voice) is not None:
            self.finish(before, play.start)
        for change in stopped(
            assigned, play, assigned.string, self.model, assigned.cents + (voice.bends.at(play.start) or bend)
        ):
            self._change(change)

    def _change(self, change: Change) -> None:
        """Change all strings of a key."""
        self.changes += (replace(change, string=name) for name in self.model.groups[change.string])


class PacedHands(Hands):
    """Hands that act at points of the control grid.

    model, capo : see `Hands`.
    ramp : s, longest preparation of a gesture that was not known early enough.
    spacing : points of the control grid between beginnings of notes that come together.
    dampers : of the keys.
    now : sample of the next point of the control grid.
    """

    def __init__(self, model: Model, ramp: float, spacing: int, capo: int):
        super().__init__(model, capo, source="live")
        self.dt, self.ramp, self.spacing, self.now = 1.0 / model.fs, ramp, spacing, 0
        self.dampers = Dampers(model)
        self.changes = laid_on(0.0, model) + [Change(0.0, name, stop=capo) for name in model.strings if capo]
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
            string.later or string.cents != string.target or self.is_sustained(string.voice)
            for string in self.strings.values()
        )

    def sounding(self) -> dict[str, Sounding]:
        """Return string -> note on it, for the left hand; its stops count from the capo."""
        out = {}
        for name, string in self.strings.items():
            if (voice := string.voice) is not None:
                weight = 1.0 if voice.key_down else PEDALLED if voice.pedalled else 0.0
                out[name] = Sounding(string.stop - self.capo, weight)
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
        play = tapped(voice.note, self.model, self._source)
        if play is not None:
            self.plays.append(replace(play, time=max(voice.time, self.now * self.dt - play.gesture.start)))
        return play is not None

    def finish(self, voice: Voice, following: float = math.inf) -> None:
        """Damp the string of a note now, or end the gesture that lasts as long as the note."""
        assert voice.string is not None
        string, time = self.strings[voice.string], self.now * self.dt
        self.dampers.release(voice.string)
        if self.is_sustained(voice):
            self.go_on(voice, until=self.now)
            voice.play = None
        string.voice = None
        if end := ended(time, voice.string, self.model, self.capo, following):
            damped, free = end
            self._change(damped)
            self.plays += touch_at_end(voice.assigned, voice.play, time, self.model)
            string.later.append((self.now + math.ceil(round((free.time - time) / self.tick, 6)) * GRID, free))
            string.target = string.cents

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
        due = [string for string in self.strings.values() if string.later and string.later[0][0] <= self.now]
        if not due:
            return False
        string = min(due, key=lambda string: string.later[0][0])
        _, change = string.later.popleft()
        string.stop = string.stop if change.stop is None else change.stop
        if change.cents is not None:
            string.cents = string.target = change.cents
        self._change(replace(change, time=self.now * self.dt))
        return True

    def bend_one(self) -> bool:
        """Move the bend of the string farthest from its target by a step; return whether there was one."""
        bent = {
            name: string
            for name, string in self.strings.items()
            if string.voice is not None and string.cents != string.target
        }
        if not bent:
            return False
        name = max(bent, key=lambda name: abs(bent[name].target - bent[name].cents))
        string, step = bent[name], BEND_RATE * 2 * self.spacing * GRID * self.dt
        way = string.target - string.cents
        string.cents = string.target if abs(way) <= step else string.cents + math.copysign(step, way)
        self._change(Change(self.now * self.dt, name, cents=string.cents))
        return True

    def move_dampers(self) -> None:
        """Move the dampers that keys and pedals have stirred."""
        if self.dampers.stirred:
            self.changes += self.dampers.moved(self.now * self.dt)

    def _gesture(self, voice: Voice, event: Event) -> Gesture:
        assert voice.assigned is not None
        place = self.model.place(voice.assigned.string, voice.assigned.stop)
        return exciter_of(voice.note, self.model, voice.assigned.string).gesture(event, place)

    def _has_una_corda(self, voice: Voice) -> bool:
        return self.dampers.una_corda

    def _prepared(self, play: Play, voice: Voice, before: Voice | None) -> Play:
        """Return the gesture of a note, prepared from now on, and for at most `ramp` where it is late."""
        begin = self.now * self.dt
        gesture = gripped(hurried(play.gesture, max(self.ramp, voice.time - begin)))
        return replace(play, time=max(voice.time, begin - gesture.start), gesture=gesture)

    def _lay(self, voice: Voice, assigned: Assigned, play: Play, bend: float) -> None:
        """Stop a string for a note's gesture now; its slides and bends follow."""
        string, begin = self.strings[assigned.string], self.now * self.dt
        voice.began = self.now
        if string.voice is not None:
            string.voice.string = None
        # the bend follows while the pluck is prepared
        string.cents, string.target = assigned.cents, assigned.cents + bend
        first, *later = stopped(assigned, play, assigned.string, self.model, assigned.cents)
        string.later.clear()
        for change in sorted(later, key=lambda c: c.time):
            string.later.append((math.floor(change.time / self.tick + 1e-6) * GRID, change))
        self.dampers.press(assigned.string)
        self._change(replace(first, time=max(first.time, begin) if voice.time > begin else begin))
        self.move_dampers()
