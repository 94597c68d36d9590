"""The first pages are true: their commands and instruments are there, and the README is short."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from tonewood.cli.commands import COMMANDS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
OVERVIEW = (ROOT / "docs" / "overview.md").read_text(encoding="utf-8")


def test_every_command_is_named() -> None:
    assert set(re.findall(r"`tonewood ([a-z]+)[ `]", OVERVIEW)) == set(COMMANDS)


def test_every_instrument_is_named() -> None:
    table = OVERVIEW.partition("## Instruments")[2].partition("##")[0]
    named = {name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert named == {p.parent.name for p in (ROOT / "instruments").glob("*/instrument.yaml")}


def test_files_named_by_the_architecture_exist() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    for name in re.findall(r"\b([a-z_]+\.py)\b", text):
        assert any(list(ROOT.glob(f"{folder}/**/{name}")) for folder in ("src/tonewood", "plugins", "tests")), name
    for folder in re.findall(r"`(tests/[a-z/]+)`", text):
        assert (ROOT / folder).is_dir(), folder


def test_the_first_commands_are_those_of_continuous_integration() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert 'pip install -e ".[test]" && python -m pytest -n 2' in README
    assert {"pytest>=8", "pytest-xdist>=3"} <= set(extras["test"])
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "[test,dev]" in ci
    assert re.search(r"python -m pytest .*-n 2", ci)
    score = re.search(r"tonewood render (\S+) -i classical_guitar", README)
    assert score is not None
    assert (ROOT / score[1]).is_file()


def test_the_readme_fits_on_two_screens() -> None:
    lines = README.splitlines()
    assert len(lines) <= 90
    assert sum(len(line.split()) for line in lines if not line.startswith("|")) < 700
