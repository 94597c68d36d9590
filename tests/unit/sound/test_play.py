"""Playing into a sound card that is not there: a stream that asks for blocks as PortAudio does."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import NumericalError, OutputError
from tonewood.sound.level.limiter import Limiter


class FakeStream:
    """Calls back from a thread of its own and keeps the blocks."""

    status: Any = None

    def __init__(self, **options: Any) -> None:
        self.options, self.got = options, []
        type(self).last = self

    def __enter__(self) -> FakeStream:
        self.thread = threading.Thread(target=self._run)
        self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.thread.join(5.0)

    def _run(self) -> None:
        n, channels = self.options["blocksize"], self.options["channels"]
        while True:
            out = np.full((n, channels), np.nan, dtype=self.options["dtype"])
            try:
                self.options["callback"](out, n, None, self.status)
            except StopIteration:
                self.options["finished_callback"]()
                return
            self.got.append(out)
            time.sleep(0.001)


@pytest.fixture(autouse=True)
def _without_sounddevice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the test machine's sound card nor the lack of one has a say."""
    monkeypatch.setitem(sys.modules, "sounddevice", None)


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    return tw.load_instrument("monochord")


def renderer(instrument: tw.Instrument, **options: Any) -> tw.Renderer:
    return tw.Renderer(tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)]), instrument, max_duration=0.2, **options)


def test_the_card_gets_the_very_samples(monochord: tw.Instrument) -> None:
    wanted = np.concatenate(list(renderer(monochord).blocks(1024)))
    played = tw.play(renderer(monochord), block_size=256, stream=FakeStream)
    assert played.frames == len(wanted)
    assert FakeStream.last.options["dtype"] == "float32"  # PortAudio knows no doubles
    got = np.concatenate([block for block in FakeStream.last.got if block.any()])  # a late block is silence
    assert np.array_equal(got[: len(wanted)], np.repeat(wanted, 2, axis=1).astype(np.float32))
    assert not got[len(wanted) :].any()


def test_a_score_is_played_with_the_options_of_a_render(monochord: tw.Instrument) -> None:
    score = tw.Score([tw.Note(0.0, 0.1, note=45, force=1.0)])
    wanted = tw.render(score, monochord, 16000, max_duration=0.1, gain_db=-6.0).samples
    played = tw.play(score, monochord, 16000, max_duration=0.1, gain_db=-6.0, block_size=100, stream=FakeStream)
    assert played.frames == len(wanted) == 1600
    got = np.concatenate([block for block in FakeStream.last.got if block.any()])
    assert np.array_equal(got[:1600], np.repeat(wanted, 2, axis=1).astype(np.float32))
    with pytest.raises(TypeError, match="already"):
        tw.play(renderer(monochord), gain_db=-6.0, stream=FakeStream)
    with pytest.raises(TypeError, match="instrument"):
        tw.play(score, stream=FakeStream)


def test_a_block_that_comes_late_is_counted(monochord: tw.Instrument) -> None:
    slow = renderer(monochord)
    blocks = slow.blocks

    def late(size: int) -> Any:
        for i, block in enumerate(blocks(size)):
            while i == 12 and len(FakeStream.last.got) < 12 + 5:
                time.sleep(0.001)
            yield block

    slow.blocks = late  # type: ignore[method-assign]  # the generator, slowed down
    played = tw.play(slow, block_size=512, stream=FakeStream)
    assert played.underruns == played.late >= 5
    assert played.frames == 9600


def test_gaps_the_card_tells_of_are_counted(monochord: tw.Instrument) -> None:
    class Telling(FakeStream):
        status = SimpleNamespace(output_underflow=True)

    played = tw.play(renderer(monochord), block_size=1024, stream=Telling)
    assert played.underruns - played.late >= 9


def test_clipping_is_counted_and_a_limiter_prevents_it(monochord: tw.Instrument) -> None:
    assert tw.play(renderer(monochord, gain_db=60.0), stream=FakeStream).clipped > 0
    assert np.abs(np.concatenate(FakeStream.last.got)).max() <= 1.0
    assert tw.play(renderer(monochord, gain_db=60.0), stream=FakeStream, limiter=Limiter(48000)).clipped == 0


