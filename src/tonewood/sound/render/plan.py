"""A render foreseen: which effects will run on which strings, when and why, and how long it will take.

The score is played through at a third of the sampling rate, with switched effects watched but not switched: that shows
which would be switched, and when. Steps are timed on the first second of sound, at the full rate. Where there are very
many bends, each of which exchanges strings, they are left out of both: some are timed by themselves, and all counted.
"""

from __future__ import annotations

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
from tonewood.performance.score.note import Dropped
from tonewood.sound.files.inputs import InstrumentLike, ScoreLike, as_instrument, as_score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.presets import with_preset
from tonewood.sound.render.renderer import Renderer

#: the sketch is made at this share of the sampling rate, but at no less than this
_SKETCH, _LEAST_FS = 3, 12000
#: s of sound that are timed
_TIMED = 1.0
#: samples of a stretch timed with and without a switched effect, and how often
_STRETCH, _ROUNDS = 2048, 3
#: points of the control grid with bends from which on these are foreseen by themselves, and how many are timed
_MANY_BENDS, _TIMED_BENDS = 500, 40


@dataclass(frozen=True, slots=True)
class Plan:
    """A render foreseen.

    Attributes
    ----------
    effects : one per effect and component.
    duration_s : of sound, with its tail.
    predicted_s : of computing, without load.
    timed_s : of sound on which that rests.
    notes_dropped : notes that cannot be played, and why.
    bends, bends_s : points in time at which strings are bent, where these are very many, and the seconds of
        `predicted_s` that they take.
    """

    effects: Sequence[PlannedEffect]
    duration_s: float
    predicted_s: float
    timed_s: float
    notes_dropped: Sequence[Dropped] = ()
    bends: int = 0
    bends_s: float = 0.0


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
    score, instrument = as_score(score), as_instrument(instrument)
    options = with_preset(RenderOptions.of(options, fs, settings), instrument.spec).at(room=None)  # takes no time
    low = max(options.fs // _SKETCH, min(_LEAST_FS, options.fs))
    sketched = options.at(fs=low, accuracy="standard", oversampling=None, freq_limit=None)
    # imports and caches of the first time belong to no second of sound
    first_second = _TIMED if options.max_duration is None else min(_TIMED, options.max_duration)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)  # the last one, which is not at a lower rate, warns
        full = Renderer(score, instrument, options=options)
        bends = bends_by_point(full.performance.timeline, full.model.fs)
        if len(bends) > _MANY_BENDS:
            score = replace(score, controls=[c for c in score.controls if c.kind != "bend"])
        for _ in Renderer(score, instrument, options=sketched.at(max_duration=first_second)).blocks(4096):
            pass
        sketch = Renderer(score, instrument, options=sketched)
    sketch.engine.only_watch = True
    first = Spent()
    for _ in sketch.blocks(512):
        if sketch.time <= _TIMED:
            first = Spent.of(sketch.engine)
        if progress is not None:
            progress(sketch.time)
    seconds = sketch.summary().duration_s
    timed = Renderer(score, instrument, options=options.at(max_duration=min(_TIMED, seconds)), model=full.model)
    for _ in timed.blocks(4096):
        pass
    rates = _switched_rates(timed.engine)
    scale = timed.model.fs / sketch.model.fs
    extra = sum(_computing(rates, timed.engine.usage).values())
    computing = {key: scale * seconds for key, seconds in _computing(rates, sketch.engine.usage).items()}
    n_bends = sum(point * GRID < seconds * full.model.fs for point in bends) if len(bends) > _MANY_BENDS else 0
    bends_s = n_bends * seconds_per_bend(full.model, bends) if n_bends else 0.0
    foreseen = Foreseen(sketch.engine.usage, seconds, computing)
    return Plan(
        effects=[planned for effect in sketch.engine.effects for planned in effect.plan(foreseen)],
        duration_s=seconds,
        predicted_s=predicted(Spent.of(timed.engine), extra, first, Spent.of(sketch.engine))
        + sum(computing.values())
        + bends_s,
        timed_s=timed.summary().duration_s,
        notes_dropped=timed.dropped,
        bends=n_bends,
        bends_s=bends_s,
    )


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
