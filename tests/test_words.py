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
OTHERS = sorted(
    path for folder in ("tests", "benchmarks", "examples", "scripts") for path in (ROOT / folder).rglob("*.py")
)
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "ARCHITECTURE.md", ROOT / "CONTRIBUTING.md"])

#: words of no meaning here, whole or as a part of a name; others of the table's last column mean something elsewhere
NOWHERE = (
    "asleep", "awake", "guarded", "ledger", "loom", "surroundings", "taut", "weave", "woven", "warp", "sleeper", "calm",
    "rung",
)  # fmt: skip
#: words that physics and English need, but that name nothing in Python: matrices gather and scatter, motion is
#: longitudinal, searches converge in iterations
NO_NAME = (
    "push", "pushes", "pushed", "pull", "pulls", "pulled", "along", "turns", "visit", "stir", "aside", "books", "told",
    "settled", "swing", "sway", "tense",
)  # fmt: skip
#: names with such a word: file, or None for all, and reason
NAMED = {
    "pull_off": (None, "technique of the left hand"),
    "pull": ({"hammer.py", "plectrum.py"}, "force of a spring"),
    "push": ({"hammer.py", "left_hand.py"}, "force of a hand"),
}


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


def names_of(path: Path) -> set[str]:
    """Names that a Python file binds or uses."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    found = (getattr(node, field, None) for node in nodes for field in ("id", "attr", "arg", "name"))
    return {name for name in found if isinstance(name, str)}


def test_the_table_is_read():
    assert len(rows()) >= 20


def test_every_term_is_in_use(words):
    used = set().union(*words.values())
    for terms, _, _ in rows():
        for term in terms.split(", "):
            parts = re.findall(r"[a-z]+", term.lower())
            missing = [part for part in parts if not {part, part + "s", part + "d", part + "ed"} & used]
            assert not missing, f"{term}: {missing} stands nowhere in the sources"


def test_private_words_are_gone(words):
    prose = {page: words_of(page) for page in [*PAGES, *OTHERS] if page != Path(__file__)}
    table = ROOT / "CONTRIBUTING.md"
    prose[table] -= set(re.findall("[a-z]+", " ".join(row[2] for row in rows()).lower()))
    for word in NOWHERE:
        forms = {word, word + "s", word + "ed", word + "ing"}
        found = [str(path.relative_to(ROOT)) for path, there in (words | prose).items() if forms & there]
        assert not found, f"{word!r} stands in {found}"


@pytest.mark.slow
def test_no_name_holds_a_private_word():
    for path in [*PYTHON, *(ROOT / "benchmarks").rglob("*.py")]:
        for name in names_of(path):
            held = set(re.findall("[a-z]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name).lower())) & set(NO_NAME)
            files, _ = NAMED.get(name, (set(), ""))
            assert not held or files is None or path.name in files, f"{path.relative_to(ROOT)}: {name}"


@pytest.mark.slow
def test_a_public_class_name_means_one_class():
    """And no alias of a type has the name of a class."""
    homes, aliases = defaultdict(list), defaultdict(list)
    for path in PYTHON:
        if "lab" in path.parts:  # papers call different things the same
            continue
        place = str(path.relative_to(ROOT))
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(place)
            elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                aliases[node.targets[0].id].append(place)
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert not twice
    assert {name: places for name, places in aliases.items() if name in homes} == {}
