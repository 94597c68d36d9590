"""``tonewood strings``, and what ``tonewood intonation`` refuses."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from cli_runs import refused

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["intonation", "monochord"], ["stops.kind", "frets are wanted"]),
        (["intonation", "classical_guitar", "--frets", "40"], ["--frets", "2 to 19"]),
        (["strings", "ej4"], ["there is no string set 'ej4'"]),
        (["strings", "ej46", "--length", "50"], ["--length", "0.02 to 5"]),
    ],
)
def test_commands_refuse(tonewood: Run, arguments: list[str], said: list[str]) -> None:
    refused(tonewood(*arguments), *said)


def test_strings_are_listed(tonewood: Run) -> None:
    code, out, _ = tonewood("strings")
    assert code == 0
    assert "phosphor_bronze" in out
    assert "Polak" in out
    rows = json.loads(tonewood("strings", "exl110", "--json")[1])["strings"]
    assert rows[5]["tension"] == pytest.approx(72.13, abs=0.01)
    assert "together 460.8 N, 103.6 lb" in tonewood("strings", "exl110")[1]


@pytest.mark.parametrize(
    ("name", "inches", "material"),
    # printed on their packets: gauges in thousandths of an inch; of ej46 none is known
    [("exl110", (46, 36, 26, 17, 13, 10), True), ("ej16", (53, 42, 32, 24, 16, 12), False), ("ej46", (), False)],
)
def test_gauges_of_a_set_are_told(tonewood: Run, name: str, inches: tuple[int, ...], material: bool) -> None:
    rows = json.loads(tonewood("strings", name, "--json")[1])["strings"]
    found = [None if row["diameter"] is None else round(row["diameter"] / 25.4e-6) for row in rows]
    assert found == (list(inches) or [None] * 6)
    assert [row["material"] is not None for row in rows] == [material] * 6
    text = tonewood("strings", name)[1].splitlines()[3:9]
    for line, row in zip(text, rows, strict=True):
        d = row["diameter"]
        size = ["-", "-"] if d is None else [f"{1e3 * d:.3f}", f"{d / 0.0254:.4f}"]
        assert line.split()[:4] == [row["note"], *size, row["material"] or "-"]
        assert f"{row['tension']:.2f}" in line
    longer = json.loads(tonewood("strings", name, "--length", 0.7, "--json")[1])["strings"]
    assert {row["length"] for row in longer} == {0.7}
    for a, b in zip(rows, longer, strict=True):
        assert b["tension"] / a["tension"] == pytest.approx((0.7 / a["length"]) ** 2)
