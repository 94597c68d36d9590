"""Every notebook runs from top to bottom, and shows what it says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook["cells"] if cell["cell_type"] == "code" for output in cell["outputs"]]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebooks_are_kept_without_outputs_and_compile(path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert outputs(notebook) == []
    for i, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            compile("".join(cell["source"]), f"{path.name}[{i}]", "exec")


def test_there_is_one_for_each_reader() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["maker", "musician", "researcher"]


@pytest.mark.validate
@pytest.mark.parametrize(("name", "figures", "players"), [("maker", 1, 0), ("musician", 2, 4), ("researcher", 2, 0)])
def test_a_notebook_runs(name: str, figures: int, players: int, tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="needs the extra `notebook`")
    nbformat = pytest.importorskip("nbformat")
    (tmp_path / "scores").symlink_to(FOLDER.parent / "scores")
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output.get("data", {}) for output in outputs(notebook)]
    assert sum("image/png" in data for data in shown) == figures
    assert sum("<audio" in data.get("text/html", "") for data in shown) == players
    assert not [output for output in outputs(notebook) if output["output_type"] == "error"]
