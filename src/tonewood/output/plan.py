"""What a render will do, before it: which effects will run on which strings, when and why, and how long it will take.

The score is played through at a third of the sampling rate, with every tension left at rest but watched: that tells
what would be switched when. How long things take is timed on the first second of sound, at the full rate.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tonewood.engine.engine import Engine
from tonewood.engine.ledger import Ledger, Spans
from tonewood.errors import DroppedNotesWarning
from tonewood.instrument.bundle import Instrument
from tonewood.instrument.contract import Plugin
from tonewood.output.options import RenderOptions
from tonewood.output.render import Renderer
from tonewood.score.note import Dropped, Score

#: the sketch is made at this share of the sampling rate, but at no less than this
_SKETCH, _LEAST_FS = 3, 12000
#: s of sound that are timed
_TIMED = 1.0
#: samples of a stretch timed with and without rising tensions, and how often
_STRETCH, _ROUNDS = 2048, 3


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """One effect on one component.

    Attributes
    ----------
    name : of the effect.
    component : string, ``body`` or output group.
    spans_s : (start, stop) of the times it will run, s of score time; of a contact, when it will touch.
    why : one line.
    predicted_s : of computing, None where it is not told apart from the rest.
    """

    name: str
    component: str
    spans_s: tuple[tuple[float, float], ...]
    why: str
    predicted_s: float | None

    @property
    def seconds(self) -> float:
        """How long it will run, s of sound."""
        return sum(stop - start for start, stop in self.spans_s)


@dataclass(frozen=True, slots=True)
class Plan:
    """A render foreseen.

    Attributes
    ----------
    effects : one per effect and component.
    duration_s : of sound, with its tail.
    predicted_s : of computing, without load.
    timed_s : of sound on which that rests.
    notes_dropped : what cannot be played, and why.
    """

    effects: Sequence[PlannedEffect]
    duration_s: float
    predicted_s: float
    timed_s: float
    notes_dropped: Sequence[Dropped] = ()


def plan(
    score: Score,
    instrument: Instrument,
    fs: float | None = None,
    *,
    options: RenderOptions | None = None,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> Plan:
    """Foresee a render; `Renderer` has the same options, and warns of dropped notes."""
    options = RenderOptions.of(options, fs, settings)
    low = max(options.fs // _SKETCH, min(_LEAST_FS, options.fs))
    # what is imported and kept the first time belongs to no second of sound
    first_second = _TIMED if options.max_duration is None else min(_TIMED, options.max_duration)
    for _ in Renderer(score, instrument, options=options.at(fs=low, max_duration=first_second)).blocks(4096):
        pass
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)  # the first one has told
        sketch = Renderer(score, instrument, options=options.at(fs=low))
    sketch.engine.watching = True
    # with fewer modes at fewer samples the same sleep is worth less
    sketch.engine.sleeper.worth *= (low / options.fs) ** 2
    first = Spent()
    for _ in sketch.blocks(512):
        if sketch.time <= _TIMED:
            first = Spent.of(sketch.engine)
        if progress is not None:
            progress(sketch.time)
    seconds = sketch.summary().duration_s
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DroppedNotesWarning)
        timed = Renderer(score, instrument, options=options.at(max_duration=min(_TIMED, seconds)))
    for _ in timed.blocks(4096):
        pass
    rising = _rising(timed.engine)
    scale = timed.model.fs / sketch.model.fs
    modes = {name: timed.engine.ledger.n_modes(name) for name in timed.model.strings}
    ledger = sketch.engine.ledger
    per_string = {name: scale * spans.samples * rising.per_mode * modes[name] for name, spans in ledger.tense.items()}
    extra = rising.seconds(_tense_modes(timed.engine.ledger), timed.engine.ledger.any_tense)
    return Plan(
        effects=_planned(ledger, sketch.engine, per_string, seconds),
        duration_s=seconds,
        predicted_s=predicted(Spent.of(timed.engine), extra, first, Spent.of(sketch.engine))
        + sum(per_string.values())
        + scale * ledger.any_tense * rising.per_sample,
        timed_s=timed.summary().duration_s,
        notes_dropped=timed.dropped,
    )


@dataclass(frozen=True, slots=True)
class Spent:
    """Seconds of computing: in steps, and between them (stops, gestures, looks)."""

    stepping: float = 0.0
    control: float = 0.0

    @classmethod
    def of(cls, engine: Engine) -> Spent:
        """What an engine has taken so far."""
        return cls(engine.ticker.stepping_s, engine.ticker.control_s)


@dataclass(frozen=True, slots=True)
class Rising:
    """What rising tensions take: s per sample with any of them, and s per sample and mode of their strings."""

    per_sample: float = 0.0
    per_mode: float = 0.0

    @classmethod
    def fitted(cls, still: float, some: float, every: float, modes: tuple[int, int]) -> Rising:
        """From seconds per sample with no tension rising, some and all, of strings with so many modes."""
        few, many = modes
        if many <= few:
            return cls(0.0, max(every - still, 0.0) / max(many, 1))
        slope = max(every - some, 0.0) / (many - few)
        return cls(max(some - still - slope * few, 0.0), slope)

    def seconds(self, mode_samples: float, samples: float) -> float:
        """For steps of modes of strings whose tension rises, and samples in which any did."""
        return self.per_mode * mode_samples + self.per_sample * samples


def predicted(timed: Spent, extra: float, first: Spent, whole: Spent) -> float:
    """Seconds for a whole score without what rising tensions take.

    Parameters
    ----------
    timed : of its beginning as it will be rendered; `extra` of its steps are due to rising tensions.
    first, whole : of the same beginning, and of the whole score, in a sketch.
    """
    steps = max(timed.stepping - extra, 0.0) / first.stepping if first.stepping > 0 else 1.0
    control = timed.control / first.control if first.control > 0 else 1.0
    return steps * whole.stepping + control * whole.control


def _tense_modes(ledger: Ledger) -> float:
    """Modes of strings whose tension rose, times samples."""
    return sum(spans.samples * ledger.n_modes(name) for name, spans in ledger.tense.items())


def _rising(engine: Engine) -> Rising:
    """What rising tensions take, timed on the state an engine is in."""
    names = engine.switch.strings
    if not names:
        return Rising()
    chosen: dict[str, Sequence[str]] = {"still": (), "some": names[:1], "every": names}
    times: dict[str, list[float]] = {key: [] for key in chosen}
    for _ in range(_ROUNDS):
        for key, on in chosen.items():
            engine.stepper.exchange(engine.system.with_tensions(on))
            state = engine.state.copy()
            began = time.thread_time()
            engine.stepper.run(state, _STRETCH)
            times[key].append((time.thread_time() - began) / _STRETCH)
    engine.stepper.exchange(engine.system)
    modes = [sum(engine.ledger.n_modes(name) for name in chosen[key]) for key in ("some", "every")]
    still, some, every = (min(times[key]) for key in chosen)
    return Rising.fitted(still, some, every, (modes[0], modes[1]))


def _planned(ledger: Ledger, engine: Engine, per_string: Mapping[str, float], seconds: float) -> list[PlannedEffect]:
    model, whole = engine.model, ((0.0, seconds),)
    choice, out = model.choice, []
    parts: dict[str, Plugin[Any]] = {**model.instrument.attachments, **model.exciters}

    def spans(of: Spans) -> tuple[tuple[float, float], ...]:
        return tuple((max(a / model.fs, 0.0), b / model.fs) for a, b in of.all if b > 0)

    for name, string in model.strings.items():
        for effect in string.resonator.effects:
            if effect.name not in choice.names:
                out.append(PlannedEffect(effect.name, name, (), f"left out: effects are {_mode(choice.mode)}", None))
            elif effect.name == "tension_modulation":
                if string.resonator.axial_stiffness <= 0:
                    continue
                when = spans(ledger.tense[name])
                why = "always: effects are all" if choice.mode == "all" else "always: it is among those named"
                if choice.mode == "auto":
                    cents = ledger.largest[name]
                    size = f"its tension rises by up to {cents:.2g} cents" if cents < 1e9 else "a gesture moves it"
                    why = f"{size}; the budget is {choice.budget_cents:g}"
                out.append(PlannedEffect(effect.name, name, when, why, per_string.get(name, 0.0)))
            elif effect.name == "longitudinal":
                why = f"as long as its tension rises or its phantom partials pass {choice.budget_db:g} dB"
                out.append(PlannedEffect(effect.name, name, spans(ledger.tense[name]), why, None))
            elif effect.name != "second_polarization" or len(string.polarizations) > 1:
                out.append(PlannedEffect(effect.name, name, whole, effect.before, None))
    for (name, part), _ in ledger.contacts.items():
        when = spans(ledger.touched[name, part])
        why = "the string reaches it" if when else "watched; the string does not reach it"
        out += [PlannedEffect(e.name, name, when, why, None) for e in parts[part].effects if e.name != "dampers"]
    for name, held in ledger.held.items():
        out.append(PlannedEffect("dampers", name, spans(held), "fingers touch the string to pluck it", None))
    for part, plugin in parts.items():
        out += [
            PlannedEffect(e.name, part, (), f"left out: effects are {_mode(choice.mode)}", None)
            for e in plugin.effects
            if e.name not in choice.names
        ]
    out += [PlannedEffect(e.name, "body", whole, e.before, None) for e in model.instrument.body.effects]
    made = {group.name for group in model.outputs}
    for group, pickup in model.instrument.pickups.items():
        here = group in made
        why = "it is recorded" if here else "nobody records it"
        out += [PlannedEffect(e.name, group, whole if here else (), why, None) for e in pickup.effects]
    return out


def _mode(mode: str) -> str:
    return "named one by one" if mode == "list" else mode
