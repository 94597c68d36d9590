"""A bundle of one's own, begun from another one or from the folder of a fit: text with comments where a person decides.

Nothing in it is credited to anybody who has not said so: values copied from a bundle are of unknown origin until its
maker fills that in, with a note that tells their kind there. The sources stay, since their licences ask for it.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError, OutputError
from tonewood.instrument.bundle.json_schema import bundle_schema
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.migration import bundle_edits
from tonewood.instrument.bundle.schema import SCHEMA
from tonewood.instrument.bundle.string_sets import string_set
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.files import Files
from tonewood.support.whole_files import check_new_folder, write_whole
from tonewood.support.yaml_edit import edit_text
from tonewood.support.yaml_io import load_yaml, parse_yaml

#: file of a fit's folder that holds parts of a bundle
PARTS = "body.yaml"
#: for editors, in the new folder
SCHEMA_FILE = "instrument.schema.json"
MODELINE = f"# yaml-language-server: $schema={SCHEMA_FILE}"

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_PATH = re.compile(r"[A-Za-z_][\w.*]*")
_KEY = re.compile(r"^([A-Za-z_]+):", re.MULTILINE)
#: comments before keys of the file
_DECIDE = {
    "title": "# DECIDE: what is it, in one line?",
    "licence": "# DECIDE: may others use it? An SPDX name such as CC-BY-4.0; the licences of the sources hold as well.",
    "provenance": (
        "# DECIDE: where does each figure come from? measured, estimated, published, computed (these need a source),\n"
        "# authored or stand_in. `tonewood check` lists unknown ones."
    ),
    "body": (
        "# DECIDE: is this the body? `tonewood fit` makes one from a measurement. Masses, springs, dashpots on it go\n"
        "# here as well:  added: [{at: POINT, mass: 0.010}]"
    ),
    "strings": "# DECIDE: scale length, strings (`tonewood list` has sets for strings_from), and where each one ends.",
    "stops": "# DECIDE: frets?",
    "playing": "# DECIDE: how hard is it played? N at the softest and the loudest note.",
    "outputs": "# DECIDE: what is 0 dBFS? `tonewood render` says how loud its loudest sample was.",
}


def new_bundle(folder: Path, source: str, *, strings: str | None = None, allow_code: bool = False) -> Instrument:
    """Make a folder with an instrument that plays at once.

    Parameters
    ----------
    folder : to make; its last part is the instrument's name.
    source : an installed instrument, a bundle's folder, or the folder of a fit.
    strings : named string set; of a fit ej46 where left out, of a bundle its own.
    allow_code : run plugins that lie as Python files in the source's folder.

    Returns
    -------
    The instrument, loaded from its new folder.

    Raises
    ------
    BundleError : the name is no name, the source is none of these, or the bundle made of it cannot be played.
    OutputError : the folder is there already, or cannot be made; nothing stays behind.
    """
    name = folder.name
    if not _NAME.fullmatch(name):
        raise BundleError(
            f"{name!r} cannot be the name of an instrument; letters, digits and _ are allowed", key="NAME"
        )
    check_new_folder(folder)
    source_path = Path(source)
    if not (source_path / registry.MANIFEST).is_file() and (source_path / PARTS).is_file():
        text = _from_fit(name, source_path, strings or "ej46")
        files = _tables(source_path)
        root = source_path.resolve()
    else:
        original = Instrument.load(source, allow_code=allow_code)
        text, root = _from_bundle(name, original, strings), original.folder
        files = [p for p in sorted(root.rglob("*")) if p.is_file() and "__pycache__" not in p.parts]
        files = [p for p in files if p != root / registry.MANIFEST and p.name != SCHEMA_FILE]
    try:
        folder.mkdir()
        for path in files:
            target = folder / path.relative_to(root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        write_whole(folder / SCHEMA_FILE, json.dumps(bundle_schema(), indent=1) + "\n")
        write_whole(folder / registry.MANIFEST, text)
        return Instrument.load(folder, allow_code=allow_code)
    except BaseException as fault:
        with suppress(OSError):
            shutil.rmtree(folder)
        if isinstance(fault, OSError):
            raise OutputError(f"cannot be made: {fault.strerror}", file=folder) from None
        raise


def _from_bundle(name: str, original: Instrument, strings: str | None) -> str:
    """Text of the original with the new name, everything of unknown origin, and comments."""
    manifest = original.folder / registry.MANIFEST
    text = manifest.read_text(encoding="utf-8-sig")
    values = load_yaml(manifest)
    if edits := bundle_edits(values, manifest):
        text = edit_text(text, edits, file=manifest)
    title = f"{name}, begun as a copy of {original.name}: {original.spec.title}"
    provenance = ["provenance:"]
    keys = () if strings is None else _given_by(strings)
    for path in values.get("provenance", {}):  # of the file alone: a string set keeps its own
        entry = original.spec.provenance[path]
        kind, *rest = path.split(".")
        if kind == "strings" and rest[1:2] and rest[1] in keys:
            continue  # the set's own
        source = f", source {entry.source}" if entry.source else ""
        note = f" ({entry.note})" if entry.note else ""
        was = f"copied from {original.name}, where it is {entry.kind}{source}{note}"
        provenance.append(
            f"  {path if _PATH.fullmatch(path) else _quoted(path)}: {{kind: unknown, note: {_quoted(was)}}}"
        )
    changed = {
        "name": f"name: {name}\n",
        "title": f"title: {_quoted(title)}\n",
        "provenance": "\n".join(provenance) + "\n\n" if len(provenance) > 1 else "provenance: {}\n\n",
    }
    head, blocks = _blocks(text)
    if strings is not None:
        string_set(strings)
        blocks = _with_strings(blocks, values, strings)
    lines = [line for line in head.splitlines() if "yaml-language-server" not in line]
    out = [MODELINE + "\n", *(line + "\n" for line in lines)]
    for key, block in blocks:
        if key == "description":  # it credits the bundle copied
            continue
        out += _comment(key)
        out.append(changed.get(key, block))
    if "provenance" not in values:
        out += [*_comment("provenance"), changed["provenance"]]
    manifest_text = "".join(out)
    expected = {**values, **parse_yaml(changed["name"] + changed["title"] + changed["provenance"])}
    expected["schema"] = SCHEMA
    expected.pop("description", None)
    if strings is None and parse_yaml(manifest_text, file=manifest) != expected:
        raise BundleError("cannot be copied automatically: copy its folder by hand", file=manifest)
    return manifest_text


def _with_strings(blocks: Sequence[tuple[str, str]], values: Mapping[str, Any], strings: str) -> list[tuple[str, str]]:
    """The blocks with another string set in place of the strings' own values."""
    merged = values["strings"]
    rest = {k: v for k, v in merged.items() if k != "defaults"}
    dropped = _given_by(strings)

    def thinned(part: Any) -> Any:
        return {k: v for k, v in part.items() if k not in dropped} if isinstance(part, dict) else part

    lines = [f"strings_from: {strings}\n", "strings:\n"]
    if "defaults" in merged:
        lines.append(f"  defaults: {json.dumps(thinned(merged['defaults']), ensure_ascii=False)}\n")
    lines += [f"  {key}: {json.dumps(thinned(part), ensure_ascii=False)}\n" for key, part in rest.items()]
    block = "".join(lines) + "\n"
    return [(key, block if key == "strings" else text) for key, text in blocks if key != "strings_from"]


