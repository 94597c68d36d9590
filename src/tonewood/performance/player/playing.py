"""A whole score to actions of hands: strings, stops, bends, plucks with their forces, and the ends of notes."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from tonewood.errors import NothingPlayedError, ScoreError
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.dampers import SOSTENUTO, SUSTAIN, UNA_CORDA, Dampers, pedal_moves
from tonewood.performance.player.hands import laid_on, noises, slurred
from tonewood.performance.player.strokes import (
    BEND_RATE,
    beyond_capo,
    ended,
    event_values,
    hurried,
    is_where_asked,
    stopped,
    stroke,
    tapped,
    with_force,
)
from tonewood.performance.player.techniques import checked_technique, with_marks, with_techniques
from tonewood.performance.player.timeline import GRID, Change, Play, Timeline
from tonewood.performance.player.variation import Deviates, moved
from tonewood.performance.score.assignment import Assigned, PlayableString, assign
from tonewood.performance.score.controllers import Controllers, History, loudness
from tonewood.performance.score.note import Control, Dropped, Score, ignored_name

#: volume, expression, sustain pedal
_READ_CONTROLLERS = ("cc7", "cc11", SUSTAIN)
#: bends of a score that are said to take long
_MANY_BENDS = 2000


@dataclass(frozen=True)
class Performance:
    """A score made playable on one instrument.

    Attributes
    ----------
    timeline : changes and gestures.
    notes : every note played, with its string and stop.
    dropped : notes that cannot be played, and why.
    warnings : one line each.
    ignored : kind of message or controller that the instrument does not use -> how many there were.
    """

    timeline: Timeline
    notes: Sequence[Assigned]
    dropped: Sequence[Dropped]
    warnings: Sequence[str]
    ignored: Mapping[str, int]


def perform(score: Score, model: Model, *, channel_per_string: bool = False, capo: int = 0) -> Performance:
    """Give every note a string, a stop and a gesture.

    Notes may ask for `technique` the name of one of the instrument's exciters, or the bundle's keys and controllers
    ask for them; the bundle's first one is the default.

    Parameters
    ----------
    channel_per_string : notes of the first channel go to the first string, and so on.
    capo : stop at which all strings are held that no finger stops, 0 for none. Stops of notes are counted from the nut.

    Raises
    ------
    ScoreError : there are no stops beyond the capo, the score has no notes, none that can be played, or asks for a
        technique the instrument does not have.
    """
    score = with_techniques(score, model.playing)
    score = with_marks(score, [n for n, e in model.exciters.items() if e.at is None], playable(model))
    if not score.notes and not score.dropped:
        raise ScoreError("has no notes to play", file=score.place)
    controllers = Controllers(score.controls)
    for note in score.notes:
        checked_technique(note.technique, model, score.place)
    body = [tapped(note, model) for note in score.notes]
    notes = [
        beyond_capo(with_force(note, model, loudness(controllers.of(note))), capo)
        for note, tap in zip(score.notes, body, strict=True)
        if tap is None
    ]
    assignment = assign(
        notes, playable(model, capo), channel_per_string=channel_per_string, tuning=model.instrument.tuning
    )
    by_string: dict[str, list[Assigned]] = defaultdict(list)
    drawn: dict[int, Deviates] = {}
    variation = model.playing.variation
    for i, assigned in enumerate(replace(a, stop=a.stop + capo) if capo else a for a in assignment.notes):
        if variation.seed is not None:
            deviates = Deviates.of(variation.seed, i)
            assigned = moved(assigned, deviates, variation)
            drawn[id(assigned)] = deviates
        by_string[assigned.string].append(assigned)
    reader = _Reader(model, score, controllers, drawn, capo)
    for name, line in by_string.items():
        reader.play(name, sorted(line, key=lambda a: a.note.time))
    plays = [*(tap for tap in body if tap is not None), *reader.plays]
    dropped = [*score.dropped, *assignment.dropped]
    if not plays:
        raise NothingPlayedError(_why_nothing(dropped), file=score.place)
    warnings = [*score.warnings, *reader.warnings]
    n_bent = len({(c.string, c.stop, c.cents) for c in reader.changes if c.cents is not None and c.stop is None})
    if n_bent > _MANY_BENDS:
        warnings.append(
            f"{n_bent} different bends of strings: the modes of each are computed anew, which takes long; "
            "`tonewood plan` says how long"
        )
    if assignment.n_cut:
        warnings.append(f"{assignment.n_cut} notes end early: their string is needed again")
    if reader.n_moved:
        warnings.append(
            f"{reader.n_moved} notes are played at another place than asked for: that lies within 1 % of the length of "
            "its ends, or beyond the stop"
        )
    if assignment.doubled:
        warnings.append(f"{len(assignment.doubled)} notes share another voice's pluck of the same pitch")
    first = min([0.0, *(play.start for play in plays)])
    changes = laid_on(first, model) + reader.changes + _damper_changes(model, reader.pedals, reader.pressed)
    if capo:
        changes += [Change(first, name, stop=capo) for name in model.strings]
    timeline = Timeline(
        sorted(changes, key=lambda c: c.time),
        sorted(plays, key=lambda p: p.start),
    )
    notes_played = sorted(reader.played, key=lambda a: a.note.time)
    return Performance(timeline, notes_played, sorted(dropped, key=lambda d: d.time), warnings, _ignored(score, model))


class _Reader:
    """Plays strings whose notes are all known.

    Attributes
    ----------
    changes, plays, played : of the strings played so far, and their notes.
    pressed : (time, whether it goes down, first string) of keys.
    pedals, warnings : moves of pedals, and lines about them.
    n_moved : notes that are played at another place than asked for.
    """

    def __init__(self, model: Model, score: Score, controllers: Controllers, drawn: Mapping[int, Deviates], capo: int):
        self._model, self._capo, self._file = model, capo, score.place
        self._controllers, self._drawn = controllers, drawn
        self._bends = {c: History(_glided(line, GRID / model.fs)) for c, line in _by_channel(score.controls).items()}
        self.pedals, self.warnings = pedal_moves(model, score.controls)
        self._una_corda = History([move for move in self.pedals if move.kind == UNA_CORDA])
        self.changes: list[Change] = []
        self.plays: list[Play] = []
        self.played: list[Assigned] = []
        self.pressed: list[tuple[float, bool, str]] = []
        self.n_moved = 0

    def play(self, name: str, line: Sequence[Assigned]) -> None:
        """Play the notes of one key, or of one string, in the order of their times."""
        model = self._model
        line = slurred(line, model.playing)
        for string in model.groups[name]:
            own: list[Play] = []
            for i, assigned in enumerate(line):
                held, time = line[i - 1].stop if i else float(self._capo), assigned.note.time
                event, play = stroke(
                    assigned, string, model, event_values(assigned.note, model, self._controllers.of(assigned.note)),
                    held=held, duration=self._duration(assigned, line[i + 1] if i + 1 < len(line) else None, string),
                    una_corda=(self._una_corda.at(time) or 0.0) >= 0.5, drawn=self._drawn.get(id(assigned)),
                )  # fmt: skip
                self.n_moved += string == name and not is_where_asked(event, assigned, model, self._file)
                if i:
                    play = replace(play, gesture=hurried(play.gesture, play.time - own[-1].stop))
                own.append(play)
            for assigned, play, following in zip(line, own, [*own[1:], None], strict=True):
                self.changes += self._left_hand(assigned, play, following, string)
            # a hammer or bow of the first string meets the others of its key, too; known forces act on each of them
            self.plays += [play for play in own if string == name or not (play.gesture.on or play.gesture.motions)]
            if string == name:
                self.played += line
                self._press(name, line, own)
                self.plays += noises(line, own, model, self._capo)

    def _duration(self, assigned: Assigned, following: Assigned | None, string: str) -> float:
        """Return for how long a gesture goes on that lasts as long as its note, s."""
        duration, name = assigned.end - assigned.note.time, assigned.note.technique or self._model.default_exciter
        if following is None or (following.note.technique or self._model.default_exciter) != name:
            return duration
        free = following.note.time - assigned.note.time - self._model.exciter(name, string).recovery
        return min(duration, max(free, 0.5 * duration))

    def _left_hand(self, assigned: Assigned, play: Play, following: Play | None, string: str) -> list[Change]:
        """Stop the string as the pluck begins, bend it with its channel, damp it at the note's end."""
        bends = self._bends.get(assigned.note.channel, History())
        first, *later = stopped(assigned, play, string, self._model, assigned.cents + (bends.at(play.start) or 0.0))
        bent = [Change(b.time, string, cents=assigned.cents + b.value) for b in bends.between(play.start, assigned.end)]
        following_start = following.start if following else math.inf
        if not math.isfinite(assigned.end):
            return [first, *later, *bent]
        return [first, *later, *bent, *ended(assigned.end, string, self._model, self._capo, following_start)]

    def _press(self, name: str, line: Sequence[Assigned], plays: Sequence[Play]) -> None:
        """Enter when a key goes down and comes up; struck again it does not come up in between."""
        for i, (assigned, play) in enumerate(zip(line, plays, strict=True)):
            up = min(assigned.note.key_up, plays[i + 1].start if i + 1 < len(plays) else math.inf)
            if up > play.start:
                self.pressed += [(play.start, True, name), (up, False, name)]


