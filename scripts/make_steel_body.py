"""Write body and microphones of steel_guitar and twelve_string_guitar: the body that drawn_guitar_x draws, to 16 kHz.

    python scripts/make_steel_body.py instruments/steel_guitar instruments/twelve_string_guitar     # some minutes

Solving the drawing to 6 kHz, as drawn_guitar_x does, leaves nothing of a stroke above that. To 16 kHz it takes a minute
of processor time, and so the modes are kept as tables: `body.csv` for the plugin modal_table, `microphones.csv` for
modal_radiation. Two microphones stand where guitars are recorded, 0.35 m in front of the twelfth fret and of the lower
bout.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import tonewood as tw
from tonewood.instrument.contract.base import Body
from tonewood.instrument.inspection.modal_export import modal_table_text
from tonewood.physics import plate

FMAX = 16000.0
#: m, of the drawing: x from the neck joint, y to the treble side, z out of the top
MICROPHONES = {"left": (0.02, 0.0, 0.35), "right": (0.40, -0.05, 0.35)}
STRINGS = ("E2", "A2", "D3", "G3", "B3", "E4")
#: Hz, of a decaying exponential, which the table can only write as a pair of modes: far below all that is heard
STILL = 0.1


def drawn() -> tw.Instrument:
    """Return the drawing with the ends of the strings as its only points."""
    saddle = {
        f"bridge_{s}{end}": {"at": [0.340, round(0.0108 * (k - 2.5), 4)], "direction": end[1:] or "z"}
        for end in ("", "_y")
        for k, s in enumerate(STRINGS)
    }
    ends = {f"strings.{s}.end": [f"body.bridge_{s}", f"body.bridge_{s}_y"] for s in STRINGS}
    there = [f"body.bridge_{s}" for s in STRINGS]
    outputs = [
        {
            "name": "bridge",
            "plugin": "point_pickup",
            "quantity": "acceleration",
            "at": {"mean": there},
            "full_scale": 1.0,
        }
    ]
    tap = {"exciters.tap.at": there[0]}
    changes = {"body.points": saddle, "body.fmax": FMAX, "outputs": outputs}
    return tw.load_instrument("drawn_guitar_x").replace({**changes, **ends, **tap})


def microphones(body: Body[Any]) -> str:
    """Text of the table of both microphones' banks."""
    sources, basis = body.sources(FMAX), body.basis(FMAX)
    shapes = np.array([basis.right[basis.index(point)].real for point in basis.points])
    delay = min(float(sources.distances(at).min()) for at in MICROPHONES.values()) / plate.SOUND_SPEED
    banks = [plate.microphone(sources, at, basis.poles, shapes, FMAX, delay) for at in MICROPHONES.values()]
    for name, bank in zip(MICROPHONES, banks, strict=True):
        print(
            f"{name}: {len(bank.poles)} poles, error median and 95 %: {bank.error_db[0]:.2f}, {bank.error_db[1]:.2f} dB"
        )
    # rows of the body's poles have residues of both; those of high damping are each microphone's own
    n, rows = len(basis.poles), []
    for k, pole in enumerate(basis.poles):
        rows.append((pole, [bank.residues[k] for bank in banks]))
    for c, bank in enumerate(banks):
        for pole, residue in zip(bank.poles[n:], bank.residues[n:], strict=True):
            own = [residue if c == other else np.zeros_like(residue) for other in range(len(banks))]
            rows.append((pole, own))
    names = [f"{c}_at_{point}_{part}" for c in MICROPHONES for point in basis.points for part in ("re", "im")]
    lines = [
        "# Two microphones 0.35 m in front of the body of body.csv, Pa/(N s) per force on each of its points.",
        "# Made by scripts/make_steel_body.py. CC-BY-4.0.",
        ",".join(["f_Hz", "Q", *names]),
    ]
    for pole, residues in rows:
        if pole.imag == 0:
            pole, residues = complex(pole.real, 2 * np.pi * STILL), [r / 2 for r in residues]
        cells = [f"{x:.7g}" for residue in residues for r in residue for x in (r.real, r.imag)]
        lines.append(",".join([f"{pole.imag / (2 * np.pi):.9g}", f"{-pole.imag / (2 * pole.real):.9g}", *cells]))
    return "\n".join(lines) + "\n"


def main(folders: list[Path]) -> None:
    """Write both tables into each folder."""
    body = drawn().body
    title = "# The body of drawn_guitar_x with modes to 16 kHz, made by scripts/make_steel_body.py. CC-BY-4.0.\n"
    shapes, heard = title + modal_table_text(body, "body.csv", FMAX), microphones(body)
    for folder in folders:
        (folder / "body.csv").write_text(shapes, encoding="utf-8")
        (folder / "microphones.csv").write_text(heard, encoding="utf-8")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
