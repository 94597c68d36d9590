"""Random scenes for the nonlinear solve: instruments of every kind, touched and played in every way, some beyond sense.

A scene is a function of its seed alone, so that a scene that fails is replayed by its number.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tonewood as tw
from tonewood.instrument.bundle.loading import Instrument

Rng = np.random.Generator
#: by the checkout's folders: a scene must not depend on other packages installed
#: those whose strings are played one by one; keys have tests of their own
SHIPPED = sorted(
    path.parent.name
    for path in (Path(__file__).parents[2] / "instruments").glob("*/instrument.yaml")
    if "\nkeys:" not in path.read_text()
)
RATES = (8000, 11025, 16000, 22050, 32000, 44100, 48000, 96000, 192000)
KINDS = ("stiff_string", "tension_modulated_string", "geometric_string")


@dataclass(frozen=True)
class Scene:
    """A score on an instrument: at `fs` Hz for `duration` s."""

    instrument: Instrument
    score: tw.Score
    fs: int
    duration: float

    def renderer(self, *, energy: bool = False) -> tw.Renderer:
        """All effects on; so that strings stretch whatever it costs."""
        return tw.Renderer(
            self.score, self.instrument, self.fs, effects="all", max_duration=self.duration, energy=energy
        )


def log(rng: Rng, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def some(rng: Rng, parts: dict[str, Any], chance: float = 0.4) -> dict[str, Any]:
    """Each with that chance."""
    return {name: part for name, part in parts.items() if rng.random() < chance}


def scene(seed: int, folder: Path, *, samples: int = 600) -> Scene:
    """Scene `seed`, of about so many samples; its body's table goes into `folder`."""
    rng = np.random.default_rng(seed)
    fs = int(rng.choice(RATES))
    made = shipped(rng) if rng.random() < 0.25 else invented(rng, folder, fs)
    duration = samples / fs
    names = made.string_names
    exciters = [None, *made.resolved["exciters"]]
    plugins = {name: part["plugin"] for name, part in made.resolved["exciters"].items()}
    bodily = [name for name, plugin in plugins.items() if plugin == "force_pulse"]
    pluck = plugins.get(made.resolved["playing"]["exciter"] or "") == "pluck_ramp"
    notes = []
    for _ in range(int(rng.integers(1, 7))):
        technique = exciters[int(rng.integers(len(exciters)))]
        force = log(rng, 0.1, 1000) if technique is None and pluck and rng.random() < 0.6 else None
        stop = int(rng.integers(0, 13)) if "stops" in made.resolved and rng.random() < 0.5 else 0
        string = None if technique in bodily else str(rng.choice(names))
        if string is not None:
            stop = min(stop, stops(made, string))
        at, length = float(rng.uniform(0, 0.8 * duration)), float(rng.choice([0.005, 0.02, 0.1]))
        notes.append(
            tw.Note(at, length, string=string, stop=None if string is None else stop, force=force, technique=technique)
        )
    bends = [
        tw.Control(float(rng.uniform(0, duration)), "bend", float(rng.choice([-100.0, 200.0, 2400.0])))
        for _ in range(int(rng.integers(0, 3)))
    ]
    return Scene(made, tw.Score(notes, bends), fs, duration)


def stops(made: Instrument, string: str) -> int:
    """Highest stop of a string."""
    own = made.resolved["strings"][string].get("stops")
    return int((made.resolved.get("stops") or {}).get("count", 0) if own is None else own)


def shipped(rng: Rng) -> Instrument:
    """A built-in instrument, its strings perhaps of another kind."""
    made = tw.load_instrument(SHIPPED[int(rng.integers(len(SHIPPED)))])
    changes: dict[str, Any] = {}
    for name in made.string_names:
        if made.resolved["strings"][name]["plugin"] == "stiff_string" and rng.random() < 0.5:
            changes[f"strings.{name}.plugin"] = "tension_modulated_string"
            changes[f"strings.{name}.axial_stiffness"] = log(rng, 1e3, 1e6)
    return made.replace({**changes, "tuning.compensate": "none"}) if changes else made


def string(rng: Rng, kind: str, fs: int) -> dict[str, Any]:
    """A string of any length, weight and stiffness."""
    values: dict[str, Any] = {
        "plugin": kind, "note": str(rng.choice(["E1", "A1", "D3", "A4"])), "length": log(rng, 0.1, 1.5),
        "tension": log(rng, 5, 500), "linear_density": log(rng, 1e-4, 1e-2),
        "bending_stiffness": float(rng.choice([0.0, log(rng, 1e-7, 1e-2)])),
        "loss": {
            "law": "woodhouse", "eta_a": log(rng, 1e-2, 3), "eta_f": log(rng, 1e-5, 1e-2),
            "eta_b": log(rng, 1e-4, 0.1),
        },
        "end": "body.bridge", "polarizations": [["z"], ["z", "y"]][int(rng.integers(2))],
        "tilt_deg": float(rng.uniform(-20, 20)), "end_compliance": float(rng.choice([0.0, 1e-6])),
        "freq_upper": float(rng.choice([2000.0, 8000.0, 20000.0])),
    }  # fmt: skip
    # the octave above it keeps a mode below the limit of the rate
    values["tension"] = min(values["tension"], values["linear_density"] * (0.12 * fs * values["length"]) ** 2)
    f0 = (values["tension"] / values["linear_density"]) ** 0.5 / (2 * values["length"])
    values["freq_upper"] = max(values["freq_upper"], 5 * f0)
    if kind != "stiff_string":
        values["axial_stiffness"] = log(rng, 1e2, 1e6)
    if kind == "geometric_string":
        # so does its first longitudinal mode
        highest = values["linear_density"] * (0.35 * fs * values["length"]) ** 2
        if highest > max(1e3, 2 * values["tension"]):
            values["axial_stiffness"] = log(rng, max(1e2, values["tension"]), min(highest, 1e6))
        else:
            values["plugin"] = "tension_modulated_string"
    if values["plugin"] == "geometric_string":
        values["freq_coupled"] = float(rng.choice([500.0, 2000.0]))
    return values


