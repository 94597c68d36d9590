"""Tables of results: a DataFrame where pandas is installed, and a light table with the same columns elsewhere."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: rows that a notebook shows of a longer table
_SHOWN = 60


class Table:
    """Columns of equal length.

    columns : name, with its unit where it has one -> values.
    Raises ValueError : the columns differ in length.
    """

    def __init__(self, columns: Mapping[str, Sequence[Any]]):
        self._columns = {name: list(values) for name, values in columns.items()}
        if len({len(values) for values in self._columns.values()}) > 1:
            raise ValueError("columns of a table must be equally long")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self._columns)

    def __getitem__(self, column: str) -> list[Any]:
        return list(self._columns[column])

    def __len__(self) -> int:
        return len(next(iter(self._columns.values()), []))

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def rows(self) -> list[tuple[Any, ...]]:
        """Rows, each with a value per column."""
        return list(zip(*self._columns.values(), strict=True))

    def __repr__(self) -> str:
        cells = [list(self.columns), *([_text(v) for v in row] for row in self.rows()[:_SHOWN])]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.columns))]
        lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
        return "\n".join([*lines, *self._rest()])

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{html.escape(name)}</th>" for name in self.columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_text(v))}</td>" for v in row) + "</tr>" for row in self.rows()[:_SHOWN]
        )
        rest = "".join(f"<p>{line}</p>" for line in self._rest())
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{rest}"

    def _rest(self) -> list[str]:
        more = len(self) - _SHOWN
        return [f"and {more} rows more"] if more > 0 else []


def table(columns: Mapping[str, Sequence[Any]]) -> Any:
    """Make a table: a `pandas.DataFrame` where pandas is installed, else a `Table`."""
    try:
        import pandas
    except ImportError:
        return Table(columns)
    return pandas.DataFrame(dict(columns))


def properties_html(title: str, rows: Mapping[str, object]) -> str:
    """HTML of an object in a notebook: a heading and a table of its properties, all escaped."""
    left = "style='text-align:left'"
    cells = "".join(
        f"<tr><th {left}>{html.escape(name)}</th><td {left}>{html.escape(str(v))}</td></tr>" for name, v in rows.items()
    )
    return f"<strong>{html.escape(title)}</strong><table>{cells}</table>"


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
