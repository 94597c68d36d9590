"""Every page: its code runs, its commands run, and the API reference lists every public name.

The blocks of a page run in order, in a folder of their own that holds ``tune.mid``, ``phrase.mid`` and ``examples``.

- ``python`` blocks share their variables.
- ``sh`` blocks: each command ``tonewood ...`` runs in this process, shortened unless ``--validate`` is given.
- A comment before a block says more: ``<!-- not run: REASON -->``, ``<!-- run in part: REASON -->`` (only the commands
  ``tonewood ...``), ``<!-- run in full: REASON -->`` (only with ``--validate``),
  ``<!-- file: PATH -->`` (the block is written there before anything runs).
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shlex
import shutil
import sys
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import soundfile as sf
import typer

import tonewood as tw
import tonewood.authoring as ta
from tonewood import errors
from tonewood.cli.app import application
from tonewood.cli.main import run

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*/README.md")],
    key=lambda p: p.relative_to(ROOT).as_posix(),
)
NAMES = [p.relative_to(ROOT).as_posix() for p in PAGES]
_MARKER = r"(?:^<!-- (not run|run in part|run in full|file): (.+?) -->\n)?"
_BLOCK = re.compile(_MARKER + r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
#: options that make a command quick
SHORT = {
    "render": ["--max-duration", "0.1"],
    "batch": ["--dry-run"],
    "fit": ["--band", "70", "260"],
    "compare": ["--fs", "16000", "--set", "stops.count=7"],
    "report": ["--fs", "16000", "--set", "stops.count=7"],
}
#: commands of which the page's own option gives way
SHORTENED = {"fit"}


@dataclass(frozen=True)
class Block:
    """A fenced block with the comment before it."""

    marker: str
    reason: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    return [Block(*found) for found in _BLOCK.findall(page.read_text(encoding="utf-8"))]


def commands(block: Block) -> list[list[str]]:
    """Words of each command of a shell block, comments left out."""
    lines = block.text.replace("\\\n", " ").replace("&&", "\n").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_page_imports_what_is_installed_with_the_package(page: Path) -> None:
    """Tests have more packages than users: those of an extra count, others need their installation on the page."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].items()
    needed = [*project["dependencies"], *(one for x, of in extras if x not in ("test", "dev", "docs") for one in of)]
    installed = {re.split(r"[^a-z0-9_]", one)[0] for one in needed}
    text = page.read_text(encoding="utf-8")
    own = {Path(b.reason).stem for b in blocks(page) if b.marker == "file"} | {"tonewood"}
    for block in (b for b in blocks(page) if b.language == "python" and b.marker != "not run"):
        for node in ast.walk(ast.parse(block.text)):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in (name.partition(".")[0] for name in names):
                known = name in sys.stdlib_module_names | installed | own
                assert known or f"pip install {name}" in text, f"{name} is imported"


def run_page(page: Path, folder: Path, whole: bool) -> dict[str, Any]:
    """Run a page in an empty folder, which is the current one; returns the variables of its Python."""
    if page.parent.parent == ROOT / "examples":
        shutil.copytree(page.parent, folder, dirs_exist_ok=True)
    (folder / "examples").symlink_to(ROOT / "examples")
    shutil.copy(ROOT / "examples" / "scores" / "pentatonic.mid", folder / "phrase.mid")
    tw.write_midi(tw.Score([tw.Note(0.3 * i, 0.3, note=n) for i, n in enumerate((45, 52, 57))]), folder / "tune.mid")
    found = blocks(page)
    for block in found:
        if block.marker == "file":
            (folder / block.reason).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.reason).write_text(block.text, encoding="utf-8")
    scope: dict[str, Any] = {"__name__": page.stem}
    for block in found:
        if block.marker == "not run" or (block.marker == "run in full" and not whole):
            continue
        if block.language == "python":
            exec(compile(block.text, str(page), "exec", dont_inherit=True), scope)
        elif block.language == "sh":
            for words in commands(block):
                if words[0] == "tonewood":
                    run_command(words[1:], whole)
    return scope


def run_command(arguments: list[str], whole: bool) -> None:
    short = [] if whole else SHORT.get(arguments[0], [])
    with pytest.raises(SystemExit) as ended:
        run(arguments + (short if arguments[0] in SHORTENED or not set(short) & set(arguments) else []))
    assert ended.value.code == 0, shlex.join(arguments)


