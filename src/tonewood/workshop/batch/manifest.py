"""The manifest of a batch: scores, instruments, factors, and pages for listeners.

Schema ``tonewood-batch/1``, a YAML file. A manifest names instruments and scores; *factors* are parameters of the
instrument (any path of the bundle) or of the render (``render.fs``, ``render.effects``, ...) with named levels;
conditions are the crossed or listed levels; `tonewood.workshop.batch.conditions` expands them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from tonewood.errors import TonewoodError
from tonewood.performance.score.note import Note
from tonewood.sound.render.options import RenderOptions
from tonewood.support.params import described, quantity
from tonewood.support.validation_messages import first_message
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.batch.pages import (
    TRIALS,
    AnyPage,
    HtmlPage,
    Language,
    Levels,
    Name,
    PairPage,
    ParameterPath,
    Section,
    SoundPage,
    StaircasePage,
    Text,
    TrainingPage,
    as_pairs,
)

RESERVED = ("instrument", "score", "repeat")
#: numbers of a note that may vary
NOTE_FIELDS = ("time", "duration", "held", "note", "freq", "force", "velocity_midi", "from_bridge", "angle_deg")
#: keys under ``render.tail`` -> field
TAIL_KEYS = {"cap": "tail", "energy_db": "tail_level_db"}


class ManifestError(TonewoodError):
    """A manifest cannot be used."""


class NoteFields(Section):
    """One inline note: the fields of `tonewood.Note`."""

    time: float = Field(ge=0, le=3600)
    duration: float = Field(default=1.0, gt=0, le=3600)
    held: float | None = Field(default=None, ge=0)
    note: float | None = Field(default=None, ge=0, le=127)
    freq: float | None = Field(default=None, gt=0)
    force: float | None = Field(default=None, ge=0)
    velocity_midi: float | None = Field(default=None, ge=0, le=127)
    string: str | None = None
    stop: int | None = Field(default=None, ge=0)
    from_bridge: float | None = Field(default=None, gt=0)
    angle_deg: float | None = None
    technique: str | None = None
    channel: int | None = Field(default=None, ge=0, le=15)
    marks: tuple[str, ...] = ()
    partial: int | None = Field(default=None, ge=2, le=64)
    glides: tuple[tuple[float, float], ...] = ()
    program: int | None = Field(default=None, ge=1, le=128)

    def to_note(self) -> Note:
        """Convert to the score's own type."""
        return Note(**self.model_dump())


class ScoreSource(Section):
    """A phrase written inline, or an excerpt of a MIDI file (path relative to the manifest)."""

    phrase: list[NoteFields] | None = Field(default=None, min_length=1, max_length=10_000)
    midi: str | None = None
    start: float = Field(default=0.0, ge=0)
    stop: float | None = Field(default=None, gt=0)
    channel_per_string: bool = False

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.phrase is None) == (self.midi is None):
            raise PydanticCustomError("score", "give either phrase or midi")
        if self.phrase is not None and {"start", "stop", "channel_per_string"} & self.model_fields_set:
            raise PydanticCustomError("score", "start, stop and channel_per_string belong to midi")
        if self.stop is not None and self.stop <= self.start:
            raise PydanticCustomError("score", "stop must be later than start")
        return self


class Factor(Section):
    """A parameter and its named levels; a level is a value, ``{scale: x}`` or ``{fraction: x}``."""

    path: ParameterPath
    levels: dict[Name, Any] = Field(min_length=1, max_length=1000)


class Variation(Section):
    """Variation of one parameter from repeat to repeat; exactly one law."""

    normal_db: float | None = Field(default=None, gt=0, le=24, description="standard deviation, dB")
    normal: float | None = Field(default=None, gt=0, description="standard deviation, in the unit of the path")
    uniform: float | None = Field(default=None, gt=0, description="half width, in the unit of the path")

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        if sum(x is not None for x in (self.normal_db, self.normal, self.uniform)) != 1:
            raise PydanticCustomError("vary", "give exactly one of normal_db, normal, uniform")
        return self


