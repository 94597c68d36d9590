"""Time of a sample of `grand_piano` where the tension rises of every string that has phantom partials in the bundle.

    python benchmarks/rising_piano.py

All modes move; no notes. The least of thirty blocks of 256 samples, processor time.
"""

from __future__ import annotations

import csv
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

import tonewood as tw
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.stepping.kernel import KernelStepper

BLOCK, FS = 256, 48000.0


def rising(folder: Path) -> tw.Instrument:
    shutil.copytree(tw.list_instruments()["grand_piano"], folder)
    path = folder / "keys.csv"
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    for row in rows:
        row["string.bridge_leverage"] = ""
        if row["string.plugin"] == "phantom_string":
            row["string.plugin"] = "tension_modulated_string"
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    return tw.load_instrument(folder)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        system = assemble(rising(Path(name) / "grand_piano"), FS).system
    stepper, state = KernelStepper(system), system.start()
    state.modes[:] = np.random.default_rng(0).normal(size=state.modes.shape) * 1e-7
    least = np.inf
    for _ in range(30):
        began = time.thread_time()
        stepper.advance(state, BLOCK)
        least = min(least, time.thread_time() - began)
    print(
        f"{len(system.potentials)} strings: {least / BLOCK * 1e6:.1f} us a sample, {BLOCK / FS / least:.2f} x real time"
    )


if __name__ == "__main__":
    main()
