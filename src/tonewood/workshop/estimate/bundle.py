"""The bundle of an estimate: a copy of the initial one with the estimated figures and their origin."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.new_bundle import new_bundle
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.support.whole_files import folder_whole, write_whole
from tonewood.workshop.estimate import laws
from tonewood.workshop.estimate.as_json import to_json
from tonewood.workshop.estimate.estimate import Estimate
from tonewood.workshop.estimate.figures import split_key
from tonewood.workshop.estimate.playing import strings_of

UNKNOWN = "unknown"
#: key of the recordings among a bundle's sources
SOURCE = "recordings"
#: preset with the share of the room
PRESET = "recorded"
#: figures and all that is known of them, beside the manifest
RESULT = "estimate.json"


@dataclass(frozen=True)
class RecordingOrigin:
    """Where recordings come from: what was recorded, who did it, SPDX name of their licence, address."""

    title: str = UNKNOWN
    recorded_by: str = UNKNOWN
    licence: str = UNKNOWN
    url: str | None = None


def write_bundle(
    estimate: Estimate, folder: Path, source: str, origin: RecordingOrigin, *, allow_code: bool = False
) -> Instrument:
    """Write the bundle of an estimate.

    estimate : its result.
    folder : to make; its last part is the instrument's name.
    source : the instrument begun with, by name or folder.
    origin : of the recordings.
    allow_code : run plugins that lie in the source's folder.
    Returns The instrument, loaded from its folder: its figures are those of the estimate.
    Raises BundleError, OutputError : as `new_bundle`; nothing stays behind.
    """
    new_bundle(folder, source, allow_code=allow_code)
    with folder_whole(folder):
        manifest = folder / MANIFEST
        text = manifest.read_text(encoding="utf-8")
        if (name := _table_of_keys(text)) is not None:
            table = folder / name
            write_whole(table, _keyed(table.read_text(encoding="utf-8"), estimate))
        write_whole(manifest, _edited(text, estimate, origin))
        write_whole(folder / RESULT, json.dumps(to_json(estimate), indent=1, allow_nan=False) + "\n")
        copy = Instrument.load(folder, allow_code=allow_code)
        if copy.resolved["strings"] != estimate.instrument.resolved["strings"]:
            raise BundleError(
                "the strings written are not those estimated; this bundle's form is not known", file=manifest
            )
        return copy


def _edited(text: str, estimate: Estimate, origin: RecordingOrigin) -> str:
    """Text of a manifest with the figures in it; comments stay."""
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.width, yaml.preserve_quotes = 118, True
    values = yaml.load(text)
    _write_strings(values, estimate)
    now, name = estimate.instrument.resolved, estimate.instrument.spec.playing.default_exciter
    if estimate.figures.place is not None:
        values["exciters"][name]["from_bridge"] = now["exciters"][name]["from_bridge"]
    if (edge := now["exciters"][name].get("edge")) is not None:
        values["exciters"][name]["edge"] = edge
    if estimate.figures.forces is not None and estimate.figures.forces != estimate.start.forces:
        values["playing"]["velocity"].update({k: now["playing"]["velocity"][k] for k in ("low", "high")})
    moved = estimate.figures.moved_modes(estimate.begun_with)
    if "body" in moved:
        values["body"]["moved_modes"] = [_flow(yaml, row) for row in moved["body"]]
    if (room := estimate.room) is not None and room.known:
        preset = _flow(yaml, {"room": room.room, "room_mix_db": room.mix_db})
        values.setdefault("presets", {})[PRESET] = preset
    parts = {part["name"]: part for part in now["outputs"]}
    for part in values["outputs"]:
        if rows := moved.get(f"outputs.{part['name']}"):
            part["moved_modes"] = [_flow(yaml, row) for row in rows]
        bands = parts[part["name"]]["equalizer"]
        if bands:
            part["equalizer"] = [_flow(yaml, {k: v for k, v in band.items() if v is not None}) for band in bands]
    values["title"] = f"{values['name']}, estimated from recordings: {origin.title}"
    source_entry = {
        "text": f"{origin.title}; recorded by {origin.recorded_by}",
        **({} if origin.url is None else {"url": origin.url}),
        "licence": origin.licence,
        "changes": f"{len(estimate.notes)} single notes analysed; no recording is part of this bundle",
    }
    values["sources"].insert(0, SOURCE, source_entry)  # comments hang on the last one
    for path, note in _provenance(estimate).items():
        values["provenance"][path] = _flow(yaml, {"kind": "estimated", "source": SOURCE, "note": note})
    stream = io.StringIO()
    yaml.dump(values, stream)
    return stream.getvalue()


def _table_of_keys(text: str) -> str | None:
    """Name of the file with a row for each key, if a manifest has one: the spec holds its rows as entries."""
    from ruamel.yaml import YAML

    keys = YAML(typ="safe").load(text).get("keys")
    return None if keys is None else keys.get("table")


def _flow(yaml: Any, values: Mapping[str, Any]) -> Any:
    """A mapping that is written in braces."""
    mapping = yaml.map(**values)
    mapping.fa.set_flow_style()
    return mapping


def _write_strings(values: Any, estimate: Estimate) -> None:
    """Figures of strings into the values of a manifest; those of a table of keys are not there."""
    now, key = estimate.instrument.resolved["strings"], split_key(estimate.begun_with)
    strings = values["strings"]
    for lead, law in estimate.figures.laws.items():
        for name in strings_of(estimate.instrument, lead):
            if name not in strings:
                continue
            part = strings[name]
            if law.names:
                if "loss" in part:
                    part["loss"].update(now[name]["loss"])
                else:
                    part["loss"] = dict(now[name]["loss"])
            if estimate.figures.bending[lead] > 0:
                part["bending_stiffness"] = now[name]["bending_stiffness"]
            if estimate.figures.split is not None:
                first, _, second = key.partition(".")
                if second:
                    part[first] = dict(now[name][first])
                else:
                    part[first] = now[name][first]


def _keyed(text: str, estimate: Estimate) -> str:
    """A table of keys with the figures of their strings; comments stay, columns that are missing are added."""
    rows = text.splitlines()
    head = [row for row in rows if row.startswith("#") or not row.strip()]
    table = list(csv.DictReader([row for row in rows if row.strip() and not row.startswith("#")]))
    now = estimate.instrument.resolved["strings"]
    entries = estimate.instrument.spec.keys
    assert entries is not None
    by_note = {entry.note: entry.strings[0] for entry in entries.entries.values()}
    for row in table:
        lead = by_note.get(row["note"])
        if lead is None or lead not in estimate.figures.laws:
            continue
        for parameter in estimate.figures.laws[lead].names:
            row[f"string.loss.{parameter}"] = repr(now[lead]["loss"][parameter])
        if estimate.figures.bending[lead] > 0:
            row["string.bending_stiffness"] = repr(now[lead]["bending_stiffness"])
    columns = list(dict.fromkeys(name for row in table for name in row))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(table)
    return "\n".join([*head, stream.getvalue()])


def _provenance(estimate: Estimate) -> dict[str, str]:
    """Path -> note, of all figures that were estimated."""
    out = {}
    figures = estimate.figures
    for lead in figures.laws:
        interval = estimate.intervals.get(lead)
        if interval is None:
            how = "no notes of its own tell it: it follows the neighbouring strings"
        else:
            spread = ", ".join(
                f"{100 * s:.0f} % at {f / 1000:g} kHz" for f, s in zip(laws.STATED, interval.spread, strict=True)
            )
            how = f"decay rate known within {spread} (90 %); single parameters trade with each other"
        if estimate.begun_with.spec.keys is None or lead in estimate.intervals:
            out[f"strings.{lead}.loss"] = how
    out["strings.*.bending_stiffness"] = "median of B over the notes of a string"
    if figures.split is not None:
        out[f"strings.*.{split_key(estimate.begun_with)}"] = "from the modulation of partials"
    if figures.place is not None:
        exciter = estimate.instrument.spec.playing.default_exciter
        scatter = "" if estimate.places is None else f"; notes scatter by {1000 * estimate.places.scatter:.0f} mm"
        out[f"exciters.{exciter}.from_bridge"] = f"median of combs in the levels of partials{scatter}"
    if figures.edge != estimate.start.edge:
        exciter = estimate.instrument.spec.playing.default_exciter
        out[f"exciters.{exciter}.edge"] = "from the change of brightness from soft to loud strokes"
    if figures.forces != estimate.start.forces:
        out["playing.velocity"] = "range of forces from the peaks of soft and loud strokes; their middle is begun with"
    for path in figures.moved_modes(estimate.begun_with):
        out[f"{path}.moved_modes"] = "frequency and Q from what rings below high notes; modal masses are begun with"
    if estimate.room is not None and estimate.room.known:
        out[f"presets.{PRESET}"] = "from the level between partials, to which noise adds: an upper limit"
    for name, curve in figures.gains.items():
        if np.any(curve):
            out[f"outputs.{name}.equalizer"] = "smooth gain: microphone, room, nail and release in one, without a level"
    return out
