"""Entry point: one line on stderr and exit code 2 for what a user can mend, 130 for Ctrl-C."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer

from tonewood.errors import TonewoodError

# typer may carry its own copy of click: its errors are found through it
_UsageError = typer.BadParameter.__bases__[0]
_ClickError: type[Exception] = _UsageError.__bases__[0]

app = typer.Typer(
    name="tonewood",
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Physical sound synthesis: render and play scores on modelled instruments, and look into them.",
)


def _register() -> None:
    """Add the commands; each module imports what it needs only when it runs."""
    from tonewood.cli import play, render

    app.command("render")(render.render)
    app.command("play")(play.play)


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    _register()
    given = sys.argv[1:] if arguments is None else arguments
    try:
        code = app(args=given or ["--help"], standalone_mode=False)
    except TonewoodError as error:
        _fail(str(error), 2)
    except _ClickError as error:
        message = getattr(error, "format_message", lambda: str(error))()
        _fail(" ".join(message.split()), 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; nothing was written", 130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(line: str, code: int) -> NoReturn:
    print(f"tonewood: {line}", file=sys.stderr)
    sys.exit(code)
