"""The BLAS libraries that NumPy and SciPy call: one thread while the library computes, and their identity.

Matrices here have a few hundred rows at most. Threads gain nothing on them, cost much where other processes run too,
and change the order of sums, so that samples would depend on their number.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


@cache
def _libraries() -> tuple[Any, ...]:
    """Controllers of the BLAS libraries loaded, those of NumPy and of SciPy among them."""
    import scipy.linalg  # noqa: F401  # loads its own
    from threadpoolctl import ThreadpoolController

    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


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
        self.lock, self.entries, self.before = Lock(), 0, list[int]()

    def __enter__(self) -> None:
        with self.lock:
            self.entries += 1
            if self.entries == 1:
                self.before = [library.get_num_threads() for library in _libraries()]
                for library in _libraries():
                    _set_threads(library, 1)

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.entries -= 1
            if self.entries == 0:
                for library, threads in zip(_libraries(), self.before, strict=True):
                    _set_threads(library, threads)


_ONE_THREAD = _OneThread()


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with BLAS limited to one thread, process-wide; the limit before it comes back after it."""

    @wraps(function)
    def limited(*args: P.args, **options: P.kwargs) -> R:
        with _ONE_THREAD:
            return function(*args, **options)

    return limited


def blas_libraries() -> list[str]:
    """Name, version and processor kernel of each, as `openblas 0.3.30 SkylakeX`: their sums differ in the last bits."""
    found = (library.info() for library in _libraries())
    names = [f"{i['internal_api']} {i['version']} {i.get('architecture') or ''}".rstrip() for i in found]
    return sorted(set(names))
