"""Notes to actions of hands: strings, stops, bends, plucks with their forces, and the ends of notes."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from tonewood.errors import NothingPlayedError, ScoreError
from tonewood.instrument.contract.gestures import Event, Place
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.hands import LET_GO_AFTER, damping, laid_on, let_go, noises, slurred
from tonewood.performance.player.note_events import event_values, exciter_of, force_of, hurried, is_where_asked
from tonewood.performance.player.pedals import SOSTENUTO, SUSTAIN, UNA_CORDA, PedalCourses
from tonewood.performance.player.techniques import stop_course, touch_course, with_marks, with_techniques
from tonewood.performance.player.timeline import GRID, Change, Play, Timeline
from tonewood.performance.player.variation import Deviates, moved, touched
from tonewood.performance.score.assignment import Assigned, PlayableString, assign
from tonewood.performance.score.controllers import Controllers, History
from tonewood.performance.score.note import Control, Dropped, Note, Score, ignored_name, volume_factors
from tonewood.support.validation_messages import did_you_mean

#: volume, expression, sustain pedal
_READ_CONTROLLERS = ("cc7", "cc11", SUSTAIN)
#: cents/s, how fast a bend follows its wheel: a string whose tension jumped would gain as much energy as tension
BEND_RATE = 40e3
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
    notes, body_plays = _split_taps(score, model)
    factor = dict(zip(map(id, score.notes), volume_factors(score), strict=True))
    louder = [_with_force(n, model, factor[id(n)]) for n in notes]
    if capo:
        louder = [n if n.stop is None else replace(n, stop=max(n.stop - capo, 0.0)) for n in louder]
    strings = playable(model, capo)
    assignment = assign(louder, strings, channel_per_string=channel_per_string, tuning=model.instrument.tuning)
    by_string: dict[str, list[Assigned]] = defaultdict(list)
    drawn: dict[int, Deviates] = {}
    variation = model.playing.variation
    for i, assigned in enumerate(replace(a, stop=a.stop + capo) if capo else a for a in assignment.notes):
        if variation.seed is not None:
            deviates = Deviates.of(variation.seed, i)
            assigned = moved(assigned, deviates, variation)
            drawn[id(assigned)] = deviates
        by_string[assigned.string].append(assigned)
    for line in by_string.values():
        line.sort(key=lambda a: a.note.time)
    controllers = Controllers(score.controls)
    bends = {c: History(_glided(line, GRID / model.fs)) for c, line in _by_channel(score.controls).items()}
    changes: list[Change] = []
    pedals = PedalCourses(model, score.controls)
    pressed: dict[str, list[tuple[float, float]]] = {}
    plays = list(body_plays)
    dropped = [*score.dropped, *assignment.dropped]
    played: list[Assigned] = []
    n_moved = 0
    for name, line in by_string.items():
        line = slurred(line, model.playing)
        for string in model.groups[name]:
            own: list[Play] = []
            for i, assigned in enumerate(line):
                following = line[i + 1] if i + 1 < len(line) else None
                held = line[i - 1].stop if i else float(capo)
                event = _event(assigned, string, held, following, model, controllers, drawn.get(id(assigned)))
                n_moved += string == name and not is_where_asked(event, assigned, model, score.place)
                place = model.place(string, assigned.stop, una_corda=pedals.una_corda(assigned.note.time))
                gesture = exciter_of(assigned.note, model, string).gesture(event, place)
                exciter = assigned.note.technique or model.default_exciter
                play = Play(assigned.note.time, gesture, string=string, exciter=exciter)
                if i:
                    play = replace(play, gesture=hurried(play.gesture, play.time - own[-1].stop))
                own.append(play)
            for assigned, play, following_play in zip(line, own, [*own[1:], None], strict=True):
                changes += _left_hand(assigned, play, following_play, string, model, bends, capo)
            if string == name:
                played += line
                pressed[name] = _presses(line, own)
            # a hammer or bow of the first string meets the others of its key, too; known forces act on each of them
            plays += [play for play in own if string == name or not (play.gesture.on or play.gesture.motions)]
            if string == name:
                plays += noises(line, own, model, capo)
    if not plays:
        raise NothingPlayedError(_why_nothing(dropped), file=score.place)
    warnings = list(score.warnings) + pedals.warnings
    n_bent = len({(c.string, c.stop, c.cents) for c in changes if c.cents is not None and c.stop is None})
    if n_bent > _MANY_BENDS:
        warnings.append(f"{n_bent} different bends of strings: the modes of each are computed anew, which takes long")
    if assignment.n_cut:
        warnings.append(f"{assignment.n_cut} notes end early: their string is needed again")
    if n_moved:
        warnings.append(
            f"{n_moved} notes are played at another place than asked for: that lies within 1 % of the length of "
            "its ends, or beyond the stop"
        )
    if assignment.doubled:
        warnings.append(f"{len(assignment.doubled)} notes share another voice's pluck of the same pitch")
    first = min([0.0, *(play.start for play in plays)])
    changes = laid_on(first, model) + changes + pedals.changes(pressed)
    if capo:
        changes += [Change(first, name, stop=capo) for name in model.strings]
    timeline = Timeline(
        sorted(changes, key=lambda c: c.time),
        sorted(plays, key=lambda p: p.start),
    )
    played.sort(key=lambda a: a.note.time)
    return Performance(timeline, played, sorted(dropped, key=lambda d: d.time), warnings, _ignored(score, model))


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


def _split_taps(score: Score, model: Model) -> tuple[list[Note], list[Play]]:
    """Notes for strings, and gestures on points of the body that `technique` names."""
    strings, taps = [], []
    for note in score.notes:
        if note.technique is None or note.technique not in model.exciters:
            if note.technique is not None:
                names = f"{did_you_mean(note.technique, model.exciters)}there are {', '.join(model.exciters)}"
                raise ScoreError(f"there is no technique {note.technique!r}; {names}", file=score.place)
            strings.append(note)
            continue
        exciter = model.exciters[note.technique]
        if exciter.at is None:
            strings.append(note)
            continue
        force = force_of(note, model, 1.0)
        values = {} if force is None else {"force": force}
        taps.append(Play(note.time, exciter.gesture(Event(values), Place(exciter.at)), at=exciter.at))
    return strings, taps


def _with_force(note: Note, model: Model, factor: float) -> Note:
    force = force_of(note, model, factor)
    return note if force is None else replace(note, force=force, velocity_midi=None)


def _presses(line: Sequence[Assigned], plays: Sequence[Play]) -> list[tuple[float, float]]:
    """When the key of a string's notes goes down and comes up, s; struck again it does not come up in between."""
    out = []
    for i, (assigned, play) in enumerate(zip(line, plays, strict=True)):
        up = assigned.note.key_up
        out.append((play.start, min(up, plays[i + 1].start) if i + 1 < len(plays) else up))
    return out


