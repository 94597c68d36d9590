"""Bounds, payments and counts of effects recomputed with plain loops, closed forms and by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from effect_scenes import FS, duet, moment, tension_effect

import tonewood as tw
from tonewood.instrument.contract.contract_checks import WrongResultError
from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects import base, bridge_response, connections, runtime_effects, sidebands, tension
from tonewood.performance.effects.base import (
    EffectReport,
    Foreseen,
    Moment,
    PlannedEffect,
    Run,
    Switching,
    Watched,
    in_decibels,
    next_multiple,
)
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.connections import ConnectionsInReach
from tonewood.performance.effects.costs import Costs
from tonewood.performance.effects.gesture_connections import GestureConnections, holds_at, with_laws
from tonewood.performance.effects.longitudinal import LONGITUDINAL
from tonewood.performance.effects.phantom_partials import PhantomPartialsEffect
from tonewood.performance.effects.phantoms import PartialSlopes, Phantoms
from tonewood.performance.effects.sidebands import Plane, Sidebands
from tonewood.performance.effects.string_energies import StringEnergies
from tonewood.performance.effects.switching import clear_memory, free_velocity, motion, pay
from tonewood.performance.effects.tension_bounds import largest
from tonewood.performance.effects.unswitched import GESTURE_COST
from tonewood.performance.effects.usage import Bound, EffectUsage, Spans
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.gestures import Active
from tonewood.performance.player.timeline import GRID, Play, Timeline
from tonewood.physics.coupling.connections import Rigid, SpringDashpot
from tonewood.physics.coupling.laws.contact import Contact
from tonewood.physics.coupling.potentials.tension import stretch_weights
from tonewood.physics.coupling.system import State, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.stepping.forcing import Segment
from tonewood.physics.stepping.motion import to_motion


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(duet(mode="auto"), FS)


def shaken(model: Model, seed: int, size: float = 1e-6) -> State:
    """Random motion of all modes, weaker the higher they are."""
    rng, state = np.random.default_rng(seed), model.system.start()
    for name in model.system.names:
        modes = model.system.modes_of(state, name)
        modes[:] = rng.normal(size=modes.shape) * size / np.arange(1, modes.shape[1] + 1)
    return state


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


def replace_moment(model: Model, frettings: dict[str, Fretting], sample: int = 0, **more: Any) -> Moment:
    held = {name: Fretting() for name in model.strings} | frettings
    state = more.pop("state", None) or model.system.start()
    state.sample = sample
    return Moment(model.system, state, held, np.ones(len(model.system.readouts)), **more)


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


def test_a_wrong_result_names_the_plugin_that_declares_the_effect() -> None:
    declared = SimpleNamespace(files=SimpleNamespace(manifest="a/plugin.toml"), key="strings.a")
    effect = SimpleNamespace(effect=SimpleNamespace(name="buzz"), plugins={"a": declared, "b": None})
    fault = base._fault(effect, "is wrong")
    assert (fault.reason, str(fault.file), fault.key) == ("effect 'buzz': is wrong", "a/plugin.toml", "strings.a")
    alone = base._fault(SimpleNamespace(plugins={}), "is wrong")
    assert (alone.reason, alone.file, alone.key) == ("is wrong", None, None)


def hand_phantoms() -> Phantoms:
    rng = np.random.default_rng(3)
    parts = {name: PartialSlopes(rng.normal(size=(3, 4)), rng.normal(size=(3, 4))) for name in ("a", "b")}
    return Phantoms(parts, rng.uniform(size=(2, 3, 3)), rng.uniform(size=(3, 3)))


def test_slopes_levels_and_cents_of_phantom_partials_by_loops() -> None:
    found, rng = hand_phantoms(), np.random.default_rng(4)
    moving = {name: (rng.normal(size=4), rng.normal(size=4)) for name in ("a", "b")}
    wanted = []
    for i in range(3):
        total = 0.0
        for name, (q, v) in moving.items():
            d = sum(found.parts[name].displaced[i, k] * q[k] for k in range(4))
            m = sum(found.parts[name].moving[i, k] * v[k] for k in range(4))
            total += d * d + m * m
        wanted.append(math.sqrt(total))
    slopes = found.slopes(moving)
    assert slopes == pytest.approx(wanted)
    pairs = list(itertools.product(range(3), repeat=2))
    levels = [sum(found.heard[r, i, j] * slopes[i] * slopes[j] for i, j in pairs) for r in range(2)]
    assert found.level(slopes, np.array([1.0, 1e9])) == pytest.approx(levels[0])
    assert found.level(slopes, np.array([2.0 * levels[0], 4.0 * levels[1]])) == pytest.approx(0.5)
    assert found.cents(slopes) == pytest.approx(sum(found.detuning[i, j] * slopes[i] * slopes[j] for i, j in pairs))
    assert found.parts["a"].first(2).displaced.shape == (2, 4)


def test_phantom_bounds_are_sums_over_pairs_of_partials_and_axial_modes() -> None:
    """The module's formulas, pair by pair, with the products cos i cos j = (cos(i + j) + cos(i - j)) / 2."""
    high = {"connections.frets.action_first": 3e-3, "connections.frets.action_twelfth": 6e-3}
    changes = {"strings.B3.plugin": "geometric_string", **high}
    model = assemble(duet(mode="all").replace(changes), FS)
    system, response = model.system, BridgeResponse(model)
    law = system.potentials[0]
    compiled = {name: system.compiled[system.slot(name)] for name in law.components}
    T = model.strings["B3"].tension(0)
    found = Phantoms.of(law, compiled, T, response)
    ends = [HeldModes.of(compiled[name].basis, "bridge") for name in law.transverse]
    axial = HeldModes.of(compiled[law.longitudinal].basis, "bridge")
    n = len(found.detuning)
    assert n == min(int(np.sum(h.freq_rad < 2 * np.pi * law.freq_coupled)) for h in ends)
    freq = [min(float(h.freq_rad[i]) for h in ends) for i in range(n)]

    def sizes(at: float) -> np.ndarray:
        return response.heard_at(law.longitudinal, np.array([at]))[:, 0]

    click = response.stopped_at(law.longitudinal, response.freq_rad[:1])[:, 0]
    for i, j in ((0, 0), (0, 1), (2, 5), (n - 1, n - 2), (3, 3)):
        heard, moved = np.zeros(len(found.heard)), 0.0
        for order in range(axial.n_modes + 1):
            # (C_i cos i + C_j cos j)^2 has the order-th cosine where i + j or |i - j| is the order
            product = 0.5 * ((i + j + 2 == order) + (abs(i - j) == order))
            driven = 0.25 * law.axial_stiffness * product
            if not driven:
                continue
            answers = []
            for side, W in enumerate((abs(freq[i] - freq[j]), freq[i] + freq[j])):
                answer = 1.0
                if order:
                    W0, s = float(axial.freq_rad[order - 1]), float(axial.damping_rate[order - 1])
                    away = max(abs(W0**2 - W**2) - 2 * 0.0006 * W**2, 0.0)
                    answer = math.hypot(W**2, 2 * s * W) / math.hypot(away, 2 * s * W + 1e-9 * W0**2)
                answers.append(answer)
                if i != j or side == 1:
                    heard += driven * answer * sizes(W)
            after = sizes(float(axial.freq_rad[order - 1])) if order else click
            heard += driven * after * (2.0 + (sum(answers) if order else 0.0))
            moved += driven * sum(answers) if order else 0.0
        np.testing.assert_allclose(found.heard[:, i, j], heard, rtol=1e-9)
        assert found.detuning[i, j] == pytest.approx(600 / math.log(2) / T * moved, rel=1e-9)


