"""The theory page names functions that exist."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "theory.md"


def resolve(name):
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = import_module(".".join(["tonewood", *parts[:cut]]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            thing = getattr(thing, attribute)
        return thing
    raise AssertionError(f"{name}: no such module")


def test_every_name_in_backticks_exists():
    names = set(
        re.findall(
            r"`((?:modal|coupling|stepping|energy|passivity|lab)\.[A-Za-z_0-9.]+)`", PAGE.read_text(encoding="utf-8")
        )
    )
    assert len(names) > 30
    for name in names:
        assert resolve(name) is not None
