"""Stages of a computation that takes seconds, reported to a listener, such as the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count

Listener = Callable[[str], None]

_listeners: list[Listener] = []


@contextmanager
def stages(name: str, total: int) -> Iterator[Callable[[str], None]]:
    """Give a function that tells the stage which begins; all of them end with the block.

    name : of the computation.
    total : number of stages.
    """
    number = count(1)

    def begin(stage: str) -> None:
        for listener in _listeners:
            listener(f"{name} {next(number)}/{total}: {stage}")

    try:
        yield begin
    finally:
        for listener in _listeners:
            listener("")


def listen(listeners: Sequence[Listener]) -> None:
    """Tell the stages of all later computations to these listeners, and to no others."""
    _listeners[:] = listeners


def on_terminal() -> Sequence[Listener]:
    """Return a listener that shows the stage in one line of a terminal's stderr; none where that is no terminal."""
    if not sys.stderr.isatty():
        return ()
    return (lambda text: print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True),)
