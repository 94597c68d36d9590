"""State of an instrument that is played live: voices, strings, and counts of notes."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

from tonewood.instrument.contract.gestures import Event
from tonewood.performance.player.timeline import Change, Play
from tonewood.performance.score.assignment import Assigned
from tonewood.performance.score.note import Dropped, Note

#: dropped notes that are kept with their reasons; all are counted
_KEPT = 100


@dataclass(eq=False)
class Voice:
    """One note, from its key to the end of its sound.

    Attributes
    ----------
    number : counted from 0.
    note : as it was asked for.
    key_down, pedalled : whether its key is held, or the pedal holds it.
    string : on which it sounds; None before it begins, after it was ended by another one, and on the body.
    began : sample of its beginning.
    """

    number: int
    note: Note
    key_down: bool = True
    pedalled: bool = False
    string: str | None = None
    began: int = 0
    assigned: Assigned | None = None
    play: Play | None = None
    event: Event = field(default_factory=Event)


@dataclass(eq=False)
class PlayedString:
    """One string: its voice, stop, bend, and the changes of them still to come."""

    voice: Voice | None = None
    stop: float = 0.0
    #: cents of the stop's pitch, bent and as asked for
    cents: float = 0.0
    wanted: float = 0.0
    #: (sample, change), in order
    later: deque[tuple[int, Change]] = field(default_factory=deque)


@dataclass(eq=False)
class LiveCounters:
    """Counts of notes and events.

    Attributes
    ----------
    notes : that began.
    cut : notes that ended because another one needed their string.
    dropped : reason -> notes that could not be played.
    latest : the last of these, at most 100.
    ignored : kind of controller -> changes of it without effect; ``playing.noises.KIND`` where a score would have it.
    """

    notes: int = 0
    cut: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    latest: deque[Dropped] = field(default_factory=lambda: deque(maxlen=_KEPT))
    ignored: Counter[str] = field(default_factory=Counter)
