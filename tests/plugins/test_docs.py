"""The pages for instrument and plugin makers: what they show is what ships."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tonewood.instrument import registry
from tonewood.instrument.assembly import assemble
from tonewood.instrument.bundle import Instrument
from tonewood.instrument.registry import check_plugin, list_instruments
from tonewood.instrument.schema_table import inserted

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "make_an_instrument.md").read_text(encoding="utf-8")


def shown(name: str) -> str:
    """The file of the monochord's bundle that the page shows."""
    (text,) = re.findall(rf"<!-- file: path/to/monochord/{name} -->\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    return text


def test_the_monochord_shown_is_the_one_that_ships() -> None:
    folder = list_instruments()["monochord"]
    for name in ("instrument.yaml", "body.csv"):
        assert shown(name) == (folder / name).read_text()


def test_tables_are_up_to_date() -> None:
    """Mended by ``python -m tonewood.instrument.schema_table docs/make_an_instrument.md``."""
    assert inserted(PAGE) == PAGE


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


@pytest.mark.usefixtures("plate")
def test_the_third_partys_instrument() -> None:
    check_plugin(registry.list_plugins()["rectangular_plate"], "rectangular_plate")
    zither = Instrument.load("plate_zither")
    model = assemble(zither, 16000)
    assert model.system.compiled[0].basis.n_modes > 20
    for string in model.strings.values():
        tuned = string.tuned()
        assert tuned is not None
        assert abs(tuned.error_cents) < 1.0
