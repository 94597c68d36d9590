"""Identity of an instrument: hashes of its values, tables and plugins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tonewood.instrument.contract import registry
from tonewood.instrument.contract.bundle_code import code_hash, is_code
from tonewood.instrument.contract.plugin import Plugin


def content_hash(resolved: Mapping[str, Any], folder: Path, granted: Iterable[Path], plugins: Mapping[str, str]) -> str:
    """SHA-256 over the resolved values, the files of the folder and granted ones, and the hashes of plugins."""
    digest = hashlib.sha256(json.dumps(resolved, sort_keys=True, ensure_ascii=True).encode())
    files = (p for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    tables = (p for p in files if p.name != registry.MANIFEST)
    for path in [*sorted(tables), *sorted(granted)]:
        digest.update(path.name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    for name, sha256 in sorted(plugins.items()):
        digest.update(f"{name}:{sha256}".encode())
    return digest.hexdigest()


def plugin_hashes(parts: Iterable[tuple[str, Plugin[Any]]]) -> dict[str, str]:
    """Name in the bundle -> SHA-256 of the plugin's source, for names and plugins of all parts."""
    kinds = {name: type(plugin) for name, plugin in parts}
    return {name: code_hash(kind) if is_code(name) else registry.plugin_hash(name) for name, kind in kinds.items()}
