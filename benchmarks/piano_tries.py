"""Tries on `grand_piano`: what each change of strings, hammers, board or noises does to the figures of in_the_air.py.

    python benchmarks/piano_tries.py                    # some ten minutes
    python benchmarks/piano_tries.py shipped ribs_20    # some of them

A try plays A2 to A6 on a piano of these five keys, those named `whole...` on all 88. docs/piano.md has the sources.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from in_the_air import DURATION, PIANO, PIANO_HEAD, piano
from numpy.typing import NDArray

import tonewood as tw
from tonewood.workshop.estimate.recordings import FS

Row = dict[str, str]
NOTES = {"A2": 25, "A3": 37, "A4": 49, "A5": 61, "A6": 73}
#: m, speaking lengths of a Steinway M of 1936 at these keys but A2, as a technician measured them
STEINWAY_M = {37: 0.756, 49: 0.392, 61: 0.208, 73: 0.109}


def strung(row: Row, length: float, diameter: float) -> Row:
    """Return the row with a plain steel string of another length and diameter, m, at the same pitch."""
    density = 7850 * np.pi / 4 * diameter**2
    scale = length / float(row["string.length"])
    tension = float(row["string.tension"]) * scale**2 * density / float(row["string.linear_density"])
    stiffness = 2.02e11 * np.pi / 64 * diameter**4
    new = {"length": length, "tension": tension, "linear_density": density, "bending_stiffness": stiffness}
    return row | {f"string.{k}": repr(float(v)) for k, v in new.items()}


def wire(row: Row) -> float:
    """Diameter of a plain string, m."""
    return float((float(row["string.bending_stiffness"]) * 64 / (2.02e11 * np.pi)) ** 0.25)


def board(**constants: object) -> Callable[[Path], None]:
    """Return a change that draws the board anew with other constants of `make_soundboard.py`."""

    def change(folder: Path) -> None:
        path = Path(__file__).parents[1] / "scripts" / "make_soundboard.py"
        spec = importlib.util.spec_from_file_location("board", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        for name, value in constants.items():
            setattr(module, name, value)
        module.main(folder)

    return change


def keys(each: Callable[[int, Row], Row]) -> Callable[[Path], None]:
    """Return a change of the rows of `keys.csv`; the number counts keys from 1."""

    def change(folder: Path) -> None:
        lines = (folder / "keys.csv").read_text(encoding="utf-8").splitlines()
        rows = [each(NOTES[row["note"]], row) for row in csv.DictReader(x for x in lines if x[:1] != "#")]
        with (folder / "keys.csv").open("w", newline="", encoding="utf-8") as stream:
            table = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    return change


def falling(folder: Path) -> None:
    """Mobility above 1.1 kHz falls by 6 dB per octave, as Wogram has it, in place of 3."""
    lines = (folder / "soundboard.csv").read_text(encoding="utf-8").splitlines()
    head = [x for x in lines if not x[:1].isdigit()]
    rows = np.array([[float(v) for v in x.split(",")] for x in lines[len(head) :]])
    high = rows[:, 0] > 1100.0
    rows[high, 3:91] *= (1100.0 / rows[high, :1]) ** 0.25
    (folder / "soundboard.csv").write_text("\n".join([*head, *(",".join(map(repr, r)) for r in rows.tolist())]) + "\n")


def cents(spread: float) -> Callable[[int, Row], Row]:
    """Unisons whose outer strings lie so many cents apart."""
    return lambda n, row: row | {"cents_2": f"{0.55 * spread:g}", "cents_3": f"{-0.45 * spread:g}"}


def chaigne(n: int, row: Row) -> Row:
    """Felts of Chaigne and Askenfelt (1994), straight between C2, C4 and C7: K on a logarithmic scale."""
    at = (16, 40, 76)
    stiffness = np.exp(np.interp(n, at, np.log([4e8, 4.5e9, 1e12])))
    return row | {"hammer.stiffness": f"{stiffness:.4g}", "hammer.exponent": f"{np.interp(n, at, [2.3, 2.5, 3.0]):.3f}"}


TRIES: dict[str, Callable[[Path], None]] = {
    "shipped": lambda folder: None,
    "ribs_20": board(RIB_HEIGHT=0.020),
    "board_8": board(THICKNESS=8e-3),
    "bridge_in": board(TREBLE=((0.30, 1.70), (0.517, 0.930), (0.919, 0.357), (1.417, 0.125))),
    "unisons_0.3": keys(cents(0.3)),
    "unisons_3": keys(cents(3.0)),
    "heads_conklin": keys(lambda n, row: row | {"hammer.mass": f"{1e-3 * min(11.0, 11 - 7.5 * (n - 12) / 76):.5f}"}),
    "felts_chaigne": keys(chaigne),
    "mobility_6_db": falling,
    "lengths_steinway_m": keys(lambda n, row: strung(row, STEINWAY_M[n], wire(row)) if n in STEINWAY_M else row),
    "thinner_wire": keys(lambda n, row: strung(row, float(row["string.length"]), 0.95 * wire(row)) if n > 60 else row),
    "noises": lambda folder: None,
    "pedal": lambda folder: None,
    "whole": lambda folder: None,
    "whole_noises_pedal": lambda folder: None,
    "phantoms": keys(
        lambda n, row: row | {
            "string.plugin": "phantom_string", "string.bridge_leverage": row["string.bridge_leverage"] or "0.012",
            "string.axial_stiffness": row["string.axial_stiffness"] or f"{2.02e11 * np.pi / 4 * wire(row) ** 2:.4g}",
        }
    ),
}  # fmt: skip


def sounds(name: str, folder: Path) -> dict[int, NDArray[np.float64]]:
    """Notes of one try."""
    shutil.copytree(tw.list_instruments()["grand_piano"], folder)
    if not name.startswith("whole"):
        lines = (folder / "keys.csv").read_text(encoding="utf-8").splitlines()
        kept = [x for x in lines if x[:1] == "#" or x.partition(",")[0] in ("note", *NOTES)]
    names = [x.partition(",")[0] for x in (folder / "keys.csv").read_text().splitlines() if x[:1] in "ABCDEFG"]
    assert len(names) == 88
    if TRIES[name].__qualname__.startswith("board"):
        TRIES[name](folder)
    if not name.startswith("whole"):
        (folder / "keys.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    if not TRIES[name].__qualname__.startswith("board"):
        TRIES[name](folder)
    path = folder / "instrument.yaml"
    hashed = re.compile(r",\s*sha256: \w+")
    path.write_text(hashed.sub("", path.read_text(encoding="utf-8")), encoding="utf-8")
    instrument = tw.load_instrument(folder)
    pedal = [tw.Control(0.0, "cc64", 1.0)] if "pedal" in name else []
    out = {}
    for note in PIANO:
        score = tw.Score([tw.Note(0.1, DURATION, note=note, velocity_midi=80)], pedal)
        effects = {"effects": "all"} if name == "phantoms" else {}
        sound = tw.render(score, instrument, max_duration=DURATION, fs=FS, noises="noises" in name, **effects)
        out[note] = np.asarray(sound.samples, dtype=np.float64).mean(axis=1)
    return out


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tries", nargs="*", help=", ".join(TRIES))
    for name in parser.parse_args().tries or TRIES:
        print(f"\n{name}\n\n{PIANO_HEAD}\n|---" + "|---:" * 7 + "|")
        with tempfile.TemporaryDirectory() as place:
            figures = piano(sounds(name, Path(place) / "piano"))
        print(f"A5 to A6: {figures[93][-1] - figures[81][-1]:.1f} dB", flush=True)


if __name__ == "__main__":
    main()
