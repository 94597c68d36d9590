"""The sums of a plan, of renders that are none: seconds and blocks by hand."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

import tonewood as tw
from tonewood.performance.player.timeline import Change
from tonewood.performance.score.note import Control
from tonewood.sound.render import plan as plan_module
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.plan import plan, seconds_per_bend

CHANGES = [Change(t, "A", cents=1.0) for t in (0.0, 0.1, 0.2, 2.9)]


class Render:
    """A render whose blocks take 0.1 and 0.05 s, those of a sketch a fifth; it ends after `length` s."""

    made: ClassVar[list[Render]] = []
    length, end = 2.88, "decayed"

    def __init__(self, score: tw.Score, instrument: Any, *, options: RenderOptions, model: Any = None):
        self.score, self.options, self.given = score, options, model
        self.fs, self.zero_frame, self.time, self.n = options.fs, 2400, 0.0, 0
        self.model = SimpleNamespace(fs=float(options.fs))
        self.dropped = ("a note",)
        self.performance = SimpleNamespace(timeline=SimpleNamespace(changes=CHANGES))
        self.engine = SimpleNamespace(
            counters=SimpleNamespace(stepping_s=0.0, control_s=0.0), usage=self, only_watch=False,
            effects=[SimpleNamespace(plan=lambda foreseen: [foreseen])],
        )  # fmt: skip
        self.made.append(self)

    def blocks(self, size: int) -> Iterator[int]:
        unit = 0.02 if self.engine.only_watch else 0.1
        while self.time + size / self.fs <= self.length:
            self.n, self.time = self.n + 1, (self.n + 1) * size / self.fs
            self.engine.counters.stepping_s, self.engine.counters.control_s = unit * self.n, 0.5 * unit * self.n
            yield self.n

    def summary(self) -> Any:
        return SimpleNamespace(duration_s=self.time, end=self.end)


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Points by which the engine is warmed."""
    warmed: list[Any] = []
    engine = SimpleNamespace(model=SimpleNamespace(fs=16000.0), advance=warmed.append)
    Render.made.clear()
    monkeypatch.setattr(plan_module, "Renderer", Render)
    monkeypatch.setattr(plan_module, "as_instrument", lambda name: SimpleNamespace(spec=None))
    monkeypatch.setattr(plan_module, "assembled", lambda instrument, options: None)
    monkeypatch.setattr(plan_module, "Engine", lambda model, timeline: engine)
    monkeypatch.setattr(plan_module, "_switched_rates", lambda engine: {})
    monkeypatch.setattr(
        plan_module, "_computing",
        lambda rates, usage: {("e", "A"): 0.2, ("e", "B"): 0.1} if usage.engine.only_watch else {("e", "A"): 0.5},
    )  # fmt: skip
    monkeypatch.setattr(plan_module, "seconds_per_bend", lambda model, bends: 0.01)
    monkeypatch.setattr(plan_module.time, "thread_time", lambda: 7.0)
    return warmed


def score() -> tw.Score:
    moves = [Control(0.5, "bend", 1.0), Control(0.5, "cc1", 1.0)]
    return tw.Score([tw.Note(t, 0.5, note=45) for t in (0.0, 1.0, 2.0, 6.0)], moves)


@pytest.mark.parametrize(("fs", "low"), [(48000, 16000), (36000, 12000), (24000, 12000), (8000, 8000)])
def test_a_sketch_is_made_at_a_third_of_the_rate_and_12_khz_at_least(stubs: list[Any], fs: int, low: int) -> None:
    plan(score(), "x", fs, accuracy="draft", oversampling=2.0, freq_limit=5000.0, room="hall")
    full, sketch = (made.options for made in Render.made)
    assert (full.fs, full.accuracy, full.oversampling, full.freq_limit, full.room) == (fs, "draft", 2.0, 5000.0, None)
    assert (sketch.fs, sketch.accuracy, sketch.oversampling, sketch.freq_limit) == (low, "standard", None, None)
    assert sketch.max_duration is None


