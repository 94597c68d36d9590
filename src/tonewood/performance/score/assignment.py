"""Assigns notes to strings and stops, playable by one left hand, at the least cost over all notes known so far.

The pitch, string or stop of a note gives its options; notes that begin together form a chord, whose notes go to
different strings; `fingering` then chooses among all ways through the chords. A string holds one note at
a time: a new one ends the earlier. Voices (MIDI channels) that meet on a pitch at the same moment share one pluck, as
a player reads them; twice the same pitch in one voice asks for two strings. A note that has no option, or is one too
many for the strings at its moment, is dropped with a reason. A wide stretch or a long shift is never a reason: it
only costs.

`assign` knows a whole piece. `StringChooser` decides as notes come, from the place where the hand is and the notes that
sound: of the chords in its window only those due now are final, the later ones count in the cost. A player without
lookahead has a window of one chord. A note that sounds weighs 1 while its key is down, `PEDALLED` while only the pedal
holds it, and 0 afterwards; it is taken to last a second more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from tonewood.errors import ScoreError
from tonewood.instrument.scales import Tuning, note_name
from tonewood.performance.score.fingering import (
    Chord,
    FingeringCosts,
    Option,
    Sounding,
    StringMatching,
    finger,
    hand_after,
)
from tonewood.performance.score.note import Dropped, Note

CHORD_WINDOW = 0.030
SIMULTANEOUS = 0.001
TOLERANCE_CENTS = 50.0
#: weight of a note that only the pedal holds
PEDALLED = 0.5


@dataclass(frozen=True)
class PlayableString:
    """A string as the left hand sees it.

    name : its name.
    pitches : MIDI number of each stop, the open string first; one number for a string that is never stopped; lowest
        and highest if `continuous`.
    continuous : whether any pitch from the first to the last can be stopped; a stop is then a number of semitones.
    """

    name: str
    pitches: tuple[float, ...]
    continuous: bool = False

    def __post_init__(self) -> None:
        rising = all(a < b for a, b in zip(self.pitches, self.pitches[1:], strict=False))
        if not self.pitches or not rising or not all(map(math.isfinite, self.pitches)):
            raise ScoreError("the pitches of its stops must rise", key=f"strings.{self.name}")

    @classmethod
    def fretted(cls, name: str, open_note: float, n_stops: int = 0) -> PlayableString:
        """String with `n_stops` frets, a semitone apart."""
        return cls(name, tuple(open_note + i for i in range(n_stops + 1)))

    def stop_for(self, pitch: float) -> float:
        """The stop nearest to a pitch, however far."""
        if self.continuous:
            return min(max(pitch, self.pitches[0]), self.pitches[-1]) - self.pitches[0]
        return min(range(len(self.pitches)), key=lambda i: abs(self.pitches[i] - pitch))

    def pitch_at(self, stop: float) -> float | None:
        """MIDI number of a stop; None if there is no such stop."""
        if self.continuous:
            pitch = self.pitches[0] + stop
            return pitch if pitch <= self.pitches[-1] else None
        return self.pitches[int(stop)] if stop == int(stop) and stop < len(self.pitches) else None

    @property
    def range(self) -> str:
        """Names of its lowest and highest note, for people."""
        low, high = note_name(self.pitches[0]), note_name(self.pitches[-1])
        return low if low == high else f"{low} to {high}"


@dataclass(frozen=True, slots=True)
class Assigned:
    """A note on a string: `cents` is the pitch asked for minus that of the stop, `end` (s) the end of its sound."""

    note: Note
    string: str
    stop: float
    cents: float
    end: float


@dataclass(frozen=True)
class Assignment:
    """Assignment of all notes.

    notes : one per pluck, in time order.
    doubled : notes without a pluck of their own: another voice's note at the same moment and pitch sounds for them
        (as loud as the louder, as long as the longer of them).
    dropped : notes that cannot be played, with the reason.
    n_cut : how many notes were ended by another pitch on their string.
    cost : minimised, see `fingering`.
    """

    notes: tuple[Assigned, ...]
    doubled: tuple[Note, ...]
    dropped: tuple[Dropped, ...]
    n_cut: int
    cost: float


def assign(
    notes: Iterable[Note],
    strings: Sequence[PlayableString],
    *,
    channel_per_string: bool = False,
    tuning: Tuning | None = None,
) -> Assignment:
    """Give every note a string and a stop.

    notes : with a pitch (`note` or `freq`), or a string (with a stop, or open), or both; given values are kept.
        A pitch up to 50 cents off a stop is played there, the difference is `Assigned.cents`.
    strings : of the instrument.
    channel_per_string : notes of the first MIDI channel go to the first string, and so on.
    tuning : for notes given by `freq`, and for the size of `cents`; twelve equal steps, A4 at 440 Hz by default.
    Returns assignment : every note is in `notes`, in `doubled` or in `dropped`.
    """
    resolver = PlaceResolver(strings, tuning or Tuning(), channel_per_string)
    plucks = sorted(notes, key=lambda n: n.time)
    doubled: list[Note] = []
    if not channel_per_string:
        plucks, doubled = _share_plucks(plucks)
    chords, dropped = _chords(plucks, resolver)
    chosen, cost = finger([_chord(chord) for chord in chords], len(strings), FingeringCosts())
    pairs = [
        (voice.note, option)
        for chord, options in zip(chords, chosen, strict=True)
        for voice, option in zip(chord, options, strict=True)
    ]
    assigned, n_cut = _ends(pairs, strings, resolver)
    drops = tuple(sorted((drop for _, drop in dropped), key=lambda d: d.time))
    return Assignment(assigned, tuple(doubled), drops, n_cut, cost)


class StringChooser:
    """Left hand of a player who reads as far ahead as notes are known, or not at all.

    strings, channel_per_string, tuning : as for `assign`.
    hand : stop under the first finger.
    """

    def __init__(
        self, strings: Sequence[PlayableString], *, channel_per_string: bool = False, tuning: Tuning | None = None
    ):
        self.strings, self.hand = strings, 1.0
        self._resolver = PlaceResolver(strings, tuning or Tuning(), channel_per_string)

    def assign(
        self, notes: Sequence[Note], sounding: Mapping[str, Sounding], ahead: Sequence[Note] = ()
    ) -> tuple[list[Assigned], list[tuple[int, Dropped]]]:
        """Give every note of a chord a string and a stop.

        notes : that begin now, at one time.
        sounding : string -> note that sounds on it now.
        ahead : later notes that are known, in time order; they only count in the cost.
        Returns assigned : in the order of the notes, without an end.
        dropped : (index of the note, reason) of those that cannot be played.
        """
        now = notes[0].time if notes else 0.0
        first, dropped = _chords(notes, self._resolver)
        later, _ = _chords(ahead, self._resolver)
        if not first:
            return [], dropped
        chords = [_chord(chord, now) for chord in (*first, *later)]
        now_on = {i: sounding[string.name] for i, string in enumerate(self.strings) if string.name in sounding}
        chosen, _ = finger(chords, len(self.strings), FingeringCosts(), hand=self.hand, sounding=now_on)
        self.hand = hand_after(self.hand, chosen[0])
        return [
            Assigned(v.note, self.strings[o.string].name, o.stop, self._resolver.cents(v.note, o), math.inf)
            for v, o in zip(first[0], chosen[0], strict=True)
        ], dropped


class PlaceResolver:
    """Finds the strings and stops at which a note can be played."""

    def __init__(self, strings: Sequence[PlayableString], tuning: Tuning, channel_per_string: bool):
        self._strings = strings
        self._tuning = tuning
        self._channel_per_string = channel_per_string
        self._index = {string.name: i for i, string in enumerate(strings)}
        if not strings or len(self._index) < len(strings):
            raise ScoreError("there must be strings, each with its own name", key="strings")
        self._anywhere: dict[float, list[Option]] = {}

    def options(self, note: Note) -> list[Option]:
        """Places for the note, at least one, or a `ScoreError` with the reason why there is none."""
        pitch = self._tuning.note(note.freq) if note.note is None and note.freq is not None else note.note
        string = self._named(note)
        if string is not None:
            return [self._on_string(string, pitch, 0 if pitch is None and note.stop is None else note.stop)]
        if pitch is None:
            raise ScoreError("neither a pitch nor a string is given")
        if note.stop is not None:
            options = [o for o in self._everywhere(pitch) if o.stop == note.stop]
            if not options:
                raise ScoreError(f"no string plays {note_name(pitch)} at stop {note.stop:g}")
            return options
        return self._everywhere(pitch)

    def cents(self, note: Note, option: Option) -> float:
        """Cents of the pitch asked for above the stop."""
        sounding = self._strings[option.string].pitch_at(option.stop)
        pitch = self._tuning.note(note.freq) if note.note is None and note.freq is not None else note.note
        if pitch is None or sounding is None or pitch == sounding:
            return 0.0
        return self._tuning.cents_between(sounding, pitch)

    def _named(self, note: Note) -> int | None:
        if note.string is not None:
            if note.string not in self._index:
                raise ScoreError(f"there is no string {note.string!r} (strings: {', '.join(self._index)})")
            return self._index[note.string]
        if not self._channel_per_string:
            return None
        if note.channel is None or note.channel >= len(self._strings):
            which = "no channel" if note.channel is None else f"channel {note.channel + 1}"
            raise ScoreError(f"{which}, where channels 1 to {len(self._strings)} are the strings")
        return note.channel

    def _everywhere(self, pitch: float) -> list[Option]:
        if pitch not in self._anywhere:
            places = ((i, string.stop_for(pitch)) for i, string in enumerate(self._strings))
            self._anywhere[pitch] = [Option(i, stop) for i, stop in places if self._near(i, stop, pitch)]
        if not self._anywhere[pitch]:
            raise ScoreError(f"no string plays {note_name(pitch)} ({self._range()})")
        return self._anywhere[pitch]

    def _on_string(self, i: int, pitch: float | None, stop: float | None) -> Option:
        string = self._strings[i]
        if stop is None and pitch is not None:
            stop = string.stop_for(pitch)
            if not self._near(i, stop, pitch):
                raise ScoreError(f"string {string.name} does not play {note_name(pitch)} (it has {string.range})")
        sounding = string.pitch_at(stop or 0.0)
        if sounding is None:
            raise ScoreError(f"string {string.name} has no stop {stop:g} (it has {string.range})")
        if pitch is not None and not self._near(i, stop or 0.0, pitch):
            names = note_name(sounding), note_name(pitch)
            raise ScoreError(f"stop {stop:g} of string {string.name} plays {names[0]}, not {names[1]}")
        return Option(i, stop or 0.0)

    def _near(self, i: int, stop: float, pitch: float) -> bool:
        sounding = self._strings[i].pitch_at(stop)
        if sounding is None or abs(sounding - pitch) > 12:
            return False
        return sounding == pitch or abs(self._tuning.cents_between(sounding, pitch)) <= TOLERANCE_CENTS + 1e-6

    def _range(self) -> str:
        low = min(string.pitches[0] for string in self._strings)
        high = max(string.pitches[-1] for string in self._strings)
        return f"the strings reach from {note_name(low)} to {note_name(high)}"


def _share_plucks(notes: Sequence[Note]) -> tuple[list[Note], list[Note]]:
    """Merge notes of different channels with the same pitch and time; notes that name a string are not merged."""
    plucks: list[Note] = []
    doubled: list[Note] = []
    latest: dict[float, tuple[int, set[int]]] = {}  # pitch: its last pluck and the channels that share it
    for note in notes:
        if note.note is None or note.channel is None or note.string is not None or note.stop is not None:
            plucks.append(note)
            continue
        i, channels = latest.get(note.note, (-1, set()))
        if i >= 0 and note.time <= plucks[i].time + SIMULTANEOUS and note.channel not in channels:
            channels.add(note.channel)
            quiet, loud = sorted((plucks[i], note), key=lambda n: n.velocity_midi or 0.0)
            end, up = (
                max(ends) for ends in zip(*((n.time + n.duration, n.key_up) for n in (quiet, loud)), strict=True)
            )
            time = plucks[i].time
            plucks[i] = replace(loud, time=time, duration=end - time, held=up - time if up < end else None)
            doubled.append(quiet)
        else:
            latest[note.note] = len(plucks), {note.channel}
            plucks.append(note)
    return plucks, doubled


class _Candidate(NamedTuple):
    """A note that can be played: its number among the notes, and its places."""

    number: int
    note: Note
    options: list[Option]


_Chord = list[_Candidate]


def _chords(notes: Sequence[Note], resolver: PlaceResolver) -> tuple[list[_Chord], list[tuple[int, Dropped]]]:
    """Group notes that begin together into chords that can be played on different strings; drop the others.

    Notes within `SIMULTANEOUS` cannot follow one another on a string. Those that begin within `CHORD_WINDOW` are one
    chord if there are strings for all of them, else they follow.
    """
    playable: _Chord = []
    dropped: list[tuple[int, Dropped]] = []

    def drop(index: int, note: Note, reason: str) -> None:
        dropped.append((index, Dropped(note.time, note.note, note.channel, reason)))

    for i, note in enumerate(notes):
        try:
            playable.append(_Candidate(i, note, resolver.options(note)))
        except ScoreError as error:
            drop(i, note, error.reason)
    chords: list[_Chord] = []
    matching = StringMatching()
    first = 0
    while first < len(playable):
        begin = playable[first].note.time
        last = first
        while last < len(playable) and playable[last].note.time <= begin + SIMULTANEOUS:
            last += 1
        unit = playable[first:last]
        first = last
        if chords and begin <= chords[-1][0].note.time + CHORD_WINDOW:
            joined = matching.copy()
            if all(joined.add(voice.options) for voice in unit):
                matching = joined
                chords[-1].extend(unit)
                continue
        matching = StringMatching()
        kept = {i for i in _by_importance(unit) if matching.add(unit[i].options)}
        sounding = {unit[i].note.note for i in kept if unit[i].note.note is not None}
        for i, (index, note, _) in enumerate(unit):
            if i not in kept:
                why = f"no string is free beside the other {len(unit) - 1} notes at its moment"
                if note.note in sounding:
                    why = "its pitch is played at its moment already, and no other string is free for it"
                drop(index, note, why)
        chords.append([unit[i] for i in sorted(kept)])
    return chords, dropped


def _by_importance(unit: _Chord) -> list[int]:
    """Named strings first, then the loudest, then the outer voices: order in which notes get a string."""
    by_pitch = sorted(range(len(unit)), key=lambda i: unit[i].note.note or 0.0)
    depth = {i: min(rank, len(unit) - 1 - rank) for rank, i in enumerate(by_pitch)}
    return sorted(
        range(len(unit)), key=lambda i: (unit[i].note.string is None, -(unit[i].note.velocity_midi or 0.0), depth[i])
    )


def _chord(voices: _Chord, origin: float = 0.0) -> Chord:
    """Chord for `fingering`, with times from an origin (s)."""
    return Chord(
        time=voices[0].note.time - origin,
        ends=tuple(v.note.time - origin + v.note.duration for v in voices),
        durations=tuple(max(v.note.duration, 1e-6) for v in voices),
        options=tuple(tuple(v.options) for v in voices),
    )


def _ends(
    pairs: Sequence[tuple[Note, Option]], strings: Sequence[PlayableString], resolver: PlaceResolver
) -> tuple[tuple[Assigned, ...], int]:
    """End each note at the next one on its string, if that comes first; count those ended by another pitch."""
    following: dict[int, tuple[float, float]] = {}  # string: time and stop of the note after
    assigned: list[Assigned] = []
    n_cut = 0
    for note, option in reversed(pairs):
        time, stop = following.get(option.string, (math.inf, 0.0))
        end = note.time + note.duration
        n_cut += time < end - SIMULTANEOUS and stop != option.stop
        assigned.append(
            Assigned(note, strings[option.string].name, option.stop, resolver.cents(note, option), min(end, time))
        )
        following[option.string] = note.time, option.stop
    return tuple(reversed(assigned)), n_cut
