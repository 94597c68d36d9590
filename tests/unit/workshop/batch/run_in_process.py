"""Run a batch with the fake renderer in a process of its own, to be killed from outside."""

from __future__ import annotations

import sys
from pathlib import Path

from batch_fakes import FakeRenderer

from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.workers import Workers

if __name__ == "__main__":
    manifest, folder, jobs, *never = sys.argv[1:]
    run_batch(Path(manifest), Path(folder), FakeRenderer(never=tuple(never)), Workers(int(jobs), "threads"))
