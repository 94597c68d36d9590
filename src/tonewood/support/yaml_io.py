"""YAML files that people write: read, with the values of files parsed before kept between runs.

`yaml_parser` says which YAML is read; it is imported for files that are not kept yet.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError, together
from tonewood.support.cache_folder import cache_folder, keep, read_kept
from tonewood.support.text_files import decoded

MAX_BYTES = 1_000_000

#: characters from which on the values of a file are kept
_SHORTEST_KEPT = 1000

_SUFFIXES = (".yaml", ".yml")


def load_yaml(
    path: str | os.PathLike[str], *, max_bytes: int = MAX_BYTES, error: type[TonewoodError] = TonewoodError
) -> dict[str, Any]:
    """Read one YAML file into a dict of dicts, lists, str, int, float, bool and None.

    path : the file, UTF-8.
    max_bytes : longest file that is read.
    error : class of the error raised, for a caller with a subclass of its own.
    Raises TonewoodError
        One line naming file, line (or dotted key) and the values allowed: the file cannot be read, is too long,
        is not UTF-8 or not YAML, or holds something `parse_yaml` refuses.
    """
    try:
        with Path(path).open("rb") as stream:
            raw = stream.read(max_bytes + 1)
    except OSError as fault:
        raise error(f"cannot be read: {fault.strerror}", file=path) from None
    if len(raw) > max_bytes:
        raise error(f"longer than the {max_bytes} bytes allowed", file=path)
    return _parsed(decoded(raw, file=path, error=error), path, error)


def _parsed(text: str, path: str | os.PathLike[str], error: type[TonewoodError]) -> dict[str, Any]:
    """As `parse_yaml`, of a file whose values may be known from an earlier run: parsing takes a tenth of a start."""
    if cache_folder() is None or len(text) < _SHORTEST_KEPT:
        return parse_yaml(text, file=path, error=error)
    key = hashlib.sha256(Path(__file__).with_name("yaml_parser.py").read_bytes() + text.encode()).hexdigest()
    data = read_kept("yaml", key, _mapping)
    if data is None:
        data = parse_yaml(text, file=path, error=error)
        keep("yaml", key, json.dumps(data).encode())
    return data


def _mapping(content: bytes) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(content)
    return data


def parse_yaml(
    text: str, *, file: str | os.PathLike[str] | None = None, error: type[TonewoodError] = TonewoodError
) -> dict[str, Any]:
    """As `load_yaml`, from a text; `file` is only named in errors. See `yaml_parser.parse`."""
    from tonewood.support.yaml_parser import parse

    return parse(text, file=file, error=error)


def located(fault: TonewoodError) -> TonewoodError:
    """Return an error with the line of its key, or of the nearest key above it, if its file is a YAML file.

    A key of `strings.NAME` that stands under `strings.defaults` instead is found there. Several faults stand in the
    order of their lines.
    """
    if fault.also:
        return together(sorted(map(_located, fault.all), key=lambda one: one.line or 0))
    return _located(fault)


def _located(fault: TonewoodError) -> TonewoodError:
    if fault.file is None or not fault.key or fault.line is not None or Path(fault.file).suffix not in _SUFFIXES:
        return fault
    from tonewood.support.yaml_parser import line_of

    try:
        line = line_of(Path(fault.file).read_text(encoding="utf-8-sig"), fault.key)
    except (OSError, ValueError):
        return fault
    return fault if line is None else type(fault)(fault.reason, file=fault.file, key=fault.key, line=line)
