"""The linear step: modes x ports x instruction set."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from tonewood import _kernel
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

FS, BODY_MODES = 48000.0, 64


def instrument(n_modes: int, n_ports: int) -> System:
    """Strings of sines, each joined to a body of 64 modes at a point of its own; heard at the first."""
    rng = np.random.default_rng(1)
    per_string = (n_modes - BODY_MODES) // n_ports
    omega = np.sort(2 * np.pi * rng.uniform(80.0, 8000.0, BODY_MODES))
    points = {f"p{i}": rng.standard_normal(BODY_MODES) for i in range(n_ports)}
    components = {"body": ModalBasis.real(omega, 0.01 * omega, points)}
    joints = []
    for i in range(n_ports):
        omega = np.linspace(2 * np.pi * (80.0 + 10 * i), 2 * np.pi * 20000.0, per_string)
        components[f"s{i}"] = ModalBasis.real(omega, 1.0 + 1e-4 * omega, {"end": rng.standard_normal(per_string)})
        joints.append(Connection(f"j{i}", (Term(f"s{i}", "end"), Term("body", f"p{i}", -1.0))))
    return System.build(components, joints, [Readout("out", "velocity", (Term("body", "p0"),))], dt=1 / FS)


def multiply_adds(n_modes: int, n_ports: int) -> int:
    """That the equations need per sample: a rotation, and a row and a column per port and readout of each mode."""
    per_string = (n_modes - BODY_MODES) // n_ports
    return n_ports * per_string * (4 + 2 + 2) + BODY_MODES * (4 + 4 * n_ports + 2)


@cache
def peak(isa: str) -> float:
    return max(_kernel.fma_peak(isa, 0.05) for _ in range(5))


@pytest.mark.parametrize("isa", _kernel.instruction_sets())
@pytest.mark.parametrize("n_ports", [1, 6, 12])
@pytest.mark.parametrize("n_modes", [256, 1536, 12288])
def test_linear_step(benchmark: Any, tell: Callable[[str], None], n_modes: int, n_ports: int, isa: str) -> None:
    system = instrument(n_modes, n_ports)
    stepper = KernelStepper(system, isa=isa)
    state = stepper.start()
    state.modes[:] = np.random.default_rng(2).standard_normal(state.modes.shape) * 1e-6
    steps = max(64, 3_000_000 // n_modes)
    benchmark.group = f"{n_modes} modes, {n_ports} ports"
    benchmark.pedantic(lambda: stepper.run(state, steps), rounds=7, warmup_rounds=1)
    real_modes = sum(c.basis.n_modes for c in system.compiled)
    per_step = benchmark.stats.stats.median / steps
    share = multiply_adds(n_modes, n_ports) / per_step / peak(isa)
    found = {"ns_per_mode_and_sample": 1e9 * per_step / real_modes, "share_of_fma_peak": share}
    benchmark.extra_info |= found
    tell(f"{found['ns_per_mode_and_sample']:.3f} ns, {100 * share:.0f} % of the peak")
