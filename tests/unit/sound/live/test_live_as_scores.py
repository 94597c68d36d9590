"""The same MIDI messages live and in a file: pedals, counts of messages without effect, and messages that come late."""

from __future__ import annotations

import gc
import os
import pty
import select
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

import tonewood as tw
from midi_bytes import write
from pianos import piano
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.player.playing import perform
from tonewood.performance.score.reading import read_score
from tonewood.sound.live.keyboard import ComputerKeyboard
from tonewood.sound.live.receiver import MidiReceiver
from tonewood.sound.live.session import LiveSession
from tonewood.sound.live.stream import Arrivals
from tonewood.sound.live.take import Take

DOWN, UP = (0xB0, 64, 127), (0xB0, 64, 0)
SOUND_OFF, RESET = (0xB0, 120, 0), (0xB0, 121, 0)


def played(midi: MidiReceiver, messages: Sequence[Sequence[int]], spacing: int = 4800) -> list[bool]:
    """Whether a note is held by its key or the pedal, long after each message."""
    out = []
    for message in messages:
        midi.receive(message)
        midi.live.process(spacing)
        out.append(midi.live.player.n_sounding > 0)
    return out


def test_all_sound_off_leaves_the_pedal_where_it_is(monochord: tw.Instrument, tmp_path: Path) -> None:
    """MIDI 1.0: it ends all notes and resets no controller; the pedal holds the next note. So has the file's reader."""
    messages = [DOWN, (0x90, 45, 90), (0x80, 45, 0), SOUND_OFF, (0x90, 45, 90), (0x80, 45, 0), UP]
    midi = MidiReceiver(tw.Live(monochord, prepare=False))
    assert played(midi, messages) == [False, True, True, False, True, True, False]
    score = read_score(write(tmp_path / "a.mid", [(0.1 * i, message) for i, message in enumerate(messages)]))
    assert [(n.time, n.time + n.duration) for n in score.notes] == [
        (pytest.approx(0.1), pytest.approx(0.3)), (pytest.approx(0.4), pytest.approx(0.6))
    ]  # fmt: skip


@pytest.mark.parametrize("messages", [[RESET], [(0xB0, 11, 64), RESET], [(0xB0, 1, 9), RESET]])
def test_a_reset_counts_controllers_that_were_not_moved_as_little_as_in_a_file(
    monochord: tw.Instrument, tmp_path: Path, messages: list[tuple[int, ...]]
) -> None:
    midi = MidiReceiver(tw.Live(monochord, prepare=False))
    played(midi, [*messages, (0x90, 45, 90)], 128)
    path = write(tmp_path / "a.mid", [(0.1, message) for message in [*messages, (0x90, 45, 90), (0x80, 45, 0)]])
    in_file = perform(read_score(path), assemble(monochord, 48000.0)).ignored
    assert midi.ignored + midi.live.player.counters.ignored == dict.fromkeys(in_file, 1)
    assert midi.live.player.controls.get((0, "cc11"), 1.0) == 1.0


def test_pedals_of_channels_that_are_not_played_move_nothing(tmp_path: Path) -> None:
    """Pedals of all channels move one mechanism: one of a channel that --tracks leaves out would hold the notes."""
    instrument = piano(tmp_path, ["C4"])
    dampers = {}
    for channels in (None, [1], [2]):
        midi = MidiReceiver(tw.Live(instrument, prepare=False, fs=24000), channels)
        played(midi, [(0xB1, 64, 127), (0xD1, 5), (0xA1, 60, 5), (0xB1, 74, 5)], 64)
        share = midi.live.player.hands.dampers._position("cc64")
        dampers[channels and channels[0]] = share, sum(midi.live.player.counters.ignored.values())
    assert dampers == {None: (1.0, 3), 1: (0.0, 0), 2: (1.0, 3)}


def test_a_stream_that_never_pauses_is_in_time_again_after_an_interruption() -> None:
    """A clock's messages, one in 20 ms; sound begins 3 s after the first, and the messages of these 3 s keep their
    distances.

    Message t comes 3 s late up to t = 3 s, then at 6 s + (t - 3 s) / 2, which is t at 9 s: none waits any more.
    """
    fs, block, began = 8000, 80, 3.0
    now = [0.0]
    arrivals = Arrivals[float](fs, block, lambda: now[0])
    times, delays, frame, due = [0.02 * i for i in range(600)], dict[float, float](), 0, 0
    while now[0] < 12.0:
        now[0] = began + frame / fs
        while due < len(times) and times[due] <= now[0]:
            arrivals.add(times[due], times[due])
            due += 1
        delays |= {time: now[0] - time for time in arrivals.due(frame)}
        frame += block
    longest = block / fs + 1e-9
    assert list(delays) == times
    for time, delay in delays.items():
        wanted = 3.0 if time <= began else max((9.0 - time) / 2, 0.0)
        assert wanted - longest <= delay <= wanted + longest, time


def test_a_signal_before_the_first_block_keeps_the_messages_that_came(
    monochord: tw.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Garbage is collected before: that takes as long as many blocks."""
    source = SimpleNamespace(name="keys", poll=[[(0.0, (0x90, 45, 90))], []].pop, close=lambda: None)
    take = Take(48000)
    session = LiveSession(tw.Live(monochord, prepare=False), [source], take=take)

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tonewood.sound.live.session.gc.collect", interrupted)
    source.poll()
    assert session.run(stream=SimpleNamespace).frames == 0
    assert take.messages == [(0, bytes((0x90, 45, 90)))]
    assert gc.isenabled()


def test_a_terminal_that_has_gone_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Esc does: what was typed before counts, and nothing is raised."""
    controller, terminal = pty.openpty()
    with open(terminal) as stdin:
        monkeypatch.setattr("tonewood.sound.live.keyboard.sys.stdin", stdin)
        keys = ComputerKeyboard(36.0)
        os.write(controller, b"z")
        assert select.select([terminal], [], [], 10.0)[0]
        assert [message for _, message in keys.poll()] == [[0x90, 36, 90]]
        assert not keys.ended
        os.close(controller)
        assert select.select([terminal], [], [], 10.0)[0]
        assert keys.poll() == []
        assert keys.ended
        keys.close()
