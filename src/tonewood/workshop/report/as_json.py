"""Facts as JSON: everything that the page shows, as plain values, without sounds and pictures."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from tonewood.workshop.report.comparison import Comparison, finite
from tonewood.workshop.report.facts import BodyMode, InstrumentFacts, NoteRow, StringRow
from tonewood.workshop.report.summary import changes, key_figures
from tonewood.workshop.report.tones import Tone


def to_json(comparison: Comparison) -> dict[str, Any]:
    """A comparison, ``tonewood-compare/1``, or of one instrument a report, ``tonewood-report/1``; infinity is null."""
    alone = len(comparison.instruments) == 1
    common: dict[str, Any] = {
        "schema": f"tonewood-{'report' if alone else 'compare'}/1",
        "duration": comparison.duration,
        "velocity_midi": comparison.velocity_midi,
        "instruments": [_instrument(facts) for facts in comparison.instruments],
        "modes": [
            {
                "modes": [None if mode is None else _mode(mode) for mode in match.modes],
                "cents": [match.cents(i) for i in range(len(match.modes))],
            }
            for match in comparison.modes
        ],
        "notes": [
            {"string": m.string, "stop": m.stop, "notes": [None if n is None else _note(n) for n in m.notes]}
            for m in comparison.notes
        ],
        "wolf_notes": [
            [None if w is None else asdict(w) | {"stops": list(w.stops)} for w in match.wolves]
            for match in comparison.wolves
        ],
    }
    if alone:
        return common
    common["changes"] = [
        [asdict(row) | {"times": row.times} for row in changes(comparison, i)]
        for i in range(1, len(comparison.instruments))
    ]
    if comparison.sweep:
        common["sweep"] = {"key": comparison.sweep, "rows": [
            {"value": value, "label": facts.label, "figures": {k: v for k, (v, _) in key_figures(facts).items()}}
            for value, facts in comparison.swept()
        ]}  # fmt: skip
    rows = [{"key": row.key, "values": list(row.values), "unit": row.unit} for row in comparison.parameters]
    return {**common, "parameters": rows}


def _instrument(facts: InstrumentFacts) -> dict[str, Any]:
    return {
        "label": facts.label,
        "called": facts.called,
        "named_modes": {name: facts.body_modes[k].freq for name, k in facts.named.items()},
        "mass": facts.mass,
        "name": facts.name,
        "title": facts.title,
        "licence": facts.licence,
        "description": facts.description,
        "changes": list(facts.changes),
        "added": list(facts.added),
        "unknown": list(facts.unknown),
        "sources": {key: source.model_dump(exclude_none=True) for key, source in facts.sources.items()},
        "stand_ins": dict(facts.stand_ins),
        "provenance": dict(facts.kinds),
        "table_doubts": list(facts.table_doubts),
        "warnings": list(facts.warnings),
        "fs": facts.fs,
        "mobility": {
            "freq": _rounded(facts.freq, 4),
            "level_db": {
                name: _rounded(20 * np.log10(np.maximum(np.abs(y), 1e-12)), 3) for name, y in facts.mobility.items()
            },
        },
        "strings": [_string(s) for s in facts.strings],
        "tones": {name: _tone(tone) for name, tone in facts.tones.items()},
        "missing_tones": dict(facts.missing_tones),
    }


def _mode(mode: BodyMode) -> dict[str, Any]:
    return {key: finite(getattr(mode, key)) for key in ("freq", "q", "t60", "residue", "mass")}


def _note(note: NoteRow) -> dict[str, Any]:
    keys = ("note", "freq", "cents", "cents_mounted", "t60", "tension")
    return {key: getattr(note, key) for key in keys} | {"t60": finite(note.t60)}


def _string(string: StringRow) -> dict[str, Any]:
    return asdict(string) | {"partials": [asdict(p) | {"t60": finite(p.t60)} for p in string.partials]}


def _tone(tone: Tone) -> dict[str, Any]:
    return {
        "string": tone.string,
        "stop": tone.stop,
        "freq": tone.freq,
        "peak_dbfs": finite(tone.peak_dbfs),
        "lufs": finite(tone.lufs),
        "full_scale": tone.full_scale,
        "unit": tone.unit,
        "time": _rounded(tone.time, 4),
        "level_db": _rounded(tone.level_db, 2),
    }


def _rounded(values: Any, digits: int) -> list[float]:
    return [round(float(v), digits) for v in values]
