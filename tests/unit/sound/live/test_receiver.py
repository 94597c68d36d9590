"""MIDI messages, MPE zones, takes and sessions, with ports and a sound card of this process."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import mido
import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.score.midi import read_messages, read_midi
from tonewood.sound.live.keyboard import HELD, ComputerKeyboard
from tonewood.sound.live.ports import MidiInput
from tonewood.sound.live.receiver import MidiReceiver
from tonewood.sound.live.session import LiveSession
from tonewood.sound.live.stream import Arrivals
from tonewood.sound.live.take import Replay, Take


def receiver(instrument: tw.Instrument) -> MidiReceiver:
    return MidiReceiver(tw.Live(instrument, prepare=False))


def bends(midi: MidiReceiver) -> dict[int, float]:
    """Channel -> cents."""
    return {c: v for (c, kind), v in midi.live.player.controls.items() if kind == "bend"}


def register(midi: MidiReceiver, channel: int, parameter: tuple[int, int], value: int) -> None:
    for controller, byte in ((101, parameter[0]), (100, parameter[1]), (6, value)):
        midi.receive((0xB0 | channel, controller, byte))


def test_notes_velocity_zero_and_running_keys(guitar: tw.Instrument) -> None:
    midi = receiver(guitar)
    midi.receive((0x91, 64, 100))
    midi.live.process(256)
    assert midi.live.player.n_sounding == 1
    midi.receive((0x91, 64, 0))
    midi.receive((0x81, 64, 0))
    midi.live.process(4800)
    assert midi.live.player.n_sounding == 0
    assert midi.ignored == {"note-off without a note": 1}


def test_the_range_of_the_wheel_is_two_semitones_or_what_parameter_0_says(guitar: tw.Instrument) -> None:
    midi = receiver(guitar)
    midi.receive((0xE0, 0, 96))  # half way up: (96 * 128 - 8192) / 8192
    assert bends(midi)[0] == 100
    register(midi, 0, (0, 0), 12)
    assert bends(midi)[0] == 600


def test_a_zone_adds_the_masters_bend_and_passes_its_controllers_on(guitar: tw.Instrument) -> None:
    midi = receiver(guitar)
    register(midi, 0, (0, 6), 5)
    assert midi.zones == {0: [1, 2, 3, 4, 5]}
    midi.receive((0xE2, 0, 66))  # member: 2 * 128 / 8192 of 48 semitones
    assert bends(midi)[2] == 150
    midi.receive((0xE0, 0, 32))  # master: half way down of 2 semitones
    assert bends(midi)[2] == 50
    assert bends(midi)[1] == -100
    midi.receive((0xB0, 64, 127))
    assert [midi.live.player.controls.get((c, "cc64")) for c in (0, 3, 5, 6)] == [1.0, 1.0, 1.0, None]
    register(midi, 15, (0, 6), 12)  # the upper zone takes channels from the lower
    assert midi.zones == {0: [1, 2], 15: list(range(3, 15))}
    register(midi, 0, (0, 6), 15)
    assert midi.zones == {0: list(range(1, 16))}
    register(midi, 0, (0, 6), 0)
    assert midi.zones == {}


@pytest.mark.parametrize("seed", range(8))
def test_bends_are_those_of_the_file_reader(monochord: tw.Instrument, tmp_path: Path, seed: int) -> None:
    """Zones, ranges, wheels and resets at random: live and from a file every channel ends at the same bend."""
    rng = np.random.default_rng(seed)
    messages = []
    for _ in range(60):
        at, value = int(rng.choice([0, 1, 2, 9, 14, 15])), int(rng.integers(0, 16))
        messages += [
            [(0xB0 | at, 101, 0), (0xB0 | at, 100, int(rng.choice([0, 6]))), (0xB0 | at, 6, value)],
            [(0xE0 | at, 0, int(rng.integers(0, 128)))],
            [(0xB0 | at, 121, 0)],
        ][int(rng.choice(3, p=[0.3, 0.6, 0.1]))]
    midi, track = receiver(monochord), mido.MidiTrack()
    for message in messages:
        midi.receive(message)
        track.append(mido.Message.from_bytes(message, time=1))
    track += [mido.Message("note_on", note=45), mido.Message("note_off", note=45, time=500)]
    file = mido.MidiFile()
    file.tracks.append(track)
    file.save(tmp_path / "a.mid")
    read = {c.channel: c.value for c in read_midi(tmp_path / "a.mid").controls if c.kind == "bend"}
    assert {c: round(v) for c, v in read.items() if round(v)} == {c: v for c, v in bends(midi).items() if v}


def test_a_bend_beyond_all_limits_is_held_there(monochord: tw.Instrument) -> None:
    """Ranges of a member and of its master may add up to more than a string can be bent."""
    midi = receiver(monochord)
    for channel, parameter, value in ((0, (0, 6), 3), (0, (0, 0), 100), (1, (0, 0), 127)):
        register(midi, channel, parameter, value)
    midi.receive((0xE1, 127, 127))
    midi.receive((0xE0, 127, 127))
    assert bends(midi)[1] == 12800
    assert midi.ignored == {"bend beyond 12800 cents, held there": 1}


def test_each_voice_of_a_zone_bends_its_own_string(guitar: tw.Instrument) -> None:
    midi = receiver(guitar)
    register(midi, 0, (0, 6), 15)
    midi.receive((0x91, 45, 100))
    midi.receive((0x92, 64, 100))
    midi.live.process(2048)
    midi.receive((0xE1, 0, 65))
    midi.live.process(2048)
    cents = {
        name: f.cents for name, f in midi.live.engine.frettings.items() if midi.live.player.hands.strings[name].voice
    }
    assert sorted(cents.values()) == [0.0, 75.0]


def test_what_has_no_effect_is_counted(guitar: tw.Instrument) -> None:
    midi = receiver(guitar)
    for message in ((0xC0, 5), (0xF0, 1, 2), (0xF8,), (0x90, 200, 1), (0x90, 60), (), (0x12, 3, 4), (0xB0, 122, 0)):
        midi.receive(message)
    assert midi.ignored == {
        "program change": 1, "system exclusive": 1, "system message": 1, "damaged message": 4, "local control": 1
    }  # fmt: skip
    assert midi.messages == 8


def random_messages(seed: int, n: int) -> list[list[int]]:
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(n):
        key, value = int(rng.integers(36, 80)), int(rng.integers(0, 128))
        kinds = [
            [0x90, key, value],
            [0x80, key, 0],
            [0xB0, 64, value],
            [0xE0, value, value],
            [0xB0, 74, value],
            [0xD0, 7],
        ]
        out.append(kinds[int(rng.integers(len(kinds)))])
    return out


@pytest.mark.slow
@pytest.mark.parametrize("fs", [44100, pytest.param(48000, marks=pytest.mark.validate)])
def test_a_take_plays_back_to_the_same_samples(guitar: tw.Instrument, tmp_path: Path, fs: int) -> None:
    live = tw.Live(guitar, fs, ramp=3e-3, spacing=1, prepare=False)
    midi, take, sound = MidiReceiver(live), Take(fs), []
    rng = np.random.default_rng(1)
    for message in random_messages(2, 24):
        take.add(live.frames, message)
        midi.receive(message)
        sound.append(live.process(int(rng.integers(1, 400))))
    take.save(tmp_path / "take.mid", live, live.frames)
    recorded = np.concatenate(sound)
    again = np.concatenate(list(Replay(tmp_path / "take.mid", guitar, max_duration=0.5).blocks(1000)))
    assert np.abs(recorded).max() > 1e-3
    assert np.array_equal(again[: len(recorded)], recorded)
    messages, end, _ = read_messages(tmp_path / "take.mid")
    assert len(messages) == 24
    assert round(end * fs) == len(recorded)


def test_a_take_is_kept_while_it_is_recorded(monochord: tw.Instrument, tmp_path: Path) -> None:
    """Saved again and again, with waits longer than a number of the file can be; mido is the second opinion."""
    live, take = tw.Live(monochord, prepare=False), Take(48000)
    times = [0, 5, 5, 300, 300 + 3 * 2**28, 301 + 3 * 2**28]
    for i, frame in enumerate(times):
        take.add(frame, (0x90 | i, 45 + i, 90))
        take.save(tmp_path / "take.mid", live, frame + 7)
        file = mido.MidiFile(tmp_path / "take.mid")
        ticks = np.cumsum([m.time for m in file.tracks[0]])
        messages = [(int(t), m.bytes()) for t, m in zip(ticks, file.tracks[0], strict=True) if not m.is_meta]
        assert messages == [(t, [0x90 | k, 45 + k, 90]) for k, t in enumerate(times[: i + 1])]
        assert ticks[-1] == frame + 7
    assert [p.name for p in tmp_path.iterdir()] == ["take.mid"]


@pytest.mark.parametrize(
    "message",
    [(0x90,), (0x90, 47), (0x90, 47, 200), (0x90, 300, 64), (0x90, -1, 64), (0xE0, 0), (47, 100), (0x190, 47, 64), ()],
)
def test_a_damaged_message_changes_no_other_of_the_take(
    monochord: tw.Instrument, tmp_path: Path, message: tuple[int, ...]
) -> None:
    midi, take = receiver(monochord), Take(48000)
    for frame, one in ((0, (0x90, 45, 90)), (10, message), (20, (0xC0, 5, 6, 7)), (30, (0x80, 45, 0, 1))):
        midi.receive(one)
        take.add(frame, one)
    assert midi.ignored["damaged message"] == 1
    take.save(tmp_path / "take.mid", midi.live, 40)
    messages = [m.bytes() for m in mido.MidiFile(tmp_path / "take.mid").tracks[0] if not m.is_meta]
    assert messages == [[0x90, 45, 90], [0xC0, 5], [0x80, 45, 0]]


def test_a_replay_at_another_rate_says_so(monochord: tw.Instrument, tmp_path: Path) -> None:
    live, take = tw.Live(monochord, 44100, prepare=False), Take(44100)
    take.add(0, (0x90, 45, 90))
    take.save(tmp_path / "take.mid", live, 100)
    replay = Replay(tmp_path / "take.mid", monochord, 48000, max_duration=0.05)
    assert sum(len(block) for block in replay.blocks()) == 2400
    assert replay.summary().warnings == ["recorded at 44100 Hz: its samples are those at that rate"]
    with pytest.raises(TonewoodError, match="--fs: a take at 47999 Hz"):
        Take(47999)


@pytest.mark.parametrize("setting", ["fs=x", "fs=1e999", "fs=7", "ramp=nan", "ramp=", "spacing=-1", "spacing=1_0"])
def test_a_take_with_a_setting_that_is_no_number_is_refused_in_one_line(
    monochord: tw.Instrument, tmp_path: Path, setting: str
) -> None:
    import mido

    track = mido.MidiTrack([mido.MetaMessage("track_name", name=f"tonewood take; {setting}")])
    track.append(mido.Message("note_on", note=45, velocity=90))
    mido.MidiFile(type=0, tracks=[track]).save(tmp_path / "take.mid")
    with pytest.raises(TonewoodError, match=setting.split("=")[0]) as caught:
        Replay(tmp_path / "take.mid", monochord)
    assert "\n" not in str(caught.value)


class FakeCard:
    """Asks for a number of blocks as a sound card does, as soon as each is ready: nothing of it depends on timing."""

    latency = 0.01

    def __init__(self, **options: Any) -> None:
        self.options, self.got = options, []
        type(self).last = self

    def __enter__(self) -> FakeCard:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def session(live: tw.Live, sources: list[Any], n_blocks: int, **options: Any) -> tuple[LiveSession, np.ndarray, Any]:
    """Play some blocks; return the sound that the card has got."""
    made = LiveSession(live, sources, **options)

    def take_blocks() -> bool:
        card = FakeCard.last
        while len(card.got) < n_blocks:
            out = np.zeros((card.options["blocksize"], card.options["channels"]), np.float32)
            before = made.stream.underruns
            card.options["callback"](out, len(out), None, None)
            if made.stream.underruns == before:
                card.got.append(out)
        return False

    played = made.run(stream=FakeCard, wait=take_blocks)
    return made, np.concatenate(FakeCard.last.got), played


def test_a_port_is_played_and_recorded(guitar: tw.Instrument, ports: Any, tmp_path: Path) -> None:
    port = MidiInput("keys b")
    assert port.name == "Keys B"
    ports.OPEN["Keys B"].feed(mido.Message("note_on", note=45, velocity=100), mido.Message("note_on", note=64))
    live, take = tw.Live(guitar, prepare=False), Take(48000)
    made, sound, played = session(live, [port], 40, take=take, block_size=256, ahead=3)
    assert FakeCard.last.options["latency"] == "low"
    assert np.abs(sound).max() > 1e-3
    assert played.frames == 40 * 256
    assert made.latency["device"] == 0.01
    assert made.latency["blocks"] == pytest.approx(5 * 256 / 48000)
    assert "2 sounding" in made.status()
    assert ports.OPEN == {}
    take.save(tmp_path / "take.mid", live, live.frames)
    again = np.concatenate(list(Replay(tmp_path / "take.mid", guitar, max_duration=0.3).blocks(512)))
    assert np.array_equal(sound, again[: len(sound)].astype(np.float32))


class Waiting:
    """A source whose messages came before the first block, at given times re the first of them, s."""

    name = "waiting"

    def __init__(self, *messages: tuple[float, tuple[int, ...]]) -> None:
        self.messages = list(messages)

    def poll(self) -> list[tuple[float, tuple[int, ...]]]:
        begun, out = time.monotonic() - 10.0, self.messages
        self.messages = []
        return [(begun + at, message) for at, message in out]

    def close(self) -> None:
        pass


def test_messages_that_waited_for_the_sound_keep_their_distances(monochord: tw.Instrument) -> None:
    """They came 10 s before the first block: a note, its end 50 ms later, and the next; all were at frame 0.

    Those of two sources are put into their order, and one that is due after the end is counted.
    """
    live, take = tw.Live(monochord, prepare=False), Take(48000)
    one = Waiting((0.0, (0x90, 45, 100)), (0.1, (0x90, 47, 100)), (5.0, (0x80, 47, 0)))
    two = Waiting((0.05, (0x80, 45, 0)))
    made, _, _ = session(live, [one, two], 60, take=take, block_size=128)
    assert [tuple(data) for _, data in take.messages] == [
        (0x90, 45, 100), (0x80, 45, 0), (0x90, 47, 100), (0x80, 47, 0)
    ]  # fmt: skip
    for (frame, _), at in zip(take.messages[:3], (0.0, 0.05, 0.1), strict=True):
        assert at * 48000 - 128 < frame <= at * 48000
    assert take.messages[3][0] == live.frames
    assert made.receiver.ignored == {"message after the last block": 1}


def test_arrivals_keep_their_distances_until_none_waits() -> None:
    clock = [0.0]
    arrivals = Arrivals[str](1000, 10, lambda: clock[0])
    clock[0] = 0.04
    arrivals.add(0.03, "in time")
    assert list(arrivals.due(0)) == ["in time"]
    for at, name in ((1.0, "first"), (1.012, "second"), (1.0125, "third")):
        arrivals.add(at, name)
    clock[0] = 2.0
    assert [list(arrivals.due(frame)) for frame in (100, 110, 120)] == [["first"], ["second", "third"], []]
    arrivals.add(1.99, "in time")  # none waits any more
    assert list(arrivals.due(130)) == ["in time"]


def test_calls_that_waited_for_the_stream_keep_their_distances(
    monochord: tw.Instrument, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[int] = []
    live = tw.Live(monochord, prepare=False)
    stream = tw.AudioStream(live, 64, ahead=8)
    with monkeypatch.context() as patch:
        for at in (-9.0, -8.995):
            patch.setattr("tonewood.sound.live.stream.time.monotonic", lambda at=at: at)
            stream.send(lambda: frames.append(live.frames))
    with stream:
        pass
    assert frames == [0, 192]  # 5 ms are 240 frames: in the block from 192 on


def test_ports_that_are_not_there_are_one_line(ports: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TonewoodError, match="--midi-in: 'organ' is not there; there are Keys A, Keys B, Pads"):
        MidiInput("organ")
    with pytest.raises(TonewoodError, match="'keys' fits several; there are Keys A, Keys B"):
        MidiInput("keys")
    assert MidiInput().name == "Keys A"
    monkeypatch.setattr(ports, "NAMES", [])
    with pytest.raises(TonewoodError, match="there is no MIDI input; --keyboard"):
        MidiInput()


def test_without_rtmidi_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> list[str]:
        raise ModuleNotFoundError("No module named 'rtmidi'", name="rtmidi")

    monkeypatch.setattr(mido, "get_input_names", missing)
    with pytest.raises(TonewoodError, match=r"need rtmidi: pip install 'tonewood\[live\]'"):
        MidiInput()


def test_without_a_sequencer_one_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing() -> list[str]:
        raise OSError("MidiInAlsa::initialize: error creating ALSA sequencer client object.")

    monkeypatch.setattr(mido, "get_input_names", nothing)
    with pytest.raises(TonewoodError, match=r"ALSA sequencer client.*modprobe snd-seq.*JACK.*MIDO_BACKEND.*--keyboard"):
        MidiInput()


def test_the_computers_keys(guitar: tw.Instrument) -> None:
    typed, clock = [""], [0.0]

    def read() -> str:
        text, typed[0] = typed[0], ""
        return text

    keys = ComputerKeyboard(40, read, lambda: clock[0])
    typed[0] = "zq-]z"
    assert keys.poll() == [
        (0.0, [0x90, 36, 90]),
        (0.0, [0x90, 48, 90]),
    ]  # the octave up has z at 48, which is still held
    clock[0] = HELD + 0.01
    typed[0] = "s"
    assert [message for _, message in keys.poll()] == [[0x90, 49, 80], [0x80, 36, 0], [0x80, 48, 0]]
    typed[0] = " \x1b!"
    assert keys.poll() == [(clock[0], [0xB0, 120, 0])]
    assert keys.ended
    with pytest.raises(TonewoodError, match="--keyboard: standard input is no terminal"):
        ComputerKeyboard(40)


def test_calls_reach_the_thread_that_computes(monochord: tw.Instrument) -> None:
    live = tw.Live(monochord)
    threads: list[int] = []
    stream = tw.AudioStream(live, 128, ahead=1, chain=[lambda block, fs: block * 0.5])
    stream.send(lambda: threads.append(threading.get_ident()))
    stream.send(live.note_on, "A2", 100)
    with stream:
        got = []
        while len(got) < 60:
            out = np.zeros((128, 2), np.float32)
            before = stream.underruns
            stream.callback(out, 128)
            if stream.underruns == before:
                got.append(out)
    assert threads
    assert threads[0] != threading.get_ident()
    wanted = tw.Live(monochord, gain_db=20 * np.log10(0.5))
    wanted.process(128)
    wanted.note_on("A2", 100)
    # the call comes before some block: the first that sounds begins the note
    sound = np.concatenate(got)[:, 0]
    begin = int(np.flatnonzero(sound)[0]) // 128 * 128
    expected = wanted.process(len(sound) - begin)[:, 0]
    assert np.abs(sound[begin:]).max() > 1e-4
    assert np.allclose(sound[begin:], expected, rtol=1e-6, atol=1e-9)


def test_a_chain_that_holds_samples_back_makes_no_short_blocks() -> None:
    held = np.zeros((0, 2))

    def late(block: np.ndarray, fs: int) -> np.ndarray:
        """Hold the last 64 samples back."""
        nonlocal held
        joined = np.concatenate([held, block])
        held = joined[-64:]
        return joined[:-64]

    source = np.random.default_rng(0).standard_normal((512, 2))
    stream = tw.AudioStream(iter(np.split(source, 4)), 128, chain=[late], fs=48000, n_channels=2)
    blocks = list(stream._chained())
    assert [len(block) for block in blocks] == [128, 128, 128, 64]
    assert np.array_equal(np.concatenate(blocks), source[:448])
    with pytest.raises(TypeError, match="only then"):
        tw.AudioStream(iter(source), 128)
    for block, ahead in ((0, 2), (1.5, 2), (None, 2), (1 << 21, 2), (128, 0), (128, 1.5), (128, 5000)):
        with pytest.raises(TonewoodError, match=r"^(block_size|ahead): is .*; 1 to \d+ are allowed"):
            tw.AudioStream(iter(source), block, ahead=ahead, fs=48000, n_channels=2)  # type: ignore[arg-type]


def test_a_pedalboard_is_a_chain() -> None:
    """As docs/live.md has it: blocks through a reverb are the whole sound through the same reverb."""
    pedalboard = pytest.importorskip("pedalboard")
    sound = np.random.default_rng(3).normal(scale=0.1, size=(2560, 2))
    board, again = (pedalboard.Pedalboard([pedalboard.Reverb(room_size=0.3)]) for _ in range(2))
    chain = [lambda block, fs: board(block.T.astype("float32"), fs, reset=False).T]
    stream = tw.AudioStream(iter(np.split(sound, 20)), 128, chain=chain, fs=48000, n_channels=2)
    found = np.concatenate(list(stream._chained()))
    wanted = again(sound.T.astype("float32"), 48000).T
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 1e-6
    assert np.abs(found - sound).max() > 0.01


def test_percussion_is_left_out_and_counted_unless_asked_for(tmp_path: Path) -> None:
    """Notes of channel 10, as in a score; a member of a zone of MPE is no percussion; a take keeps what was asked."""
    notes = [(0x90 | channel, key, 100) for channel, key in ((9, 45), (0, 47), (9, 48))]
    left_out = {"note of channel 10, left out (--tracks 10 plays it)": 2}
    for channels, played, ignored in ((None, 1, left_out), ([10], 2, None), ([1, 10], 3, {})):
        live = tw.Live("monochord", prepare=False)
        midi, take = MidiReceiver(live, channels), Take(48000, channels)
        for message in notes:
            take.add(live.frames, message)
            midi.receive(message)
            live.process(4800)
        assert live.summary().notes + sum(live.summary().dropped.values()) == played
        if ignored is not None:
            assert dict(midi.ignored) == ignored
        take.save(tmp_path / "a.mid", live, live.frames)
        replay = Replay(tmp_path / "a.mid", "monochord", max_duration=0.3)
        for _ in replay.blocks():
            pass
        assert replay.summary().notes == live.summary().notes
    zone = MidiReceiver(tw.Live("monochord", prepare=False))
    register(zone, 0, (0, 6), 15)
    zone.receive(notes[0])
    assert not zone.ignored
