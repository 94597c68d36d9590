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
