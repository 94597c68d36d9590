"""The command line: one line on stderr and exit code 2 for errors a user can mend (1: silence), 130 for Ctrl-C."""

from __future__ import annotations

import errno
import os
import re
import sys
from contextlib import suppress
from difflib import get_close_matches
from itertools import pairwise
from typing import NoReturn, TextIO

from tonewood.cli.commands import COMMANDS, InterruptError, ReaderGoneError
from tonewood.cli.stopping import stopping
from tonewood.errors import TonewoodError
from tonewood.support.validation_messages import did_you_mean

#: bytes of an argument that are no UTF-8, as Python has them; libraries of sound files fail on such names
_NO_TEXT = re.compile("[\ud800-\udfff]")
#: exit code, as shells have it
_INTERRUPTED = 130


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    words = sys.argv[1:] if arguments is None else arguments
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever called
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  # as long as the process
    try:
        if unreadable := [word for word in words if not word.isascii() and _NO_TEXT.search(word)]:
            raise TonewoodError(f"argument {unreadable[0]!r} is not UTF-8: rename the file, or correct the text")
        # imported here, so that Ctrl-C meanwhile is caught
        from tonewood.cli.app import ABORTED, ClickError, application

        try:
            app = application(words[0] if words else None)
            code = app(args=_with_values(words) or ["--help"], prog_name="tonewood", standalone_mode=False)
        except ClickError as error:
            usage = TonewoodError(_usage(error, words))
            _print_error(words, "UsageError", usage, 2)
            _fail(usage.reason, 2)
        except ABORTED:
            raise InterruptError from None
        if code == _INTERRUPTED:  # exit code of typer for a Ctrl-C before the command has begun
            raise InterruptError
    except TonewoodError as error:
        fault = _in_its_line(error, words)
        _print_error(words, type(fault).__name__, fault, fault.exit_code)
        _fail("\ntonewood: ".join(map(str, fault.all)), fault.exit_code)
    except (InterruptError, KeyboardInterrupt) as error:
        # Where a KeyboardInterrupt has passed a call of exec (every dataclass makes some), CPython ends by killing
        # itself with the signal, whatever the exit code; another call makes it forget.
        exec("")
        _interrupted(words, str(error) or _remaining())
    except ReaderGoneError:
        _no_more(sys.stdout)
        sys.exit(0)
    except OSError as error:
        if error.filename is not None:  # of the system, where no command has better words
            fault = TonewoodError(f"cannot be used: {error.strerror}", file=str(error.filename))
            _print_error(words, "OutputError", fault, 2)
            _fail(str(fault), 2)
        _no_more(sys.stdout)
        if stopping.signal:  # SIGHUP: the terminal has gone
            _interrupted(words, _remaining())
        if error.errno in (None, errno.ENOENT):  # NumPy gives no number
            _fail(f"cannot go on: {error.strerror or error}", 2)
        _fail(f"standard output: cannot be written: {error.strerror}", 2)
    except Exception:  # raised again, unless a signal caused it
        if stopping.signal:  # an import that was interrupted may fail in other ways
            _interrupted(words, _remaining())
        raise
    if stopping.signal and stopping.code != _INTERRUPTED:  # a session that a signal has ended in good order
        sys.exit(stopping.code)
    sys.exit(code if isinstance(code, int) else 0)


def _remaining() -> str:
    """Files that were completed before an interruption, besides those kept between runs."""
    from tonewood.support.cache_folder import cache_folder
    from tonewood.support.whole_files import completed

    cache = cache_folder()
    files = list(dict.fromkeys(f.name for f in completed if cache is None or not f.is_relative_to(cache.resolve())))
    if not files:
        return "nothing was written"
    more = f" and {len(files) - 3} more" if len(files) > 3 else ""
    return f"{', '.join(files[:3])}{more} {'are' if len(files) > 1 else 'is'} written"


def _interrupted(words: list[str], rest: str) -> NoReturn:
    fault = TonewoodError(f"{stopping.word}; {rest}")
    _print_error(words, "Interrupted", fault, stopping.code)
    _fail(fault.reason, stopping.code)


def _with_values(words: list[str]) -> list[str]:
    """Give an option whose value may be left out its value: ``--midi-in`` alone is the first input."""
    out = []
    for word, following in pairwise([*words, "-"]):
        out.append(word)
        if word == "--midi-in" and following.startswith("-"):
            out.append("first")
    return out


def _print_error(words: list[str], kind: str, fault: TonewoodError, code: int) -> None:
    """With ``--json``, print an error as one object on stdout; its first keys are those of every report."""
    if "--json" in words:
        import json

        facts = [{"file": f.file, "line": f.line, "key": f.key, "reason": f.reason} for f in fault.all]
        error = {"kind": kind, **facts[0], "exit_code": code, **({"also": facts[1:]} if fault.also else {})}
        with suppress(OSError):
            print(json.dumps({"schema": "tonewood-error/1", "ok": False, "error": error}))


def _usage(error: Exception, words: list[str]) -> str:
    """One line for a wrong argument, with the option that it resembles and the command to ask."""
    text = " ".join((error.format_message() if hasattr(error, "format_message") else str(error)).split())
    if hasattr(error, "option_name") and hasattr(error, "possibilities"):
        hint = did_you_mean(str(error.option_name), error.possibilities or ()).replace("did", "Did")
        text = f"No such option: {error.option_name}. {hint}".strip()
    elif hasattr(error, "command_name"):  # click 8.4 and later, where typer does not bring its own
        close = get_close_matches(str(error.command_name), COMMANDS, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else ""
        text = f"No such command '{error.command_name}'. {hint}".strip()
    command = " ".join(["tonewood", *(name for name in words[:1] if name in COMMANDS), "-h"])
    return f"{text if text.endswith(('.', '?')) else text + '.'} See: {command}"


def _in_its_line(error: TonewoodError, arguments: list[str]) -> TonewoodError:
    """Return an error with the line of its file, unless an option gave the value at fault."""
    if error.key and f"--{error.key}" in arguments:
        return error
    words = [b for a, b in pairwise(arguments) if a == "--set"] + [a[6:] for a in arguments if a.startswith("--set=")]
    for path in (word.partition("=")[0].split(".") for word in words):
        if error.key and all(a in ("*", b) for a, b in zip(path, error.key.split("."), strict=False)):
            return error
    from tonewood.support.yaml_io import located

    return located(error)


def _no_more(stream: TextIO) -> None:
    """Redirect a stream to nowhere: the rest of its buffer would fail again when the interpreter ends."""
    with suppress(OSError, ValueError):  # no file at all, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _fail(line: str, code: int) -> NoReturn:
    try:
        print(f"tonewood: {line}", file=sys.stderr)
    except OSError:  # it cannot be written to
        _no_more(sys.stderr)
    sys.exit(code)
