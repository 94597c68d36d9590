"""Makes a data set, shard by shard, on any number of workers; an unfinished one is taken up again.

A shard counts as made when its record stands there, written last, with the key of everything that decides its bytes.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tonewood.errors import OutputError, TonewoodError
from tonewood.support.folder_lock import locked
from tonewood.support.text_files import json_value
from tonewood.support.whole_files import remove, write_whole
from tonewood.workshop.batch.data_sheet import Subject, write_data_sheet
from tonewood.workshop.batch.manifest import ManifestError
from tonewood.workshop.batch.production import Fault
from tonewood.workshop.batch.records import write_json
from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.store import content_key
from tonewood.workshop.batch.workers import Workers
from tonewood.workshop.dataset.manifest import Dataset
from tonewood.workshop.dataset.sampling import Sample, samples
from tonewood.workshop.dataset.shards import Shard, ShardTask, make, shard_name

SCHEMA = "tonewood-dataset/1"
SHARD_SCHEMA = "tonewood-shard/1"
SHARDS, PHYSICS, RECORD = "shards", "physics", "dataset.json"
#: sounds that are tried to predict time and length, and s of each
_TRIED, _PIECE = 6, 6.0
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class DatasetPlan:
    """The work of a data set, before anything is rendered.

    keys : of all shards, by number.
    faults : sounds that cannot be resolved.
    sound_seconds, compute_seconds : predicted for all sounds, s of one core; None if not asked.
    """

    dataset: Dataset
    samples: tuple[Sample, ...]
    tasks: tuple[ShardTask, ...]
    keys: dict[int, str]
    faults: tuple[Fault, ...]
    sound_seconds: float | None = None
    compute_seconds: float | None = None

    @cached_property
    def hours_per_core_hour(self) -> float | None:
        """Hours of sound that one core makes in an hour."""
        if self.sound_seconds is None or not self.compute_seconds:
            return None
        return self.sound_seconds / self.compute_seconds

    def summary(self) -> dict[str, Any]:
        """The plan as JSON-ready data."""
        return {
            "name": self.dataset.name,
            "sounds": len(self.samples),
            "shards": len(self.keys),
            "to_make": len(self.tasks),
            "sound_hours": None if self.sound_seconds is None else self.sound_seconds / 3600,
            "core_hours": None if self.compute_seconds is None else self.compute_seconds / 3600,
            "sound_hours_per_core_hour": self.hours_per_core_hour,
            "failed": [{"name": f.name, "reason": f.reason} for f in self.faults],
        }


@dataclass(frozen=True)
class DatasetReport:
    """Result of a run."""

    name: str
    folder: Path
    made: int
    reused: int
    sounds: int
    sound_seconds: float
    sha256: str
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.faults

    def summary(self) -> dict[str, Any]:
        """The report as JSON-ready data."""
        faults = [{"name": f.name, "reason": f.reason} for f in self.faults]
        return {**vars(self), "folder": str(self.folder), "faults": faults, "notes": list(self.notes)}


def plan_dataset(
    dataset: Dataset, source: Path, folder: Path, renderer: EngineRenderer, *, predict: bool = False
) -> DatasetPlan:
    """List the shards that are not made yet; nothing is written.

    predict : try some sounds, and predict time and length.
    Raises TonewoodError
        A score cannot be read, no sound can be resolved, or the folder holds a data set of another name.
    """
    _check_folder(dataset, folder)
    every = tuple(samples(dataset, source))
    size = dataset.sounds.per_shard
    by = f"tonewood {version('tonewood')}"
    settings = {"sounds": dataset.sounds.model_dump(mode="json"), "by": by, "labels": SHARD_SCHEMA}
    tasks, keys = [], {}
    faults: list[Fault] = []
    for number, start in enumerate(range(0, len(every), size)):
        part = every[start : start + size]
        identities = []
        for sample in part:
            try:
                identities.append(content_key(renderer.identity(sample.condition)))
            except TonewoodError as fault:
                faults.append(Fault(sample.condition.name, str(fault)))
                identities.append(str(fault))
        named = [[s.condition.name, s.parameters, key] for s, key in zip(part, identities, strict=True)]
        keys[number] = content_key({"settings": settings, "sounds": named})
        if not _is_made(folder, number, keys[number]):
            tasks.append(ShardTask(number, dataset, part, renderer, by))
    if len(faults) == len(every):
        raise ManifestError(f"no sound can be resolved: {faults[0].reason}")
    plan = DatasetPlan(dataset, every, tuple(tasks), keys, tuple(faults))
    return _predicted(plan, renderer) if predict else plan


def _is_made(folder: Path, number: int, key: str) -> bool:
    """Whether a shard is there, whole and of this key, with no sound that failed."""
    try:
        record = json_value((folder / SHARDS / f"{shard_name(number)}.json").read_bytes())
        if record.pop("sha256") != _digest(record) or record["key"] != key or record["failed"]:
            return False
        return all(
            hashlib.sha256((folder / subfolder / name).read_bytes()).hexdigest() == digest
            for subfolder, files in ((SHARDS, record["files"]), (PHYSICS, record["physics"]))
            for name, digest in files.items()
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return False


def _digest(record: dict[str, Any]) -> str:
    """SHA-256 of the record of a shard, by which a damaged one is known."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _check_folder(dataset: Dataset, folder: Path) -> None:
    """Check that a folder holds no shard of a data set of another name. Raises OutputError : it does."""
    for path in sorted((folder / SHARDS).glob("*.json")):
        with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
            if (name := json_value(path.read_bytes())["name"]) != dataset.name:
                raise OutputError(f"holds the data set {name!r}; take another folder", file=folder)


