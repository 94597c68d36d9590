"""``tonewood validate``: every system of the papers against references from outside the code.

Rows of a reconstruction or stand-in that was fitted to the reference are listed as regression.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tonewood.cli.common import Json, need, print_json


def validate(
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help="system, or the beginning of some names, e.g. fabre; repeatable"),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", metavar="DIR", help="redraw the papers' figures into DIR")
    ] = None,
    as_json: Json = False,
) -> int:
    """Print one row per checked quantity; exit code 1 if one fails.

    Rows whose system was fitted to the reference (a reconstruction, a stand-in) are called regression, not validation.
    """
    if plots is not None:
        need("plot", "matplotlib")
    from rich.console import Console

    from tonewood.lab import validation

    validation.selected(only)
    console = Console(highlight=False, quiet=as_json)
    if not console.is_terminal:
        console = Console(width=180, highlight=False, quiet=as_json)
    rows = []
    for name, group in validation.run_each(only):
        console.print(validation.table(name, group))
        rows += group
    failed = [row for row in rows if not row.passed]
    console.print(f"{validation.counted(rows)}, {len(failed)} failed")
    for row in failed:
        console.print(f"FAILED: {row.system}: {row.quantity}: error {row.error:.3g}, tolerance {row.tolerance:.3g}")
    if plots is not None:
        for path in validation.draw(plots, only):
            console.print(f"{path}")
    if as_json:
        print_json("validation", validation.to_json(rows), ok=not failed)
    return 1 if failed else 0
