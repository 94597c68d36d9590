"""The pages for instrument and plugin makers: what they show is what ships, and runs."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tonewood.instrument import registry
from tonewood.instrument.assembly import assemble
from tonewood.instrument.bundle import Instrument
from tonewood.instrument.registry import check_plugin, list_instruments
from tonewood.instrument.schema_table import inserted

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "docs" / name for name in ("make_an_instrument.md", "write_a_plugin.md", "strings_and_contact.md")]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_examples_run(page: Path) -> None:
    scope: dict[str, Any] = {"__name__": page.stem}
    found = blocks(page, "python")
    assert found
    for block in found:
        exec(compile(block, str(page), "exec"), scope)


def test_the_monochord_shown_is_the_one_that_ships() -> None:
    folder = list_instruments()["monochord"]
    assert blocks(PAGES[0], "yaml") == [(folder / "instrument.yaml").read_text()]
    assert blocks(PAGES[0], "csv") == [(folder / "body.csv").read_text()]


def test_tables_are_up_to_date() -> None:
    """Mended by ``python -m tonewood.instrument.schema_table docs/make_an_instrument.md``."""
    page = PAGES[0].read_text(encoding="utf-8")
    assert inserted(page) == page


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
