"""Writes accounts of energy as JSON, CSV or a picture, by the suffix of the file."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

from tonewood.errors import TonewoodError
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.support.whole_files import AtomicFile, whole_file, write_whole

_ENDINGS = (".json", ".csv", ".png")
_KINDS = ("stored", "supplied", "booked", "lost")


def check_energy_file(path: Path) -> None:
    """Check before a long render that an account can be written to a file.

    Raises TonewoodError : another ending than .json, .csv or .png, a place that cannot be written to, or no matplotlib
        for a picture.
    """
    if path.suffix.lower() not in _ENDINGS:
        raise TonewoodError(f"is {path.name!r}; a name ending in {', '.join(_ENDINGS)} is allowed", key="--energy")
    AtomicFile(path).discard()
    if path.suffix.lower() == ".png":
        try:
            import matplotlib  # noqa: F401  # better to know now
        except ImportError:
            raise TonewoodError('pictures need matplotlib: pip install "tonewood[plot]"', key="--energy") from None


def energy_csv(trace: EnergyTrace) -> str:
    """A row per interval: time, steps, every entry in J and the residual; columns ``stored:NAME`` and so on."""
    columns = {f"{kind}:{name}": values for kind in _KINDS for name, values in getattr(trace, kind).items()}
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(["time_s", "steps", *columns, "residual"])
    for row in zip(trace.time, trace.steps, *columns.values(), trace.residual, strict=True):
        writer.writerow([repr(value.item()) for value in row])
    return rows.getvalue()


def save_energy(trace: EnergyTrace, path: Path) -> None:
    """Write an account to a file that appears only when it is complete.

    Raises TonewoodError : see `check_energy_file`.
    Raises OutputError : it cannot be written.
    """
    check_energy_file(path)
    ending = path.suffix.lower()
    if ending == ".png":
        with whole_file(path) as stream:
            trace.plot(stream)
    else:
        write_whole(path, energy_csv(trace) if ending == ".csv" else json.dumps(trace.to_dict(), allow_nan=False))
