"""Tables of results as Markdown and for a terminal, numbers in few digits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.table import Table

T = TypeVar("T")


def number(value: float | None, digits: int = 2) -> str:
    """Few digits; nothing for an unknown value."""
    if value is None or not math.isfinite(value):
        return ""
    return f"{value:.{digits}g}" if value == 0 or 1e-3 <= abs(value) < 1e4 else f"{value:.{digits - 1}e}"


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    """A table, aligned to be read as it is; the first `left` columns to the left."""
    cells = [list(heads), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(heads))]
    rule = ["-" * w if i < left else "-" * (w - 1) + ":" for i, w in enumerate(widths)]
    padded = [
        [c.ljust(w) if i < left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))]
        for row in [cells[0], rule, *cells[1:]]
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in padded)


def table(items: Iterable[T], columns: Mapping[str, Callable[[T], str]], *, left: int = 1) -> str:
    """A `markdown` table of a row per item; `columns` says the cell below each heading."""
    return markdown(list(columns), ([cell(item) for cell in columns.values()] for item in items), left=left)


def terminal(
    title: str, heads: Sequence[str], rows: Iterable[tuple[Sequence[str], str | None]], left: int = 1
) -> Table:
    """A table for a terminal, of rows and their styles; the first `left` columns fold, the others do not wrap."""
    from rich.table import Table

    out = Table(title=title, title_justify="left", expand=False)
    for i, head in enumerate(heads):
        out.add_column(head, overflow="fold", no_wrap=i >= left, justify="right" if left <= i < left + 4 else "left")
    for cells, style in rows:
        out.add_row(*cells, style=style)
    return out
