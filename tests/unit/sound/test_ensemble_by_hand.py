"""Parts of a score on several instruments, with processes, renders and files that the test replaces."""

from __future__ import annotations

import warnings
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import DroppedNotesWarning, NothingPlayedError, OutputError, TonewoodError
from tonewood.performance.score.note import Control, Dropped
from tonewood.sound.ensemble import mix
from tonewood.sound.ensemble.mix import EnsemblePart
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Summary

FS = 8000


def summary(**more: Any) -> Summary:
    usual = {"frames": 4, "fs": FS, "duration_s": 1.0, "render_s": 1.0, "realtime_factor": 1.0, "n_modes": 1,
             "notes": 1, "notes_dropped": [], "peak_dbfs": 0.0, "end": "decayed", "warnings": ["one"]}  # fmt: skip
    return Summary(**{**usual, **more})


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
