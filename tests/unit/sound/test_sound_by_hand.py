"""Ways of a sound to its file, its mix and its player, with neighbours that the test replaces: what each is given."""

from __future__ import annotations

import gc
import sys
import warnings
from collections import Counter, deque
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.errors import DroppedNotesWarning, NothingPlayedError, OutputError, TonewoodError
from tonewood.performance.engine.engine import GRID
from tonewood.performance.score.note import Control, Dropped
from tonewood.sound.ensemble import mix
from tonewood.sound.ensemble.mix import EnsemblePart
from tonewood.sound.files import audio
from tonewood.sound.files.audio import SoundWriter
from tonewood.sound.level.loudness import resampled
from tonewood.sound.live import take
from tonewood.sound.live.session import LiveSession
from tonewood.sound.live.stream import Arrivals, AudioStream
from tonewood.sound.render import energy, plan
from tonewood.sound.render.model_file import flat, save_model, write_arrays
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer, Summary
from tonewood.support.params import Parameters
from tonewood.support.whole_files import AtomicFile

FS = 8000


def summary(**more: Any) -> Summary:
    usual = {"frames": 4, "fs": FS, "duration_s": 1.0, "render_s": 1.0, "realtime_factor": 1.0, "n_modes": 1,
             "notes": 1, "notes_dropped": [], "peak_dbfs": 0.0, "end": "decayed", "warnings": ["one"]}  # fmt: skip
    return Summary(**{**usual, **more})


# parts of an ensemble


