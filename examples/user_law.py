"""A contact law of one's own, as two C functions: a felt that hardens exponentially, on a hammer that meets a string.

    V(d) = F a [exp(p / a) - 1 - p / a],  V'(d) = -F [exp(p / a) - 1],    p = -d > 0 the compression, V = 0 otherwise

The kernel calls the compiled functions; the potential makes the step keep its energy, whatever the law. Where there is
no C compiler, the same potential is given as a table. ctypes, cffi and numba's cfunc serve alike.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import tonewood.authoring as ta
from tonewood.physics.coupling.connections import Rigid
from tonewood.physics.coupling.system import System
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion

FORCE, LENGTH = 0.5, 1.0e-4  # N, m
MASS, SPEED = 2.0e-3, 1.5  # kg, m/s
SOURCE = f"""
#include <math.h>
double potential(double d) {{ double s = -d / {LENGTH}; return s > 0 ? {FORCE * LENGTH} * (expm1(s) - s) : 0; }}
double slope(double d) {{ double s = -d / {LENGTH}; return s > 0 ? {-FORCE} * expm1(s) : 0; }}
"""


def compiled(folder: Path) -> ta.CompiledPotential | None:
    """The law in C, or None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform == "win32":
        return None
    source, library = folder / "felt.c", folder / "felt.so"
    source.write_text(SOURCE)
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    felt = ctypes.CDLL(str(library))
    for function in (felt.potential, felt.slope):
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    # a pointer to the C function itself: no Python runs in the sample loop
    double = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    pointers = (ctypes.cast(function, double) for function in (felt.potential, felt.slope))
    return ta.CompiledPotential(*pointers, residual=False)


def sampled() -> ta.SampledPotential:
    """The same as a table of forces."""
    d = np.linspace(-1e-3, 1e-4, 2001)
    return ta.SampledPotential.from_force(d, FORCE * np.expm1(np.maximum(-d, 0) / LENGTH), residual=False)


def main() -> tuple[float, float]:
    """Contact time (s), and energy after the blow as a share of that before."""
    loss = lambda freq_rad, k: 0 * freq_rad  # noqa: E731
    string = ta.string_basis(0.65, 73.9, 3.61e-3, 4e-5, loss, freq_upper=20000).with_places({"struck": 0.3})
    hammer = ta.loose_mass(MASS)
    with tempfile.TemporaryDirectory() as folder:
        law = compiled(Path(folder)) or sampled()
        system = System.build(
            {"string": string, "hammer": hammer},
            [
                ta.Connection("end", (ta.Term("string", "bridge"),), Rigid()),
                ta.Connection("felt", (ta.Term("string", "struck"), ta.Term("hammer", "mass", -1.0)), law),
            ],
            dt=1 / 48000,
        )
        stepper = KernelStepper(system)
        state = stepper.start()
        system.modes_of(state, "hammer")[:] = from_motion(hammer, np.zeros(1), np.array([SPEED * math.sqrt(MASS)]))
        before = 0.5 * MASS * SPEED**2
        _, forces = stepper.run(state, 480)
    q, v = to_motion(string, system.modes_of(state, "string"))
    _, speed = to_motion(hammer, system.modes_of(state, "hammer"))
    after = 0.5 * float(np.sum(string.stiffness * q**2 + v**2) + np.sum(speed**2))
    contact = float(np.sum(forces[:, 1] > 0) / 48000)
    print(f"{type(law).__name__}: {contact * 1e3:.2f} ms of contact, energy after / before {after / before:.12f}")
    return contact, after / before


if __name__ == "__main__":
    main()
