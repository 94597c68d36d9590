"""Errors of the geometrically exact strings of `run.py`, tonewood's and IRCAM's, each against its own equation's limit.

    python benchmarks/peers/string_errors.py --sav FOLDER [--eigen FOLDER]

The lowest string over its first 0.3 s at 0.9 of its length: root of the summed squares of the difference from the
solution at 384 kHz (tonewood: of 150 modes, IRCAM: of as many points as that rate allows) over that of the motion.
IRCAM's equation has no longitudinal motion; its traces are shifted to where they differ least.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from run import POINTS, QUARTER, pluck_forces, sav_command, strings

from tonewood.physics.stepping.kernel import KernelStepper

SECONDS, LIMIT = 0.3, 384_000


def own(rate: int, modes: int, force: float, longitudinal: int = 5) -> NDArray[np.float64]:
    system = strings(rate, [modes], "longitudinal", longitudinal)
    return KernelStepper(system).run(system.start(), round(SECONDS * rate), pluck_forces(system, force))[0][:, 0]


def theirs(command: list[str], rate: int, force: float, trace: Path) -> NDArray[np.float64]:
    given = {"RATE": str(rate), "TRACE": str(trace)}
    subprocess.run([command[0], str(SECONDS), "2", str(force), *command[1:3]], env=os.environ | given, check=True,
                   capture_output=True)  # fmt: skip
    return np.fromfile(trace, np.float32).astype(float)


def error(found: NDArray[np.float64], limit: NDArray[np.float64]) -> float:
    n = min(len(found), len(limit))
    return float(np.linalg.norm(found[:n] - limit[:n]) / np.linalg.norm(limit[:n]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sav", metavar="FOLDER", help="src/processor of Ircam-RnD/SAV-string-simulations")
    parser.add_argument("--eigen", metavar="FOLDER", default="/usr/include/eigen3", help="headers of Eigen")
    options = parser.parse_args()
    print("| force, N | tonewood, 101 modes | 25 modes | 25 modes, 24 kHz | IRCAM, 101 points |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        command = sav_command(Path(name), options.sav, options.eigen)
        for force in (0.3, 1.0, 3.0):
            limit, cells = own(LIMIT, 150, force), []
            for rate, modes, modes_lengthwise in (
                (48_000, POINTS[0], 5),
                (48_000, QUARTER[0], 5),
                (24_000, QUARTER[0], 3),
            ):
                every = LIMIT // rate
                cells.append(error(own(rate, modes, force, modes_lengthwise), limit[every - 1 :: every]))
            if command:
                trace = Path(name) / "trace"
                limit, found = theirs(command, LIMIT, force, trace), theirs(command, 48_000, force, trace)[:-8]
                cells.append(min(error(found, limit[first::8]) for first in range(24)))
            print(f"| {force:g} | " + " | ".join(f"{x:.2g}" for x in cells) + " |")


if __name__ == "__main__":
    main()
