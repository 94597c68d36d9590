"""A whole score to actions of hands: strings, stops, bends, plucks with their forces, and the ends of notes."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from tonewood.errors import NothingPlayedError, ScoreError
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.between_notes import key_noises, laid_on, noises, slurred
from tonewood.performance.player.dampers import SOSTENUTO, SUSTAIN, UNA_CORDA, pedal_moves
from tonewood.performance.player.hands import Hands
from tonewood.performance.player.strokes import BEND_RATE, beyond_capo, event_values, tapped, with_force
from tonewood.performance.player.techniques import checked_technique, with_marks, with_techniques
from tonewood.performance.player.timeline import GRID, Change, Timeline
from tonewood.performance.player.variation import Deviates, moved
from tonewood.performance.player.voices import Voice
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

    channel_per_string : notes of the first channel go to the first string, and so on.
    capo : stop at which all strings are held that no finger stops, 0 for none. Stops of notes are counted from the nut.
    Raises ScoreError : there are no stops beyond the capo, the score has no notes, none that can be played, or asks for
        a technique the instrument does not have.
    """
    score = with_techniques(score, model.playing)
    score = with_marks(score, [n for n, e in model.exciters.items() if e.at is None], playable(model))
    if not score.notes and not score.dropped:
        raise ScoreError("has no notes to play", file=score.place)
    controllers = Controllers(score.controls)
    for note in score.notes:
        checked_technique(note.technique, model, score.place)
    body = [tapped(note, model, score.place) for note in score.notes]
    notes = [
        beyond_capo(with_force(note, model, loudness(controllers.of(note))), capo)
        for note, tap in zip(score.notes, body, strict=True)
        if tap is None
    ]
    assignment = assign(
        notes, playable(model, capo), channel_per_string=channel_per_string, tuning=model.instrument.tuning
    )
    bends = {c: History(_glided(wheel, GRID / model.fs)) for c, wheel in _by_channel(score.controls).items()}
    pedals, pedal_warnings = pedal_moves(model, score.controls)
    hands, played = Hands(model, capo, pedals, score.place), list[Assigned]()
    for numbered in _by_string(assignment.notes, model, capo):
        notes_of_string = [assigned for _, assigned in numbered]
        gestures = []
        for (i, assigned), following in zip_longest(numbered, notes_of_string[1:]):
            voice = Voice(i, assigned.note, assigned=assigned, duration=_duration(assigned, following, model))
            voice.bends = bends.get(assigned.note.channel, voice.bends)
            gestures.append(hands.begin(voice, event_values(assigned.note, model, controllers.of(assigned.note))))
        hands.finish(voice)
        hands.plays += noises(notes_of_string, gestures, model, capo)
        hands.plays += key_noises(notes_of_string, model)
        played += notes_of_string
    decided = hands.taken()
    plays = [*(tap for tap in body if tap is not None), *decided.plays]
    dropped = [*score.dropped, *assignment.dropped]
    if not plays:
        raise NothingPlayedError(_why_nothing(dropped), file=score.place)
    warnings = [*score.warnings, *pedal_warnings]
    n_bent = len({(c.string, c.stop, c.cents) for c in decided.changes if c.cents is not None and c.stop is None})
    if n_bent > _MANY_BENDS:
        warnings.append(
            f"{n_bent} different bends of strings: the modes of each are computed anew, which takes long; "
            "`tonewood plan` says how long"
        )
    if assignment.n_cut:
        warnings.append(f"{assignment.n_cut} notes end early: their string is needed again")
    if hands.n_moved:
        warnings.append(
            f"notes played at another place than asked for, which lies within 1 % of the length of the string's ends, "
            f"or beyond the stop: {hands.n_moved}"
        )
    if assignment.doubled:
        warnings.append(f"{len(assignment.doubled)} notes share another voice's pluck of the same pitch")
    first = min([0.0, *(play.start for play in plays)])
    changes = [*laid_on(first, model), *decided.changes]
    if capo:
        changes += [Change(first, name, stop=capo) for name in model.strings]
    timeline = Timeline(sorted(changes, key=lambda c: c.time), sorted(plays, key=lambda p: p.start))
    notes_played = sorted(played, key=lambda a: a.note.time)
    return Performance(timeline, notes_played, sorted(dropped, key=lambda d: d.time), warnings, _ignored(score, model))


def _by_string(notes: Sequence[Assigned], model: Model, capo: int) -> Iterator[list[tuple[int, Assigned]]]:
    """Yield the notes of each key, or string, with their numbers, in the order of their times, varied and slurred."""
    variation = model.playing.variation
    by_string: dict[str, list[tuple[int, Assigned]]] = defaultdict(list)
    for i, assigned in enumerate(notes):
        if capo:
            assigned = replace(assigned, stop=assigned.stop + capo)
        if variation.seed is not None:
            assigned = moved(assigned, Deviates.of(variation.seed, i), variation)
        by_string[assigned.string].append((i, assigned))
    for numbered in by_string.values():
        numbered.sort(key=lambda pair: pair[1].note.time)
        slurs = slurred([assigned for _, assigned in numbered], model.playing)
        yield [(i, slur) for (i, _), slur in zip(numbered, slurs, strict=True)]


def _duration(assigned: Assigned, following: Assigned | None, model: Model) -> float:
    """Return for how long a gesture goes on that lasts as long as its note, s."""
    duration, name = assigned.end - assigned.note.time, assigned.note.technique or model.default_exciter
    if following is None or (following.note.technique or model.default_exciter) != name:
        return duration
    free = following.note.time - assigned.note.time - model.exciter(name, assigned.string).recovery
    return min(duration, max(free, 0.5 * duration))


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

    Raises ScoreError : a string has no stops beyond the capo.
    """
    shortest = min((s.n_stops for s in model.strings.values()), default=0)
    if capo and not 0 < capo < shortest:
        raise ScoreError(f"is {capo}; 0 to {max(shortest - 1, 0)} are allowed on this instrument", key="capo")
    return [
        PlayableString(
            name,
            (s.open_note + capo, s.open_note + s.n_stops)
            if s.stopping.continuous and s.n_stops
            else tuple(s.open_note + i for i in range(capo, s.n_stops + 1)),
            s.stopping.continuous,
        )
        for name, s in model.strings.items()
        if name in model.groups
    ]


def _glided(bends: Sequence[Control], tick: float) -> list[Control]:
    """Return the bends with leaps drawn out to steps, one per `tick` (s), at no more than the greatest rate.

    Steps on the way are multiples of that rate, so that leaps there and back share the bases of their strings.
    """
    out: list[Control] = []
    value, step = 0.0, BEND_RATE * tick
    for i, control in enumerate(bends):
        time = control.time
        until = bends[i + 1].time if i + 1 < len(bends) else math.inf
        while value != control.value and time < until:
            way = control.value - value
            on_grid = step * (math.floor(value / step + 1e-9) + 1 if way > 0 else math.ceil(value / step - 1e-9) - 1)
            value = control.value if abs(way) <= step else on_grid
            out.append(Control(time, control.kind, value, control.channel))
            time += tick
    return out


def _by_channel(controls: Sequence[Control]) -> dict[int | None, list[Control]]:
    out: dict[int | None, list[Control]] = defaultdict(list)
    for control in controls:
        if control.kind == "bend":
            out[control.channel].append(control)
    return out
