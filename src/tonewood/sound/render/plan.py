"""A render foreseen: which effects will run on which strings, when and why, and how long it will take.

The score is played through at a third of the sampling rate, with switched effects watched but not switched: that shows
which would be switched, and when. Steps are timed on the first second of sound, at the full rate. Where there are very
many bends, each of which exchanges strings, they are left out of both: some are timed by themselves, and all counted.
Of a long score the beginning is played through, and the rest is taken to be like it.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tonewood.errors import DroppedNotesWarning
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Foreseen, PlannedEffect, SwitchedEffect
from tonewood.performance.effects.usage import EffectUsage
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.timeline import GRID, Change, Timeline
from tonewood.performance.score.note import Dropped, Score
from tonewood.sound.files.inputs import InstrumentLike, ScoreLike, as_instrument, as_score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.presets import with_preset
from tonewood.sound.render.renderer import Renderer, assembled

#: the sketch is made at this share of the sampling rate, but at no less than this
_SKETCH, _LEAST_FS = 3, 12000
#: s of sound that are timed
_TIMED = 1.0
#: samples of a stretch timed with and without a switched effect, and how often
_STRETCH, _ROUNDS = 2048, 3
#: points of the control grid with bends from which on these are foreseen by themselves, and how many are timed
_MANY_BENDS, _TIMED_BENDS = 500, 40
#: notes that are looked at, and processor time (s) after which the sketch ends, but not before a second of sound
_MOST_NOTES, _MOST_COMPUTING = 1500, 3.0
#: moves of controllers that are looked at, bends besides: a pedal's moves all dampers
_MOST_MOVES = 3000


@dataclass(frozen=True, slots=True)
class Plan:
    """A render foreseen.

    Attributes
    ----------
    effects : one per effect and component.
    duration_s : of sound, with its tail; at most, where not all of it was sketched.
    predicted_s : of computing, without load.
    timed_s : of sound on which that rests.
    notes_dropped : notes that cannot be played, and why.
    bends, bends_s : points in time at which strings are bent, where these are very many, and the seconds of
        `predicted_s` that they take.
    sketched_s : of sound that was played through; where this is less than `duration_s`, effects and dropped notes are
        those until then, and the rest of the times is taken to be in proportion.
    """

    effects: Sequence[PlannedEffect]
    duration_s: float
    predicted_s: float
    timed_s: float
    notes_dropped: Sequence[Dropped] = ()
    bends: int = 0
    bends_s: float = 0.0
    sketched_s: float = 0.0


def plan(
    score: ScoreLike,
    instrument: InstrumentLike,
    fs: float | None = None,
    *,
    options: RenderOptions | None = None,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> Plan:
    """Foresee a render: the effects that will run, and the time of computing.

    Parameters
    ----------
    score, instrument, fs, options, settings : as for `Renderer`, which warns of dropped notes, too.
    progress : called with the score time reached (s).

    Returns
    -------
    The plan: length, notes dropped, effects with their times, predicted seconds.

    Raises
    ------
    NothingPlayedError : no note can be played.
    TonewoodError : something is out of range; one line.
    """
    whole, instrument = as_score(score), as_instrument(instrument)
    options = with_preset(RenderOptions.of(options, fs, settings), instrument.spec).at(room=None)  # takes no time
    low = max(options.fs // _SKETCH, min(_LEAST_FS, options.fs))
    sketched = options.at(fs=low, accuracy="standard", oversampling=None, freq_limit=None)
    longest = math.inf if options.max_duration is None else options.max_duration
    beginning, until = _beginning(whole)
    full = Renderer(beginning, instrument, options=options)
    dropped, bends = full.dropped, bends_by_point(full.performance.timeline, full.model.fs)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)  # issued above
        if len(bends) > _MANY_BENDS:
            beginning = replace(beginning, controls=[c for c in beginning.controls if c.kind != "bend"])
            full = Renderer(beginning, instrument, options=options, model=full.model)
        if until < longest:
            sketched = sketched.at(max_duration=until)
        sketch = Renderer(beginning, instrument, options=sketched)
    # imports and caches of the first time belong to no second of sound
    warm = Engine(assembled(instrument, sketched), sketch.performance.timeline)
    warm.advance(math.ceil(min(_TIMED, longest) * warm.model.fs / GRID))
    sketch.engine.only_watch = True
    first, began = Spent(), time.thread_time()
    for _ in sketch.blocks(512):
        if sketch.time <= _TIMED:
            first = Spent.of(sketch.engine)
        elif time.thread_time() - began > _MOST_COMPUTING:
            break
        if progress is not None:
            progress(sketch.time)
    looked = sketch.summary()
    seconds = duration = looked.duration_s
    if looked.end == "not ended" or until < longest:
        end = max(n.time + n.duration for n in whole.notes)
        duration = max(seconds, min(longest, end + options.tail + full.zero_frame / full.fs))
    for _ in full.blocks(1024):
        if full.time >= min(_TIMED, seconds):
            break
    rates = _switched_rates(full.engine)
    scale = full.model.fs / sketch.model.fs
    extra = sum(_computing(rates, full.engine.usage).values())
    computing = {key: scale * seconds for key, seconds in _computing(rates, sketch.engine.usage).items()}
    n_bends = sum(point * GRID < seconds * full.model.fs for point in bends) if len(bends) > _MANY_BENDS else 0
    bends_s = n_bends * seconds_per_bend(full.model, bends) if n_bends else 0.0
    foreseen = Foreseen(sketch.engine.usage, seconds, computing)
    more = duration / seconds
    notes = [sum(note.time < until for note in whole.notes) for until in (seconds, duration)]
    spent = Spent.of(sketch.engine).times(more, notes[1] / max(notes[0], 1))
    return Plan(
        effects=[planned for effect in sketch.engine.effects for planned in effect.plan(foreseen)],
        duration_s=duration,
        predicted_s=predicted(Spent.of(full.engine), extra, first, spent) + more * (sum(computing.values()) + bends_s),
        timed_s=full.summary().duration_s,
        notes_dropped=dropped,
        bends=n_bends,
        bends_s=bends_s,
        sketched_s=seconds,
    )


def _beginning(score: Score) -> tuple[Score, float]:
    """The first notes and moves of a score, and the time (s) of the first one that is left out."""
    notes = sorted(score.notes, key=lambda note: note.time)
    moves = sorted(control.time for control in score.controls if control.kind != "bend")
    left_out = [note.time for note in notes[_MOST_NOTES:]] + moves[_MOST_MOVES:]
    until = min(left_out, default=math.inf)
    if not notes or until == math.inf:
        return score, math.inf
    until = max(until, notes[0].time + _TIMED)
    controls = [control for control in score.controls if control.time < until]
    return replace(score, notes=[n for n in notes[:_MOST_NOTES] if n.time < until], controls=controls), until


def bends_by_point(timeline: Timeline, fs: float) -> dict[int, list[Change]]:
    """Points of the control grid at which strings are bent while they sound -> these changes."""
    out: dict[int, list[Change]] = {}
    for change in timeline.changes:
        if change.cents is not None and change.stop is None:
            out.setdefault(int(np.floor(change.time * fs / GRID)), []).append(change)
    return out


def seconds_per_bend(model: Model, bends: Mapping[int, Sequence[Change]]) -> float:
    """Measure the time of the bends of one point: the first ones, one point after another, on strings at rest."""
    points = list(bends.values())[:_TIMED_BENDS]
    moved = [replace(change, time=i * GRID / model.fs) for i, point in enumerate(points) for change in point]
    engine = Engine(model, Timeline(moved, ()))
    engine.advance(len(points))
    return engine.counters.control_s / len(points)


@dataclass(frozen=True, slots=True)
class Spent:
    """Seconds of computing: in steps, and between them (stops, gestures, looks)."""

    stepping: float = 0.0
    control: float = 0.0

    @classmethod
    def of(cls, engine: Engine) -> Spent:
        """Time that an engine has taken so far."""
        return cls(engine.counters.stepping_s, engine.counters.control_s)

    def times(self, steps: float, control: float) -> Spent:
        """Return so many times the seconds in steps, and between them."""
        return Spent(steps * self.stepping, control * self.control)


@dataclass(frozen=True, slots=True)
class SwitchedRate:
    """Time of a switched effect: s per sample with any of it, and s per sample and unit of its load."""

    per_sample: float = 0.0
    per_load: float = 0.0

    @classmethod
    def fitted(cls, none: float, some: float, every: float, loads: tuple[float, float]) -> SwitchedRate:
        """From seconds per sample with the effect on none, some and all of its components, and both loads."""
        few, many = loads
        if many <= few:
            return cls(0.0, max(every - none, 0.0) / max(many, 1.0))
        slope = max(every - some, 0.0) / (many - few)
        return cls(max(some - none - slope * few, 0.0), slope)


def predicted(timed: Spent, extra: float, first: Spent, whole: Spent) -> float:
    """Seconds for a whole score without the time of switched effects.

    timed : of its beginning as it will be rendered; `extra` of its steps are due to switched effects.
    first, whole : of the same beginning, and of the whole score, in a sketch.
    """
    steps = max(timed.stepping - extra, 0.0) / first.stepping if first.stepping > 0 else 1.0
    control = timed.control / first.control if first.control > 0 else 1.0
    return steps * whole.stepping + control * whole.control


def _computing(rates: Mapping[str, SwitchedRate], usage: EffectUsage) -> dict[tuple[str, str], float]:
    """(effect, component) -> seconds that steps of switched effects take."""
    out: dict[tuple[str, str], float] = {}
    for name, rate in rates.items():
        loads = usage.loads[name]
        for component, load in loads.items():
            seconds = usage.spans[name, component].samples * load * rate.per_load
            out[name, component] = seconds + usage.running[name] * rate.per_sample / len(loads)
    return out


def _switched_rates(engine: Engine) -> dict[str, SwitchedRate]:
    """Measure the time of switched effects, each on the state an engine is in with all others as they are."""
    out: dict[str, SwitchedRate] = {}
    for effect in engine.effects:
        if not (isinstance(effect, SwitchedEffect) and effect.chosen and effect.components):
            continue
        names = effect.components
        chosen: dict[str, Sequence[str]] = {"none": (), "some": names[:1], "every": names}
        times: dict[str, list[float]] = {key: [] for key in chosen}
        for _ in range(_ROUNDS):
            for key, on in chosen.items():
                engine.stepper.exchange(effect.apply(engine.system, on, engine.frettings))
                state = engine.state.copy()
                began = time.thread_time()
                engine.stepper.run(state, _STRETCH)
                times[key].append((time.thread_time() - began) / _STRETCH)
        loads = [sum(effect.load(name) for name in chosen[key]) for key in ("some", "every")]
        none, some, every = (min(times[key]) for key in chosen)
        out[effect.name] = SwitchedRate.fitted(none, some, every, (loads[0], loads[1]))
    engine.stepper.exchange(engine.system)
    return out