def _damper_changes(
    model: Model, pedals: Sequence[Control], pressed: Sequence[tuple[float, bool, str]]
) -> list[Change]:
    """Return how keys and pedals move dampers; at one time keys come up, then go down, then pedals move."""
    dampers = Dampers(model)
    events: list[tuple[float, int, Control | str]] = [(time, int(down), name) for time, down, name in pressed]
    events += [(move.time, 2, move) for move in pedals]
    out: list[Change] = []
    for time, together in groupby(sorted(events, key=lambda e: e[:2]), key=lambda e: e[0]):
        for _, kind, event in together:
            if isinstance(event, Control):
                dampers.control(event.kind, event.value, event.channel)
            elif kind:
                dampers.press(event)
            else:
                dampers.release(event)
        out += dampers.moved(time)
    return out


def _ignored(score: Score, model: Model) -> dict[str, int]:
    """Count events ignored while reading, and changes of controllers that neither the player nor the bundle reads."""
    read = {"bend", *_READ_CONTROLLERS, *model.playing.controls, *model.playing.switches}
    if (keys := model.instrument.spec.keys) is not None and keys.has_pedals:
        read |= {SOSTENUTO, UNA_CORDA}
    unread = Counter(ignored_name(c.kind) for c in score.controls if c.kind not in read)
    return dict(Counter(score.ignored) + unread)


