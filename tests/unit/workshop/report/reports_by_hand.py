"""Instruments and comparisons of reports whose values are worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tonewood.instrument.inspection.frequencies import StringFeel
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.workshop.report import comparison
from tonewood.workshop.report.comparison import Comparison, match_modes
from tonewood.workshop.report.facts import BodyMode, InstrumentFacts, NoteRow, PartialRow, StringRow
from tonewood.workshop.report.tones import Tone

FREQ = np.geomspace(40.0, 10000.0, 241)


def mode(freq: float, q: float = 20.0, mass: float = 0.1, shape: tuple[complex, ...] = (1.0,)) -> BodyMode:
    return BodyMode(freq, q, math.log(1000) * q / (math.pi * freq), 1 / mass, mass, np.array(shape, dtype=complex))


def wolf(string: str, low: float, high: float, severity: float, stops: tuple[int, ...] = ()) -> WolfNote:
    return WolfNote(string, low, high, (low + high) / 2, 0.5, 50.0, severity, low, stops)


def note(string: str, stop: int, t60: float = 1.0, name: str = "A2") -> NoteRow:
    return NoteRow(string, stop, name, 110.0, 0.5, 0.25 * stop, t60, 60.0)


def tone(name: str, lufs: float = -20.0, level: tuple[float, ...] = (-10.0, -5.0, -30.0), **other: Any) -> Tone:
    values: dict[str, Any] = {
        "note": name, "string": "A", "stop": 0.0, "freq": 110.0, "samples": np.full((480, 1), 0.5), "fs": 4800,
        "time": np.arange(3) / 10, "level_db": np.array(level), "peak_dbfs": -6.0, "lufs": lufs,
        "full_scale": 1.0, "unit": "Pa",
    }  # fmt: skip
    return Tone(**values | other)


def facts(label: str = "A", **other: Any) -> InstrumentFacts:
    """Of one string A and modes at 100 and 200 Hz."""
    feel = StringFeel(0.1, 1.0, None, None)
    string = StringRow("A", "A2", 0.65, 1e-3, 60.0, 61.0, "pitch", 12, feel, (PartialRow(1, 110.0, 0.0, math.inf),))
    values: dict[str, Any] = {
        "label": label, "called": "", "name": "box", "title": "A box", "licence": "CC0-1.0", "description": "",
        "folder": "", "changes": (), "added": (), "sources": {}, "stand_ins": {}, "unknown": (), "kinds": {},
        "table_doubts": (), "warnings": (), "fs": 48000.0, "body_modes": (mode(100.0), mode(200.0)), "named": {},
        "mass": None, "surface": None, "surface_modes": None, "freq": FREQ, "mobility": {"A": 0.01 + 0j * FREQ},
        "strings": (string,), "notes": (note("A", 0), note("A", 1)), "wolves": (), "tones": {}, "missing_tones": {},
        "parameters": {},
    }  # fmt: skip
    return InstrumentFacts(**values | other)


def compared(*instruments: InstrumentFacts, **other: Any) -> Comparison:
    values: dict[str, Any] = {
        "instruments": instruments, "modes": match_modes([f.body_modes for f in instruments]),
        "wolves": comparison.match_wolves([f.wolves for f in instruments]),
        "notes": comparison.match_notes([f.notes for f in instruments]), "parameters": (), "tones": (),
        "duration": 2.0, "velocity_midi": 80.0,
    }  # fmt: skip
    return Comparison(**values | other)
