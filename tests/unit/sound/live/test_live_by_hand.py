"""An instrument played live, its stream, its session and its take, with neighbours that the test replaces."""

from __future__ import annotations

import gc
import sys
from collections import Counter, deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.engine.engine import GRID
from tonewood.sound.live import take
from tonewood.sound.live.session import LiveSession
from tonewood.sound.live.stream import Arrivals, AudioStream

FS = 8000


def test_frames_of_a_live_instrument_are_counted_and_its_past_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    live = tw.Live("monochord", FS, prepare=False)
    forgotten: list[int] = []
    monkeypatch.setattr(live, "_fill", lambda frames: None)
    monkeypatch.setattr(live.engine.usage, "forget_times", lambda: forgotten.append(live.frames))
    live._pending = np.array([[0.5], [-1.5], [1.0], [1.25], [0.0], [0.25]])
    assert live.process(3)[:, 0].tolist() == [0.5, -1.5, 1.0]
    assert live.process(1)[:, 0].tolist() == [1.25]
    found = live.summary()
    assert (found.frames, found.clipped, found.peak_dbfs) == (4, 2, pytest.approx(20 * np.log10(1.5)))
    assert live.time == 4 / FS
    for frames, times in ((65534, 0), (65535, 1), (65536, 1), (131070, 1), (131071, 2)):
        live.frames, live._pending = frames, np.zeros((1, 1))
        live.process(1)
        assert len(forgotten) == times


def test_a_long_block_is_stepped_at_once_and_no_further_than_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points of 64 frames; while notes may come between two of them, or stops are to be compiled, one at a time."""
    live = tw.Live("monochord", FS, prepare=False)
    steps: list[int] = []
    advance = live.engine.advance
    monkeypatch.setattr(live.engine, "advance", lambda points: (steps.append(points), advance(points))[1])
    idle = live.player.idle_points
    assert idle >= 8
    assert GRID == 64
    for frames, points in ((257, [5]), (63, []), (1, [1]), (63, []), (512, [8])):
        steps.clear()
        live.process(frames)
        assert steps == points
    live.player.spare = lambda: False  # what waits is not compiled yet
    live._bases._waiting.append(("A2", 0, {}))
    live.process(256)
    live._bases._waiting.clear()
    live.process(256)
    assert steps == [8, 1, 1, 1, 1, 4]


def test_a_meter_has_loads_underruns_and_the_last_note_that_was_lost() -> None:
    counters = SimpleNamespace(dropped=Counter(), latest=deque())
    stream = SimpleNamespace(loads=deque(), underruns=0, latency=0.02, device_latency=0.03)
    player = SimpleNamespace(n_sounding=2, counters=counters)
    live = SimpleNamespace(player=player, ramp=0.005, latency=0.0075)
    one: Any = SimpleNamespace(stream=stream, live=live)
    assert LiveSession.status(one) == "load   0 %, worst   0 % | 0 underruns | 2 sounding"
    stream.loads.extend([0.1, 0.2, 0.6])
    stream.underruns = 3
    counters.dropped.update({"too low": 2, "too high": 1})
    counters.latest.extend([SimpleNamespace(reason="too low"), SimpleNamespace(reason="too high")])
    assert LiveSession.status(one) == (
        "load  30 %, worst  60 % | 3 underruns | 2 sounding | 3 not played, last: too high"
    )
    parts = LiveSession.latency.fget(one)  # type: ignore[attr-defined]
    assert parts == pytest.approx({"pluck": 0.005, "grid": 0.0025, "blocks": 0.02, "device": 0.03})


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_session_leaves_the_interpreter_as_it_was(interrupted: bool) -> None:
    """Meanwhile no collection, and threads that give way sooner; messages without a block go into the take."""
    during: list[Any] = []

    class Stream:
        def play(self, *arguments: Any, **options: Any) -> str:
            during.append((gc.isenabled(), sys.getswitchinterval(), arguments, options))
            if interrupted:
                raise KeyboardInterrupt
            return "played"

        def playback(self) -> str:
            return "so far"

    taken: list[Any] = []
    live: Any = SimpleNamespace(fs=FS, frames=77)
    closed: list[str] = []
    source: Any = SimpleNamespace(
        poll=lambda: [(2.0, [0x90, 2, 2]), (1.0, [0x90, 1, 1])], close=lambda: closed.append("closed")
    )
    take: Any = SimpleNamespace(add=lambda frame, message: taken.append((frame, message)))
    made = object.__new__(LiveSession)
    made.live, made.sources, made.take, made.stream = live, [source], take, Stream()  # type: ignore[assignment]
    made.receiver = SimpleNamespace(ignored=Counter())  # type: ignore[assignment]
    made._arrivals = Arrivals(FS, 64)
    before = sys.getswitchinterval()
    assert made.run("device", "stream", None) == ("so far" if interrupted else "played")  # type: ignore[comparison-overlap]
    assert (gc.isenabled(), sys.getswitchinterval()) == (True, before)
    assert during == [(False, pytest.approx(5e-4), ("device", "stream", None), {"low_latency": True})]
    assert taken == [(77, [0x90, 1, 1]), (77, [0x90, 2, 2])]
    assert made.receiver.ignored == {"message after the last block": 2}
    assert closed == ["closed"]


def test_frames_before_the_first_are_left_out_however_they_are_stepped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A resampler that looks 70 frames ahead gives these before frame 0: in one piece, and in two."""

    class Ahead:
        def __call__(self, sound: np.ndarray, sample: int) -> np.ndarray:
            return sound

        def samples(self, frames: float) -> float:
            return frames

    for waits in (False, True):
        live = tw.Live("monochord", FS, prepare=False)
        given = iter(range(10**6))
        monkeypatch.setattr(
            live.engine, "advance", lambda points, given=given: np.array([[next(given)] for _ in range(points * GRID)])
        )
        live._early, live._resampler = 70, Ahead()  # type: ignore[assignment]
        live._routing = SimpleNamespace(scaled=lambda x: x, finished=lambda x: x)  # type: ignore[assignment]
        live.player.spare = lambda: False
        live._bases._waiting.extend([("A2", 0, {})] * waits)
        assert live.process(10)[:, 0].tolist() == list(range(70, 80))
        assert live.process(100)[:, 0].tolist() == list(range(80, 180))


