"""The manifest of a batch: scores, instruments, factors, and pages for listeners.

Schema ``tonewood-batch/1``, a YAML file. A manifest names instruments and scores; *factors* are parameters of the
instrument (any path of the bundle) or of the render (``render.fs``, ``render.effects``, ...) with named levels;
conditions are the crossed or listed levels; `tonewood.workshop.batch.conditions` expands them.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from tonewood.errors import TonewoodError, together
from tonewood.performance.score.note import Note
from tonewood.sound.level.loudness import sine_loudness
from tonewood.sound.render.options import RenderOptions
from tonewood.support.params import described, quantity
from tonewood.support.validation_messages import all_messages, first_message
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.batch.page_parts import Language, Levels, Name, ParameterPath, Section, Text
from tonewood.workshop.batch.pages import (
    TRIALS,
    AnyPage,
    HtmlPage,
    LevelPage,
    PairPage,
    SoundPage,
    StaircasePage,
    TrainingPage,
    as_pairs,
)

RESERVED = ("instrument", "score", "repeat")
#: other columns of the table of answers
ANSWER_COLUMNS = (
    "listener", "simulated", "page", "type", "trial", "index", "repetition", "training", "stimulus", "role", "item",
    "value", "response", "right", "level", "track", "seconds", "plays", "heard", "time",
)  # fmt: skip
#: numbers of a note that may vary
NOTE_FIELDS = ("time", "duration", "held", "note", "freq", "force", "velocity_midi", "from_bridge", "angle_deg")
#: keys under ``render.tail`` -> field
TAIL_KEYS = {"cap": "tail", "energy_db": "tail_level_db"}


class ManifestError(TonewoodError):
    """A manifest cannot be used; its line counts pages from 1, as a plan does, and `key` from 0."""

    @staticmethod
    def shown_key(key: str) -> str:
        """Return a key with its page counted from 1: ``page 2.reference``."""
        head, _, rest = key.partition(".")
        number, dot, inner = rest.partition(".")
        return f"page {int(number) + 1}{dot}{inner}" if head == "pages" and number.isdecimal() else key


#: dotted key of a manifest -> its fault
Misfit = tuple[str, str]


class NoteFields(Section):
    """One inline note: the fields of `tonewood.Note`."""

    time: float = Field(ge=0, le=3600, description="s from the beginning of the score")
    duration: float = Field(default=1.0, gt=0, le=3600, description="s")
    held: float | None = Field(default=None, ge=0, description="s that the finger stays; the duration if left out")
    note: float | None = Field(default=None, ge=0, le=127, description="MIDI note number, may be fractional")
    freq: float | None = Field(default=None, gt=0, description="Hz, instead of a note")
    force: float | None = Field(default=None, ge=0, description="N")
    velocity_midi: float | None = Field(default=None, ge=0, le=127, description="MIDI velocity, instead of a force")
    string: str | None = Field(default=None, description="name of the string")
    stop: int | None = Field(default=None, ge=0, description="fret or stop on that string")
    from_bridge: float | None = Field(default=None, gt=0, description="m, place of the gesture")
    angle_deg: float | None = Field(default=None, description="direction of the gesture")
    technique: str | None = Field(default=None, description="name of an exciter")
    channel: int | None = Field(default=None, ge=0, le=15, description="MIDI channel, from 0")
    marks: tuple[str, ...] = Field(default=(), description="signs of the notation")
    partial: int | None = Field(default=None, ge=2, le=64, description="number of a harmonic")
    glides: tuple[tuple[float, float], ...] = Field(default=(), description="(s, semitones) from the note's beginning")
    program: int | None = Field(default=None, ge=1, le=128, description="General MIDI program, from 1")

    def to_note(self) -> Note:
        """Convert to the score's own type."""
        return Note(**self.model_dump())


class ScoreSource(Section):
    """A phrase written inline, or an excerpt of a MIDI file (path relative to the manifest)."""

    phrase: list[NoteFields] | None = Field(
        default=None, min_length=1, max_length=10_000, description="notes written here"
    )
    midi: str | None = Field(default=None, description="MIDI file, relative to the manifest")
    start: float = Field(default=0.0, ge=0, description="s of the file at which the excerpt begins")
    stop: float | None = Field(default=None, gt=0, description="s of the file at which it ends")
    channel_per_string: bool = Field(default=False, description="MIDI channel 1 plays the first string, and so on")

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

    path: ParameterPath = Field(description="parameter of the bundle, or of the render (render.)")
    levels: dict[Name, Any] = Field(
        min_length=1, max_length=1000, description="name -> value, {scale: x} or {fraction: x}"
    )


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

    in_: float = Field(default=0.002, ge=0, le=5, alias="in", description="s, at the beginning")
    out: float = Field(default=0.050, ge=0, le=5, description="s, at the end")


