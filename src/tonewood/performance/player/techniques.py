"""Techniques that a score asks for, and the courses of the stop and of touching points that they give."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tonewood.errors import ScoreError
from tonewood.instrument.bundle.schema import Playing
from tonewood.instrument.contract.attached import Motion
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_number
from tonewood.performance.player.timeline import Play
from tonewood.performance.score.assignment import PlayableString
from tonewood.performance.score.controllers import Controllers
from tonewood.performance.score.harmonics import interval
from tonewood.performance.score.note import Note, Score
from tonewood.support.validation_messages import did_you_mean

#: s that a slide's end is heard before the note ends, or its string is struck again
_ARRIVAL = 0.03
#: stops of a slide are rounded to this fraction of a step
_FINEST = 1000


def with_techniques(score: Score, playing: Playing) -> Score:
    """The score without its keyswitches, and with the techniques they and controllers ask for.

    A keyswitch holds for its channel until the next one; a controller while it is at a half or more, and before any
    keyswitch. A technique that a note names itself stands.
    """
    if not (playing.keyswitches or playing.switches):
        return score
    keys = {float(note_number(key)): technique for key, technique in playing.keyswitches.items()}
    controllers = Controllers(score.controls)
    notes, latest = [], dict[int | None, str]()
    # a key pressed together with a note is meant for it
    for note in sorted(score.notes, key=lambda n: (n.time, n.note not in keys)):
        if note.note in keys and note.string is None:
            latest[note.channel] = keys[note.note]
            continue
        technique = technique_of(note, latest.get(note.channel), playing, controllers.of(note))
        notes.append(replace(note, technique=technique))
    return replace(score, notes=notes)


def technique_of(note: Note, keyed: str | None, playing: Playing, latest: Callable[[str], float | None]) -> str | None:
    """Return the technique that a note names, or that keys and controllers ask for; None for the usual one.

    keyed : technique of the last keyswitch on the note's channel.
    latest : kind of controller -> its value on the note's channel, None before its first.
    """
    technique = note.technique or keyed
    for kind, name in playing.switches.items():
        if note.technique is None and (latest(kind) or 0.0) >= 0.5:
            technique = name
    return technique


def checked_technique(name: str | None, model: Model, file: str | None = None) -> None:
    """Refuse a technique that the instrument does not have."""
    if name is not None and name not in model.exciters:
        names = f"{did_you_mean(name, model.exciters)}there are {', '.join(model.exciters)}"
        raise ScoreError(f"there is no technique {name!r}; {names}", file=file)


#: sign -> techniques that play it, the first that the instrument has
_SIGNS = {
    "palm_mute": ("palm",),
    "hammer_on": ("hammer_on",),
    "pull_off": ("pull_off",),
    "slide": ("slide",),
    "harmonic": ("harmonic",),
    "slap": ("slap",),
    "pop": ("pop",),
    "tapping": ("hammer_on",),
    "dead_note": ("palm",),
    "rest_stroke": ("rest",),
}


def with_marks(score: Score, names: Collection[str], strings: Sequence[PlayableString]) -> Score:
    """Give notes the techniques that their signs ask for, and let go of frets that no string has.

    Slides become notes of the technique ``slide``, harmonics of ``harmonic``; on an instrument without them the note
    that a slide reaches is plucked, and a harmonic as a note of its pitch.

    names : techniques of the instrument.
    strings : of the instrument.
    Returns The score; `Score.ignored` counts signs that the instrument has no technique for, and notes of a tablature
        that are fingered elsewhere.
    """
    if not any(note.marks or note.glides or note.partial for note in score.notes):
        return score
    lacking: Counter[str] = Counter()
    places = {(string.pitch_at(stop), stop) for string in strings for stop in map(float, range(len(string.pitches)))}
    notes = []
    for written in score.notes:
        for note in _slid(_touched(written, names, lacking), "slide" in names, lacking):
            technique = note.technique
            for mark in note.marks:
                fitting = next((name for name in _SIGNS.get(mark, ()) if name in names), None)
                if mark == "tablature":
                    if (_stopped(note), note.stop) not in places and not any(string.continuous for string in strings):
                        lacking["note of the tablature, fingered elsewhere"] += 1
                        note = replace(note, stop=None)
                elif fitting is None:
                    lacking[f"{mark.replace('_', ' ')}, plucked as any note"] += 1
                else:
                    technique = technique or fitting
            notes.append(replace(note, note=_stopped(note), technique=technique))
    return replace(score, notes=notes, ignored=dict(Counter(score.ignored) + lacking))


def _stopped(note: Note) -> float | None:
    """Pitch of the string under a harmonic, or of the note."""
    return note.note if note.note is None or note.partial is None else note.note - interval(note.partial)


def _touched(note: Note, names: Collection[str], lacking: Counter[str]) -> Note:
    """A harmonic by its technique, or a note of its pitch wherever a string has it."""
    if note.partial is None:
        return note
    if "harmonic" in names:
        return replace(note, technique=note.technique or "harmonic")
    lacking["harmonic, plucked as a note of its pitch"] += 1
    return replace(note, partial=None, stop=None, marks=tuple(m for m in note.marks if m != "tablature"))


def _slid(note: Note, slides: bool, lacking: Counter[str]) -> Iterator[Note]:
    """A note, and one for each place that its stop slides to."""
    if not note.glides or note.note is None:
        yield note
        return
    at_end = note.duration - _ARRIVAL
    points = [(min(time, at_end), steps) for time, steps in note.glides]
    if not slides:
        inner = [(t, s) for t, s in points if 0.0 < t < at_end]
        into = points[0][0] <= 0.0
        lacking["slide into or out of a note, plucked as any note"] += len(inner) < len(points)
        points = [(0.0, 0.0), *inner[into:]]
    elif points[0][0] > 0.0:
        points = [(0.0, 0.0), *points]
    previous = None
    for (time, steps), until in zip(points, [*(t for t, _ in points[1:]), note.duration], strict=True):
        stop = None if note.stop is None else note.stop + steps
        if steps == previous or (stop is not None and stop < 0):
            continue
        marks = note.marks if previous is None else ("slide", *(m for m in note.marks if m == "tablature"))
        yield replace(
            note, time=note.time + max(time, 0.0), duration=max(until - time, _ARRIVAL), note=note.note + steps,
            stop=stop, glides=(), marks=marks, held=None,
        )  # fmt: skip
        previous = steps


def stop_course(play: Play, stop: float, continuous: bool, tick: float) -> list[tuple[float, float]]:
    """Times (s) and stops of a gesture's finger, one per `tick` (s) at most; ends with the note's own stop.

    A fretted string sounds the last fret that the finger has reached, from below or from above.
    """
    segments = play.gesture.stops
    if not segments:
        return []
    begin, end = segments[0].start, segments[-1].stop
    times = np.append(np.arange(begin, end - 1e-9, tick), end - 1e-9)
    values = Motion("", "offset", segments).course(times)
    out: list[tuple[float, float]] = []
    for time, value in [*zip(times.tolist(), values.tolist(), strict=True), (end, stop)]:
        if time == end:
            reached = stop
        elif continuous:
            reached = round(value * _FINEST) / _FINEST
        else:
            reached = float(math.floor(value + 1e-9) if stop >= values[0] else math.ceil(value - 1e-9))
        if not out or reached != out[-1][1]:
            out.append((play.time + time, reached))
    return out


def touch_course(play: Play, tick: float) -> list[tuple[float, tuple[tuple[str, float], ...]]]:
    """Times (s), one per `tick` (s) at most, and where the gesture's fingers then touch: (point, m from the bridge)."""
    courses = play.gesture.touches
    if not courses:
        return []
    begin = min(segments[0].start for segments in courses.values())
    end = max(segments[-1].stop for segments in courses.values())
    out: list[tuple[float, tuple[tuple[str, float], ...]]] = []
    for time in np.append(np.arange(begin, end - 1e-9, tick), end).tolist():
        touches = tuple(
            (point, float(Motion("", "offset", c).course(min(max(time, c[0].start), c[-1].stop - 1e-9))))
            for point, c in courses.items()
        )
        if not out or touches != out[-1][1]:
            out.append((play.time + time, touches))
    return out
