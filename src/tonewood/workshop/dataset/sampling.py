"""From the manifest of a data set to its sounds, one condition each, in an order that nothing else decides.

Instruments are outermost, then scores, then the samples of the parameters. A sample is a point of the unit cube, mapped
to values: the points of a grid, independent random ones, or a scrambled Sobol sequence (A. B. Owen, J. Complexity 14
(1998) 466), drawn anew for each instrument and score. A sound's point does not move when others are added.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.workshop.batch.conditions import Condition, bundle_of, draws_of, midi_source
from tonewood.workshop.batch.manifest import ManifestError, ScoreSource
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.dataset.manifest import MAX_SOUNDS, Dataset

MIDI_SUFFIXES = (".mid", ".midi")
#: characters that no name of a file in a ZIP has; bytes of a name that are no UTF-8 are half surrogate pairs
_NO_NAME = re.compile("[\x00-\x1f\x7f\\\\\ud800-\udfff]")


@dataclass(frozen=True)
class Sample:
    """One sound to be made.

    index : its number in the data set, from 0.
    """

    index: int
    parameters: dict[str, Any]
    condition: Condition


def points(dataset: Dataset, labels: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Values of the parameters, sample by sample, of one instrument and score."""
    named = dataset.parameters
    if dataset.sampling == "grid":
        for combination in itertools.product(*(p.grid() for p in named.values())):
            yield dict(zip(named, combination, strict=True))
        return
    size = dataset.size or 1
    if dataset.sampling == "sobol" and named:
        from scipy.stats import qmc

        engine = qmc.Sobol(len(named), scramble=True, seed=generator(dataset.seed, "sobol", *labels))
        shares = engine.random_base2(max(0, math.ceil(math.log2(size))))[:size]
    else:
        shares = np.empty((size, len(named)))
        for k, name in enumerate(named):
            shares[:, k] = generator(dataset.seed, "random", name, *labels).random(size)
    for row in shares:
        yield {name: p.at(float(share)) for (name, p), share in zip(named.items(), row, strict=True)}


def sources(dataset: Dataset, folder: Path) -> dict[str, dict[str, Any]]:
    """Fields `notes`, or `midi` and `midi_sha256`, of a condition for each score: those written, and the folder's.

    Raises ManifestError : a file or the folder cannot be read, or holds no MIDI files.
    """
    by_name = {name: _source(name, score, folder) for name, score in dataset.scores.items()}
    if dataset.folder is None:
        return by_name
    root = folder / dataset.folder
    files = sorted(p for p in root.rglob("*") if p.suffix.lower() in MIDI_SUFFIXES and p.is_file())
    if not files:
        raise ManifestError(f"{dataset.folder} holds no MIDI files ({', '.join(MIDI_SUFFIXES)})", key="folder")
    for path in files:
        name = path.relative_to(root).with_suffix("").as_posix()
        if _NO_NAME.search(name):
            reason = f"{name!a} names files of labels: UTF-8 without control characters and backslashes is allowed"
            raise ManifestError(reason, key="folder")
        if name in by_name:
            raise ManifestError(f"{dataset.folder}: two scores are called {name}", key="folder")
        by_name[name] = midi_source(path, path.name, "folder")
    return by_name


def samples(dataset: Dataset, folder: Path) -> list[Sample]:
    """All sounds of a data set, in order.

    Raises ManifestError : a score's file cannot be read, two names differ by case alone, or there are more than
        `MAX_SOUNDS`.
    """
    scores = sources(dataset, folder)
    for key, names in (("instruments", dataset.instruments), ("scores", scores)):
        folded: dict[str, str] = {}
        for name in names:
            if (other := folded.setdefault(name.casefold(), name)) != name:
                reason = f"{other} and {name} differ by case alone; their labels are one file on macOS and Windows"
                raise ManifestError(reason, key=key)
    each = dataset.size or math.prod(len(p.grid()) for p in dataset.parameters.values())
    if (count := len(dataset.instruments) * len(scores) * each) > MAX_SOUNDS:
        raise ManifestError(f"{count} sounds; {MAX_SOUNDS} are allowed", key="parameters")
    plan: list[Sample] = []
    for instrument, bundle in dataset.instruments.items():
        source_folder = bundle_of(bundle, folder)
        for score, source in scores.items():
            for k, values in enumerate(points(dataset, (instrument, score))):
                condition = _condition(dataset, (instrument, source_folder), score, k, values, source)
                plan.append(Sample(len(plan), values, condition))
    return plan


def _condition(
    dataset: Dataset, instrument: tuple[str, str], score: str, k: int, values: dict[str, Any], source: dict[str, Any]
) -> Condition:
    settings: dict[str, dict[str, Any]] = {"note": {}, "render": {}, "": {}}
    for name, value in values.items():
        parameter = dataset.parameters[name]
        head, _, rest = parameter.path.partition(".")
        if head in ("note", "render"):
            settings[head][rest] = value
        else:
            settings[""][parameter.path] = parameter.setting(value)
    labels = (instrument[0], score, str(k))
    return Condition(
        name=f"{instrument[0]}/{score}/{k:06d}",
        instrument=instrument[0],
        score=score,
        repeat=k + 1,
        levels={},
        bundle=instrument[1],
        overrides=settings[""],
        render=dataset.render_settings(settings["render"]),
        draws=draws_of(dataset.vary, dataset.seed, labels),
        seed=dataset.seed,
        note_changes=settings["note"],
        **source,
    )


def _source(name: str, score: ScoreSource, folder: Path) -> dict[str, Any]:
    if score.phrase is not None:
        try:
            return {"notes": tuple(fields.to_note() for fields in score.phrase)}
        except TonewoodError as fault:
            raise ManifestError(fault.reason, key=f"scores.{name}.phrase") from None
    assert score.midi is not None  # the schema asks for one of the two
    path = (folder / score.midi).resolve()
    return midi_source(path, path.name, f"scores.{name}.midi", score)
