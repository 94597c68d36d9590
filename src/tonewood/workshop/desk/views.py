"""What is seen of a model, as plain data for the page: mobility, shapes, partials, wolf notes, forces, differences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.frequencies import bridge_mobility, partials
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_name
from tonewood.performance.score.note import Note, Score
from tonewood.physics.plate.outline import inside
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer
from tonewood.workshop.desk.differences import MOST_MODES
from tonewood.workshop.report.facts import body_modes, frequencies

Floats = NDArray[np.float64]

#: partials of a string, and points of a curve on the page at most
_PARTIALS, _MOST_POINTS = 20, 2500
#: s of the force that is shown
_FORCE = 0.06


def mobility(model: Model) -> dict[str, Any]:
    """Mobility of the body at every string's end, and its modes.

    Returns freq : Hz; db : string -> dB re 1 (m/s)/N; modes : Hz, Q and mass (kg) of each, by frequency.
    """
    freq = frequencies(model.body, model.fs)
    if len(freq) > _MOST_POINTS:
        freq = np.unique(freq[np.linspace(0, len(freq) - 1, _MOST_POINTS).astype(int)])
    db = {n: 20 * np.log10(np.maximum(np.abs(y), 1e-12)) for n, y in bridge_mobility(model, freq).items()}
    modes = body_modes(model)
    return {
        "freq": _rounded(freq, 6),
        "db": {name: _rounded(y, 5) for name, y in db.items()},
        "modes": [{"freq": m.freq, "q": _finite(m.q), "mass": _finite(m.mass)} for m in modes[:MOST_MODES]],
        "n_modes": len(modes),
    }


def shape(model: Model, freq: float) -> dict[str, Any]:
    """Shape of the body's mode nearest to a frequency: on its whole surface where that is known, else at strings' ends.

    freq : Hz.
    Raises TonewoodError : the body has no modes.
    """
    modes = body_modes(model)
    if not modes:
        raise TonewoodError("the body has no modes")
    mode = min(modes, key=lambda m: abs(m.freq - freq))
    ends = np.real(mode.shape * np.exp(-1j * np.angle(mode.shape[np.argmax(np.abs(mode.shape))])))
    out: dict[str, Any] = {
        "freq": mode.freq, "q": _finite(mode.q), "mass": _finite(mode.mass), "strings": list(model.groups),
        "ends": _rounded(ends, 4), "label": "", "points": [], "heights": [], "rings": [],
    }  # fmt: skip
    surface = model.instrument.body.sources(model.fs / 2)
    if surface is None or not len(surface.areas):
        return out
    alone = model.instrument.body.basis(model.fs / 2).natural_freq
    k = int(np.argmin(np.abs(alone - mode.freq)))
    heights = surface.volumes[:, k] / surface.areas
    wood = inside(surface.points, surface.rings)
    largest = float(np.quantile(np.abs(heights[wood]), 0.99)) or 1.0
    out |= {
        "label": surface.labels[k] if k < len(surface.labels) else "",
        "points": [_rounded(p, 4) for p in surface.points[wood]],
        "heights": _rounded(np.clip(heights[wood] / largest, -1.5, 1.5), 3),
        "rings": [[_rounded(p, 4) for p in ring[:: max(1, len(ring) // 120)]] for ring in surface.rings],
        "own_freq": float(alone[k]),
    }
    return out


def strings(model: Model) -> list[dict[str, Any]]:
    """Partials of every open string on its body, with their decay (T60, s)."""
    return [
        {
            "string": name,
            "note": note_name(model.strings[name].open_note),
            "partials": [
                {"n": p.number, "freq": p.freq, "cents": p.cents, "t60": _finite(p.t60)}
                for p in partials(model, name, 0, count=_PARTIALS)
            ],
        }
        for name in list(model.groups)[:12]
    ]


def neck(model: Model) -> list[dict[str, Any]]:
    """Stops of every string with their notes' frequencies (Hz), for the picture of wolf notes."""
    return [{"string": name, "freqs": [round(f, 3) for f in model.strings[name].tuning.freqs]} for name in model.groups]


def force(instrument: Instrument, string: str, options: RenderOptions) -> dict[str, Any]:
    """Constraint force between a plucked open string and the body: its first 60 ms, N.

    Raises TonewoodError : there is no such string.
    """
    if string not in instrument.groups:
        raise TonewoodError(f"there is no {string!r}; there is {', '.join(instrument.groups)}", key="string")
    probe = {"name": "desk_force", "plugin": "point_pickup", "quantity": "force", "at": f"{string}.bridge"}
    values = {**instrument.resolved, "outputs": [*instrument.resolved["outputs"], {**probe, "full_scale": 1.0}]}
    probed = Instrument.from_values(values, instrument.folder, instrument.granted, allow_code=instrument.allow_code)
    score = Score([Note(0.0, 1.0, string=string, stop=0, velocity_midi=80.0)])
    settings = options.at(outputs=("desk_force",), gain_db=0.0, max_duration=_FORCE, tail=_FORCE, lead_in=0.01)
    sound = np.concatenate(list(Renderer(score, probed, options=settings).blocks(4096)))[:, 0]
    return {"string": string, "fs": options.fs, "before": 0.01, "force": _rounded(sound, 5)}


def drawing(instrument: Instrument) -> dict[str, Any] | None:
    """Outline and braces of a body that is drawn, and paths of their ends; None of another one.

    instrument : whose body has braces with `start` and `stop`, and a surface with rings.
    """
    values = instrument.resolved["body"]
    braces = values.get("braces")
    if not isinstance(braces, Mapping) or not all(_is_brace(b) for b in braces.values()):
        return None
    drawn = getattr(instrument.body, "drawing", None)
    rings = [] if drawn is None else [ring for ring in (drawn.outline, drawn.hole) if ring is not None]
    bridge = values.get("bridge")
    return {
        "rings": [[_rounded(p, 4) for p in ring[:: max(1, len(ring) // 160)]] for ring in rings],
        "braces": [{"name": name, **_bar(brace)} for name, brace in braces.items()],
        "bridge": _bar(bridge) if _is_brace(bridge) else None,
    }


def _is_brace(value: Any) -> bool:
    return isinstance(value, Mapping) and {"start", "stop", "width"} <= value.keys()


def _bar(value: Mapping[str, Any]) -> dict[str, Any]:
    return {"start": value["start"], "stop": value["stop"], "width": value["width"]}


def _rounded(values: Floats, digits: int) -> list[float]:
    """Numbers with so many significant digits; those that are not finite become 0."""
    return [float(f"{x:.{digits}g}") if math.isfinite(x) else 0.0 for x in np.asarray(values, dtype=float)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
