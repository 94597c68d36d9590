"""Notes from their keys to the end of their sound: voices, keys and pedal, strings, and counts."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from tonewood.instrument.contract.gestures import Event
from tonewood.performance.player.timeline import Change, Play
from tonewood.performance.score.assignment import Assigned
from tonewood.performance.score.controllers import History
from tonewood.performance.score.note import Dropped, Note

#: s, by which a gesture that lasts as long as its note is known ahead
CONTINUED = 0.25
#: dropped notes that are kept with their reasons; all are counted
_KEPT = 100
#: different reasons that are counted apart; a reason may name a time
_REASONS = 1000
#: notes of one key that were struck and not released; more of them release the first
_STRUCK = 8


@dataclass(eq=False)
class Voice:
    """One note, from its key to the end of its sound.

    number : counted from 0.
    note : as it was asked for.
    key_down, pedalled : whether its key is held, or the pedal holds it.
    string : on which it sounds; None before it begins, after it was ended by another one, and on the body.
    time : s, when it is to sound; a note that came without lookahead sounds as soon as it can.
    duration : s, for which a gesture that lasts as long as its note goes on, as far as that is known.
    bends : of its channel, where these are known.
    began : sample of its beginning.
    """

    number: int
    note: Note
    key_down: bool = True
    pedalled: bool = False
    string: str | None = None
    time: float = -math.inf
    duration: float = CONTINUED
    bends: History = field(default_factory=History)
    began: int = 0
    assigned: Assigned | None = None
    play: Play | None = None
    event: Event = field(default_factory=Event)


@dataclass(eq=False)
class PlayedString:
    """One string: its voice, stop, bend, and the changes of them still to come."""

    voice: Voice | None = None
    stop: float = 0.0
    #: cents by which the stop's pitch is bent now, and those of its target
    cents: float = 0.0
    target: float = 0.0
    #: (sample, change), in order
    later: deque[tuple[int, Change]] = field(default_factory=deque)


@dataclass(eq=False)
class PlayerCounters:
    """Counts of notes and events.

    notes : that began.
    cut : notes that ended because another one needed their string.
    dropped : reason -> notes that could not be played; beyond 1000 reasons they are under ``other reasons``.
    latest : the last of these, at most 100.
    ignored : kind of controller -> changes of it without effect; ``playing.noises.KIND`` where a score would have it.
    """

    notes: int = 0
    cut: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    latest: deque[Dropped] = field(default_factory=lambda: deque(maxlen=_KEPT))
    ignored: Counter[str] = field(default_factory=Counter)

    def drop(self, drop: Dropped) -> None:
        """Count a note that cannot be played."""
        known = drop.reason in self.dropped or len(self.dropped) < _REASONS
        self.dropped[drop.reason if known else "other reasons"] += 1
        self.latest.append(drop)


class HeldKeys:
    """Keys of all channels: which are down, which notes only the pedal holds, and which were let go.

    held : (channel, note) -> notes whose key is down, in the order in which they were struck.
    pedalled : (channel, note) -> the note that only the pedal holds.
    ending : notes that were let go and are to be ended.
    falling : notes that the pedal holds, released before their dampers were off the strings for the shortest time.
    """

    def __init__(self) -> None:
        self.held: dict[tuple[int, float], list[Voice]] = {}
        self.pedalled: dict[tuple[int, float], Voice] = {}
        self.ending: list[Voice] = []
        self.falling: list[Voice] = []

    def press(self, voice: Voice) -> Voice | None:
        """Press the key of a note; returns one of it that is to be released first, where too many were struck."""
        if (key := _key(voice)) is None:
            return None
        if (before := self.pedalled.pop(key, None)) is not None:
            self.end(before)
        voices = self.held.setdefault(key, [])
        voices.append(voice)
        return voices[0] if len(voices) > _STRUCK else None

    def holds(self, voice: Voice) -> bool:
        """Whether the key of a note is one of these, or the note has none (it sounds on the body)."""
        return (key := _key(voice)) is None or voice in self.held.get(key, ())

    def release(self, voice: Voice, *, pedal: bool) -> None:
        """Release the key of a note, which ends unless the pedal holds it; that holds one note a key."""
        voice.key_down = False
        if (key := _key(voice)) is not None:
            self.held[key].remove(voice)
            if not self.held[key]:
                del self.held[key]
        if not pedal or key is None:
            self.ending.append(voice)
            return
        if (before := self.pedalled.get(key)) is not None:
            self.end(before)
        voice.pedalled = True
        self.pedalled[key] = voice
        self.falling.append(voice)

    def lift_pedal(self, channel: int | None) -> None:
        """End the notes that only the pedal holds, on a channel or on all."""
        for key in [key for key in self.pedalled if channel in (None, key[0])]:
            self.end(self.pedalled.pop(key))

    def let_go(self, voice: Voice) -> None:
        """Forget a note that only the pedal holds: another one has its string."""
        voice.pedalled = False
        self.pedalled = {key: held for key, held in self.pedalled.items() if held is not voice}

    def end(self, voice: Voice) -> None:
        """Let a note end."""
        voice.key_down = voice.pedalled = False
        self.ending.append(voice)

    def due(self, voices: list[Voice], waits: Callable[[Voice], bool]) -> Voice | None:
        """Take the first of `ending` or `falling` that sounds and need not wait, and those before it without sound."""
        for voice in [voice for voice in voices if not waits(voice)]:
            voices.remove(voice)
            if voice.string is not None:
                return voice
        return None


def _key(voice: Voice) -> tuple[int, float] | None:
    """Channel and pitch of a note's key; None of a note that only names a string."""
    return None if voice.note.note is None else (voice.note.channel or 0, voice.note.note)