def test_a_force_that_stops_leaves_integrals_of_the_response() -> None:
    """|H| = 1 from v0 to v1: (1/pi) ((w - v0) / w + ln(v1 / w)); |H| = v: ((w^2 - v0^2) / 2w + v1 - w) / pi."""
    freq = np.geomspace(10.0, 1e4, 4001)
    flat = bridge_response._stopped(np.ones((1, 1, freq.size)), freq)[0, 0]
    np.testing.assert_allclose(flat, ((freq - 10.0) / freq + np.log(1e4 / freq)) / np.pi, rtol=1e-4)
    rising = bridge_response._stopped(freq[None, None], freq)[0, 0]
    np.testing.assert_allclose(rising, ((freq**2 - 100.0) / (2 * freq) + 1e4 - freq) / np.pi, rtol=1e-4)


def test_responses_of_the_outputs_are_those_of_the_stepped_body(model: Model) -> None:
    """The force of a string on its bridge, read by a radiating body: the sum over the body's modes, at its points."""
    response, system = BridgeResponse(model), model.system
    body = system.compiled[system.slot("body")].basis
    w = response.freq_rad
    assert np.all(np.diff(w) > 0.0)
    assert w[0] == pytest.approx(2 * np.pi * 20.0)
    inside = np.abs(body.poles.imag)
    inside = inside[(inside > 2 * np.pi * 20) & (inside < np.pi * FS)]
    assert np.isin(inside, w).all()
    for c, component in enumerate(response.components):
        end = next(k for k in system.connections if k.name == f"{component}.bridge")
        entry = {t.point: t.factor for t in end.terms if t.component == "body"}
        shape = sum(f * body.right[body.index(p)] for p, f in entry.items())
        left = sum(f * body.left[body.index(p)] for p, f in entry.items())
        k = len(w) // 3
        s = 1j * w[k]
        own = np.sum(shape * left / (s - body.poles) + (shape * left).conj() / (s - body.poles.conj()))
        own += sum(
            f * g * body.residual[body.index(p), body.index(q)] for p, f in entry.items() for q, g in entry.items()
        )
        assert response.mobility[c, k] == pytest.approx(abs(own) * w[k], rel=1e-6)
    middle = response.heard_at(response.components[0], w[5:7])
    np.testing.assert_array_equal(middle, response.heard[:, 0, 5:7])
    half = response.heard_at(response.components[0], np.array([0.5 * (w[5] + w[6])]))
    np.testing.assert_allclose(half[:, 0], response.heard[:, 0, 5:7].mean(axis=1))
    np.testing.assert_array_equal(response.stopped_at(response.components[1], w[9:10]), response.stopped[:, 1, 9:10])


