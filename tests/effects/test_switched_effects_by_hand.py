"""Energies, switches and rising tension of effects, by values worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from effect_scenes import FS, moment, tension_effect
from effects_by_hand import replace_moment, shaken

from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects import tension
from tonewood.performance.effects.base import (
    Moment,
    PlannedEffect,
    Switching,
    in_decibels,
    next_multiple,
)
from tonewood.performance.effects.costs import Costs
from tonewood.performance.effects.gesture_connections import GestureConnections, holds_at, with_laws
from tonewood.performance.effects.string_energies import StringEnergies
from tonewood.performance.effects.switching import clear_memory, free_velocity, motion, pay
from tonewood.performance.effects.tension_bounds import largest
from tonewood.performance.effects.usage import Bound, EffectUsage, Spans
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.gestures import Active
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.connections import Rigid, SpringDashpot
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.forcing import Segment

# -- energies and switches ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("piece", "most"),
    [
        (Segment(1.0, 2.0, -3.0), 3.0), (Segment(1.0, 2.0, 1.0, -4.0), 3.0), (Segment(0.0, 2.0, 0.0, 4.0, -2.0), 2.0),
        (Segment(0.0, 2.0, 1.0, -4.0, 2.0), 1.0), (Segment(0.0, 0.5, 0.0, 4.0, -2.0), 1.5),
        (Segment(3.0, 5.0, 0.5, 4.0, -2.0), 2.5), (Segment(0.0, 2.0, 0.0, -4.0, -2.0), 16.0),
    ],
)  # fmt: skip
def test_the_largest_force_of_a_parabola_is_at_an_end_or_its_turning_point(piece: Segment, most: float) -> None:
    assert largest(piece) == pytest.approx(most)


def test_bounds_and_spans_add_up() -> None:
    assert Bound(1.0, 4.0).larger(Bound(2.0, 3.0)) == Bound(2.0, 4.0)
    assert (Bound().cents, Bound().level) == (0.0, 0.0)
    spans = Spans()
    for start, n in ((0, 64), (64, 64), (256, 64), (321, 3)):
        spans.add(start, n)
    assert (spans.samples, spans.all) == (195, [(0, 128), (256, 320), (321, 324)])
    assert [next_multiple(s, 4) for s in (-1, 0, 255, 256, 257)] == [0, 256, 256, 512, 512]
    assert [in_decibels(x) for x in (1.0, 0.1, 0.0)] == pytest.approx([0.0, -20.0, -400.0])
    assert PlannedEffect("a", "b", ((0.0, 1.0), (2.0, 2.5)), "", None).seconds == 1.5


def test_usage_counts_samples_by_effect_and_component() -> None:
    usage = EffectUsage(100.0, {"a": {"x": 3.0, "y": 5.0}}, {"a": 2.0, "b": 9.0})
    usage.count(-100, 100, {"a": {"x"}, "b": ()}, 10, 0.5)
    usage.count(0, 200, {"a": {"x", "y"}, "b": {"z"}}, 10, 1.0)
    usage.count(200, 100, {"a": ()}, 10, 0.3)
    assert usage.samples == 400
    assert dict(usage.running) == {"a": 300, "b": 200}
    assert {key: spans.samples for key, spans in usage.spans.items()} == {
        ("a", "x"): 300,
        ("a", "y"): 200,
        ("b", "z"): 200,
    }
    assert usage.seconds(250) == 2.5
    assert usage.score_time(usage.spans["a", "x"]) == ((0.0, 2.0),)
    assert usage.score_time(Spans(0, [(-50, 0), (100, 150)])) == ((1.0, 1.5),)
    assert usage.costs.declared == {"a": 2.0}
    usage.forget_times()
    usage.spans["a", "x"].add(300, 10)
    assert usage.spans["a", "x"].all == [(-100, 200), (300, 310)]
    usage.forget_times()
    assert (usage.spans["a", "x"].all, usage.spans["a", "x"].samples) == ([(300, 310)], 310)
    usage.enter("a", [("x", Bound(1.0, 0.1), True), ("x", Bound(0.5, 0.2), False), ("y", Bound(2.0), False)])
    assert usage.left_out == {("a", "x"): Bound(1.0, 0.1)}
    assert usage.largest == {("a", "x"): Bound(1.0, 0.2), ("a", "y"): Bound(2.0, 0.0)}


def test_time_saved_is_that_of_the_samples_without() -> None:
    """Load times rate of the component's own, and its share by load of what running at all costs."""
    usage = EffectUsage(100.0, {"a": {"x": 3.0, "y": 1.0}}, {"a": 2.0})
    usage.count(0, 300, {"a": {"x"}}, 10, 0.5)
    usage.count(300, 700, {"a": ()}, 10, 0.5)
    rates = SimpleNamespace(mode=1e-3, running={"a": 0.4}, load={"a": 0.01})
    usage.costs.rates = lambda: rates  # type: ignore[assignment, method-assign, return-value]
    assert usage.saved("a", "x") == pytest.approx(3.0 * (700 * 0.01 + 700 * 0.4 / 4.0))
    assert usage.saved("a", "y") == pytest.approx(1.0 * (1000 * 0.01 + 700 * 0.4 / 4.0))
    assert usage.saved_as_declared(5.0) == pytest.approx(1000 * 5.0 * 1e-3)
    assert Costs({}).rates().mode == 0.0


