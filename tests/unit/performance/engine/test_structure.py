"""The engine's modules: no circles among their imports, no file that is too long to read."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import tonewood.performance

FOLDER = Path(tonewood.performance.__path__[0])
FILES = sorted(FOLDER.rglob("*.py"))


def module(path: Path) -> str:
    parts = path.relative_to(FOLDER).with_suffix("").parts
    return ".".join(["tonewood", "performance", *(part for part in parts if part != "__init__")])


def test_no_import_goes_round_in_a_circle() -> None:
    names = {module(path) for path in FILES}
    graph: dict[str, set[str]] = {}
    for path in FILES:
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        graph[module(path)] = {node.module for node in nodes if node.module in names}
    assert graph["tonewood.performance.engine.engine"] > {
        "tonewood.performance.effects",
        "tonewood.performance.player.fretting",
    }
    list(TopologicalSorter(graph).static_order())  # raises CycleError


def test_no_file_is_longer_than_500_lines() -> None:
    assert {path.name for path in FILES if len(path.read_text().splitlines()) > 500} == set()
