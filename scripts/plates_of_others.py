"""Table of docs/a_body_from_a_drawing.md: other people's plates, by shear factor.

python scripts/plates_of_others.py fem_plates.csv           # all plates
python scripts/plates_of_others.py fem_plates.csv --every 12

The file has constants and frequencies by finite elements, as in the repository
Data-driven-characterization-of-spruce-tonewood-plates.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from tonewood.physics.plate.plate import FREE, Plate
from tonewood.physics.plate.wood import Wood
from tonewood.support.blas import one_blas_thread


@one_blas_thread
def fem_errors(rows: Sequence[dict[str, str]], shear_factor: float, sheared: bool = True) -> np.ndarray:
    """Relative errors of all modes of some plates, paired by frequency."""
    errors = []
    for row in rows:
        v = {k: float(x) for k, x in row.items() if x}
        shear = {"G_LT": v["Gxz"], "G_RT": v["Gyz"]} if sheared else {}
        wood = Wood(v["Ex"], v["Ey"], v["Gxy"], v["vxy"], v["rho"], **shear)
        ring = np.array([[0, 0], [v["L"], 0], [v["L"], v["W"]], [0, v["W"]]])
        freq = Plate([ring], wood, v["T"], FREE, size=0.03, shear_factor=shear_factor).modes(count=28).freq[3:]
        theirs = np.array([x for k, x in v.items() if k[0] == "f" and k[1:].isdigit() and x > 0])
        i, j = linear_sum_assignment(np.abs(np.log(theirs[:, None] / freq)))
        errors.append(freq[j] / theirs[i] - 1)
    return np.concatenate(errors)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--every", type=int, default=1, help="take each Nth plate")
    options = parser.parse_args()
    with options.file.open() as file:
        rows = list(csv.DictReader(file))[:: options.every]
    print(f"{len(rows)} plates: median and 95 % of |error|, median error, %")
    for label, factor, sheared in (("5/6", 5 / 6, True), ("1", 1.0, True), ("Kirchhoff", 1.0, False)):
        errors = 100 * fem_errors(rows, factor, sheared)
        size = np.abs(errors)
        print(f"{label:10} {len(errors):6} modes  {np.median(size):5.2f} {np.quantile(size, 0.95):5.2f} "
              f"{np.median(errors):+6.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
