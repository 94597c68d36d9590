"""Points at which an engine stops, what it takes there, and the forces of gestures in progress, by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.contract.attached import Motion
from tonewood.instrument.contract.gestures import Gesture, Hold
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects.base import Switching, Watched
from tonewood.performance.engine import engine as engines
from tonewood.performance.engine import schedule as schedules
from tonewood.performance.engine import trial
from tonewood.performance.engine.energy_budget import EnergyBudget
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.performance.engine.in_progress import GesturesInProgress
from tonewood.performance.engine.schedule import Schedule
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.gestures import Active, forces, places
from tonewood.performance.player.timeline import Change, Play, Timeline
from tonewood.physics.coupling.system import Injection, PrescribedMotion
from tonewood.physics.stepping.forcing import SampledForce, Segment

FS = 8000
#: 0.02 s of a rising force, 0.01 s of a falling one
PLUCK = (Segment(-0.02, 0.0, 0.0, 50.0), Segment(0.0, 0.01, 1.0, -100.0))


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(tw.load_instrument("classical_guitar").replace({"effects.mode": "all"}), FS, freq_limit=1000)


def engine(model: Model, *parts: Change | Play, **options: Any) -> Engine:
    changes = [p for p in parts if isinstance(p, Change)]
    return Engine(model, Timeline(changes, [p for p in parts if isinstance(p, Play)]), **options)


def pluck(time: float, string: str = "E2", **values: Any) -> Play:
    return Play(time, Gesture(PLUCK, **{"from_bridge": 0.1, **values}), string=string, exciter="pluck")


@pytest.mark.parametrize(
    ("start", "sample"), [(0.0, 0), (1 / FS, 0), (-1 / FS, -64), (-64 / FS, -64), (-64.5 / FS, -128), (0.5, 0)]
)
def test_an_engine_begins_at_the_point_before_its_timeline(model: Model, start: float, sample: int) -> None:
    assert engine(model, Change(start, "E2", cents=0.0)).state.sample == sample


@pytest.mark.parametrize(
    ("now", "due", "stop", "hold", "until"),
    [
        (0, math.inf, math.inf, None, 64 * GRID),  # a stop at the latest
        (GRID, math.inf, math.inf, None, 65 * GRID),
        (0, 1000.0, math.inf, None, 1000 // GRID * GRID),
        (0, 10.0, math.inf, None, GRID),  # what is due now has been done
        (0, 640.5, math.inf, None, 640),
        (0, math.inf, 200.0, None, 256),  # the point after a gesture's end
        (0, math.inf, 256.0, None, 256),
        (0, math.inf, math.inf, 100, 100),
        (0, math.inf, math.inf, 0, 64 * GRID),
        (100, math.inf, math.inf, None, 128),  # back to the grid
        (100, math.inf, math.inf, 120, 120),
    ],
)
def test_the_next_sample_at_which_an_engine_stops(
    model: Model, now: int, due: float, stop: float, hold: int | None, until: int
) -> None:
    one = engine(model)
    one.state.sample = now
    one.schedule = SimpleNamespace(next_due=due)  # type: ignore[assignment]
    holds = () if hold is None else ((hold, 1.0),)
    one.gestures.active = [Active(pluck(0.0), stop, holds)] if stop < math.inf or holds else []
    one.gestures.active = [replace(a, stop=1e9) if stop == math.inf else a for a in one.gestures.active]
    assert one._next_event() == until


def test_changes_and_gestures_are_taken_at_the_point_before_them(model: Model) -> None:
    """The last of several changes counts; a pluck moves the place, but not where it is the usual one."""
    usual = model.strings["E2"].places.pluck
    parts = [
        Change(0.0, "A2", stop=2.0),
        Change(10 / FS, "A2", stop=3.0),
        Change(63.9 / FS, "A2", cents=20.0),
        Change(64 / FS, "D3", stop=1.0),
        pluck(0.02 + 32 / FS, from_bridge=0.2, width=0.01),
        pluck(0.02, "G3", from_bridge=usual),
        Change(0.0, "B3", cents=0.0),
    ]
    one = engine(model, *parts)
    moved, fresh = one._due(0)
    assert moved == {"A2": Fretting(3.0, 20.0), "E2": Fretting(place=0.2, width=0.01)}
    assert [play.string for play in fresh] == ["G3", "E2"]
    assert one.counters.strings_played == {"E2", "G3"}
    moved, fresh = one._due(GRID)
    assert (moved, fresh) == ({"D3": Fretting(stop=1.0)}, [])


def test_counts_of_exchanges_and_samples(model: Model) -> None:
    one = engine(model, Change(0.0, "A2", stop=2.0), Change(0.1, "A2", stop=2.0), Change(0.2, "A2", stop=4.0))
    assert one.advance(0).shape == (0, len(model.system.readouts))
    out = one.advance(30)
    assert out.shape == (30 * GRID, len(model.system.readouts))
    assert (one.state.sample, one.counters.exchanges, one.usage.samples) == (30 * GRID, 2, 30 * GRID)
    assert one.frettings["A2"] == Fretting(stop=4.0)
    assert one._modes == sum(compiled.basis.n_modes for compiled in one.system.compiled)


def test_a_snapshot_keeps_all_that_moves_and_continues_bit_for_bit(model: Model) -> None:
    parts = [pluck(0.02), Change(0.05, "E2", added_damping=20.0), pluck(0.09, "A2"), Change(0.06, "A2", stop=3.0)]
    one = engine(model, *parts)
    one.advance(5)
    kept = one.snapshot()
    sample, n_active = kept.state.sample, len(kept.gestures.active)
    rest = one.advance(10)
    assert (kept.state.sample, len(kept.gestures.active)) == (sample, n_active)
    other = engine(model, *parts)
    other.restore(kept)
    np.testing.assert_array_equal(other.advance(10), rest)
    one.restore(kept)
    np.testing.assert_array_equal(one.advance(10), rest)
    assert np.abs(rest).max() > 0.0
    # another timeline begins where the copy was taken: what was due before is not done again
    third = engine(model, pluck(0.02), pluck(0.2, "D3"))
    third.restore(kept)
    third.follow_timeline()
    assert third.schedule.next_due == pytest.approx(0.18 * FS)


def test_a_new_gesture_ends_the_one_before_on_its_string(model: Model) -> None:
    system, progress = model.system, GesturesInProgress()
    first, second, other = pluck(0.02), pluck(0.025), pluck(0.02, "A2")
    progress.begin([first, other], (), model, system, 0, dampers=True)
    assert progress.strings == {"E2", "A2"}
    assert [a.stop for a in progress.active] == [0.03 * FS] * 2
    lengths = {i.component: i.stop for i in progress.injections}
    assert max(lengths.values()) >= 0.03 * FS
    copy = progress.copy()
    progress.begin([second], (), model, system, 64, dampers=True)
    assert {(a.play.string, a.play.time) for a in progress.active} == {("E2", 0.025), ("A2", 0.02)}
    assert {i.stop for i in progress.injections if i.component.startswith("E2") and i.start < 64} <= {64}
    assert copy.strings == {"E2", "A2"}
    assert {a.play.time for a in copy.active} == {0.02}
    n = len(progress.injections)
    progress.end(10**6)
    assert (progress.injections, progress.controls, n > 0) == ([], [], True)


def test_a_gesture_goes_on_in_new_modes_where_its_string_is_held_otherwise(model: Model) -> None:
    """Its force is compiled anew from now on, that of the other string is left as it was."""
    system, progress = model.system, GesturesInProgress()
    progress.begin([pluck(0.02), pluck(0.02, "A2")], (), model, system, 0, dampers=False)
    before = {id(i) for i in progress.injections if i.component.startswith("A2")}
    progress.begin([], ("E2",), model, system, 64, dampers=False)
    assert {id(i) for i in progress.injections if i.component.startswith("A2")} == before
    assert all(i.stop <= 64 or i.start >= 64 for i in progress.injections if i.component.startswith("E2"))
    assert {i.start for i in progress.injections if i.component.startswith("E2") and i.stop > 64} == {64}
    assert len(progress.active) == 2
    assert progress.active[0].holds == ()


@pytest.mark.parametrize(("dampers", "n"), [(True, 4), (False, 0)])
def test_fingers_hold_strings_where_these_are_damped(model: Model, dampers: bool, n: int) -> None:
    progress = GesturesInProgress()
    held = pluck(0.02, hold=Hold(-0.02, -0.01, 0.0, 2.0))
    progress.begin([held], (), model, model.system, 0, dampers=dampers)
    assert len(progress.active[0].holds) == n


def test_what_is_over_is_forgotten() -> None:
    values = np.ones((1, 10))
    injections = [Injection("c", start, np.ones((1, 2)), values) for start in (0, 5)]
    controls = [PrescribedMotion("k", start, velocity=np.ones(10)) for start in (0, 5)]
    progress = GesturesInProgress(injections=list(injections), controls=list(controls))
    progress.end(10)
    assert (progress.injections, progress.controls) == (injections[1:], controls[1:])


def test_places_of_a_gesture_s_force(model: Model) -> None:
    """cos and sin of its angle on the planes of a string; inputs and points of the body as they are declared."""
    (z, point, a), (y, _, b) = places(pluck(0.0, angle_deg=30.0), model)
    assert (z, y, point) == ("E2.z", "E2.y", "pluck")
    tilted = model.strings["E2"].weights(30.0)
    assert (a, b) == (tilted["E2.z"], tilted["E2.y"])
    assert math.hypot(a, b) == pytest.approx(1.0)
    name = next(iter(model.inputs))
    assert places(Play(0.0, Gesture(PLUCK), at=name), model) == model.inputs[name]
    assert places(Play(0.0, Gesture(PLUCK, on=name), string="E2"), model) == model.inputs[name]


def test_noise_and_segments_add_up(model: Model) -> None:
    noise = SampledForce(-0.005, 1 / 4000, np.sin(np.arange(60)))
    both, alone, parts = (
        forces(Play(0.03, Gesture(s, 0.1, noise=x), string="E2"), model, model.system, 0)
        for s, x in ((PLUCK, noise), ((), noise), (PLUCK, None))
    )
    assert {i.component for i in both} == {i.component for i in alone} == {i.component for i in parts}

    def moved(injections: list[Injection]) -> np.ndarray:
        stepped = engine(model)
        stepped.gestures.injections = injections
        stepped.schedule = Schedule(stepped.dt, model.strings)
        return stepped.advance(6)

    np.testing.assert_allclose(
        moved(both), moved(alone) + moved(parts), rtol=1e-6, atol=1e-9 * np.abs(moved(both)).max()
    )


@pytest.mark.parametrize(
    ("gesture", "said"),
    [
        (Gesture(PLUCK, on="nowhere"), "gesture: on names 'nowhere'; there are "),
        (Gesture((), motions=(Motion("k", "offset", PLUCK),)), "gesture: motions names 'k'; there are "),
        (Gesture((), touches={"p": PLUCK}), "gesture: touches names 'p'; there are "),
    ],
)
def test_names_that_nothing_has_attached_are_refused(model: Model, gesture: Gesture, said: str) -> None:
    with pytest.raises(BundleError, match=said) as caught:
        forces(Play(0.0, gesture, string="E2", exciter="pluck"), model, model.system, 0)
    assert caught.value.key == model.exciters["pluck"].key
    with pytest.raises(BundleError) as caught:
        forces(Play(0.0, gesture, string="E2", exciter="gone"), model, model.system, 0)
    assert caught.value.key == "exciters.gone"


def test_an_energy_budget_knows_the_forces_of_gestures(model: Model) -> None:
    budget = EnergyBudget(model.system, model.system.start(), model)
    noise = SampledForce(0.0, 1e-4, np.ones(3))
    known = budget._known(Active(Play(0.5, Gesture(PLUCK, 0.1, noise=noise), string="E2"), 9.0))
    assert [(k.component, k.point) for k in known] == [("E2.z", "pluck")] * 2 + [("E2.y", "pluck")] * 2
    assert {k.label for k in known} == {"E2 played"}
    assert {k.time for k in known} == {0.5}
    (tap, *_) = budget._known(Active(Play(0.0, Gesture(PLUCK), at=next(iter(model.inputs))), 9.0))
    assert tap.label == f"{next(iter(model.inputs))} played"


def test_a_change_without_a_time_left_is_due_at_once() -> None:
    schedule = Schedule(0.5, ["a"])
    schedule.add(
        [Change(1.0, "a")], [Play(3.0, Gesture((Segment(-1.0, 2.0, 1.0),)), string="a"), Play(9.0, Gesture(()))]
    )
    assert (schedule.next_due, schedule.stop) == (2.0, 9.0)
    assert schedule.next_of("a", 3) == 4.0
    assert schedule.take(2) == ([], [])
    assert schedule.take(5)[0] == [Change(1.0, "a")]
    assert not schedule.done
    schedule.take(19)
    assert schedule.done


def test_an_engine_keeps_no_energy_budget_unasked(model: Model) -> None:
    assert engine(model).energy_budget is None
    assert engine(model, energy=True).energy_budget is not None


def test_what_was_taken_is_forgotten_in_bulk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not one by one, each of which moves all that are left; and not never."""
    monkeypatch.setattr(schedules, "_FORGET", 5)
    line = schedules._Line[int]()
    for i in range(20):
        line.add(float(i), i)
    kept = []
    for until in range(1, 13):
        assert line.take(until) == [until - 1]
        kept.append(len(line._entries))
    assert kept == [20] * 5 + [14] * 6 + [8]
    assert (line.next_due, line.copy()._entries) == (12.0, list(range(12, 20)))


