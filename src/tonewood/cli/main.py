"""Entry point: one line on stderr and exit code 2 for what a user can mend (1: no note played), 130 for Ctrl-C."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn

from tonewood.errors import TonewoodError

#: command -> module and function
COMMANDS = {
    "render": "render:render",
    "play": "play:play",
    "list": "listing:list_installed",
    "plan": "plan:plan",
    "check": "check:check",
    "modes": "modes:modes",
    "schema": "schema:schema",
    "migrate": "migrate:migrate",
    "batch": "batch:batch",
    "results": "results:results",
    "validate": "validate:validate",
    "accuracy": "accuracy:accuracy",
}

#: exit code, as shells have it
_INTERRUPTED = 130


class InterruptError(Exception):
    """Ctrl-C inside a command: typer would turn a KeyboardInterrupt into an exit code without a word.

    Its text says what is left behind.
    """


class ReaderGoneError(Exception):
    """Nobody reads standard output any more, as behind ``| head``; typer would make an exit code of that, too."""


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    given = sys.argv[1:] if arguments is None else arguments
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever called
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  # as long as the process
    try:
        # within the reach of Ctrl-C, as it takes a while
        from tonewood.cli.app import ABORTED, ClickError, application

        try:
            code = application(given[0] if given else None)(args=given or ["--help"], standalone_mode=False)
        except ClickError as error:
            message = error.format_message() if hasattr(error, "format_message") else str(error)
            _fail(" ".join(message.split()), 2)
        except ABORTED:
            raise InterruptError from None
        if code == _INTERRUPTED:  # what typer makes of a Ctrl-C before the command has begun
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
    """What still waits to be written goes nowhere, instead of failing again when the interpreter ends."""
    with suppress(OSError, ValueError):  # no file at all, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(line: str, code: int) -> NoReturn:
    with suppress(OSError):  # nowhere to say it
        print(f"tonewood: {line}", file=sys.stderr)
    sys.exit(code)
