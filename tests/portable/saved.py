"""Assembled systems in files that a program without Python can read, with the samples that they should give.

A file holds named arrays: first the line ``tonewood-arrays/1``, then for each array a line ``name type n0 n1 ...``
(type ``f8`` or ``i8``, sizes in decimal; none for a single number) and right after its newline the numbers,
little-endian, 8 bytes each, the last index fastest. `saved.hpp` reads it.

Names are the paths of `KernelStepper.describe`, ``components/0/e``; beside these stand ``capacity``, known forces as
``injections/i/0`` to ``3`` (slot, first step, vectors, values) and ``samples`` (n, channels).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.system import Injection, System
from tonewood.stepping.kernel import KernelStepper

MAGIC = b"tonewood-arrays/1\n"
Arrays = dict[str, NDArray[Any]]


def write(path: Path, arrays: Arrays) -> None:
    with path.open("wb") as stream:
        stream.write(MAGIC)
        for name, values in arrays.items():
            kind = "f8" if values.dtype.kind == "f" else "i8"
            stream.write(" ".join([name, kind, *map(str, values.shape)]).encode() + b"\n")
            stream.write(values.astype(f"<{kind}").tobytes())


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


def flat(value: Any, path: str = "") -> Arrays:
    """Arrays and numbers in nested mappings and sequences, by their paths; lists of numbers are arrays."""
    if isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, Sequence) and not (
        isinstance(value, list) and all(isinstance(x, int | float) for x in value)
    ):
        entries = enumerate(value)
    else:
        return {path: np.asarray(value, dtype=int if isinstance(value, list) and not value else None)}
    return {k: a for key, inner in entries for k, a in flat(inner, f"{path}/{key}" if path else str(key)).items()}


def record(system: System, n: int, injections: Sequence[Injection]) -> Arrays:
    """Description of `system` for the kernel, and the n samples that it gives from rest (in the baseline set)."""
    stepper = KernelStepper(system, isa="baseline")
    state = stepper.start()
    description = stepper.describe()
    if description["nonlinear"]["functions"]:
        raise ValueError("a law that is a function in memory cannot be saved")
    description["capacity"] = state.modes.shape[1]
    description["injections"] = [stepper._pack_injection(injection, state) for injection in injections]
    description["samples"] = stepper.run(state, n, injections)[0]
    return flat(description)
