"""Conditions and manifests of batches whose values are worked out by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import batch_fakes as fakes

from tonewood.workshop.batch.conditions import expand
from tonewood.workshop.batch.layout import Group, Stimulus, Trial, lay_out
from tonewood.workshop.batch.manifest import Manifest, check_manifest
from tonewood.workshop.batch.production import (
    SoundFile,
)

HERE = Path(__file__).parent


STAIRS = {
    "type": "staircase", "path": "body.t60", "of": {"score": "low", "damping": "block", "pluck": "near"},
    "scale": "percent", "start": 40.0, "lowest": 1.0, "highest": 80.0,
}  # fmt: skip


def manifest(**changes: Any) -> Manifest:
    return check_manifest(fakes.manifest(**changes))


def laid(**changes: Any) -> tuple[Manifest, Any, tuple[Group, ...], list[str]]:
    made = manifest(**changes)
    conditions = expand(made, HERE)
    groups, notes = lay_out(made, conditions)
    return made, {c.name: c for c in conditions}, groups, notes


def group(name: str, page: int, *trials: tuple[str, ...]) -> Group:
    """A group of trials whose codes begin with the reference."""
    codes = list(dict.fromkeys(code for trial in trials for code in trial))
    stimuli = tuple(Stimulus(code, f"of {code}") for code in codes)
    made = tuple(Trial(f"{name}{i}", name, codes[0], tuple(codes[1:])) for i, codes in enumerate(trials))
    return Group(name, page, {}, stimuli, made)


def sound_file(code: str, **changes: Any) -> SoundFile:
    values: dict[str, Any] = {
        "code": code, "group": "g", "condition": f"of {code}", "role": "sound", "key": "k", "file": f"{code}.wav",
        "fs": 48000, "channels": 1, "subtype": "PCM_16", "frames": 60000, "gain_db": 1.0, "page_drop_db": 0.5,
        "lufs": -23.456, "momentary_lufs": -20.0, "loudness_gated": True, "peak_dbfs": -3.0, "true_peak_dbtp": -2.345,
        "sha256": "ab",
    }  # fmt: skip
    return SoundFile(**values | changes)
