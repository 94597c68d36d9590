"""A shard: sounds one after the other in a FLAC file, tables of sounds and notes, and the labels as files in a ZIP.

All of it is a function of the samples of the shard, so its bytes are the same whoever makes it: no times, no names of
machines, and ZIP entries of a fixed date.
"""

from __future__ import annotations

import hashlib
import io
import json
import traceback
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.support.parquet import is_storable
from tonewood.workshop.batch.production import Fault
from tonewood.workshop.batch.rendering import EngineRenderer, instrument_of
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.batch.stimuli import BITS, quantised
from tonewood.workshop.batch.store import content_key
from tonewood.workshop.dataset import labels
from tonewood.workshop.dataset.manifest import Dataset
from tonewood.workshop.dataset.sampling import Sample
from tonewood.workshop.dataset.sound import Sound, note_row, sound_of

#: of ZIP entries; the format begins in 1980
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class ShardTask:
    """A shard to be made; all that a worker needs."""

    number: int
    dataset: Dataset
    samples: tuple[Sample, ...]
    renderer: EngineRenderer
    by: str


@dataclass(frozen=True)
class Shard:
    """A shard that was made: its files by name, and sounds that failed."""

    number: int
    files: dict[str, bytes]
    physics: dict[str, bytes]
    seconds: float
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]


def shard_name(number: int) -> str:
    """Beginning of the names of a shard's files."""
    return f"{number:05d}"


def make(task: ShardTask) -> Shard:
    """Render all sounds of a shard."""
    rows: list[dict[str, Any]] = []
    notes: list[dict[str, Any]] = []
    faults: list[Fault] = []
    texts: list[str] = []
    pieces: list[Any] = []
    files: dict[str, bytes] = {}
    physics: dict[str, bytes] = {}
    start, sounds = 0, task.dataset.sounds
    for sample in task.samples:
        condition = sample.condition
        try:
            key = content_key(task.renderer.identity(condition))
            sound = sound_of(task.renderer, condition, sounds.level, sounds.stems == "string", sounds.duration)
        except TonewoodError as fault:
            faults.append(Fault(condition.name, str(fault)))
            continue
        except Exception as fault:  # an error of a plugin must not end the other renders
            faults.append(Fault(condition.name, f"{type(fault).__name__}: {fault}", traceback.format_exc()))
            continue
        instrument = instrument_of(condition, task.renderer.allow_code)
        resolved = json.dumps(instrument.resolved, sort_keys=True, default=str).encode()
        resolved_key = hashlib.sha256(resolved).hexdigest()[:16]
        physics[f"{resolved_key}.json"] = resolved
        facts = _facts(sample, sound, key, resolved_key)
        for stem, samples in sound.stems.items():
            random = generator(task.dataset.seed, "dither", condition.name, stem)
            edge = 1.0 - 2.0 / 2 ** (BITS[sounds.subtype] - 1)  # two steps are left to the dither
            whole = quantised(np.clip(samples, -edge, edge), sounds.subtype, random)
            pieces.append(whole)
            digest = hashlib.sha256(np.ascontiguousarray(whole, dtype="<i4").tobytes()).hexdigest()
            peak = float(np.max(np.abs(whole))) / 2.0 ** (BITS[sounds.subtype] - 1)
            record = {"stem": stem, "start": start, "frames": len(whole), "sha256": digest, "peak": peak}
            record["clipped"] = sound.clipped[stem]
            rows.append({**facts, **record, "file": f"{shard_name(task.number)}.flac"})
            start += len(whole)
        notes += [note_row(condition.name, note) for note in sound.notes]
        files |= _labels(task, sample, sound)
        texts += _warning_lines(condition.name, sound)
    seconds = sum(row["frames"] / row["fs"] for row in rows if row["stem"] == "")
    return Shard(task.number, _written(task, rows, notes, pieces, files), physics, seconds, tuple(faults), tuple(texts))


def _facts(sample: Sample, sound: Sound, key: str, physics: str) -> dict[str, Any]:
    condition = sample.condition
    return {
        "sound": condition.name,
        "index": sample.index,
        "instrument": condition.instrument,
        "score": condition.score,
        "fs": sound.fs,
        "channels": ",".join(sound.channels),
        "gain_db": sound.gain_db,
        "notes": len(sound.notes),
        "dropped": len(sound.dropped),
        "key": key,
        "physics": physics,
        **{f"p.{name}": value for name, value in sample.parameters.items()},
    }


def _labels(task: ShardTask, sample: Sample, sound: Sound) -> dict[str, bytes]:
    """Files of labels of one sound."""
    name, formats = sample.condition.name, task.dataset.sounds.labels
    files = {}
    if "jams" in formats:
        seconds = len(sound.stems[""]) / sound.fs
        text = labels.jams(name, sound.notes, sound.fs, seconds, sample.parameters, task.by)
        files[f"{name}.jams"] = text.encode()
    if "midi" in formats:
        files[f"{name}.mid"] = labels.midi(sound.notes, sound.fs)
    return files


def _warning_lines(name: str, sound: Sound) -> list[str]:
    lines = [f"{name}: {reason}" for reason in (*sound.warnings, *sound.dropped)]
    for stem, clipped in sound.clipped.items():
        if clipped and stem:
            lower = "take sounds: {level: calibrated} with a lower render.gain_db"
            lines.append(f"{name}: {clipped} samples of the stem {stem} clipped; {lower}")
        elif clipped:
            lines.append(f"{name}: {clipped} samples clipped; lower render.gain_db, or take sounds: {{level: peak}}")
    return lines


def _written(
    task: ShardTask, rows: list[dict[str, Any]], notes: list[dict[str, Any]], pieces: list[Any], files: dict[str, bytes]
) -> dict[str, bytes]:
    """Bytes of the shard's files."""
    import soundfile

    name, subtype = shard_name(task.number), task.dataset.sounds.subtype
    if not rows:
        return {}
    width = max(piece.shape[1] for piece in pieces)
    whole = np.concatenate([np.pad(p, ((0, 0), (0, width - p.shape[1]))) for p in pieces])
    stream = io.BytesIO()
    samples = whole if subtype == "PCM_16" else whole << 8
    soundfile.write(stream, samples, int(rows[0]["fs"]), subtype=subtype, format="FLAC")
    made_files = {f"{name}.flac": stream.getvalue(), f"{name}.parquet": parquet(rows)}
    if notes:
        made_files[f"{name}.notes.parquet"] = parquet(notes)
    if files:
        made_files[f"{name}.labels.zip"] = zipped(files)
    return made_files


def parquet(rows: Sequence[dict[str, Any]]) -> bytes:
    """Rows as Parquet; a column of values of several kinds, or with an integer beyond 64 bits, is text (JSON)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, list[Any]] = {key: [row.get(key) for row in rows] for key in rows[0]}
    for key, values in columns.items():
        kinds = {bool if isinstance(v, bool) else float if isinstance(v, (int, float)) else type(v) for v in values}
        kinds -= {type(None)}
        if len(kinds) > 1 or kinds & {list, dict, tuple} or not all(map(is_storable, values)):
            columns[key] = [None if v is None else json.dumps(v) for v in values]
        elif kinds == {float} and any(isinstance(v, float) for v in values):
            columns[key] = [None if v is None else float(v) for v in values]
        elif not kinds:  # all are missing
            columns[key] = pa.array(values, pa.float64())
    stream = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), stream, compression="zstd")
    return bytes(stream.getvalue().to_pybytes())


def zipped(files: dict[str, bytes]) -> bytes:
    """Files as a ZIP, the same bytes for the same files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
    return stream.getvalue()
