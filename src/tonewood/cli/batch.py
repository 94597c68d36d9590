"""``tonewood batch``: a manifest to a folder for listeners."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tonewood.cli import dataset
from tonewood.cli.common import Advance, AllowCode, Json, need, print_faults, print_json, progress, warn
from tonewood.errors import TonewoodError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tonewood.workshop.batch.plan import BatchPlan
    from tonewood.workshop.batch.runner import Report
    from tonewood.workshop.listening.power import PowerRow


def batch(
    manifest: Annotated[Path, typer.Argument(help="YAML file of instruments, scores, factors and pages")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder; an unfinished one is taken up again")],
    jobs: Annotated[int, typer.Option(help="workers on this machine; -1 for one per core")] = -1,
    workers: Annotated[str, typer.Option(help="processes or threads")] = "processes",
    cluster: Annotated[str | None, typer.Option(help="address of a Dask scheduler to render on")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="print the plan and the predicted time, do nothing")
    ] = False,
    pilot: Annotated[
        Path | None, typer.Option(help="folder with the answers of a pilot: --dry-run takes effects and spread of it")
    ] = None,
    exports: Annotated[
        list[str] | None,
        typer.Option("--export", help="write the test for webmushra, jspsych, psychopy, or as bids; repeatable"),
    ] = None,
    allow_code: AllowCode = False,
    as_json: Json = False,
) -> int:
    """Render all conditions of MANIFEST and write stimuli, pages, key and records; or a data set, in shards."""
    need("batch", "joblib", "pyloudnorm", "matplotlib")
    if cluster is not None:
        need("cluster", "dask", "distributed")
    from tonewood.support.yaml_io import load_yaml
    from tonewood.workshop.batch.manifest import ManifestError
    from tonewood.workshop.batch.rendering import EngineRenderer
    from tonewood.workshop.batch.runner import plan_batch, run_batch
    from tonewood.workshop.batch.workers import Workers
    from tonewood.workshop.exchange.export import check_programs, export
    from tonewood.workshop.listening.power import power_of
    from tonewood.workshop.listening.results import analyse

    if jobs == 0 or jobs < -1:
        raise TonewoodError(f"is {jobs}; 1 or more are allowed, or -1", key="--jobs")
    if workers not in ("processes", "threads"):
        raise TonewoodError(f"is {workers!r}; processes or threads are allowed", key="--workers")
    if pilot is not None and not dry_run:
        raise TonewoodError("belongs to --dry-run", key="--pilot")
    programs = exports or []
    check_programs(programs)
    if programs and dry_run:
        raise TonewoodError("writes files, --dry-run none", key="--export")
    pool = Workers(jobs, "threads" if workers == "threads" else "processes", cluster)
    data = load_yaml(manifest, error=ManifestError)
    if data.get("kind") == "dataset":
        if pilot is not None:
            raise TonewoodError("belongs to listening tests", key="--pilot")
        if programs:
            raise TonewoodError("belongs to listening tests", key="--export")
        if dry_run:
            return dataset.planned(data, manifest, output, allow_code, as_json, pool.count)
        with _Bars() as bars:
            return dataset.made(data, manifest, output, pool, allow_code, as_json, bars)
    if dry_run:
        plan = plan_batch(manifest, output, EngineRenderer(allow_code), pool, predict=True)
        power = power_of(plan.manifest, plan.trials_of_a_pair(), None if pilot is None else analyse(pilot))
        if as_json:
            rows = [vars(row) for row in power]
            print_json("batch-plan", {**plan.summary(), "power": rows}, ok=not plan.faults)
        else:
            _print_plan(plan)
            _print_power(plan, power)
        return 1 if plan.faults else 0
    with _Bars() as bars:
        try:
            report = run_batch(manifest, output, EngineRenderer(allow_code), pool, bars)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("finished renders are kept, run it again to go on") from None
    exported = export(output, programs) if programs else []
    if as_json:
        places = [{"folder": str(one.folder), "notes": list(one.notes)} for one in exported]
        print_json("batch-report", {**report.summary(), "exports": places}, ok=report.ok)
    else:
        _print_report(report)
        for one in exported:
            print(one.folder)
            warn(list(one.notes))
    return 0 if report.ok else 1


#: s between two lines of progress in a log
_LOG_EVERY = 15.0


class _Bars(ExitStack):
    """One progress bar after another, a stage each; where there is no terminal, lines for a log.

    clock : time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.stage = ""
        self.advance: Advance | None = None
        self.clock = clock
        self.began = self.last_line = clock()
        self.logs = not sys.stderr.isatty()

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self.logs:
            self._log(stage, done, total)
            return
        if stage != self.stage:
            self.pop_all().close()
            self.stage, self.advance = stage, self.enter_context(progress(f"{stage} ({total})", total))
        if self.advance is not None:
            self.advance(done)

    def _log(self, stage: str, done: int, total: int) -> None:
        """Print a line at most every `_LOG_EVERY` seconds, and one at the end of a stage that took longer."""
        now = self.clock()
        if stage != self.stage:
            self.stage, self.began, self.last_line = stage, now, now
        ends = done == total and self.last_line > self.began
        if now - self.last_line < _LOG_EVERY and not ends:
            return
        self.last_line = now
        left = (now - self.began) * (total - done) / max(done, 1)
        rest = f"{now - self.began:.0f} s" if ends else f"about {left:.0f} s to go"
        print(
            f"tonewood: {stage}: {done} of {total} ({100 * done / max(total, 1):.0f} %), {rest}",
            file=sys.stderr,
            flush=True,
        )


def _print_plan(plan: BatchPlan) -> None:
    for condition in plan.conditions:
        print(condition.name)
    summary = plan.summary()
    print(
        f"{len(plan.conditions)} conditions: {summary['to_render']} to render, {summary['rendered']} rendered; "
        f"{summary['files']} files, {summary['trials']} trials; about {summary['predicted_seconds']:.0f} s"
    )
    _print_rest(plan)


def _print_power(plan: BatchPlan, power: Sequence[PowerRow]) -> None:
    if power:
        asked = plan.manifest.power
        print(f"for a power of {asked.power:g} at alpha {asked.alpha:g}:")
        for row in power:
            print(f"  {row}")


def _print_report(report: Report) -> None:
    print(
        f"{report.folder}: {len(report.files)} files from {report.rendered} new and {report.reused} earlier renders, "
        f"{report.seconds:.1f} s"
    )
    _print_rest(report)


def _print_rest(overview: BatchPlan | Report) -> None:
    warn(list(overview.notes))
    print_faults(overview.faults, "conditions")
