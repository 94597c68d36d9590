"""Parallel work in processes, threads, or on a Dask cluster, through joblib.

Processes are the default. The kernel releases the interpreter lock while it steps, but a render of a short note spends
about half of its time in Python (tuning strings, solving for bases, joining blocks), where two threads wait for each
other; sound files are the same either way.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeVar

from tonewood.errors import OldFormatWarning, TonewoodError

T = TypeVar("T")
R = TypeVar("R")
Backend = Literal["processes", "threads"]
_JOBLIB = {"processes": "loky", "threads": "threading"}


@dataclass(frozen=True)
class Workers:
    """Place of the work.

    jobs : workers on this machine; -1 for one per core.
    cluster : address of a Dask scheduler, instead of this machine.
    """

    jobs: int = 1
    backend: Backend = "processes"
    cluster: str | None = None

    @property
    def count(self) -> int:
        """Number of workers on this machine."""
        from joblib import effective_n_jobs

        return int(effective_n_jobs(self.jobs))

    def local(self) -> Workers:
        """Return these workers without the cluster, for work on this machine's files."""
        return Workers(self.jobs, self.backend)

    def each(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """Results of `function` in the order they are finished; each is dropped here once it is taken.

        Raises TonewoodError : a worker process died, the cluster does not answer, or the current folder was removed.
        """
        from joblib import Parallel, delayed
        from joblib.externals.loky.process_executor import BrokenProcessPool

        if self.cluster is None and self.backend == "processes":
            try:
                function = partial(_in_folder, os.getcwd(), function)
            except FileNotFoundError:
                raise TonewoodError("the current folder is not there any more: go to another one") from None
        with self._backend(len(items)) as options:
            try:
                parallel = Parallel(return_as="generator_unordered", pre_dispatch="2*n_jobs", **options)
                with warnings.catch_warnings():
                    # the error that ends it gives the reason
                    warnings.filterwarnings("ignore", message=r"\d+ tasks? (which|have been)", category=UserWarning)
                    yield from parallel(delayed(function)(item) for item in items)
            except BrokenProcessPool:
                raise TonewoodError(
                    "a worker process died (out of memory?); finished work is kept: run again"
                ) from None

    @contextlib.contextmanager
    def _backend(self, n_items: int) -> Iterator[dict[str, Any]]:
        if self.cluster is None:
            yield {"n_jobs": max(1, min(self.count, n_items)), "backend": _JOBLIB[self.backend]}
            return
        from distributed import Client
        from joblib import parallel_config

        try:
            client = Client(self.cluster, timeout="20s")  # type: ignore[no-untyped-call]  # has no types
        except (OSError, ValueError) as fault:
            raise TonewoodError(f"cluster {self.cluster} does not answer: {fault}") from None
        with client, parallel_config(backend="dask", wait_for_workers_timeout=60):
            yield {"n_jobs": -1}


def _in_folder(folder: str, function: Callable[[T], R], item: T) -> R:
    """Call a function in the caller's current folder: worker processes may be left from a call made in another one."""
    os.chdir(folder)
    warnings.simplefilter("ignore", OldFormatWarning)  # the caller's process has shown it
    return function(item)
