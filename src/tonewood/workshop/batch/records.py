"""Records of a batch: the key to its codes, and a record of every file as JSON and CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tonewood.support.csv_text import csv_text
from tonewood.support.parquet import write_parquet
from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.batch.layout import Group
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.production import Fault, SoundFile

KEY_SCHEMA = "tonewood-key/1"
RECORD_SCHEMA = "tonewood-record/1"
RECORD_JSON = "manifest.json"
RECORD_CSV = "manifest.csv"
RECORD_PARQUET = "manifest.parquet"


def key_of(manifest: Manifest, groups: Sequence[Group], conditions: Mapping[str, Condition]) -> dict[str, Any]:
    """The key to the codes: every trial and every file with its factor levels."""
    trials = {
        trial.id: {
            "page": group.page + 1,
            "type": manifest.pages[group.page].type,
            "group": trial.name,
            "fixed": group.fixed,
            "reference": trial.reference,
            "stimuli": list(trial.stimuli),
        }
        for group in groups
        for trial in group.trials
    }
    stimuli = {
        stimulus.code: {
            "condition": stimulus.condition,
            "role": stimulus.role,
            "group": group.name,
            "levels": conditions[stimulus.condition].all_levels,
        }
        for group in groups
        for stimulus in group.stimuli
    }
    return {
        "schema": KEY_SCHEMA,
        "name": manifest.name,
        "seed": manifest.seed,
        "factors": list(manifest.choices()),
        "levels": manifest.choices(),
        "trials": trials,
        "stimuli": stimuli,
    }


def file_records(
    files: Sequence[SoundFile],
    conditions: Mapping[str, Condition],
    identities: Mapping[str, dict[str, Any]],
    renders: Mapping[str, dict[str, Any]],
) -> list[dict[str, Any]]:
    """One record per file: the condition, its sources, facts about the render, and the file itself.

    identities, renders : by content key; the renderer's identity of a sound, and its facts about the render.
    """
    records = []
    for file in files:
        condition = conditions[file.condition]
        records.append(
            {
                **asdict(file),
                "instrument": condition.instrument,
                "score": condition.score,
                "repeat": condition.repeat,
                "levels": condition.levels,
                "seed": condition.seed,
                "asked": condition.asked(),
                "identity": identities[file.key],
                "render": renders[file.key],
            }
        )
    return records


def batch_record(
    manifest: Manifest, records: Sequence[Mapping[str, Any]], faults: Sequence[Fault], notes: Sequence[str]
) -> dict[str, Any]:
    """The whole record of a batch."""
    return {
        "schema": RECORD_SCHEMA,
        "name": manifest.name,
        "manifest": manifest.model_dump(mode="json", by_alias=True, exclude_none=True),
        "files": list(records),
        "failed": [asdict(fault) for fault in faults],
        "notes": list(notes),
    }


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write readable JSON, as a whole file."""
    text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
    write_whole(path, text + "\n", make_folder=True)


def write_csv(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """Write records as a table: nested facts get dotted columns, lists stand as JSON."""
    write_whole(path, csv_text(*_table(records)), make_folder=True)


def write_table(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """As `write_csv`, as Parquet."""
    write_parquet(path, *_table(records))


def _table(records: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[dict[str, Any]]]:
    """Columns and rows of records."""
    rows = [dict(_flat(record)) for record in records]
    return list(dict.fromkeys(name for row in rows for name in row)), rows


def _flat(value: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for name, item in value.items():
        if isinstance(item, Mapping):
            pairs += _flat(item, f"{prefix}{name}.")
        elif isinstance(item, (list, tuple)):
            pairs.append((prefix + name, json.dumps(item, ensure_ascii=False)))
        else:
            pairs.append((prefix + name, item))
    return pairs
