"""All checked quantities of the laboratory in one table: every system of the papers, and closed forms.

Rows whose system was fitted to the reference are called regression, not validation (see `lab.row`).

Each module of `lab.systems` offers ``rows()`` and, where there are figures to redraw, ``plots(directory)``;
``tonewood validate`` and the tests run those listed here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from tonewood.errors import OutputError, TonewoodError
from tonewood.lab.row import Row
from tonewood.lab.tables import terminal
from tonewood.support.plain_values import finite

if TYPE_CHECKING:
    from rich.table import Table

#: name -> module of `lab.systems`
SYSTEMS = {
    "fabre_forms": "fabre_forms",
    "fabre_academic": "fabre_academic",
    "fabre_guitar": "fabre_guitar",
    "fabre_harp": "harp",
    "fabre_methods": "fabre_methods",
    "string_and_body": "string_and_body",
    "klosner": "klosner",
    "chinnakonda": "chinnakonda",
}


def selected(only: Sequence[str] | None) -> list[str]:
    """Names of the systems that `only` asks for: each entry is a name or the beginning of some (``fabre``).

    Raises TonewoodError : an entry fits no name.
    """
    if not only:
        return list(SYSTEMS)
    names = []
    for entry in only:
        matches = [name for name in SYSTEMS if name.startswith(entry)]
        if not matches or not entry:
            raise TonewoodError(
                f"is {entry!r}; there are {', '.join(SYSTEMS)}, or the beginning of these", key="--only"
            )
        names += [name for name in matches if name not in names]
    return names


def run(only: Sequence[str] | None = None) -> list[Row]:
    """Compute the rows of some systems, or of all."""
    return [row for _, rows in run_each(only) for row in rows]


def run_each(only: Sequence[str] | None = None) -> Iterator[tuple[str, list[Row]]]:
    """Yield the rows system by system, as each is done."""
    for name in selected(only):
        yield name, list(_module(name).rows())


def draw(directory: Path, only: Sequence[str] | None = None) -> list[Path]:
    """Redraw the papers' figures as PNG files; return their paths."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise OutputError(f"cannot be made: {fault.strerror}", file=directory) from None
    modules = [_module(name) for name in selected(only)]
    return [path for module in modules if hasattr(module, "plots") for path in module.plots(directory)]


def to_json(rows: Sequence[Row]) -> dict[str, object]:
    """``{"rows": [...]}``; a value that is not a number becomes null."""
    return {"rows": [finite(row.to_dict()) for row in rows]}


def counted(rows: Sequence[Row]) -> str:
    """How many rows there are, and how many of each kind where there are two."""
    fitted = sum(row.kind == "regression" for row in rows)
    return f"{len(rows)} rows" + (f" ({len(rows) - fitted} validation, {fitted} regression)" if fitted else "")


def table(name: str, rows: Sequence[Row]) -> Table:
    """The rows of one system for a terminal."""
    failed = sum(not row.passed for row in rows)
    title = f"{name}: {counted(rows)}" + (f", {failed} FAILED" if failed else "")
    heads = ["system", "quantity", "reference from", "reference", "value", "error", "tolerance", "kind", ""]
    cells = (
        [
            row.system, row.quantity, row.source, f"{row.reference:.6g}", f"{row.value:.6g}",
            f"{row.error:.2g}{' rel' if row.relative else ''}", f"{row.tolerance:.2g}", row.kind,
            "ok" if row.passed else "FAIL",
        ]
        for row in rows
    )  # fmt: skip
    styles = (None if row.passed else "bold red" for row in rows)
    return terminal(title, heads, zip(cells, styles, strict=True), left=3)


def _module(name: str) -> ModuleType:
    return import_module(f"tonewood.lab.systems.{SYSTEMS[name]}")
