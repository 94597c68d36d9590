"""The example package as if it were installed."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tonewood.instrument.contract import registry

ROOT = Path(__file__).parents[2]


@pytest.fixture
def plate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The example package as if it were installed: its source on the path, its entry points announced."""
    example = ROOT / "examples" / "third_party_plugin"
    project = tomllib.loads((example / "pyproject.toml").read_text())["project"]
    info = tmp_path / "tonewood_plate-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(example / "src"))
    caches = (registry.entries, registry.plugin, registry.plugin_hash)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()