def _predicted(plan: DatasetPlan, renderer: EngineRenderer) -> DatasetPlan:
    """The plan with time and length of all sounds, from a few of them spread over the set; the first warms up.

    Those of them that cannot be rendered are among its faults.
    """
    n = len(plan.samples)
    chosen = sorted({round(k * (n - 1) / max(_TRIED - 1, 1)) for k in range(_TRIED)})
    lengths, costs = [], []
    faults = {fault.name: fault for fault in plan.faults}
    for index in [chosen[0], *chosen]:
        try:
            began = time.process_time()
            trial = renderer.renderer(plan.samples[index].condition)
            ready = time.process_time()
            frames = 0
            for block in trial.blocks(4096):
                frames += len(block)
                if frames > _PIECE * trial.fs:
                    break
        except TonewoodError as fault:
            name = plan.samples[index].condition.name
            faults.setdefault(name, Fault(name, str(fault)))
            continue
        stepped = time.process_time() - ready
        seconds = frames / trial.fs
        whole = trial.expected_duration - 0.5 * trial.options.tail if frames > _PIECE * trial.fs else seconds
        lengths.append(max(whole, seconds))
        costs.append(ready - began + stepped * lengths[-1] / max(seconds, 1e-9))
    plan = replace(plan, faults=tuple(faults.values()))
    lengths, costs = (lengths[1:] or lengths), (costs[1:] or costs)
    if not lengths:
        return plan
    passes = 2 if plan.dataset.sounds.stems == "string" else 1
    sound = n * (plan.dataset.sounds.duration or sum(lengths) / len(lengths))
    return replace(plan, sound_seconds=sound, compute_seconds=passes * n * sum(costs) / len(costs))


def run_dataset(
    dataset: Dataset,
    source: Path,
    folder: Path,
    renderer: EngineRenderer,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> DatasetReport:
    """Make the missing shards, and the record of the whole.

    dataset, source, folder, renderer : as for `plan_dataset`.
    workers : where shards are rendered; only this process writes.
    Raises TonewoodError : the manifest is wrong, the disk is full, the workers are gone. Finished shards are kept.
    """
    started = time.perf_counter()
    plan = plan_dataset(dataset, source, folder, renderer)
    shard_folder = folder / SHARDS
    faults: list[Fault] = []
    notes: list[str] = []
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "tonewood batch"):
        shards = (workers or Workers()).each(make, plan.tasks) if plan.tasks else ()
        for done, shard in enumerate(shards, start=1):
            _write(folder, shard, plan.keys[shard.number], dataset.name)
            faults += shard.faults
            notes += shard.notes
            if progress is not None:
                progress("shards", done, len(plan.tasks))
        for stray in shard_folder.glob("[0-9][0-9][0-9][0-9][0-9]*.*"):
            name = stray.name.partition(".")[0]
            if name.isdecimal() and name not in {shard_name(number) for number in plan.keys}:
                remove(stray)
        records = _records(folder, plan.keys)
        digests = sorted((name, digest) for record in records for name, digest in record["sounds"].items())
        whole = hashlib.sha256(json.dumps(digests).encode()).hexdigest()
        seconds = sum(record["seconds"] for record in records)
        write_json(folder / RECORD, _record(plan, records, whole, seconds, faults))
        write_data_sheet(folder, _subject(plan, seconds, dict(digests)), _identities(plan, renderer))
    return DatasetReport(
        name=dataset.name,
        folder=folder,
        made=len(plan.tasks),
        reused=len(plan.keys) - len(plan.tasks),
        sounds=len(plan.samples) - len(faults),
        sound_seconds=seconds,
        sha256=whole,
        faults=tuple(sorted(faults, key=lambda fault: fault.name)),
        notes=tuple(sorted(notes)),
        seconds=time.perf_counter() - started,
    )


