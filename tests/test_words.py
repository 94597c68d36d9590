"""The glossary of CONTRIBUTING.md, held to the sources; one name means one class."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHON = sorted([*(ROOT / "src").rglob("*.py"), *(ROOT / "plugins").glob("*.py")])
CPP = sorted([*(ROOT / "src" / "kernel").rglob("*.hpp"), *(ROOT / "src" / "kernel").rglob("*.cpp")])

#: words of no meaning here, whole or as a part of a name; others of the table's last column mean something elsewhere
NOWHERE = (
    "asleep", "awake", "guarded", "ledger", "loom", "surroundings", "swing", "sway", "taut", "weave", "woven",
    "warp", "sleeper", "calm", "rungs",
)  # fmt: skip


def rows() -> list[tuple[str, str, str]]:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Words")[2]
    found = re.findall(r"^\| ([^|]+) \| ([^|]+) \|([^|]*)\|$", text, re.MULTILINE)
    return [(a.strip(), b.strip(), c.strip()) for a, b, c in found[2:]]


def words_of(path: Path) -> set[str]:
    """Words of a file, names cut at underscores and capitals."""
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", path.read_text(encoding="utf-8"))
    return set(re.findall(r"[a-z]+", text.lower().replace("_", " ")))


@pytest.fixture(scope="module")
def words() -> dict[Path, set[str]]:
    return {path: words_of(path) for path in [*PYTHON, *CPP]}


def test_the_table_is_read():
    assert len(rows()) >= 20


def test_every_term_is_in_use(words):
    used = set().union(*words.values())
    for terms, _, _ in rows():
        for term in terms.split(", "):
            parts = re.findall(r"[a-z]+", term.lower())
            missing = [part for part in parts if not {part, part + "s", part + "d", part + "ed"} & used]
            assert not missing, f"{term}: {missing} stands nowhere in the sources"


@pytest.mark.parametrize("word", NOWHERE)
def test_private_words_are_gone(words, word):
    forms = {word, word + "s", word + "ed", word + "ing"}
    found = [str(path.relative_to(ROOT)) for path, there in words.items() if forms & there]
    assert not found, f"{word!r} stands in {found}"


def test_a_public_class_name_means_one_class():
    homes = defaultdict(list)
    for path in PYTHON:
        if "lab" in path.parts:  # papers call different things the same
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(str(path.relative_to(ROOT)))
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert not twice