def plane(n: int, readouts: int, seed: int) -> Plane:
    rng = np.random.default_rng(seed)
    shape = rng.uniform(0.5, 1.0, 4)
    stiffness = rng.uniform(1.0, 2.0, 4)
    return Plane(
        stiffness, shape, rng.normal(size=(n, 4)), rng.normal(size=(n, 4)), rng.normal(size=4),
        rng.uniform(size=(readouts, n, 13)), rng.uniform(size=(readouts, 13)), rng.uniform(size=readouts),
    )  # fmt: skip


def test_the_level_of_sidebands_by_loops() -> None:
    """Partials of two planes: beats by the mean stretch of each of the twelve lowest, the rest together."""
    planes, rng = {"a": plane(3, 2, 5), "b": plane(14, 2, 6)}, np.random.default_rng(7)
    moving = {name: (rng.normal(size=4), rng.normal(size=4)) for name in planes}
    found, rise, peak = Sidebands(planes, 0.01), 0.01, np.array([2.0, 3.0])
    beats, totals, bending, sizes, aboves = np.zeros(12), 0.0, 0.0, {}, {}
    for name, p in planes.items():
        q, v = moving[name]
        potential = 0.5 * max(p.stiffness @ (q * q) - (p.shape @ q) ** 2 / np.sum(p.shape**2 / p.stiffness), 0.0)
        kinetic = 0.5 * max(v @ v - (p.shape @ v) ** 2 / (p.shape @ p.shape), 0.0)
        assert p.energies(q, v) == pytest.approx((potential, kinetic))
        sizes[name] = [math.hypot(p.bent[i] @ q, p.moving[i] @ v) for i in range(len(p.bent))]
        squares = [0.5 * s * s for s in sizes[name]]
        above = max(potential + kinetic - sum(squares), 0.0)
        aboves[name] = math.sqrt(2 * above)
        bending += potential
        totals += sum(squares) + above
        for m, square in enumerate(squares[:12]):
            beats[m] += square
    shares = [rise * b for b in beats] + [rise * max(totals - beats.sum(), 0.0)]
    heard = np.zeros(2)
    for name, p in planes.items():
        for r in range(2):
            for i, size in enumerate(sizes[name]):
                heard[r] += size * sum(p.heard[r, i, m] * shares[m] for m in range(13))
            heard[r] += aboves[name] * sum(p.above[r, m] * shares[m] for m in range(13))
            heard[r] += p.stopped[r] * 4 * rise * bending * abs(p.bridge_force @ moving[name][0])
    assert found.level(moving, peak) == pytest.approx(max(heard / peak))
    still = {name: (0 * q, 0 * v) for name, (q, v) in moving.items()}
    assert found.level(still, peak) == 0.0
    # a pluck adds its partials to those that sound, amplitude to amplitude
    q = rng.normal(size=4)
    alone = Sidebands({"a": planes["a"]}, rise)
    drawn = {"a": (q, np.zeros(4))}
    from_rest = alone.level({"a": (0 * q, 0 * q)}, peak, {"a": q})
    bent = max(
        planes["a"].stopped * 4 * rise * planes["a"].energies(q, 0 * q)[0] * abs(planes["a"].bridge_force @ q) / peak
    )
    assert from_rest <= alone.level(drawn, peak) <= from_rest + bent


def test_planes_with_the_same_modes_are_recognised(model: Model) -> None:
    one, other = (model.system.compiled[model.system.slot(c)].basis for c in ("E4.z", "B3.z"))
    assert sidebands._same_modes(one, one)
    assert not sidebands._same_modes(one, other)


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