def test_blocks_of_a_stream_are_timed_clipped_and_given_to_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 8 ms that take 2, 4 and 1 ms, by a processor that halves them and gives 96 frames in place of 64."""
    clock = iter([0.0, 0.002, 1.0, 1.004, 2.0, 2.001, 3.0])
    monkeypatch.setattr("tonewood.sound.live.stream.time.perf_counter", lambda: next(clock))

    def longer(block: np.ndarray, fs: int) -> np.ndarray:
        assert fs == FS
        return np.concatenate([0.5 * block, 0.5 * block[:32]])

    sound = AudioStream([np.full((64, 1), v) for v in (1.0, 3.0)], 64, ahead=9, chain=[longer], fs=FS, n_channels=1)
    sound._fill()
    given = [sound._ready.get() for _ in range(4)]
    assert given.pop() is None
    values = np.concatenate([0.5 * np.ones(96), np.ones(96)])
    assert [block.tolist() for block in given if block is not None] == [
        [[v, v] for v in values[first : first + 64]] for first in (0, 64, 128)
    ]
    assert (sound.n_channels, sound.clipped) == (2, 96)
    assert list(sound.loads) == pytest.approx([0.25, 0.5, 0.125])
    assert sound.latency == pytest.approx(11 * 0.008)
    found = sound.playback()
    assert (found.load, found.worst_block_s) == (pytest.approx(0.875 / 3), pytest.approx(0.004))


def test_settings_of_a_take_have_their_limits(tmp_path: Path) -> None:
    limits = {"fs": (8000.0, 768000.0), "ramp": (0.0, 1.0), "spacing": (0.0, 1e6)}
    for name, (low, high) in limits.items():
        for value in (low, high):
            assert take._number({name: repr(value)}, name, 1.0, "a.mid") == value
        for text in (repr(low - 1), repr(high * 1.01), "much"):
            with pytest.raises(TonewoodError, match=f"a.mid: {name}: the take has the value '{text}'; a number from"):
                take._number({name: text}, name, 1.0, "a.mid")
    assert take._number({}, "ramp", 0.25, "a.mid") == 0.25
    recorded, live = take.Take(FS), tw.Live("monochord", FS, prepare=False, spacing=0)
    recorded.add(100, [0x90, 45, 90])
    recorded.save(tmp_path / "t.mid", live, 300)
    again = take.Replay(tmp_path / "t.mid", "monochord", tail=0.0)
    assert (again.live.player.spacing, again.fs) == (0, FS)
    assert [len(block) for block in again.blocks(150)] == [100, 150, 50]
    assert again.time == 300 / FS
