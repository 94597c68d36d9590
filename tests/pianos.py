"""Some keys of `grand_piano` as a bundle of their own."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import tonewood as tw


def some_keys(folder: Path, notes: Sequence[str], cells: Mapping[str, str] | None = None) -> Path:
    """Copy the bundle with the rows of these notes; `cells` are written over every row: column -> text."""
    source = tw.list_instruments()["grand_piano"]
    shutil.copytree(source, folder, dirs_exist_ok=True)
    lines = (source / "keys.csv").read_text(encoding="utf-8").splitlines()
    header, *rows = [line.split(",") for line in lines if not line.startswith("#")]
    kept = [dict(zip(header, row, strict=True)) | dict(cells or {}) for row in rows if row[0] in notes]
    header += [name for name in cells or {} if name not in header]
    text = "\n".join([",".join(header), *(",".join(row[name] for name in header) for row in kept)])
    (folder / "keys.csv").write_text(text + "\n", encoding="utf-8")
    return folder


def piano(folder: Path, notes: Sequence[str], cells: Mapping[str, str] | None = None) -> tw.Instrument:
    """Load it."""
    return tw.load_instrument(some_keys(folder, notes, cells))
