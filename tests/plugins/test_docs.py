"""The pages for instrument and plugin makers show the files that ship."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema_table import inserted
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.registry import check_plugin, list_instruments
from tonewood.instrument.model.assembly import assemble

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
    """Mended by ``python -m tonewood.instrument.bundle.schema_table docs/make_an_instrument.md``."""
    assert inserted(PAGE) == PAGE


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