class Wanted:
    """A switched effect without any cost, wanted where it is told to be."""

    name, components = "wanted", ("a", "b")

    def __init__(self) -> None:
        self.watched: Watched | None = None
        self.done: list[object] = []

    def watch(self, moment: object, before: Switching) -> Watched | None:
        return self.watched

    def cost(self, moment: object, component: str, on: bool) -> float:
        return 0.0

    def reset(self, system: object, state: object, components: frozenset[str]) -> None:
        self.done.append(("reset", sorted(components)))

    def apply(self, system: object, on: frozenset[str], frettings: object) -> object:
        self.done.append(("apply", sorted(on)))
        return system

    def wants(self, *components: str, until: int = 0) -> None:
        self.watched = Watched(frozenset(components), (), dict.fromkeys(components, until))


def test_an_effect_is_exchanged_where_its_switch_moves_and_only_there(model: Model) -> None:
    one, effect = engine(model), Wanted()
    one._watched, one.switchings["wanted"] = [effect], Switching(frozenset("a"))  # type: ignore[list-item]

    def switched() -> list[object]:
        effect.done.clear()
        one._switch((), ())
        return effect.done

    assert switched() == []  # nothing was watched
    assert one.switchings["wanted"] == Switching(frozenset("a"))
    effect.wants("a", until=7)
    assert switched() == []  # it is on already
    assert one.switchings["wanted"] == Switching(frozenset("a"), until={"a": 7})
    effect.wants("b", until=9)
    assert switched() == [("reset", ["a", "b"]), ("apply", ["b"])]
    assert one.switchings["wanted"] == Switching(frozenset("b"), until={"b": 9})
    effect.wants("a", "b")
    assert switched() == [("reset", ["a"]), ("apply", ["a", "b"])]
    one.only_watch = True
    effect.wants("b", until=3)
    assert switched() == []
    assert one.switchings["wanted"] == Switching(frozenset("b"), until={"b": 3})


