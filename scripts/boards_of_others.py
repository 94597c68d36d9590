"""Table of docs/wood.md: constants of other people's boards.

python scripts/boards_of_others.py FOLDER

FOLDER holds plates.csv and a file .npz of hits a board, as in the repository
Data-driven-characterization-of-spruce-tonewood-plates.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from tonewood.workshop.taps.strongest import strongest
from tonewood.workshop.wood.board import Board, estimate_board, typical
from tonewood.workshop.wood.rectangle import Rectangle

NAMES = ("E_L", "E_R", "G_LR")


def solution(folder: Path, row: dict[str, str]) -> Board:
    """Constants of one board, in two passes as the command has them."""
    size = [1e-3 * float(row[key]) for key in ("length_mm", "width_mm", "thickness_mm")]
    mass = 1e-3 * float(row["mass_g"])
    taps = np.load(folder / f"{row['plate']}.npz")["acceleration"]
    peaks = strongest([*taps], 48000, (30.0, 800.0))
    columns = [p.freq for p in peaks], [p.error for p in peaks], [p.quality for p in peaks]
    nominal = typical("sitka_spruce", mass / float(np.prod(size)))
    first = estimate_board(Rectangle.of(*size, mass, nominal), *columns)
    return estimate_board(Rectangle.of(*size, mass, first.wood), *columns, prior=nominal)


def main(folder: Path) -> None:
    """Print a row a board."""
    print(
        "| board | peaks used | worst, % | r.m.s., % | not used, Hz | "
        + " | ".join(NAMES)
        + " | E_L, E_R, G_LR re the authors', % |"
    )
    print("|---|---:|---:|---:|---|---:|---:|---:|---|")
    for row in csv.DictReader((folder / "plates.csv").open(encoding="utf-8")):
        board = solution(folder, row)
        worst = max(abs(p.computed / p.measured - 1) for p in board.pairs)
        values, apart = [], []
        for name in NAMES:
            value, (low, high) = getattr(board.wood, name) / 1e9, board.intervals[name]
            values.append(f"{value:.3g} ({low / 1e9:.3g}-{high / 1e9:.3g})")
            apart.append(f"{100 * (1e9 * value / float(row[f'authors_{name}_Pa']) - 1):+.0f}")
        unused = ", ".join(f"{f:.0f}" for f in board.peaks_without_mode) or "none"
        cells = [row["plate"], len(board.pairs), f"{100 * worst:.1f}", f"{100 * board.misfit:.2f}", unused, *values]
        print("| " + " | ".join(map(str, [*cells, ", ".join(apart)])) + " |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