class Onset(Section):
    """Alignment: the onset of every sound stands at the same sample; see `tonewood.workshop.batch.trimming`."""

    align: Literal["detected", "score"] = Field(
        default="detected", description="the first loud sample, or score time 0, is put at `at`"
    )
    level_db: float = Field(default=-40.0, ge=-100, le=-3, description="re the sound's peak, of the first sample")
    at: float = Field(default=0.010, ge=0, le=10, description="s from the beginning of the file")


class Trim(Section):
    """The end of a sound: after it no block is louder than `level_db` re the loudest (`workshop.batch.trimming`)."""

    level_db: float | None = Field(default=-60.0, ge=-120, le=-20, description="None: sounds are not trimmed")
    block: float = Field(default=0.020, ge=0.001, le=1.0, description="s")


class Loudness(Section):
    """One gain per file, from its loudness; see `tonewood.workshop.batch.stimuli`."""

    method: Literal["bs1770_gated", "loudest", "none"] = Field(default="bs1770_gated", description="what is made equal")
    window: float = Field(default=0.1, ge=0.01, le=3.0, description="s, of loudest")
    target_lufs: float = Field(default=-23.0, ge=-60, le=-5, description="LUFS")
    true_peak_dbtp: float = Field(default=-1.0, ge=-30, le=-0.1, description="dBTP, limit of a page's sounds")
    removed: ClassVar[dict[str, str]] = {
        "short": "was removed in 0.2: a sound shorter than 400 ms is always measured over one block",
        "on_clash": "was removed in 0.2: a page is always lowered as a whole",
    }


class Stimuli(Section):
    """Properties of all sound files of the batch."""

    fs: int = Field(default=48000, ge=8000, le=192000, description="Hz; renders at another rate are resampled")
    channels: int = Field(default=1, ge=1, le=2, description="of the files")
    downmix: Literal["mean", "first"] = Field(default="mean", description="mean of all channels, or the first alone")
    subtype: Literal["PCM_16", "PCM_24"] = Field(default="PCM_16", description="bits of a sample")
    room: str | None = Field(default=None, description="impulse response (WAV): of a room, or binaural with 2 channels")
    onset: Onset = Field(default=Onset(), description="alignment of beginnings")
    trim: Trim = Field(default=Trim(), description="where sounds end")
    duration: Literal["page_max"] | Annotated[float, Field(gt=0, le=600)] = Field(
        default="page_max", description="s of every file, or that of the page's longest sound"
    )
    longest: float = Field(default=12.0, gt=0, le=600, description="s, limit of page_max")
    fade: Fade = Field(default=Fade(), description="at both ends")
    loudness: Loudness = Field(default=Loudness(), description="gain of each sound")


class Power(Section):
    """Probabilities of the errors that `--dry-run` plans the number of listeners for."""

    alpha: float = Field(default=0.05, gt=0, lt=0.5, description="probability of a false alarm")
    power: float = Field(default=0.8, ge=0.5, lt=1, description="probability of finding what is expected")


class Output(Section):
    """Files that are written, and the order of the pages."""

    blind: bool = Field(default=True, description="the audition page shows codes until it is unblinded")
    key: Annotated[str, Field(pattern=r"^[\w.-]+\.json$")] = Field(
        default="key.json", description="file of codes and conditions"
    )
    formats: list[Literal["test", "html", "csv", "json", "parquet"]] = Field(
        default=["test", "html", "csv", "json"],
        description="test.json, audition.html, and the record as CSV, JSON and Parquet",
    )
    pictures: bool = Field(
        default=False, description="waveform, spectrogram and differences of every sound, for the audition page"
    )
    page_order: Literal["seeded", "listed", "per_listener"] = Field(
        default="per_listener",
        description="order of trials: another one for each listener, one random order, or as listed",
    )


