"""Entry point: one line on stderr and exit code 2 for what a user can mend (1: no note played), 130 for Ctrl-C."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn

from tonewood.cli.commands import InterruptError, ReaderGoneError
from tonewood.errors import TonewoodError

#: exit code, as shells have it
_INTERRUPTED = 130


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    given = sys.argv[1:] if arguments is None else arguments
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever called
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  # as long as the process
    try:
        # imported here, so that Ctrl-C meanwhile is caught
        from tonewood.cli.app import ABORTED, ClickError, application

        try:
            code = application(given[0] if given else None)(args=given or ["--help"], standalone_mode=False)
        except ClickError as error:
            message = error.format_message() if hasattr(error, "format_message") else str(error)
            _fail(" ".join(message.split()), 2)
        except ABORTED:
            raise InterruptError from None
        if code == _INTERRUPTED:  # exit code of typer for a Ctrl-C before the command has begun
            raise InterruptError
    except TonewoodError as error:
        _fail(str(error), error.exit_code)
    except (InterruptError, KeyboardInterrupt) as error:
        # Where a KeyboardInterrupt has passed a call of exec (every dataclass makes some), CPython ends by killing
        # itself with the signal, whatever the exit code; another call makes it forget.
        exec("")
        _fail(f"interrupted; {str(error) or 'nothing was written'}", _INTERRUPTED)
    except ReaderGoneError:
        _no_more_output()
        sys.exit(0)
    except OSError as error:
        if error.filename is not None:
            raise
        _no_more_output()
        _fail(f"standard output: cannot be written: {error.strerror}", 2)
    sys.exit(code if isinstance(code, int) else 0)


def _no_more_output() -> None:
    """Redirect standard output to nowhere: the rest of its buffer would fail again when the interpreter ends."""
    with suppress(OSError, ValueError):  # no file at all, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(line: str, code: int) -> NoReturn:
    with suppress(OSError):  # stderr cannot be written to
        print(f"tonewood: {line}", file=sys.stderr)
    sys.exit(code)
