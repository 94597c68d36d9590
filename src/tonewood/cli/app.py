"""The typer application: all commands, or a single one."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Annotated, Any

import typer

from tonewood.cli.commands import COMMANDS, InterruptError, ReaderGoneError
from tonewood.cli.common import warn
from tonewood.cli.stopping import stopping
from tonewood.errors import CacheFolderWarning, DamagedCacheWarning, OldFormatWarning

# typer may carry its own copy of click: its errors are found through it
_UsageError = typer.BadParameter.__bases__[0]
ClickError: type[Exception] = _UsageError.__bases__[0]
ABORTED: type[Exception] = typer.Abort


def application(first: str | None) -> typer.Typer:
    """Make the application with the command `first`, or with all commands if there is none of that name."""
    app = typer.Typer(
        name="tonewood",
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
        help="Physical sound synthesis: render and play scores on modelled instruments, and look into them.",
    )
    for name in [first] if first in COMMANDS else COMMANDS:
        module, _, function = COMMANDS[name].partition(":")
        app.command(name)(_command(getattr(import_module(f"tonewood.cli.{module}"), function)))
    # with a single command typer would leave its name out
    app.callback()(_options)
    return app


def _command(command: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(command)
    def wrapped(*args: Any, **options: Any) -> Any:
        show = warnings.showwarning

        def show_in_one_line(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, OldFormatWarning | DamagedCacheWarning | CacheFolderWarning):
                warn([str(message)])
            else:
                show(message, category, *place, **more)

        try:
            stopping.command_begins()
            with warnings.catch_warnings():
                warnings.showwarning = show_in_one_line
                code = command(*args, **options)
            sys.stdout.flush()
        except KeyboardInterrupt as error:
            raise InterruptError(*error.args) from None
        except BrokenPipeError:
            raise ReaderGoneError from None
        return code

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
