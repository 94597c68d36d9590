"""The manifest of a data set: scores, instruments, and parameters with the values that they take.

Schema ``tonewood-batch/1`` with ``kind: dataset``. A parameter is a path of the bundle, of the render (``render.``) or
of every note (``note.``); its values are listed, or drawn from a range.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from tonewood.performance.score.note import Note
from tonewood.support.validation_messages import first_message
from tonewood.workshop.batch.manifest import (
    NOTE_FIELDS,
    ManifestError,
    RenderSettings,
    ScoreSource,
    Variation,
    check_vary,
)
from tonewood.workshop.batch.pages import Name, ParameterPath, Section

#: fields of a note that a parameter may set
SETTABLE = (*NOTE_FIELDS, "string", "stop", "technique", "channel")
#: MIDI files have at most this many ticks in a beat, and whole microseconds in one
_MOST_TICKS = 32767
_BEATS_PER_SECOND = (1, 2, 4, 5, 8, 10)
MAX_SOUNDS = 10_000_000

Range = tuple[float, float]


class Parameter(Section):
    """A parameter and its values: `values`, or one range."""

    path: ParameterPath
    values: list[Any] | None = Field(default=None, min_length=1, max_length=100_000)
    uniform: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    log_uniform: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
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
        found = self.uniform or self.log_uniform
        return None if found is None else (found[0], found[1])

    def _check_notes(self, name: str) -> None:
        for value in self.values or self.range or ():
            fields: dict[str, Any] = {"time": 0.0, "note": 60.0, name: value}
            if name == "freq":
                fields["note"] = None
            try:
                Note(**fields)
            except Exception as fault:
                raise PydanticCustomError("parameter", f"{self.path}: {value!r}: {fault}") from None

    def at(self, share: float) -> Any:
        """The value at a share 0 to 1 of the range, or of the list."""
        if self.values is not None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        low, high = self.range or (0.0, 1.0)
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

    subtype: Literal["PCM_16", "PCM_24"] = "PCM_24"
    level: Literal["calibrated", "peak"] = Field(
        default="calibrated", description="the instrument's full scale, with render.gain_db; or each to -1 dBFS"
    )
    stems: Literal["none", "string"] = Field(default="none", description="the shares of all strings, too")
    duration: float | None = Field(default=None, gt=0, le=3600, description="s, of every sound: zeros, or cut")
    per_shard: int = Field(default=100, ge=1, le=100_000, description="sounds in a shard")
    labels: list[Literal["jams", "midi"]] = Field(default=["jams", "midi"], description="files beside the tables")


class Dataset(Section):
    """A whole data set."""

    schema_: Literal["tonewood-batch/1"] = Field(alias="schema")
    kind: Literal["dataset"]
    name: Name
    title: str = ""
    licence: str = Field(default="", description="of the sounds, an SPDX name; the instruments' own are listed besides")
    seed: int = Field(ge=0, lt=2**63)
    instruments: dict[Name, str] = Field(min_length=1)
    scores: dict[Name, ScoreSource] = Field(default_factory=dict)
    folder: str | None = Field(default=None, description="of MIDI files, each a score, folders below it included")
    parameters: dict[Name, Parameter] = Field(default_factory=dict)
    sampling: Literal["grid", "random", "sobol"] = "grid"
    size: int | None = Field(default=None, ge=1, description="sounds of each instrument and score; of a grid all")
    vary: dict[ParameterPath, Variation] = Field(default_factory=dict)
    render: RenderSettings = RenderSettings()
    sounds: Sounds = Sounds()

    @field_validator("vary")
    @classmethod
    def _notes_vary(cls, vary: dict[str, Variation]) -> dict[str, Variation]:
        for path in vary:
            check_vary(path)
        return vary

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.scores and self.folder is None:
            raise PydanticCustomError("dataset", "scores: give scores, or a folder of MIDI files")
        if self.sampling == "grid":
            if self.size is not None:
                raise PydanticCustomError("dataset", "size: a grid has as many sounds as its parameters have values")
            missing = [n for n, p in self.parameters.items() if p.values is None and p.steps is None]
            if missing:
                raise PydanticCustomError("dataset", f"parameters.{missing[0]}.steps: is missing; a grid needs it")
        elif self.size is None:
            raise PydanticCustomError("dataset", f"size: is missing; sampling: {self.sampling} needs it")
        elif steps := [n for n, p in self.parameters.items() if p.steps is not None]:
            raise PydanticCustomError("dataset", f"parameters.{steps[0]}.steps: belongs to sampling: grid")
        paths = [p.path for p in self.parameters.values()]
        if double := {path for path in paths if paths.count(path) > 1}:
            raise PydanticCustomError("dataset", f"parameters: {min(double)} stands there twice")
        if "midi" in self.sounds.labels and midi_clock(self.render.fs) is None:
            raise PydanticCustomError(
                "dataset", f"sounds.labels: MIDI has no tick of one sample at {self.render.fs} Hz; take [jams]"
            )
        for name, parameter in self.parameters.items():
            if parameter.path.startswith("render."):
                self._check_render(name, parameter)
        return self

    def _check_render(self, name: str, parameter: Parameter) -> None:
        if parameter.path == "render.fs":
            raise PydanticCustomError("dataset", f"parameters.{name}.path: all sounds of a data set have one rate")
        for value in parameter.values or parameter.range or ():
            try:
                self.render_settings({parameter.path.removeprefix("render."): value})
            except ValidationError as error:
                reason = first_message(error, RenderSettings)[1]
                raise PydanticCustomError("dataset", f"parameters.{name}: {value!r}: {reason}") from None

    def render_settings(self, changes: dict[str, Any]) -> RenderSettings:
        """The render settings with some changed, checked anew."""
        return RenderSettings.model_validate({**self.render.model_dump(), **changes})


def midi_clock(fs: float) -> tuple[int, int] | None:
    """Ticks per beat and microseconds per beat for which a tick is one sample; None if there are none."""
    for beats in _BEATS_PER_SECOND:
        if fs % beats == 0 and fs / beats <= _MOST_TICKS:
            return int(fs // beats), 1_000_000 // beats
    return None


def check_dataset(data: dict[str, Any], *, file: Path | None = None) -> Dataset:
    """Check the manifest of a data set.

    Raises
    ------
    ManifestError : one line: file, dotted key, fault and the values allowed.
    """
    try:
        return Dataset.model_validate(data)
    except ValidationError as error:
        key, reason = first_message(error, Dataset)
        raise ManifestError(reason, file=file, key=key) from None