RUN = [
    name
    for name, page in zip(NAMES, PAGES, strict=True)
    if any(b.language in ("python", "sh") and b.marker != "not run" for b in blocks(page))
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


#: pages that take seconds: continuous integration runs them
SLOW = {
    "examples/listening_test/README.md",
    *(
        f"docs/{page}.md"
        for page in (
            "a_body_from_a_drawing", "tutorial", "playing", "use_design", "from_a_measurement", "piano", "compare",
            "use_score", "sampling", "wood", "strings_and_intonation", "listening_tests",
        )
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in RUN if n != "README.md"]
)
def test_a_page_runs(name: str, folder: Path) -> None:
    run_page(ROOT / name, folder, whole=False)


@pytest.mark.validate
@pytest.mark.parametrize("name", RUN)
def test_a_page_runs_in_full(name: str, folder: Path) -> None:
    run_page(ROOT / name, folder, whole=True)


def test_the_readme_runs(folder: Path) -> None:
    run_page(ROOT / "README.md", folder, whole=False)
    assert 4800 < sf.info("greensleeves.wav").frames < 7200  # 0.1 s of score, and the first pluck's preparation


@pytest.mark.slow
def test_the_overview_runs(folder: Path) -> None:
    scope = run_page(ROOT / "docs" / "overview.md", folder, whole=False)
    info = sf.info("two_notes.wav")
    assert (info.frames, info.channels) == (96000, 2)
    assert scope["block"].shape[1] == 2


def test_pages_that_run_are_found() -> None:
    """The pattern of a block misses none of these."""
    assert set(RUN) >= {
        "README.md",
        "docs/effects.md",
        "docs/from_a_measurement.md",
        "docs/listening_tests.md",
        "docs/make_an_instrument.md",
        "docs/strings_and_contact.md",
        "docs/write_a_plugin.md",
        "examples/listening_test/README.md",
    }


@pytest.mark.parametrize("name", NAMES)
def test_nothing_escapes_being_run(name: str) -> None:
    """Commands stand in ``sh`` blocks, and where one is not run the page says why."""
    page = ROOT / name
    text = page.read_text(encoding="utf-8")
    assert text.count("\n```") % 2 == 0
    assert len(blocks(page)) == text.count("\n```") // 2
    for block in blocks(page):
        assert block.language, f"a block without a language: {block.text[:60]}"
        if block.language == "sh":
            foreign = [words for words in commands(block) if words[0] != "tonewood"]
            assert not foreign or block.marker in ("not run", "run in part"), foreign
    outside = _BLOCK.sub("", text)
    assert re.findall(r"^ {4,}(?:tonewood|python|pip|bash) .*$", outside, re.MULTILINE) == []


@pytest.mark.parametrize("name", NAMES)
def test_equations_are_plain_text(name: str) -> None:
    """The site typesets no TeX: its commands would stand on the page as they are written."""
    text = _BLOCK.sub("", (ROOT / name).read_text(encoding="utf-8"))
    assert re.findall(r"\\[A-Za-z]{2,}", re.sub(r"`[^`]*`", "", text)) == []


@pytest.mark.parametrize("name", NAMES)
def test_tables_are_whole(name: str) -> None:
    """A row after an empty line belongs to no table: its bars would stand on the page."""
    text = _BLOCK.sub("", (ROOT / name).read_text(encoding="utf-8"))
    for table in re.findall(r"(?:^\|.*\n)+", f"{text}\n", re.MULTILINE):
        assert re.match(r"\|.*\n\|[ :|-]+\n", table), table.splitlines()[0]


@pytest.mark.parametrize("name", NAMES)
def test_commands_in_sentences_exist(name: str) -> None:
    """Names of commands, options and scripts in the text."""
    known = {
        command: {option for parameter in made.params for option in parameter.opts} | {"--help"}
        for command, made in typer.main.get_command(application(None)).commands.items()
    }
    text = _BLOCK.sub("", (ROOT / name).read_text(encoding="utf-8"))
    for command, rest in re.findall(r"`tonewood ([a-z]\w*)([^`]*)`", text):
        assert command in known
        assert set(re.findall(r"(?<!\w)--?[a-z][a-z-]*", rest)) <= known[command], f"tonewood {command}{rest}"
    for script in re.findall(r"`(?:[A-Z_]+=\w+ )?(?:python|bash) ([\w/.]+\.(?:py|sh))\b", text):
        assert (ROOT / script).is_file(), script


PACKAGES = {"tonewood", *(path.stem for path in (ROOT / "src" / "tonewood").iterdir() if path.name[0] not in "_.")}
FOLDERS = ("src", "plugins", "tests", "examples", "benchmarks", "scripts")
ENDINGS = ("py", "hpp", "cpp", "yaml", "json", "png")


def exists(name: str) -> bool:
    """Whether a dotted name, with or without the package's, leads to a module or to something in one."""
    parts = name.removeprefix("tonewood.").split(".")
    for n in range(len(parts), -1, -1):
        try:
            found = importlib.import_module(".".join(("tonewood", *parts[:n])))
        except ModuleNotFoundError:
            continue
        for part in parts[n:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


@pytest.mark.parametrize("name", [*(n for n in NAMES if n != "CHANGELOG.md"), "src", "plugins"])
def test_names_in_sentences_exist(name: str) -> None:
    """Modules, names in them, and files; in docstrings, too."""
    pages = [ROOT / name] if name.endswith(".md") else sorted((ROOT / name).rglob("*.py"))
    files = [f"/{path.relative_to(ROOT).as_posix()}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.*")]
    for page in pages:
        text = _BLOCK.sub("", page.read_text(encoding="utf-8"))
        for dotted in set(re.findall(r"(?<!`)`((?:\w+\.)+\w+)(?:\(\))?`(?!`)", text)):
            first, last = dotted.split(".")[0], dotted.split(".")[-1]
            assert first not in PACKAGES or last in ENDINGS or exists(dotted), f"{page.name}: {dotted}"
        for file in set(re.findall(r"`((?:\w+/)+\w+\.(?:py|hpp|cpp))`", text)):
            assert any(known.endswith(f"/{file}") for known in files), f"{page.name}: {file}"


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_somewhere(name: str) -> None:
    """To files of the repository, as they are followed where the code is hosted."""
    page = ROOT / name
    for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", _BLOCK.sub("", page.read_text(encoding="utf-8"))):
        assert target.startswith("https://") or (page.parent / target).exists(), target


def test_the_reference_lists_every_public_name_once() -> None:
    text = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "reference").glob("*.md"))
    listed = Counter(re.findall(r"^::: tonewood\.([\w.]+)$", text, re.MULTILINE))
    assert set(listed.values()) == {1}
    authoring = [n for n in ta.__all__ if n not in tw.__all__ and not hasattr(errors, n)]
    kinds = [n for n, kind in vars(errors).items() if inspect.isclass(kind) and n not in tw.__all__]
    wanted = {*tw.__all__, *(f"authoring.{n}" for n in authoring), *(f"errors.{n}" for n in kinds)}
    # beside these, results that nobody makes himself
    results = {n for n in listed if n.startswith(("sound.", "performance.", "workshop.", "instrument."))}
    assert set(listed) - results == wanted


#: first and last class of an example in docs/write_a_plugin.md -> most lines of code, blank ones not counted
SHORT_EXAMPLES = {
    ("EvenParameters", "EvenString"): 25,
    ("KnockParameters", "Knock"): 25,
    ("PowerParameters", "Power"): 15,
    ("PairParameters", "Pair"): 20,
    ("PinParameters", "Pin"): 35,
}


def test_the_guides_plugins_are_short() -> None:
    """Parameters and plugin, docstrings included; that they run, `test_a_page_runs` checks."""
    text = "\n".join(b.text for b in blocks(ROOT / "docs" / "write_a_plugin.md") if b.language == "python")
    lines, classes = (
        text.splitlines(),
        {n.name: n for n in reversed(ast.parse(text).body) if isinstance(n, ast.ClassDef)},
    )
    for (first, last), most in SHORT_EXAMPLES.items():
        parts = [c for c in classes.values() if classes[first].lineno <= c.lineno <= classes[last].lineno]
        code = [line for c in parts for line in lines[c.lineno - 1 : c.end_lineno] if line.strip()]
        assert 5 < len(code) <= most, (last, len(code))
