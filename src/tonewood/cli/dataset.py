"""``tonewood batch`` for a manifest of kind ``dataset``: plan, run, and printed summary."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tonewood.cli.common import need, print_faults, print_json, warn
from tonewood.support.units import counted

if TYPE_CHECKING:
    from tonewood.workshop.batch.runner import Progress
    from tonewood.workshop.batch.workers import Workers
    from tonewood.workshop.dataset.runner import DatasetPlan, DatasetReport

#: notes that are printed
_MOST_NOTES = 20


def planned(data: dict[str, Any], manifest: Path, output: Path, allow_code: bool, as_json: bool, cores: int = 1) -> int:
    """Print how much there is to do, and how long it will take. Raises TonewoodError : the manifest cannot be used."""
    need("dataset", "pyarrow")
    from tonewood.workshop.batch.rendering import EngineRenderer
    from tonewood.workshop.dataset.manifest import check_dataset
    from tonewood.workshop.dataset.runner import plan_dataset

    dataset = check_dataset(data, file=manifest)
    plan = plan_dataset(dataset, manifest.parent, output, EngineRenderer(allow_code), predict=True)
    if as_json:
        print_json("dataset-plan", plan.summary(), ok=not plan.faults)
    else:
        _print_plan(plan, cores)
    return 1 if plan.faults else 0


def made(
    data: dict[str, Any],
    manifest: Path,
    output: Path,
    workers: Workers,
    allow_code: bool,
    as_json: bool,
    bars: Progress,
) -> int:
    """Make the data set; returns the exit code.

    Raises TonewoodError : the manifest cannot be used, or the disk is full.
    """
    need("dataset", "pyarrow")
    from tonewood.workshop.batch.rendering import EngineRenderer
    from tonewood.workshop.dataset.manifest import check_dataset
    from tonewood.workshop.dataset.runner import run_dataset

    dataset = check_dataset(data, file=manifest)
    report = run_dataset(dataset, manifest.parent, output, EngineRenderer(allow_code), workers, bars)
    print_json("dataset-report", report.summary(), ok=report.ok) if as_json else _print_report(report)
    return 0 if report.ok else 1


def _print_plan(plan: DatasetPlan, cores: int) -> None:
    print(f"{len(plan.samples)} sounds in {len(plan.keys)} shards, {len(plan.tasks)} of them to make")
    if plan.sound_seconds is not None and plan.compute_seconds is not None:
        share = len(plan.tasks) / max(len(plan.keys), 1)
        print(
            f"about {plan.sound_seconds / 3600:.3g} hours of sound, {plan.hours_per_core_hour:.3g} hours of sound per "
            f"core-hour; about {share * plan.compute_seconds / cores:.0f} s to go on {cores} cores"
        )
    print_faults(plan.faults, "sounds")


def _print_report(report: DatasetReport) -> None:
    print(
        f"{report.folder}: {report.sounds} sounds, {report.sound_seconds / 3600:.3g} hours, in {report.made} new and "
        f"{report.reused} earlier shards, {report.seconds:.1f} s; SHA-256 of all samples {report.sha256[:16]}"
    )
    warn(list(report.notes[:_MOST_NOTES]))
    if (more := len(report.notes) - _MOST_NOTES) > 0:
        warn([f"{counted(more, 'more note')}: --json has all"])
    print_faults(report.faults, "sounds")
