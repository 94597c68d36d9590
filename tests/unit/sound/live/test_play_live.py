"""``tonewood play --midi-in`` from the command to its summary, on a card and a port of this process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mido
import numpy as np
import pytest

from tonewood.cli.main import run
from tonewood.errors import OutputError


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
