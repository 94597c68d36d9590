"""Conditions to sound with tonewood's own engine: the only part of a batch that knows instruments."""

from __future__ import annotations

import json
import math
import platform
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.score.assignment import assign
from tonewood.performance.score.midi import read_midi
from tonewood.performance.score.note import Note, Score
from tonewood.physics.stepping.kernel import compiler, instruction_set
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer, assembled
from tonewood.support.blas import blas_libraries
from tonewood.workshop.batch.conditions import Condition, Draw, vary_notes
from tonewood.workshop.batch.store import Rendered

_PIECE = 0.25  # s, rendered to predict the time of the rest
# s to set up, s per second of sound
_COSTS: dict[tuple[object, ...], tuple[float, float]] = {}


@dataclass(frozen=True)
class EngineRenderer:
    """Renders conditions; small, so that it costs nothing to send to a worker.

    allow_code : run plugins in the folders of bundles, here and in the workers.
    """

    allow_code: bool = False

    def identity(self, condition: Condition) -> dict[str, Any]:
        """Everything that decides the samples: parameters, hashes, version, instruction set, libraries.

        Raises TonewoodError
            The bundle cannot be loaded, an override does not fit it, or the instruction set is not the one asked for.
        """
        isa, here = condition.render.isa, instruction_set()
        if isa not in ("auto", here):
            raise TonewoodError(f"{isa} is asked for, this process runs {here}: set TONEWOOD_ISA", key="render.isa")
        instrument = instrument_of(condition, self.allow_code)
        return {
            "asked": condition.asked(),
            "bundle": instrument.content_hash,
            "plugins": instrument.plugin_hashes,
            "parameters": instrument.resolved,
            "version": _version(),
            "isa": here,
            "computed_with": computed_with(),
        }

    def own_value(self, condition: Condition, path: str) -> Any:
        """Value of a parameter of the instrument, or of an option of the render (``render.``); None if not given.

        Raises TonewoodError : the bundle cannot be loaded, or an override does not fit it.
        """
        value: Any = instrument_of(condition, self.allow_code).resolved
        if path.startswith("render."):
            return condition.render.model_dump().get(path.removeprefix("render."))
        for name in path.split("."):
            if isinstance(value, list):
                value = {str(v.get("name", i) if isinstance(v, Mapping) else i): v for i, v in enumerate(value)}
            if not isinstance(value, Mapping):
                return None
            value = next(iter(value.values()), None) if name == "*" else value.get(name)
        return value

    def predict(self, condition: Condition) -> float:
        """Time of a render, s, from a short measured piece of the first one asked for on the same bundle and rate.

        The length is that of the score with half its longest tail.
        """
        settings = condition.render
        how = (settings.accuracy, settings.oversampling, settings.freq_limit, str(settings.effects), settings.energy)
        kind = (condition.bundle, settings.fs, *how)
        if kind not in _COSTS:
            began = time.perf_counter()
            renderer = self.renderer(condition, max_duration=_PIECE)
            ready = time.perf_counter()
            for _ in renderer.blocks():
                pass
            _COSTS[kind] = (ready - began, (time.perf_counter() - ready) / _PIECE)
        setup, per_second = _COSTS[kind]
        length = max((n.time + n.duration for n in _score(condition).notes), default=0.0) + 0.5 * settings.tail
        return setup + per_second * min(length, settings.max_duration or math.inf)

    def render(self, condition: Condition) -> Rendered:
        """The sound of a condition, with its human variation.

        Raises TonewoodError : a score cannot be read or played, or the render went wrong.
        """
        renderer = self.renderer(condition)
        samples = np.concatenate(list(renderer.blocks(4096)))
        info = _plain(asdict(renderer.summary())) | {"channels": list(renderer.channels)}
        if renderer.energy is not None:
            info["energy"] = renderer.energy.balance()
        return Rendered(samples, renderer.fs, info)

    def renderer(self, condition: Condition, max_duration: float | None = None, *, by_string: bool = False) -> Renderer:
        """The renderer of a condition, with its human variation; `by_string` splits its outputs as `assembled` does.

        Raises TonewoodError : a score cannot be read or played, or an override does not fit.
        """
        instrument = instrument_of(condition, self.allow_code)
        options = condition.render.at(channel_per_string=_channel_per_string(condition))
        return Renderer(
            _varied(_score(condition), instrument, condition),
            instrument,
            options=options if max_duration is None else options.at(max_duration=max_duration),
            model=_MODELS.of(instrument, options, by_string=by_string),
        )


def _plain(value: Any) -> Any:
    """JSON-ready copy; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (str, int)) or value is None:
        return value
    return float(value) if math.isfinite(value) else None


def instrument_of(condition: Condition, allow_code: bool = False) -> Instrument:
    """The bundle with the condition's overrides, and with the draws of the repeat."""
    changes = json.dumps({**condition.overrides, **condition.render.effect_changes})
    draws = tuple(draw for draw in condition.draws if draw.note_field is None)
    return _changed(_loaded(condition.bundle, allow_code), changes, draws)


@lru_cache(maxsize=64)
def _changed(bundle: Instrument, changes: str, draws: tuple[Draw, ...]) -> Instrument:
    """A bundle with overrides, written as JSON, and drawn variations."""
    instrument = bundle.replace(json.loads(changes))
    varied: dict[str, Any] = {}
    for draw in draws:
        drawn = float(draw.values(1)[0])
        varied |= {path: draw.applied(value, drawn) for path, value in _numbers(instrument.resolved, draw.path)}
    return instrument.replace(varied)