def test_a_score_that_was_sketched_to_its_end(stubs: list[Any]) -> None:
    """90 blocks of 32 ms; the first 31 are within a second. 47 of the whole render, of 21.3 ms, are a second."""
    told: list[float] = []
    found = plan(score(), "x", progress=told.append)
    assert (found.duration_s, found.sketched_s, found.notes_dropped) == (2.88, 2.88, ("a note",))
    assert told == pytest.approx([0.032 * n for n in range(1, 91)])
    full, sketch = Render.made
    assert (full.n, sketch.n, full.engine.only_watch) == (47, 90, False)
    assert found.timed_s == full.time
    assert stubs == [250]  # a second of 16 kHz in points of 64
    # without the switched effect 4.2 s, which take 0.62 in the sketch; three times as many samples
    switched = 3 * 0.3
    assert found.predicted_s == pytest.approx((4.7 - 0.5) / 0.62 * 1.8 + 2.35 / 0.31 * 0.9 + switched)
    (foreseen,) = found.effects
    found_by_sketch: Any = foreseen  # what its effect was given
    assert (found_by_sketch.usage, found_by_sketch.seconds) == (sketch, 2.88)
    assert found_by_sketch.computing == pytest.approx({("e", "A"): 0.6, ("e", "B"): 0.3})
    assert (found.bends, found.bends_s) == (0, 0.0)


def test_a_score_of_which_the_beginning_was_sketched(stubs: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The processor's time is over at the third block after the first second; bends are counted apart."""
    clock = itertools.chain([0.0, 2.9, 3.0, 3.1], itertools.repeat(9.0))
    monkeypatch.setattr(plan_module.time, "thread_time", lambda: next(clock))
    monkeypatch.setattr(plan_module, "_MANY_BENDS", 3)
    monkeypatch.setattr(Render, "end", "not ended")
    found = plan(score(), "x", tail=1.5)
    first, full, _ = Render.made
    assert [[c.kind for c in made.score.controls] for made in Render.made] == [["bend", "cc1"], ["cc1"], ["cc1"]]
    assert full.given is first.model
    assert found.sketched_s == pytest.approx(34 * 0.032)
    # the last note ends at 6.5 s, 1.5 s of tail and a lead-in of 50 ms
    assert found.duration_s == pytest.approx(8.05)
    # of the points at 0, 0.1, 0.2 and 2.9 s three are in the part that was played through
    more = 8.05 / (34 * 0.032)
    assert (found.bends, found.bends_s) == (3, pytest.approx(0.03))
    steps, control = 4.2 / 0.62 * 0.02 * 34 * more, 2.35 / 0.31 * 0.01 * 34 * 4 / 2  # two of four notes were played
    assert found.predicted_s == pytest.approx(steps + control + more * (0.9 + 0.03))
    Render.made.clear()
    monkeypatch.setattr(plan_module, "_MANY_BENDS", 4)
    assert plan(score(), "x", max_duration=1.2).bends == 0
    assert len(Render.made) == 2


@pytest.mark.parametrize(("longest", "duration", "points"), [(7.0, 7.0, 250), (0.5, 1.024, 125)])
def test_a_plan_ends_with_the_longest_render(
    longest: float, duration: float, points: int, stubs: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Never below what was sketched; of 0.5 s no more is warmed."""
    monkeypatch.setattr(Render, "end", "not ended")
    monkeypatch.setattr(Render, "length", 1.03)
    assert plan(score(), "x", tail=1.5, max_duration=longest).duration_s == pytest.approx(duration)
    assert stubs == [points]


def test_a_long_score_is_sketched_to_its_first_note_that_is_left_out(
    stubs: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "_MOST_NOTES", 2)
    found = plan(score(), "x", tail=1.0)
    full, sketch = Render.made
    assert [made.options.max_duration for made in (full, sketch)] == [None, 2.0]
    assert [n.time for n in sketch.score.notes] == [0.0, 1.0]
    assert found.duration_s == pytest.approx(7.55)
    assert plan(score(), "x", max_duration=1.9).duration_s == 2.88
    assert Render.made[-1].options.max_duration == 1.9


def test_time_of_bends_is_that_of_points_one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first 40 points, each at a point of its own; their mean."""
    done: list[Any] = []

    class Engine:
        counters = SimpleNamespace(control_s=0.8)

        def __init__(self, model: Any, timeline: Any):
            done.append([(round(c.time * 100, 6), c.cents) for c in timeline.changes])

        def advance(self, points: int) -> None:
            done.append(points)

    monkeypatch.setattr(plan_module, "Engine", Engine)
    model: Any = SimpleNamespace(fs=6400.0)
    bends = {5 * i: [Change(9.0, "A", cents=float(i))] * (2 if i == 1 else 1) for i in range(50)}
    assert seconds_per_bend(model, bends) == pytest.approx(0.8 / 40)
    assert done == [[(0.0, 0.0), (1.0, 1.0), (1.0, 1.0), *((float(i), float(i)) for i in range(2, 40))], 40]
    assert seconds_per_bend(model, {0: bends[0], 3: bends[5]}) == pytest.approx(0.4)
