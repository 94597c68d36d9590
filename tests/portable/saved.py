"""Assembled systems in files, with the samples that they should give: beside the arrays of
`tonewood.sound.render.model_file` stand known forces as ``injections/i/0`` to ``3`` (slot, first step, vectors,
values) and ``samples`` (n, channels).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tonewood.physics.coupling.system import Injection, System
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.sound.render.model_file import MAGIC, Arrays, flat, recorded


def read(path: Path) -> Arrays:
    out: Arrays = {}
    with path.open("rb") as stream:
        assert stream.readline() == MAGIC
        while line := stream.readline():
            name, kind, *shape = line.decode().split()
            sizes = tuple(map(int, shape))
            data = stream.read(8 * int(np.prod(sizes, dtype=int)))
            out[name] = np.frombuffer(data, dtype=f"<{kind}").reshape(sizes).astype(kind)
    return out


def record(system: System, n: int, injections: Sequence[Injection]) -> Arrays:
    """Description of `system` for the kernel, and the n samples that it gives from rest (in the baseline set)."""
    stepper = KernelStepper(system, isa="baseline")
    state = stepper.start()
    packed = stepper.pack_injections(injections, state.sample)
    more = {"injections": packed, "samples": stepper.run(state, n, injections)[0]}
    return recorded(system, isa="baseline") | flat(more)
