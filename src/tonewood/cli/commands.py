"""The commands, and what ends one of them besides an error."""

from __future__ import annotations

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


class InterruptError(Exception):
    """Ctrl-C inside a command: typer would turn a KeyboardInterrupt into an exit code without a word.

    Its text says what is left behind.
    """


class ReaderGoneError(Exception):
    """Nobody reads standard output any more, as behind ``| head``; typer would make an exit code of that, too."""
