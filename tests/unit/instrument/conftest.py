"""A small instrument written out, whose body every test can change."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tonewood.instrument.bundle.loading import Instrument

BODY = "f_Hz,Q,modal_mass,bridge,wing\n182,25,0.60,1,0.4\n315,30,0.40,1,-0.7\n640,35,0.30,1,0.2\n"
LOSS = {"law": "sigma", "sigma0": 0.6, "sigma1": 2e-4}
SMALL: dict[str, Any] = {
    "schema": "tonewood-instrument/2",
    "name": "small",
    "title": "Two strings on a box",
    "licence": "CC-BY-4.0",
    "sources": {},
    "body": {
        "plugin": "modal_table",
        "table": "body.csv",
        "shapes": "points",
        "points": {"bridge": {"direction": "z"}, "wing": {"direction": "z"}},
    },
    "strings": {
        "defaults": {
            "plugin": "stiff_string",
            "length": 0.65,
            "bending_stiffness": 4e-5,
            "loss": LOSS,
            "end": "body.bridge",
            "freq_upper": 4000,
        },
        "A2": {"note": "A2", "tension": 73.9, "linear_density": 3.61e-3, "tilt_deg": 12, "split_cents": 4},
        "D3": {"note": "D3", "tension": 71.2, "linear_density": 1.95e-3, "polarizations": ["z"]},
    },
    "stops": {"kind": "frets", "count": 12},
    "exciters": {
        "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.105},
        "tap": {"plugin": "force_pulse", "at": "body.wing"},
    },
    "playing": {"controls": {"cc74": {"parameter": "pluck.from_bridge", "low": 0.03, "high": 0.25}}},
    "outputs": [
        {
            "name": "bridge",
            "plugin": "point_pickup",
            "quantity": "acceleration",
            "at": "body.bridge",
            "full_scale": 500,
        },
        {"name": "wing", "plugin": "point_pickup", "quantity": "velocity", "at": "body.wing", "full_scale": 1.0},
    ],
}

Make = Callable[..., Instrument]


@pytest.fixture
def values() -> dict[str, Any]:
    return copy.deepcopy(SMALL)


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """An instrument from values (the small one's where none are given)."""
    (tmp_path / "body.csv").write_text(BODY)

    def build(values: dict[str, Any] | None = None) -> Instrument:
        return Instrument.from_values(copy.deepcopy(SMALL) if values is None else values, tmp_path)

    return build
