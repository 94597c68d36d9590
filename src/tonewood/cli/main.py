"""Entry point: one line on stderr and exit code 2 for what a user can mend, 130 for Ctrl-C."""

from __future__ import annotations

import sys

import click
import typer

from tonewood.errors import TonewoodError

app = typer.Typer(
    name="tonewood",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Physical sound synthesis: render and play scores on modelled instruments, and look into them.",
)


def _register() -> None:
    """Add the commands; each module imports what it needs only when it runs."""
    from tonewood.cli import inspect, play, render

    app.command("render")(render.render)
    app.command("play")(play.play)
    app.command("list")(inspect.list_)
    app.command("check")(inspect.check)
    app.command("modes")(inspect.modes)


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    _register()
    try:
        code = app(args=arguments, standalone_mode=False)
    except TonewoodError as error:
        _fail(str(error), 2)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        sys.exit(2)
    except click.ClickException as error:
        _fail(" ".join(error.format_message().split()), 2)
    except (KeyboardInterrupt, click.exceptions.Abort):
        _fail("interrupted; nothing was written", 130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(line: str, code: int) -> None:
    print(f"tonewood: {line}", file=sys.stderr)
    sys.exit(code)