def usage_of(model: Model, seconds: float = 2.0) -> EffectUsage:
    usage = EffectUsage(float(FS), {}, {})
    usage.samples = int(seconds * FS)
    return usage


def test_effects_that_always_run_report_the_whole_time(model: Model) -> None:
    effects = {e.name: e for e in runtime_effects(model)}
    usage = usage_of(model)
    for report in effects["second_polarization"].report(usage):
        assert (report.seconds_active, report.seconds_saved, report.bound) == (2.0, 0.0, None)
    foreseen = Foreseen(usage, 3.0, {})
    assert {p.spans_s for p in effects["second_polarization"].plan(foreseen)} == {((0.0, 3.0),)}
    (group, *rest) = effects["outputs"].report(usage)
    assert (group.seconds_active, [r.seconds_active for r in rest]) == (2.0, [0.0] * len(rest))
    plans = effects["outputs"].plan(foreseen)
    assert [(p.seconds, p.why) for p in plans[:1]] == [(3.0, "it is recorded")]
    assert {(p.seconds, p.why) for p in plans[1:]} <= {(0.0, "it is not recorded")}


def test_effects_left_out_save_their_declared_cost() -> None:
    model = assemble(duet(mode="none"), FS)
    (effect,) = (e for e in runtime_effects(model) if e.name == "second_polarization")
    usage = usage_of(model)
    usage.costs.rates = lambda: SimpleNamespace(mode=1e-9)  # type: ignore[assignment, method-assign, return-value]
    reports = effect.report(usage)
    assert [r.component for r in reports] == ["B3", "E4"]
    for report in reports:
        modes = sum(
            model.system.compiled[model.system.slot(c)].basis.n_modes
            for c in model.strings[report.component].components
        )
        assert report.seconds_active == 0.0
        assert report.seconds_saved == pytest.approx(usage.samples * effect.effect.cost(modes) * 1e-9)
    assert {p.why for p in effect.plan(Foreseen(usage, 3.0, {}))} == {"left out: effects are none"}


