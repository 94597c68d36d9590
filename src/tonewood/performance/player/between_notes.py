"""Hands between the notes of a score: slurs, noises of fingers and keys, and hands that lie on idle strings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from tonewood.instrument.bundle.schema import NoteEnd, Playing
from tonewood.instrument.contract.gestures import Event, Place
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.timeline import GRID, Change, Play
from tonewood.performance.score.assignment import Assigned

#: a damped string is released after this many times its T60; then it rings with the others
LET_GO_AFTER = 1.5
#: a slide of the hand takes at most this share of the time that there is for it
_SHARE = 0.4


def slurred(notes: Sequence[Assigned], playing: Playing) -> list[Assigned]:
    """Return a string's notes; those that overlap the one before in the score get the technique of a slur.

    A note that names a technique keeps it.
    """
    slurs, out = playing.slurs, list(notes[:1])
    for before, assigned in pairwise(notes):
        both = before.note.time + before.note.duration - assigned.note.time
        steps = assigned.stop - before.stop
        way = slurs.far if abs(steps) > slurs.reach else slurs.up if steps > 0 else slurs.down
        if way is not None and steps and both >= slurs.overlap and assigned.note.technique is None:
            assigned = replace(assigned, note=replace(assigned.note, technique=way))
        out.append(assigned)
    return out


def damping(end: NoteEnd) -> float:
    """Decay rate that a hand adds to every mode of a string that it damps, 1/s."""
    return math.log(1000.0) / end.t60


def let_go(time: float, string: str, stop: float, end: NoteEnd) -> Change:
    """Take the stopping finger off a damped string; a hand stays on it where idle strings are damped."""
    return Change(time, string, stop=stop, cents=0.0, added_damping=None if end.idle == "damp" else 0.0)


def laid_on(time: float, model: Model) -> list[Change]:
    """Lay a hand on every string, where idle strings are damped."""
    end = model.playing.note_end
    return [Change(time, name, added_damping=damping(end)) for name in model.strings if end.idle == "damp"]


def noises(notes: Sequence[Assigned], plays: Sequence[Play], model: Model, capo: float) -> Iterator[Play]:
    """Yield the noises of the hands on one string that fit between the gestures of its notes, in order of time.

    line, plays : notes of the string and their gestures.
    capo : stop at which the string is held before its first note.
    """
    options, end, names = model.playing.noises, model.playing.note_end, _noise_exciters(model)
    if not names:
        return
    fret, free_from, slurs = capo, -math.inf, model.playing.slurs.named.values()
    for i, (assigned, play) in enumerate(zip(notes, plays, strict=True)):
        # a stop changes at the last point of the control grid before the gesture that needs it
        until = _point_before(play.start, model.fs)
        for kind in ("fretting", "squeak"):
            far = abs(assigned.stop - fret) >= options.least_shift and min(assigned.stop, fret) > capo
            moves = assigned.stop != fret and not play.gesture.stops and play.exciter not in slurs
            if kind not in names or not moves or (kind == "squeak" and not far):
                continue
            noise = _noise(names[kind], assigned, fret, until, _SHARE * (until - free_from), model)
            if noise is not None:
                until = noise.start
                yield noise
        fret, free_from = assigned.stop, play.stop
        following = plays[i + 1].start if i + 1 < len(plays) else math.inf
        if end.kind == "ring" or not math.isfinite(assigned.end) or assigned.end >= following - 1e-3:
            continue
        if "touch" in names and assigned.end >= free_from:
            # as the string is damped
            noise = _noise(names["touch"], assigned, fret, _point_before(assigned.end, model.fs), math.inf, model)
            if noise is not None and noise.stop < following:
                free_from = noise.stop
                yield noise
        if assigned.end + LET_GO_AFTER * end.t60 < following - 0.1:
            fret = capo


def touch_at_end(assigned: Assigned | None, play: Play | None, time: float, model: Model) -> list[Play]:
    """Return the noise of the finger that ends a note at a time (s), as it is played live.

    There is none where the noise is not wanted, or the string is still being plucked. It is the one noise that needs no
    knowledge of the next note.
    """
    name = _noise_exciters(model).get("touch")
    if name is None or assigned is None or (play is not None and play.stop > time):
        return []
    noise = _noise(name, assigned, assigned.stop, time, math.inf, model)
    return [] if noise is None else [noise]


def key_noises(notes: Sequence[Assigned], model: Model) -> Iterator[Play]:
    """Yield the noises of a key's notes: as it goes down, and as it comes up before the next note."""
    names = _noise_exciters(model)
    for i, assigned in enumerate(notes):
        note = assigned.note
        following = notes[i + 1].note.time if i + 1 < len(notes) else math.inf
        for kind, time in (("key", note.time), ("release", note.key_up)):
            if kind not in names or not math.isfinite(time) or (kind == "release" and time >= following):
                continue
            exciter = model.exciters[names[kind]]
            values = {} if note.force is None else {"velocity": note.force}
            values = {k: v for k, v in values.items() if k in type(exciter.parameters).model_fields}
            gesture = exciter.gesture(Event(values), Place(exciter.at or ""))
            if gesture.start < gesture.stop:
                yield Play(time, gesture, at=exciter.at, exciter=names[kind])


def not_live(model: Model) -> list[str]:
    """Noises that are wanted and need a score that is known ahead, as keys of the bundle."""
    return [f"playing.noises.{kind}" for kind in _noise_exciters(model) if kind != "touch"]


def _noise_exciters(model: Model) -> dict[str, str]:
    """Noise -> exciter, of those that are wanted and not left out."""
    noises = model.playing.noises
    return {k: name for k, name in noises.named.items() if noises.on and model.choice.keeps(model.exciters[name])}


def _point_before(time: float, fs: float) -> float:
    """Last point of the control grid, s, at or before a time (s)."""
    return math.floor(round(time * fs / GRID, 6)) * GRID / fs


def _noise(name: str, assigned: Assigned, stop_before: float, time: float, longest: float, model: Model) -> Play | None:
    """Gesture of an exciter at a time; None if it does nothing, or would be prepared for longer than `longest` (s)."""
    string = model.strings[assigned.string]
    event = Event({}, string.freq(assigned.stop), 0.0, assigned.stop, stop_before, string.length(stop_before))
    gesture = model.exciters[name].gesture(event, model.place(assigned.string, assigned.stop))
    if gesture.start == gesture.stop or -gesture.start > longest:
        return None
    # all that changes at its beginning then changes at one point of the grid; the gesture after it cuts off its end
    late = -(time + gesture.start) * model.fs / GRID
    return Play(time + round(late, 6) % 1.0 * GRID / model.fs, gesture, string=assigned.string, exciter=name)
