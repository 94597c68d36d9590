"""Stimuli per second of `tonewood batch`, and how much of the cores it uses.

    python benchmarks/batch_throughput.py --notes 1000 --jobs 2 --workers processes
    python benchmarks/batch_throughput.py --notes 10000 --jobs 2 --dask --formats json

Renders notes of two seconds on the classical guitar, once each, from manifest to files and pages; `--dask` renders on a
cluster of so many processes of this machine. Core efficiency is the processor time of rendering and file making, summed
over all workers, divided by jobs times wall time. The rates of the tenths of the renders show whether a stimulus costs
more the more came before.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import psutil

from tonewood.workshop.batch.rendering import EngineRenderer
from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.workers import Workers


def manifest(notes: int, formats: list[str]) -> dict:
    """So many notes: pitches of the guitar, each at several places."""
    pitches = min(notes, 40)
    places = {f"p{i}": round(0.05 + 0.1 * i / (notes / pitches), 5) for i in range(-(-notes // pitches))}
    return {
        "schema": "tonewood-batch/1",
        "name": "throughput",
        "seed": 1,
        "instruments": {"guitar": "classical_guitar"},
        "scores": {f"n{40 + m}": {"phrase": [{"time": 0, "duration": 2, "note": 40 + m}]} for m in range(pitches)},
        "factors": {"place": {"path": "exciters.pluck.from_bridge", "levels": places}},
        "render": {"tail": {"energy_db": -200, "cap": 0.01}},
        "stimuli": {"duration": 2.0},
        "pages": [{"type": "html"}],
        "output": {"formats": formats},
    }


def resident(process: psutil.Process) -> float:
    """Resident memory, MB; 0 of a process that has ended."""
    with contextlib.suppress(psutil.Error):
        return float(process.memory_info().rss) / 2**20
    return 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--notes", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--workers", choices=["processes", "threads"], default="processes")
    parser.add_argument("--dask", action="store_true")
    parser.add_argument("--formats", nargs="*", default=["test", "html", "csv", "json"])
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "batch.yaml"
        path.write_text(json.dumps(manifest(given.notes, given.formats)))
        stages: dict[str, list[float]] = {}
        times: list[float] = []
        peaks = [0.0, 0.0]  # MB: of a worker, and the time at which it was looked at last
        began = time.perf_counter()

        def mark(stage: str, done: int, total: int) -> None:
            now = time.perf_counter() - began
            if now > peaks[1] + 1.0:  # a forked child's own peak would begin with its parent's
                workers_now = psutil.Process().children(recursive=True)
                peaks[:] = max([peaks[0], *(resident(p) for p in workers_now)]), now
            stages.setdefault(stage, [now, now])[1] = now
            if stage == "renders":
                times.append(now)

        with contextlib.ExitStack() as stack:
            address = None
            if given.dask:
                from distributed import LocalCluster

                options = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
                address = stack.enter_context(LocalCluster(given.jobs, **options)).scheduler_address
                began = time.perf_counter()
            workers = Workers(given.jobs, given.workers, address)
            report = run_batch(path, Path(folder) / "out", EngineRenderer(), workers, mark)
            wall = time.perf_counter() - began
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True)  # only ended children are counted below
    used = sum(
        usage.ru_utime + usage.ru_stime
        for usage in (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    )
    print(f"{len(report.files)} stimuli, {given.jobs} {given.workers}: {wall:.1f} s, {len(report.files) / wall:.2f} /s")
    tenths = [times[i * (len(times) - 1) // 10] for i in range(11)]
    rates = [(len(times) - 1) / 10 / (b - a) for a, b in itertools.pairwise(tenths)]
    print("renders per second, by tenths: " + ", ".join(f"{rate:.1f}" for rate in rates))
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory: this process {own:.0f} MB, largest worker {peaks[0]:.0f} MB")
    print("until the end of each stage, s: " + ", ".join(f"{k} {v[1]:.1f}" for k, v in stages.items()))
    print(f"core efficiency {used / wall / given.jobs:.3f} (processor time {used:.1f} s)")


if __name__ == "__main__":
    main()