@pytest.mark.parametrize(
    ("change", "done"),
    [(Fretting(stop=2.0), ["effects", "velocities"]), (Fretting(cents=20.0), []), (Fretting(added_damping=9.0), [])],
)
def test_a_new_stop_takes_effects_and_joined_velocities_along(
    model: Model, change: Fretting, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bend or a damper does not: laws stay, and velocities with them; the motion of the string is carried."""
    one, seen = engine(model, pluck(0.02)), list[str]()
    one.advance(8)
    before = {c: one.system.modes_of(one.state, c).copy() for c in model.strings["A2"].components}
    monkeypatch.setattr(one, "_with_effects", lambda system: seen.append("effects") or system)
    monkeypatch.setattr(engines, "share_velocities", lambda system, state: seen.append("velocities"))
    exchanges = one.counters.exchanges
    one._refret({"A2": change})
    assert seen == done
    assert one.frettings["A2"] == change
    assert one.counters.exchanges == exchanges + 1
    if not done:  # the same modes go on
        for component, modes in before.items():
            np.testing.assert_allclose(one.system.modes_of(one.state, component)[0], modes[0], rtol=0.05, atol=1e-9)


def test_every_gesture_of_an_instrument_is_tried_once(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """One after another on the strings, 5 ms apart where they share one; eight points of the grid after the last."""
    made, compared = list[Engine](), list[str]()

    def kept(*given: Any) -> Engine:
        made.append(Engine(*given))
        return made[-1]

    monkeypatch.setattr(trial, "Engine", kept)
    monkeypatch.setattr(trial, "_same_connections", lambda string: compared.append(string.name))
    trial.try_parts(model)
    (one,) = made
    assert compared == [name for name in model.groups if model.strings[name].n_stops]
    n = len(model.groups)
    exciters = list(model.exciters)
    assert one.counters.strings_played == {list(model.groups)[i % n] for i in range(len(exciters))}
    last = 0.005 * ((len(exciters) - 1) // n) * FS
    assert 0 <= one.state.sample - (last + 8 * GRID) < GRID
    trial.try_parts(SimpleNamespace(groups={}, exciters=model.exciters))  # type: ignore[arg-type]
    assert len(made) == 1