def _given_by(strings: str) -> tuple[str, ...]:
    """Keys of strings that a set says, or that do not hold with it."""
    has_loss = all((entry.loss or entry.made_of) is not None for entry in string_set(strings).strings)
    usual = ("tension", "linear_density", "bending_stiffness", "axial_stiffness", "made_of", "fretting_stiffness")
    return (*usual, *(("loss",) if has_loss else ()))


def _blocks(text: str) -> tuple[str, list[tuple[str, str]]]:
    """The text before the first key, and each key of the file with all that belongs to it."""
    starts = list(_KEY.finditer(text))
    ends = [match.start() for match in starts[1:]] + [len(text)]
    blocks = [(match[1], text[match.start() : end]) for match, end in zip(starts, ends, strict=True)]
    return text[: starts[0].start()] if starts else text, blocks


def _comment(key: str) -> list[str]:
    return [_DECIDE[key] + "\n"] if key in _DECIDE else []


def _from_fit(name: str, folder: Path, strings: str) -> str:
    """Text of an instrument with a fitted body, and six strings, or as many as the set has."""
    parts, chosen = load_yaml(folder / PARTS), string_set(strings)
    _, blocks = _blocks((folder / PARTS).read_text(encoding="utf-8"))
    block = dict(blocks)
    for key in ("sources", "provenance", "body", "outputs"):
        if key not in block:
            raise BundleError("is no file of a fit: this key is missing", file=folder / PARTS, key=key)
    points = parts["body"]["points"]
    ends = _ends(points, parts["outputs"], len(chosen.strings))
    names = [entry.note.replace("#", "s") for entry in chosen.strings]
    loss = "    loss: {law: woodhouse, eta_f: 4.0e-5, eta_b: 0.02, eta_a: 1.2}  # DECIDE: not published for this set\n"
    rows = "".join(
        f"  {key}: {{note: {_quoted(entry.note)}, end: body.{end}}}\n"
        for key, entry, end in zip(names, chosen.strings, ends, strict=True)
    )
    unknown = ("strings.*", "stops", "tuning", "exciters", "playing", "outputs.*.full_scale", "effects")
    return (
        f"""{MODELINE}
schema: {SCHEMA}   # SI throughout; other units only where the key says so: _deg, _cents, _db
name: {name}
{_DECIDE["title"]}
title: {_quoted(f"{name}, a measured body with {strings} strings")}
{_DECIDE["licence"]}
licence: unknown

{block["sources"]}
{_DECIDE["provenance"]}
{block["provenance"]}"""
        + "".join(f"  {path}: {{kind: unknown}}\n" for path in unknown)
        + f"""
{_DECIDE["body"]}
{block["body"]}
{_DECIDE["strings"]}
strings_from: {strings}
strings:
  defaults:                     # merged under every string
    plugin: stiff_string
    length: {chosen.length!r}
    tilt_deg: 12                # makes the double decay of a plucked string
    split_cents: 4
{"" if all((entry.loss or entry.made_of) is not None for entry in chosen.strings) else loss}{rows}
{_DECIDE["stops"]}
stops: {{kind: frets, count: 19}}
tuning: {{reference_freq: 440.0, scale: equal_12, compensate: coupled, at: each_stop}}

exciters:
  pluck: {{plugin: finger_pluck, force: 2.0, from_bridge: {{fraction: 0.16}}, angle_deg: 55, nail: 0.8}}
  tap: {{plugin: force_pulse, at: body.{ends[0]}, duration: 1.0e-3, force: 5.0}}

{_DECIDE["playing"]}
playing:
  velocity: {{parameter: pluck.force, low: 0.12, high: 5.0, curve: exponential}}
  note_end: {{kind: damp, t60: 0.12}}

{_DECIDE["outputs"]}
{block["outputs"]}
effects: {{mode: auto, budget_db: -80, budget_cents: 0.5}}
"""
    )


def _tables(folder: Path) -> list[Path]:
    """Files of a fit that its parts of a bundle name."""
    parts = load_yaml(folder / PARTS)
    named = [part.get("table") for part in (parts.get("body"), *parts.get("outputs", [])) if isinstance(part, dict)]
    files = Files(folder, folder / PARTS)
    return [files.path(name, "table") for name in named if isinstance(name, str)]


def _ends(points: Mapping[str, Any], outputs: Sequence[Mapping[str, Any]], count: int) -> list[str]:
    """Point of each string, bass to treble: the nearest along the bridge, or the one that was driven first."""
    placed = {name: point["u"] for name, point in points.items() if point.get("u") is not None}
    if len(placed) < 2:
        driven = next(str(o["at"]["mean"][0]).partition(".")[2] for o in outputs if o["plugin"] == "point_pickup")
        return [next(iter(placed), driven)] * count
    at = [-1 + 2 * i / max(count - 1, 1) for i in range(count)]
    return [min(placed, key=lambda name: abs(placed[name] - u)) for u in at]


def _quoted(text: str) -> str:
    """A word of YAML, whatever is in it: JSON is YAML."""
    return json.dumps(text, ensure_ascii=False)