class RenderSettings(RenderOptions):
    """Options of the render; any of them may be a factor under ``render.``.

    A manifest may write `tail` and `tail_level_db` as ``tail: {cap, energy_db}``, and a single one of `outputs` as
    ``output``.
    """

    #: key of an earlier version -> message (`validation_messages.first_message`)
    removed: ClassVar[dict[str, str]] = {
        "precision": "was removed in 0.2: samples are always computed in double precision; `tonewood migrate` helps"
    }

    tail: float = quantity("s", low=0.0, high=600.0, default=12.0, doc="longest ring after the last note")
    tail_level_db: float = quantity(
        "dB", low=-300.0, high=-1.0, default=-90.0, doc="the ring has ended this far below the loudest sample"
    )
    isa: Literal["auto", "avx512", "avx2", "neon", "baseline"] = described(
        "instruction set that the renders must be computed with", default="auto"
    )

    @model_validator(mode="before")
    @classmethod
    def _other_spellings(cls, values: Any) -> Any:
        if not isinstance(values, Mapping):
            return values
        out = dict(values)
        for key in ("preset", "room", "room_distance", "room_mix_db"):
            if out.get(key) != cls.model_fields[key].default and key in out:
                text = f"{key}: is for single renders; here `outputs`, `humanize`, `noises` and stimuli.room say it"
                raise PydanticCustomError("room", text)
        if "output" in out and "outputs" not in out and (one := out.pop("output")) is not None:
            out["outputs"] = [one]
        if isinstance(tail := out.get("tail"), Mapping):
            unknown = [key for key in tail if key not in TAIL_KEYS]
            if unknown:
                raise PydanticCustomError("tail", f"tail.{unknown[0]}: is not a known key; allowed: cap, energy_db")
            del out["tail"]
            out |= {TAIL_KEYS[key]: value for key, value in tail.items()}
        return out


class Fade(Section):
    """Raised-cosine fades, s."""

    in_: float = Field(default=0.002, ge=0, le=5, alias="in")
    out: float = Field(default=0.050, ge=0, le=5)


class Onset(Section):
    """Alignment: the onset of every sound stands at the same sample; see `tonewood.workshop.batch.trimming`."""

    align: Literal["detected", "score"] = "detected"
    level_db: float = Field(default=-40.0, ge=-100, le=-3, description="re the sound's peak, of the first sample")
    at: float = Field(default=0.010, ge=0, le=10, description="s from the beginning of the file")


class Trim(Section):
    """The end of a sound: after it no block is louder than `level_db` re the loudest (`workshop.batch.trimming`)."""

    level_db: float | None = Field(default=-60.0, ge=-120, le=-20, description="None: sounds are not trimmed")
    block: float = Field(default=0.020, ge=0.001, le=1.0, description="s")


class Loudness(Section):
    """One gain per file, from its loudness; see `tonewood.workshop.batch.stimuli`."""

    method: Literal["bs1770_gated", "loudest", "none"] = "bs1770_gated"
    window: float = Field(default=0.1, ge=0.01, le=3.0, description="s, of loudest")
    target_lufs: float = Field(default=-23.0, ge=-60, le=-5)
    true_peak_dbtp: float = Field(default=-1.0, ge=-30, le=-0.1)
    removed: ClassVar[dict[str, str]] = {
        "short": "was removed in 0.2: a sound shorter than 400 ms is always measured over one block",
        "on_clash": "was removed in 0.2: a page is always lowered as a whole",
    }


