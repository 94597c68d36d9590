"""The manifest of a data set: scores, instruments, and parameters with the values that they take.

Schema ``tonewood-batch/1`` with ``kind: dataset``. A parameter is a path of the bundle, of the render (``render.``) or
of every note (``note.``); its values are listed, or drawn from a range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from tonewood.performance.score.note import Note
from tonewood.sound.files.audio import not_held
from tonewood.support.validation_messages import all_messages, first_message
from tonewood.workshop.batch.manifest import (
    NOTE_FIELDS,
    Misfit,
    RenderSettings,
    ScoreSource,
    Variation,
    misfits_of_vary,
    raise_misfits,
)
from tonewood.workshop.batch.page_parts import Name, ParameterPath, Section

#: fields of a note that a parameter may set
SETTABLE = (*NOTE_FIELDS, "string", "stop", "technique", "channel")
#: MIDI files have at most this many ticks in a beat, and whole microseconds in one
_MOST_TICKS = 32767
_BEATS_PER_SECOND = (1, 2, 4, 5, 8, 10)
MAX_SOUNDS = 1_000_000

Range = tuple[float, float]


class Parameter(Section):
    """A parameter and its values: `values`, or one range."""

    path: ParameterPath = Field(description="note.FIELD, render.OPTION, or a parameter of the bundle")
    values: list[Any] | None = Field(default=None, min_length=1, max_length=100_000, description="to choose from")
    uniform: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="[low, high]"
    )
    log_uniform: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="[low, high], uniform in the logarithm"
    )
    steps: int | None = Field(
        default=None, ge=2, le=100_000, description="values of a range in a grid, its ends among them"
    )
    sets: Literal["value", "scale", "fraction"] = Field(
        default="value",
        description="the parameter; a factor on the bundle's own value; or a fraction of a string's length",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if sum(x is not None for x in (self.values, self.uniform, self.log_uniform)) != 1:
            raise PydanticCustomError("parameter", "give exactly one of values, uniform, log_uniform")
        low, high = self.range or (0.0, 1.0)
        if not low < high or (self.log_uniform is not None and low <= 0):
            raise PydanticCustomError("parameter", "a range is [low, high] with low < high, of log_uniform above 0")
        if self.steps is not None and self.values is not None:
            raise PydanticCustomError("parameter", "steps belongs to a range")
        head, _, name = self.path.partition(".")
        if head == "note" and name not in SETTABLE:
            raise PydanticCustomError("parameter", f"path: note.{name} is not one of {', '.join(SETTABLE)}")
        if head in ("note", "render") and self.sets != "value":
            raise PydanticCustomError("parameter", "sets: belongs to parameters of the bundle")
        if head == "note":
            self._check_notes(name)
        return self

    @property
    def range(self) -> Range | None:
        """Ends of a range."""
        limits = self.uniform or self.log_uniform
        return None if limits is None else (limits[0], limits[1])

    def _check_notes(self, name: str) -> None:
        for value in self.values or self.range or ():
            fields: dict[str, Any] = {"time": 0.0, "note": 60.0, name: value}
            try:
                Note(**fields)
            except Exception as fault:
                raise PydanticCustomError("parameter", f"{self.path}: {value!r}: {fault}") from None

    def at(self, share: float) -> Any:
        """The value at a share 0 to 1 of the range, or of the list."""
        if self.values is not None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        assert self.range is not None  # a parameter without values has one
        low, high = self.range
        if self.log_uniform is not None:
            return low * math.exp(share * math.log(high / low))
        return low + share * (high - low)

    def grid(self) -> list[Any]:
        """All values of a grid."""
        if self.values is not None:
            return self.values
        n = self.steps or 2
        return [self.at(k / (n - 1)) for k in range(n)]

    def setting(self, value: Any) -> Any:
        """The override of the bundle that a value stands for."""
        return value if self.sets == "value" else {self.sets: value}


class Sounds(Section):
    """Files of the sounds."""

    subtype: Literal["PCM_16", "PCM_24"] = Field(default="PCM_24", description="bits of a sample")
    level: Literal["calibrated", "peak"] = Field(
        default="calibrated", description="the instrument's full scale, with render.gain_db; or each to -1 dBFS"
    )
    stems: Literal["none", "string"] = Field(default="none", description="the shares of all strings, too")
    duration: float | None = Field(default=None, gt=0, le=3600, description="s, of every sound: zeros, or cut")
    per_shard: int = Field(default=100, ge=1, le=100_000, description="sounds in a shard")
    labels: list[Literal["jams", "midi"]] = Field(default=["jams", "midi"], description="files beside the tables")


class Dataset(Section):
    """A whole data set."""

    schema_: Literal["tonewood-batch/1"] = Field(alias="schema", description="of this file")
    kind: Literal["dataset"] = Field(description="a data set; `test` is a listening test")
    name: Name = Field(description="of the set")
    title: str = Field(default="", description="kept in the record")
    licence: str = Field(default="", description="of the sounds, an SPDX name; the instruments' own are listed besides")
    seed: int = Field(ge=0, lt=2**63, description="of every random choice")
    instruments: dict[Name, str] = Field(
        min_length=1, description="name -> installed instrument, or folder relative to the manifest"
    )
    scores: dict[Name, ScoreSource] = Field(default_factory=dict, description="name -> music")
    folder: str | None = Field(default=None, description="of MIDI files, each a score, folders below it included")
    parameters: dict[Name, Parameter] = Field(
        default_factory=dict, description="name -> what varies from sound to sound"
    )
    sampling: Literal["grid", "random", "sobol"] = Field(
        default="grid", description="all combinations, independent draws, or a scrambled Sobol sequence"
    )
    size: int | None = Field(default=None, ge=1, description="sounds of each instrument and score; of a grid all")
    vary: dict[ParameterPath, Variation] = Field(
        default_factory=dict, description="path -> variation from note to note"
    )
    render: RenderSettings = Field(default=RenderSettings(), description="settings of all renders")
    sounds: Sounds = Field(default=Sounds(), description="files of the sounds")

    def misfits(self) -> Iterator[Misfit]:
        """Parts that do not fit together."""
        if not self.scores and self.folder is None:
            yield "scores", "give scores, or a folder of MIDI files"
        yield from misfits_of_vary(self.vary)
        for name, parameter in self.parameters.items():
            if self.sampling == "grid" and parameter.values is None and parameter.steps is None:
                yield f"parameters.{name}.steps", "is missing; a grid needs it"
            if self.sampling != "grid" and parameter.steps is not None:
                yield f"parameters.{name}.steps", "belongs to sampling: grid"
            if parameter.path.startswith("render."):
                yield from self._misfits_of_render(name, parameter)
        if self.sampling == "grid" and self.size is not None:
            yield "size", "a grid has as many sounds as its parameters have values"
        if self.sampling != "grid" and self.size is None:
            yield "size", f"is missing; sampling: {self.sampling} needs it"
        paths = [p.path for p in self.parameters.values()]
        if double := {path for path in paths if paths.count(path) > 1}:
            yield "parameters", f"{min(double)} stands there twice"
        if self.sounds.duration is not None and round(self.sounds.duration * self.render.fs) < 1:
            yield "sounds.duration", f"is shorter than a sample, {1 / self.render.fs:.3g} s"
        if reason := not_held("FLAC", self.render.fs):
            yield "render.fs", reason
        if "midi" in self.sounds.labels and midi_clock(self.render.fs) is None:
            yield "sounds.labels", f"MIDI has no tick of one sample at {self.render.fs} Hz; take [jams]"

    def _misfits_of_render(self, name: str, parameter: Parameter) -> Iterator[Misfit]:
        if parameter.path == "render.fs":
            yield f"parameters.{name}.path", "all sounds of a data set have one rate"
        for value in parameter.values or parameter.range or ():
            try:
                self.render_settings({parameter.path.removeprefix("render."): value})
            except ValidationError as error:
                yield f"parameters.{name}", f"{value!r}: {first_message(error, RenderSettings)[1]}"

    def render_settings(self, changes: dict[str, Any]) -> RenderSettings:
        """The render settings with some changed, checked anew."""
        return RenderSettings.model_validate({**self.render.model_dump(), **changes}) if changes else self.render


def midi_clock(fs: float) -> tuple[int, int] | None:
    """Ticks per beat and microseconds per beat for which a tick is one sample; None if there are none."""
    for beats in _BEATS_PER_SECOND:
        if fs % beats == 0 and fs / beats <= _MOST_TICKS:
            return int(fs // beats), 1_000_000 // beats
    return None


def check_dataset(data: dict[str, Any], *, file: Path | None = None) -> Dataset:
    """Check the manifest of a data set.

    Raises ManifestError : a line for each fault: file, dotted key, fault and the values allowed.
    """
    try:
        dataset = Dataset.model_validate(data)
    except ValidationError as error:
        raise_misfits(all_messages(error, Dataset), file)
        raise
    raise_misfits(dataset.misfits(), file)
    return dataset


def dataset_schema() -> dict[str, Any]:
    """JSON schema of the manifest of a data set, for editors."""
    return Dataset.model_json_schema(by_alias=True)