def test_a_switch_is_paid_from_velocities_that_the_bridge_does_not_see(model: Model) -> None:
    """The kinetic energy falls by the cost; positions and joined velocities stay; more than a half is refused."""
    effect, system = tension_effect(model), model.system
    state = shaken(model, 1)
    free = {}
    for name in effect.payers("E4"):
        basis = system.compiled[system.slot(name)].basis
        rows = [basis.right[basis.index(t.point)].real for c in system.connections if isinstance(c.law, Rigid)
                for t in c.terms if t.component == name]  # fmt: skip
        v = motion(system, state, name)[1]
        A = np.stack(rows).T
        free[name] = v - A @ np.linalg.lstsq(A, v, rcond=None)[0]
        np.testing.assert_allclose(
            free_velocity(system, name, basis, v), free[name], rtol=1e-9, atol=1e-9 * abs(v).max()
        )
    kinetic = sum(0.5 * f @ f for f in free.values())
    for share, paid in ((0.499, True), (0.501, False), (0.0, True), (-1.0, True)):
        after = state.copy()
        effect_ = SimpleNamespace(cost=lambda *_, share=share: share * kinetic, payers=effect.payers)
        assert pay(effect_, moment(system, after), "E4", True) is paid  # type: ignore[arg-type]
        energies = [0.0, 0.0]
        for name in effect.payers("E4"):
            (q0, v0), (q1, v1) = (motion(system, s, name) for s in (state, after))
            np.testing.assert_allclose(q1, q0, rtol=1e-9, atol=1e-12 * abs(q0).max())
            energies = [e + 0.5 * v @ v for e, v in zip(energies, (v0, v1), strict=True)]
            basis = system.compiled[system.slot(name)].basis
            end = basis.right[basis.index("bridge")].real
            assert end @ v1 == pytest.approx(end @ v0, rel=1e-9)
        lost = share * kinetic if paid and share > 0.0 else 0.0
        assert energies[0] - energies[1] == pytest.approx(lost, rel=1e-6, abs=1e-9 * kinetic)


def test_memory_of_the_named_potentials_alone_is_cleared(model: Model) -> None:
    state = model.system.start()
    state.potentials[:] = 1.0
    clear_memory(model.system, state, {"E4"})
    cleared = {p.name: bool(np.all(state.potentials[m] == 0.0))
               for p, m in zip(model.system.potentials, model.system.potentials.memory, strict=True)}  # fmt: skip
    kept = {p.name: bool(np.all(state.potentials[m] == 1.0))
            for p, m in zip(model.system.potentials, model.system.potentials.memory, strict=True)}  # fmt: skip
    assert (cleared["E4"], kept["B3"]) == (True, True)


# -- rising tension ----------------------------------------------------------------------------------------------------


def test_energies_of_strings_are_those_of_their_modes(model: Model) -> None:
    system, state = model.system, shaken(model, 2)
    groups = [("E4.z", "E4.y"), ("B3.y",)]
    wanted = []
    for names in groups:
        energy = 0.0
        for name in names:
            q, v = motion(system, state, name)
            energy += 0.5 * float(v @ v + system.compiled[system.slot(name)].basis.stiffness @ (q * q))
        wanted.append(energy)
    assert StringEnergies(system, groups).at(system, state) == pytest.approx(wanted, rel=1e-9)
    whole = StringEnergies(system, [tuple(system.names)]).at(system, state)
    assert whole[0] == pytest.approx(stored_energy(system, state).modes, rel=1e-9)