def _event(
    assigned: Assigned,
    on: str,
    held: float,
    following: Assigned | None,
    model: Model,
    controllers: Controllers,
    drawn: Deviates | None,
) -> Event:
    """Return the values that the exciter is given: the note's own, and those of controllers."""
    note, string = assigned.note, model.strings[on]
    name = note.technique or model.default_exciter
    values = event_values(note, model, lambda kind: controllers.at(kind, note.channel, note.time))
    if drawn is not None:
        length = string.length(assigned.stop)
        values = touched(values, model.exciter(name, on), length, drawn, model.playing.variation)
    duration = assigned.end - note.time
    if following is not None and (following.note.technique or model.default_exciter) == name:
        free = following.note.time - note.time - model.exciter(name, on).recovery
        duration = min(duration, max(free, 0.5 * duration))
    return Event(values, string.freq(assigned.stop), duration, assigned.stop, held, string.length(held))


def _left_hand(
    assigned: Assigned,
    play: Play,
    following: Play | None,
    name: str,
    model: Model,
    bends: Mapping[int | None, History],
    capo: int,
) -> list[Change]:
    """Stop the string as the pluck begins, bend it with its channel, damp it at the note's end.

    A note that ends while the next one on its string is prepared is ended by that: its damper would stay on the string.
    """
    channel = assigned.note.channel
    line = bends.get(channel, History())
    at_start = assigned.cents + (line.at(play.start) or 0.0)
    course = stop_course(play, assigned.stop, model.strings[name].stopping.continuous, GRID / model.fs)
    (begin, first), *rest = course or [(play.start, assigned.stop)]
    out = [Change(begin, name, stop=first, cents=at_start, added_damping=0.0, touches=())]
    out += [Change(time, name, touches=touches) for time, touches in touch_course(play, GRID / model.fs)]
    out += [Change(time, name, stop=stop) for time, stop in rest]
    out += [Change(b.time, name, cents=assigned.cents + b.value) for b in line.between(play.start, assigned.end)]
    end = model.playing.note_end
    if end.kind == "ring" or model.strings[name].damper is not None or not math.isfinite(assigned.end):
        return out
    free_again = following.start if following else math.inf
    if assigned.end < free_again - 1e-3:
        out.append(Change(assigned.end, name, added_damping=damping(end)))
        free = assigned.end + LET_GO_AFTER * end.t60
        if free < free_again - 0.1:
            out.append(let_go(free, name, capo, end))
    return out


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
