"""MkDocs hook: pages that are made from the rest of the repository, and links between all of them.

Pages link each other by their places in the repository, so that links work where the code is hosted; here they are
turned to the places in the site. A file that is linked and is no page of its own is shown on a page.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import os
import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_type_hints

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("MPLBACKEND", "Agg")
sys.path.insert(0, str(ROOT / "scripts"))  # a module, so that sounds are rendered once for all builds of `mkdocs serve`

import gallery  # noqa: E402

log = get_plugin_logger(__name__)

#: file of the repository -> page of the site
PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SUPPORT.md": "support.md",
    "SECURITY.md": "security.md",
    "CODE_OF_CONDUCT.md": "code_of_conduct.md",
    "LICENSE": "licence.md",
    "CITATION.cff": "cite.md",
    "examples": "examples/index.md",
    "examples/third_party_plugin": "examples/third_party_plugin.md",
    "examples/listening_test/README.md": "examples/listening_test.md",
}
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
#: type of an option -> word for its value
_VALUES: dict[Any, str] = {
    **dict.fromkeys((int, int | None), "INTEGER"),
    **dict.fromkeys((float, float | None), "NUMBER"),
    **dict.fromkeys((Path, Path | None, list[Path] | None), "PATH"),
    bool: "",
}
_FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
_FETCHED = re.compile(
    r"<(?:script|img|audio|source|iframe)[^>]*\ssrc=\"?(?:https?:)?//[^\s>]*"
    r"|<link[^>]*stylesheet[^>]*\shref=\"?(?:https?:)?//[^\s>]*"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are no files of ``docs/``."""
    for source, page in PAGES.items():
        path = ROOT / source
        if source == "examples":
            text = _examples()
        elif source == "CITATION.cff":
            text = _cite(path)
        elif path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
        elif path.is_dir():
            text = (path / "README.md").read_text(encoding="utf-8")
        else:
            text = _licence(path)
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    files.append(File.generated(config, "reference/schema.md", content=_schema()))
    from tonewood.instrument.bundle.json_schema import bundle_schema

    schema = json.dumps(bundle_schema(), indent=2)
    files.append(File.generated(config, "reference/tonewood-instrument.schema.json", content=schema))
    files.append(File.generated(config, "gallery.md", content=gallery.page()))
    for made in gallery.files():
        files.append(File.generated(config, f"gallery/{made.name}", abs_src_path=str(made)))
    for source in sorted(_linked(files)):
        files.append(File.generated(config, _shown(source), content=_source_page(ROOT / source)))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Turn links to files of the repository into links to pages; put sounds where a page names them."""
    here = page.file.src_uri
    markdown = gallery.with_players(markdown)

    def turned(link: re.Match[str]) -> str:
        target = _place(_repository_path(here, link[2]), files)
        if target is None:
            return link[0]
        return link[1] + posixpath.relpath(target, posixpath.dirname(here) or ".") + link[3]

    return "".join(text if text.startswith("```") else _LINK.sub(turned, text) for text in _FENCE.split(markdown))


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """Warn of a page that would fetch something from another host."""
    for found in _FETCHED.findall(output):
        log.warning("%s is not complete without a network: %s", page.file.src_uri, found)
    return output


def _repository_path(page: str, target: str) -> str | None:
    """Where a link of a page leads to, from the root of the repository; None for addresses."""
    if ":" in target:
        return None
    made_from = {made: source for source, made in PAGES.items()}
    source = made_from.get(page, f"docs/{page}")
    folder = source if (ROOT / source).is_dir() else posixpath.dirname(source)
    return posixpath.normpath(posixpath.join(folder, target))


def _place(path: str | None, files: Files) -> str | None:
    """Page or file of the site that shows a file of the repository."""
    if path is None:
        return None
    candidates = (PAGES.get(path), path.removeprefix("docs/"), _shown(path))
    return next((c for c in candidates if c and files.get_file_from_path(c) is not None), None)


def _linked(files: Files) -> Iterator[str]:
    """Files of the repository that pages link and that are not in the site."""
    found = set()
    for file in files.documentation_pages():
        for _, target, _ in _LINK.findall(_FENCE.sub("", file.content_string)):
            path = _repository_path(file.src_uri, target)
            if path and _place(path, files) is None and (ROOT / path).is_file():
                found.add(path)
    yield from found


def _shown(source: str) -> str:
    return f"files/{source}.md"


def _source_page(path: Path) -> str:
    language = {".py": "python", ".yaml": "yaml"}.get(path.suffix, "text")
    name = path.relative_to(ROOT).as_posix()
    return f"# {name}\n\n```{language}\n{path.read_text(encoding='utf-8')}```\n"


def _examples() -> str:
    """One line per example: the first line of its docstring."""
    lines = ["# Examples\n", "Each script does one thing; run it from a checkout.\n"]
    lines += ["| script | purpose |", "| --- | --- |"]
    for path in sorted((ROOT / "examples").glob("*.py")):
        summary = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]
        lines.append(f"| [{path.name}]({path.name}) | {summary} |")
    lines += [
        "",
        "- [A listening test](listening_test/README.md), from manifest to pages",
        "- [A plugin package](third_party_plugin) of a third party's: a plate as a body, and a zither on it",
    ]
    return "\n".join(lines) + "\n"


def _licence(path: Path) -> str:
    return (
        "# Licence\n\nThe code is under the MIT licence, below. Measured data of the instruments (tables under "
        "`instruments/`) are under the Creative Commons Attribution 4.0 licence, whose text is in "
        "`LICENSES/CC-BY-4.0.txt`: each bundle and each table names its source, its authors and the changes made.\n\n"
        f"```text\n{path.read_text(encoding='utf-8')}```\n"
    )


def _cite(path: Path) -> str:
    return (
        "# How to cite\n\nPlease cite the software and the papers of the methods that you used. In the Citation File "
        f"Format:\n\n```yaml\n{path.read_text(encoding='utf-8')}```\n"
    )


_COMMANDS = """# Commands

