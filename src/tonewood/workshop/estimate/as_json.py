"""An estimate as plain values: figures, intervals, distances, notes; numbers that are not finite become None."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from tonewood.support.plain_values import finite
from tonewood.workshop.estimate import gain, laws
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.estimate.estimate import Estimate, Half
from tonewood.workshop.estimate.pluck import Louder


def to_json(estimate: Estimate) -> dict[str, Any]:
    """Return everything but the sounds."""
    figures = estimate.figures
    plain: dict[str, Any] = finite({
        "begun_with": estimate.begun_with.name,
        "strings": {name: _string(estimate, name) for name in figures.laws},
        "place": {
            "value": figures.place, "before": estimate.start.place,
            **({} if (p := estimate.places) is None else {"scatter_m": p.scatter, "notes": p.notes}),
        },
        "split_cents": {"value": figures.split, "before": estimate.start.split},
        "gain_db": {"freq_Hz": gain.KNOTS, **figures.gains, "90 %": estimate.gain_interval},
        "louder": None if estimate.louder is None else [_louder(row) for row in estimate.louder],
        "edge_m": {"value": figures.edge, "before": estimate.start.edge},
        "forces_N": {"value": figures.forces, "before": estimate.start.forces},
        "body_modes": [asdict(mode) for mode in estimate.body_modes],
        "moved_modes": [
            {"near_Hz": near, "freq_ratio": f, "q_ratio": q} for near, (f, q) in sorted(figures.modes.items())
        ],
        "room": None if estimate.room is None else asdict(estimate.room),
        "distances": {
            "all notes": {"before": estimate.before.as_dict(), "after": estimate.after.as_dict()},
            "held back": [_half(half) for half in estimate.halves],
            "scale": {name: row.as_dict() for name, row in estimate.scale.items() if row.notes},
        },
        "notes": [
            {
                "file": p.recording.file, "note": p.recording.note, "string": p.string, "stop": p.stop,
                "f0_Hz": a.f0, "B": a.b, "partials": len(a.partials), "onset_s": a.onset,
                "rise_s": a.rise,
            }
            for p, a in zip(estimate.notes, estimate.recorded, strict=True)
        ],
        "moved": list(estimate.moved),
        "warnings": list(estimate.warnings),
    })  # fmt: skip
    return plain


def _string(estimate: Estimate, name: str) -> dict[str, Any]:
    law, interval = estimate.figures.laws[name], estimate.intervals.get(name)
    spread = estimate.b_spread.get(name)
    out: dict[str, Any] = {
        "loss": dict(zip(law.names, law.values, strict=True)),
        "bending_stiffness": estimate.figures.bending[name],
        "bending_stiffness_before": estimate.start.bending[name],
        "own_notes": bool(estimate.figures.estimated.get(name)),
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
