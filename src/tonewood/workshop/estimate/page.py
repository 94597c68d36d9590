"""Report of an estimate: one HTML page without network, with sounds and spectrograms of notes held back."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np

from tonewood.instrument.scales import note_name
from tonewood.sound.files.audio import flac_bytes
from tonewood.support.arrays import Floats
from tonewood.support.page.offline import offline_page
from tonewood.support.plotting import data_uri
from tonewood.workshop.estimate import laws
from tonewood.workshop.estimate.bundle import PRESET, RecordingOrigin
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.estimate.estimate import Estimate
from tonewood.workshop.estimate.pictures import gain_picture, rates_picture, spectrograms
from tonewood.workshop.estimate.recordings import FS
from tonewood.workshop.estimate.spectra import find_onset

#: notes held back that are heard, from each half; s before the onset, of a sound, and of its fade
_HEARD, _BEFORE, _LENGTH, _FADE = 3, 0.03, 3.0, 0.05
#: rms and largest sample of the sounds
_RMS, _PEAK = 0.08, 0.9


def page(estimate: Estimate, origin: RecordingOrigin, name: str) -> str:
    """Page of an estimate; every text of a file is escaped. Raises TonewoodError : jinja2 is not installed."""
    template = (files("tonewood.workshop.estimate") / "page.html").read_text(encoding="utf-8")
    columns = columns_of(estimate)
    return offline_page(
        template,
        estimate=estimate,
        origin=origin,
        title=f"{name}, estimated from recordings",
        warnings=estimate.warnings,
        columns={key: row.as_dict() for key, row in columns.items()},
        labels=Distance.LABELS,
        scale=any(row.notes for row in estimate.scale.values()),
        tones=[_tone(estimate, half, i) for half, i in heard(estimate)],
        stated=laws.STATED,
        strings=[_string(estimate, lead) for lead in shown_strings(estimate)],
        rates_picture=rates_picture(estimate, shown_strings(estimate)),
        parameters=[row for lead in estimate.intervals for row in _parameters(estimate, lead)],
        gain_picture=gain_picture(estimate),
        place=place_line(estimate),
        split=split_line(estimate),
        louder=louder_line(estimate),
        modes=mode_lines(estimate),
        room=room_line(estimate),
        rows=list(zip(estimate.notes, estimate.recorded, strict=True)),
        note_name=note_name,
    )


def columns_of(estimate: Estimate) -> dict[str, Distance]:
    """Distances by the heading of their column: held-back halves, all notes, and the scale."""
    columns: dict[str, Distance] = {}
    for i, half in enumerate(estimate.halves, 1):
        columns |= {f"held back {i}: before": half.before, f"held back {i}: after": half.after}
    columns |= {"all: before": estimate.before, "all: after": estimate.after}
    return columns | {name: row for name, row in estimate.scale.items() if row.notes}


def shown_strings(estimate: Estimate) -> list[str]:
    """Strings of a table: all, or of many those whose own notes tell them."""
    names = list(estimate.figures.laws)
    return names if len(names) <= 12 else [name for name in names if name in estimate.intervals]


def place_line(estimate: Estimate) -> str:
    """Place of the pluck, with its scatter over notes; empty where it was not estimated."""
    if estimate.figures.place is None or estimate.start.place is None:
        return ""
    places = estimate.places
    scatter = "" if places is None else f"; places of single notes scatter by {1e3 * places.scatter:.0f} mm"
    return f"Place of the pluck: {estimate.figures.place:.4g}, begun with {estimate.start.place:.4g}{scatter}."


def split_line(estimate: Estimate) -> str:
    """Splitting of the polarizations; empty where strings have one."""
    if estimate.figures.split is None or estimate.start.split is None:
        return ""
    return (
        f"Splitting of the polarizations: {estimate.figures.split:.2g} cents (standard deviation), begun with "
        f"{estimate.start.split:.2g}; from the modulation of partials, to which body and room add theirs."
    )


def louder_line(estimate: Estimate) -> str:
    """What playing louder changes; empty without pairs of soft and loud."""
    if estimate.louder is None:
        return ""
    shown = [
        f"{who} {row.bright:+.1f} dB of 3 to 8 kHz"
        + (f" and {row.peak:+.1f} dB of peak" if np.isfinite(row.peak) else " (peaks were normalised)")
        for who, row in zip(("recorded", "computed"), estimate.louder, strict=True)
    ]
    figures, start, moved = estimate.figures, estimate.start, ""
    if figures.edge is not None and start.edge is not None and figures.edge != start.edge:
        moved = f" Edge of the finger: {1e3 * figures.edge:.2g} mm, begun with {1e3 * start.edge:.2g} mm"
        if figures.forces != start.forces and figures.forces is not None and start.forces is not None:
            ends = [f"{low:.3g} to {high:.3g} N" for low, high in (figures.forces, start.forces)]
            moved += f"; forces at velocity 1 and 127: {ends[0]}, begun with {ends[1]}"
        moved += "."
    return f"From soft to loud, {estimate.louder[0].notes} pairs: {'; '.join(shown)}.{moved}"


def mode_lines(estimate: Estimate) -> list[str]:
    """Body modes that the notes tell, and what was moved."""
    out = []
    for mode in estimate.body_modes:
        (low, high), (least, most) = mode.freq_interval, mode.q_interval
        ratios = estimate.figures.modes.items()
        near = [f for f, (ratio, _) in ratios if abs(np.log(f * ratio / mode.freq)) < np.log(1.1)]
        moved = "not moved: no mode of the bundle's tables sounds near it"
        if near:
            by_freq, by_q = estimate.figures.modes[near[0]]
            moved = f"frequency of the bundle's mode at {near[0]:.4g} Hz times {by_freq:.4g}, Q times {by_q:.3g}"
        figures = f"{mode.freq:.4g} Hz ({low:.4g} to {high:.4g}), Q {mode.q:.2g} ({least:.2g} to {most:.2g})"
        out.append(f"Body mode at {figures}: {moved}.")
    return out


def room_line(estimate: Estimate) -> str:
    """Share of the room; empty where none is told."""
    room = estimate.room
    if room is None:
        return ""
    low, high = room.interval
    if not room.known:
        return f"Room: not told by these notes; a mix of {low:+.1f} to {high:+.1f} dB of {room.room} would do."
    return (
        f"Room: preset {PRESET}, {room.room} with a mix of {room.mix_db:+.1f} dB ({low:+.1f} to {high:+.1f}), an upper "
        f"limit as noise counts, too. Misfit of levels between partials: {room.dry:.1f} dB, with it {room.wet:.1f} dB, "
        f"{room.notes} notes."
    )


def heard(estimate: Estimate) -> list[tuple[int, int]]:
    """Half and number of the held-back notes that are heard: low, middle and high ones of each half."""
    out = []
    for h, half in enumerate(estimate.halves):
        indices = sorted(half.held_back, key=lambda i: estimate.notes[i].recording.note)
        places = np.linspace(0, len(indices) - 1, min(_HEARD, len(indices))).round().astype(int)
        out += [(h, indices[k]) for k in dict.fromkeys(places.tolist())]
    return sorted(out, key=lambda row: estimate.notes[row[1]].recording.note)


def _tone(estimate: Estimate, half: int, i: int) -> dict[str, Any]:
    """Sounds and spectrograms of one note."""
    played, now = estimate.notes[i], estimate.halves[half]
    labels = ("recorded", "estimated", estimate.begun_with.name)
    raw = (played.recording.samples, now.sounds[i], now.begun[i])
    sounds = dict(zip(labels, (_cut(x, played.recording.freq) for x in raw), strict=True))
    length = min(map(len, sounds.values()))
    sounds = {label: _faded(x[:length]) for label, x in sounds.items()}
    return {
        "name": f"{played.name}, string {played.string}, stop {played.stop:g}",
        "sounds": [
            {"label": label, "uri": data_uri(flac_bytes(x[:, None], FS), "audio/flac")} for label, x in sounds.items()
        ],
        "spectrogram": spectrograms(played.name, sounds),
    }


def _cut(x: Floats, freq: float) -> Floats:
    """A sound from 30 ms before its onset, at one rms over its first second, as far as its peak allows."""
    first = find_onset(x, freq)[0] - round(_BEFORE * FS)
    piece = np.concatenate([np.zeros(max(-first, 0)), x[max(first, 0) :]])[: round(_LENGTH * FS)]
    rms = float(np.sqrt(np.mean(piece[:FS] ** 2)))
    return np.asarray(piece * min(_RMS / rms, _PEAK / float(np.abs(piece).max())))


def _faded(x: Floats) -> Floats:
    n = min(len(x), round(_FADE * FS))
    return np.concatenate([x[: len(x) - n], x[len(x) - n :] * np.linspace(1, 0, n)])


def _string(estimate: Estimate, lead: str) -> dict[str, Any]:
    law, interval = estimate.figures.laws[lead], estimate.intervals.get(lead)
    before, after = estimate.start.bending[lead], estimate.figures.bending[lead]
    spreads = [None] * len(laws.STATED) if interval is None else interval.spread.tolist()
    return {
        "name": lead,
        "count": sum(p.string == lead for p in estimate.notes),
        "b": after / before if before > 0 else None,
        "rates": list(zip(law.rate(laws.STATED).tolist(), spreads, strict=True)),
        "own": bool(estimate.figures.estimated.get(lead)),
    }


def _parameters(estimate: Estimate, lead: str) -> list[dict[str, str]]:
    law, interval = estimate.figures.laws[lead], estimate.intervals[lead]
    pairs = laws.trades(law, interval)
    rows = []
    for j, name in enumerate(law.names):
        others = [(b if a == name else a, r) for a, b, r in pairs if name in (a, b)]
        low, high = interval.values[:, j]
        rows.append({
            "string": lead, "name": name, "value": f"{law.values[j]:.2g}", "low": f"{low:.2g}", "high": f"{high:.2g}",
            "trades": ", ".join(f"{other} ({r:.2f})" for other, r in others).replace("-", "\N{MINUS SIGN}"),
        })  # fmt: skip
    return rows
