"""Assembled systems in files that a program without Python can read, with the samples that they should give.

A file holds named arrays: first the line ``tonewood-arrays/1``, then for each array a line ``name type n0 n1 ...``
(type ``f8`` or ``i8``, sizes in decimal) and right after its newline the numbers, little-endian, 8 bytes each, the last
index fastest. `saved.hpp` reads it. Names are those of the arguments of `_kernel.Kernel`'s methods, of which `record`
keeps one call each; a known force is ``injection/i`` (slot, first step) with ``vectors`` and ``values``; ``samples``
are (n, channels).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonewood import _kernel
from tonewood.coupling.system import Injection, System
from tonewood.stepping.kernel import KernelStepper

MAGIC = b"tonewood-arrays/1\n"
Arrays = dict[str, NDArray[Any]]

COMPONENT = ("e", "rows", "w", "history", "incidence", "channels", "difference")
GUARDED = ("e", "rows", "w", "from_fixed", "from_guarded", "on_rows")
STRETCHED = ("a", "half", "reading", "kick", "e")
GEOMETRIC = ("slopes", "reading", "yields", "kick", "to_port", "from_port")
SOLVE = ("g", "gamma", "constant", "weights")
GAPS = ("compliance", "from_linear", "to_linear", "residual")


def write(path: Path, arrays: Arrays) -> None:
    with path.open("wb") as stream:
        stream.write(MAGIC)
        for name, values in arrays.items():
            kind = "f8" if values.dtype.kind == "f" else "i8"
            stream.write(" ".join([name, kind, *map(str, values.shape)]).encode() + b"\n")
            stream.write(np.ascontiguousarray(values, dtype=f"<{kind}").tobytes())


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


class _Recorder:
    """Takes the calls that load a kernel, and keeps what they bring."""

    def __init__(self, isa: str, n_components: int, capacity: int, n_channels: int):
        self.arrays: Arrays = {"kernel": np.array([n_components, capacity, n_channels])}

    def _keep(self, prefix: str, names: Sequence[str], values: Sequence[Any]) -> None:
        self.arrays |= {f"{prefix}/{name}": _array(value) for name, value in zip(names, values, strict=True)}

    def take_back(self, slot: int, number: int) -> bool:
        return False

    def statistics(self) -> list[int]:
        return [0] * 11

    def set_component(self, slot: int, offset: int, driven: bool, *arrays: Any) -> None:
        self.arrays[f"component/{slot}/numbers"] = np.array([offset, driven], dtype=int)
        self._keep(f"component/{slot}", COMPONENT, arrays)

    def set_guarded(self, slot: int, *arrays: Any) -> None:
        self._keep(f"guarded/{slot}", GUARDED, arrays)

    def set_stretched(self, slot: int, *arrays: Any) -> None:
        self._keep(f"stretched/{slot}", STRETCHED, arrays)

    def set_geometric(self, strings: Any) -> None:
        for t, (scale, along, parts) in enumerate(strings):
            self.arrays[f"geometric/{t}"] = np.array([scale, along, *(part[0] for part in parts)], dtype=float)
            for p, part in enumerate(parts):
                self._keep(f"geometric/{t}/{p}", GEOMETRIC, part[1:])

    def set_solve(self, *arrays: Any) -> None:
        self._keep("solve", SOLVE, arrays)

    def set_nonlinear(self, k: int, terms: Any, dt: float, theta: float, guarded: bool, weights: Any) -> None:
        numbers = np.array([k, dt, theta, guarded], dtype=float)
        self._keep("nonlinear", ("numbers", "terms", "weights"), (numbers, np.array(terms).reshape(-1, 5), weights))

    def set_laws(self, laws: Any) -> None:
        for j, (kind, numbers, knots, coefficients, functions) in laws:
            if functions:
                raise ValueError("a law that is a function in memory cannot be saved")
            self.arrays[f"law/{j}"] = np.array([kind, *numbers], dtype=float)
            self._keep(f"law/{j}", ("knots", "coefficients"), (np.array(knots), np.array(coefficients)))

    def set_gaps(self, *arrays: Any) -> None:
        self._keep("gaps", GAPS, arrays)

    def set_tensions(self, strings: Any, matrix: Any, offset: Any) -> None:
        self._keep("tensions", ("matrix", "offset"), (matrix, offset))
        for t, (index, kappa, components) in enumerate(strings):
            self.arrays[f"tension/{t}"] = np.array([index, kappa])
            self.arrays[f"tension/{t}/components"] = np.array(components, dtype=int)


def _array(value: Any) -> NDArray[Any]:
    return value if isinstance(value, np.ndarray) else np.array(value, dtype=int)


def record(system: System, n: int, injections: Sequence[Injection]) -> Arrays:
    """What a kernel is given to step `system` from rest, and the n samples that it gives (in the baseline set)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_kernel, "Kernel", _Recorder)
        recorder: Any = KernelStepper(system)
    out: Arrays = recorder._kernel.arrays
    out["kernel"] = np.append(out["kernel"], len(system.tensions))
    stepper = KernelStepper(system, isa="baseline")
    state = stepper.start()
    for i, injection in enumerate(injections):
        slot, start, vectors, values = stepper._pack_injection(injection, state)
        out |= {
            f"injection/{i}": np.array([slot, start]),
            f"injection/{i}/vectors": vectors,
            f"injection/{i}/values": values,
        }
    out["samples"] = stepper.run(state, n, injections)[0]
    return out