def length_tension(model: Model, name: str) -> tuple[float, float, Any]:
    basis = model.system.compiled[model.system.slot(f"{name}.z")].basis
    return float(basis.metadata["length"]), float(basis.metadata["tension"]), basis  # type: ignore[arg-type]


def test_rises_of_pitch_by_the_energy_of_a_string(model: Model) -> None:
    """dT = EA E / (2 L T) in the mean; cents = 600 / ln 2 dT / T, three halves of it at most."""
    bounds, system = tension_effect(model).bounds, model.system
    law = next(p for p in system.potentials if p.name == "E4")
    length, T, _ = length_tension(model, "E4")
    energy = 1e-3
    cents = 600 / math.log(2) * law.axial_stiffness * energy / (2 * length * T**2)
    assert bounds.rise("E4", system, energy) == pytest.approx(1.5 * cents, rel=0.02)
    assert bounds.rise("E4", system, 2 * energy) == pytest.approx(2 * bounds.rise("E4", system, energy))
    per_joule = bounds.cents_per_joule(system)
    assert per_joule[list(bounds._laws).index("E4")] == pytest.approx(bounds.rise("E4", system, 1.0))
    # a force F at x draws the string by F x (L - x) / (T L): its energy is half of F times that
    x, force = 0.2, 3.0
    stored = 0.5 * force**2 * x * (length - x) / (T * length)
    drawn = bounds.rise_under_force("E4", system, Fretting(place=x), force)
    assert drawn == pytest.approx(4 / 3 * bounds.rise("E4", system, stored), rel=0.01)
    usual = min(model.strings["E4"].places.pluck, 0.9 * length)
    assert bounds.rise_under_force("E4", system, Fretting(), force) == pytest.approx(
        bounds.rise_under_force("E4", system, Fretting(place=usual), force)
    )
    rates = [system.compiled[system.slot(f"E4.{p}")].basis.damping_rate.min() for p in "zy"]
    assert bounds.damping_rate("E4", system) == min(rates)


def test_a_pluck_is_foreseen_by_amplitudes_that_add(model: Model) -> None:
    """sqrt E <= sqrt E0 + F sqrt(C / 2); nothing is known of gestures that move a mass, or have no known force."""
    bounds, system = tension_effect(model).bounds, model.system
    at = replace_moment(model, {"E4": Fretting(place=0.2)})
    length, T, _ = length_tension(model, "E4")
    C = 0.2 * (length - 0.2) / (T * length)
    play = Play(0.0, Gesture((Segment(-0.02, 0.0, 0.0, 50.0), Segment(0.0, 0.01, 1.0, -100.0)), 0.2), string="E4")
    for energy in (0.0, 1e-5, -1e-9):
        E = (math.sqrt(max(energy, 0.0)) + 1.0 * math.sqrt(C / 2)) ** 2
        bound = bounds.foreseen(play, at, energy, levels=False)
        assert bound.cents == pytest.approx(4 / 3 * bounds.rise("E4", system, E), rel=0.01)
        assert bound.level == math.inf
    soft = Play(0.0, Gesture((Segment(0.0, 0.01, 1e-3),), 0.2), string="E4")
    assert bounds.foreseen(soft, at, 0.0).level < math.inf
    unknown = math.inf, math.inf
    for gesture in (Gesture(()), replace(play.gesture, on="E4.hammer")):
        bound = bounds.foreseen(Play(0.0, gesture, string="E4"), at, 0.0)
        assert (bound.cents, bound.level) == unknown


