"""The glossary of CONTRIBUTING.md, held to the sources; one name means one class."""

from __future__ import annotations

import ast
import io
import re
import tokenize
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
    "asleep", "awake", "guarded", "ledger", "loom", "surroundings", "swing", "sway", "taut", "weave", "woven",
    "warp", "sleeper", "calm", "rung", "tense", "told", "settle", "settles", "settled",
    "settling", "awaited", "affordable",
)  # fmt: skip
#: words that physics and English need, but that name nothing in Python: matrices gather and scatter, motion is
#: longitudinal, searches take iterations
NO_NAME = (
    "push", "pushes", "pushed", "pull", "pulls", "pulled", "along", "turns", "visit", "stir", "aside", "books",
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


def prose_of(path: Path) -> str:
    """Comments, docstrings and pages, line by line; code, headings and blocks of pages are empty lines."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = re.sub(r"^```.*?^```", lambda m: "\n" * m[0].count("\n"), text, flags=re.MULTILINE | re.DOTALL)
        return re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
    if path.suffix != ".py":
        return "\n".join(line.partition("//")[2] for line in text.splitlines())
    lines = [""] * (text.count("\n") + 2)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            lines[token.start[0]] = token.string.lstrip("#: ")
        elif token.type == tokenize.STRING and token.string.startswith('"""'):
            for i, line in enumerate(token.string.splitlines()):
                lines[token.start[0] + i] = "" if line.startswith("#") else line
    return "\n".join(lines[1:])


#: verbs that a question follows: "says what it did"
ASKING = re.compile(
    r"\b(says?|said|asks?|asked|tells?|knows?|shows?|decides?|see|explains?|states?)\s+(\w+\s+)?$", re.IGNORECASE
)


def noun_clauses(path: Path) -> list[str]:
    """Places of clauses of "what" that stand for a noun; questions, asked or told of, and words in quotes do not."""
    if "what" not in path.read_text(encoding="utf-8").lower():
        return []
    prose, found = prose_of(path), []
    for match in re.finditer(r'(?<!")\bwhat\b(?!")', prose, re.IGNORECASE):
        before, rest = " ".join(prose[: match.start()][-60:].split()) + " ", prose[match.end() :]
        end = re.search(r"[.?!](?=\s|$|[\"|)*])|\n\s*\n|\|", rest)
        if ASKING.search(before) or (end is not None and end[0] == "?") or before.endswith("** ") or rest[:1] == "=":
            continue
        found.append(f"{path.relative_to(ROOT)}:{prose.count(chr(10), 0, match.start()) + 1}")
    return found


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


def test_no_name_holds_a_private_word():
    for path in [*PYTHON, *(ROOT / "benchmarks").rglob("*.py")]:
        for name in names_of(path):
            held = set(re.findall("[a-z]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name).lower())) & set(NO_NAME)
            files, _ = NAMED.get(name, (set(), ""))
            assert not held or files is None or path.name in files, f"{path.relative_to(ROOT)}: {name}"


def test_nouns_stand_for_nouns():
    """Sentences say "the result of a search", not a clause of "what"."""
    found = [place for path in [*PYTHON, *CPP, *OTHERS, *PAGES] for place in noun_clauses(path)]
    assert not found, found


def test_the_search_for_clauses_finds_some(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    page, code = tmp_path / "page.md", tmp_path / "code.py"
    page.write_text("# @ it is\n\n@ is it? A page. @ it says,\nit says @ it did. It is @ it is.\n".replace("@", "what"))
    code.write_text('"""See @ it does: @ it does."""\nwhat = 1  # of @ it is\n'.replace("@", "what"))
    assert noun_clauses(page) == ["page.md:3", "page.md:4"]
    assert noun_clauses(code) == ["code.py:1", "code.py:2"]


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
