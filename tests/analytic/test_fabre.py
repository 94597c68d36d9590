"""Every checked quantity of Fabre's systems and of the closed forms: the rows of `tonewood validate`."""

from __future__ import annotations

import pytest

from tonewood.lab import validation

#: system -> least number of rows
LEAST = {
    "fabre_forms": 25,
    "fabre_academic": 30,
    "fabre_guitar": 30,
    "fabre_harp": 18,
    "fabre_methods": 18,
    "string_and_body": 20,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEAST)
def test_every_row_passes(name):
    rows = validation.run([name])
    assert len(rows) >= LEAST[name]
    assert len({(row.system, row.quantity) for row in rows}) == len(rows)
    failed = [f"{row.quantity}: {row.value} for {row.reference}" for row in rows if not row.passed]
    assert not failed


@pytest.mark.validate
def test_figures_are_drawn(tmp_path):
    paths = validation.draw(tmp_path, ["fabre", "string"])
    assert len(paths) >= 6
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 20_000