def test_the_quietest_strings_share_the_budget(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels add up from the quietest on; one beyond its budget of cents is infinite, one at rest 0."""
    bounds = tension_effect(model).bounds
    alone = {"B3": 0.25, "E4": 0.125}
    monkeypatch.setattr(bounds, "sidebands", lambda name, *_: SimpleNamespace(level=lambda moving, peak: alone[name]))
    at = replace_moment(model, {})
    half = 0.5 * bounds.budget
    found = bounds.of_motion(at, {"B3": half, "E4": half}, ["B3", "E4"])
    assert found == {"B3": Bound(half, 0.375), "E4": Bound(half, 0.125)}
    found = bounds.of_motion(at, {"B3": 1.01 * bounds.budget, "E4": bounds.budget}, ["B3", "E4"])
    assert found == {"B3": Bound(1.01 * bounds.budget, math.inf), "E4": Bound(bounds.budget, 0.125)}
    assert bounds.of_motion(at, {"B3": 0.0, "E4": half}, ["B3", "E4"])["B3"] == Bound(0.0, 0.0)
    assert bounds.of_motion(at, {"B3": half, "E4": half}, [])["B3"] == Bound(half, 0.0)


def test_a_share_of_idle_time_by_hand(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pluck at 2 s of e^4 times 0.9 of the budget, falling at 1/s: 2 s until it is below; idle times less 0.3 s."""
    monkeypatch.setattr(tension, "SHORTEST", 0.3)
    monkeypatch.setattr(tension, "LEAST_IDLE_SHARE", 0.55)
    effect = tension_effect(model)
    monkeypatch.setattr(effect.bounds, "damping_rate", lambda name, system: 1.0)
    monkeypatch.setattr(effect.bounds, "rise_under_force", lambda name, system, held, force: force)
    monkeypatch.setattr(effect, "load", lambda name: {"B3": 1.0, "E4": 3.0}[name])
    over = math.exp(4.0) * 0.9 * effect.budget
    pluck = Play(2.0, Gesture((Segment(0.0, 0.5, math.sqrt(over)),), 0.1), string="E4")
    line = Timeline([], [pluck, Play(9.9, Gesture((Segment(0.0, 0.1, 0.0),)), at="body.x")])
    assert line.stop == 10.0
    # E4 is free until 2 s, plucked until 2.5 s, over the budget until 4.5 s; B3 is always free
    idle = 3.0 * ((2.0 - 0.3) + (10.0 - 4.5 - 0.3)) + 1.0 * (10.0 - 0.3)
    assert effect.idle_share(line) == pytest.approx(idle / 40.0)
    assert effect.watched
    effect.prepare(line)
    assert effect.watched
    short = Timeline([], [replace(pluck, time=0.0)])
    assert effect.idle_share(short) == pytest.approx((0.5 - 0.3) * 1.0 / (0.5 * 4))
    effect.prepare(short)
    assert not effect.watched
    assert effect.why(EffectUsage(1.0, {}, {}), "E4").startswith("the score leaves hardly any time")


def test_looks_at_rising_tensions(model: Model) -> None:
    effect = tension_effect(model)
    for on, pending, points in (((), (), 64), (("B3",), (), 16), (("B3", "E4"), (), 64), ((), ("B3",), 1)):
        switching = Switching(frozenset(on), frozenset(pending))
        assert effect.next_watch(100, switching) == next_multiple(100, points)
    budget = effect.budget
    found = effect.wanted({"B3": Bound(budget), "E4": Bound(0.95 * budget)}, {"E4"})
    assert found == {"E4"}
    assert effect.wanted({"B3": Bound(1.01 * budget), "E4": Bound(0.9 * budget)}, {"E4"}) == {"B3"}
    assert effect.budget_level == pytest.approx(effect.share * 10 ** (model.choice.budget_db / 20))
    usage = EffectUsage(1.0, {}, {})
    usage.enter(effect.name, [("E4", Bound(3.0), True)])
    assert effect.why(usage, "E4") == f"its tension rises by up to 3 cents; the budget is {budget:g}"
    usage.enter(effect.name, [("E4", Bound(math.inf), True)])
    assert effect.why(usage, "E4").startswith("a gesture moves it")


@pytest.mark.parametrize(
    ("cents", "level", "over"),
    [(4.0, 0.0, 4.0), (1.0, 8.0, 4.0), (0.5, 0.5, 1.0), (2.0, math.inf, 2.0), (1e30, 0.0, 1e30)],
)
def test_the_next_bound_waits_half_the_time_in_which_it_may_fall(
    model: Model, cents: float, level: float, over: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Energy falls by exp(-2 s t), sidebands with its power 3/2; at most half a second."""
    effect, at = tension_effect(model), moment(model.system, model.system.start(), 640)
    monkeypatch.setattr(effect.bounds, "damping_rate", lambda name, system: {"E4": 2.0}[name])
    bound = Bound(cents * effect.budget, level * effect.budget_level)
    rate = effect.bounds.damping_rate("E4", model.system)
    seconds = min(math.log(over) / (4 * rate), 0.5)
    assert effect.next_bound("E4", at, bound) == pytest.approx(640 + seconds * FS, abs=1.0)


def test_strings_that_rise_are_watched_by_hand(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tension, "SHORTEST", 0.3)
    effect = tension_effect(model)
    level = {"B3": 2.0 * effect.budget, "E4": 0.1 * effect.budget}
    monkeypatch.setattr(effect.bounds, "of_motion", lambda at, cents, names: {n: Bound(level[n]) for n in cents})
    none, both = Switching(), Switching(frozenset({"B3", "E4"}))
    assert effect.watch(replace_moment(model, {}, GRID), none) is None
    whole = effect.watch(replace_moment(model, {}, GRID * 64), none)
    assert whole is not None
    assert whole.wanted == {"B3"}
    assert list(whole.bounds) == [("B3", Bound(level["B3"]), False), ("E4", Bound(level["E4"]), True)]
    assert set(whole.until) == {"B3"}
    # one that a gesture acts on, or whose next one is near, stays on
    busy = effect.watch(replace_moment(model, {}, GRID * 64, busy={"E4"}), both)
    near = effect.watch(replace_moment(model, {}, GRID * 64, until=lambda name: 0.29), both)
    far = effect.watch(replace_moment(model, {}, GRID * 64, until=lambda name: 0.3), both)
    assert busy is not None
    assert far is not None
    assert (busy.wanted, near, far.wanted) == ({"B3", "E4"}, None, {"B3"})
    between = effect.watch(replace_moment(model, {}, GRID * 16), Switching(frozenset({"E4"})))
    assert between is not None
    assert between.wanted == {"B3", "E4"}
    hit = Play(0.0, Gesture((Segment(0.0, 0.01, 100.0),), 0.2), string="E4")
    fresh = effect.watch(replace_moment(model, {}, GRID, fresh=[hit]), none)
    assert fresh is not None
    assert fresh.wanted == {"E4"}
    ((name, bound, left_out),) = fresh.bounds
    assert (name, left_out) == ("E4", False)
    assert bound.cents > effect.budget


@pytest.mark.parametrize(("on", "sample", "asked"), [("B3", GRID, {"E4"}), ("", GRID, {"B3", "E4"}), ("E4", 0, None)])
def test_strings_that_are_held_otherwise_are_asked_for_unless_they_rise(
    model: Model, on: str, sample: int, asked: set[str] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect, seen = tension_effect(model), list[set[str]]()

    def of_motion(at: Moment, cents: dict[str, float], names: list[str]) -> dict[str, Bound]:
        seen.append(set(names))
        return {name: Bound(0.0) for name in names}

    monkeypatch.setattr(effect.bounds, "of_motion", of_motion)
    found = effect.watch(replace_moment(model, {}, sample, moved=["B3", "E4"]), Switching(frozenset({on} - {""})))
    assert found is not None
    assert seen == [{"B3", "E4"} if asked is None else asked]
    assert found.wanted == (set() if sample == 0 else {on} - {""})


# -- fingers -----------------------------------------------------------------------------------------------------------


def test_fingers_hold_from_their_last_step_on() -> None:
    gesture = Gesture(())
    rows = [
        Active(Play(0.0, gesture, string="a"), 99, ((10, 1.0), (20, 2.0), (30, 0.0))),
        Active(Play(0.0, gesture, string="b"), 99, ((15, 5.0),)), Active(Play(0.0, gesture), 99, ((0, 9.0),)),
    ]  # fmt: skip
    wanted = {9: {}, 10: {"a": 1.0}, 19: {"a": 1.0, "b": 5.0}, 20: {"a": 2.0, "b": 5.0}, 30: {"b": 5.0}}
    assert {now: holds_at(rows, now) for now in wanted} == wanted


def test_dashpots_of_fingers_come_and_go(model: Model) -> None:
    connections = GestureConnections(model)

    def dampings(system: System) -> dict[str, set[float]]:
        out: dict[str, set[float]] = {}
        for c in system.connections:
            if c.role == "hold" and isinstance(c.law, SpringDashpot):
                out.setdefault(c.owner, set()).add(c.law.damping)
        return out

    free = connections.with_holds(model.system, {})
    held = connections.with_holds(free, {"E4": 2.5})
    assert dampings(held) == {"B3": {0.0}, "E4": {2.5}}
    assert dampings(connections.with_holds(held, {})) == {"B3": {0.0}, "E4": {0.0}}
    assert connections.with_holds(held, {"E4": 2.5}) is held
    again = connections.with_holds(free, {"E4": 2.5})
    assert again.connections is held.connections
    (j,) = [i for i, c in enumerate(held.connections) if c.role == "hold" and c.owner == "E4"][:1]
    other = with_laws(held, [(j, SpringDashpot(damping=7.0))])
    assert other.connections[j].law == SpringDashpot(damping=7.0)
    assert with_laws(other, [(j, SpringDashpot(damping=7.0))]) is other
    assert connections.with_moved(held, []) is held