class Manifest(Section):
    """A whole batch."""

    schema_: Literal["tonewood-batch/1"] = Field(alias="schema", description="of this file")
    kind: Literal["test"] = Field(default="test", description="a listening test; `dataset` has keys of its own")
    name: Name = Field(description="of the test")
    title: Text = Field(default="", description="that listeners see")
    licence: str = Field(default="", description="of the sounds, an SPDX name, for the data sheet")
    language: Language = Field(default="en", description="of a listener whose own has no texts")
    texts: dict[Language, dict[str, str]] = Field(
        default_factory=dict, description="words of the pages of one's own: language -> key -> text"
    )
    seed: int = Field(ge=0, lt=2**63, description="of every random choice")
    instruments: dict[Name, str] = Field(
        min_length=1, description="name -> installed instrument, or folder relative to the manifest"
    )
    scores: dict[Name, ScoreSource] = Field(min_length=1, description="name -> music")
    factors: dict[Name, Factor] = Field(default_factory=dict, description="name -> parameter and its levels")
    design: Literal["crossed", "listed"] = Field(
        default="crossed", description="all combinations of levels, or those of `conditions`"
    )
    conditions: list[Levels] | None = Field(default=None, description="levels of each condition, of design listed")
    exclude: list[Levels] = Field(
        default_factory=list, description="conditions with any of these sets of levels are left out"
    )
    repeats: int = Field(default=1, ge=1, le=1000, description="times that each condition is rendered")
    random: list[str] = Field(
        default_factory=list, description="factors whose levels are a sample of many: results hold for the others, too"
    )
    vary: dict[ParameterPath, Variation] = Field(default_factory=dict, description="path -> human variation")
    render: RenderSettings = Field(default=RenderSettings(), description="settings of all renders")
    stimuli: Stimuli = Field(default=Stimuli(), description="what is done to sounds")
    pages: list[AnyPage] = Field(
        default=[HtmlPage(type="html")], min_length=1, description="that listeners see, in order"
    )
    power: Power = Field(default=Power(), description="for counting listeners")
    output: Output = Field(default=Output(), description="files that are written")

    def choices(self) -> dict[str, list[str]]:
        """Names that `group_by`, `exclude` and the like may use, with the levels of each."""
        return {
            "instrument": list(self.instruments),
            "score": list(self.scores),
            **{name: list(factor.levels) for name, factor in self.factors.items()},
        }

    def misfits(self, replaced: Collection[int] = ()) -> Iterator[Misfit]:
        """Names that are not there and parts that do not fit together, in the manifest's order.

        replaced : pages (from 0) that stand for faulty ones: nothing is said of them.
        """
        choices = self.choices()
        yield from (
            ("factors", f"{name} is not free as the name of a factor") for name in self.factors if name in RESERVED
        )
        for name, factor in self.factors.items():
            yield from self._misfits_of_render(name, factor)
        if (self.design == "listed") != (self.conditions is not None):
            yield "design", "listed and conditions belong together"
        for index, row in enumerate(self.conditions or []):
            yield from _misfits_of_levels(row, choices, f"conditions.{index}")
            if missing := set(self.factors) - set(row):
                yield f"conditions.{index}", f"no level of {', '.join(sorted(missing))}"
        for index, row in enumerate(self.exclude):
            yield from _misfits_of_levels(row, choices, f"exclude.{index}")
        for name in self.random:
            if name not in choices:
                yield "random", f"{name} is not one of {', '.join(choices)}"
        yield from misfits_of_vary(self.vary)
        for index, page in enumerate(self.pages):
            if not isinstance(page, TrainingPage) or page.page - 1 not in replaced:
                yield from self._misfits_of_page(page, f"pages.{index}", choices)

    def _misfits_of_page(self, page: Any, key: str, choices: dict[str, list[str]]) -> Iterator[Misfit]:
        for name in page.group_by if isinstance(page, SoundPage) else ():
            if name not in choices and name != "repeat":
                yield f"{key}.group_by", f"{name} is not one of {', '.join([*choices, 'repeat'])}"
        for part in ("questions", "scales"):  # answers stand under these names
            names = [one.name for one in getattr(page, part, ())]
            yield from ((f"{key}.{part}", f"{name} stands there twice") for name in names if names.count(name) > 1)
        if isinstance(page, PairPage):
            for factor, pairs in page.pairs.items():
                if factor not in choices:
                    yield from _misfits_of_levels({factor: ""}, choices, f"{key}.pairs")
                    continue
                for pair in as_pairs(pairs, choices[factor]):
                    if len(pair) != 2 or pair[0] == pair[1]:
                        yield f"{key}.pairs", "a pair is two different levels"
                    for level in pair:
                        yield from _misfits_of_levels({factor: level}, choices, f"{key}.pairs")
        elif isinstance(page, StaircasePage):
            yield from _misfits_of_levels(page.of, choices, f"{key}.of")
        elif isinstance(page, TrainingPage):
            trained = self.pages[page.page - 1] if page.page <= len(self.pages) else None
            if not isinstance(trained, TRIALS):
                yield f"{key}.page", f"{page.page} is no page with trials"
        elif (reference := getattr(page, "reference", None)) is not None:
            yield from _misfits_of_levels(reference, choices, f"{key}.reference")

    def _misfits_of_render(self, name: str, factor: Factor) -> Iterator[Misfit]:
        if not factor.path.startswith("render."):
            return
        for level, value in factor.levels.items():
            try:
                self.render_settings({factor.path.removeprefix("render."): value})
            except ValidationError as error:
                yield f"factors.{name}.levels.{level}", first_message(error, RenderSettings)[1]

    def render_settings(self, changes: dict[str, Any]) -> RenderSettings:
        """The render settings with some changed, checked anew."""
        names = {f"tail.{key}": field for key, field in TAIL_KEYS.items()}
        data = {**self.render.model_dump(), **{names.get(key, key): value for key, value in changes.items()}}
        return RenderSettings.model_validate(data)


