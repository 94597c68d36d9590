"""A renderer that needs no engine, and small manifests: decaying sines whose pitch the factors set."""

from __future__ import annotations

import copy
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import NumericalError, TonewoodError
from tonewood.performance.score.note import Note
from tonewood.workshop.batch.conditions import Condition, Draw, vary_notes
from tonewood.workshop.batch.store import Rendered

BASE: dict[str, Any] = {
    "schema": "tonewood-batch/1",
    "name": "damping",
    "seed": 7,
    "instruments": {"harp": "african_harp"},
    "scores": {
        "low": {"phrase": [{"time": 0.0, "freq": 110.0, "force": 1.0}]},
        "high": {"phrase": [{"time": 0.0, "freq": 440.0, "force": 2.0}]},
    },
    "factors": {
        "damping": {"path": "body.t60", "levels": {"complex": 0.5, "proportional": 0.4, "block": 0.3}},
        "pluck": {"path": "body.detune", "levels": {"near": 1.0, "far": 1.01}},
    },
    "stimuli": {"longest": 1.0},
    "pages": [
        {
            "type": "mushra",
            "group_by": ["score", "pluck"],
            "reference": {"damping": "complex"},
            "anchors": [3500],
        },
        {"type": "abx", "group_by": ["score"], "pairs": {"damping": ["complex", "block"]}},
    ],
}


def manifest(**changes: Any) -> dict[str, Any]:
    """The base manifest with top-level keys changed; None takes one out."""
    data = copy.deepcopy(BASE) | copy.deepcopy(changes)
    return {k: v for k, v in data.items() if v is not None}


def write(folder: Path, data: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "batch.yaml"
    path.write_text(json.dumps(data))  # JSON is YAML
    return path


def given(draw: Draw, note: Note) -> float | None:
    value = getattr(note, draw.note_field or "")
    return 0.1 if value is None else value


class FakeRenderer:
    """Sums of decaying sines.

    `sleep` makes each render take that long, `log` counts them in a file, the conditions named in `never` are never
    finished.
    """

    def __init__(self, sleep: float = 0.0, log: Path | None = None, version: str = "1", never: tuple[str, ...] = ()):
        self.sleep, self.log, self.version, self.never = sleep, log, version, never

    def identity(self, condition: Condition) -> dict[str, Any]:
        if condition.overrides.get("body.t60") == "unknown":
            raise TonewoodError("unknown is not a number", key="body.t60")
        return {"asked": condition.asked(), "bundle": condition.bundle, "version": self.version, "isa": "any"}

    def own_value(self, condition: Condition, path: str) -> Any:
        if not path.startswith(("body.", "render.")):
            raise TonewoodError("is not a known key", key=path)
        return condition.overrides.get(path, 0.5)

    def predict(self, condition: Condition) -> float:
        return 0.5

    def render(self, condition: Condition) -> Rendered:
        if self.log is not None:
            with self.log.open("a") as stream:
                stream.write(condition.name + "\n")
        time.sleep(self.sleep)
        while condition.name in self.never:
            time.sleep(1.0)
        t60 = condition.overrides.get("body.t60", 0.5)
        if t60 == "unstable":
            raise NumericalError("not finite at 0.1 s")
        if t60 == "bug":
            raise ZeroDivisionError("a plugin's mistake")
        if t60 == "silent":
            return Rendered(np.zeros((100, 1)), 48000)
        if t60 in ("empty", "flat"):
            return Rendered(np.ones((0, 1) if t60 == "empty" else 100), 48000)
        if t60 == "nan":
            return Rendered(np.full((100, 1), np.nan), 48000)
        fs = condition.render.fs
        notes = vary_notes(condition.notes or (), condition.draws, given)
        t = np.arange(round((max(n.time for n in notes) + 2 * t60) * fs)) / fs
        sound = np.zeros(len(t))
        for note in notes:
            u = np.maximum(t - note.time, 0.0)
            freq = (note.freq or 220.0) * condition.overrides.get("body.detune", 1.0)
            sound += 0.05 * (note.force or 1.0) * np.exp(-6.9 * u / t60) * np.sin(2 * np.pi * freq * u)
        return Rendered(sound[:, None], fs, {"energy_residual": 1e-12, "effects": ["all"]})
