"""Author the stand-in soundboard of `grand_piano`: its modal table, from published statistics and a seed.

    python scripts/make_soundboard.py instruments/grand_piano

Mean mobility of a plate (Skudrzyk): Y = n(f) / (4 m), n the modal density and m the modal mass. Here Y at the bridge is
given, and m follows. No figure is that of one instrument.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SEED = 20
#: (Hz, modes per Hz), straight between: Ege, Boutillon and Rebillat 2013 to 5 kHz; carried on above
DENSITY = ((60.0, 0.06), (1100.0, 0.06), (1100.1, 0.05), (5000.0, 0.02), (5000.1, 0.014), (12000.0, 0.014))
#: (Hz, loss factor): the same, about 2 % below 3 kHz
LOSS = ((60.0, 0.020), (3000.0, 0.020), (12000.0, 0.0286))
#: s/kg, mean conductance at the bridge. A conductance of 2.7e-4 s/kg at every frequency gives a piano's prompt decays;
#: here most keys lie between two resonances, and the mean has to be higher
MOBILITY = 4.0e-4
#: m, length of each bridge, and distance between two places whose motion is independent
BASS, TREBLE, KNOTS = 0.45, 1.40, 0.0875
#: keys on the bass bridge; correlation of the bridges' motion below this frequency (Hz)
BASS_KEYS, CORRELATION, TOGETHER = 20, 0.3, 300.0
#: m, from rib to rib; above this frequency (Hz) modes are confined to one to three of these
RIB, CONFINED = 0.130, 1100.0
#: amplitude beyond, that the bridge carries on
FLOOR = 0.3
#: Hz, critical frequency, above which a mode's pressure follows its velocity rather than its acceleration
CRITICAL = 1100.0


def frequencies(draws: np.random.Generator) -> Floats:
    """Frequencies whose spacing is 1 / n(f), each moved by up to 10 % of it."""
    grid = np.linspace(DENSITY[0][0], DENSITY[-1][0], 200_001)
    density = np.interp(grid, *zip(*DENSITY, strict=True))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
    n = np.arange(int(count[-1])) + 0.5
    return np.interp(n + draws.uniform(-0.1, 0.1, n.size), count, grid)


def smooth(places: Floats, length: float, draws: np.random.Generator) -> Floats:
    """Draw a random function of variance 1, straight between knots along a bridge."""
    knots = np.linspace(0.0, length, round(length / KNOTS) + 1)
    weights = np.array([np.interp(places, knots, row) for row in np.eye(knots.size)])
    return (draws.standard_normal(knots.size) @ weights) / np.sqrt((weights**2).sum(axis=0))


def shape(freq: float, bass: Floats, treble: Floats, draws: np.random.Generator) -> Floats:
    """Shape of one mode at every key."""
    share = CORRELATION if freq < TOGETHER else 0.0
    own = smooth(treble, TREBLE, draws)
    along = np.interp(bass, [0.0, BASS], [0.0, TREBLE])
    found = np.concatenate(
        [share * np.interp(along, treble, own) + np.sqrt(1 - share**2) * smooth(bass, BASS, draws), own]
    )
    if freq < CONFINED:
        return found
    places = np.concatenate([bass, treble + 0.1 * TREBLE])
    width, centre = RIB * draws.uniform(1.0, 3.0), draws.uniform(0.0, places.max())
    bump = np.exp(-0.5 * ((places - centre) / (0.5 * width)) ** 2)
    return found * (FLOOR + (1 - FLOOR) * bump)


def main(folder: Path) -> None:
    """Write ``soundboard.csv``."""
    draws = np.random.default_rng(SEED)
    keys = [line.partition(",")[0] for line in (folder / "keys.csv").read_text().splitlines() if line[:1] in "ABCDEFG"]
    names = [note.replace("#", "s") for note in keys]
    bass = np.linspace(0.0, BASS, BASS_KEYS)
    treble = np.linspace(0.0, TREBLE, len(names) - BASS_KEYS)
    freq = frequencies(draws)
    shapes = np.array([shape(f, bass, treble, draws) for f in freq])
    confined = freq >= CONFINED
    # confinement must not change the mean mobility at any key
    shapes[confined] /= np.sqrt(np.mean(shapes[confined] ** 2, axis=0))
    shapes[np.abs(shapes) < 1e-2] = 0.0
    mass = np.interp(freq, *zip(*DENSITY, strict=True)) / (4 * MOBILITY)
    q = 1 / np.interp(freq, *zip(*LOSS, strict=True))
    radiated = 1 / np.sqrt(1 + (freq / CRITICAL) ** 2)
    both, own = draws.standard_normal(freq.size), draws.standard_normal((2, freq.size))
    left, right = radiated * (np.sqrt(0.5) * both + np.sqrt(0.5) * own)
    lines = [
        "# Stand-in for a grand's soundboard, by scripts/make_soundboard.py from published statistics: not measured.",
        "# CC-BY-4.0, the tonewood authors. modal_mass in kg; a column per key on its bridge, and two that are heard.",
    ]
    with (folder / "soundboard.csv").open("w", newline="") as stream:
        stream.write("\n".join(lines) + "\n")
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["f_Hz", "Q", "modal_mass", *names, "left", "right"])
        for row in zip(freq, q, mass, shapes, left, right, strict=True):
            f, Q, m, phi, lft, rgt = row
            table.writerow([f"{f:.3f}", f"{Q:.3g}", f"{m:.4g}", *(f"{x:.4g}" for x in phi), f"{lft:.4g}", f"{rgt:.4g}"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
