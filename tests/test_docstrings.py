"""Docstrings of public names: each parameter, field and error is named."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LISTED = sorted(
    name
    for page in (ROOT / "docs" / "reference").glob("*.md")
    for name in re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
)


def thing(name: str) -> object:
    module, _, last = name.rpartition(".")
    return getattr(importlib.import_module(module), last)


def missing(function: object, context: str) -> list[str]:
    """Parameters and errors of a function that neither its docstring nor its class's names."""
    doc = f"{inspect.getdoc(function) or ''} {context}"
    node = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(function)))).body[0]  # type: ignore[arg-type]
    assert isinstance(node, ast.FunctionDef)
    names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    raised = [
        ast.unparse(n.exc.func) for n in ast.walk(node) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)
    ]
    wanted = {n for n in names if n not in ("self", "cls") and n[0] != "_"} | {r for r in raised if r.endswith("Error")}
    return [word for word in sorted(wanted) if not re.search(rf"\b{re.escape(word)}\b", doc)]


@pytest.mark.parametrize("name", LISTED)
def test_docstrings_name_parameters_and_errors(name: str) -> None:
    found = thing(name)
    if inspect.isfunction(found):
        assert missing(found, "") == []
    if not inspect.isclass(found):
        return
    own = inspect.getdoc(found) or ""
    if dataclasses.is_dataclass(found):
        assert [f.name for f in dataclasses.fields(found) if not re.search(rf"\b{f.name}\b", own)] == []
    for key, value in vars(found).items():
        method = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        if key[0] != "_" and inspect.isfunction(method) and method.__doc__:
            inherited = " ".join(inspect.getdoc(getattr(base, key, None)) or "" for base in found.__mro__[1:])
            assert missing(method, own + inherited) == [], key
