"""From a manifest to its conditions: one per combination of instrument, score, factor levels and repeat.

The list is in the order of the manifest (instruments outermost, repeats innermost), so it is the same on every
machine. A repeat differs from the next by its human variation only. The variation is drawn for instrument, score
and repeat, not for the condition: sounds that listeners compare share one performance, and differ in the factors
alone.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.contract.registry import INSTRUMENTS, entries
from tonewood.performance.score.note import Note
from tonewood.workshop.batch.manifest import Manifest, ManifestError, RenderSettings, ScoreSource, Variation
from tonewood.workshop.batch.seeds import generator

MAX_CONDITIONS = 100_000
#: numbers of a note that are set in the parameters of an exciter, too
_EXCITER_FIELDS = ("force", "from_bridge", "angle_deg", "time")


@dataclass(frozen=True)
class Draw:
    """One parameter's human variation in one repeat: a law and its own random numbers."""

    path: str
    law: str  # normal_db | normal | uniform
    spread: float
    seed: int
    labels: tuple[str, ...]

    @property
    def note_field(self) -> str | None:
        """Field of a note that varies from note to note, or None for a parameter of the instrument.

        ``note.time`` names a field of every note; so does ``exciters.pluck.force``, since a note's gesture is
        where force and place are set.
        """
        head, _, last = self.path.rpartition(".")
        if head == "note":
            return last
        of_notes = head.count(".") == 1 and head.startswith("exciters.")
        return last if of_notes and last in _EXCITER_FIELDS else None

    def values(self, n: int) -> NDArray[np.float64]:
        """The first `n` draws, shape (n,): factors for ``normal_db``, else amounts to add."""
        random = generator(self.seed, "vary", self.path, *self.labels)
        if self.law == "uniform":
            return random.uniform(-self.spread, self.spread, n)
        drawn = self.spread * random.standard_normal(n)
        return np.asarray(10.0 ** (drawn / 20.0) if self.law == "normal_db" else drawn, dtype=np.float64)

    def applied(self, value: float, drawn: float) -> float:
        """`value` varied by one number of `values`."""
        return value * drawn if self.law == "normal_db" else value + drawn


@dataclass(frozen=True)
class Condition:
    """One sound to be rendered: plain data, so that it can go to another process or machine.

    name : readable, e.g. ``harp.low.damping=complex.r1``.
    instrument, score, repeat, levels : where it stands in the design.
    bundle : name or absolute path of the instrument bundle.
    overrides : bundle path -> value, in the manifest's order.
    render : settings of the render, with the levels of ``render.*`` factors in them.
    notes : of an inline phrase, or None.
    midi : absolute path, start, stop (s or None), channel_per_string of a MIDI excerpt, or None.
    draws : the human variation of this repeat.
    note_changes : field of `tonewood.Note` -> value for every note of the score.
    """

    name: str
    instrument: str
    score: str
    repeat: int
    levels: dict[str, str]
    bundle: str
    overrides: dict[str, Any]
    render: RenderSettings
    notes: tuple[Note, ...] | None = None
    midi: dict[str, Any] | None = None
    midi_sha256: str | None = None
    draws: tuple[Draw, ...] = ()
    seed: int = 0
    all_levels: dict[str, str] = field(default_factory=dict)
    note_changes: dict[str, Any] = field(default_factory=dict)

    def asked(self) -> dict[str, Any]:
        """Everything of the manifest that decides the samples, as JSON-ready data (no names, no places)."""
        return {
            "overrides": self.overrides,
            "render": self.render.model_dump(mode="json"),
            "notes": None if self.notes is None else [dataclasses.asdict(n) for n in self.notes],
            "midi": None if self.midi is None else {k: v for k, v in self.midi.items() if k != "path"},
            "midi_sha256": self.midi_sha256,
            "draws": [dataclasses.asdict(d) for d in self.draws],
            "seed": self.seed,
            **({"note_changes": self.note_changes} if self.note_changes else {}),
        }


def expand(manifest: Manifest, folder: Path) -> tuple[Condition, ...]:
    """All conditions of a manifest, in its order.

    folder : the manifest's folder, to which its paths are relative.
    Raises ManifestError
        A score's file cannot be read, nothing is left after exclusion, or there are more than `MAX_CONDITIONS`.
    """
    count = len(manifest.instruments) * len(manifest.scores) * manifest.repeats
    count *= math.prod(len(f.levels) for f in manifest.factors.values())
    if manifest.design == "crossed" and count > MAX_CONDITIONS:
        raise ManifestError(f"{count} conditions; {MAX_CONDITIONS} are allowed", key="factors")
    sources = {name: _source(name, s, folder) for name, s in manifest.scores.items()}
    conditions = tuple(
        _condition(manifest, folder, sources[cell["score"]], cell, repeat)
        for cell in _places(manifest)
        for repeat in range(1, manifest.repeats + 1)
    )
    if not conditions:
        raise ManifestError("nothing is left to render", key="exclude")
    return conditions