How do I call tonewood, and read its answers in a script?

- **Help.** `tonewood -h` lists the commands, `tonewood COMMAND -h` prints the text below, `tonewood --version` the
  version.
- **Completion.** Run `tonewood --install-completion` once and open a new shell (bash, zsh, fish, PowerShell): Tab
  completes commands, options and names of instruments. `tonewood --show-completion` prints the script instead.
- **Report.** With `--json` a command prints one object on standard output, nothing else.
- **Exit codes.** 0: done. 1: a test failed, no note could be played, or `--check` found something. 2: an error to mend.
  130: Ctrl-C.

Every report under `--json` begins with the same two keys: `{"schema": "tonewood-render/1", "ok": true, ...}`. `ok` is
whether the exit code is 0; numbers that are not finite are null. An error stands there, too, beside its one line on
standard error, with null for keys that do not apply:

```json
{"schema": "tonewood-error/1", "ok": false, "error": {"kind": "BundleError", "file": "m/instrument.yaml",
 "line": 20, "key": "strings.A2.length", "reason": "is 900 m; at most 5 m: did you mean 900 mm (0.9)?",
 "exit_code": 2}}
```

`kind` is the class of the error, `UsageError` for wrong arguments, or `Interrupted`. `tonewood schema` prints a JSON
schema and takes no `--json`. To foresee a render, put `plan` in place of `render` in its command line and leave out
`--block`, `--normalize`, `--limiter` and `--energy`.
"""


def _commands() -> str:
    """Reference of the command line, from the declarations of the commands."""
    from tonewood.cli.commands import COMMANDS

    lines = [_COMMANDS]
    for name, place in COMMANDS.items():
        module, _, function = place.partition(":")
        command = getattr(importlib.import_module(f"tonewood.cli.{module}"), function)
        hints = get_type_hints(command, include_extras=True)
        arguments, options = [], []
        for parameter in inspect.signature(command).parameters.values():
            if parameter.name == "context":
                continue
            info = hints[parameter.name].__metadata__[0]
            required = parameter.default is parameter.empty
            default = "required" if required else f"`{parameter.default}`"
            if parameter.default in (None, False):
                default = ""
            row = f"{default} | {' '.join((info.help or '').split()).replace('|', chr(92) + '|')} |"
            value = info.metavar or _VALUES.get(hints[parameter.name].__origin__, "TEXT")
            if isinstance(info, typer.models.ArgumentInfo):
                word = info.metavar or parameter.name.upper()
                arguments.append((word if required else f"[{word}]", f"| `{word}` | {row}"))
            else:
                # typer keeps the first spelling as the default
                spelled = [s for s in (info.default, *(info.param_decls or ())) if isinstance(s, str)]
                spelled = spelled or [f"--{parameter.name.replace('_', '-')}"]
                options.append(f"| {', '.join(f'`{s} {value}`'.replace(' `', '`') for s in spelled)} | {row}")
        words = "".join(f" {word}" for word, _ in arguments)
        text = inspect.getdoc(command) or ""
        lines += [f"## tonewood {name}\n", f"    tonewood {name}{words}{' [OPTIONS]' * bool(options)}\n", text, ""]
        if arguments or options:
            lines += ["| argument or option | default | meaning |", "| --- | --- | --- |"]
            lines += [*(row for _, row in arguments), *options, ""]
    return "\n".join(lines)


def _schema() -> str:
    """Keys of a bundle and of the built-in plugins, each table under a heading that can be linked."""
    from tonewood.instrument.bundle.schema_table import bundle_tables, plugin_tables

    def headed(tables: str) -> str:
        tables = re.sub(r"^\*\*(.+)\*\*(?::? (.*))?$", r"### \1\n\n\2", tables, flags=re.MULTILINE)
        return re.sub(r"^\*(.+)\*, (\w+): (.*)$", r"#### \1: \2\n\n\3", tables, flags=re.MULTILINE)

    return (
        "# Schema of instruments\n\n"
        "Which keys may a bundle have? [Make an instrument](../make_an_instrument.md) explains them. "
        "For editors: [tonewood-instrument.schema.json](tonewood-instrument.schema.json), printed by "
        "`tonewood schema`.\n\n"
        f"## Keys of a bundle\n\n{headed(bundle_tables())}\n"
        f"## Keys of the built-in plugins\n\n{headed(plugin_tables())}"
    )