def invented(rng: Rng, folder: Path, fs: int) -> Instrument:
    """Strings of one kind on a body of a few modes, with contacts and all that can play them."""
    n_modes = int(rng.integers(1, 9))
    freq, Q, mass = (
        np.sort(10 ** rng.uniform(1.5, 3.9, n_modes)),
        10 ** rng.uniform(0.7, 3.5, n_modes),
        10 ** rng.uniform(-2, 1, n_modes),
    )
    shape = rng.uniform(-1, 1, n_modes)
    rows = [f"{f:.6g},{q:.4g},{m:.4g},{s:.4g}" for f, q, m, s in zip(freq, Q, mass, shape, strict=True)]
    (folder / "body.csv").write_text("\n".join(["f_Hz,Q,modal_mass,bridge", *rows]))
    kind = KINDS[int(rng.choice(3, p=[0.2, 0.4, 0.4]))]
    strings = {f"S{i}": string(rng, kind, fs) for i in range(int(rng.integers(1, 4)))}
    shortest = min(s["length"] for s in strings.values())
    contact = {
        "stiffness": log(rng, 1e5, 1e13),
        "exponent": float(rng.choice([1.0, 1.5, 2.3])),
        "loss": float(rng.choice([0.0, 0.3, 5.0])),
    }
    frets = rng.random() < 0.5
    board: dict[str, Any] = {
        "plugin": "frets",
        "action_first": log(rng, 1e-5, 1e-3),
        "action_twelfth": log(rng, 1e-4, 3e-3),
        **contact,
    }
    if not frets:
        board = {
            "plugin": "fingerboard", "end_from_bridge": 0.3 * shortest, "action_nut": log(rng, 1e-5, 1e-3),
            "action_end": log(rng, 1e-4, 3e-3), "points": int(rng.integers(4, 20)), **contact,
        }  # fmt: skip
    connections = some(rng, {
        "board": board,
        "barrier": {
            "plugin": "bridge_barrier", "start": 0.0, "stop": 0.02 * shortest, "top": 0.0, "radius": log(rng, 0.3, 3),
            "points": int(rng.integers(3, 12)), "stiffness": log(rng, 1e6, 1e10), "loss": float(rng.choice([0.0, 0.3])),
        },
        "rattle": {
            "plugin": "rattle", "from_bridge": float(rng.uniform(0.1, 0.8)) * shortest, "mass": log(rng, 1e-5, 1e-2),
            "clearance": log(rng, 1e-6, 1e-3), **contact,
        },
    })  # fmt: skip
    place = lambda: {"fraction": float(rng.uniform(0.02, 0.6))}  # noqa: E731
    dynamic = float(rng.choice([0.0, 0.3, 0.8]))
    exciters: dict[str, Any] = {
        "pluck": {
            "plugin": "pluck_ramp", "from_bridge": place(), "ramp_time": float(rng.choice([1e-3, 0.02])),
            "release_time": float(rng.choice([0.0, 2e-4])), "angle_deg": float(rng.uniform(-90, 90)),
        },
        **some(rng, {
            "hammer": {
                "plugin": "hammer", "from_bridge": place(), "velocity": log(rng, 0.1, 10), "mass": log(rng, 1e-4, 1e-2),
                "stiffness": log(rng, 1e4, 1e12), "exponent": float(rng.choice([1.0, 2.5, 4.0])),
                "loss": float(rng.choice([0.0, 0.2])),
            },
            "bow": {
                "plugin": "bow", "from_bridge": place(), "force": log(rng, 0.1, 40), "velocity": log(rng, 0.01, 3),
                "static": dynamic + float(rng.uniform(0, 1)), "dynamic": dynamic, "speed": log(rng, 1e-3, 0.5),
            },
            "plectrum": {
                "plugin": "plectrum", "from_bridge": place(), "stiffness": log(rng, 1e2, 1e5),
                "mass": log(rng, 1e-5, 1e-3), "speed": log(rng, 0.03, 3), "force": log(rng, 0.1, 100),
                "dynamic": float(rng.choice([0.0, 0.5, 1.0])),
            },
            "finger": {
                "plugin": "stopping_finger", "touch": place(), "width": float(rng.choice([0.0, 0.02])),
                "weight": log(rng, 0.1, 100), "force": log(rng, 0.1, 30),
            },
            "slide": {"plugin": "left_hand", "action": "slide", "time": 1e-3},
            "hammer_on": {"plugin": "left_hand", "action": "hammer_on"},
        }, 0.6),
    }  # fmt: skip
    model = str(rng.choice(["ideal", "finger"]))
    values = {
        "schema": "tonewood-instrument/2", "name": "random", "title": "Random", "licence": "CC0-1.0", "sources": {},
        "body": {
            "plugin": "modal_table", "table": "body.csv", "shapes": "points",
            "points": {"bridge": {"direction": [0.0, 0.6, 0.8]}},
        },
        "strings": strings, "connections": connections, "exciters": exciters,
        "stops": {"kind": "frets" if frets else "continuous", "count": 15, "model": model},
        "playing": {"exciter": "pluck", "velocity": {"parameter": "pluck.force", "low": 0.1, "high": 10.0}},
        "tuning": {"compensate": "none"},
        "outputs": [
            {"name": "bridge", "plugin": "point_pickup", "quantity": "velocity", "at": "body.bridge", "full_scale": 1.0}
        ],
    }  # fmt: skip
    return Instrument.from_values(values, folder)
