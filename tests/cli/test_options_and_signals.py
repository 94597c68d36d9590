"""Options, command lines, signals and exceptions of commands."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli_refusals import refused

from tonewood.cli import (
    common,
    main,
    stopping,
)
from tonewood.cli.commands import COMMANDS, InterruptError, ReaderGoneError
from tonewood.cli.options import _number, option_name, render_options
from tonewood.cli.stopping import SignalHandling
from tonewood.errors import TonewoodError
from tonewood.support import whole_files


def test_settings_of_a_score() -> None:
    assert common.reading(1.0, 2.0, -3.0, 0.5, " 1, 12,") == {
        "start": 1.0,
        "stop": 2.0,
        "transpose": -3.0,
        "tempo": 0.5,
        "tracks": [1, 12],
    }
    assert common.reading(0.0, None, 0.0, 1.0, None)["tracks"] is None
    for text in ("", " , ", "1,x", "-1", "1234567890"):
        refused("numbers from 1, with commas", common.reading, 0, None, 0, 1, text)
    assert common.reading(0, None, 0, 1, "123456789")["tracks"] == [123456789]


def test_ranges_words_bands_and_files(tmp_path) -> None:
    for value in (1.0, 2.0):
        common.allow("--x", value, 1.0, 2.0, "m")
    for value in (0.99, 2.01, math.nan):
        refused(r"--x: is .* m; 1 to 2 are allowed", common.allow, "--x", value, 1.0, 2.0, "m")
    common.allow_word("--w", "a", ["a", "b"])
    refused("--w: is 'c'; a, b are allowed", common.allow_word, "--w", "c", ["a", "b"])
    common.allow_band((0.0, 1.0))
    for band in ((-1.0, 1.0), (1.0, 1.0), (2.0, 1.0), (math.nan, 1.0)):
        refused("a lower and a higher frequency", common.allow_band, band)
    common.allow_file("-o", None, ".csv")
    for name in ("a.CSV", "a.htm", "a.yml"):
        common.allow_file("-o", tmp_path / name, ".csv", ".html", ".yaml")
    refused(
        "is 'a.txt'; a name ending in .csv or .html is allowed",
        common.allow_file,
        "-o",
        tmp_path / "a.txt",
        ".csv",
        ".html",
    )
    refused("there is no folder", common.allow_file, "-o", tmp_path / "no" / "a.csv", ".csv")
    common.need("plot", "json", "csv")
    refused(r"needs no_such_module, .* 'tonewood\[x\]'", common.need, "x", "json", "no_such_module")


def test_options_of_a_render() -> None:
    assert [option_name(name) for name in ("gain_db", "tail_level_db", "room_mix_db", "lead_in", "fs")] == [
        "--gain",
        "--tail-level",
        "--room-mix",
        "--lead-in",
        "--fs",
    ]
    assert (_number("1.5"), _number("auto")) == (1.5, "auto")
    assert render_options({"fs": 44100, "gain_db": -3.0}).gain_db == -3.0
    refused("--fs: ", render_options, {"fs": 10})
    refused("--gain: ", render_options, {"gain_db": 1e9})
    assert isinstance(render_options({"lead_in": "0.25"}).lead_in, float)


def test_words_of_a_command_line(monkeypatch) -> None:
    assert main._with_values(["play", "--midi-in"]) == ["play", "--midi-in", "first"]
    assert main._with_values(["--midi-in", "--fs", "1"]) == ["--midi-in", "first", "--fs", "1"]
    assert main._with_values(["--midi-in", "port", "x"]) == ["--midi-in", "port", "x"]
    assert main._with_values([]) == []
    cache = whole_files.completed.copy()
    monkeypatch.setattr(whole_files, "completed", [])
    assert main._remaining() == "nothing was written"
    for names, said in (
        (["a"], "a is written"),
        (["a", "b", "b"], "a, b are written"),
        (list("abcde"), "a, b, c and 2 more are written"),
    ):
        whole_files.completed[:] = [Path("/x") / name for name in names]
        assert main._remaining() == said
    monkeypatch.setattr(whole_files, "completed", cache)
    option = SimpleNamespace(option_name="--fz", possibilities=["--fs"], format_message=lambda: "x")
    assert main._usage(option, ["render"]) == "No such option: --fz. Did you mean --fs? See: tonewood render -h"
    plain = SimpleNamespace(format_message=lambda: "Missing  argument\n'A'")
    assert main._usage(plain, ["x"]) == "Missing argument 'A'. See: tonewood -h"
    command = SimpleNamespace(command_name="rendr", format_message=lambda: "")
    assert main._usage(command, []) == "No such command 'rendr'. Did you mean 'render'? See: tonewood -h"
    assert "render" in COMMANDS


def test_errors_are_in_their_line_unless_an_option_gave_the_value(tmp_path, capsys) -> None:
    file = tmp_path / "instrument.yaml"
    file.write_text("a: 1\nstrings:\n  E2: {length: 1}\n")
    fault = TonewoodError("r", file=file, key="strings.E2.length")
    assert main._in_its_line(fault, []).line == 3
    for words in (["--set", "strings.E2.length=2"], ["--set=strings.*.length=2"], ["--set", "strings=1"]):
        assert main._in_its_line(fault, words) is fault
    assert main._in_its_line(fault, ["--set", "strings.A2.length=2"]).line == 3
    named = TonewoodError("r", file=file, key="fs")
    assert main._in_its_line(named, ["--fs"]) is named
    main._print_error(["--json"], "BundleError", TonewoodError("r", file="f", key="k", line=4), 2)
    assert json.loads(capsys.readouterr().out) == {
        "schema": "tonewood-error/1",
        "ok": False,
        "error": {"kind": "BundleError", "file": "f", "line": 4, "key": "k", "reason": "r", "exit_code": 2},
    }
    main._print_error([], "BundleError", fault, 2)
    assert capsys.readouterr().out == ""


def test_signals_have_their_words_and_codes() -> None:
    handling = SignalHandling()
    assert (handling.word, handling.code) == ("interrupted", 130)
    handling.signal = signal.SIGTERM
    assert (handling.word, handling.code) == ("terminated", 143)
    handling.command_begins()
    with pytest.raises(KeyboardInterrupt):
        handling._take(signal.SIGHUP, None)
    assert (handling.signal, handling.code, handling.word) == (signal.SIGHUP, 129, "hung up")
    handling._take(signal.SIGINT, None)  # within a second of the other
    assert handling.signal == signal.SIGHUP


def test_signals_are_handled_unless_they_were_ignored(monkeypatch) -> None:
    before = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_IGN, signal.SIGHUP: signal.SIG_DFL}
    taken, hook = {}, sys.unraisablehook
    monkeypatch.setattr(signal, "getsignal", before.get)
    monkeypatch.setattr(signal, "signal", taken.__setitem__)
    handling = SignalHandling()
    try:
        handling.begin()
        assert sys.unraisablehook == handling._lost
    finally:
        sys.unraisablehook = hook
    assert handling.installed
    assert taken == dict.fromkeys((signal.SIGINT, signal.SIGHUP), handling._take)


@pytest.mark.parametrize(("since", "reason"), [(None, "hung up; nothing was written"), (-2.0, "hung up")])
def test_a_signal_that_ends_the_program_is_told_as_json_too(monkeypatch, since, reason) -> None:
    """Before a command nothing was written; a second after another signal nobody knows."""
    said, codes, handling = [], [], SignalHandling()
    monkeypatch.setattr(stopping, "_write", lambda descriptor, text: said.append((descriptor, text)))
    monkeypatch.setattr(stopping.os, "_exit", codes.append)
    monkeypatch.setattr(sys, "argv", ["tonewood", "list", "--json"])
    if since is not None:
        handling.command_begins()
        for seconds in (10.0, 11.0):  # the second one is a second later
            monkeypatch.setattr(stopping.time, "monotonic", lambda seconds=seconds: seconds)
            with pytest.raises(KeyboardInterrupt):
                handling._take(signal.SIGHUP, None)
    else:
        with pytest.raises(KeyboardInterrupt):
            handling._take(signal.SIGHUP, None)
    assert (codes, said[1]) == ([129], (2, f"tonewood: {reason}\n"))
    report = json.loads(said[0][1])
    assert (said[0][0], report["schema"], report["ok"]) == (1, "tonewood-error/1", False)
    assert report["error"] == {
        "kind": "Interrupted", "file": None, "line": None, "key": None, "reason": reason, "exit_code": 129,
    }  # fmt: skip


def test_an_interruption_that_got_lost_comes_again(monkeypatch) -> None:
    import threading

    sent, others = [], []

    class Timer:
        def __init__(self, seconds, call, arguments):
            self.start = lambda: sent.append((seconds, call, arguments))

    monkeypatch.setattr(threading, "Timer", Timer)
    monkeypatch.setattr(sys, "__unraisablehook__", others.append)
    handling = SignalHandling()
    handling.signal = signal.SIGTERM
    handling._lost(SimpleNamespace(exc_type=KeyboardInterrupt))
    assert sent == [(0.01, os.kill, (os.getpid(), signal.SIGTERM))]
    assert others == []
    handling._lost(fault := SimpleNamespace(exc_type=ValueError))
    assert (others, len(sent)) == ([fault], 1)


@pytest.mark.parametrize(("code", "given"), [(0, 0), (3, 3), (None, 0), ("a line", 1)])
def test_the_exit_code_of_a_command_is_kept_for_signals_after_it(monkeypatch, code, given) -> None:
    from tonewood.cli import start

    calls = []
    monkeypatch.setattr(start.stopping, "begin", lambda: calls.append("begin"))
    monkeypatch.setattr(start.stopping, "command_ends", calls.append)

    def run():
        raise SystemExit(code)

    monkeypatch.setattr(main, "run", run)
    monkeypatch.setenv("PYTHONSAFEPATH", "")  # put back after the test: it would reach the processes of others
    with pytest.raises(SystemExit) as end:
        start.main()
    assert (calls, end.value.code, os.environ["PYTHONSAFEPATH"]) == (["begin", given], code, "1")


def fails(fault):
    def command(*arguments, **options):
        raise fault

    return command


@pytest.mark.parametrize(
    ("fault", "code", "line"),
    [
        (InterruptError("a is written"), 130, "tonewood: interrupted; a is written\n"),
        (KeyboardInterrupt(), 130, "tonewood: interrupted; nothing was written\n"),
        (ReaderGoneError(), 0, ""),
        (
            OSError(28, "No space left on device", "/x/y"),
            2,
            "tonewood: /x/y: cannot be used: No space left on device\n",
        ),
        (OSError(28, "No space left"), 2, "tonewood: standard output: cannot be written: No space left\n"),
        (FileNotFoundError(2, "No such folder"), 2, "tonewood: cannot go on: No such folder\n"),
        (OSError("5 requested and 3 written"), 2, "tonewood: cannot go on: 5 requested and 3 written\n"),
        (TonewoodError("r", file="f", key="k"), 2, "tonewood: f: k: r\n"),
    ],
)
def test_exceptions_of_commands_end_in_one_line(monkeypatch, capsys, fault, code, line) -> None:
    monkeypatch.setattr("tonewood.cli.app.application", lambda first: fails(fault))
    monkeypatch.setattr(main, "_no_more", lambda stream: None)
    monkeypatch.setattr(whole_files, "completed", [])
    with pytest.raises(SystemExit) as end:
        main.run(["list"])
    assert (end.value.code, capsys.readouterr().err) == (code, line)


def test_an_exception_that_nobody_expected_is_raised(monkeypatch, capsys) -> None:
    """Unless a signal was its cause."""
    monkeypatch.setattr("tonewood.cli.app.application", lambda first: fails(ZeroDivisionError("x")))
    monkeypatch.setattr(whole_files, "completed", [])
    with pytest.raises(ZeroDivisionError):
        main.run(["list"])
    monkeypatch.setattr(main.stopping, "signal", int(signal.SIGTERM))
    with pytest.raises(SystemExit) as end:
        main.run(["list"])
    assert (end.value.code, capsys.readouterr().err) == (143, "tonewood: terminated; nothing was written\n")
    # a session that SIGTERM has ended in good order
    monkeypatch.setattr("tonewood.cli.app.application", lambda first: lambda **options: 0)
    with pytest.raises(SystemExit) as end:
        main.run(["list"])
    assert end.value.code == 143
