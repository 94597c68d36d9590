"""The typer application: all commands, or a single one."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from tonewood.cli.commands import COMMANDS, InterruptError, ReaderGoneError
from tonewood.cli.common import warn
from tonewood.cli.stopping import stopping
from tonewood.errors import CacheFolderWarning, DamagedCacheWarning, OldFormatWarning, TonewoodError
from tonewood.support.whole_files import check_unread, protect

# typer may carry its own copy of click: its errors are found through it
_UsageError = typer.BadParameter.__bases__[0]
ClickError: type[Exception] = _UsageError.__bases__[0]
ABORTED: type[Exception] = typer.Abort
#: parameters that name a file to write
_WRITTEN = {"output", "table", "plot", "record", "energy", "page", "report"}
#: commands that rewrite the files that they read
_IN_PLACE = {"desk", "migrate"}
#: file that makes a folder an instrument's
BUNDLE_FILE = "instrument.yaml"


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
        show, shown = warnings.showwarning, set[str]()

        def show_in_one_line(message: Warning | str, category: type[Warning], *location: Any, **more: Any) -> None:
            if issubclass(category, OldFormatWarning | DamagedCacheWarning | CacheFolderWarning):
                if str(message) not in shown:  # filters that a library changes make Python forget what was shown
                    shown.add(str(message))
                    warn([str(message)])
            else:
                show(message, category, *location, **more)

        try:
            stopping.command_begins()
            if command.__name__ not in _IN_PLACE:
                _protect_sources(options)
            with warnings.catch_warnings():
                warnings.showwarning = show_in_one_line
                code = command(*args, **options)
            sys.stdout.flush()
        except KeyboardInterrupt as error:
            raise InterruptError(*error.args) from None
        except BrokenPipeError:
            raise ReaderGoneError from None
        except SystemExit as end:  # no command ends by it
            raise TonewoodError(f"code of a plugin ended the program: SystemExit({end.code!r})") from end
        except MemoryError as error:
            raise TonewoodError(f"not enough memory: {error}" if str(error) else "not enough memory") from error
        finally:
            protect(())  # whoever calls commands from Python may write these files afterwards
        return code

    return wrapped


def _protect_sources(options: Mapping[str, Any]) -> None:
    """Let no file be replaced that an argument reads: the file itself, or all files of an instrument's folder.

    Outputs that arguments name are refused at once, those that the command names itself as it begins to write them.
    """
    values = [(name, one) for name, value in options.items() for one in (value if isinstance(value, list) else [value])]
    paths = [(name, Path(value)) for name, value in values if isinstance(value, Path | str)]
    protect(file for name, path in paths if name not in _WRITTEN for file in _files(path))
    for name, path in paths:
        if name in _WRITTEN:
            check_unread(path)


def _files(path: Path) -> Iterator[Path]:
    """Files that an argument reads."""
    with suppress(OSError, ValueError):  # a name too long, or with a zero byte
        if path.is_file():
            yield path
        elif (path / BUNDLE_FILE).is_file():
            yield from path.iterdir()


def _print_version(value: bool) -> None:
    if value:
        from tonewood import __version__

        print(f"tonewood {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="print the version and exit", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Options before the command."""