class ModelCache:
    """The models that this process used last, by everything that decides them.

    Conditions come ordered by instrument (`runner.plan_batch`), so a few are enough, and the time of a render does not
    depend on how many came before. A model is immutable but for bases of stops that do not depend on their order.
    """

    def __init__(self, most: int = 4):
        self.most = most
        self._models: OrderedDict[str, Model] = OrderedDict()

    def of(self, instrument: Instrument, options: RenderOptions, *, by_string: bool) -> Model:
        """The model of an instrument with the options of a render, made if it is not among the last ones."""
        decides = {
            name: getattr(options, name)
            for name in ("fs", "accuracy", "oversampling", "freq_limit", "outputs", "humanize", "noises", "effects")
        }
        changes = json.dumps({**decides, **options.effect_changes, "by_string": by_string}, sort_keys=True, default=str)
        key = f"{instrument.content_hash} {changes}"
        model = self._models.pop(key, None) or assembled(instrument, options, by_string=by_string)
        self._models[key] = model
        while len(self._models) > self.most:
            self._models.popitem(last=False)
        return model


_MODELS = ModelCache()


@lru_cache(maxsize=64)
def _loaded(bundle: str, allow_code: bool) -> Instrument:
    return Instrument.load(bundle, allow_code=allow_code)


@cache
def _version() -> str:
    return version("tonewood")


@cache
def computed_with() -> dict[str, Any]:
    """Compiler and libraries that change the last bits, and the vector instructions that NumPy uses here.

    The number of BLAS threads is not among them: renders use one (`blas`).
    """
    return {
        "kernel": compiler(),
        "blas": blas_libraries(),
        "numpy": np.__version__,
        "scipy": version("scipy"),
        "simd": np.show_config(mode="dicts")["SIMD Extensions"].get("found", []),
        "libc": " ".join(platform.libc_ver()),
    }


def _score(condition: Condition) -> Score:
    if condition.notes is not None:
        score = Score(condition.notes, name=condition.score)
    else:
        midi = condition.midi or {}
        score = read_midi(midi["path"], start=midi["start"], stop=midi["stop"])
    if not condition.note_changes:
        return score
    return replace(score, notes=tuple(replace(note, **condition.note_changes) for note in score.notes))


def _channel_per_string(condition: Condition) -> bool:
    return condition.render.channel_per_string or bool((condition.midi or {}).get("channel_per_string", False))


def _varied(score: Score, instrument: Instrument, condition: Condition) -> Score:
    if not any(draw.note_field for draw in condition.draws):
        return score
    lookup = _Base(score, instrument, condition)
    return replace(score, notes=vary_notes(score.notes, condition.draws, lookup.value))


class _Base:
    """Value of a field of a note before it varies."""

    def __init__(self, score: Score, instrument: Instrument, condition: Condition):
        self.score, self.instrument, self.condition = score, instrument, condition
        playing = instrument.spec.playing
        self.velocity = playing.velocity
        self.default = playing.default_exciter
        self.lengths: dict[tuple[object, ...], float] | None = None

    def value(self, draw: Draw, note: Note) -> float | None:
        name = draw.note_field or ""
        exciter = note.technique or self.default
        head = draw.path.split(".")
        if head[0] == "exciters" and head[1] not in ("*", exciter):
            return None
        of_note = getattr(note, name)
        if of_note is not None:
            return float(of_note)
        if name not in ("force", "from_bridge", "angle_deg"):  # the instrument has no value of its own
            return None
        if name == "force" and note.velocity_midi is not None:
            return self.velocity.value(note.velocity_midi)
        value = self.instrument.resolved["exciters"].get(exciter, {}).get(name)
        if isinstance(value, Mapping):
            length = self._length(note)
            return None if length is None else float(value["fraction"]) * length
        return None if value is None else float(value)

    def _length(self, note: Note) -> float | None:
        """Speaking length of the string a note will be played on, m; None for a note that cannot be played."""
        if self.lengths is None:
            from tonewood.performance.player.playing import playable

            model = assemble(self.instrument, self.condition.render.fs)
            assignment = assign(
                self.score.notes,
                playable(model),
                channel_per_string=_channel_per_string(self.condition),
                tuning=self.instrument.tuning,
            )
            self.lengths = {_place(a.note): model.place(a.string, a.stop).length for a in assignment.notes}
        return self.lengths.get(_place(note))


def _place(note: Note) -> tuple[object, ...]:
    return (note.time, note.note, note.freq, note.string, note.stop)


def _numbers(values: Any, path: str, prefix: str = "") -> list[tuple[str, float]]:
    """Numbers a dotted path with ``*`` leads to, each with its own path."""
    if not path:
        if isinstance(values, bool) or not isinstance(values, (int, float)):
            raise TonewoodError(f"{values!r} cannot vary: a number is wanted", key=f"vary.{prefix}")
        return [(prefix, float(values))]
    first, _, rest = path.partition(".")
    if isinstance(values, list):
        values = {str(v.get("name", i) if isinstance(v, Mapping) else i): v for i, v in enumerate(values)}
    if not isinstance(values, Mapping) or (first != "*" and first not in values):
        raise TonewoodError(f"there is no {first!r}", key=f"vary.{prefix}.{path}" if prefix else f"vary.{path}")
    names = list(values) if first == "*" else [first]
    return [number for n in names for number in _numbers(values[n], rest, f"{prefix}.{n}" if prefix else n)]