def _subject(plan: DatasetPlan, seconds: float, digests: dict[str, str]) -> Subject:
    dataset = plan.dataset
    facts = {
        "format": f"FLAC, {dataset.render.fs:g} Hz, {dataset.sounds.subtype}",
        "length": f"{seconds:.1f} s in all",
        "level": dataset.sounds.level,
    }
    data = dataset.model_dump(mode="json", by_alias=True, exclude_none=True)
    return Subject(dataset.name, dataset.title, dataset.licence, data, facts, digests)


def _identities(plan: DatasetPlan, renderer: EngineRenderer) -> list[dict[str, Any]]:
    """Identities of the first sound that can be made on each instrument."""
    identities: dict[str, dict[str, Any]] = {}
    for sample in plan.samples:
        if sample.condition.bundle not in identities:
            with suppress(TonewoodError):
                identities[sample.condition.bundle] = renderer.identity(sample.condition)
    return list(identities.values())


def _write(folder: Path, shard: Shard, key: str, data_set: str) -> None:
    """Write the files of a shard, and its record last."""
    shard_folder, name = folder / SHARDS, shard_name(shard.number)
    remove(shard_folder / f"{name}.json")
    for stray in shard_folder.glob(f"{name}.*"):
        if stray.name not in shard.files:
            remove(stray)
    for file, content in {**shard.files, **{f"../{PHYSICS}/{k}": v for k, v in shard.physics.items()}}.items():
        write_whole((shard_folder / file).resolve(), content, make_folder=True)
    record = {
        "schema": SHARD_SCHEMA,
        "name": data_set,
        "key": key,
        "seconds": shard.seconds,
        "failed": [{"name": f.name, "reason": f.reason} for f in shard.faults],
        "files": {file: hashlib.sha256(content).hexdigest() for file, content in sorted(shard.files.items())},
        "physics": {file: hashlib.sha256(content).hexdigest() for file, content in sorted(shard.physics.items())},
        "sounds": _digests(shard),
    }
    write_json(shard_folder / f"{name}.json", {**record, "sha256": _digest(record)})


def _digests(shard: Shard) -> dict[str, str]:
    """Name of a sound (and stem) -> SHA-256 of its samples."""
    import pyarrow.parquet as pq
    from pyarrow import BufferReader

    table = shard.files.get(f"{shard_name(shard.number)}.parquet")
    if table is None:
        return {}
    rows = pq.read_table(BufferReader(table), columns=["sound", "stem", "sha256"]).to_pylist()
    return {f"{row['sound']}.{row['stem']}".rstrip("."): row["sha256"] for row in rows}


def _records(folder: Path, numbers: Sequence[int] | dict[int, str]) -> list[dict[str, Any]]:
    return [json.loads((folder / SHARDS / f"{shard_name(n)}.json").read_bytes()) for n in numbers]


def _record(
    plan: DatasetPlan, shards: list[dict[str, Any]], whole: str, seconds: float, faults: Sequence[Fault]
) -> dict[str, Any]:
    """Record of the data set; nothing in it depends on the number of workers."""
    names = sorted({s.condition.bundle for s in plan.samples})
    return {
        "schema": SCHEMA,
        "name": plan.dataset.name,
        "manifest": plan.dataset.model_dump(mode="json", by_alias=True, exclude_none=True),
        "sounds": sum(len(record["sounds"]) for record in shards),
        "seconds": seconds,
        "sounds_sha256": whole,
        "bundles": names,
        "shards": [record["files"] for record in shards],
        "failed": [{"name": f.name, "reason": f.reason} for f in sorted(faults, key=lambda fault: fault.name)],
    }
