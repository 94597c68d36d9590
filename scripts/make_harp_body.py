"""Write body and microphones of the african_harp bundle: the complex modes of the stand-in, as tables.

Run from the root of the repository: python scripts/make_harp_body.py [FOLDER]

The sound stands in, too: the soundboard moves as the places where the strings are tied, the first four as one half of
its area, the last four as the other. Of a volume acceleration Q'' a microphone at the distance R in free air hears
rho Q'' / (4 pi R); the acceleration of mode lambda is lambda^2 / (s - lambda) times its shapes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from tonewood.lab.systems.harp_body import SEED, harp_body_table

HEADER = f"""\
# Body of a harp from Central Africa: 32 complex modes between 100 and 1700 Hz. A STAND-IN, not a measured instrument:
# Fabre, Le Carrou & Chomette, J. Sound Vib. 590 (2024) 118593, identified such a body but do not print its modes.
#
# Made by scripts/make_harp_body.py (seed {SEED}) from the matrices in tonewood.lab.systems.harp_body. CC-BY-4.0.
#
# Points s1 .. s8: where the strings are tied to the tailpiece, direction normal to the soundboard (z).
# y = 2 Re sum right z,  z' = lambda z + left f,  lambda = 2 pi f_Hz (-zeta + i sqrt(1 - zeta^2)), y in m, f in N.
"""


#: m^2, of each half of the soundboard; kg/m^3; m, from the two halves to the microphones
HALF, DENSITY, NEAR, FAR = 0.025, 1.2, 0.5, 0.55
SOUND = """\
# Two microphones half a metre in front of the harp of body.csv, Pa/(N s) per force on each string's place: a STAND-IN.
# Made by scripts/make_harp_body.py, which says how. CC-BY-4.0.
"""


def microphones(names: list[str], values: np.ndarray) -> str:
    """Text of the table of both microphones' banks."""
    columns = dict(zip(names, values.T, strict=True))
    freq, zeta = 2 * np.pi * columns["f_Hz"], columns["zeta"]
    poles = freq * (-zeta + 1j * np.sqrt(1 - zeta**2))
    points = [f"s{i}" for i in range(1, 9)]
    shape = {
        (p, side): columns[f"{p}_{side}_re"] + 1j * columns[f"{p}_{side}_im"]
        for p in points
        for side in ("right", "left")
    }
    half = [np.mean([shape[p, "right"] for p in part], axis=0) for part in (points[:4], points[4:])]
    heads, rows = ["f_Hz", "Q"], [poles.imag / (2 * np.pi), -poles.imag / (2 * poles.real)]
    for channel, ways in (("left", (NEAR, FAR)), ("right", (FAR, NEAR))):
        heard = sum(DENSITY * HALF / (4 * np.pi * r) * moved for r, moved in zip(ways, half, strict=True))
        for p in points:
            residue = heard * poles**2 * shape[p, "left"]
            heads += [f"{channel}_at_{p}_re", f"{channel}_at_{p}_im"]
            rows += [residue.real, residue.imag]
    lines = [",".join(heads), *(",".join(f"{x:.7g}" for x in row) for row in zip(*rows, strict=True))]
    return SOUND + "\n".join(lines) + "\n"


def main(folder: Path) -> None:
    """Write both tables into `folder`."""
    names, values = harp_body_table()
    rows = [",".join(f"{value:.15g}" for value in row) for row in values]
    (folder / "body.csv").write_text(HEADER + ",".join(names) + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    (folder / "microphones.csv").write_text(microphones(names, values), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "instruments/african_harp"))
