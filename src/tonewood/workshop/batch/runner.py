"""Runs a batch: renders the missing conditions, then writes files, pages and records.

An interrupted run (a kill, a full disk) is continued by running it again: renders are stored under the hash of
everything that decides their samples, and a render is either complete or absent. A condition that fails is reported,
and the others are rendered; pages and pairs without one of their sounds are left out.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tonewood.errors import NumericalError, OutputError, TonewoodError
from tonewood.support.folder_lock import locked
from tonewood.support.whole_files import remove
from tonewood.workshop.batch import audition, definition, records
from tonewood.workshop.batch.conditions import Condition, expand
from tonewood.workshop.batch.layout import Group, lay_out
from tonewood.workshop.batch.manifest import Manifest, ManifestError, load_manifest
from tonewood.workshop.batch.pages import HtmlPage, PairPage, as_pairs
from tonewood.workshop.batch.pictures import write_differences
from tonewood.workshop.batch.production import (
    PICTURES,
    SOUNDS,
    Fault,
    SoundFile,
    level_faults,
    make_files,
    room_response,
)
from tonewood.workshop.batch.stimuli import StimulusError
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.batch.workers import Workers

WORK = "work"
_FILE_SECONDS = 0.1  # to measure, write and draw one sound file
_CODE_FILE = re.compile(r"[b-df-hj-np-tv-xz]{6}\.(wav|png)")
Progress = Callable[[str, int, int], None]


class StimulusRenderer(Protocol):
    """Renders conditions. It is pickled into workers; every call depends on its condition alone."""

    def identity(self, condition: Condition) -> dict[str, Any]:
        """Everything that decides the samples, JSON-ready: parameters, hashes, version, instruction set."""

    def render(self, condition: Condition) -> Rendered:
        """The sound itself."""

    def own_value(self, condition: Condition, path: str) -> Any:
        """Value of a parameter of the instrument or the render (``render.``); raises a TonewoodError without one."""

    def predict(self, condition: Condition) -> float:
        """About how long `render` will take, s."""


@dataclass(frozen=True)
class BatchPlan:
    """The work of a batch, before anything is rendered.

    Attributes
    ----------
    source : the manifest's folder.
    conditions, groups : of the manifest, those that could be resolved.
    levels : of staircases, rendered beforehand.
    keys : content key by condition name.
    todo : one condition for each key that is not rendered yet.
    seconds : predicted time of rendering those and of writing the files with the workers given, s; None if not asked.
    faults : conditions that could not be resolved.
    """

    manifest: Manifest
    source: Path
    conditions: tuple[Condition, ...]
    levels: tuple[definition.StaircaseLevel, ...]
    groups: tuple[Group, ...]
    keys: dict[str, str]
    identities: dict[str, dict[str, Any]]
    todo: tuple[Condition, ...]
    seconds: float | None
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]

    @property
    def room(self) -> Path | None:
        """File of the impulse response that all sounds are convolved with."""
        return None if self.manifest.stimuli.room is None else self.source / self.manifest.stimuli.room

    @property
    def n_files(self) -> int:
        """Sound files that will be written."""
        return sum(len(g.stimuli) for g in self.groups)

    def trials_of_a_pair(self) -> dict[int, int]:
        """Trials that a listener gets on each page (from 0) of pairs, of one pair of levels."""
        found: dict[int, int] = {}
        for index, page in enumerate(self.manifest.pages):
            if isinstance(page, PairPage):
                (factor, pairs), *_ = page.pairs.items()
                count = len(as_pairs(pairs, self.manifest.choices()[factor]))
                trials = sum(len(g.trials) for g in self.groups if g.page == index)
                trials = min(trials, page.subset or trials)
                found[index] = page.times * max(1, trials // count)
        return found

    def summary(self) -> dict[str, Any]:
        """The plan as JSON-ready data."""
        return {
            "name": self.manifest.name,
            "conditions": [c.name for c in self.conditions],
            "to_render": len(self.todo),
            "rendered": len(set(self.keys.values())) - len(self.todo),
            "files": self.n_files,
            "trials": sum(len(g.trials) for g in self.groups),
            "predicted_seconds": None if self.seconds is None else round(self.seconds, 3),
            "failed": [{"name": f.name, "reason": f.reason} for f in self.faults],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Report:
    """Result of a run."""

    name: str
    folder: Path
    rendered: int
    reused: int
    files: tuple[SoundFile, ...]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.faults

    def summary(self) -> dict[str, Any]:
        """The report as JSON-ready data."""
        return {
            "name": self.name,
            "folder": str(self.folder),
            "rendered": self.rendered,
            "reused": self.reused,
            "files": len(self.files),
            "failed": [{"name": f.name, "reason": f.reason} for f in self.faults],
            "notes": list(self.notes),
            "seconds": round(self.seconds, 3),
        }


def plan_batch(
    manifest_path: Path,
    folder: Path,
    renderer: StimulusRenderer,
    workers: Workers | None = None,
    *,
    predict: bool = False,
) -> BatchPlan:
    """Expand a manifest and list the conditions that are not rendered yet; nothing is written.

    Parameters
    ----------
    manifest_path, folder, renderer, workers : as for `run_batch`.
    predict : predict the time too, for which the renderer may try itself.

    Raises
    ------
    TonewoodError
        The manifest cannot be used, or no condition can be resolved.
    """
    manifest = load_manifest(manifest_path)
    try:
        conditions = expand(manifest, manifest_path.parent)
        groups, notes = lay_out(manifest, conditions)
        levels = definition.staircase_levels(manifest, manifest_path.parent, renderer.own_value)
        if (room := manifest.stimuli.room) is not None:
            try:
                room_response(manifest_path.parent / room, manifest.stimuli)
            except StimulusError as fault:
                raise ManifestError(f"{room}: {fault.reason}", key="stimuli.room") from None
    except ManifestError as fault:
        raise ManifestError(fault.reason, file=manifest_path, key=fault.key) from None
    keys: dict[str, str] = {}
    identities: dict[str, dict[str, Any]] = {}
    faults: list[Fault] = []
    for condition in (*conditions, *(level.condition for level in levels)):
        try:
            identity = renderer.identity(condition)
        except TonewoodError as fault:
            faults.append(Fault(condition.name, str(fault)))
            continue
        keys[condition.name] = key = content_key(identity)
        identities[key] = identity
    if not keys:  # a misspelt path of a factor: one line, however many conditions have it
        raise ManifestError(f"no condition can be resolved: {faults[0].reason}", file=manifest_path)
    store = Store(folder / WORK)
    try:
        new = [level for level in levels if not store.has(keys.get(level.condition.name, ""))]
        definition.check_rendering(new, renderer.render)
    except ManifestError as fault:
        raise ManifestError(fault.reason, file=manifest_path, key=fault.key) from None
    todo: dict[str, Condition] = {}
    for condition in (*conditions, *(level.condition for level in levels)):
        wanted = keys.get(condition.name)
        if wanted is not None and wanted not in todo and not store.has(wanted):
            todo[wanted] = condition
    # one instrument after the other: workers keep the models that they used last
    order = sorted(
        todo, key=lambda key: json.dumps([(c := todo[key]).bundle, c.overrides], default=str, sort_keys=True)
    )
    todo = {key: todo[key] for key in order}
    if todo and (unused := store.others(set(keys.values()))):
        notes.append(
            f"{unused} renders in {store.folder} are not used: they were made of something else (parameters, scores, "
            "version, instruction set, BLAS or other libraries)"
        )
    seconds = None
    if predict:
        seconds = _FILE_SECONDS * sum(len(g.stimuli) for g in groups)
        for condition in todo.values():
            try:
                seconds += renderer.predict(condition)
            except TonewoodError as fault:
                faults.append(Fault(condition.name, str(fault)))
        seconds /= 1 if workers is None else workers.count
    plan = BatchPlan(
        manifest,
        manifest_path.parent,
        conditions,
        tuple(levels),
        groups,
        keys,
        identities,
        tuple(todo.values()),
        seconds,
        tuple(faults),
        tuple(notes),
    )
    _check_answers(plan, folder)
    return plan


def _check_answers(plan: BatchPlan, folder: Path) -> None:
    """Check that no test and no sound is replaced to which answers were given; raises as `check_answers`."""
    heard = {plan.keys.get(condition.name) for condition in plan.conditions}
    replaced = sum(plan.keys[condition.name] in heard for condition in plan.todo)
    definition.check_answers(folder, plan.manifest, plan.source, plan.groups, replaced)


def run_batch(
    manifest_path: Path,
    folder: Path,
    renderer: StimulusRenderer,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> Report:
    """Render the missing conditions and write the whole batch into `folder`.

    Parameters
    ----------
    manifest_path : the YAML file.
    folder : made if need be; of it, listeners get sounds only, by `tonewood serve`.
    renderer : see `StimulusRenderer`.
    workers : where the work is done; rendering may go to a cluster, files are made here.
    progress : called with the stage's name, the number done and the number in all.

    Raises
    ------
    TonewoodError
        The batch cannot begin or go on: the manifest is wrong, the disk is full, the workers are gone. Finished
        renders are kept.
    """
    started = time.perf_counter()
    workers = workers or Workers()
    plan = plan_batch(manifest_path, folder, renderer, workers)
    store = Store(folder / WORK)
    try:
        store.folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:  # better to know before the first render
        raise OutputError(f"cannot be made: {fault.strerror}", file=folder) from None
    with locked(folder, "tonewood batch"):
        _check_answers(plan, folder)
        return _run(plan, folder, store, renderer, workers, progress, started)


def _run(
    plan: BatchPlan,
    folder: Path,
    store: Store,
    renderer: StimulusRenderer,
    workers: Workers,
    progress: Progress | None,
    started: float,
) -> Report:
    manifest = plan.manifest
    failed = _render_missing(plan, store, renderer, workers, progress)
    renders = {key: store.facts(key) for key in set(plan.keys.values()) - set(failed)}
    keys = {name: key for name, key in plan.keys.items() if key in renders}
    groups, lost = _complete(
        plan.groups, {s.code for g in plan.groups for s in g.stimuli if s.condition in keys}, manifest
    )
    files, silent, lowered = make_files(
        groups,
        keys,
        store,
        manifest.stimuli,
        folder,
        workers.local(),
        room=plan.room,
        seed=manifest.seed,
        pictures="html" in manifest.output.formats,
        advance=_Counter(progress, "files", 2 * sum(len(g.stimuli) for g in groups)),
    )
    groups, lost_too = _complete(groups, {f.code for f in files}, manifest)
    heard = {s.code for g in groups for s in g.stimuli}
    files = [f for f in files if f.code in heard]
    unrendered = [Fault(name, f.reason, f.detail) for name, key in plan.keys.items() if (f := failed.get(key))]
    levels = {f"{x.condition.name} ({x.key})": keys.get(x.condition.name) for x in plan.levels}
    faults = (*plan.faults, *unrendered, *silent, *level_faults(levels, store, manifest.stimuli, plan.room))
    notes = (*plan.notes, *lost, *lowered, *lost_too)
    _write_records(plan, groups, files, renders, faults, notes, folder, workers.local())
    return Report(
        name=manifest.name,
        folder=folder,
        rendered=len(plan.todo) - len(failed),
        reused=len(set(plan.keys.values())) - len(plan.todo),
        files=tuple(files),
        faults=faults,
        notes=notes,
        seconds=time.perf_counter() - started,
    )


@dataclass(frozen=True)
class _Outcome:
    key: str
    rendered: Rendered | None
    fault: Fault | None = None


def _render_missing(
    plan: BatchPlan, store: Store, renderer: StimulusRenderer, workers: Workers, progress: Progress | None
) -> dict[str, Fault]:
    """Render the missing conditions; returns failures by key. Only this process writes to the store."""
    store.clear_parts()
    tasks = [(renderer, condition, plan.keys[condition.name]) for condition in plan.todo]
    faults: dict[str, Fault] = {}
    done = _Counter(progress, "renders", len(tasks))
    for outcome in workers.each(_render, tasks) if tasks else ():
        if outcome.rendered is not None:
            store.save(outcome.key, outcome.rendered)
        if outcome.fault is not None:
            faults[outcome.key] = outcome.fault
        done()
    return faults


def _render(task: tuple[StimulusRenderer, Condition, str]) -> _Outcome:
    renderer, condition, key = task
    started = time.perf_counter()
    try:
        if content_key(renderer.identity(condition)) != key:
            reason = (
                "the worker would render something else: other bundle, plugins, version, instruction set, "
                "BLAS or other libraries"
            )
            return _Outcome(key, None, Fault(condition.name, reason))
        rendered = renderer.render(condition)
        _check(rendered)
    except TonewoodError as fault:
        return _Outcome(key, None, Fault(condition.name, str(fault)))
    except Exception as fault:  # an error of a plugin must not end the other renders; its traceback is kept
        reason = f"{type(fault).__name__}: {fault}"
        return _Outcome(key, None, Fault(condition.name, reason, traceback.format_exc()))
    info = {**rendered.info, "render_seconds": time.perf_counter() - started}
    return _Outcome(key, replace(rendered, info=info))


def _check(rendered: Rendered) -> None:
    if rendered.samples.ndim != 2 or not rendered.samples.size:
        raise NumericalError(f"a render of shape (n, channels) is wanted, not {rendered.samples.shape}")
    if not np.all(np.isfinite(rendered.samples)):
        first = int(np.argmin(np.isfinite(rendered.samples).all(axis=1)))
        raise NumericalError(f"the sound is not finite from {first / rendered.fs:.4f} s on")
    json.dumps(rendered.info, allow_nan=False)


def _complete(groups: Sequence[Group], there: set[str], manifest: Manifest) -> tuple[list[Group], list[str]]:
    """Groups without the trials that lack a sound, and notes on these.

    A page that is only to be heard goes on with the sounds it has.
    """
    kept, notes = [], []
    for group in groups:
        here = {s.code for s in group.stimuli} & there
        if isinstance(manifest.pages[group.page], HtmlPage):
            trials = tuple(replace(t, stimuli=tuple(c for c in t.stimuli if c in here)) for t in group.trials)
        else:
            trials = tuple(t for t in group.trials if set(t.codes) <= here)
            here &= {c for t in trials for c in t.codes}
            if lost := len(group.trials) - len(trials):
                notes.append(f"{group.name}: {lost} of {len(group.trials)} trials left out: a sound failed")
        if here:
            stimuli = tuple(s for s in group.stimuli if s.code in here)
            kept.append(replace(group, stimuli=stimuli, trials=trials))
    return kept, notes


def _write_records(
    plan: BatchPlan,
    groups: Sequence[Group],
    files: Sequence[SoundFile],
    renders: dict[str, dict[str, Any]],
    faults: Sequence[Fault],
    notes: Sequence[str],
    folder: Path,
    workers: Workers,
) -> None:
    manifest, formats = plan.manifest, plan.manifest.output.formats
    by_code = {f.code: f for f in files}
    conditions = {c.name: c for c in plan.conditions}
    _remove_strangers(folder, set(by_code))
    rows = records.file_records(files, conditions, plan.identities, renders)
    if "test" in formats:
        drops = {f.group: f.page_drop_db for f in files}
        made = definition.definition_of(manifest, groups, by_code, plan.source, drops)
        records.write_json(folder / definition.FILE, made)
    if "html" in formats:
        _draw_differences(groups, by_code, folder, workers)
        audition.write_audition(folder, manifest, groups, by_code, conditions)
    if "csv" in formats:
        records.write_csv(folder / records.RECORD_CSV, rows)
    if "json" in formats:
        record = records.batch_record(manifest, rows, faults, notes)
        if plan.room is not None:
            record["room_sha256"] = hashlib.sha256(plan.room.read_bytes()).hexdigest()
        records.write_json(folder / records.RECORD_JSON, record)
    records.write_json(folder / manifest.output.key, records.key_of(manifest, groups, conditions))


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


def _remove_strangers(folder: Path, codes: set[str]) -> None:
    """Remove sounds and pictures an earlier run made under codes that are no longer in use."""
    for place in (folder / SOUNDS, folder / PICTURES):
        for path in place.glob("*.*"):
            if _CODE_FILE.fullmatch(path.name) and path.stem not in codes:
                remove(path)


class _Counter:
    """Counts finished work and reports it."""

    def __init__(self, progress: Progress | None, stage: str, total: int):
        self.progress, self.stage, self.total, self.done = progress, stage, total, 0

    def __call__(self) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.stage, self.done, self.total)
