"""Tables as CSV text that is safe to open in a spreadsheet."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

#: first characters by which spreadsheets know a formula, or may after they have cut white space
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH PLUS SIGN}",
            "\N{FULLWIDTH HYPHEN-MINUS}", "\N{FULLWIDTH COMMERCIAL AT}")  # fmt: skip
#: where some programs begin a new cell, whatever stands around it: semicolons, tabs, ends of lines
_SEPARATOR = re.compile("([;\t\n])")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """A table with a row of names; cells that a row lacks are empty.

    A text that begins like a formula gets an apostrophe in front, which makes it text in a spreadsheet; so does what
    follows a semicolon, a tab or the end of a line in it, because spreadsheets may split cells there. Numbers stay as
    they are, also those written as text.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_cell(name) for name in columns])
    for row in rows:
        writer.writerow([_cell(row.get(name, "")) for name in columns])
    return text.getvalue()


def _cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    value = value.replace("\r\n", "\n").replace("\r", "\n")
    first, *others = _SEPARATOR.split(value)
    return _text(first, value) + "".join(_text(part, part) for part in others)


def _text(part: str, begins: str) -> str:
    """A part of a cell, with an apostrophe in front where `begins` begins a formula and is no number."""
    if begins in (";", "\t", "\n") or not begins.lstrip(" \N{NO-BREAK SPACE}\0").startswith(_FORMULA):
        return part
    try:
        float(begins)
    except ValueError:
        return "'" + part
    return part