class Stimuli(Section):
    """Properties of all sound files of the batch."""

    fs: int = Field(default=48000, ge=8000, le=192000, description="Hz; renders at another rate are resampled")
    channels: int = Field(default=1, ge=1, le=2)
    downmix: Literal["mean", "first"] = "mean"
    subtype: Literal["PCM_16", "PCM_24"] = "PCM_16"
    room: str | None = Field(default=None, description="impulse response (WAV): of a room, or binaural with 2 channels")
    onset: Onset = Onset()
    trim: Trim = Trim()
    duration: Literal["page_max"] | Annotated[float, Field(gt=0, le=600)] = "page_max"
    longest: float = Field(default=12.0, gt=0, le=600, description="s, limit of page_max")
    fade: Fade = Fade()
    loudness: Loudness = Loudness()


class Power(Section):
    """Probabilities of the errors that `--dry-run` plans the number of listeners for."""

    alpha: float = Field(default=0.05, gt=0, lt=0.5)
    power: float = Field(default=0.8, ge=0.5, lt=1)


class Output(Section):
    """Files that are written, and the order of the pages."""

    blind: bool = Field(default=True, description="the audition page shows codes until it is unblinded")
    key: Annotated[str, Field(pattern=r"^[\w.-]+\.json$")] = "key.json"
    formats: list[Literal["test", "html", "csv", "json"]] = Field(default=["test", "html", "csv", "json"])
    page_order: Literal["seeded", "listed", "per_listener"] = "per_listener"


class Manifest(Section):
    """A whole batch."""

    schema_: Literal["tonewood-batch/1"] = Field(alias="schema")
    kind: Literal["test"] = Field(default="test", description="a listening test; `dataset` has keys of its own")
    name: Name
    title: Text = ""
    language: Language = Field(default="en", description="of a listener whose own has no texts")
    texts: dict[Language, dict[str, str]] = Field(
        default_factory=dict, description="words of the pages of one's own: language -> key -> text"
    )
    seed: int = Field(ge=0, lt=2**63)
    instruments: dict[Name, str] = Field(min_length=1)
    scores: dict[Name, ScoreSource] = Field(min_length=1)
    factors: dict[Name, Factor] = Field(default_factory=dict)
    design: Literal["crossed", "listed"] = "crossed"
    conditions: list[Levels] | None = None
    exclude: list[Levels] = Field(default_factory=list)
    repeats: int = Field(default=1, ge=1, le=1000)
    random: list[str] = Field(
        default_factory=list, description="factors whose levels are a sample of many: results hold for the others, too"
    )
    vary: dict[ParameterPath, Variation] = Field(default_factory=dict)
    render: RenderSettings = RenderSettings()
    stimuli: Stimuli = Stimuli()
    pages: list[AnyPage] = Field(default=[HtmlPage(type="html")], min_length=1)
    power: Power = Power()
    output: Output = Output()

    @field_validator("factors")
    @classmethod
    def _names_are_free(cls, factors: dict[str, Factor]) -> dict[str, Factor]:
        for name in factors:
            if name in RESERVED:
                raise PydanticCustomError("factors", f"{name} is not free as the name of a factor")
        return factors

    @field_validator("vary")
    @classmethod
    def _notes_vary(cls, vary: dict[str, Variation]) -> dict[str, Variation]:
        for path in vary:
            check_vary(path)
        return vary

    def choices(self) -> dict[str, list[str]]:
        """Names that `group_by`, `exclude` and the like may use, with the levels of each."""
        return {
            "instrument": list(self.instruments),
            "score": list(self.scores),
            **{name: list(factor.levels) for name, factor in self.factors.items()},
        }

    @model_validator(mode="after")
    def _names_exist(self) -> Self:
        if (self.design == "listed") != (self.conditions is not None):
            raise PydanticCustomError("design", "design: listed and conditions belong together")
        choices = self.choices()
        for index, row in enumerate(self.exclude):
            _check_levels(row, choices, f"exclude.{index}")
        for index, row in enumerate(self.conditions or []):
            _check_levels(row, choices, f"conditions.{index}")
            if missing := set(self.factors) - set(row):
                raise PydanticCustomError("design", f"conditions.{index}: no level of {', '.join(sorted(missing))}")
        for name in self.random:
            if name not in choices:
                raise PydanticCustomError("random", f"random: {name} is not one of {', '.join(choices)}")
        for index, page in enumerate(self.pages):
            self._check_page(page, f"pages.{index}", choices)
        for name, factor in self.factors.items():
            self._check_render_levels(name, factor)
        return self

    def _check_page(self, page: Any, key: str, choices: dict[str, list[str]]) -> None:
        for name in page.group_by if isinstance(page, SoundPage) else ():
            if name not in choices and name != "repeat":
                allowed = ", ".join([*choices, "repeat"])
                raise PydanticCustomError("page", f"{key}.group_by: {name} is not one of {allowed}")
        if isinstance(page, PairPage):
            for factor, pairs in page.pairs.items():
                _check_levels({factor: choices.get(factor, [""])[0]}, choices, f"{key}.pairs")
                for pair in as_pairs(pairs, choices[factor]):
                    if len(pair) != 2 or pair[0] == pair[1]:
                        raise PydanticCustomError("page", f"{key}.pairs: a pair is two different levels")
                    for level in pair:
                        _check_levels({factor: level}, choices, f"{key}.pairs")
        elif isinstance(page, StaircasePage):
            _check_levels(page.of, choices, f"{key}.of")
        elif isinstance(page, TrainingPage):
            trained = self.pages[page.page - 1] if page.page <= len(self.pages) else None
            if not isinstance(trained, TRIALS):
                raise PydanticCustomError("page", f"{key}.page: {page.page} is no page with trials")
        elif (reference := getattr(page, "reference", None)) is not None:
            _check_levels(reference, choices, f"{key}.reference")

    def _check_render_levels(self, name: str, factor: Factor) -> None:
        if not factor.path.startswith("render."):
            return
        for level, value in factor.levels.items():
            try:
                self.render_settings({factor.path.removeprefix("render."): value})
            except ValidationError as error:
                reason = first_message(error, RenderSettings)[1]
                raise PydanticCustomError("factor", f"factors.{name}.levels.{level}: {reason}") from None

    def render_settings(self, changes: dict[str, Any]) -> RenderSettings:
        """The render settings with some changed, checked anew."""
        names = {f"tail.{key}": field for key, field in TAIL_KEYS.items()}
        data = {**self.render.model_dump(), **{names.get(key, key): value for key, value in changes.items()}}
        return RenderSettings.model_validate(data)