def test_contacts_and_fingers_report_when_they_acted(model: Model) -> None:
    effects, usage = {e.name: e for e in runtime_effects(model)}, usage_of(model)
    frets, dampers = effects["frets"], effects["dampers"]
    usage.spans["frets", "E4"].add(0, FS // 2)
    usage.spans["frets", "B3"].add(0, 2 * FS)
    reports = {r.component: r for r in frets.report(usage)}
    assert [(reports[n].seconds_active, reports[n].bound) for n in ("E4", "B3")] == [(0.5, 0.0), (2.0, None)]
    assert dampers.report(usage) == []
    usage.spans["dampers", "B3"].add(FS, FS)
    (finger,) = dampers.report(usage)
    assert (finger.component, finger.seconds_active, finger.bound) == ("B3", 1.0, 0.0)
    (planned,) = dampers.plan(Foreseen(usage, 2.0, {}))
    assert (planned.spans_s, planned.why) == (((1.0, 2.0),), "fingers touch the string to pluck it")
    usage.spans["dampers", "E4"].add(-FS, FS // 2)
    assert {p.why for p in dampers.plan(Foreseen(usage, 2.0, {}))} == {"fingers touch the string to pluck it"}
    del usage.spans["dampers", "E4"]
    whys = {p.component: p.why for p in frets.plan(Foreseen(usage, 2.0, {}))}
    assert whys == {"B3": "the string reaches it", "E4": "the string reaches it"}
    # the connections that acted are those of a string's contacts
    columns = [j for j, c in enumerate(model.system.connections) if c.owner == "E4" and c.part and "frets" in c.part]
    for acted, strings in (([], []), (columns[:1], ["E4"]), ([j for j in range(3) if j not in columns], [])):
        run = Run(0, 64, model.system, np.array(acted, dtype=np.intp), {"B3"}, {})
        assert list(frets.running(run)) == strings
        assert set(dampers.running(run)) == {"B3"}


def test_noises_are_counted_by_their_gestures() -> None:
    guitar = tw.load_instrument("classical_guitar").replace({"playing.noises.on": True})
    model = assemble(guitar, 8000, freq_limit=1000)
    (effect,) = (e for e in runtime_effects(model) if e.name == "touch_noise")
    usage = EffectUsage(8000.0, {}, {})
    usage.samples = 8000
    run = Run(0, 64, model.system, np.zeros(0, dtype=np.intp), (), {}, [
        Play(0.0, Gesture(()), string="E2", exciter="touch"), Play(0.0, Gesture(()), string="A2", exciter="pluck"),
        Play(0.0, Gesture(()), at="body.x", exciter="touch"), Play(0.0, Gesture(()), exciter="touch"),
    ])  # fmt: skip
    assert effect.running(run) == {"E2", "body.x", ""}
    for start in (0, 1000):
        usage.spans["touch_noise", "E2"].add(start, 64)
    usage.costs.rates = lambda: SimpleNamespace(mode=1e-9)  # type: ignore[assignment, method-assign, return-value]
    (planned,) = effect.plan(Foreseen(usage, 1.0, {}))
    assert planned.predicted_s == pytest.approx(2 * GESTURE_COST * 1e-9)
    assert planned.spans_s == ((0.0, 0.008), (0.125, 0.133))


def test_a_coupling_reports_with_the_tension_that_switches_it() -> None:
    model = assemble(duet(mode="auto").replace({"strings.B3.plugin": "geometric_string"}), FS)
    (effect,) = (e for e in runtime_effects(model) if e.name == LONGITUDINAL.name)
    usage = usage_of(model)
    assert effect.components == ("B3",)
    usage.spans["longitudinal", "B3"].add(0, FS)
    (report,) = effect.report(usage)
    assert (report.seconds_active, report.bound, report.seconds_saved) == (1.0, None, 0.0)
    usage.enter("tension_modulation", [("B3", Bound(0.1, 1e-5), True)])
    (report,) = effect.report(usage)
    assert report.bound == pytest.approx(-100.0)
    on = {"tension_modulation": Switching(frozenset({"B3", "E4"}))}
    run = Run(0, 64, model.system, np.zeros(0, dtype=np.intp), (), on)
    assert set(effect.running(run)) == {"B3"}
    assert effect.running(replace(run, switchings={})) == ()
    (planned,) = effect.plan(Foreseen(usage, 2.0, {}))
    assert planned.spans_s == ((0.0, 1.0),)
    assert planned.why == f"as long as its tension rises or its phantom partials pass {model.choice.budget_db:g} dB"
    for mode, why in (("all", "always: effects are all"), (["longitudinal", "tension_modulation"], "always: it is")):
        model = assemble(duet(mode=mode).replace({"strings.B3.plugin": "geometric_string"}), FS)
        (effect,) = (e for e in runtime_effects(model) if e.name == LONGITUDINAL.name)
        (planned,) = effect.plan(Foreseen(usage, 2.0, {}))
        assert planned.why.startswith(why)


def test_switched_effects_report_cents_and_level(model: Model) -> None:
    effect, usage = (
        tension_effect(model),
        EffectUsage(float(FS), {"tension_modulation": {"B3": 1.0, "E4": 1.0}}, {"tension_modulation": 1.0}),
    )
    usage.samples = 2 * FS
    usage.spans[effect.name, "E4"].add(0, FS)
    usage.enter(effect.name, [("E4", Bound(0.25, 1e-4), True), ("B3", Bound(9.0, 1.0), False)])
    reports = {r.component: r for r in effect.report(usage)}
    assert (reports["E4"].seconds_active, reports["E4"].bound) == (1.0, 0.25)
    assert reports["E4"].bound_db == pytest.approx(-80.0)
    assert (reports["B3"].seconds_active, reports["B3"].bound, reports["B3"].bound_db) == (0.0, None, None)
    planned = {p.component: p for p in effect.plan(Foreseen(usage, 2.0, {(effect.name, "E4"): 0.125}))}
    assert (planned["E4"].predicted_s, planned["B3"].predicted_s) == (0.125, 0.0)
    assert planned["E4"].spans_s == ((0.0, 1.0),)


@pytest.mark.parametrize(
    ("check", "value", "fits"),
    [
        ("next_watch", 128, True),
        ("next_watch", 64, False),
        ("next_watch", 129, False),
        ("next_watch", 0, False),
        ("watch", None, True),
        ("watch", 3, False),
        ("watch", Watched(frozenset({"a"})), True),
        ("watch", Watched(frozenset({"c"})), False),
        ("watch", Watched(frozenset(), [("b", Bound(), True)]), True),
        ("watch", Watched(frozenset(), [("c", Bound(), True)]), False),
        ("watch", Watched(frozenset(), [("a", Bound())]), False),  # type: ignore[list-item]
        ("watch", Watched(frozenset(), [("a", 0.1, True)]), False),  # type: ignore[list-item]
        ("watch", Watched(frozenset(), [("a", Bound(-0.1), True)]), False),
        ("watch", Watched(frozenset(), [("a", Bound(0.0, math.nan), True)]), False),
        ("watch", Watched(frozenset(), [("a", Bound(math.inf, math.inf), True)]), True),
        ("start", Switching(), True),
        ("start", None, False),
        ("apply", None, False),
        ("cost", 1.5, True),
        ("cost", math.inf, False),
        ("load", 0.0, True),
        ("load", -1.0, False),
        ("report", [], True),
        ("report", (), False),
        ("report", [1], False),
        ("plan", [PlannedEffect("a", "b", (), "", None)], True),
        ("plan", [EffectReport("a", "b", 0.0, 0.0, None, "dB")], False),
        ("report", [EffectReport("a", "b", 0.0, 0.0, None, "dB")], True),
    ],
)
def test_results_of_effects_are_checked(check: str, value: object, fits: bool) -> None:
    effect = SimpleNamespace(components=("a", "b"))
    refused = False
    try:
        base._CHECKS[check](effect, value, {"sample": 64})
    except WrongResultError:
        refused = True
    assert refused is not fits


def phantoms(budget_db: float = -80.0) -> tuple[Model, PhantomPartialsEffect]:
    strings = {f"strings.{name}.plugin": "phantom_string" for name in ("B3", "E4")}
    model = assemble(duet(mode="auto", budget_db=budget_db).replace(strings), FS)
    (effect,) = (e for e in runtime_effects(model) if isinstance(e, PhantomPartialsEffect))
    return model, effect


def test_phantom_partials_run_on_all_strings_for_a_while_after_a_gesture() -> None:
    """Of 64 samples of 24 kHz 15 are 40 ms; motion spreads for 0.15 s."""
    model, effect = phantoms()
    assert effect.components == ("B3", "E4")
    quiet, spreading = Switching(), Switching(until={"": 1000})
    assert [effect.next_watch(s, spreading) for s in (0, 14 * GRID, 15 * GRID)] == [15 * GRID, 15 * GRID, 30 * GRID]
    at = replace_moment(model, {}, GRID)
    assert effect.watch(at, quiet) is None
    hit = Play(0.0, Gesture((Segment(0.0, 0.01, 1.0),), 0.2), string="E4")
    begun = effect.watch(replace_moment(model, {}, GRID, fresh=[hit]), quiet)
    assert begun is not None
    assert (begun.wanted, begun.until, list(begun.bounds)) == ({"B3", "E4"}, {"": GRID + round(0.15 * FS)}, [])
    moved = effect.watch(replace_moment(model, {}, GRID, moved=["E4"]), quiet)
    assert moved is not None
    assert (moved.wanted, dict(moved.until)) == ({"B3", "E4"}, begun.until)
    # until 3,664 nothing more is looked at, then at the next of 15
    on = Switching(moved.wanted, until=moved.until)
    assert effect.watch(replace_moment(model, {}, 45 * GRID), on) is None
    assert effect.watch(replace_moment(model, {}, 58 * GRID), on) is None
    late = effect.watch(replace_moment(model, {}, 60 * GRID), on)
    assert late is not None
    assert late.wanted == frozenset()
    # strings that were switched off by hand come back while motion spreads
    some = effect.watch(replace_moment(model, {}, 45 * GRID), Switching(frozenset({"E4"}), until=moved.until))
    assert some is not None
    assert some.wanted == {"B3", "E4"}
    assert effect.load("E4") == sum(
        model.system.compiled[model.system.slot(f"E4.{p}")].potentials["E4"].weights.shape[1] for p in "zy"
    )
    assert effect.why(EffectUsage(1.0, {}, {}), "E4") == "from a gesture until the missing sound is below -80 dB"
    assert effect.budget == pytest.approx(effect.share * 1e-4)


@pytest.mark.parametrize(
    ("few", "levels", "on", "wanted"),
    [
        (True, (0.5, 0.49), (), ()),
        (True, (0.5, 0.51), (), ("B3", "E4")),
        (True, (0.5, 0.41), ("E4", "B3"), ("B3", "E4")),
        (True, (0.5, 0.39), ("E4", "B3"), ()),
        (False, (0.7, 0.7), (), ()),
        (False, (0.75, 0.7), (), ("B3",)),
        (False, (0.6, 0.6), ("B3",), ()),
        (False, (0.7, 0.6), ("B3",), ("B3",)),
        (False, (1.1, 1.2), (), ("B3", "E4")),
    ],
)
def test_levels_of_phantom_partials_add_up_or_in_power(
    few: bool,
    levels: tuple[float, float],
    on: tuple[str, ...],
    wanted: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of few strings the sum is below the budget, of keys the root of the sum of squares; 0.9 of it where they run."""
    model, effect = phantoms()
    level = dict(zip(("B3", "E4"), levels, strict=True))
    monkeypatch.setattr(effect, "_levels", lambda at, peak: {name: level[name] * effect.budget for name in level})
    monkeypatch.setattr(effect, "_few", few)
    found = effect.watch(replace_moment(model, {}, 15 * GRID), Switching(frozenset(on)))
    assert found is not None
    assert found.wanted == set(wanted)
    assert {(name, left_out) for name, _, left_out in found.bounds} == {(n, n not in wanted) for n in level}


def test_a_bound_of_phantom_partials_is_that_of_the_motion() -> None:
    """Four times as much for twice the motion, half for twice the loudest sample, infinite where modes have left."""
    model, effect = phantoms()
    small, large = shaken(model, 9, 1e-7), shaken(model, 9, 2e-7)
    one, two = (effect._levels(replace_moment(model, {}, state=s), np.ones(1)) for s in (small, large))
    assert {name: 4 * level for name, level in one.items()} == pytest.approx(two)
    half = effect._levels(replace_moment(model, {}, state=small), np.full(1, 2.0))
    assert {name: level / 2 for name, level in one.items()} == pytest.approx(half)
    assert all(0.0 < level < math.inf for level in one.values())
    for name, level in one.items():
        bound, system = effect._bounds[name, 0.0], model.system
        bases = {c: system.compiled[system.slot(c)].basis for c in bound.parts}
        moved = {c: to_motion(basis, system.modes_of(small, c)) for c, basis in bases.items()}
        squares = sum(
            (part.displaced @ moved[c][0]) ** 2 + (part.moving @ moved[c][1]) ** 2 for c, part in bound.parts.items()
        )
        s = np.sqrt(squares)
        assert level == pytest.approx(max(s @ M @ s for M in bound.heard))
    # modes that a bend has moved beyond half the sampling rate are in no bound
    fewer = model.system.compiled[model.system.slot("E4.z")].basis
    gone = model.system.with_basis("E4.z", fewer.select(np.arange(fewer.n_modes) < fewer.n_modes - 1))
    left = effect._levels(replace(replace_moment(model, {}, state=small), system=gone), np.ones(1))
    assert (left["B3"], left["E4"]) == (pytest.approx(one["B3"]), math.inf)
    assert effect._alike("E4") == "E4"
    effect.prepare(Timeline([], [Play(0.0, Gesture(()), string="B3")]))
    assert ("B3", 0.0) in effect._bounds


class Reached(ConnectionsInReach):
    """Frets in a reach of 1 mm."""

    def reach(self, connection: str) -> float:
        return 1e-3


def reached(model: Model) -> Reached:
    parts = {name: p for name, p in model.instrument.attachments.items() if name == "frets"}
    effect = next(e for e in runtime_effects(model) if e.name == "frets").effect
    return Reached(model, effect, parts)


def test_an_excursion_bounds_the_motion_at_a_contact(model: Model) -> None:
    """sqrt(2 E C), C = sum phi^2 / omega^2; no mode by itself moves farther, and the static shape comes to it."""
    effect, system = reached(model), model.system
    state = shaken(model, 3)
    places = [j for j, c in enumerate(system.connections) if c.part == "frets" and c.owner == "E4"]
    names = [system.connections[j].name for j in places]
    assert effect.names("E4") == names
    doubled = 2 * StringEnergies(system, [model.strings["E4"].components]).at(system, state)[0]
    found = effect.excursion(system, state, "E4")
    for i, j in enumerate(places):
        C = 0.0
        for term in system.connections[j].terms:
            basis = system.compiled[system.slot(term.component)].basis
            phi = term.factor * basis.right[basis.index(term.point)].real
            C += sum(p * p / k for p, k in zip(phi, basis.stiffness, strict=True))
        assert found[i] == pytest.approx(math.sqrt(doubled * C), rel=1e-6)
    assert effect.load("E4") == len(places)
    assert effect.payers("E4") == model.strings["E4"].components


def test_contacts_in_reach_come_and_go_with_their_laws(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    effect, held = reached(model), {name: Fretting() for name in model.strings}
    off = effect.apply(model.system, (), held)
    on = effect.apply(off, {"E4"}, held)
    laws = {c.name: c.law for c in on.connections if c.part == "frets"}
    resting = [law for name, law in laws.items() if name.startswith("B3")]
    assert set(resting) == {SpringDashpot()}
    own = {c.name: c.law for c in model.strings["E4"].connections(0.0)}
    assert all(laws[name] == own[name] for name in effect.names("E4"))
    size = {"B3": 0.0, "E4": 0.0}
    monkeypatch.setattr(effect, "excursion", lambda system, state, string: np.array([0.0, size[string]]))
    monkeypatch.setattr(effect, "names", lambda string: ["x", "y"])
    none = Switching()
    assert [effect.next_watch(100, s) for s in (none, Switching(frozenset(effect.components)))] == [
        next_multiple(100, 16), next_multiple(100, 64),
    ]  # fmt: skip
    assert effect.watch(replace_moment(model, {}, GRID), none) is None
    for excursion, running, wanted in (
        (0.5e-3, (), ()),
        (0.51e-3, (), ("E4",)),
        (0.41e-3, ("E4",), ("E4",)),
        (0.4e-3, ("E4",), ()),
    ):
        size["E4"] = excursion
        found = effect.watch(replace_moment(model, {}, 16 * GRID), Switching(frozenset(running)))
        assert found is not None
        assert found.wanted == set(wanted)
        assert {(s, left) for s, _, left in found.bounds} == {("B3", True), ("E4", not wanted)}
    busy = effect.watch(replace_moment(model, {}, GRID, busy={"B3", "other"}, moved=["B3"]), none)
    assert busy is not None
    assert "B3" in busy.wanted


def test_switching_contacts_costs_their_potential(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """k (g - offset)^2 / 2 of a spring, and K p^(a + 1) / (a + 1) of a contact pressed by p = offset - gap."""
    effect, at = reached(model), replace_moment(model, {})
    n = len(effect.names("E4"))
    gap = np.zeros(len(model.system.connections))
    monkeypatch.setattr(connections, "gaps", lambda system, state: gap)
    j = effect._places["E4"]
    for law, g, energy in (
        (SpringDashpot(200.0, offset=1e-3), 4e-3, 0.5 * 200.0 * 9e-6),
        (Contact(1e6, 2.0, 0.0, offset=-1e-3), -3e-3, 1e6 * (2e-3) ** 3 / 3),
        (Contact(1e6, 2.0, 0.0, offset=-1e-3), 0.0, 0.0),
    ):
        monkeypatch.setattr(effect, "laws", lambda string, held, law=law: [law] + [SpringDashpot()] * (n - 1))
        gap[j[0]] = g
        assert effect.cost(at, "E4", True) == pytest.approx(energy)
        assert effect.cost(at, "E4", False) == pytest.approx(-energy)


def test_heights_of_sidebands_by_their_formulas(model: Model) -> None:
    """F / F_n and A / A_n of the module for single pairs, with the partials that they drive through the bridge."""
    system, response = model.system, BridgeResponse(model)
    basis = system.compiled[system.slot("E4.z")].basis
    held = HeldModes.of(basis, "bridge")
    found = Plane.of("E4.z", basis, held, system, response)
    w, g, s = held.freq_rad, held.force, held.damping_rate
    i, end = response.components.index("E4.z"), basis.index("bridge")
    low = held.vectors[:12]
    form = (low * np.asarray(stretch_weights(basis))) @ low.T
    ratios = [abs(form[j, k]) / math.sqrt(form[j, j] * form[k, k]) for j, k in itertools.permutations(range(12), 2)]
    single = min(32, len(w))
    assert found.bent.shape == (single, basis.n_modes)
    np.testing.assert_allclose(found.bent, (held.vectors * held.stiffness / w[:, None])[:single])
    np.testing.assert_allclose(found.bridge_force, (g / w) @ (held.vectors * held.stiffness / w[:, None]))
    for n, m in ((0, 3), (2, 2), (5, 1), (7, 11)):
        total = 0.0
        for side in (-1.0, 1.0):
            freq = abs(w[n] + side * 2 * w[m])
            if n == m and side < 0:
                continue
            away = max(abs(w[n] ** 2 - freq**2), 2 * freq * (0.0012 * freq + s[n]))
            bridge = freq**2 / away
            k = int(np.argmin(np.abs(w - freq)))
            mobility = np.interp(w[k], response.freq_rad, response.mobility[i]) + w[k] * abs(basis.residual[end, end])
            shift = g[k] ** 2 * mobility / (2 * w[k] ** 2)
            apart = abs(freq - w[k]) - 0.0012 * w[k] - shift
            driven = (bridge * shift + 0.5 * max(ratios) * w[k]) / max(s[k] + s[n] + 2 * s[m], apart)
            total += response.heard_at("E4.z", np.array([freq]))[0, 0] * (bridge + driven) * g[n] / w[n]
        assert found.heard[0, n, m] == pytest.approx(total, rel=1e-9)
    top = response.heard[0, i].max()
    np.testing.assert_allclose(found.heard[0, :, -1], (top * (g / w) * (2 + w / w[0]))[:single], rtol=1e-9)
    np.testing.assert_allclose(found.stopped, response.stopped_at("E4.z", response.freq_rad[:1])[:, 0])
