"""How cost grows with strings and body modes: the strings of a concert grand, 6 to 243, on a body that was made up.

    python benchmarks/scale.py [strings|planes|hammers|motions|body|tension|piano ...] [--rounds 5] [--chart FILE]

Strings: 88 notes, 8 of one, 5 of two and 75 of three strings, from published scaling (`SCALE` below), their modes to
12 kHz. Fewer strings are those of as many keys, evenly spread. Body: 300 modes from 60 Hz to 12 kHz with Q 50 and
random shapes along the bridge, linear between `motions` knots, so that 88 bridge points have that many independent
motions. All strings ring. One core; every block of 256 samples counts as it was quickest of all rounds. Time is that of
a sample at 48 kHz, where real time is 20.8 us.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.coupling import elimination
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set
from tonewood.support.plotting import COLOURS, DASHES, LINE, figure, legend, log_axis

Floats = NDArray[np.float64]
FS, BLOCK = 48000.0, 256
#: key, length (m), core (mm), mass per length (g/m): C2 to C7 as published (finite-difference scripts of one grand),
#: D#1 after Chabassier, Chaigne & Joly (2013); the ends, the break at key 20/21 and the step of the bass from one
#: string a note to two at 8/9 are stand-ins. Plain wire (from key 21) has 7850 kg/m^3.
SCALE: dict[str, list[tuple[float, float, float, float]]] = {
    "single": [(1, 2.020, 1.600, 149.88), (7, 1.945, 1.480, 77.82), (8, 1.904, 1.450, 71.12)],
    "wound": [(9, 1.863, 1.250, 43.47), (13, 1.709, 1.120, 27.73), (16, 1.602, 1.051, 20.84), (20, 1.450, 1.0, 15.41)],
    "plain": [
        (21, 1.840, 1.100, 0.0), (28, 1.259, 1.063, 0.0), (40, 0.657, 1.0, 0.0), (52, 0.344, 0.932, 0.0),
        (64, 0.180, 0.891, 0.0), (76, 0.095, 0.831, 0.0), (88, 0.050, 0.775, 0.0),
    ],
}  # fmt: skip
#: key, sigma_0 (1/s), sigma_1 (s, of omega^2) of the same scripts
LOSS = [
    (1, 0.2, 1.4e-9),
    (16, 0.2, 2.0e-9),
    (28, 0.12, 2.3e-9),
    (40, 0.18, 2.6e-9),
    (52, 0.24, 3.0e-9),
    (88, 0.42, 4e-9),
]
YOUNG = 2.02e11
HAMMER = {
    "plugin": "hammer", "from_bridge": {"fraction": 0.12}, "mass": 8.7e-3, "stiffness": 5.8e9, "loss": 0.1,
}  # fmt: skip
CENTS = (0.0, 0.6, -0.5)
ALL = 243


@dataclass(frozen=True)
class Wire:
    """One string: its key, its place in the unison, and its parameters for `stiff_string`."""

    key: int
    place: int
    values: dict[str, Any]


def wires(freq_upper: float) -> list[Wire]:
    """All 243 strings, from the bass."""
    out = []
    for key in range(1, 89):
        part = SCALE["single" if key <= 8 else "wound" if key <= 20 else "plain"]
        keys = [row[0] for row in part]
        length, core = (float(np.exp(np.interp(key, keys, np.log([row[i] for row in part])))) for i in (1, 2))
        bare = 7850 * np.pi / 4 * (core * 1e-3) ** 2
        density = 1e-3 * float(np.exp(np.interp(key, keys, np.log([row[3] for row in part])))) if key <= 20 else bare
        freq = 440.0 * 2 ** ((key - 49) / 12)
        tension = density * (2 * length * freq) ** 2
        sigma0, sigma1 = (float(np.interp(key, [r[0] for r in LOSS], [r[i] for r in LOSS])) for i in (1, 2))
        for place in range(1 if key <= 8 else 2 if key <= 13 else 3):
            values = {
                "freq": float(freq * 2 ** (CENTS[place] * np.sqrt(261.6 / freq) / 1200)),
                "length": length,
                "tension": float(tension),
                "linear_density": float(density),
                "bending_stiffness": float(YOUNG * np.pi / 64 * (core * 1e-3) ** 4),
                "loss": {"law": "sigma", "sigma0": sigma0, "sigma1": float(sigma1 * tension / density)},
                "freq_upper": freq_upper,
            }
            out.append(Wire(key, place, values))
    return out


def body(modes: int, motions: int) -> dict[str, Floats]:
    """The body's table: a column for each key's bridge point."""
    rng = np.random.default_rng(21)
    where = np.linspace(0, 1, modes)
    # half of the modes below 2.2 kHz, as a soundboard's density falls above its first kilohertz
    freq = np.interp(where, [0, 0.21, 0.68, 1], [60.0, 1100.0, 5000.0, 11800.0])
    spacing = np.gradient(freq)
    freq = np.sort(freq + 0.1 * spacing * rng.uniform(-1, 1, modes))
    mass = 1 / (4 * 2.7e-4 * spacing)  # mean mobility 2.7e-4 s/kg everywhere
    keys = np.arange(88)
    knots = np.linspace(0, 87, motions)
    table = {"f_Hz": freq, "Q": np.full(modes, 50.0), "modal_mass": mass}
    shapes = rng.standard_normal((motions, modes))
    for key in keys:
        table[f"key{key + 1}"] = np.array([np.interp(key, knots, shape) for shape in shapes.T])
    return table


def stretches(wire: Wire) -> dict[str, Any]:
    """The same wire as a string whose tension rises; EA of a round core from its bending stiffness."""
    axial = 2 * float(np.sqrt(np.pi * YOUNG * wire.values["bending_stiffness"]))
    return {"plugin": "tension_modulated_string", "axial_stiffness": axial}


def write_bundle(
    folder: Path,
    strings: int = ALL,
    *,
    modes: int = 300,
    motions: int = 40,
    planes: Sequence[str] = ("z",),
    tilt: float = 0.0,
    freq_upper: float = 12000.0,
    hammers: bool = False,
    rising: int = 0,
) -> Path:
    """Write the bundle: `planes` of polarization, `tilt` degrees that make the body move in both; hammers or plucks.

    The tension of the lowest `rising` strings rises with their amplitude.
    """
    every = wires(freq_upper)
    chosen = [every[int(i)] for i in np.linspace(0, ALL - 1, strings).round()]
    table = body(modes, motions)
    columns = [np.asarray(c) for c in table.values()]
    lines = [",".join(table), *(",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True))]
    (folder / "body.csv").write_text("\n".join(lines) + "\n")
    common = {"plugin": "stiff_string", "polarizations": list(planes), "tilt_deg": tilt}
    spec = {
        "schema": "tonewood-instrument/2",
        "name": "scale",
        "title": "Strings of a grand piano on a body that was made up",
        "licence": "CC0-1.0",
        "sources": {},
        "provenance": {"*": {"kind": "authored"}},
        "body": {
            "plugin": "modal_table",
            "table": "body.csv",
            "shapes": "points",
            "points": {f"key{key}": {"direction": "z"} for key in range(1, 89)},
        },
        "strings": {
            f"k{w.key}_{w.place}": {**common, **w.values, "end": f"body.key{w.key}", **(stretches(w) if rises else {})}
            for rises, w in ((i < rising, w) for i, w in enumerate(chosen))
        },
        "tuning": {"compensate": "none"},
        "stops": {"kind": "none"},
        "exciters": {"pluck": HAMMER if hammers else {"plugin": "pluck_ramp", "from_bridge": {"fraction": 0.12}}},
        "playing": {"velocity": {"parameter": f"pluck.{'velocity' if hammers else 'force'}", "low": 0.4, "high": 4.0}},
        "outputs": [
            {"name": name, "plugin": "point_pickup", "quantity": "acceleration", "at": f"body.{at}", "full_scale": 1.0}
            for name, at in (("bass", "key10"), ("treble", "key60"))
        ],
    }  # fmt: skip
    (folder / "instrument.yaml").write_text(json.dumps(spec, indent=1))
    return folder


class Scene:
    """A bundle, assembled; all modes of its strings and body are set in motion at random."""

    def __init__(self, one_matrix: bool = False, still: str = "", potentials: bool = True, **what: Any):
        self.still = still  # plane of motion that is at rest
        kept = elimination.LEAST_IN_PARTS
        elimination.LEAST_IN_PARTS = 10**9 if one_matrix else kept
        try:
            self._make(potentials, **what)
        finally:
            elimination.LEAST_IN_PARTS = kept

    def _make(self, potentials: bool, **what: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            bundle = what.pop("bundle", None) or write_bundle(Path(folder), **what)
            made = time.perf_counter()
            self.model: Model = assemble(tw.load_instrument(bundle), FS)
        system = self.model.system
        self.stepper = KernelStepper(system if potentials else system.with_potentials(()))
        self.load_seconds = time.perf_counter() - made

    def run(self, seconds: float) -> Floats:
        """Return the time that each block takes, s."""
        state, system = self.stepper.start(), self.model.system
        rng = np.random.default_rng(1)
        components = [c for string in self.model.strings.values() for c in string.components]
        for name in ("body", *(c for c in components if not self.still or not c.endswith(f".{self.still}"))):
            modes = system.modes_of(state, name)
            modes[:] = 1e-8 * rng.standard_normal(modes.shape)
        marks = [time.perf_counter()]
        for _ in range(int(seconds * FS) // BLOCK):
            self.stepper.advance(state, BLOCK)
            marks.append(time.perf_counter())
        return np.diff(marks)


def measure(scenes: dict[str, dict[str, Any]], seconds: float, rounds: int) -> dict[str, dict[str, float]]:
    """Microseconds a sample, modes and load time of each scene."""
    made = {name: Scene(**what) for name, what in scenes.items()}
    least: dict[str, Floats] = {}
    for _ in range(rounds):
        for name, scene in made.items():
            took = scene.run(seconds)
            least[name] = np.minimum(least.get(name, took), took)
    return {
        name: {
            "us": 1e6 * float(np.sum(least[name])) / (len(least[name]) * BLOCK),
            "modes": float(scene.model.n_modes),
            "load": scene.load_seconds,
        }
        for name, scene in made.items()
    }


KINDS: dict[str, dict[str, Any]] = {"": {}, ", one matrix": {"one_matrix": True}}
COUNTS = (6, 12, 24, 48, 88, 132, 176, 243)
STUDIES: dict[str, dict[str, dict[str, Any]]] = {
    "strings": {f"{n}{of}": {"strings": n, **how} for of, how in KINDS.items() for n in COUNTS},
    "planes": {
        "243, one plane": {},
        "243, two planes, y rigid": {"planes": ("z", "y")},
        "243, two planes, y rigid and at rest": {"planes": ("z", "y"), "still": "y"},
        "243, two planes, both move the body": {"planes": ("z", "y"), "tilt": 10.0},
    },
    "hammers": {"no hammers": {}, "243 hammers, away": {"hammers": True}},
    "motions": {f"{r} motions": {"motions": r} for r in (16, 24, 40, 60, 88)},
    "body": {f"{n} body modes": {"modes": n} for n in (75, 150, 300, 600)},
    "tension": {f"{n} of 243 rise{of}": {"rising": n, **how} for n in (0, 1, 8, 30, 61) for of, how in KINDS.items()},
    "piano": {
        "grand_piano": {"bundle": "grand_piano", "potentials": False},
        "grand_piano, forces of all phantom partials": {"bundle": "grand_piano"},
    },
}


def draw(us: dict[str, float], path: Path) -> None:
    """Draw microseconds a sample against strings."""
    made, axes = figure(heights=[5.0])
    ax = axes[0, 0]
    for i, (kind, label) in enumerate(zip(KINDS, ("solved in parts", "as one matrix"), strict=True)):
        row = [us[f"{n}{kind}"] for n in COUNTS]
        ax.plot(COUNTS, row, "o", ls=DASHES[i], color=COLOURS[i], lw=LINE, label=f"connections {label}")
    ax.axhline(1e6 / FS, color=COLOURS[2], ls=DASHES[2], lw=LINE, label="real time")
    ax.set(xscale="log", xlabel="strings", ylabel="time of a sample, \u00b5s")
    ax.set_xticks(COUNTS, [str(n) for n in COUNTS])
    ax.set_xticks([], minor=True)
    log_axis(ax)
    legend(ax)
    made.savefig(path, dpi=70)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="*", help=f"of {', '.join(STUDIES)}; all if none is given")
    parser.add_argument("--seconds", type=float, default=0.2)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--chart", type=Path, help="picture of time against strings to write, with `strings`")
    args = parser.parse_args()
    print(
        f"{FS:g} Hz, one core, {instruction_set()}, {args.seconds:g} s of sound, the quickest of {args.rounds} rounds\n"
    )
    for name in args.studies or list(STUDIES):
        found = measure(STUDIES[name], args.seconds, args.rounds)
        print(
            f"| {name} | modes | us a sample | x real time | ns a mode and sample | load s |\n|---|---|---|---|---|---|"
        )
        for scene, row in found.items():
            us = row["us"]
            print(
                f"| {scene} | {row['modes']:.0f} | {us:.2f} | {1e6 / FS / us:.2f} | {1e3 * us / row['modes']:.2f} "
                f"| {row['load']:.2f} |"
            )
        print()
        if name == "strings" and args.chart:
            draw({scene: row["us"] for scene, row in found.items()}, args.chart)
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
