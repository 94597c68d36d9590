"""Files of a batch beside its sounds: test, audition page, records, key, data sheet."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import remove
from tonewood.workshop.batch import audition, definition, records
from tonewood.workshop.batch.data_sheet import Subject, write_data_sheet
from tonewood.workshop.batch.layout import Group
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import localised
from tonewood.workshop.batch.pictures import write_differences
from tonewood.workshop.batch.plan import BatchPlan
from tonewood.workshop.batch.production import PICTURES, SOUNDS, Fault, SoundFile
from tonewood.workshop.batch.workers import Workers

_CODE_FILE = re.compile(r"[b-df-hj-np-tv-xz]{6}\.(wav|png)")


def write_outputs(
    plan: BatchPlan,
    groups: Sequence[Group],
    files: Sequence[SoundFile],
    renders: dict[str, dict[str, Any]],
    faults: Sequence[Fault],
    notes: Sequence[str],
    folder: Path,
    workers: Workers,
) -> None:
    """Write them into the batch's folder; those of earlier runs under other codes are removed.

    groups, files : that are complete.
    renders : facts about the render by content key.
    faults, notes : for the record.
    Raises OutputError : a file cannot be written.
    """
    manifest, formats = plan.manifest, plan.manifest.output.formats
    by_code = {f.code: f for f in files}
    conditions = {c.name: c for c in plan.conditions}
    _remove_strangers(folder, set(by_code), pictures=manifest.output.pictures)
    rows = records.file_records(files, conditions, plan.identities, renders)
    if "test" in formats:
        drops = {f.group: f.page_drop_db for f in files}
        test = definition.definition_of(manifest, groups, by_code, plan.source, drops)
        records.write_json(folder / definition.FILE, test)
    if "html" in formats:
        if manifest.output.pictures:
            _draw_differences(groups, by_code, folder, workers)
        audition.write_audition(folder, manifest, groups, by_code, conditions)
    if "csv" in formats:
        records.write_csv(folder / records.RECORD_CSV, rows)
    if "parquet" in formats:
        records.write_table(folder / records.RECORD_PARQUET, rows)
    if "json" in formats:
        record = records.batch_record(manifest, rows, faults, notes)
        if plan.room is not None:
            record["room_sha256"] = definition.room_sha256(plan.room)
        records.write_json(folder / records.RECORD_JSON, record)
    write_data_sheet(folder, _subject(manifest, files), [plan.identities[key] for key in renders])
    records.write_json(folder / manifest.output.key, records.key_of(manifest, groups, conditions))


def _subject(manifest: Manifest, files: Sequence[SoundFile]) -> Subject:
    settings = manifest.stimuli
    loudness = [f.lufs for f in files if f.lufs is not None]
    level = settings.loudness
    target = "" if level.method == "none" else f", {level.target_lufs:g} LUFS"
    facts = {
        "format": f"WAV, {settings.fs} Hz, {settings.channels} channels, {settings.subtype}",
        "length": f"{sum(f.frames for f in files) / settings.fs:.1f} s in all",
        "loudness": f"{level.method}{target}",
    }
    if loudness:
        facts["measured"] = f"{min(loudness):.1f} to {max(loudness):.1f} LUFS (BS.1770)"
    data = manifest.model_dump(mode="json", by_alias=True, exclude_none=True)
    title = localised(manifest.title, manifest.language)
    return Subject(manifest.name, title, manifest.licence, data, facts, {f.code: f.sha256 for f in files})


#: sounds in one figure of differences
_MOST_DIFFERENCES = 13


def _draw_differences(groups: Sequence[Group], files: Mapping[str, SoundFile], folder: Path, workers: Workers) -> None:
    """One figure a group: how its sounds differ from the reference, or from the first."""
    shown = [g for g in groups if any(s.code in files for s in g.stimuli)]
    tasks = []
    for number, group in enumerate(shown, start=1):
        references = [t.reference for t in group.trials if t.reference is not None]
        present = sorted((s for s in group.stimuli if s.code in files), key=lambda s: s.code not in references[:1])
        path = folder / PICTURES / f"differences{number}.png"
        if 1 < len(present) <= _MOST_DIFFERENCES:
            labels = [s.condition + ("" if s.role == "sound" else f" ({s.role})") for s in present]
            sounds = {label: folder / files[s.code].file for label, s in zip(labels, present, strict=True)}
            tasks.append((path, sounds, group.name))
        else:
            remove(path)
    for _ in workers.each(_draw, tasks) if tasks else ():
        pass


def _draw(task: tuple[Path, dict[str, Path], str]) -> None:
    import soundfile

    path, files, heading = task
    sounds = {label: soundfile.read(file, always_2d=True)[0] for label, file in files.items()}
    write_differences(path, sounds, soundfile.info(next(iter(files.values()))).samplerate, heading)


def _remove_strangers(folder: Path, codes: set[str], *, pictures: bool) -> None:
    """Remove sounds and pictures an earlier run made under codes that are no longer in use."""
    for subfolder, used in ((folder / SOUNDS, codes), (folder / PICTURES, codes if pictures else set())):
        for path in subfolder.glob("*.*"):
            if _CODE_FILE.fullmatch(path.name) and path.stem not in used:
                remove(path)
    for path in () if pictures else (folder / PICTURES).glob("differences*.png"):
        remove(path)