def test_an_error_while_rendering_reaches_the_caller(monochord: tw.Instrument) -> None:
    broken = renderer(monochord)

    def fails(size: int) -> Any:
        yield np.zeros((size, 1))
        raise NumericalError("no longer finite")

    broken.blocks = fails  # type: ignore[method-assign]  # in place of the renderer's own
    with pytest.raises(NumericalError, match="no longer finite"):
        tw.play(broken, stream=FakeStream)


def test_without_sounddevice_or_portaudio_one_line(monochord: tw.Instrument, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OutputError, match=r"pip install 'tonewood\[play\]'"):
        tw.play(renderer(monochord))

    class NoPortAudio:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "sounddevice":
                raise OSError("PortAudio library not found")

    monkeypatch.delitem(sys.modules, "sounddevice")
    monkeypatch.setattr(sys, "meta_path", [NoPortAudio(), *sys.meta_path])
    with pytest.raises(OutputError, match="needs the PortAudio library"):
        tw.play(renderer(monochord))


def test_a_device_that_is_not_there_one_line(monochord: tw.Instrument, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = ModuleType("sounddevice")

    class PortAudioError(Exception):
        pass

    def refuse(**options: Any) -> None:
        raise PortAudioError(f"no device {options['device']}")

    fake.PortAudioError, fake.OutputStream, fake.CallbackStop = PortAudioError, refuse, StopIteration  # type: ignore[attr-defined]  # a module of these names
    monkeypatch.setitem(sys.modules, "sounddevice", fake)
    with pytest.raises(OutputError, match="cannot open the sound device: no device 99"):
        tw.play(renderer(monochord), device=99)
    with pytest.raises(OutputError, match="--device names another, and `tonewood render` writes a file"):
        tw.play(renderer(monochord))


def test_a_device_that_cannot_be_started_is_one_line_and_one_that_was_is_given_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fake, calls = ModuleType("sounddevice"), list[str]()

    class PortAudioError(Exception):
        pass

    class OutputStream:
        busy, latency = True, 0.25

        def __init__(self, **options: Any) -> None:
            self.callback = options["callback"]

        def start(self) -> None:
            if self.busy:
                raise PortAudioError("device busy")
            with contextlib.suppress(StopIteration):
                while True:
                    self.callback(np.zeros((4, 2), np.float32), 4)

        def stop(self) -> None:
            calls.append("stop")

        def close(self) -> None:
            calls.append("close")

    fake.PortAudioError, fake.OutputStream, fake.CallbackStop = PortAudioError, OutputStream, StopIteration  # type: ignore[attr-defined]  # a module of these names
    monkeypatch.setitem(sys.modules, "sounddevice", fake)
    with pytest.raises(OutputError, match="cannot open the sound device: device busy"):
        tw.AudioStream([np.zeros((4, 1))], 4, fs=16000, n_channels=1).play()
    assert calls == []
    OutputStream.busy = False
    stream = tw.AudioStream([np.zeros((4, 1))], 4, fs=16000, n_channels=1)
    assert (stream.play().frames, stream.device_latency, calls) == (4, 0.25, ["stop", "close"])


def test_a_device_that_stops_by_itself_is_an_error() -> None:
    """PortAudio calls back that the stream has finished, also where the device was unplugged."""

    class Unplugged(FakeStream):
        def _run(self) -> None:
            for _ in range(2):
                self.options["callback"](np.zeros((self.options["blocksize"], 2), np.float32), 4000, None, None)
            self.options["finished_callback"]()

    blocks = [np.zeros((4000, 1))] * 100
    with pytest.raises(OutputError, match=r"^the sound device has stopped by itself, after 0\.5 s$"):
        tw.AudioStream(blocks, 4000, fs=16000, n_channels=1).play(stream=Unplugged)
    ended = tw.AudioStream(blocks[:2], 4000, fs=16000, n_channels=1).play(stream=FakeStream)
    assert ended.frames == 8000


def test_samples_beyond_full_scale_are_counted() -> None:
    blocks = [np.array([[0.5], [-1.5], [1.0], [1.2]]), np.array([[0.9], [-1.0], [-3.0], [0.0]])]
    played = tw.AudioStream(blocks, 4, fs=16000, n_channels=1).play(stream=FakeStream)
    assert played.clipped == 3