def vary_notes(
    notes: Sequence[Note], draws: Sequence[Draw], base: Callable[[Draw, Note], float | None]
) -> tuple[Note, ...]:
    """Notes with their human variation, in time order.

    notes : in the order they were written.
    draws : those with a `note_field` are applied, each with one number per note.
    base : value of that field before the variation, given in the note or by the instrument; None leaves the note
        unchanged.
    """
    varied = list(notes)
    for draw in draws:
        name = draw.note_field
        if name is None:
            continue
        for i, drawn in enumerate(draw.values(len(varied))):
            value = base(draw, notes[i])
            if value is not None:
                changed: dict[str, Any] = {name: draw.applied(value, float(drawn))}
                if name not in ("angle_deg", "note"):
                    changed[name] = max(changed[name], 0.0)
                if name == "velocity_midi":
                    changed[name] = min(changed[name], 127.0)
                varied[i] = dataclasses.replace(varied[i], **changed)
    return tuple(sorted(varied, key=lambda note: note.time))


def _places(manifest: Manifest) -> Iterator[dict[str, str]]:
    """Levels of every condition of the design, exclusions taken out."""
    choices = manifest.choices()
    if manifest.design == "crossed":
        rows = (dict(zip(choices, combo, strict=True)) for combo in itertools.product(*choices.values()))
    else:
        rows = (
            {"instrument": instrument, "score": score, **row}
            for row in manifest.conditions or []
            for instrument in ([row["instrument"]] if "instrument" in row else choices["instrument"])
            for score in ([row["score"]] if "score" in row else choices["score"])
        )
    seen: set[tuple[str, ...]] = set()
    for row in rows:
        levels = {name: row[name] for name in choices}
        key = tuple(levels.values())
        if key not in seen and not any(rule.items() <= levels.items() for rule in manifest.exclude):
            seen.add(key)
            yield levels


def _condition(
    manifest: Manifest, folder: Path, source: dict[str, Any], cell: dict[str, str], repeat: int
) -> Condition:
    instrument, score = cell["instrument"], cell["score"]
    levels = {name: cell[name] for name in manifest.factors}
    values = {manifest.factors[name].path: manifest.factors[name].levels[lv] for name, lv in levels.items()}
    settings = {p.removeprefix("render."): v for p, v in values.items() if p.startswith("render.")}
    parts = [instrument, score, *(f"{name}={level}" for name, level in levels.items())]
    parts += [f"r{repeat}"] if manifest.repeats > 1 else []
    labels = (instrument, score, str(repeat))
    return Condition(
        name=".".join(parts),
        instrument=instrument,
        score=score,
        repeat=repeat,
        levels=levels,
        all_levels={**cell, "repeat": str(repeat)},
        bundle=bundle_of(manifest.instruments[instrument], folder),
        overrides={p: v for p, v in values.items() if not p.startswith("render.")},
        render=manifest.render_settings(settings),
        draws=draws_of(manifest.vary, manifest.seed, labels),
        seed=manifest.seed,
        **source,
    )


def draws_of(vary: Mapping[str, Variation], seed: int, labels: tuple[str, ...]) -> tuple[Draw, ...]:
    """The human variation of one performance, which `labels` name."""
    laws = {path: next(iter(law.model_dump(exclude_none=True).items())) for path, law in vary.items()}
    return tuple(Draw(path, law, float(spread), seed, labels) for path, (law, spread) in laws.items())


def bundle_of(value: str, folder: Path) -> str:
    """Name of an installed instrument, or a folder relative to the manifest's."""
    beside = folder / value
    if "/" in value or "\\" in value or (value not in entries(INSTRUMENTS) and beside.is_dir()):
        return str(beside.resolve())
    return value


def _source(name: str, score: ScoreSource, folder: Path) -> dict[str, Any]:
    if score.phrase is not None:
        return {"notes": tuple(fields.to_note() for fields in score.phrase)}
    assert score.midi is not None  # the schema asks for one of the two
    return midi_source((folder / score.midi).resolve(), score.midi, f"scores.{name}.midi", score)


def midi_source(path: Path, name: str, key: str, excerpt: ScoreSource | None = None) -> dict[str, Any]:
    """Fields `midi` and `midi_sha256` of a condition; the whole file without an excerpt.

    Raises ManifestError : the file, which is called `name`, cannot be read; names the key.
    """
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as fault:
        raise ManifestError(f"{name} cannot be read: {fault.strerror}", key=key) from None
    fields = excerpt or ScoreSource(midi=name)
    midi = {key: getattr(fields, key) for key in ("start", "stop", "channel_per_string")}
    return {"midi": {"path": str(path), **midi}, "midi_sha256": digest}
