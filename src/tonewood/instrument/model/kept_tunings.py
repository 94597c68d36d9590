"""Tunings of open strings, kept between runs: a file per instrument and limit of modes, safe to delete at any time.

The files lie in the `cache_folder`. A file's key is a hash of all that the tunings depend on: the bundle's values and
other files, its plugins' sources, the computing sources (by length and time), NumPy with its BLAS library, and SciPy.
So a render has the same samples with the file and without it. A damaged file is computed again, with a warning.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.tuning import CoupledMode, TunedStop
from tonewood.support.blas import numpy_blas
from tonewood.support.cache_folder import cache_folder, keep, read_kept

#: packages whose sources decide on a tuning; "" for the modules beside them
_SOURCES = ("physics", "instrument", "support", "performance/score")


class KeptTunings:
    """Tunings of an instrument's open strings, from an earlier run and from this one.

    instrument : with its plugins made.
    limit : Hz, no mode is stepped above it.
    """

    def __init__(self, instrument: Instrument, limit: float):
        self._key = _key(instrument, limit)
        #: string -> tension (N) at which its modes were first computed, and its tuning
        self.entries: dict[str, tuple[float, TunedStop]] = {}
        if self._key is not None:
            self.entries = read_kept("tunings", self._key, _decoded) or {}
        self._complete = True

    def add(self, name: str, guess: float, tuned: TunedStop) -> None:
        """Enter a new tuning."""
        self.entries[name] = guess, tuned
        self._complete = False

    def save(self) -> None:
        """Write the tunings added; a file that cannot be written costs time alone."""
        if not self._complete and self._key is not None:
            rows = {name: _plain(*entry) for name, entry in self.entries.items()}
            keep("tunings", self._key, json.dumps(rows).encode())
            self._complete = True


def _plain(guess: float, tuned: TunedStop) -> dict[str, object]:
    """Values of one string for JSON, which keeps every bit of a float."""
    modes = [[m.pole.real, m.pole.imag, list(m.shares), m.strength] for m in tuned.modes]
    return {"guess": float(guess), "freq": float(tuned.freq), "tension": float(tuned.tension), "modes": modes}


def _decoded(content: bytes) -> dict[str, tuple[float, TunedStop]]:
    return {name: _entry(values) for name, values in json.loads(content).items()}


def _entry(values: Mapping[str, object]) -> tuple[float, TunedStop]:
    def number(value: object) -> float:
        if not isinstance(value, float):
            raise TypeError(f"{value!r} is no number")
        return value

    modes = []
    for real, imag, shares, strength in values["modes"]:  # type: ignore[attr-defined]  # a fault of the file is one here
        pole = complex(number(real), number(imag))
        modes.append(CoupledMode(pole, tuple(number(share) for share in shares), number(strength)))
    if not modes:
        raise ValueError("no modes")
    return number(values["guess"]), TunedStop(number(values["freq"]), number(values["tension"]), tuple(modes))


def _key(instrument: Instrument, limit: float) -> str | None:
    """Hash of all that the tunings depend on; None where nothing is kept."""
    if cache_folder() is None:
        return None
    try:
        parts = [instrument.content_hash, limit, _sources(), *_libraries()]
    except OSError:  # a file of the bundle is gone
        return None
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _stamp(path: Path) -> str:
    stat = path.stat()
    return f"{path.name} {stat.st_size} {stat.st_mtime_ns}"


@cache
def _sources() -> str:
    """Names, lengths and times of the source files, as a hash."""
    files = (path for room in _SOURCES for path in sorted((Path(__file__).parents[2] / room).rglob("*.py")))
    return hashlib.sha256("\n".join(_stamp(path) for path in files).encode()).hexdigest()


@cache
def _libraries() -> tuple[object, ...]:
    """Versions of the libraries that compute; the same for a whole process."""
    return np.__version__, numpy_blas(), version("scipy")
