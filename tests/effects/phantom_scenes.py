"""Random scenes for phantom partials that come and go: strings in unison and at intervals on light, sharp bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

import tonewood as tw

FS = 24000.0
SECONDS = 3.0
#: tension (N), linear density (kg/m), bending stiffness (N m^2), axial stiffness (N)
STRINGS = [
    (700.0, 1.2e-2, 6e-3, 1.5e5),
    (133.9, 2.095e-3, 4.65e-5, 10807.0),
    (110.8, 9.805e-3, 1.1e-3, 52620.0),
    (650.0, 6e-3, 1.5e-3, 1.6e5),
]


def scene(seed: int, folder: Path) -> tuple[tw.Instrument, tw.Score, float]:
    """An instrument written into `folder`, one to four plucks, and a budget in dB.

    Bodies have 1 to 6 modes, Q 20 to 3000, 20 to 300 g; outputs read displacement, velocity or acceleration; strings
    are 0.02 semitones to an octave apart.
    """
    rng = np.random.default_rng([55, seed])
    n_modes, n_strings = int(rng.integers(1, 7)), int(rng.integers(1, 5))
    names = [f"s{i + 1}" for i in range(n_strings)]
    rows = [
        [10 ** rng.uniform(1.9, 3.6), 10 ** rng.uniform(1.3, 3.48), 10 ** rng.uniform(-1.7, -0.52),
         *(rng.uniform(-1, 1) for _ in names)]
        for _ in range(n_modes)
    ]  # fmt: skip
    lines = [["f_Hz", "Q", "modal_mass", *names], *([f"{value:.5f}" for value in row] for row in rows)]
    (folder / "body.csv").write_text("\n".join(",".join(line) for line in lines) + "\n")
    tension, density, bending, axial = STRINGS[rng.integers(4)]
    length = float(rng.uniform(0.6, 1.3))
    note = 69 + 12 * np.log2(np.sqrt(tension / density) / 2 / length / 440)
    apart = float(rng.choice([0.02, 0.05, 7.02, 4.0, 12.0][: 5 if n_strings == 2 else 4]))
    strings = {
        name: {
            "plugin": "phantom_string", "note": float(note + i * apart), "linear_density": density, "tension": tension,
            "length": length / 2 ** (i * apart / 12), "bending_stiffness": bending, "axial_stiffness": axial,
            "longitudinal_loss": float(10 ** rng.uniform(-3, -1.5)), "bridge_leverage": float(rng.uniform(-0.3, 0.5)),
            "loss": {"law": "sigma", "sigma0": float(10 ** rng.uniform(-0.5, 0.5)), "sigma1": 3e-4},
            "end": f"body.{name}",
        }
        for i, name in enumerate(names)
    }  # fmt: skip
    values: dict[str, Any] = {
        "schema": "tonewood-instrument/2", "name": "light", "title": "light", "licence": "CC0-1.0", "sources": {},
        "provenance": {"*": {"kind": "authored"}},
        "body": {"plugin": "modal_table", "table": "body.csv", "shapes": "points",
                 "points": {name: {"direction": "z"} for name in names}},
        "strings": strings, "stops": {"kind": "none"},
        "exciters": {"pluck": {"plugin": "pluck_ramp", "from_bridge": 0.03,
                               "release_time": float(10 ** rng.uniform(-4, -3))}},
        "playing": {"velocity": {"parameter": "pluck.force", "low": 0.4, "high": 4.0}, "note_end": {"kind": "ring"}},
        "outputs": [{"name": "bridge", "plugin": "point_pickup", "at": "body.s1", "full_scale": 100.0,
                     "quantity": str(rng.choice(["displacement", "velocity", "acceleration"]))}],
    }  # fmt: skip
    with (folder / "instrument.yaml").open("w") as stream:
        YAML().dump(values, stream)
    notes = [
        tw.Note(float(rng.uniform(0, 1.2)), 3.0, string=str(rng.choice(names)), stop=0,
                force=float(10 ** rng.uniform(-1, 1.2)), from_bridge=float(rng.uniform(0.03, 0.15)))
        for _ in range(rng.integers(1, 5))
    ]  # fmt: skip
    return tw.load_instrument(folder), tw.Score(sorted(notes, key=lambda n: n.time)), float(rng.uniform(-95, -40))


def excess(seed: int, folder: Path) -> float:
    """By how many dB `auto` differs from `all` beyond its budget, re the loudest sample."""
    instrument, score, budget = scene(seed, folder)
    sounds = []
    for options in ({"effects": "auto", "budget_db": budget}, {"effects": "all"}):
        stream = tw.Renderer(score, instrument, FS, max_duration=SECONDS, tail=tw.Tail(-150, SECONDS), **options)
        sounds.append(np.concatenate([np.asarray(block, dtype=np.float64) for block in stream.blocks(4096)]))
    n = min(map(len, sounds))
    difference = np.max(np.abs(sounds[0][:n] - sounds[1][:n])) / np.max(np.abs(sounds[1]))
    return float(20 * np.log10(max(difference, 1e-300)) - budget)
