"""Reports and checks of effects, and contacts in reach, by values worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from effect_scenes import FS, duet, tension_effect
from effects_by_hand import replace_moment, shaken

import tonewood as tw
from tonewood.instrument.contract.contract_checks import WrongResultError
from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects import base, connections, runtime_effects
from tonewood.performance.effects.base import (
    EffectReport,
    Foreseen,
    PlannedEffect,
    Run,
    Switching,
    Watched,
    next_multiple,
)
from tonewood.performance.effects.connections import ConnectionsInReach
from tonewood.performance.effects.longitudinal import LONGITUDINAL
from tonewood.performance.effects.string_energies import StringEnergies
from tonewood.performance.effects.unswitched import GESTURE_COST
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.timeline import GRID, Play
from tonewood.physics.coupling.connections import SpringDashpot
from tonewood.physics.coupling.laws.contact import Contact

# -- results -----------------------------------------------------------------------------------------------------------


def test_a_wrong_result_names_the_plugin_that_declares_the_effect() -> None:
    declared = SimpleNamespace(files=SimpleNamespace(manifest="a/plugin.toml"), key="strings.a")
    effect = SimpleNamespace(effect=SimpleNamespace(name="buzz"), plugins={"a": declared, "b": None})
    fault = base._fault(effect, "is wrong")
    assert (fault.reason, str(fault.file), fault.key) == ("effect 'buzz': is wrong", "a/plugin.toml", "strings.a")
    alone = base._fault(SimpleNamespace(plugins={}), "is wrong")
    assert (alone.reason, alone.file, alone.key) == ("is wrong", None, None)


# -- reports -----------------------------------------------------------------------------------------------------------


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


# -- results again -----------------------------------------------------------------------------------------------------


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


# -- contacts ----------------------------------------------------------------------------------------------------------


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
