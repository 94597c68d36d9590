"""The C++ kernel behind the same interface as `stepper.NumpyStepper`.

The instruction set is chosen when the module is imported: the widest this machine has, or the one named by the
environment variable ``TONEWOOD_ISA``. Results are bit-identical for one instruction set, however a run is cut.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood import _kernel
from tonewood.errors import NumericalError, TonewoodError
from tonewood.numerics.connections import SpringDashpot
from tonewood.numerics.system import Compiled, Injection, State, System

Floats = NDArray[np.float64]


def instruction_set() -> str:
    """Name of the instruction set in use: avx512, avx2 or baseline."""
    available: list[str] = _kernel.instruction_sets()
    wanted = os.environ.get("TONEWOOD_ISA", "auto")
    if wanted == "auto":
        return available[0]
    if wanted not in available:
        raise TonewoodError(f"TONEWOOD_ISA={wanted}: this machine has auto, {', '.join(available)}")
    return wanted


class KernelStepper:
    """Steps a `System` in C++.

    Parameters
    ----------
    system : what to step.
    precision : ``f64`` or ``f32`` (states and coefficients; forces are solved for in double).
    isa : instruction set, by default `instruction_set()`.
    """

    def __init__(self, system: System, *, precision: str = "f64", isa: str | None = None):
        if precision not in ("f64", "f32"):
            raise ValueError(f"precision is f64 or f32, not {precision!r}")
        make = _kernel.KernelF64 if precision == "f64" else _kernel.KernelF32
        self.dtype: type[np.floating] = np.float64 if precision == "f64" else np.float32
        self._kernel = make(isa or instruction_set(), len(system.names), sum(system.capacities), len(system.readouts))
        self._packed: dict[int, tuple[Injection, NDArray[np.floating], Floats]] = {}
        self._loaded: list[tuple[Compiled, bytes] | None] = [None] * len(system.names)
        self.system = system
        self._load(system)

    def exchange(self, system: System) -> None:
        """Go on with a changed system: same components and connections, other bases or laws."""
        self.system = system
        self._load(system)

    def _load(self, system: System) -> None:
        idle = np.array([_idle(c.law) for c in system.connections], dtype=bool)
        self._active = np.flatnonzero(~idle)
        for slot, (compiled, one_way) in enumerate(zip(system.compiled, system.driven, strict=True)):
            incidence = system.incidence(slot)[self._active]
            wired = np.nonzero(incidence)
            key = b"".join(part.tobytes() for part in (*wired, incidence[wired]))
            if (known := self._loaded[slot]) and known[0] is compiled and known[1] == key:
                continue
            self._loaded[slot] = (compiled, key)
            p = len(compiled.ports)
            used = np.any(incidence != 0.0, axis=0)
            # nobody asks for the motion of a driven component's ports
            ports_read = np.zeros(p, dtype=bool) if one_way else used
            keep = np.concatenate([ports_read, np.ones(len(compiled.rows) - p, dtype=bool)])
            rows = compiled.rows[keep]
            E = compiled.E if self.dtype is np.float64 else _rounded_inward(compiled.E)
            self._kernel.set_component(
                slot,
                system.offsets[slot],
                one_way,
                _pack(E.reshape(-1, 4)[None])[0],
                _pack(rows),
                _pack(compiled.W[used]),
                np.ascontiguousarray(compiled.history[:, used][:, :, keep]),
                np.ascontiguousarray(incidence[:, used]),
                compiled.readouts.tolist(),
                compiled.difference.astype(int).tolist(),
            )
        s = system.solve
        on = self._active
        self._kernel.set_solve(
            np.ascontiguousarray(s.G[np.ix_(on, on)]),
            s.gamma[on],
            s.constant[on],
            np.ascontiguousarray(system.force_weights()[:, on]),
        )

    def run(self, state: State, n: int, injections: Sequence[Injection] = ()) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps; see `NumpyStepper.run`."""
        if state.modes.dtype != self.dtype:
            raise ValueError(f"a state of {state.modes.dtype} does not fit a kernel of {np.dtype(self.dtype)}")
        out = np.empty((n, len(self.system.readouts)))
        active_forces = np.empty((n, len(self._active)))
        active = [i for i in injections if i.start < state.sample + n and i.stop > state.sample]
        slot, sample = self._kernel.run(
            state.modes, out, active_forces, [self._pack_injection(i, state) for i in active]
        )
        if slot >= 0:
            t = (state.sample + sample) * self.system.dt
            raise NumericalError(f"{self.system.names[slot]} is no longer finite at {t:.6f} s")
        forces = np.zeros((n, len(self.system.connections)))
        forces[:, self._active] = active_forces
        if n:
            state.forces[:] = forces[-1]
        state.sample += n
        return out, forces

    def start(self) -> State:
        """Return the state of rest in this kernel's precision."""
        rest = self.system.start()
        return State(rest.modes.astype(self.dtype), rest.forces)

    def _pack_injection(self, injection: Injection, state: State) -> tuple[int, int, NDArray[np.floating], Floats]:
        known = self._packed.get(id(injection))
        if known is None or known[0] is not injection:
            for key in [k for k, v in self._packed.items() if v[0].stop <= state.sample]:
                del self._packed[key]
            vectors = _pack(injection.vectors).astype(self.dtype)
            known = (injection, vectors, np.ascontiguousarray(injection.values))
            self._packed[id(injection)] = known
        return self.system.slot(injection.component), injection.start - state.sample, known[1], known[2]


def _idle(law: object) -> bool:
    return isinstance(law, SpringDashpot) and law.stiffness == 0.0 and law.damping == 0.0


def _pack(a: Floats) -> Floats:
    """(k, n_modes, c) -> (k, c, padded n_modes), zeros in the padding."""
    k, n, c = a.shape
    width = -(-max(n, 1) // _kernel.PADDING) * _kernel.PADDING
    out = np.zeros((k, c, width))
    out[:, :, :n] = a.transpose(0, 2, 1)
    return out


def _rounded_inward(E: Floats) -> Floats:
    """Propagators whose single-precision rounding never turns faster than it should decay: |E32| <= |E|.

    Rounded to nearest, |E| of an undamped mode can come out above 1 and the mode would grow.
    """
    E32 = E.astype(np.float32).astype(np.float64)
    exact = E[:, 0, 0] * E[:, 1, 1] - E[:, 0, 1] * E[:, 1, 0]
    for _ in range(4):
        rounded = E32[:, 0, 0] * E32[:, 1, 1] - E32[:, 0, 1] * E32[:, 1, 0]
        high = rounded > exact
        if not high.any():
            break
        E32[high] = np.nextafter(E32[high].astype(np.float32), np.float32(0)).astype(np.float64)
    return E32
