"""Entry point: one line on stderr and exit code 2 for what a user can mend, 130 for Ctrl-C."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer

from tonewood.errors import TonewoodError

# typer may carry its own copy of click: its errors are found through it
_UsageError = typer.BadParameter.__bases__[0]
_ClickError: type[Exception] = _UsageError.__bases__[0]

#: command -> module and function
COMMANDS = {
    "render": "render:render",
    "play": "play:play",
    "list": "listing:list_installed",
    "plan": "plan:plan",
    "check": "check:check",
    "modes": "modes:modes",
    "schema": "schema:schema",
    "batch": "batch:batch",
    "results": "results:results",
    "validate": "validate:validate",
    "accuracy": "accuracy:accuracy",
}


def _app(first: str | None) -> typer.Typer:
    """The command asked for, or all of them where there is none; modules import what they need when they run."""
    app = typer.Typer(
        name="tonewood",
        add_completion=False,
        pretty_exceptions_enable=False,
        help="Physical sound synthesis: render and play scores on modelled instruments, and look into them.",
    )
    for name in [first] if first in COMMANDS else COMMANDS:
        module, _, function = COMMANDS[name].partition(":")
        app.command(name)(_interruptible(getattr(import_module(f"tonewood.cli.{module}"), function)))
    # with a single command typer would leave its name out
    app.callback()(_options)
    return app


class _InterruptError(Exception):
    """Ctrl-C inside a command; typer would turn a KeyboardInterrupt into an exit code without a word."""


def _interruptible(command: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(command)
    def wrapped(*args: Any, **options: Any) -> Any:
        try:
            return command(*args, **options)
        except KeyboardInterrupt:
            raise _InterruptError from None

    return wrapped


def _print_version(wanted: bool) -> None:
    if wanted:
        from tonewood import __version__

        print(f"tonewood {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="print the version and exit", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Options before the command."""


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    given = sys.argv[1:] if arguments is None else arguments
    app = _app(given[0] if given else None)
    try:
        code = app(args=given or ["--help"], standalone_mode=False)
    except TonewoodError as error:
        _fail(str(error), 2)
    except _ClickError as error:
        message = error.format_message() if hasattr(error, "format_message") else str(error)
        _fail(" ".join(message.split()), 2)
    except (_InterruptError, KeyboardInterrupt, typer.Abort):
        _fail("interrupted; nothing was written", 130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(line: str, code: int) -> NoReturn:
    print(f"tonewood: {line}", file=sys.stderr)
    sys.exit(code)