def _why_nothing(dropped: Sequence[Dropped]) -> str:
    """One line: how many notes were dropped, and the reasons from the most frequent on."""
    reasons = Counter(drop.reason for drop in dropped).most_common()
    listed = "; ".join(f"{reason} ({count})" if count > 1 else reason for reason, count in reasons[:3])
    count = "the one note cannot" if len(dropped) == 1 else f"none of {len(dropped)} notes can"
    return f"{count} be played: {listed}" + ("; and others" if len(reasons) > 3 else "")


def playable(model: Model, capo: int = 0) -> list[PlayableString]:
    """Return the strings as the left hand sees them, beyond a capo.

    Raises
    ------
    ScoreError : a string has no stops beyond the capo.
    """
    shortest = min((s.n_stops for s in model.strings.values()), default=0)
    if capo and not 0 < capo < shortest:
        raise ScoreError(f"is {capo}; 0 to {max(shortest - 1, 0)} are allowed on this instrument", key="capo")
    return [
        PlayableString(
            name,
            (s.open_note + capo, s.open_note + s.n_stops)
            if s.stopping.continuous
            else tuple(s.open_note + i for i in range(capo, s.n_stops + 1)),
            s.stopping.continuous,
        )
        for name, s in model.strings.items()
        if name in model.groups
    ]


def _glided(line: Sequence[Control], tick: float) -> list[Control]:
    """Return the bends with leaps drawn out to steps, one per `tick` (s), at no more than the greatest rate.

    Steps on the way are multiples of that rate, so that leaps there and back share the bases of their strings.
    """
    out: list[Control] = []
    value, step = 0.0, BEND_RATE * tick
    for i, control in enumerate(line):
        time = control.time
        until = line[i + 1].time if i + 1 < len(line) else math.inf
        while value != control.value and time < until:
            way = control.value - value
            on_grid = step * (math.floor(value / step + 1e-9) + 1 if way > 0 else math.ceil(value / step - 1e-9) - 1)
            value = control.value if abs(way) <= step else on_grid
            out.append(Control(time, control.kind, value, control.channel))
            time += tick
    return out


def _by_channel(controls: Sequence[Control]) -> dict[int | None, list[Control]]:
    """Bends of each channel."""
    out: dict[int | None, list[Control]] = defaultdict(list)
    for control in controls:
        if control.kind == "bend":
            out[control.channel].append(control)
    return out
