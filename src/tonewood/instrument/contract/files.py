"""Files of a bundle: found only inside its folder; errors in tables name line and column."""

from __future__ import annotations

import csv
import math
from pathlib import Path, PurePosixPath

import numpy as np

from tonewood.errors import BundleError
from tonewood.support.arrays import Floats
from tonewood.support.text_files import decoded
from tonewood.support.units import number_in

#: longest table that is read, bytes
MAX_TABLE = 64_000_000
#: most rows of numbers in a table
MAX_ROWS = 200_000


class Files:
    """The folder of a bundle.

    root : the folder, or None where there is none (parts made from values alone).
    manifest : name of the file that describes the instrument, for errors.
    granted : files outside the folder that an override names.
    allow_code : whether plugins that lie as Python files in the folder may run.
    """

    def __init__(
        self,
        root: Path | None,
        manifest: Path | None = None,
        granted: frozenset[Path] = frozenset(),
        allow_code: bool = False,
    ):
        self.root = root
        self.manifest = manifest
        self.granted = granted
        self.allow_code = allow_code

    def path(self, name: str, key: str = "") -> Path:
        """File `name`, a relative path with forward slashes that stays inside the folder.

        Raises BundleError : absolute, leads out of the folder (links included), or is not a file.
        """
        if Path(name) in self.granted:
            return Path(name)
        if self.root is None:
            raise BundleError(f"table {name!r} needs a bundle's folder", key=key)
        pure = PurePosixPath(name)
        inside = not (pure.is_absolute() or ".." in pure.parts or "\\" in name or ":" in name or not pure.parts)
        try:
            path = (self.root / pure).resolve() if inside else self.root
            there = path.is_file()
        except (OSError, RuntimeError, ValueError):  # links in a circle, a name too long or with a zero byte
            raise BundleError(f"{name!r} cannot be followed to a file", file=self.manifest, key=key) from None
        if not inside or not path.is_relative_to(self.root.resolve()):
            raise BundleError(
                f"{name!r} leads out of the bundle; only relative paths inside its folder are allowed",
                file=self.manifest,
                key=key,
            )
        if not there:
            raise BundleError(f"there is no file {name!r} in the bundle", file=self.manifest, key=key)
        return path

    def table(self, name: str, key: str = "") -> dict[str, Floats]:
        """Columns of a CSV table: lines that begin with ``#`` are notes, the first other line names the columns.

        Returns column name -> (n_rows,), n_rows >= 1, every number finite.
        Raises BundleError : naming the table, line and column at fault.
        """
        header, rows, shown = self.cells(name, key)
        numbers = [
            [_number(c, column, line, shown) for c, column in zip(row, header, strict=True)] for line, row in rows
        ]
        return dict(zip(header, np.array(numbers, dtype=np.float64).T, strict=True))

    def cells(self, name: str, key: str = "") -> tuple[list[str], list[tuple[int, list[str]]], str]:
        """Cells of a CSV table as they are written.

        Returns header : names of the columns.
        rows : (number of the line, a cell per column), one or more.
        file : the table's name for errors.
        Raises BundleError : naming the table and line at fault.
        """
        path = self.path(name, key)
        shown = f"{self.manifest.parent / name}" if self.manifest else name
        if path.stat().st_size > MAX_TABLE:
            raise BundleError(f"longer than the {MAX_TABLE} bytes allowed", file=shown)
        try:
            text = decoded(path.read_bytes(), file=shown, error=BundleError)
        except OSError as fault:
            raise BundleError(f"cannot be read: {fault.strerror}", file=shown) from None
        header: list[str] = []
        rows: list[tuple[int, list[str]]] = []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            try:
                cells = [cell.strip() for cell in next(csv.reader([line]))]
            except csv.Error as fault:  # a field too long
                raise BundleError(f"line {number}: {fault}", file=shown) from None
            if not header:
                header = cells
                if len(set(header)) != len(header) or "" in header:
                    raise BundleError(f"line {number}: a column has no name or the name of another", file=shown)
                continue
            if len(rows) >= MAX_ROWS:
                raise BundleError(f"line {number}: more than the {MAX_ROWS} rows allowed", file=shown)
            if len(cells) != len(header):
                raise BundleError(f"line {number}: {len(cells)} numbers under {len(header)} columns", file=shown)
            rows.append((number, cells))
        if not rows:
            raise BundleError("holds no rows: a line of column names and lines of numbers are wanted", file=shown)
        return header, rows, shown


def _number(cell: str, column: str, line: int, file: str) -> float:
    value = number_in(cell)
    if not math.isfinite(value):
        raise BundleError(f"line {line}, column {column}: {cell!r} is not a finite number", file=file)
    return value
