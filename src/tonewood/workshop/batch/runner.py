"""Runs a batch: renders the missing conditions, then writes files, pages and records.

An interrupted run (a kill, a full disk) is continued by running it again: renders are stored under the hash of
everything that decides their samples, and a render is either complete or absent. A condition that fails is reported,
and the others are rendered; pages and pairs without one of their sounds are left out.
"""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tonewood.errors import NumericalError, OutputError, TonewoodError, together
from tonewood.support.folder_lock import locked
from tonewood.workshop.batch import definition
from tonewood.workshop.batch.conditions import Condition, expand
from tonewood.workshop.batch.layout import Group, lay_out
from tonewood.workshop.batch.manifest import Manifest, ManifestError, load_manifest
from tonewood.workshop.batch.outputs import write_outputs
from tonewood.workshop.batch.pages import HtmlPage
from tonewood.workshop.batch.plan import BatchPlan, StimulusRenderer
from tonewood.workshop.batch.production import (
    Fault,
    SoundFile,
    level_faults,
    make_files,
    room_response,
    trial_of_a_file,
)
from tonewood.workshop.batch.stimuli import StimulusError
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.batch.workers import Workers

WORK = "work"
Progress = Callable[[str, int, int], None]
T = TypeVar("T")


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

    predict : predict the time too, for which the renderer may try itself.
    Raises TonewoodError : the manifest cannot be used, or no condition can be resolved.
    """
    manifest = load_manifest(manifest_path)
    conditions, groups, notes, levels = _laid_out(manifest, manifest_path, renderer)
    every = (*conditions, *(level.condition for level in levels))
    identified, faults = _each_of(every, renderer.identity)
    keys = {name: content_key(identity) for name, identity in identified.items()}
    if not keys:  # a misspelt path of a factor: one line, however many conditions have it
        raise ManifestError(f"no condition can be resolved: {faults[0].reason}", file=manifest_path)
    store = Store(folder / WORK)
    try:
        new = [level for level in levels if not store.has(keys.get(level.condition.name, ""))]
        definition.check_rendering(new, renderer.render)
    except ManifestError as fault:
        raise ManifestError(fault.reason, file=manifest_path, key=fault.key) from None
    first = {keys[c.name]: c for c in reversed(every) if c.name in keys}
    missing = [first[key] for key in dict.fromkeys(keys[c.name] for c in every if c.name in keys) if not store.has(key)]
    # one instrument after the other: workers keep the models that they used last
    todo = tuple(sorted(missing, key=lambda c: json.dumps([c.bundle, c.overrides], default=str)))
    if todo and (unused := store.others(set(keys.values()))):
        notes.append(
            f"{unused} renders in {store.folder} are not used: they were made of something else (parameters, scores, "
            "version, instruction set, BLAS or other libraries)"
        )
    seconds = None
    if predict:
        file, start = trial_of_a_file(manifest.stimuli, pictures=manifest.output.pictures)
        predicted, unpredicted = _each_of(todo, renderer.predict)
        seconds = file * sum(len(g.stimuli) for g in groups) + sum(predicted.values())
        faults += unpredicted
        if workers is not None and workers.count > 1:
            seconds = seconds / workers.count + (start if workers.backend == "processes" else 0.0)
    identities = {keys[name]: identity for name, identity in identified.items()}
    plan = BatchPlan(
        manifest, manifest_path.parent, conditions, tuple(levels), groups, keys, identities, todo, seconds,
        tuple(faults), tuple(notes),
    )  # fmt: skip
    _check_answers(plan, folder)
    return plan


def _each_of(conditions: Sequence[Condition], call: Callable[[Condition], T]) -> tuple[dict[str, T], list[Fault]]:
    """Results of a call by the condition's name, and a fault for each condition that it refused."""
    results: dict[str, T] = {}
    faults: list[Fault] = []
    for condition in conditions:
        try:
            results[condition.name] = call(condition)
        except TonewoodError as fault:
            faults.append(Fault(condition.name, str(fault)))
    return results, faults


def _laid_out(
    manifest: Manifest, path: Path, renderer: StimulusRenderer
) -> tuple[tuple[Condition, ...], tuple[Group, ...], list[str], list[definition.StaircaseLevel]]:
    """Conditions, groups, notes and levels of staircases; raises all faults of them together."""
    faults: list[TonewoodError] = []

    def kept(function: Callable[[], Any]) -> Any:
        try:
            return function()
        except ManifestError as fault:
            faults.append(fault)

    settings = manifest.stimuli
    conditions = kept(lambda: expand(manifest, path.parent))
    if conditions is not None:
        laid = kept(lambda: lay_out(manifest, conditions))
        levels = kept(lambda: definition.staircase_levels(manifest, path.parent, renderer.own_value))
    if settings.room is not None:
        try:
            room_response(path.parent / settings.room, settings)
        except StimulusError as fault:
            faults.append(ManifestError(f"{settings.room}: {fault.reason}", key="stimuli.room"))
    if faults:
        raise together(faults, file=path)
    return conditions, *laid, levels


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

    folder : made if need be; of it, listeners get sounds only, by `tonewood serve`.
    workers : where the work is done; rendering may go to a cluster, files are made here.
    Raises TonewoodError
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
        pictures=manifest.output.pictures,
        advance=_Counter(progress, "files", 2 * sum(len(g.stimuli) for g in groups)),
    )
    groups, lost_too = _complete(groups, {f.code for f in files}, manifest)
    heard = {s.code for g in groups for s in g.stimuli}
    files = [f for f in files if f.code in heard]
    unrendered = [Fault(name, f.reason, f.detail) for name, key in plan.keys.items() if (f := failed.get(key))]
    levels = {f"{x.condition.name} ({ManifestError.shown_key(x.key)})": keys.get(x.condition.name) for x in plan.levels}
    faults = (*plan.faults, *unrendered, *silent, *level_faults(levels, store, manifest.stimuli, plan.room))
    notes = (*plan.notes, *lost, *lowered, *lost_too)
    write_outputs(plan, groups, files, renders, faults, notes, folder, workers.local())
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


class _Counter:
    """Counts finished work and reports it."""

    def __init__(self, progress: Progress | None, stage: str, total: int):
        self.progress, self.stage, self.total, self.done = progress, stage, total, 0

    def __call__(self) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.stage, self.done, self.total)
