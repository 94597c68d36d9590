"""A player: notes and controllers to changes and gestures, with as much lookahead as there is.

`Player.feed` takes events as they become known. With all the lookahead there is (`math.inf`) every action is at its
exact time and knows the notes around it (`playing`, `hands.Hands`). With less, the player acts at points of the control
grid, GRID samples apart (`hands.PacedHands`): the actions depend only on the events and on the samples after which they
came.

- A note known early enough is prepared in time. Another one begins at the next point with the preparation of its
  gesture, shortened to `ramp`; it sounds when this is over.
- One thing is done at a point, so that none costs more than a block has time for: notes first, `spacing` points apart
  (twice that after one in an unusual way), then slides and strings let go, ends of notes, bends.
- A bend follows its wheel at no more than the greatest rate, one string at a time: the farthest from its wheel.
- A gesture that lasts as long as its note (a bow's stroke) is continued `CONTINUED` s ahead while the key is down.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from tonewood.errors import TonewoodError
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_number
from tonewood.performance.player.between_notes import not_live
from tonewood.performance.player.hands import PacedHands
from tonewood.performance.player.playing import perform, playable
from tonewood.performance.player.strokes import beyond_capo, event_values, with_force
from tonewood.performance.player.techniques import checked_technique, technique_of
from tonewood.performance.player.timeline import GRID, Timeline
from tonewood.performance.player.voices import HeldKeys, PlayerCounters, Voice
from tonewood.performance.score.assignment import StringChooser
from tonewood.performance.score.controllers import loudness
from tonewood.performance.score.fingering import Sounding
from tonewood.performance.score.note import Control, Dropped, Note, Score, ignored_name

#: points of the grid that are stepped at once while nothing is to be done
_IDLE = 64
#: m, to which places that controllers ask for are rounded: bases of strings are made once per place
GRAIN = 5e-3


class Player:
    """Plays one instrument.

    model : the instrument.
    ramp : s, longest preparation of a gesture that was not known early enough.
    spacing : points of the control grid between beginnings of notes that come together.
    channel_per_string : notes of the first channel go to the first string, and so on.
    capo : stop at which all strings are held that no finger stops, 0 for none. Stops of notes are counted from the nut.
    spare : called at points where nothing is to be done; whether it did work, which keeps bends waiting.
    """

    def __init__(
        self, model: Model, *, ramp: float = 5e-3, spacing: int = 2, channel_per_string: bool = False, capo: int = 0
    ):
        self.model, self.spacing, self.capo, self.channel_per_string = model, spacing, capo, channel_per_string
        self.hands, self.keys, self.counters = PacedHands(model, ramp, spacing, capo), HeldKeys(), PlayerCounters()
        self.counters.ignored.update(not_live(model))
        self.spare: Callable[[], bool] = lambda: False
        self._hand = StringChooser(
            playable(model, capo), channel_per_string=channel_per_string, tuning=model.instrument.tuning
        )
        self.waiting: deque[Voice] = deque()
        #: (time at which it is to be done, number, event) of those that are known and still to come
        self._events: list[tuple[float, int, Note | Control | Voice]] = []
        self.controls: dict[tuple[int, str], float] = {}
        self._switches = {float(note_number(k)): name for k, name in model.playing.keyswitches.items()}
        self._techniques: dict[int, str] = {}
        self._free_at = self._bend_at = 0
        self._numbers, self._voices = itertools.count(), itertools.count()
        self._read = frozenset({*model.playing.controls, *model.playing.switches, "cc7", "cc11", "cc64"})
        self._read |= self.hands.dampers.kinds

    def feed(self, events: Iterable[Note | Control], lookahead: float, sample: int = 0) -> Timeline:
        """Take events that have become known, and return the changes and gestures that are decided.

        events : that have become known since the last call, all up to the lookahead.
        lookahead : s, from the sample on, for which all events are known: infinite for a whole score, which is given
            at once, 0 where events come as they happen.
        sample : point of the control grid that is stepped next.
        Returns Changes and gestures that are decided: all of them, or those of this point.
        Raises ScoreError : a whole score has no notes or none that can be played, or asks for a technique that is not
            there.
        """
        if lookahead == math.inf:
            in_order = sorted(events, key=lambda event: event.time)
            notes = [event for event in in_order if isinstance(event, Note)]
            score = Score(notes, [event for event in in_order if isinstance(event, Control)])
            return perform(score, self.model, channel_per_string=self.channel_per_string, capo=self.capo).timeline
        self.hands.now = sample
        for event in events:
            # a note is begun at the last point before its gesture's preparation, if it is known by then
            early = self.hands.preparation(event.technique) + self.hands.tick if isinstance(event, Note) else 0.0
            heapq.heappush(self._events, (event.time - min(early, lookahead), next(self._numbers), event))
        while self._events and self._events[0][0] <= sample / self.model.fs:
            self._do(heapq.heappop(self._events)[2])
        self._tick(sample)
        return self.hands.taken()

    def _do(self, event: Note | Control | Voice) -> None:
        """Let an event happen: a note, the release of its key, or a controller."""
        if isinstance(event, Voice):
            self.release(event)
        elif isinstance(event, Note):
            if (voice := self.note_on(event, time=event.time)) is not None:
                heapq.heappush(self._events, (event.key_up, next(self._numbers), voice))
        else:
            for channel in range(16) if event.channel is None else (event.channel,):
                if event.kind == "bend":
                    self.bend(event.value, channel)
                else:
                    self.control(event.kind, event.value, channel)

    def note_on(self, note: Note, *, time: float = -math.inf) -> Voice | None:
        """Begin a note, at a time (s) or as soon as possible; None if it is a keyswitch or cannot be played.

        Raises ScoreError : the instrument has no such technique.
        """
        channel = note.channel or 0
        if note.note in self._switches and note.string is None:
            self._techniques[channel] = self._switches[note.note]
            return None
        voice = Voice(next(self._voices), self._with_technique(note), time=time)
        if (first := self.keys.press(voice)) is not None:
            self.release(first)
        self.waiting.append(voice)
        return voice

    def note_off(self, note: float, channel: int = 0) -> bool:
        """Release the key that was struck first of those of this pitch on the channel; whether there was one."""
        voices = self.keys.held.get((channel, note))
        if not voices:
            return False
        self.release(voices[0])
        return True

    def release(self, voice: Voice) -> None:
        """Release the key of a note; the pedal may hold it on."""
        if not voice.key_down:
            return
        if voice.string is not None and not self.hands.is_young(voice):
            self.hands.dampers.release(voice.string)
        self.keys.release(voice, pedal=self.controls.get((voice.note.channel or 0, "cc64"), 0.0) >= 0.5)

    def control(self, kind: str, value: float, channel: int = 0) -> None:
        """Move a controller, ``ccN`` or ``channel_pressure``, to a value from 0 to 1."""
        if kind not in self._read:
            self.counters.ignored[ignored_name(kind)] += 1
            return
        self.controls[channel, kind] = value
        self.hands.dampers.control(kind, value, channel)
        if kind == "cc64" and value < 0.5:
            self.keys.lift_pedal(channel)

    def bend(self, cents: float, channel: int | None = None) -> None:
        """Bend the notes of a channel, or all, to so many cents above their pitches; rounded to a whole one."""
        for at in range(16) if channel is None else (channel,):
            self.controls[at, "bend"] = round(cents)
        for string in self.hands.strings.values():
            if string.voice is not None and channel in (None, string.voice.note.channel or 0):
                string.target = self._cents(string.voice)

    def all_off(self, channel: int | None = None, *, pedalled: bool = False) -> None:
        """Release all keys of a channel, or of all; with `pedalled` also the notes that the pedal holds."""
        for at in [at for at in self.keys.held if channel in (None, at[0])]:
            for voice in list(self.keys.held.get(at, ())):
                self.release(voice)
        if pedalled:
            self.keys.lift_pedal(channel)

    @property
    def idle_points(self) -> int:
        """Points of the grid that may be stepped at once: 1 where something is to be done at the next."""
        busy = self.waiting or self.keys.ending or self.keys.falling or self._events
        return 1 if busy or not self.hands.idle else _IDLE

    @property
    def n_sounding(self) -> int:
        """Strings with a note whose key or pedal is held."""
        return sum(string.voice is not None for string in self.hands.strings.values())

    def _tick(self, now: int) -> None:
        """Decide what is done at a point of the grid."""
        hands = self.hands
        for string in hands.strings.values():
            if string.voice is not None and hands.is_sustained(string.voice):
                hands.go_on(string.voice)
        while (voice := self.keys.due(self.keys.falling, self._waits)) is not None and voice.string is not None:
            hands.dampers.release(voice.string)
        hands.move_dampers()
        if self.waiting and now >= self._free_at:
            self._begin(now)
        elif hands.follow():
            pass
        elif (voice := self.keys.due(self.keys.ending, self._waits)) is not None:
            hands.finish(voice)
            hands.move_dampers()
        elif now >= self._bend_at and (hands.bend_one() or self.spare()):
            self._bend_at = now + 2 * self.spacing * GRID

    def _waits(self, voice: Voice) -> bool:
        """Whether a note has not begun, or is too young to end."""
        return voice in self.waiting or (voice.string is not None and self.hands.is_young(voice))

    def _with_technique(self, note: Note) -> Note:
        """Return the note with the technique that it names, or that keys and controllers ask for, and its force."""
        channel = note.channel or 0

        def latest(kind: str) -> float | None:
            return self.controls.get((channel, kind))

        technique = technique_of(note, self._techniques.get(channel), self.model.playing, latest)
        checked_technique(technique, self.model)
        return with_force(replace(note, technique=technique), self.model, loudness(latest))

    def _cents(self, voice: Voice) -> float:
        cents = voice.assigned.cents if voice.assigned is not None else 0.0
        return cents + self.controls.get((voice.note.channel or 0, "bend"), 0.0)

    def _drop(self, voice: Voice, drop: Dropped) -> None:
        self.counters.drop(replace(drop, time=self.hands.now / self.model.fs))
        if voice.note.note is not None and voice.key_down:
            self.release(voice)

    def _begin(self, now: int) -> None:
        """Begin the first of the notes that wait; those that came with it already have their strings."""
        fresh = []
        for voice in self.waiting:
            if voice.assigned is None:
                if self.hands.tap(voice):
                    self.counters.notes += 1
                else:
                    fresh.append(voice)
        self._assign(fresh)
        self.waiting = deque(voice for voice in self.waiting if voice.assigned is not None)
        while self.waiting:
            voice = self.waiting.popleft()
            if self._started(voice):
                # a string that is held in an unusual way takes longer to compute
                self._free_at = now + self.spacing * GRID * (1 if self._is_plain(voice) else 2)
                self._bend_at = max(self._bend_at, self._free_at)
                break

    def _assign(self, fresh: list[Voice]) -> None:
        """Give notes that begin now their strings; later ones that are known count, too."""
        sounding = {v.assigned.string: Sounding(v.assigned.stop - self.capo, 1.0) for v in self.waiting if v.assigned}
        time = max([0.0, *(voice.time for voice in fresh)])
        later = sorted((e for _, _, e in self._events if isinstance(e, Note) and e.time > time), key=lambda n: n.time)
        notes, ahead = ([beyond_capo(note, self.capo) for note in notes] for notes in ([v.note for v in fresh], later))
        assigned, dropped = self._hand.assign(
            [replace(note, time=time) for note in notes], self.hands.sounding() | sounding, ahead
        )
        lost = {i for i, _ in dropped}
        kept = [i for i in range(len(fresh)) if i not in lost]
        for i, choice in zip(kept, assigned, strict=True):
            fresh[i].assigned = replace(choice, note=notes[i], stop=choice.stop + self.capo)
        for i, drop in dropped:
            self._drop(fresh[i], drop)

    def _is_plain(self, voice: Voice) -> bool:
        """Whether a note has the default technique and place, and a stop's pitch, as they are compiled before."""
        usual = voice.note.technique in (None, self.model.default_exciter) and "from_bridge" not in voice.event.values
        return usual and voice.assigned is not None and voice.assigned.cents == 0.0

    def _started(self, voice: Voice) -> bool:
        """Begin a note on its string; whether it can be played there."""
        assigned, channel = voice.assigned, voice.note.channel or 0
        assert assigned is not None
        values = event_values(voice.note, self.model, lambda kind: self.controls.get((channel, kind)))
        if "from_bridge" in values:
            values["from_bridge"] = rounded(values["from_bridge"])
        before = self.hands.strings[assigned.string].voice
        try:
            self.hands.begin(voice, values, self.controls.get((channel, "bend"), 0.0))
        except TonewoodError as fault:
            self._drop(voice, Dropped(0.0, voice.note.note, voice.note.channel, fault.reason))
            return False
        self.counters.cut += before is not None and (before.key_down or before.pedalled)
        if before is not None and before.pedalled:
            self.keys.let_go(before)
        self.counters.notes += 1
        return True


def rounded(position: float) -> float:
    """Round a position (m) that a controller asks for."""
    return round(position / GRAIN) * GRAIN
