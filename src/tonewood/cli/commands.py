"""The list of commands, and exceptions that end a command besides errors."""

from __future__ import annotations

#: command -> module and function
COMMANDS = {
    "render": "render:render",
    "play": "play:play",
    "list": "listing:list_installed",
    "plan": "plan:plan",
    "tab": "tab:tab",
    "check": "check:check",
    "modes": "modes:modes",
    "intonation": "intonation:intonation",
    "strings": "strings:strings_for_sale",
    "design": "design:design",
    "compare": "compare:compare",
    "report": "compare:report",
    "schema": "schema:schema",
    "migrate": "migrate:migrate",
    "fit": "fit:fit",
    "estimate": "estimate:estimate",
    "distance": "distance:distance",
    "taptone": "taptone:taptone",
    "wood": "wood:wood",
    "new": "new:new",
    "sample": "sample:sample",
    "desk": "desk:desk",
    "batch": "batch:batch",
    "serve": "serve:serve",
    "simulate": "simulate:simulate",
    "results": "results:results",
    "validate": "validate:validate",
    "accuracy": "accuracy:accuracy",
}


class InterruptError(Exception):
    """Ctrl-C inside a command: typer would turn a KeyboardInterrupt into an exit code without a message.

    Its text names the files that remain.
    """


class ReaderGoneError(Exception):
    """Standard output was closed by its reader, as behind ``| head``; typer would turn that into an exit code."""
