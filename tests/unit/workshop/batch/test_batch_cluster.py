from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import batch_fakes as fakes
import pytest
from batch_fakes import FakeRenderer

from tonewood.workshop.batch.runner import run_batch
from tonewood.workshop.batch.workers import Workers

distributed = pytest.importorskip("distributed")


@pytest.mark.validate
def test_a_cluster_that_loses_a_worker_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))  # workers are processes of their own
    levels = {f"l{i}": 0.1 + 0.01 * i for i in range(24)}
    page = {"type": "mushra", "group_by": ["score"], "reference": {"damping": "l0"}, "strict": False}
    data = fakes.manifest(
        scores={"low": fakes.BASE["scores"]["low"]},
        factors={"damping": {"path": "body.t60", "levels": levels}},
        pages=[page],
        output={"formats": ["json"]},
    )
    path, killed = fakes.write(tmp_path, data), []
    with (
        distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None, local_directory=tmp_path
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))

        def kill_one(stage: str, done: int, total: int) -> None:
            if (stage, done) == ("renders", 4):
                os.kill(victim, signal.SIGKILL)
                killed.append(victim)

        workers = Workers(cluster=cluster.scheduler_address)
        report = run_batch(path, tmp_path / "many", FakeRenderer(sleep=0.05), workers, kill_one)
    assert killed
    assert report.ok
    assert report.rendered == 24
    alone = run_batch(path, tmp_path / "alone", FakeRenderer())
    assert [f.sha256 for f in report.files] == [f.sha256 for f in alone.files]
