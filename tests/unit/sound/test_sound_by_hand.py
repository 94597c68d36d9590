"""Spans of a render, sound files that fail, models in files, with neighbours that the test replaces."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.files import audio
from tonewood.sound.files.audio import SoundWriter
from tonewood.sound.level.loudness import resampled
from tonewood.sound.render import energy, plan
from tonewood.sound.render.model_file import flat, save_model, write_arrays
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer
from tonewood.support.params import Parameters
from tonewood.support.whole_files import AtomicFile

FS = 8000


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


def test_a_sound_is_resampled_by_as_many_taps_as_kaiser_s_formula_gives() -> None:
    """(A - 7.95) / (2.285 pi width) + 1 of 110 dB and a width of 0.05 of the doubled rate's Nyquist frequency."""
    taps = int(np.ceil((110 - 7.95) / (2.285 * np.pi * 0.05) + 1)) | 1
    impulse = np.zeros((400, 1))
    impulse[200] = 1.0
    at = np.flatnonzero(resampled(impulse, 24000, 48000))
    assert (at[0], at[-1]) == (400 - taps // 2, 400 + taps // 2)


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