class Pool:
    """Processes that are none: a job is done when it is submitted."""

    sizes: ClassVar[list[int]] = []
    methods: ClassVar[list[str]] = []

    def __init__(self, n: int, mp_context: Any):
        self.sizes.append(n)
        self.methods.append(mp_context.get_start_method())

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def submit(self, function: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as fault:  # as a pool does
            future.set_exception(fault)
        return future


@pytest.mark.parametrize(
    ("workers", "cores", "n_parts", "size"),
    [(2, 9, 3, 2), (5, 9, 3, 3), (None, 2, 3, 2), (None, None, 3, None), (1, 9, 3, None), (4, 9, 1, None)],
)
def test_parts_come_in_their_order_from_as_many_processes_as_are_of_use(
    workers: int | None, cores: int | None, n_parts: int, size: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One worker, one processor or one part: in this process."""

    def rendered(score: str, part: EnsemblePart, options: RenderOptions, reading: dict[str, Any]) -> Any:
        if part.part == 2:
            raise NothingPlayedError("no notes")
        warnings.warn(DroppedNotesWarning("in the process of the part"), stacklevel=1)
        dropped = [Dropped(0.5, 1.0, 1, "too low")] if part.part == 3 else []
        return np.full((2, 2), part.part), summary(notes_dropped=dropped, effects=["an effect"])

    Pool.sizes, Pool.methods = [], []
    monkeypatch.setattr(mix, "_rendered", rendered)
    monkeypatch.setattr(mix, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(mix.os, "cpu_count", lambda: cores)
    told: list[str] = []
    jobs: Any = [("s", EnsemblePart(part=i, instrument=f"i{i}"), RenderOptions(), {}) for i in (1, 2, 3)[:n_parts]]
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        results = list(mix._all_rendered(jobs, workers, told.append))
    assert told == ["i1", "i2", "i3"][:n_parts]
    assert [None if isinstance(r, NothingPlayedError) else r[0].tolist() for r in results] == [
        [[1, 1], [1, 1]], None, [[3, 3], [3, 3]],
    ][:n_parts]  # fmt: skip
    assert [size] == (Pool.sizes or [None])
    if size is not None:
        assert Pool.methods == ["spawn"]
        assert results[0][1].effects == ()  # type: ignore[index]  # they hold what no process sends
        # warnings of the processes are theirs; those of dropped notes are issued once, here
        assert [str(w.message) for w in issued] == ["1 note cannot be played; the first, at 0.50 s: too low"]


def test_a_process_that_ends_is_named_with_its_instrument(monkeypatch: pytest.MonkeyPatch) -> None:
    def rendered(*_: Any) -> Any:
        raise BrokenProcessPool

    monkeypatch.setattr(mix, "_rendered", rendered)
    monkeypatch.setattr(mix, "ProcessPoolExecutor", Pool)
    jobs: Any = [("s", EnsemblePart(part=i, instrument=f"i{i}"), RenderOptions(), {}) for i in (1, 2)]
    with pytest.raises(TonewoodError, match="the process that rendered i1 ended: out of memory"):
        list(mix._all_rendered(jobs, 2, None))


@pytest.mark.parametrize(
    ("fault", "said"), [(OSError(28, "No space left"), "No space left"), (OSError("4 of 9"), r"is the disk full\?")]
)
def test_a_part_that_is_not_kept_says_why(fault: OSError, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def save(*_: Any) -> None:
        raise fault

    monkeypatch.setattr(mix, "_rendered", lambda *_: (np.zeros((1, 2)), summary()))
    monkeypatch.setattr(mix.np, "save", save)
    with pytest.raises(OutputError, match=f"kept until the mix: {said}$"):
        mix._to_file("x.npy", "s", EnsemblePart(part=1, instrument="i"), RenderOptions(), {})


def test_stems_are_as_long_as_the_longest_part(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [EnsemblePart(part=i, instrument="i") for i in (1, 2, 3)]
    why = NothingPlayedError("no notes", file="s.mid")
    given: list[Any] = []

    def all_rendered(jobs: Any, workers: Any, progress: Any) -> Any:
        given[:] = jobs
        results = [(np.ones((2, 2)), summary()), why, (np.ones((3, 2)), summary())]
        return [results[job[1].part - 1] for job in jobs]

    monkeypatch.setattr(mix, "_all_rendered", all_rendered)
    silent: list[tuple[int, str]] = []
    stems = mix.render_ensemble(
        Path("s.mid"), parts, FS, silent=lambda part, reason: silent.append((part.part, reason)), lead_in=0.5
    )
    assert silent == [(2, "no notes")]
    assert [(stem.part.part, stem.samples[:, 1].tolist()) for stem in stems] == [(1, [1, 1, 0]), (3, [1, 1, 1])]
    assert [(job[0], job[2].fs, job[2].lead_in, job[3]) for job in given] == [("s.mid", FS, 0.5, {})] * 3
    mix.render_ensemble("s.mid", parts[:1], reading={"transpose": 2})
    assert given[0][3] == {"transpose": 2}
    # one part alone, or nobody to tell: that is the error
    for some, tell in ((parts[1:2], silent.append), (parts, None)):
        with pytest.raises(NothingPlayedError) as caught:
            mix.render_ensemble("s.mid", some, silent=tell)  # type: ignore[arg-type]  # not called
        assert caught.value is why
    with pytest.raises(NothingPlayedError, match="no note of any part can be played"):
        mix.render_ensemble("s.mid", [parts[1]] * 2, silent=lambda part, reason: None)


@pytest.mark.parametrize(("channel", "acts"), [(1, True), (None, True), (0, False), (2, False)])
def test_volume_of_a_part_is_that_of_its_channel_at_the_time_of_its_lead_in(
    channel: int | None, acts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Part 2 is channel 1 from 0; a volume that the instrument itself uses is left to it."""
    controls = [
        Control(0.5, "cc7", 0.5, channel),
        Control(0.5, "cc11", 0.5, channel),
        Control(0.5, "cc1", 0.5, channel),
    ]
    score = tw.Score([tw.Note(0.0, note=45, program=p) for p in (3, 4)], controls,
                     ignored={"program change": 1, "other": 2})  # fmt: skip
    played: list[Any] = []

    class Renderer:
        channels, zero_frame, fs = ("a",), 250, 1000

        def __init__(self, music: tw.Score, instrument: Any, *, options: RenderOptions):
            played.append(music)

        def blocks(self, size: int) -> list[np.ndarray]:
            return [np.ones((500, 1)), np.ones((500, 1))]

        def summary(self) -> Summary:
            return summary()

    playing = SimpleNamespace(controls={"cc11": None}, switches={})
    instrument = SimpleNamespace(replace=lambda changes: SimpleNamespace(spec=SimpleNamespace(playing=playing)))
    monkeypatch.setattr(mix, "Renderer", Renderer)
    monkeypatch.setattr(mix, "read_score", lambda path, tracks, **reading: score)
    monkeypatch.setattr("tonewood.instrument.bundle.loading.Instrument.load", lambda name: instrument)
    part = EnsemblePart(part=2, instrument="i", programs=[3], pan=-1.0)
    sound, found = mix._rendered("s", part, RenderOptions(), {})
    assert [n.program for n in played[0].notes] == [3]
    assert [c.kind for c in played[0].controls] == ["cc11", "cc1"]
    assert played[0].ignored == {"other": 2}
    assert sound[[749, 755, 760], 0] == pytest.approx([1.0, 0.75**2, 0.25] if acts else [1.0, 1.0, 1.0])
    assert found.warnings == ("one",)
    mix._rendered("s", part.model_copy(update={"programs": None}), RenderOptions(), {})
    assert played[1].ignored == {"program change": 1, "other": 2}
    quiet = part.model_copy(update={"gain_db": -120.0})
    monkeypatch.setattr(Renderer, "blocks", lambda self, size: [np.full((9, 1), 1e-5)])
    assert mix._rendered("s", quiet, RenderOptions(), {})[1].warnings[1:] == (
        "the sound is silent: its peak is -220 dBFS",
    )
    monkeypatch.setattr(Renderer, "blocks", lambda self, size: [])
    assert mix._rendered("s", part, RenderOptions(), {})[0].shape == (0, 2)
    monkeypatch.setattr(Renderer, "channels", ("a", "b", "c"))
    with pytest.raises(TonewoodError, match="outputs: i has 3 channels; choose one or two"):
        mix._rendered("s", part, RenderOptions(), {})
    monkeypatch.setattr(mix, "Renderer", lambda *_, **__: (_ for _ in ()).throw(NothingPlayedError("too low")))
    with pytest.raises(NothingPlayedError, match="s: part 2 on i: too low"):
        mix._rendered("s", part, RenderOptions(), {})
    with pytest.raises(NothingPlayedError, match="s: part 2 on i: there are no notes to play"):
        mix._rendered("s", part.model_copy(update={"programs": [9]}), RenderOptions(), {})


# files


def test_reasons_why_a_file_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """libsndfile names none: the system is asked again."""
    (tmp_path / "a").touch()
    assert audio._reason(tmp_path / "a", RuntimeError("bad header")) == "bad header"
    assert audio._reason(tmp_path, RuntimeError("bad header")) == "Is a directory"

    def bare(*_: Any) -> None:
        raise OSError("bare")

    monkeypatch.setattr(Path, "open", bare)
    assert audio._reason(tmp_path / "a", RuntimeError("bad header")) == "bare"


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("when", ["opened", "written", "closed", "short"])
def test_a_sound_file_that_fails_is_removed_where_it_is_the_writer_s_own(
    own: bool, when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise sf.LibsndfileError(2)

    if when == "opened":
        monkeypatch.setattr(sf, "SoundFile", fail)
    elif when == "written":
        monkeypatch.setattr(sf.SoundFile, "write", fail)
    elif when == "closed":
        monkeypatch.setattr(sf, "info", fail)
    else:
        monkeypatch.setattr(sf, "info", lambda name: SimpleNamespace(frames=3))
    target = tmp_path / "a.wav"
    path: Any = target if own else AtomicFile(target)
    said = r"is incomplete on disk \(is it full\?\)" if when == "short" else "cannot be written: System error"
    with pytest.raises(OutputError, match=rf"\.wav: {said}"), SoundWriter(path, FS, 1) as writer:
        writer.write(np.zeros((4, 1)))
    left = list(tmp_path.iterdir())
    assert len(left) == (0 if own else 1)
    assert not target.exists()
    if not own:
        path.discard()


def test_a_writer_leaves_an_error_inside_it_as_it_is(tmp_path: Path) -> None:
    """Nothing of the file is looked at then."""
    with pytest.raises(ZeroDivisionError), SoundWriter(tmp_path / "a.wav", FS, 1):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    file = AtomicFile(tmp_path / "b.wav")
    with SoundWriter(file, FS, 1) as writer:
        writer.write(np.zeros((0, 1)))
        assert (writer.peak, writer.frames) == (0.0, 0)
        writer.write(np.array([[0.0], [-0.25], [0.125], [0.0]]))
        assert (writer.peak, writer.frames) == (0.25, 4)
    assert not (tmp_path / "b.wav").exists()
    file.complete()
    assert sf.info(str(tmp_path / "b.wav")).frames == 4


def test_a_silent_render_warns() -> None:
    score = tw.Score([tw.Note(0.0, 0.05, note=45)])
    with pytest.warns(UserWarning, match=r"the sound is silent: its peak is -2\d\d dBFS"):
        tw.render(score, "monochord", FS, gain_db=-200.0, max_duration=0.02)


def test_options_inside_of_other_options_report_their_place() -> None:
    from pydantic import ValidationError

    class Outer(Parameters):
        render: RenderOptions

    with pytest.raises(ValidationError) as caught:
        Outer(render={"fs": 1})
    assert [error["loc"] for error in caught.value.errors()] == [("render", "fs")]


# live


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


# models in files


def read(path: Path) -> dict[str, np.ndarray]:
    """Arrays as docs/embedding.md describes their file."""
    out = {}
    with path.open("rb") as stream:
        assert stream.readline() == b"tonewood-arrays/1\n"
        while line := stream.readline():
            name, kind, *shape = line.decode().split()
            sizes = tuple(map(int, shape))
            out[name] = np.frombuffer(stream.read(8 * int(np.prod(sizes, dtype=int))), f"<{kind}").reshape(sizes)
    return out


def test_nested_values_are_arrays_under_their_paths(tmp_path: Path) -> None:
    value = {"a": {"b": (np.eye(2), [])}, "c": [1, 2], "d": 3.5, "e": [{"f": 7}], "g": (), "h": [0.5, 1]}
    arrays = flat(value)
    assert list(arrays) == ["a/b/0", "a/b/1", "c", "d", "e/0/f", "h"]
    assert [x.dtype.kind for x in arrays.values()] == list("fiifif")
    write_arrays(tmp_path / "a", arrays)
    back = read(tmp_path / "a")
    assert {name: x.tolist() for name, x in back.items()} == {
        "a/b/0": [[1, 0], [0, 1]], "a/b/1": [], "c": [1, 2], "d": 3.5, "e/0/f": 7, "h": [0.5, 1.0],
    }  # fmt: skip
    with pytest.raises(OutputError, match="there is no folder"):
        write_arrays(tmp_path / "nowhere" / "a", arrays)


def test_a_saved_string_is_held_where_it_is_asked_and_plucked_by_the_force(tmp_path: Path) -> None:
    """Stop 12 of the monochord is the octave; twice the force makes twice the injections."""
    found = {}
    for name, more in {"open": {}, "octave": {"stops": {"A2": 12}}, "loud": {"force": 4.0}}.items():
        save_model(tmp_path / name, "monochord", 16000, **more)  # type: ignore[arg-type]
        found[name] = read(tmp_path / name)
    assert found["open"]["fs"] == pytest.approx(16000)
    assert found["open"]["n_channels"] == 1
    plucks = [name for name in found["open"] if name.startswith("plucks/0/") and name.endswith("/2")]
    assert plucks
    for name in plucks:
        once, twice = (np.tensordot(found[of][name], found[of][f"{name[:-1]}3"], (0, 0)) for of in ("open", "loud"))
        np.testing.assert_allclose(twice, 2 * once, rtol=1e-9)
    # half of the length has half as many modes below the limit
    assert [found[name]["components/1/e"].shape[1] for name in ("open", "octave")] == [64, 32]
    for more, said in (
        ({"fs": 999.0}, "fs: is 999.0; 1000 to 1e\\+07 Hz are allowed"), ({"fs": 1.1e7}, "fs: is"),
        ({"fs": "fast"}, "fs: is 'fast'"), ({"stops": {"B": 1}}, "stops: there is no string B; there are A2"),
        ({"stops": {"A2": 25}}, "stops: A2 is 25; numbers from 0 to 24 are allowed"),
    ):  # fmt: skip
        with pytest.raises(TonewoodError, match=said):
            save_model(tmp_path / "wrong", "monochord", **{"fs": 16000, **more})  # type: ignore[arg-type]
    assert not (tmp_path / "wrong").exists()


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


def test_a_sound_is_resampled_by_as_many_taps_as_kaiser_s_formula_gives() -> None:
    """(A - 7.95) / (2.285 pi width) + 1 of 110 dB and a width of 0.05 of the doubled rate's Nyquist frequency."""
    taps = int(np.ceil((110 - 7.95) / (2.285 * np.pi * 0.05) + 1)) | 1
    impulse = np.zeros((400, 1))
    impulse[200] = 1.0
    at = np.flatnonzero(resampled(impulse, 24000, 48000))
    assert (at[0], at[-1]) == (400 - taps // 2, 400 + taps // 2)


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


# plans, accounts


def test_a_sketch_of_a_plan_watches_effects_and_switches_none(monkeypatch: pytest.MonkeyPatch) -> None:
    watching: list[tuple[int, bool]] = []

    class Seen(plan.Renderer):
        def blocks(self, block_size: int = 1024) -> Any:
            watching.append((self.fs, self.engine.only_watch))
            return super().blocks(block_size)

    monkeypatch.setattr(plan, "Renderer", Seen)
    tw.plan(tw.Score([tw.Note(0.0, 0.05, note=45)]), "monochord", 48000, max_duration=0.05, tail=0.05)
    assert watching == [(16000, True), (48000, False)]


def test_an_account_with_a_value_that_is_no_number_is_not_written(tmp_path: Path) -> None:
    trace: Any = SimpleNamespace(to_dict=lambda: {"a": float("nan")})
    with pytest.raises(ValueError, match="not JSON compliant"):
        energy.save_energy(trace, tmp_path / "e.json")
    assert list(tmp_path.iterdir()) == []


# spans of a render


class Spans:
    """A renderer at 100 Hz whose last event is at sample 5120; its sound is 0, 1, 2 ... and ends at `ends`."""

    def __init__(self, sample: int, *, late: int = 0, ends: int = 10**9, room: Any = None, **options: Any):
        self.asked, self.watched, self.given = list[int](), list[tuple[int, float]](), list[int]()
        self.engine = SimpleNamespace(state=SimpleNamespace(sample=sample), advance=self.advance)
        self._resampler, self._routing, self.late, self.ends = self, self, late, ends
        self.options = SimpleNamespace(**{"max_duration": None, "energy": False, **options})
        self.fs, self.model = 100, SimpleNamespace(fs=100.0)
        self.performance = SimpleNamespace(timeline=SimpleNamespace(stop=51.2))
        self.zero_frame, self._end, self._room, self._made = 0, "", room, 0
        self._seconds = self._peak = 0.0
        self._pending = np.zeros((0, 1))

    def advance(self, ticks: int) -> np.ndarray:
        self.asked.append(ticks)
        return np.arange(1.0 + self.engine.state.sample, 1 + self.engine.state.sample + 64 * ticks)[:, None]

    def __call__(self, sound: np.ndarray, sample: int) -> np.ndarray:
        return sound

    def frame(self, sample: int) -> int:
        return sample - self.late

    def samples(self, frames: float) -> float:
        return frames

    def scaled(self, sound: np.ndarray) -> np.ndarray:
        return sound

    finished = scaled

    def _begun(self, sound: np.ndarray, first: int) -> np.ndarray:
        self.given.append(first)
        return sound[max(0, -first) :]

    def _watch(self, sample: int, peak: float) -> None:
        self.watched.append((sample, peak))
        if sample >= self.ends:
            self._end = self._end or "decayed"

    def filled(self, frames: int) -> tuple[list[int], list[tuple[int, float]], int, str]:
        Renderer._fill(self, frames)  # type: ignore[arg-type]
        return self.asked, self.watched, len(self._pending), self._end


@pytest.mark.parametrize(
    ("frames", "spans", "given"),
    [(1, 1, {}), (512, 1, {}), (513, 2, {}), (1000, 2, {}), (10**6, 9, {}), (1000, 2, {"late": 3})],
)
def test_before_the_last_event_as_many_spans_are_stepped_as_frames_need(frames: int, spans: int, given: Any) -> None:
    """Of 512 samples, and no further than two spans before the last event."""
    one = Spans(0, **given)
    late = given.get("late", 0)
    assert one.filled(frames) == ([8 * spans], [(512 * spans, 512.0 * spans)], 512 * spans - late, "")
    assert (one.given, one._made, one._peak) == ([-late], 512 * spans - late, 512.0 * spans)
    assert one._pending[0, 0] == 1.0 + late


def test_after_the_last_event_spans_are_watched_one_by_one() -> None:
    one = Spans(4608)
    asked, watched, n, end = one.filled(1)
    assert (asked, n, end) == ([64], 8 * 512, "")
    assert watched == [(4608 + 512 * k, 4608.0 + 512 * k) for k in range(1, 9)]
    one = Spans(4608, ends=4608 + 1024)
    asked, watched, n, end = one.filled(1)
    assert (asked, len(watched), n, end) == ([64], 2, 1024, "decayed")
    assert Spans(4608, energy=True).filled(1)[:2] == ([8], [(5120, 5120.0)])
    # within the two spans before it nothing but the tail follows
    assert [Spans(sample).filled(10**6)[0] for sample in (3584, 4096, 4097)] == [[16], [8], [64]]


@pytest.mark.parametrize(("sample", "late", "zero", "spans", "n"), [
    (0, 0, 0, 1, 150), (0, 20, 0, 1, 150), (0, 20, 30, 1, 170), (0, 60, 30, 1, 180), (4608, 0, 0, 3, 1392),
])  # fmt: skip
def test_the_longest_render_is_counted_from_score_time_0(sample: int, late: int, zero: int, spans: int, n: int) -> None:
    """1.5 s, of sound that a resampler gives late frames earlier; a lead-in of 30 frames comes before."""
    one = Spans(sample, late=late, max_duration=1.5 if sample == 0 else 60.0)
    one.zero_frame = zero
    asked, watched, length, end = one.filled(10**6)
    assert (asked, length, end) == ([8 * spans], n, "maximum duration")
    assert watched[-1][0] == sample + 512 * spans
    assert one._pending[0, 0] == 1.0 + sample + max(0, late - zero)
    assert one._pending[-1, 0] == watched[-1][1]


def test_reverberation_ends_with_the_longest_render() -> None:
    """A room that adds 100 frames at the end; it is told which piece is the last."""
    told: list[bool] = []

    def add(sound: np.ndarray, *, last: bool) -> np.ndarray:
        told.append(last)
        return np.concatenate([sound, np.full((100 * last, 1), 9e9)])

    room = SimpleNamespace(add=add)
    one = Spans(4608, room=room, ends=4608 + 1024)
    one._pending = np.zeros((7, 1))
    assert one.filled(1)[2] == 7 + 1124
    assert (told, one._made, one._peak) == ([True], 1124, 9e9)
    one = Spans(0, room=room)
    assert one.filled(1)[2] == 512
    assert (told[1:], one._peak) == ([False], 512.0)
    one = Spans(4608, room=room, max_duration=60.0)
    one._made = 4608
    assert one.filled(1)[2:] == (1392, "maximum duration")
