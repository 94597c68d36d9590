"""Arrays that take seconds to compute, kept between runs: a file per content, safe to delete at any time.

The files lie in the `cache_folder`. A file's name is a hash of the inputs, of the sources of the package that computes,
and of NumPy with its BLAS library and SciPy: the arrays found are those that would be computed, to the last bit.
SciPy's own BLAS library has the version that SciPy brings, and the processor kernel of NumPy's.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import OutputError
from tonewood.support.blas import numpy_blas
from tonewood.support.cache_folder import cache_folder
from tonewood.support.whole_files import whole_file

Arrays = dict[str, NDArray[Any]]

#: results of this process, the latest last
_RECENT: dict[str, Arrays] = {}
_MOST_RECENT = 16


def cached_arrays(
    inputs: Mapping[str, Any], make: Callable[[], Mapping[str, NDArray[Any]]], package: str = "plate"
) -> Arrays:
    """Return the arrays of `make`, computed once for the same inputs.

    Parameters
    ----------
    inputs : everything that decides on the result, as plain values (JSON).
    make : computes name -> array.
    package : of tonewood, whose sources are part of the hash.
    """
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True, ensure_ascii=True).encode())
    digest.update(_sources(package).encode())
    key = digest.hexdigest()
    if key in _RECENT:
        return _RECENT[key]
    path = _path(key)
    found = _read(path) if path is not None else None
    if found is None:
        found = dict(make())
        if path is not None:
            try:
                with whole_file(path, make_folder=True) as stream:
                    np.savez_compressed(stream, **cast(Any, found))
            except OutputError:
                pass  # nothing is lost but time
    while len(_RECENT) >= _MOST_RECENT:
        del _RECENT[next(iter(_RECENT))]
    _RECENT[key] = found
    return found


def _path(key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / f"{key[:32]}.npz"


def _read(path: Path) -> Arrays | None:
    """Arrays of a file; None where it is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


@cache
def _sources(package: str) -> str:
    """Hash of a package's sources and of the libraries that compute for it."""
    digest = hashlib.sha256(" ".join([np.__version__, *numpy_blas(), version("scipy")]).encode())
    for path in sorted((Path(__file__).parents[2] / package).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