def check_vary(path: str) -> None:
    """Check that a path of `vary` that names a note names one of its numbers."""
    head, _, name = path.partition(".")
    if head == "note" and name not in NOTE_FIELDS:
        raise PydanticCustomError("vary", f"{path} is not one of note.{', note.'.join(NOTE_FIELDS)}")


def _check_levels(row: Levels, choices: dict[str, list[str]], key: str) -> None:
    for name, level in row.items():
        if name not in choices:
            raise PydanticCustomError("levels", f"{key}: {name} is not one of {', '.join(choices)}")
        if level not in choices[name]:
            raise PydanticCustomError("levels", f"{key}.{name}: {level} is not one of {', '.join(choices[name])}")


def load_manifest(path: str | os.PathLike[str]) -> Manifest:
    """Read and check a manifest.

    Raises
    ------
    ManifestError
        One line: file, dotted key, fault and the values allowed.
    """
    return check_manifest(load_yaml(path, error=ManifestError), file=Path(path))


def check_manifest(data: dict[str, Any], *, file: Path | None = None) -> Manifest:
    """As `load_manifest`, from plain data."""
    try:
        return Manifest.model_validate(data)
    except ValidationError as error:
        key, reason = first_message(error, Manifest)
        raise ManifestError(reason, file=file, key=key) from None


def manifest_schema() -> dict[str, Any]:
    """JSON schema of a manifest, for editors."""
    return Manifest.model_json_schema(by_alias=True)
