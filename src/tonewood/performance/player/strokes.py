"""One note to a gesture and to changes of the left hand, however much is known of the notes around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from tonewood.errors import BundleError, ScoreError
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.gestures import Event, Gesture, Place, is_played, places
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.between_notes import LET_GO_AFTER, damping, let_go
from tonewood.performance.player.techniques import stop_course, touch_course
from tonewood.performance.player.timeline import GRID, Change, Play
from tonewood.performance.player.variation import Deviates, touched
from tonewood.performance.score.assignment import Assigned
from tonewood.performance.score.harmonics import antinode_near, middle_node
from tonewood.performance.score.note import Note
from tonewood.physics.stepping.forcing import Segment

#: cents/s, how fast a bend follows its wheel: a string whose tension jumped would gain as much energy as tension
BEND_RATE = 40e3
#: s, for the preparation of a pluck that follows another at once
_SHORTEST_PREPARATION = 1e-3


def exciter_of(note: Note, model: Model, string: str = "") -> Exciter[Any]:
    """Return the exciter that a note asks for, or the default, as it plays a string."""
    return model.exciter(note.technique or model.default_exciter, string)


def force_of(note: Note, model: Model, factor: float) -> float | None:
    """Force of a note in N; None leaves it to the exciter."""
    if note.force is not None:
        return note.force * factor
    if note.velocity_midi is not None:
        return model.playing.velocity.value(note.velocity_midi) * factor
    return None


def with_force(note: Note, model: Model, factor: float) -> Note:
    """Return a note with its force in N, if it has one, in place of its velocity.

    A `factor` below 1 brings it down to the least that the exciter allows: a volume of 0 refuses no note.
    """
    force, whole = force_of(note, model, factor), force_of(note, model, 1.0)
    if force is None or whole is None:
        return note
    name = model.playing.velocity.parameter.partition(".")[2]
    field = type(exciter_of(note, model).parameters).model_fields.get(name)
    least = next((m.ge for m in field.metadata if hasattr(m, "ge")), -math.inf) if field is not None else -math.inf
    return replace(note, force=max(force, min(whole, least)), velocity_midi=None)


def beyond_capo(note: Note, capo: int) -> Note:
    """Return a note whose stop is counted from the capo, as the left hand counts."""
    return note if not capo or note.stop is None else replace(note, stop=max(note.stop - capo, 0.0))


def tapped(note: Note, model: Model, file: str) -> Play | None:
    """Return the gesture of a note on a point of the body; None if its technique plays strings."""
    exciter = exciter_of(note, model)
    if exciter.at is None:
        return None
    is_force = note.force is not None or model.playing.velocity.parameter.endswith(".force")  # not a hammer's speed
    force = force_of(note, model, 1.0) if is_force else None
    values = {} if force is None else {"force": force}
    with values_of(note, values, exciter, exciter.at, file):
        return Play(note.time, exciter.gesture(Event(values), Place(exciter.at)), at=exciter.at)


def event_values(note: Note, model: Model, latest: Callable[[str], float | None]) -> dict[str, float]:
    """Values of the exciter's parameters that a note and controllers give.

    note : with its force in N.
    latest : kind of controller -> its value from 0 to 1 on the note's channel, None before its first.
    """
    name = note.technique or model.default_exciter
    values: dict[str, float] = {}
    for kind, control in model.playing.controls.items():
        exciter, _, parameter = control.parameter.partition(".")
        value = latest(kind) if exciter == name else None
        if value is not None:
            values[parameter] = control.value(value)
    by_note = {
        model.playing.velocity.parameter.partition(".")[2]: note.force,
        "from_bridge": note.from_bridge,
        "angle_deg": note.angle_deg,
    }
    # a hammer has no force for a velocity that means one, a bow's stroke no angle
    fields = type(model.exciters[name].parameters).model_fields
    return values | {k: v for k, v in by_note.items() if v is not None and k in fields}


def is_where_asked(event: Event, assigned: Assigned, model: Model, file: str) -> bool:
    """Whether a note is played where it is asked for; a place beyond the string is refused by a `ScoreError`."""
    string, exciter = model.strings[assigned.string], exciter_of(assigned.note, model, assigned.string)
    length = string.length(assigned.stop)
    try:
        own_places = places(exciter.adjusted(event.values), string.length(), length)
    except ValueError as fault:
        reason = f"the note at {assigned.note.time:g} s on string {string.name}: {fault}"
        raise ScoreError(reason, file=file, key=exciter.key) from None
    return all(is_played(x, length) for x in own_places.values())


@contextmanager
def values_of(note: Note, values: Collection[str], exciter: Exciter[Any], where: str, file: str) -> Iterator[None]:
    """Raise a ScoreError, which names the note, where a value that it gives is out of its exciter's range.

    values : names of those that it gives; faults of others are the bundle's.
    where : the note is played.
    """
    try:
        yield
    except BundleError as fault:
        name = (fault.key or exciter.key).removeprefix(f"{exciter.key}.")
        if name not in values:
            raise
        reason = f"the note at {note.time:g} s on {where}: {name} {fault.reason}"
        raise ScoreError(reason, file=file, key=exciter.key) from None


def gripped(gesture: Gesture) -> Gesture:
    """Return the gesture with its finger's whole dashpot from the first touch on: each change of it costs a block."""
    hold = gesture.hold
    return gesture if hold is None else replace(gesture, hold=replace(hold, grown=hold.start))