def misfits_of_tones(manifest: Manifest) -> Iterator[Misfit]:
    """Tones of level pages that files at this rate, and of this loudness, cannot hold."""
    settings = manifest.stimuli
    for index, page in enumerate(manifest.pages):
        if not isinstance(page, LevelPage):
            continue
        if page.freq >= 0.5 * settings.fs:
            reason = f"is {page.freq:g} Hz; less than half of stimuli.fs, {settings.fs} Hz, is wanted"
            yield f"pages.{index}.freq", reason
        elif (most := sine_loudness(page.freq, settings.channels)) < settings.loudness.target_lufs:
            reason = f"a sine of {page.freq:g} Hz at full scale has {most:.1f} LUFS, and stimuli.loudness asks for more"
            yield f"pages.{index}.freq", reason


def misfits_of_vary(vary: Mapping[str, Variation]) -> Iterator[Misfit]:
    """Paths of `vary` that name a note, but none of its numbers."""
    for path in vary:
        head, _, name = path.partition(".")
        if head == "note" and name not in NOTE_FIELDS:
            yield f"vary.{path}", f"is not one of note.{', note.'.join(NOTE_FIELDS)}"


def _misfits_of_levels(row: Levels, choices: dict[str, list[str]], key: str) -> Iterator[Misfit]:
    for name, level in row.items():
        if name not in choices:
            yield key, f"{name} is not one of {', '.join(choices)}"
        elif level not in choices[name]:
            yield f"{key}.{name}", f"{level} is not one of {', '.join(choices[name])}"


def load_manifest(path: str | os.PathLike[str]) -> Manifest:
    """Read and check a manifest.

    Raises ManifestError : a line for each fault: file, key, fault and the values allowed.
    """
    manifest = check_manifest(load_yaml(path, error=ManifestError), file=Path(path))
    taken = [name for name in manifest.factors if name in ANSWER_COLUMNS]  # tests of earlier versions may have them
    reason = "is not free as the name of a factor: it is a column of the table of answers"
    raise_misfits([*[("factors", f"{name} {reason}") for name in taken], *misfits_of_tones(manifest)], Path(path))
    return manifest


def check_manifest(data: dict[str, Any], *, file: Path | None = None) -> Manifest:
    """As `load_manifest`, from plain data."""
    try:
        manifest = Manifest.model_validate(data)
        misfits = list(manifest.misfits())
    except ValidationError as error:
        misfits = all_messages(error, Manifest)
        misfits += _misfits_besides(data, [key for key, _ in misfits])
        raise_misfits(misfits, file)
    raise_misfits(misfits, file)
    return manifest


def raise_misfits(misfits: Iterable[Misfit], file: Path | None) -> None:
    """Raise all faults of a manifest as one ManifestError, if there are any."""
    faults = [ManifestError(reason, file=file, key=key) for key, reason in dict.fromkeys(misfits)]
    if faults:
        raise together(faults)


#: values that fit, in place of those of required keys that do not
_STAND_INS: dict[str, Any] = {
    "schema": "tonewood-batch/1", "name": "name", "seed": 0, "instruments": {"i": "i"}, "scores": {"s": {"midi": "s"}},
}  # fmt: skip


def _misfits_besides(data: dict[str, Any], keys: Sequence[str]) -> list[Misfit]:
    """What else is wrong with a manifest whose values at `keys` are faulty: its misfits with others in their place."""
    whole, replaced = copy.deepcopy(data), set()
    for top, _, rest in (key.partition(".") for key in keys):
        inner = rest.partition(".")[0]
        section = whole.get(top)
        if top == "pages" and inner.isdecimal() and isinstance(section, list):
            section[int(inner)] = {"type": "instructions"}
            replaced.add(int(inner))
        elif top == "factors" and isinstance(section, dict) and isinstance(factor := section.get(inner), dict):
            levels = factor.get("levels")
            section[inner] = {"path": "p", "levels": levels if isinstance(levels, dict) else {}}
        elif top in ("instruments", "scores") and isinstance(section, dict) and inner in section:
            section[inner] = _STAND_INS[top][top[0]]
        elif top in _STAND_INS:
            whole[top] = _STAND_INS[top]
        else:
            whole.pop(top, None)
    try:
        return list(Manifest.model_validate(whole).misfits(replaced))
    except ValidationError:
        return []


def manifest_schema() -> dict[str, Any]:
    """JSON schema of a manifest, for editors."""
    return Manifest.model_json_schema(by_alias=True)
