"""``tonewood play --midi-in`` from the command to its summary, on a card and a port of this process."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mido
import numpy as np
import pytest

from tonewood.cli.main import run
from tonewood.errors import OutputError
from tonewood.sound.live.stream import AudioStream


class Card:
    """Takes blocks for a while, and feeds the port as it does."""

    port: Any = None

    def __init__(self, **options: Any) -> None:
        self.options = options

    def __enter__(self) -> Card:
        out = np.zeros((self.options["blocksize"], self.options["channels"]), np.float32)
        self.port.feed(
            mido.Message("note_on", note=45), mido.Message("note_on", note=3), mido.Message("program_change")
        )
        for _ in range(200):
            self.options["callback"](out, len(out), None, None)
        return self

    def __exit__(self, *_: object) -> None:
        pass


def session(
    ports: Any,
    take: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kind: type[Card],
    *more: str,
) -> tuple[int | str | None, str, str]:
    """Exit code and output of a session that plays on such a card and is recorded."""

    def card(**options: Any) -> Card:
        Card.port = ports.OPEN["Keys A"]
        return kind(**options)

    monkeypatch.setattr("tonewood.sound.live.stream._output_stream", lambda: card)
    with pytest.raises(SystemExit) as ended:
        run(["play", "-i", "monochord", "--midi-in", "--duration", "0", "--record", str(take), *more])
    return ended.value.code, *capsys.readouterr()


@pytest.mark.slow
@pytest.mark.parametrize("as_json", [True, False])
def test_a_session_from_the_command_line(
    ports: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    take = tmp_path / "take.mid"
    code, out, err = session(ports, take, monkeypatch, capsys, Card, *(["--json"] if as_json else []))
    assert not code
    assert "latency" in err
    if as_json:
        found = json.loads(out)
        assert (found["notes"], found["messages"], sum(found["notes_dropped"].values())) == (1, 3, 1)
        assert found["midi_ignored"] == {"program change": 1}
    else:
        assert "monochord played by Keys A" in out
        assert "1 note, 1 dropped" in out
        assert "without effect: 1 program change" in out
        assert "not played: no string plays D#-1" in err
    assert ports.OPEN == {}
    assert len([m for m in mido.MidiFile(take) if not m.is_meta]) == 3


def test_a_session_that_fails_keeps_its_take(
    ports: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Unplugged(Card):
        def __exit__(self, *_: object) -> None:
            raise OutputError("the sound card has gone")

    code, _, err = session(ports, tmp_path / "take.mid", monkeypatch, capsys, Unplugged)
    assert code == 2
    assert "the sound card has gone" in err
    assert len([m for m in mido.MidiFile(tmp_path / "take.mid") if not m.is_meta]) == 3


#: a session in a process of its own: a card that gives a message before every block and says when ten were played
SESSION = """
import sys, time
import mido, numpy as np
sys.path.insert(0, sys.argv.pop(1))
mido.set_backend("midi_backend")
import midi_backend
import tonewood.sound.live.stream as stream

class Card:
    latency = 0.0
    def __init__(self, **options):
        self.options = options
    def __enter__(self):
        out = np.zeros((self.options["blocksize"], self.options["channels"]), np.float32)
        for i in range(10):
            midi_backend.OPEN["Keys A"].feed(mido.Message("note_on", note=45 + i))
            self.options["callback"](out, len(out), None, None)
            time.sleep(0.01)
        print("played", flush=True)
        return self
    def __exit__(self, *_):
        pass

stream._output_stream = lambda: Card
from tonewood.cli.start import main
main()
"""


@pytest.mark.parametrize(
    ("number", "code"),
    [
        pytest.param(signal.SIGINT, 0, id="int"),
        pytest.param(signal.SIGTERM, 143, id="term", marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, 129, id="hup", marks=pytest.mark.slow),
        pytest.param(signal.SIGKILL, -9, id="kill"),
    ],
)
def test_a_signal_keeps_the_take(tmp_path: Path, number: int, code: int) -> None:
    """In good order, so that every message is there; a killed program loses a second at most."""
    take = tmp_path / "take.mid"
    words = ["play", "-i", "monochord", "--midi-in", "--record", str(take), "--level", "calibrated"]
    process = subprocess.Popen(
        [sys.executable, "-c", SESSION, str(Path(__file__).parent), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: [signal.signal(n, signal.SIG_DFL) for n in (signal.SIGINT, signal.SIGHUP)],
    )  # fmt: skip
    assert process.stdout is not None
    while process.stdout.readline() != "played\n":
        assert process.poll() is None
    if number == signal.SIGKILL:
        while not take.exists() or sum(not m.is_meta for m in mido.MidiFile(take)) < 4:
            assert process.poll() is None
            time.sleep(0.05)
    process.send_signal(number)
    out, err = process.communicate(timeout=300)
    assert process.returncode == code
    assert "Traceback" not in err
    assert [p.name for p in tmp_path.iterdir()] == ["take.mid"]
    notes = [m.note for m in mido.MidiFile(take) if not m.is_meta]
    assert notes == [45 + i for i in range(len(notes))]
    assert len(notes) > 3
    if number != signal.SIGKILL:
        assert "take.mid" in out


def test_an_error_in_the_callback_keeps_the_take(
    ports: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: Any) -> None:
        raise OutputError("the card's memory has gone")

    class Broken(Card):
        def __enter__(self) -> Card:
            super().__enter__()
            monkeypatch.setattr(AudioStream, "_give", broken)
            with contextlib.suppress(OutputError):  # the card's own thread: the error goes no further
                self.options["callback"](np.zeros((128, 2), np.float32), 128, None, None)
            return self

    code, _, err = session(ports, tmp_path / "take.mid", monkeypatch, capsys, Broken)
    assert code == 2
    assert "the card's memory has gone" in err
    assert len([m for m in mido.MidiFile(tmp_path / "take.mid") if not m.is_meta]) == 3
