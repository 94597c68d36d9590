"""One note's event for its exciter: technique, force, values of controllers, and a shorter preparation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tonewood.errors import ScoreError
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.gestures import Event, Gesture, is_played, places
from tonewood.instrument.model.assembly import Model
from tonewood.performance.score.assignment import Assigned
from tonewood.performance.score.note import Note
from tonewood.physics.stepping.forcing import Segment

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


def event_values(note: Note, model: Model, latest: Callable[[str], float | None]) -> dict[str, float]:
    """Values of the exciter's parameters that a note and controllers give.

    Parameters
    ----------
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
    given = {
        model.playing.velocity.parameter.partition(".")[2]: note.force,
        "from_bridge": note.from_bridge,
        "angle_deg": note.angle_deg,
    }
    # a hammer has no force for a velocity that means one, a bow's stroke no angle
    known = type(model.exciters[name].parameters).model_fields
    return values | {k: v for k, v in given.items() if v is not None and k in known}


def is_where_asked(event: Event, assigned: Assigned, model: Model, file: str) -> bool:
    """Whether a note is played where it is asked for; a place beyond the string is refused by a `ScoreError`."""
    string, exciter = model.strings[assigned.string], exciter_of(assigned.note, model, assigned.string)
    length = string.length(assigned.stop)
    try:
        asked = places(exciter.adjusted(event.values), string.length(), length)
    except ValueError as fault:
        reason = f"the note at {assigned.note.time:g} s on string {string.name}: {fault}"
        raise ScoreError(reason, file=file, key=exciter.key) from None
    return all(is_played(x, length) for x in asked.values())


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
