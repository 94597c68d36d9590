"""How long computing takes, on a machine that others use too: CPU time of one thread, taken in turns."""

from __future__ import annotations

import gc
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tonewood import _kernel
from tonewood.physics.stepping.kernel import instruction_set

#: takes the share of a study that is done
Tell = Callable[[float], None]


def silent(share: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds of computing per second of sound.

    median, low, high : of the repeats; low and high are the 10th and 90th percentile.
    repeats : how many.
    """

    median: float
    low: float
    high: float
    repeats: int


@dataclass(frozen=True, slots=True)
class Task:
    """Something to time: `run` makes `sound` seconds of sound; `prepare` is called before, untimed."""

    run: Callable[[], object]
    sound: float
    prepare: Callable[[], object] | None = None


def measure(tasks: Sequence[Task], repeats: int, tell: Tell = silent) -> list[Timing]:
    """Time every task `repeats` times, all in turn, so that a slow spell of the machine hits all alike.

    tell : called with the share that is done, 0 to 1.
    """
    spent: list[list[float]] = [[] for _ in tasks]
    for task in tasks:
        _once(task)
    collecting = gc.isenabled()
    gc.disable()
    try:
        for done in range(1, repeats + 1):
            for times, task in zip(spent, tasks, strict=True):
                times.append(_once(task))
            tell(done / repeats)
    finally:
        if collecting:
            gc.enable()
    return [
        Timing(float(np.median(times)), float(np.quantile(times, 0.1)), float(np.quantile(times, 0.9)), repeats)
        for times in spent
    ]


def _once(task: Task) -> float:
    if task.prepare is not None:
        task.prepare()
    began = time.thread_time()
    task.run()
    return (time.thread_time() - began) / task.sound


def machine() -> dict[str, object]:
    """Name of the processor, instruction set in use, measured peak of multiply-adds (1/s, one core, f64)."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    isa = instruction_set()
    return {
        "processor": name,
        "system": f"{platform.system()} {platform.machine()}",
        "instruction_set": isa,
        "fma_peak": _kernel.fma_peak(isa, 0.1),
    }
