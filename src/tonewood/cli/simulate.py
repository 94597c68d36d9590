"""``tonewood simulate``: listeners with known effects take a test."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import allow


def simulate(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="output folder of `tonewood batch`")],
    panel: Annotated[Path, typer.Option(help="YAML file with the effects that the listeners hear")],
    listeners: Annotated[int, typer.Option(help="number of them")] = 20,
    seed: Annotated[int, typer.Option(help="of their answers")] = 1,
) -> None:
    """Let simulated listeners take the test of DIR; their answers are marked as simulated wherever they are shown."""
    from tonewood.support.folder_lock import locked
    from tonewood.workshop.listening.definition import load_test
    from tonewood.workshop.listening.panel import read_panel, simulate

    allow("--listeners", listeners, 1, 10_000, "")
    load_test(folder)  # its fault comes first
    with locked(folder, "tonewood simulate"):
        answers = simulate(load_test(folder), read_panel(panel), listeners, seed)
    print(f"{folder}: {len(answers)} simulated listeners")
