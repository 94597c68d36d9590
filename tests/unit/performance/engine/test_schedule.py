"""What is due when, for how long a string is left alone, and the bookkeeping of an engine."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.model import string_tuning
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.engine import schedule as schedules
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.performance.engine.schedule import Schedule
from tonewood.performance.player.playing import perform
from tonewood.performance.player.timeline import Change, Timeline
from tonewood.performance.score.note import Control

FS = 16000


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), FS)


def engine(model: Model, changes: list[Change] | None = None) -> Engine:
    return Engine(model, Timeline(changes or [], []))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_entries_are_taken_once_and_in_order(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a list that is sorted anew each time, also where the oldest entries are forgotten."""
    monkeypatch.setattr(schedules, "_FORGET", 5)
    rng = random.Random(seed)
    schedule, waiting, now = Schedule(1.0, ["a", "b"]), list[Change](), 0
    for _ in range(200):
        for _ in range(rng.randrange(4)):
            change = Change(float(now + rng.randrange(40)), rng.choice("ab"))
            schedule.add([change])
            waiting.append(change)
        due = {name: [c.time for c in waiting if c.string == name and c.time >= now] for name in "ab"}
        for name, times in due.items():
            assert schedule.next_of(name, now) == min(times, default=math.inf)
        assert schedule.next_due == min((c.time for c in waiting), default=math.inf)
        assert schedule.done == (not waiting)
        now += rng.randrange(12)
        waiting.sort(key=lambda c: c.time)
        wanted = [c for c in waiting if c.time < now]
        assert schedule.copy().take(now) == (wanted, [])
        assert schedule.take(now) == (wanted, [])
        waiting = waiting[len(wanted) :]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_schedule_is_over_when_the_last_of_its_gestures_is(model: Model, order: tuple[int, int, int]) -> None:
    """Whatever is added last: the gesture of a late note, of an early one, or a change before both."""
    notes = [tw.Note(time, 0.1, string="E2", stop=0, force=2.0) for time in (0.2, 0.6)]
    early, late = (list(perform(tw.Score([note]), model).timeline.plays)[-1] for note in notes)
    schedule, parts = Schedule(1 / FS, list(model.strings)), [early, late, Change(0.4, "E2")]
    for i in order:
        part = parts[i]
        schedule.add([part], []) if isinstance(part, Change) else schedule.add([], [part])
    assert late.stop > early.stop
    assert schedule.stop == max(late.stop, 0.4)


def test_changes_that_are_added_before_anything_was_taken_are_all_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedules, "_FORGET", 4)
    schedule = Schedule(1.0, ["a"])
    for time in range(20):
        schedule.add([Change(float(time), "a")])
        assert schedule.next_of("a", 0) == 0


def test_the_time_until_a_string_changes_is_that_of_the_timeline(model: Model) -> None:
    changes = [Change(0.5, "E2", cents=10.0), Change(0.9, "A2", cents=5.0)]
    stepped = engine(model, changes)
    stepped.tail_level = -60.0
    stepped.state.sample = 20 * GRID
    now = 20 * GRID / FS
    assert stepped._until("E2") == pytest.approx(0.5 - now)
    assert stepped._until("A2") == pytest.approx(0.9 - now)
    assert stepped._until("D3") == math.inf  # the timeline is not over


@pytest.mark.parametrize(("level", "share"), [(-40.0, 0.5), (-20.0, 2.0), (-60.0, 0.0), (-80.0, 0.0)])
def test_the_time_until_silence_goes_on_as_the_sound_has_fallen(model: Model, level: float, share: float) -> None:
    """It has fallen `level` dB in 2 s since the last event: the rest up to -60 dB takes as long per dB."""
    stepped = engine(model, [Change(0.25, "E2", cents=10.0)])
    stepped.tail_level = -60.0
    stepped.advance(math.ceil(0.25 * FS / GRID) + 1)
    since = stepped.state.sample / FS - 0.25
    # quiet in its unit, and silent at a second place
    stepped.peak = np.array([0.03, 0.0, 0.05])[: len(stepped.peak)] if len(stepped.peak) > 1 else np.array([0.03])
    stepped.recent = stepped.peak * 10 ** (level / 20)
    assert stepped._until("E2") == pytest.approx(since * share, abs=1e-9)
    stepped.recent = np.zeros_like(stepped.peak)
    assert stepped._until("E2") == 0.0
    for factor in (1.0, 1.05, 2.0):  # as loud as ever, or louder: nothing has decayed
        stepped.recent = factor * stepped.peak
        assert stepped._until("E2") == math.inf
    stepped.recent, stepped.tail_level = 0.01 * stepped.peak, -math.inf
    assert stepped._until("E2") == math.inf


def test_an_engine_is_done_when_its_last_gesture_is_over(model: Model) -> None:
    score = tw.Score([tw.Note(0.0, 0.1, string="E2", stop=0, force=2.0)])
    stepped = Engine(model, perform(score, model).timeline)
    assert not stepped.done
    over = max(play.stop for play in stepped.timeline.plays)
    last = max([over, *(change.time for change in stepped.timeline.changes)])
    while stepped.state.sample < last * FS:
        assert not stepped.done
        stepped.advance(1)
    stepped.advance(1)
    assert stepped.done
    held = engine(model)
    assert held.done
    held.gestures.active = [object()]  # type: ignore[list-item]
    assert not held.done


def test_no_string_is_tuned_while_an_engine_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensions of stops, and the tension that a bend needs, are computed before the first sample."""
    notes = [tw.Note(0.0, 0.1, string="G3", stop=2, force=2.0), tw.Note(0.05, 0.1, string="A2", stop=5, force=2.0)]
    score = tw.Score(notes, controls=[Control(0.02, "bend", 60.0)])
    renderer = tw.Renderer(score, tw.load_instrument("steel_guitar"), FS, max_duration=0.15)
    assert renderer.performance.timeline.bent == {"G3": {2.0}, "A2": {5.0}}
    for search in ("tune", "held_freq"):
        monkeypatch.setattr(string_tuning, search, None)
    assert sum(len(block) for block in renderer.blocks()) == round(0.15 * FS)
    assert {renderer.engine.frettings[name].cents for name in ("G3", "A2")} == {60.0}


def test_an_engine_keeps_no_account_and_switches_effects_unless_asked(model: Model) -> None:
    stepped = engine(model)
    assert stepped.energy_budget is None
    assert stepped.only_watch is False
    assert Engine(model, Timeline([], []), energy=True).energy_budget is not None
    steel = tw.Renderer(tw.Score([tw.Note(0.0, 0.1, note=52, force=4.0)]), tw.load_instrument("steel_strings"), FS)
    for name, switching in steel.engine.switchings.items():
        assert steel.engine.running(name) == switching.on
    assert any(isinstance(steel.engine.running(name), frozenset) for name in steel.engine.switchings)
