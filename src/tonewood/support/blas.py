"""The BLAS libraries that NumPy and SciPy call: one thread while the library computes, and their identity.

Matrices here have a few hundred rows at most. Threads gain nothing on them, cost much where other processes run too,
and change the order of sums, so that samples would depend on their number.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


@cache
def _libraries(with_scipy: bool) -> tuple[Any, ...]:
    """Controllers of the BLAS libraries loaded: that of NumPy, and once it is imported that of `scipy.linalg`."""
    from threadpoolctl import ThreadpoolController

    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


def _loaded() -> tuple[Any, ...]:
    """Controllers of the libraries loaded now; `scipy.linalg` has a `solve` once it is imported as a whole."""
    return _libraries(hasattr(sys.modules.get("scipy.linalg"), "solve"))


def _set_threads(library: Any, threads: int) -> None:
    """Set a library's number of threads from any thread: threadpoolctl heeds only the first that changed OpenBLAS."""
    for prefix in ("scipy_", ""):
        for suffix in ("", "64_", "_64", "_64_"):
            if setter := getattr(library.dynlib, f"{prefix}openblas_set_num_threads{suffix}", None):
                setter(threads)
                return
    library.set_num_threads(threads)


class _OneThread:
    """Limits BLAS to one thread from the first entry to the last exit, in whichever threads these are."""

    def __init__(self) -> None:
        self.lock, self.entries = Lock(), 0
        #: file of a library -> its controller, and its number of threads before
        self.before = dict[str, tuple[Any, int]]()

    def __enter__(self) -> None:
        with self.lock:
            self.entries += 1
            if self.entries == 1:
                self._limit()

    def _limit(self) -> None:
        for library in _loaded():
            if library.filepath not in self.before:
                self.before[library.filepath] = library, library.get_num_threads()
                _set_threads(library, 1)

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.entries -= 1
            if self.entries == 0:
                for library, threads in self.before.values():
                    _set_threads(library, threads)
                self.before.clear()

    def limit_libraries(self) -> None:
        """Limit the libraries loaded since the first entry."""
        with self.lock:
            if self.entries > 0:
                self._limit()


_ONE_THREAD = _OneThread()
#: to be called where a library has been loaded: it obeys the limit that is in force
limit_libraries = _ONE_THREAD.limit_libraries


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with BLAS limited to one thread, process-wide; the limit before it comes back after it."""

    @wraps(function)
    def limited(*args: P.args, **options: P.kwargs) -> R:
        with _ONE_THREAD:
            return function(*args, **options)

    return limited


def numpy_blas() -> list[str]:
    """As `blas_libraries`, of those loaded without `scipy.linalg`."""
    return _named(_libraries(False))


def blas_libraries() -> list[str]:
    """Name, version and processor kernel of each, as `openblas 0.3.30 SkylakeX`: their sums differ in the last bits."""
    import scipy.linalg  # noqa: F401  # loads its own

    return _named(_loaded())


def _named(libraries: tuple[Any, ...]) -> list[str]:
    infos = (library.info() for library in libraries)
    names = [f"{i['internal_api']} {i['version']} {i.get('architecture') or ''}".rstrip() for i in infos]
    return sorted(set(names))
