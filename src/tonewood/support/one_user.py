"""Refusal of concurrent use: an engine has one state, and two users would each get pieces of its sound."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from tonewood.errors import TonewoodError

P = ParamSpec("P")
R = TypeVar("R")


class OneUser:
    """Context in which one thread is at a time; another one gets an error, at once. The same may enter again.

    name : in the error.
    way_out : words for the error: how to use it instead.
    """

    def __init__(self, name: str, way_out: str):
        self._line = f"this {name} is in use by another thread; {way_out}"
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise TonewoodError(self._line)

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class _Used(Protocol):
    use: OneUser


S = TypeVar("S", bound=_Used)


def alone(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Let one thread at a time into the methods of an object, which has an `OneUser` as attribute `use`."""

    @wraps(method)
    def wrapped(self: S, /, *args: P.args, **keywords: P.kwargs) -> R:
        with self.use:
            return method(self, *args, **keywords)

    return wrapped


class OneReader:
    """Lets one iteration at a time go on.

    In the thread of the one before, a new iteration takes its place, and that can be continued no more; in another
    thread it is refused until that one has ended or is closed.

    use : context of every access to the state.
    """

    def __init__(self, name: str):
        self.use = OneUser(name, "each thread needs one of its own")
        self._name = name
        self._current: tuple[object, int] | None = None

    @contextmanager
    def begun(self) -> Iterator[_Iteration]:
        """Begin an iteration, until the context is left. Raises TonewoodError : one of another thread has not ended."""
        iteration = _Iteration(self)
        with self.use:
            if self._current is not None and self._current[1] != threading.get_ident():
                raise TonewoodError(
                    f"blocks of this {self._name} are taken by another thread; each needs one of its own"
                )
            self._current = iteration, threading.get_ident()
        try:
            yield iteration
        finally:
            if self._current is not None and self._current[0] is iteration:
                self._current = None

    def check(self, iteration: object) -> None:
        """Raise a `TonewoodError` unless this is the iteration that may go on."""
        if self._current is None or self._current[0] is not iteration:
            raise TonewoodError(
                f"another iteration over the blocks of this {self._name} has begun since; one is allowed"
            )


class _Iteration:
    """Context in which an iteration makes a block."""

    def __init__(self, reader: OneReader):
        self._reader = reader

    def __enter__(self) -> None:
        self._reader.use.__enter__()
        try:
            self._reader.check(self)
        except TonewoodError:
            self._reader.use.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        self._reader.use.__exit__()
