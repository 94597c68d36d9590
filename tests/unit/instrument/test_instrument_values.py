"""Parts of an instrument by themselves: shapes, gauges, lumps, wolves, places; closed forms and small examples."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError, TonewoodError
from tonewood.instrument.bundle.added import (
    added_line,
    body_parts,
    dynamic_stiffness,
    lump,
    point_factor,
    stiffness_rate,
)
from tonewood.instrument.bundle.added_schema import Added
from tonewood.instrument.bundle.migration import bundle_edits
from tonewood.instrument.bundle.origins import Origins
from tonewood.instrument.bundle.schema import SCHEMA, ControllerMap, Effects, Finger, Provenance, Velocity
from tonewood.instrument.bundle.string_materials import made_figures, string_materials
from tonewood.instrument.bundle.string_schema import INCH, Fretboard, MadeOf, Scatter
from tonewood.instrument.bundle.string_sets import figures, string_sets
from tonewood.instrument.contract.attached import Attached, Motion, Site, loose_mass
from tonewood.instrument.contract.base import BodyPoint
from tonewood.instrument.contract.directions import unit_vector
from tonewood.instrument.contract.effects import Effect, Norms, contact_effect, level_db, modes, nothing
from tonewood.instrument.contract.gestures import Fraction, Hold, Place, is_played, metres, places, smooth_step
from tonewood.instrument.contract.moved_modes import MovedMode, with_moved_modes
from tonewood.instrument.contract.string_motion import StringMotion, levered
from tonewood.instrument.contract.svg_path import svg_ring
from tonewood.instrument.inspection.frequencies import (
    bridge_mobility,
    feel,
    held_partials,
    mobility_bands,
    mobility_peaks,
    partials,
    pitch,
    pitches,
)  # fmt: skip
from tonewood.instrument.inspection.modal_export import modal_table_text
from tonewood.instrument.inspection.mode_names import mode_names
from tonewood.instrument.inspection.potentials_at_rest import SmallMotion, _near_rest
from tonewood.instrument.inspection.string_laws import LawErrors, _relative
from tonewood.instrument.inspection.wolf import _refined, disturbed_share, intervals
from tonewood.instrument.model import fretboard
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.instrument.model.choice import Choice
from tonewood.instrument.model.finger import POINT, compliance, fingertips, laid_down
from tonewood.instrument.model.output_assembly import OutputGroup, pan_gains
from tonewood.instrument.model.references import by_part, check_connections, check_readouts
from tonewood.instrument.model.stretch import inharmonicity
from tonewood.instrument.model.string_bases import StringBases, StringPlaces
from tonewood.instrument.scales import KeyMap, Scale, Tuning
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import MOST_MODES
from tonewood.physics.stepping.forcing import Segment
from tonewood.support.params import Parameters


@pytest.fixture(scope="module")
def guitar() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), 8000, freq_limit=1500)


@pytest.mark.parametrize(
    ("path", "ring"),
    [
        ("M 0 0 L 2 0 L 2 1 Z", [(0, 0), (2, 0), (2, 1)]),
        ("m 1 1 2 0 0 1 z", [(1, 1), (3, 1), (3, 2)]),
        ("M0,0H2V1h-2z", [(0, 0), (2, 0), (2, 1), (0, 1)]),
        ("M 1 1 h 2 v 3 H 0 V 1", [(1, 1), (3, 1), (3, 4), (0, 4), (0, 1)]),
        ("M0 0L1 0L1 1L0 0", [(0, 0), (1, 0), (1, 1)]),
        ("M0 0L1 0L1 1M5 5L6 6", [(0, 0), (1, 0), (1, 1)]),
        ("M-.5-.5l1e0 0 0 1", [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5)]),
    ],
)
def test_rings_of_straight_paths(path: str, ring: list[tuple[float, float]]) -> None:
    np.testing.assert_allclose(svg_ring(path), ring)


def test_curves_of_paths_are_bezier_curves() -> None:
    """At t = 1/2 a cubic is (p0 + 3 p1 + 3 p2 + p3) / 8, a quadratic (p0 + 2 p1 + p2) / 4; handles are mirrored."""
    cubic = svg_ring("M0 0C0 4 8 4 8 0S16 4 16 0")
    assert len(cubic) == 129
    np.testing.assert_allclose(cubic[[32, 64, 96, 128]], [(4, 3), (8, 0), ((8 + 24 + 48 + 16) / 8, 0.0), (16, 0)])
    quadratic = svg_ring("M0 0Q4 4 8 0T16 0")
    np.testing.assert_allclose(quadratic[[32, 64, 96, 128]], [(4, 2), (8, 0), (12, -2), (16, 0)])
    relative = svg_ring("m2 2c0 4 8 4 8 0s8 4 8 0")
    np.testing.assert_allclose(relative, cubic + 2)
    for path, said in (("M0 0A1 1 0 0 0 1 1", "'A'"), ("M0 0L1", "takes 2 numbers"), ("M0 0L1 1", "three points")):
        with pytest.raises(ValueError, match=said):
            svg_ring(path)


def test_moved_modes_are_the_nearest_within_five_percent() -> None:
    freq, q = np.array([100.0, 104.0, 200.0]), np.array([10.0, 20.0, 30.0])
    new, new_q = with_moved_modes(
        freq, q, [MovedMode(near=103.0, freq=111.0, q=5.0), MovedMode(near=209.0, freq=1.0, q=6.0)]
    )
    assert (new.tolist(), new_q.tolist()) == ([100.0, 111.0, 1.0], [10.0, 5.0, 6.0])
    assert freq.tolist() == [100.0, 104.0, 200.0]
    for near, said in (
        (211.0, "no mode of the table lies within 5 % of 211 Hz; the nearest is at 200 Hz"),
        (95.0, "within"),
    ):
        with pytest.raises(ValueError, match=said):
            with_moved_modes(freq, q, [MovedMode(near=near, freq=1.0, q=1.0)])
    with pytest.raises(ValueError, match="there is none"):
        with_moved_modes(freq[:0], q[:0], [MovedMode(near=95.0, freq=1.0, q=1.0)])
    with pytest.raises(ValueError, match="two entries"):
        with_moved_modes(freq, q, [MovedMode(near=n, freq=1.0, q=1.0) for n in (199.0, 201.0)])


def test_steps_of_force_are_smooth() -> None:
    """Half way at half the time, level at both ends, the same slope from both sides of the middle."""
    first, second = smooth_step(1.0, 3.0, 2.0, 6.0)
    assert (first.start, first.stop, second.start, second.stop) == (1.0, 2.0, 2.0, 3.0)
    assert first.shifted(0.0)[:2] == (2.0, 0.0)
    assert first.shifted(1.0)[:2] == pytest.approx((4.0, 4.0))
    assert second.shifted(0.0)[:2] == pytest.approx((4.0, 4.0))
    assert second.shifted(1.0)[:2] == pytest.approx((6.0, 0.0))
    assert smooth_step(1.0, 1.0, 0.0, 1.0) == ()
    assert smooth_step(1.0, 0.5, 0.0, 1.0) == ()


def test_a_hold_grows_smoothly_and_ends() -> None:
    hold = Hold(1.0, 2.0, 4.0, 8.0)
    values = {0.99: 0.0, 1.0: 0.0, 1.5: 4.0, 1.25: 8 * 0.0625 * 2.5, 2.0: 8.0, 3.99: 8.0, 4.0: 0.0}
    assert {t: hold.at(t) for t in values} == pytest.approx(values)
    assert Hold(1.0, 1.0, 4.0, 8.0).at(1.0) == 8.0


def test_places_on_a_string_keep_one_percent_from_its_ends() -> None:
    string = Place("a", 0.5)
    wanted = {0.2: 0.2, 0.0: 0.005, 0.6: 0.495, 0.495: 0.495}
    assert {x: metres(x, string) for x in wanted} == pytest.approx(wanted)
    assert metres(Fraction(fraction=0.25), string) == 0.125
    assert [is_played(x, 0.5) for x in (0.0049, 0.005, 0.495, 0.4951)] == [False, True, True, False]
    with pytest.raises(BundleError, match="b is not a string"):
        metres(0.1, Place("b"))
    exciter = tw.load_instrument("classical_guitar").exciters["pluck"].parameters
    share = exciter.model_copy(update={"from_bridge": Fraction(fraction=0.5)})
    assert places(share, 0.65, 0.4)["from_bridge"] == 0.2
    far = exciter.model_copy(update={"from_bridge": 0.66})
    assert places(far, 0.66, 0.4)["from_bridge"] == 0.66
    with pytest.raises(ValueError, match=r"from_bridge is 0.66 m; places up to 0.65 m"):
        places(far, 0.65, 0.4)


def test_sites_project_and_lower() -> None:
    site = Site("s", 0.65, 0.5, (0.65, 0.6), (("s.z", (0.0, 0.6, 0.8)), ("s.y", (0.0, 0.8, -0.6))))
    assert site.motion("p", (0.0, 0.0, 1.0), 2.0) == (Term("s.z", "p", 1.6), Term("s.y", "p", -1.2))
    assert site.motion("p", (0.0, 0.6, 0.8)) == (Term("s.z", "p", 1.0),)
    assert (site.leader, Site("s", 1.0, 1.0, (), (), ("a", "s")).leader) == ("s", "a")

    def clearance(x: float) -> float:
        return 0.001 + 0.01 * x

    assert site.lowered(0.25, clearance) == pytest.approx(0.0035 - 0.006 * 0.25 / 0.5)
    assert site.lowered(0.5, clearance) == pytest.approx(0.0)
    assert Site("s", 0.65, 0.65, (), ()).lowered(0.25, clearance) == clearance(0.25)
    ramp = Motion("k", "offset", (Segment(0.0, 1.0, 1.0, 2.0),))
    assert ramp.course([-0.1, 0.0, 0.5, 1.0]).tolist() == [0.0, 1.0, 2.0, 0.0]
    owned = Attached(connections=(Connection("c", (Term("a", "b"),), SpringDashpot()),)).owned_by("s", "part")
    assert [(c.role, c.owner, c.part) for c in owned.connections] == [("attached", "s", "part")]
    mass = loose_mass(0.25, 10.0, 2.0)
    assert mass.right[0, 0] ** 2 == pytest.approx(4.0)
    assert abs(mass.poles[0]) == pytest.approx(10.0)
    assert mass.poles[0].real == pytest.approx(-2.0)


def test_shares_of_a_string_s_end_with_a_leverage() -> None:
    assert levered({"a": 0.25, "b": -0.5, "c": 0.0}, 0.125) == {"a": 0.25, "b": -0.375}
    assert levered({"a": 0.5}, -0.5) == {}
    string = StringMotion("s", ("s.z",), None, {"a": 0.25, "b": 0.5})
    assert string.onto_body(0.1) == (("body", "a", 0.25), ("body", "b", pytest.approx(0.6)))
    assert string.onto_body() == (("body", "a", 0.25), ("body", "b", 0.5))


def test_effects_declare_level_unit_and_cost() -> None:
    assert level_db(Norms(level=0.1)) == pytest.approx(-20.0)
    assert level_db(Norms()) == -math.inf
    assert (nothing(5), modes(5)) == (0.0, 5.0)
    contact = contact_effect("c", "adds")
    assert (contact.cost(4), contact.unit, contact.basic) == (2.0, "dB", False)
    assert Effect("d", "adds", "detuning", "", "").unit == "cents"
    declared = {"a": contact, "b": contact_effect("b", "x", basic=True)}
    for mode, names in (("auto", {"a", "b"}), ("all", {"a", "b"}), ("none", {"b"}), (["a"], {"a", "b"}), ([], {"b"})):
        choice = Choice.of(Effects(mode=mode, budget_db=-50.0, budget_cents=2.0), declared)
        assert (choice.names, choice.budget_db, choice.budget_cents) == (names, -50.0, 2.0)
        assert choice.mode == ("list" if isinstance(mode, list) else mode)
    with pytest.raises(TonewoodError, match="there is no effect 'x'"):
        Choice.of(Effects(mode=["x"]), declared)


def test_scatter_is_drawn_by_name_and_straight_between_stops() -> None:
    one = Scatter(seed=3, tilt_deg=2.0, split_cents=0.5)
    assert one.split("E", 1.25) == pytest.approx(0.75 * one.split("E", 1.0) + 0.25 * one.split("E", 2.0))
    assert one.tilt("E") == pytest.approx(2.0 * Scatter(seed=3, tilt_deg=1.0).tilt("E"))
    values = {
        one.tilt("E"),
        one.tilt("A"),
        one.split("E", 0),
        one.split("E", 1),
        one.split("A", 0),
        Scatter(seed=4, tilt_deg=2.0).tilt("E"),
    }
    assert len(values) == 6
    assert (Scatter().tilt("E"), Scatter().split("E", 2)) == (0.0, 0.0)


def test_a_fretboard_over_another_takes_what_it_leaves_out() -> None:
    """Of two keys that exclude each other the other one is not taken."""
    common = Fretboard(nut_height=1e-3, action_twelfth=3e-3, relief=2e-4, rule=18.0)
    assert Fretboard(action_first=5e-4, relief=0.0).over(common) == Fretboard(
        action_first=5e-4, action_twelfth=3e-3, relief=0.0, rule=18.0
    )
    assert Fretboard(saddle_height=2e-3, places=[0.1, 0.2]).over(common) == Fretboard(
        saddle_height=2e-3, places=[0.1, 0.2], nut_height=1e-3, relief=2e-4
    )
    assert Fretboard().over(common) == common


def test_a_wound_string_by_its_gauges() -> None:
    """Two of string, core and wire make the third; close winding fills pi/4 sqrt(1 + (d_w / pi (d_c + d_w))^2)."""
    values = [
        {"gauge": 1.0e-3, "core": {"gauge": 0.4e-3}, "wrap": {"material": "phosphor_bronze"}},
        {"core": {"gauge": 0.4e-3}, "wrap": {"material": "phosphor_bronze", "gauge": 0.3e-3}},
        {"gauge": 1.0e-3, "wrap": {"material": "phosphor_bronze", "gauge": 0.3e-3}},
        {"gauge": 1.0e-3, "core": {"share": 0.4}, "wrap": {"material": "phosphor_bronze"}},
        {"gauge_inch": 1.0e-3 / INCH, "core": {"share": 0.4}, "wrap": {"material": "phosphor_bronze"}},
    ]
    rho_core, rho_wrap = (string_materials()[name].density.value for name in ("plain_steel", "phosphor_bronze"))
    fill = math.pi / 4 * math.sqrt(1 + (0.3 / (math.pi * 0.7)) ** 2)
    mass = math.pi / 4 * (rho_core * 0.4e-3**2 + fill * rho_wrap * (1e-6 - 0.4e-3**2))
    for value in values:
        found = made_figures(MadeOf.model_validate({"material": "wound", **value}), 0.65, 110.0)
        assert (found.diameter, found.core_diameter) == (pytest.approx(1e-3), pytest.approx(0.4e-3))
        assert found.linear_density == pytest.approx(mass)
        assert found.tension == pytest.approx(mass * (2 * 0.65 * 110.0) ** 2)
        assert found.stress == pytest.approx(found.tension / (math.pi * 0.4e-3**2 / 4))
        area = math.pi * 0.4e-3**2 / 4
        young = string_materials()["plain_steel"].young
        assert young is not None
        modulus = young.value + young.per_stress * found.stress
        assert found.axial_stiffness == pytest.approx(modulus * area)
        assert found.bending_stiffness == pytest.approx(modulus * math.pi * 0.4e-3**4 / 64)
    half = made_figures(
        MadeOf.model_validate({"material": "wound", **values[0], "wrap": {"material": "phosphor_bronze", "fill": 0.5}}),
        0.65,
        110.0,
    )
    assert half.linear_density == pytest.approx(math.pi / 4 * (rho_core * 0.16e-6 + 0.5 * rho_wrap * 0.84e-6))
    printed = made_figures(MadeOf(material="plain_steel", gauge=4e-4, linear_density=1e-3), 0.65, 330.0)
    assert printed.linear_density == 1e-3


def test_a_core_of_nylon_follows_from_the_mass() -> None:
    """The mass of the string that it makes is the one that was printed."""
    wrap = next(name for name, m in string_materials().items() if m.young is None)
    parts = {"material": "wound", "gauge": 1.1e-3, "wrap": {"material": wrap}}
    nylon = made_figures(
        MadeOf.model_validate({**parts, "core": {"material": "nylon"}, "linear_density": 5.5e-3}), 0.65, 82.4
    )
    again = {**parts, "core": {"material": "nylon", "gauge": nylon.core_diameter}}
    assert made_figures(MadeOf.model_validate(again), 0.65, 82.4).linear_density == pytest.approx(5.5e-3, rel=1e-9)


def test_tensions_of_a_set_go_with_length_and_pitch() -> None:
    for chosen in list(string_sets().values())[:4]:
        entry = chosen.strings[0]
        near, far = figures(entry, chosen, 0.65, 100.0), figures(entry, chosen, 1.3, 150.0)
        assert far["tension"] / near["tension"] == pytest.approx(9.0)
        assert far["linear_density"] == near["linear_density"]


LUMPS = [
    Added(at="p", mass=0.02, stiffness=3e3, damping=0.5), Added(at="p", mass=0.01, frequency=100.0, q=8.0),
    Added(at="p", stiffness=2e3), Added(at="p", damping=2.0),
]  # fmt: skip


@pytest.mark.parametrize("entry", LUMPS)
def test_dynamic_stiffness_of_lumps_and_its_rates(entry: Added) -> None:
    """m s^2 + d s + k; a free mass m behind k + d s gives m s^2 (k + d s) / (m s^2 + d s + k). Rates by differences."""
    s = 2j * math.pi * 130.0

    def at(one: Added) -> complex:
        top, below = dynamic_stiffness(one)
        return complex(np.polyval(top, s) / np.polyval(below, s))

    m, d, k = lump(entry)
    if entry.frequency is None:
        assert at(entry) == pytest.approx(m * s * s + d * s + k)
        keys = ["mass", "damping", "stiffness"]
    else:
        w = 2 * math.pi * 100.0
        assert (m, d, k) == (0.0, pytest.approx(0.01 * w / 8.0), pytest.approx(0.01 * w * w))
        inertia = 0.01 * s * s
        assert at(entry) == pytest.approx(inertia * (k + d * s) / (inertia + k + d * s))
        keys = ["mass", "frequency", "q"]
    for key in keys:
        value = getattr(entry, key)
        h = 1e-6 * max(value, 1e-3)
        high, low = (entry.model_copy(update={key: value + x}) for x in (h, -h))
        top, below = stiffness_rate(entry, key)
        assert np.polyval(top, s) / np.polyval(below, s) == pytest.approx(
            (at(high) - at(low)) / (2 * h), rel=1e-5, abs=1e-9
        )
    with pytest.raises(BundleError, match="cannot be changed"):
        stiffness_rate(entry, "at")


def test_lumps_on_a_body_of_one_mode() -> None:
    """A mass dm and a spring dk on a mass m: omega^2 = (k + dk) / (m + dm)."""
    body = ModalBasis.real([200.0], [1.0], {"p": [1.0]}, modal_mass=0.5)
    points = {"p": BodyPoint((0.0, 0.0, 1.0)), "q": BodyPoint((0.0, 0.0, 1.0), driven=False)}
    entries = [Added(at="p", mass=0.25), Added(at="p", stiffness=4e4)]
    parts = body_parts(entries, body, points)
    assert parts.body.natural_freq[0] * 2 * math.pi == pytest.approx(math.sqrt((0.5 * 200.0**2 + 4e4) / 0.75), rel=1e-4)
    assert set(parts.components) == {"body.added.0.mass"}
    assert [(f.connection, f.point, f.factor) for f in parts.forces] == [
        ("body.added.0", "p", -1.0),
        ("body.added.1", "p", 1.0),
    ]
    assert body_parts([], body, points).body is body
    tilted = Added(at="p", mass=0.25, direction=(0.0, 0.6, 0.8))
    assert point_factor(0, tilted, points) == pytest.approx(0.8)
    slanted = body_parts([tilted], body, points).body
    assert slanted.natural_freq[0] * 2 * math.pi == pytest.approx(math.sqrt(0.5 * 4e4 / (0.5 + 0.64 * 0.25)), rel=1e-4)
    for entry, said in (
        (Added(at="q", mass=1.0), "there is no point 'q'"),
        (Added(at="p", mass=1.0, direction="x"), "does not move"),
    ):
        with pytest.raises(BundleError, match=said):
            point_factor(0, entry, points)
    assert added_line(LUMPS[0]) == "0.02 kg, 3000 N/m, 0.5 N s/m at p"
    assert added_line(LUMPS[1]) == "0.01 kg on a spring, tuned to 100 Hz, Q 8, at p"


def test_a_fingertip_s_compliance_is_that_of_its_parts() -> None:
    finger = Finger(mass=0.002, freq=50.0, damping_ratio=0.2, skin_stiffness=4e3, skin_damping=3.0)
    s, w = 2j * math.pi * 200.0, 2 * math.pi * 50.0
    expected = 1 / (4e3 + 3.0 * s) + 1 / (0.002 * (s * s + 2 * 0.2 * w * s + w * w))
    assert compliance(finger, 200.0) == pytest.approx(expected)
    site = Site("s", 0.65, 0.5, (), (("s.z", (0.0, 0.0, 1.0)), ("s.y", (0.0, 1.0, 0.0))))
    parts = fingertips(finger, site, stopped=True)
    assert [c.name for c in parts.connections] == ["s.finger.skin1", "s.finger.skin2"]
    law = parts.connections[0].law
    assert isinstance(law, SpringDashpot)
    assert (law.stiffness, law.damping) == (4e3, 3.0)
    assert parts.connections[1].terms == (Term("s.y", POINT), Term("s.fingertip2", "mass", -1.0))
    assert {c.law for c in fingertips(finger, site, stopped=False).connections} == {SpringDashpot()}
    tip = parts.components["s.fingertip1"]
    assert (abs(tip.poles[0]), -tip.poles[0].real) == (pytest.approx(w), pytest.approx(0.2 * w))


def test_a_finger_that_is_laid_down_takes_its_deflection_away() -> None:
    """The bridge stays, velocities stay, and the energy of the modes falls."""
    rng = np.random.default_rng(2)
    shapes = {"bridge": rng.normal(size=5), POINT: rng.normal(size=5)}
    w = np.arange(1, 6) * 100.0
    new = ModalBasis.real(w, 0 * w + 1.0, shapes)
    old = ModalBasis.real(w, 0 * w + 1.0, {**shapes, POINT: 0 * w})
    displacement, velocity = laid_down(old, new)
    q = rng.normal(size=5)
    q -= shapes["bridge"] * (shapes["bridge"] @ q) / (shapes["bridge"] @ shapes["bridge"])
    after = displacement @ q
    assert shapes[POINT] @ after == pytest.approx(0.0, abs=1e-12)
    assert shapes["bridge"] @ after == pytest.approx(0.0, abs=1e-12)
    assert w**2 @ after**2 < w**2 @ q**2
    np.testing.assert_array_equal(velocity, np.eye(5))
    np.testing.assert_array_equal(laid_down(new, old)[0], np.eye(5))
    moved = ModalBasis.real(w, 0 * w + 1.0, {**shapes, POINT: rng.normal(size=5)})
    slid = laid_down(new, moved)[0] @ q
    assert moved.right[moved.index(POINT)].real @ slid == pytest.approx(new.right[new.index(POINT)].real @ q)


def test_wolves_of_a_share_by_hand() -> None:
    x = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
    ((low, high, peak, depth, severity),) = intervals(x, np.array([0.0, 0.0, 0.4, 0.4, 0.0, 0.1]))
    # above 0.2 from 15 to 35: two triangles of 5 cents from 0.2 to 0.4, and 10 cents of 0.4
    assert (low, high, depth) == (pytest.approx(15.0), pytest.approx(35.0), pytest.approx(0.4))
    assert 20.0 <= peak <= 30.0
    assert severity == pytest.approx(2 * 5 * 0.3 + 10 * 0.4, rel=1e-6)
    assert intervals(x, np.full(6, 0.199)) == []
    assert len(intervals(x, np.array([0.3, 0.0, 0.3, 0.0, 0.3, 0.3]))) == 3
    assert disturbed_share([(0.75, 0.0, 0.25), (0.25, 0.0, 0.75)]) == pytest.approx(0.25)
    assert disturbed_share([(0.6, 0.1, 0.3)]) == 0.0
    assert disturbed_share([(0.6, 0.0, 0.4), (0.01, 0.9, 0.09), (0.2, 0.1, 0.7)]) == pytest.approx(0.25)
    places_, shares = _refined(
        lambda x: np.where(np.abs(x) < 1.0, 0.5, 0.0), np.array([90.0, 100.0, 130.0, 160.0]), 100.0
    )
    beside = np.maximum(shares[1:], shares[:-1]) > 0.05
    assert np.diff(places_)[beside].max() <= 6.5
    assert len(places_) < 10
    assert (places_[-1] - places_[-2], shares.max()) == (30.0, 0.5)


@pytest.mark.parametrize(
    ("stop", "bend", "decay", "cents", "off"),
    [
        (0, 0.0, 1e-3, 1.0, (False, False)),
        (0, 0.0, -1.1e-3, -1.1, (True, True)),
        (0, 200.0, 2e-2, 5.0, (False, False)),
        (0, 200.0, 2.1e-2, -5.1, (True, True)),
        (0, 0.0, None, 0.0, (False, False)),
        (0, 0.0, math.nan, math.nan, (True, True)),
    ],
)
def test_errors_of_partials_that_are_told(
    stop: int, bend: float, decay: float | None, cents: float, off: tuple[bool, bool]
) -> None:
    errors = LawErrors(stop, bend, 1, decay, 1, cents, 0.0)
    assert (errors.decay_is_off, errors.pitch_is_off) == off
    assert _relative(np.array([2.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])).tolist() == [1.0, 0.0, math.inf]


def test_names_of_modes_by_order_and_level() -> None:
    assert mode_names([90.0, 200.0, 260.0], [-10.0, 0.0, -5.0]) == {"A0": 0, "T1": 1, "T2": 2}
    assert mode_names([45.0, 90.0, 200.0], [0.0, -24.0, 0.0]) == {"A0": 1, "T1": 2}
    assert mode_names([90.0, 100.0, 200.0], [-26.0, -24.0, 0.0]) == {"A0": 1, "T1": 2}
    assert mode_names([100.0, 150.0, 200.0], [0.0, -11.0, 0.0]) == {"A0": 0, "T1": 2}
    assert mode_names([100.0, 140.0, 280.0, 281.0], [0.0, 0.0, 0.0, 0.0]) == {"A0": 0}
    assert mode_names([100.0, 200.0, 224.0, 225.0], [0.0] * 4) == {"A0": 0, "T1": 1, "T2": 3}
    assert mode_names([400.0], [0.0]) == {}
    assert mode_names([], []) == {}


def test_small_motion_that_is_worth_a_warning() -> None:
    def motion(freq: float, energy: float = 0.0) -> SmallMotion:
        return SmallMotion("v", 100.0, freq, energy, "")

    assert motion(100.0 * 2 ** (0.9 / 1200)).doubt is None
    sharp = motion(100.0 * 2 ** (100 / 1200))
    assert sharp.cents == pytest.approx(100.0)
    assert "sounds at 105.946 Hz (+100.0 cents)" in (sharp.doubt or "")
    assert motion(0.0).cents == -math.inf
    assert "is unstable" in (motion(0.0).doubt or "")
    assert "sets 2e-12 J free" in (motion(100.0, 2e-12).doubt or "")
    assert motion(100.0, 1e-12).doubt is None


@pytest.mark.parametrize(
    ("pan", "channels", "left", "right"),
    [(-1, 1, 1.0, 0.0), (0, 1, 2**-0.5, 2**-0.5), (1, 1, 0.0, 1.0), (0, 2, 1.0, 1.0), (-1, 2, 2**0.5, 0.0)],
)
def test_pans_keep_the_power(pan: float, channels: int, left: float, right: float) -> None:
    assert pan_gains(pan, channels) == (pytest.approx(left, abs=1e-15), pytest.approx(right, abs=1e-15))
    group = OutputGroup(
        "g", ("left", "right"), (0,), "velocity", "m/s", 1.0, "", -20.0, pan, columns=(0, 0 if channels == 1 else 1)
    )
    assert group.gains == (pytest.approx(0.1 * left, abs=1e-15), pytest.approx(0.1 * right, abs=1e-15))
    assert OutputGroup("g", ("a", "b"), (0, 1), "velocity", "m/s", 1.0, "", 20.0, columns=(0, 1)).gains == (10.0, 10.0)


def test_references_of_parts_are_checked() -> None:
    basis = ModalBasis.real([1.0], [0.1], {"p": [1.0]})
    components = {"a": basis, "b": basis}
    connection = Connection("k", (Term("a", "p"), Term("b", "p", -1.0)), SpringDashpot(), part="x")
    other = Connection("l", (Term("a", "p"),), SpringDashpot(), part="y")
    assert by_part([connection, other, connection]) == {"x": [connection] * 2, "y": [other]}

    def fault(reason: str) -> BundleError:
        return BundleError(reason)

    check_connections([connection, other], components, ["m"], fault)
    wrong = [
        ([connection, connection], (), "two connections 'k'"), ([connection], ("k",), "two connections 'k'"),
        ([Connection("k", (Term("c", "p"),), SpringDashpot())], (), "there is no component 'c'; there are a, b"),
        ([Connection("k", (Term("a", "q"),), SpringDashpot())], (), "a has no point 'q'; there are p"),
    ]  # fmt: skip
    for connections, taken, said in wrong:
        with pytest.raises(BundleError, match=said):
            check_connections(connections, components, taken, fault)
    readout = Readout("r", "velocity", (Term("a", "p"),), forces=(("k", 1.0),))
    check_readouts([readout], [Drive("a", "p", "k", 1.0)], components, ["k"], fault)
    with pytest.raises(BundleError, match="a drive of 'a': there is no connection 'z'"):
        check_readouts([], [Drive("a", "p", "z", 1.0)], components, ["k"], fault)
    with pytest.raises(BundleError, match="a drive: a has no point 'q'"):
        check_readouts([], [Drive("a", "q", "k", 1.0)], components, ["k"], fault)


def test_connections_are_listed_in_their_order() -> None:
    readout = Readout("r", "velocity", (), forces=(("k", 1.0),))
    names = [f"m{i}" for i in range(12)]
    with pytest.raises(BundleError, match=f"there is no connection 'k'; there are {', '.join(names[:10])} and 2 more"):
        check_readouts([readout], [], {}, names, BundleError)


def test_the_most_specific_origin_counts() -> None:
    entries = {
        "strings": Provenance(kind="published", source="a"), "strings.*.tension": Provenance(kind="stand_in"),
        "strings.E.tension": Provenance(kind="unknown"), "strings.*.*.x": Provenance(kind="computed", source="b"),
    }  # fmt: skip
    origins = Origins(entries, {}, SimpleNamespace())  # type: ignore[arg-type]
    found = {path: entry.kind if (entry := origins.of(path)) else None for path in (
        "strings.A.length", "strings.A.tension", "strings.E.tension", "strings.E.tension.x", "body", "strings",
    )}  # fmt: skip
    assert list(found.values()) == ["published", "stand_in", "unknown", "computed", None, "published"]
    assert origins.stand_ins() == ["strings.*.tension"]
    assert origins.of_unknown_origin() == ["strings.E.tension"]


def test_bundles_of_earlier_schemas_are_edited() -> None:
    number = int(SCHEMA.rpartition("/")[2])
    assert [edit.path for edit in bundle_edits({"schema": f"tonewood-instrument/{number - 1}"})] == ["schema"]
    assert bundle_edits({"schema": SCHEMA}) == bundle_edits({"schema": "x"}) == bundle_edits({}) == []
    with pytest.raises(BundleError, match="is of a later version of tonewood"):
        bundle_edits({"schema": f"tonewood-instrument/{number + 1}"})


def test_controllers_and_velocities_are_mapped() -> None:
    wheel = ControllerMap(parameter="a.b", low=2.0, high=1.0)
    assert [wheel.value(x) for x in (-1.0, 0.0, 0.25, 1.0, 2.0)] == [2.0, 2.0, 1.75, 1.0, 1.0]
    curve = Velocity(low=0.5, high=8.0)
    assert [curve.value(v) for v in (1, 64, 127)] == pytest.approx([0.5, 2.0, 8.0])
    assert unit_vector((0.0, 0.6, 0.805)) == pytest.approx(
        (0.0, 0.6 / math.hypot(0.6, 0.805), 0.805 / math.hypot(0.6, 0.805))
    )


def test_inharmonicity_of_a_string() -> None:
    """B = pi^2 EI / (T L^2) with T = mu (2 L f)^2."""
    string = SimpleNamespace(linear_density=4e-3, length=0.65, bending_stiffness=6e-5)
    T = 4e-3 * (2 * 0.65 * 110.0) ** 2
    assert inharmonicity(string, 110.0) == pytest.approx(math.pi**2 * 6e-5 / (T * 0.65**2))  # type: ignore[arg-type]
    string.linear_density = 0.0
    assert inharmonicity(string, 110.0) == 0.0  # type: ignore[arg-type]


def test_pitches_planes_and_feel_of_a_guitar(guitar: Model) -> None:
    tones = pitches(guitar, ["E2", "G3"])
    counts = {name: guitar.strings[name].n_stops + 1 for name in ("E2", "G3")}
    assert [(p.string, p.stop) for p in tones] == [(n, i) for n in ("E2", "G3") for i in range(counts[n])]
    one = pitch(guitar, "G3", 2)
    assert (one.note, one.wanted_freq) == (57.0, pytest.approx(220.0))
    assert one.error_cents == pytest.approx(1200 * math.log2(one.freq / 220.0))
    assert one.t60 == pytest.approx(math.log(1000) / -one.modes[0].pole.real)
    first = one.planes[0]
    assert (first.freq, first.cents, first.split_cents) == (
        pytest.approx(one.freq),
        pytest.approx(one.error_cents),
        0.0,
    )
    assert first.off_cents == first.cents - first.split_cents
    felt, string = feel(guitar, "E2"), guitar.strings["E2"]
    a, length, T = string.places.pluck, string.length(), string.tension(0.0)
    assert (felt.from_bridge, felt.newton_per_mm) == (a, pytest.approx(1e-3 * T * length / (a * (length - a))))
    angle = guitar.instrument.spec.strings["E2"].break_angle_deg
    assert felt.force_on_bridge == (None if angle is None else pytest.approx(T * math.sin(math.radians(angle))))


def test_partials_of_a_string_are_numbered_from_its_note(guitar: Model) -> None:
    found = partials(guitar, "A2", count=4)
    assert [p.number for p in found] == [1, 2, 3, 4][: len(found)]
    for p in found:
        assert p.cents == pytest.approx(1200 * math.log2(p.freq / (p.number * 110.0)))
        assert abs(p.cents) < 30.0
        assert sum(p.shares) == pytest.approx(1.0, abs=0.05)
    basis = guitar.strings["A2"].bases(0)["A2.z"]
    held = held_partials(basis, 3)
    assert len(held) == 3
    assert held == pytest.approx([110.0, 220.0, 330.0], rel=0.01)


def test_mobility_peaks_and_bands_of_one_resonance() -> None:
    """|Y| of one mode is 1 / (2 m sigma) at its frequency."""
    body = ModalBasis.real(
        [2 * math.pi * 100.0, 2 * math.pi * 400.0], [5.0, 20.0], {"p": [1.0, 1.0]}, modal_mass=[0.5, 0.25]
    )
    fake = SimpleNamespace(strings={}, body=body, body_points={"p": None}, fs=8000.0, groups={})
    peaks = mobility_peaks(fake, "p", count=2)  # type: ignore[arg-type]
    assert [f for f, _ in peaks] == pytest.approx([100.0, 400.0], rel=5e-3)
    assert [y for _, y in peaks] == pytest.approx([1 / (2 * 0.5 * 5.0), 1 / (2 * 0.25 * 20.0)], rel=0.05)
    assert [f for f, _ in mobility_peaks(fake, "p", count=1)] == pytest.approx([100.0], rel=5e-3)  # type: ignore[arg-type]
    assert mobility_peaks(fake, "q") == []  # type: ignore[arg-type]
    freq = np.geomspace(80.0, 120.0, 400)
    size = np.abs(bridge_mobility(fake, freq)["p"])  # type: ignore[arg-type]
    s = 2j * math.pi * freq
    poles = [(2 * math.pi * 100.0, 5.0, 0.5), (2 * math.pi * 400.0, 20.0, 0.25)]
    exact = np.abs(sum(s / (m * (s * s + 2 * r * s + w * w)) for w, r, m in poles))
    np.testing.assert_allclose(size, exact, rtol=1e-6)
    (band,) = mobility_bands(body, ["p", "p"], [80.0, 120.0])
    assert band == pytest.approx(np.mean(20 * np.log10(exact)))


def test_mobility_of_a_guitar_s_strings_is_that_of_their_bridge_points(guitar: Model) -> None:
    freq = np.array([100.0, 200.0])
    found = bridge_mobility(guitar, freq, ["E2"])["E2"]
    np.testing.assert_array_equal(found, guitar.body.frf(freq, "bridge_E2", "bridge_E2"))
    assert set(bridge_mobility(guitar, freq)) == set(guitar.strings)


def test_parameters_without_places_have_none() -> None:
    assert places(Parameters(), 0.65, 0.5) == {}


def test_of_several_notes_at_a_frequency_the_one_nearest_to_equal_steps_counts() -> None:
    """0, 700, 300, 1200 cents: 500 lie between the first two keys and between the last two."""
    tuning = Tuning(Scale("back and forth", (700.0, 300.0, 1200.0)), KeyMap(reference_key=60), 440.0)
    found = tuning.note(440.0 * 2 ** (500 / 1200))
    assert found == pytest.approx(62 + 2 / 9)
    assert tuning.freq(found) == pytest.approx(440.0 * 2 ** (500 / 1200))
    assert tuning.freq(60 + 5 / 7) == pytest.approx(tuning.freq(found))


@pytest.mark.parametrize(
    ("stop", "place", "found"), [(0, None, 0.1), (1, None, 0.09 * 0.9), (0, 0.3, 0.3), (1, 0.09, 0.09), (1, 0.0, 0.0)]
)
def test_the_usual_pluck_is_on_the_string_at_every_stop(stop: int, place: float | None, found: float) -> None:
    stops = SimpleNamespace(length=lambda stop: (0.65, 0.09)[stop], string="E2")
    bases = SimpleNamespace(places=StringPlaces(0.1), tuning=SimpleNamespace(stops=stops))
    assert StringBases._pluck(bases, stop, place) == pytest.approx(found)  # type: ignore[arg-type]
    for beyond in (0.091, -0.001):
        with pytest.raises(ValueError, match=f"string E2 is 0.09 m long at stop 1; {beyond:g} m is not on it"):
            StringBases._pluck(bases, 1, beyond)  # type: ignore[arg-type]


@pytest.mark.parametrize("core", [{"share": 0.4}, {"gauge": 0.4e-3}])
def test_two_of_three_gauges_are_enough(core: dict[str, float]) -> None:
    wrap = {"material": "phosphor_bronze", "gauge": 0.3e-3}
    with pytest.raises(ValueError, match=r"wrap\.gauge: follows from"):
        MadeOf.model_validate({"material": "wound", "gauge": 1e-3, "core": core, "wrap": wrap})


def test_more_modes_than_are_allowed_are_counted_by_the_wave_number(guitar: Model) -> None:
    """EI k^4 + T k^2 = mu (2 pi f)^2 at k = n pi / L."""
    string = guitar.strings["E2"].resonator
    k = (MOST_MODES + 1.5) * math.pi / string.length
    freq = math.sqrt((string.bending_stiffness * k**4 + string.tension * k**2) / string.linear_density) / (2 * math.pi)
    said = f"has some {MOST_MODES + 1} modes below {freq:g} Hz; at most {MOST_MODES} are allowed"
    with pytest.raises(BundleError, match=re.escape(said)):
        string.basis(freq)


def test_places_of_frets_by_tuning_rule_and_list() -> None:
    instrument = SimpleNamespace(
        spec=SimpleNamespace(
            stops=SimpleNamespace(count=3), strings={"a": SimpleNamespace(stops=None), "b": SimpleNamespace(stops=2)}
        ),
        tuning=Tuning(),
        open_note=lambda name: 40.0,
        folder=Path("x"),
    )

    def places(name: str, **keys: object) -> tuple[float, ...]:
        return fretboard._places(instrument, name, keys, 0.65)  # type: ignore[arg-type]

    assert places("a") == pytest.approx([0.65 * (1 - 2 ** (-n / 12)) for n in (1, 2, 3)])
    assert places("b") == pytest.approx([0.65 * (1 - 2 ** (-n / 12)) for n in (1, 2)])
    assert places("b", rule=18.0) == pytest.approx([0.65 / 18, 0.65 * (1 - (17 / 18) ** 2)])
    assert places("b", places=[0.03, 0.06, 0.09]) == (0.03, 0.06)
    for wrong in ([0.03, 0.06], [0.03, 0.06, 0.65]):
        with pytest.raises(BundleError, match=f"has {len(wrong)} frets up to {wrong[-1]:g} m; 3 below 0.65 m"):
            places("a", places=wrong)


@pytest.mark.parametrize(
    ("own", "push", "lowest", "free"),
    [
        (0.0, 0.0, 100.0, 0.0),
        (300.0, 3.0, 400.0, 0.5 * 9.0 / 400.0),
        (-100.0, 3.0, 0.0, 0.0),  # where it is unstable, no rest is near
        (-101.0, 3.0, 0.0, 0.0),
    ],
)
def test_small_motion_of_a_quadratic_potential(own: float, push: float, lowest: float, free: float) -> None:
    """V = own y^2 / 2 + push y of the lower of two modes, of 10 and 30 rad/s; one more does not move."""

    def called(y: np.ndarray) -> tuple[float, np.ndarray]:
        return 0.5 * own * y[1] ** 2 + push * y[1], np.array([0.0, own * y[1] + push, 0.0])

    energy = SimpleNamespace(called=called, stepped=called)
    potential = SimpleNamespace(name="v", effect="one")
    found = _near_rest(potential, energy, np.array([0.0, 100.0, 900.0]))  # type: ignore[arg-type]
    assert (found.name, found.effect, found.freq_modes) == ("v", "one", pytest.approx(10 / (2 * math.pi)))
    assert found.freq == pytest.approx(math.sqrt(lowest) / (2 * math.pi), abs=1e-4)
    assert found.energy == pytest.approx(free, rel=1e-6)
    assert found.wrong is None
    if own and push:
        energy.stepped = lambda y: (called(y)[0], 1.01 * called(y)[1])
        wrong = _near_rest(potential, energy, np.array([0.0, 100.0, 900.0])).wrong  # type: ignore[arg-type]
        assert wrong is not None
        assert (wrong[0], wrong[1]) == (1, pytest.approx(1.01 * wrong[2]))


def exported(basis: ModalBasis, **driven: bool) -> str:
    points = {name: BodyPoint((0.0, 0.6, -0.8), driven=yes) for name, yes in driven.items()}
    return modal_table_text(SimpleNamespace(basis=lambda high: basis, points=lambda: points), "b.csv", 900.0)  # type: ignore[arg-type]


def test_a_table_of_modes_is_sorted_and_tells_its_keys() -> None:
    """Q = omega / (2 sigma); columns of points as the basis has them."""
    omega, q = 2 * math.pi * np.array([200.0, 100.0]), np.array([20.0, 50.0])
    shapes = {"p": [0.5, -2.0], "r": [1.0, 3.0]}
    basis = ModalBasis.real(omega, omega / (2 * q), shapes, modal_mass=1.0)
    residual = np.array([[1e-6, 2e-7], [2e-7, 3e-6]])
    lines = exported(replace(basis, residual=residual), p=True, r=False).splitlines()
    assert lines[:5] == [
        "# body:", "#   plugin: modal_table", "#   table: b.csv", "#   shapes: points",
        "#   truncation: {residual_compliance: [[1e-06, 2e-07], [2e-07, 3e-06]]}",
    ]  # fmt: skip
    assert lines[5:9] == [
        "#   points:", "#     p: {direction: [0, 0.6, -0.8]}", "#     r: {direction: [0, 0.6, -0.8], driven: false}",
        "f_Hz,Q,p,r",
    ]  # fmt: skip
    rows = [[float(cell) for cell in line.split(",")] for line in lines[9:]]
    assert rows == [pytest.approx([100.0, 50.0, -2.0, 3.0]), pytest.approx([200.0, 20.0, 0.5, 1.0])]
    rigid, lossless = (ModalBasis.real([w], [s], {"p": [1.0]}) for w, s in ((0.0, 1.0), (1.0, 0.0)))
    for wrong in (rigid, lossless, ModalBasis.complex([-1.0 + 5.0j], {"p": [1.0 + 1.0j]}, {"p": [1.0 + 0.0j]})):
        with pytest.raises(TonewoodError, match="only real modes with stiffness and loss"):
            exported(wrong, p=True)