def hurried(gesture: Gesture, available: float) -> Gesture:
    """Return the gesture prepared within `available` s: the string's last pluck has to be over before it begins.

    A gesture that moves a mass or a bow is not hurried: its impulse would change. It takes over from the gesture
    before.
    """
    if gesture.on is not None or gesture.motions:
        return gesture
    shorter = max(available, _SHORTEST_PREPARATION) / -gesture.start if gesture.start < 0 else 1.0
    if shorter >= 1.0:
        return gesture

    def time(t: float) -> float:
        return t * shorter if t < 0 else t

    segments = tuple(
        Segment(time(s.start), time(s.stop), s.c0, s.c1 / shorter, s.c2 / shorter**2) if s.stop <= 0 else s
        for s in gesture.segments
    )
    hold = gesture.hold
    if hold is not None:
        hold = replace(hold, start=time(hold.start), grown=time(hold.grown), stop=time(hold.stop))
    noise = gesture.noise and gesture.noise.after(time(gesture.start))
    return replace(gesture, segments=segments, hold=hold, noise=noise)


def stroke(
    assigned: Assigned,
    string: str,
    model: Model,
    values: Mapping[str, float],
    *,
    stop_before: float,
    duration: float,
    una_corda: bool = False,
    drawn: Deviates | None = None,
) -> tuple[Event, Play]:
    """Make the gesture of a note on one string of its key.

    assigned, string : the note, and the string.
    values : of the exciter's parameters, see `event_values`.
    stop_before : stop at which the string is held before.
    duration : s, for which a gesture that lasts as long as its note goes on.
    una_corda : whether that pedal is down.
    drawn : how the note varies, if it does.
    Returns The event, and the gesture at the note's time with its whole preparation.
    """
    note, course = assigned.note, model.strings[string]
    exciter = exciter_of(note, model, string)
    if drawn is not None:
        values = touched(values, exciter, course.length(assigned.stop), drawn, model.playing.variation)
    if note.partial is not None and "touch" in type(exciter.parameters).model_fields:
        values = {**_on_nodes(note.partial, exciter, course.length(assigned.stop)), **values}
    event = Event(values, course.freq(assigned.stop), duration, assigned.stop, stop_before, course.length(stop_before))
    gesture = exciter.gesture(event, model.place(string, assigned.stop, una_corda=una_corda))
    return event, Play(note.time, gesture, string=string, exciter=note.technique or model.default_exciter)


def _on_nodes(partial: int, exciter: Exciter[Any], length: float) -> dict[str, float]:
    """Places, m from the bridge, of the finger and the pluck of a harmonic on a string of a length (m)."""
    usual = places(exciter.parameters, length, length)["from_bridge"]
    return {
        "touch": length * (1.0 - middle_node(partial)),
        "from_bridge": length * antinode_near(partial, usual / length),
    }


def stopped(assigned: Assigned, play: Play, string: str, model: Model, cents: float) -> list[Change]:
    """Return how the left hand stops a string for a gesture: the first change as it begins, then slides and touches.

    cents : bend from the stop's own pitch at the beginning.
    """
    tick = GRID / model.fs
    course = stop_course(play, assigned.stop, model.strings[string].stopping.continuous, tick)
    (begin, first), *rest = course or [(play.start, assigned.stop)]
    out = [Change(begin, string, stop=first, cents=cents, added_damping=0.0, touches=())]
    out += [Change(time, string, touches=touches) for time, touches in touch_course(play, tick)]
    return out + [Change(time, string, stop=stop) for time, stop in rest]


def ended(time: float, string: str, model: Model, capo: float, following: float = math.inf) -> list[Change]:
    """Return how a hand ends a note at a time (s): it damps the string, and lets it go later.

    A note that ends while the next one on its string is prepared is ended by that: its damper would stay on the string.

    capo : stop of the idle string.
    following : s, when the next gesture on the string begins, where that is known.
    """
    end = model.playing.note_end
    if end.kind == "ring" or model.strings[string].places.damper is not None or not time < following - 1e-3:
        return []
    out = [Change(time, string, added_damping=damping(end))]
    free = time + LET_GO_AFTER * end.t60
    return [*out, let_go(free, string, capo, end)] if free < following - 0.1 else out
