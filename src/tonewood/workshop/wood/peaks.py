"""Peaks of a tapped board: a table, or recordings of its taps."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tonewood.errors import TonewoodError
from tonewood.support.units import number_in
from tonewood.workshop.taps.recordings import read_taps
from tonewood.workshop.taps.ringing import NORMAL_90
from tonewood.workshop.taps.strongest import strongest

#: columns of a table, and other spellings of them
_COLUMNS = {"freq_Hz": ("freq_Hz", "f_Hz", "freq", "Hz"), "Q": ("Q", "q"), "error_Hz": ("error_Hz", "sd_Hz")}
#: standard deviation re the frequency of a peak whose table states none: one read off a tuner or an analyser
READ_OFF = 2e-3


@dataclass(frozen=True, slots=True)
class BoardPeak:
    """A peak: Hz, its standard deviation (Hz), and Q (0 where it is not known)."""

    freq: float
    error: float
    q: float = 0.0


def read_peaks(paths: Sequence[Path], band: tuple[float, float]) -> tuple[list[BoardPeak], list[float]]:
    """Read the peaks of one board in a band, and the frequencies of a table outside it, Hz.

    paths : one table (.csv, as `tonewood taptone -o` writes it), or recordings of taps.
    band : Hz.
    Raises TonewoodError : a file cannot be read, or holds no peak in the band; one line.
    """
    if not paths:
        raise TonewoodError("no file was given; a table of peaks (.csv) or recordings of taps are allowed", key="FILES")
    tables = [path for path in paths if path.suffix.lower() == ".csv"]
    if tables and len(paths) > 1:
        raise TonewoodError("one table of peaks, or recordings only, are allowed", key="FILES")
    listed = sorted(_table(tables[0]) if tables else _taps(paths, band), key=lambda peak: peak.freq)
    peaks = [p for p in listed if band[0] <= p.freq <= band[1]]
    if not peaks:
        raise TonewoodError(f"no peak lies between {band[0]:g} and {band[1]:g} Hz", file=paths[0], key="--band")
    return peaks, [p.freq for p in listed if p not in peaks]


def _taps(paths: Sequence[Path], band: tuple[float, float]) -> list[BoardPeak]:
    taps = read_taps(paths)
    return [BoardPeak(peak.freq, peak.error, peak.quality) for peak in strongest(taps.usable(), taps.fs, band)]


def _table(path: Path) -> list[BoardPeak]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(line for line in file if line.strip() and not line.lstrip().startswith("#")))
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        reason = getattr(fault, "strerror", None) or "is no table of text"
        raise TonewoodError(f"cannot be read: {reason}", file=path) from None
    head = [name.strip() for name in rows[0]] if rows else []
    columns = {key: next((head.index(n) for n in names if n in head), None) for key, names in _COLUMNS.items()}
    at = columns["freq_Hz"]
    if at is None:
        raise TonewoodError(f"no column freq_Hz; there are {', '.join(head) or 'none'}", file=path)
    ends = [head.index(name) for name in ("freq_low_Hz", "freq_high_Hz") if name in head]
    out: list[BoardPeak] = []
    for line, row in enumerate(rows[1:], 2):
        if any(cell.strip() for cell in row[len(head) :]):
            raise TonewoodError(
                f"row {line}: has {len(row)} cells under {len(head)} names; decimal points, and commas between cells, "
                "are allowed", file=path,
            )  # fmt: skip

        def value(column: int | None, row: list[str] = row, line: int = line) -> float | None:
            if column is None or column >= len(row) or not row[column].strip():
                return None
            number = number_in(row[column].strip())
            if not 0 < number < 1e6:
                raise TonewoodError(f"row {line}: is {row[column]!r}; a number above 0 is allowed", file=path)
            return number

        freq = value(at)
        if freq is None and not any(cell.strip() for cell in row):
            continue
        if freq is None or any(peak.freq == freq for peak in out):
            wrong = "has no frequency" if freq is None else f"lists {freq:g} Hz a second time; once is allowed"
            raise TonewoodError(f"row {line}: {wrong}", file=path)
        error = value(columns["error_Hz"])
        if len(ends) == 2 and (low := value(ends[0])) is not None and (high := value(ends[1])) is not None:
            if high < low:
                raise TonewoodError(f"row {line}: freq_low_Hz is above freq_high_Hz", file=path)
            error = (high - low) / (2 * NORMAL_90)
        out.append(BoardPeak(freq, error or READ_OFF * freq, value(columns["Q"]) or 0.0))
    return out
