"""Arrays that take seconds to compute, kept between runs: a file per content, safe to delete at any time.

The files lie in the `cache_folder`. A file's key is a hash of the inputs, of the function that computes and its source
file, of the sources of the package that it uses, and of NumPy with its BLAS library and SciPy: the arrays read are
those that would be computed, to the last bit. SciPy's own BLAS library has the version that SciPy brings, and the
processor kernel of NumPy's.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tonewood.support.blas import numpy_blas
from tonewood.support.cache_folder import keep, read_kept

Arrays = dict[str, NDArray[Any]]

#: results of this process, the latest last
_RECENT: dict[str, Arrays] = {}
_MOST_RECENT = 16


def cached_arrays(
    inputs: Mapping[str, Any], make: Callable[[], Mapping[str, NDArray[Any]]], package: str = "physics"
) -> Arrays:
    """Return the arrays of `make`, computed once for the same inputs; they cannot be written to.

    Every caller with the same inputs gets the same arrays: take a copy of one that you change.

    Parameters
    ----------
    inputs : everything that decides on the result, as plain values (JSON).
    make : computes name -> array; its name and the file that it stands in are part of the hash.
    package : of tonewood, whose sources and those of its packages are part of the hash.

    Raises
    ------
    ValueError : tonewood has no such package.
    """
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True, ensure_ascii=True).encode())
    digest.update(_sources(package).encode() + _origin(make))
    key = digest.hexdigest()
    if key in _RECENT:
        return dict(_RECENT[key])
    arrays = read_kept("arrays", key, _decoded)
    if arrays is None:
        arrays = {name: np.array(array) for name, array in make().items()}  # `make` may keep its own
        content = io.BytesIO()
        np.savez_compressed(content, **cast(Any, arrays))
        keep("arrays", key, content.getvalue())
    for array in arrays.values():
        array.setflags(write=False)
    while len(_RECENT) >= _MOST_RECENT:
        del _RECENT[next(iter(_RECENT))]
    _RECENT[key] = arrays
    return dict(arrays)


def _decoded(content: bytes) -> Arrays:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _origin(make: Callable[..., object]) -> bytes:
    """Name of a function with the content of its file: others compute something else of the same inputs."""
    module = getattr(make, "__module__", "")
    file = getattr(sys.modules.get(module), "__file__", None)
    try:
        source = b"" if file is None else Path(file).read_bytes()
    except OSError:  # not on a disk
        source = b""
    return f"{module}:{getattr(make, '__qualname__', type(make).__qualname__)}\n".encode() + source


@cache
def _sources(package: str) -> str:
    """Hash of a package's sources and of the libraries that compute for it."""
    digest = hashlib.sha256(" ".join([np.__version__, *numpy_blas(), version("scipy")]).encode())
    for path in _source_files(package):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _source_files(package: str) -> list[Path]:
    if files := sorted((Path(__file__).parents[2] / package).rglob("*.py")):
        return files
    raise ValueError(f"tonewood has no package {package!r}")
