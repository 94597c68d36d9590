"""An estimate as plain values: figures, intervals, distances, notes; numbers that are not finite become None."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from tonewood.support.plain_values import finite
from tonewood.workshop.estimate import gain, laws
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.estimate.estimate import Estimate, Half
from tonewood.workshop.estimate.pluck import Louder


def to_json(found: Estimate) -> dict[str, Any]:
    """Return everything but the sounds."""
    figures = found.figures
    plain: dict[str, Any] = finite({
        "begun_with": found.begun_with.name,
        "strings": {name: _string(found, name) for name in figures.laws},
        "place": {
            "value": figures.place, "before": found.start.place,
            **({} if found.places is None else {"scatter_m": found.places.scatter, "notes": found.places.notes}),
        },
        "split_cents": {"value": figures.split, "before": found.start.split},
        "gain_db": {"freq_Hz": gain.KNOTS, **figures.gains, "90 %": found.gain_interval},
        "louder": None if found.louder is None else [_louder(row) for row in found.louder],
        "edge_m": {"value": figures.edge, "before": found.start.edge},
        "forces_N": {"value": figures.forces, "before": found.start.forces},
        "body_modes": [asdict(mode) for mode in found.body_modes],
        "moved_modes": [
            {"near_Hz": near, "freq_ratio": f, "q_ratio": q} for near, (f, q) in sorted(figures.modes.items())
        ],
        "room": None if found.room is None else asdict(found.room),
        "distances": {
            "all notes": {"before": found.before.as_dict(), "after": found.after.as_dict()},
            "held back": [_half(half) for half in found.halves],
            "scale": {name: row.as_dict() for name, row in found.scale.items() if row.notes},
        },
        "notes": [
            {
                "file": p.recording.file, "note": p.recording.note, "string": p.string, "stop": p.stop,
                "f0_Hz": a.f0, "B": a.b, "partials": len(a.partials), "onset_s": a.onset,
                "rise_s": a.rise,
            }
            for p, a in zip(found.notes, found.recorded, strict=True)
        ],
        "moved": list(found.moved),
        "warnings": list(found.warnings),
    })  # fmt: skip
    return plain


def _string(found: Estimate, name: str) -> dict[str, Any]:
    law, interval = found.figures.laws[name], found.intervals.get(name)
    spread = found.b_spread.get(name)
    out: dict[str, Any] = {
        "loss": dict(zip(law.names, law.values, strict=True)),
        "bending_stiffness": found.figures.bending[name],
        "bending_stiffness_before": found.start.bending[name],
        "own_notes": bool(found.figures.estimated.get(name)),
        "rate_1/s": dict(zip(map(str, laws.STATED), law.rate(laws.STATED), strict=True)),
    }
    if interval is not None:
        out["rate_1/s_90 %"] = {str(f): list(pair) for f, pair in zip(laws.STATED, interval.rates.T, strict=True)}
        out["loss_90 %"] = {n: list(pair) for n, pair in zip(law.names, interval.values.T, strict=True)}
        out["bridge_per_period_90 %"] = interval.bridge
        out["trades"] = [{"between": [a, b], "rank_correlation": r} for a, b, r in laws.trades(law, interval)]
    if spread is not None:
        out["B_ratio_90 %"] = {"notes": spread[0], "low": spread[1], "high": spread[2]}
    return out


def _louder(row: Louder) -> dict[str, float]:
    return {"peak_dB": row.peak, "share_3_to_8_kHz_dB": row.bright, "per_7_dB": row.per_7_db, "pairs": row.notes}


def _half(half: Half) -> dict[str, Any]:
    def plain(distance: Distance) -> dict[str, float | int]:
        return distance.as_dict()

    return {"fitted": list(half.fitted), "before": plain(half.before), "after": plain(half.after)}
