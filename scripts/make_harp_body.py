"""Write the body of the african_harp bundle: the complex modes of the stand-in, as a table.

Run from the root of the repository: python scripts/make_harp_body.py [FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

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


def main(path: Path) -> None:
    """Write the table to `path`."""
    names, values = harp_body_table()
    rows = [",".join(f"{value:.15g}" for value in row) for row in values]
    path.write_text(HEADER + ",".join(names) + "\n" + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "instruments/african_harp/body.csv"))
