"""A changed instrument as a bundle: a copy of its folder with every value written out."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.support.whole_files import check_new_folder, folder_whole, write_whole
from tonewood.workshop.design.search import FoundDesign

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made.

    Raises BundleError : its name is none of an instrument.
    Raises OutputError : it is there already, or its parent is not.
    """
    if not _NAME.fullmatch(folder.name):
        raise BundleError(f"{folder.name!r} cannot be the name of an instrument; letters, digits and _ are allowed")
    check_new_folder(folder)


def write_design(design: FoundDesign, folder: Path) -> Instrument:
    """Write a bundle that `render` and `compare` take.

    Raises OutputError : the folder cannot be written; nothing stays behind.
    """
    instrument = design.instrument
    note = f"found by tonewood design from {instrument.name}"
    notes = {path: note for parameter in design.free for path in parameter.paths}
    title = f"{instrument.spec.title}, changed for {'; '.join(t.text for t in design.targets)}"
    return write_changed(instrument, folder, title, notes)


def write_changed(instrument: Instrument, folder: Path, title: str, notes: Mapping[str, str]) -> Instrument:
    """Write a bundle of a changed instrument; changed values become authored, others keep their origin.

    folder : to make; its last part is the instrument's name.
    notes : path of each changed value -> how it was changed.
    Returns The instrument, loaded from its new folder.
    Raises BundleError : the name is none of an instrument, or a scale lies outside of the bundle.
    Raises OutputError : the folder is there already or cannot be written; nothing stays behind.
    """
    check_folder(folder)
    if instrument.granted:
        raise BundleError("a scale outside of the bundle: copy it into the bundle's folder first", key="tuning")
    values = {k: v for k, v in instrument.resolved.items() if v is not None}
    values |= {"name": folder.name, "title": title[:200]}
    authored = {path: {"kind": "authored", "note": note[:300]} for path, note in notes.items()}
    values["provenance"] = {**values.get("provenance", {}), **authored}
    with folder_whole(folder):
        shutil.copytree(instrument.folder, folder, ignore=shutil.ignore_patterns(MANIFEST, "__pycache__"))
        write_whole(folder / MANIFEST, _yaml(values))
        return Instrument.load(folder, allow_code=instrument.allow_code)


def _yaml(values: Mapping[str, Any]) -> str:
    """Two levels of keys as lines, the rest as JSON, which is YAML."""
    out = []
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            out.append(f"{key}:")
            out += [f"  {json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in value.items()]
        else:
            out.append(f"{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(out) + "\n"
