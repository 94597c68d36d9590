"""The typer application: all commands, or a single one."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from tonewood.cli.commands import COMMANDS, InterruptError, ReaderGoneError
from tonewood.cli.common import warn
from tonewood.cli.stopping import stopping
from tonewood.errors import CacheFolderWarning, DamagedCacheWarning, OldFormatWarning, OutputError
from tonewood.support.whole_files import protect

# typer may carry its own copy of click: its errors are found through it
_UsageError = typer.BadParameter.__bases__[0]
ClickError: type[Exception] = _UsageError.__bases__[0]
ABORTED: type[Exception] = typer.Abort
#: parameters that name a file to write
_WRITTEN = {"output", "table", "plot", "record", "energy", "page"}
#: parameters that name a file to read, and an instrument: a name, or its folder
_READ, _INSTRUMENT = {"score", "room", "ensemble", "programs"}, "instrument"


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
            _refuse_to_replace(options)
            protect(_sources(options) if command.__name__ != "desk" else ())
            with warnings.catch_warnings():
                warnings.showwarning = show_in_one_line
                code = command(*args, **options)
            sys.stdout.flush()
        except KeyboardInterrupt as error:
            raise InterruptError(*error.args) from None
        except BrokenPipeError:
            raise ReaderGoneError from None
        finally:
            protect(())  # whoever calls commands from Python may write these files afterwards
        return code

    return wrapped


def _refuse_to_replace(options: Mapping[str, Any]) -> None:
    """Refuse a file to write that another argument of the command is; links may lead to it."""
    files = [
        (name, file)
        for name, value in options.items()
        for file in (value if isinstance(value, list | tuple) else [value])
        if isinstance(file, Path | str) and _is_file(file)
    ]
    for name, file in files:
        for other, read in files if name in _WRITTEN else ():
            if other != name and os.path.samefile(file, read):
                reason = (
                    f"would replace a file that is read, {other.replace('_', ' ')} {str(read)!r}; give another name"
                )
                raise OutputError(reason, file=file)


def _sources(options: Mapping[str, Any]) -> Iterator[Path]:
    """Files that a command reads: its score, room and others, and all of the folder of its instrument."""
    for name, value in options.items():
        if name in _READ and isinstance(value, Path | str):
            yield Path(value)
        elif name == _INSTRUMENT and isinstance(value, Path | str) and "\0" not in str(value):
            yield from Path(value).glob("*.*") if os.path.isdir(value) else ()


def _is_file(name: Path | str) -> bool:
    try:
        return os.path.isfile(name)
    except ValueError:  # a zero byte
        return False


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
