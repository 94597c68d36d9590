"""What plugins attach and do, number by number: clearances, felts, courses of hands, circuits, laws; closed forms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tonewood.plugins.finger_pluck import FLESH, NAIL, roughness, slip
from tonewood.plugins.hammer import _course
from tonewood.plugins.hand_noises import impedance
from tonewood.plugins.magnetic_pickup import field, induced
from tonewood.plugins.modal_radiation import cut_low
from tonewood.plugins.modal_table import _eigen_2x2
from tonewood.plugins.point_pickup import Mean

import tonewood.authoring as ta
from tonewood.errors import BundleError
from tonewood.instrument.contract.attached import Site
from tonewood.instrument.contract.base import BodyPoint, BridgeForce, Scene
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.gestures import Event, Fraction, Gesture, Hold, Place
from tonewood.instrument.contract.registry import plugin
from tonewood.physics.stepping.forcing import Segment, course

Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
STOPS = tuple(0.65 * 2 ** (-k / 12) for k in range(20))


def site(stop: int = 0, planes: Sequence[Any] = (("S.z", Z), ("S.y", Y)), **more: Any) -> Site:
    return Site("S", 0.65, STOPS[stop], STOPS, tuple(planes), **more)


def made(name: str, **values: Any) -> Any:
    return plugin(name).from_values(values)


PLACE = Place("S", 0.65, 2, 70.0)


def at(segments: Sequence[Segment], *times: float) -> list[float]:
    """Values of a course at some times."""
    return [float(x) for x in course(segments, times)]


def test_clearances_over_frets_are_a_line_a_relief_and_single_heights() -> None:
    frets = made("frets", action_first=4e-4, action_twelfth=2e-3, relief=2e-4, heights={"3": 1e-4}, stiffness=5e8)
    open_ = site()
    line = lambda x: 4e-4 + 1.6e-3 * (STOPS[1] - x) / (STOPS[1] - 0.325)  # noqa: E731
    middle = (0.65 + STOPS[19]) / 2
    assert frets.clearance(STOPS[1], open_) == pytest.approx(
        4e-4 + 4 * 2e-4 * (s := (0.65 - STOPS[1]) / (0.65 - STOPS[19])) * (1 - s)
    )
    assert frets.clearance(middle, open_) == pytest.approx(line(middle) + 2e-4)
    attached = frets.attach("frets", open_)
    assert attached.places == {f"frets.{k}": STOPS[k] for k in range(1, 20)}
    third = attached.connections[2]
    assert (third.name, third.terms) == ("S.frets.3", (ta.Term("S.z", "frets.3", 1.0),))
    assert third.law.offset == pytest.approx(-(frets.clearance(STOPS[3], open_) - 1e-4))
    assert (third.law.stiffness, third.law.exponent, third.law.loss) == (5e8, 1.5, 0.5)
    # stopped at 5: frets up to the fifth are out of play, beyond it the string is a line from its crown to the bridge
    stopped = frets.attach("frets", site(5))
    assert {stopped.places[f"frets.{k}"] for k in range(1, 6)} == {0.65}
    assert stopped.places["frets.6"] == STOPS[6]
    lowered = frets.clearance(STOPS[9], open_) - frets.clearance(STOPS[5], open_) * STOPS[9] / STOPS[5]
    assert stopped.connections[8].law.offset == pytest.approx(-max(lowered, 0.0))
    assert frets.attach("frets", site(3)).connections[2].law.offset == 0.0


def test_points_of_a_fingerboard_share_its_stiffness_under_a_line() -> None:
    board = made("fingerboard", end_from_bridge=0.15, action_nut=5e-4, action_end=2.5e-3, points=5, stiffness=1e8)
    attached = board.attach("b", site())
    xs = [0.15 + (i + 0.5) * 0.1 for i in range(5)]
    assert list(attached.places.values()) == pytest.approx(xs)
    offsets = [5e-4 + 2e-3 * (0.65 - x) / 0.5 for x in xs]
    assert [-c.law.offset for c in attached.connections] == pytest.approx(offsets)
    assert {c.law.stiffness for c in attached.connections} == {2e7}
    with pytest.raises(BundleError, match="no board ends there"):
        made("fingerboard", end_from_bridge=0.65, action_nut=0.0, action_end=0.0).attach("b", site())


def test_a_barrier_is_a_parabola_against_the_bridge_with_a_thread() -> None:
    barrier = made(
        "bridge_barrier", start=0.0, stop=0.02, top=0.004, radius=0.5, below=1e-5, points=4, stiffness=1e9,
        thread={"from_bridge": 0.01, "width": 0.004, "points": 2, "stiffness": 1e4, "damping": 2.0},
    )  # fmt: skip
    assert barrier.height(0.014) == pytest.approx(-1e-5 - 0.01**2 / 1.0)
    assert made("bridge_barrier", start=0.0, stop=0.02, stiffness=1.0, below=1e-4).height(0.01) == -1e-4
    attached = barrier.attach("b", site())
    assert list(attached.places.values()) == pytest.approx([0.0025, 0.0075, 0.0125, 0.0175, 0.009, 0.011])
    first, *_, last = attached.connections
    assert first.terms == (ta.Term("S.z", "b.0", 1.0), ta.Term("S.z", "bridge", -1.0))
    assert (first.law.stiffness, first.law.offset) == (2.5e8, pytest.approx(barrier.height(0.0025)))
    assert (last.name, last.law.stiffness, last.law.damping) == ("S.b.thread1", 5e3, 1.0)
    for values in ({"start": 0.02, "stop": 0.02}, {"start": 0.0, "stop": 0.65}):
        with pytest.raises(BundleError, match="is wanted"):
            made("bridge_barrier", stiffness=1.0, **values).attach("b", site())
    with pytest.raises(BundleError, match="lies beyond the string's end"):
        made(
            "bridge_barrier",
            start=0.0,
            stop=0.02,
            stiffness=1.0,
            thread={"from_bridge": 0.001, "width": 0.01, "stiffness": 1.0, "damping": 1.0},
        ).attach("b", site())


def test_a_loose_mass_hangs_on_its_own_spring() -> None:
    ring = made(
        "rattle", from_bridge=0.2, mass=1e-3, clearance=2e-4, freq=8.0, damping_ratio=0.25, stiffness=3e6, direction="y"
    )
    attached = ring.attach("ring", site())
    assert attached.places == {"ring.at": 0.2}
    (mass,) = attached.components.values()
    w = 2 * math.pi * 8.0
    assert (abs(mass.poles[0]), -mass.poles[0].real) == (pytest.approx(w), pytest.approx(0.25 * w))
    assert mass.right[0, 0].real ** 2 == pytest.approx(1e3)
    (contact,) = attached.connections
    assert contact.terms == (ta.Term("S.y", "ring.at", 1.0), ta.Term("S.ring.mass", "mass", -1.0))
    assert (contact.law.offset, contact.law.stiffness, contact.law.exponent) == (-2e-4, 3e6, 1.5)
    with pytest.raises(BundleError, match=r"is 0\.65 m long"):
        made("rattle", from_bridge=0.65, mass=1e-3, clearance=0.0).attach("ring", site())


def test_a_cloth_lies_on_every_plane() -> None:
    cloth = made("listing", from_bridge=0.6, width=0.04, points=2, stiffness=10.0, damping=3.0)
    attached = cloth.attach("c", site())
    assert attached.places == {"c.0": pytest.approx(0.59), "c.1": pytest.approx(0.61)}
    assert [c.terms for c in attached.connections] == [
        (ta.Term(plane, point),) for point in ("c.0", "c.1") for plane in ("S.z", "S.y")
    ]
    assert {(c.law.stiffness, c.law.damping) for c in attached.connections} == {(5.0, 1.5)}
    assert len({c.name for c in attached.connections}) == 4
    for place in (0.02, 0.63):
        with pytest.raises(BundleError, match="does not lie on string S"):
            made("listing", from_bridge=place, width=0.04, damping=1.0).attach("c", site())


def test_felts_of_a_key_s_strings_share_one_head() -> None:
    values = {"mass": 0.01, "stiffness": 1e9, "clearance": 3e-3, "return_freq": 5.0, "return_damping": 0.5}
    hammer = made("hammer", **values)
    alone = hammer.attach("h", site())
    (felt,) = alone.connections
    assert (felt.name, felt.law.offset, felt.law.exponent) == ("S.h.felt", -3e-3, 2.5)
    assert felt.terms == (ta.Term("S.z", "pluck", 1.0), ta.Term("S.h.head", "mass", -1.0))
    assert (alone.resting, alone.inputs) == ((), {"S.h.push": (("S.h.head", "mass", 1.0),)})
    head = alone.components["S.h.head"]
    assert (abs(head.poles[0]), -head.poles[0].real) == (pytest.approx(10 * math.pi), pytest.approx(5 * math.pi))
    other = hammer.attach("h", site(group=("A", "S")))
    assert (other.components, other.inputs, other.resting) == ({}, {}, ("S.h.felt",))
    assert other.connections[0].terms[-1] == ta.Term("A.h.head", "mass", -1.0)
    assert hammer.attach("h", site(group=("S", "A"))).resting == ("S.h.felt",)
    with pytest.raises(BundleError, match="does not move in this direction"):
        made("hammer", direction="x", **values).attach("h", site())


@pytest.mark.parametrize(("velocity", "throw"), [(2.0, 1.5e-3), (4.0, 0.75e-3), (1.0, 1.5e-3)])
def test_a_push_throws_the_hammer_so_that_it_arrives_at_its_time(velocity: float, throw: float) -> None:
    """Impulse m v, way clearance; on the way drag and spring are made up for: the sum of forces is the push alone."""
    values = {"mass": 0.01, "stiffness": 1e9, "clearance": 3e-3, "return_freq": 5.0, "return_damping": 0.5}
    gesture = made("hammer", velocity=velocity, **values).gesture(Event(), PLACE)
    throw = min(throw, 3e-3 / velocity)
    w, m = 10 * math.pi, 0.01
    t = np.linspace(gesture.start, 0.0, 200001)[:-1]
    dt = t[1] - t[0]
    force = course(gesture.segments, t)
    x = v = 0.0
    for f in force[::20]:
        a = f / m - 2 * 0.5 * w * v - w * w * x
        v += 20 * dt * a
        x += 20 * dt * v
    assert v == pytest.approx(velocity, rel=2e-3)
    assert x == pytest.approx(3e-3, rel=5e-3)
    assert gesture.start == pytest.approx(-(throw + (3e-3 - throw * velocity / 2) / velocity))
    still = made("hammer", velocity=0.0, **values).gesture(Event(), PLACE)
    assert (still.force(0.0), still.stop) == (0.0, 1e-3)


def test_a_press_lasts_as_long_as_its_note() -> None:
    values = {"mass": 0.01, "stiffness": 1e9, "press": 2.0, "press_time": 4e-3, "sustain": 0.5, "return_freq": 4.0}
    tangent = made("hammer", **values)
    assert tangent.recovery == pytest.approx(4e-3 + 0.125)
    assert made("hammer", mass=0.01, stiffness=1.0).recovery == 0.0
    for duration, release in ((0.1, 0.1), (math.inf, 0.5), (1e-3, 8e-3)):
        gesture = tangent.gesture(Event({}, 100.0, duration), PLACE)
        assert gesture.stop == pytest.approx(release + 4e-3)
        times = (2e-3, 5e-3, release - 1e-6, release + 2e-3)
        assert [gesture.force(x) for x in times] == pytest.approx([1.0, 2.0, 2.0, 1.0])
    key = tangent.gesture(Event({}, 100.0, 0.1), Place("S", 0.65, 1, 70.0, (("S", 1.0), ("T", 0.0))))
    assert [(m.connection.split(".")[0], m.quantity) for m in key.motions] == [("S", "scale"), ("T", "scale")]
    assert [at(m.segments, 0.0)[0] for m in key.motions] == [1.0, 0.0]
    assert key.motions[0].segments[0].stop == pytest.approx(2.0 / 4.0)


def test_a_foreseen_hammer_slows_by_the_momentum_of_its_felt() -> None:
    """Against an endless string: m (v0 - v) is the integral of the force, integrated here in finer steps."""
    p = made("hammer", mass=0.01, stiffness=1e6, exponent=2.0, velocity=2.0, free_time=4e-3).parameters
    string = Place("S", 0.65, 1, 700.0, (("S", 1.0), ("T", 0.5)))
    times, xs, vs = _course(p, Event({}, 100.0), string, 0.1)
    assert (len(times), times[0], times[-1]) == (33, 0.0, pytest.approx(4e-3))
    speed = 2 * 0.65 * 100.0
    Z_, echo = 700.0 / speed, 2 * 0.1 / speed
    n = 40000
    dt = 4e-3 / n
    x, v, y = 0.0, 2.0, 0.0
    past = np.zeros(n)
    for i in range(n):
        felt = 1e6 * max(x - y, 0.0) ** 2
        past[i] = felt
        k = round(echo / dt)
        slide = (felt - (past[i - k] if i >= k else 0.0)) / (2 * Z_)
        v -= 2 * felt / 0.01 * dt
        x, y = x + v * dt, y + slide * dt
    assert (xs[-1], vs[-1]) == (pytest.approx(x, rel=2e-2), pytest.approx(v, rel=2e-2, abs=2e-2))


def test_a_stroke_grows_lasts_and_vanishes() -> None:
    bow = made("bow", force=2.0, velocity=-0.4, attack_time=0.1, release_time=0.2, sustain=1.5, slide_time=0.05)
    gesture = bow.gesture(Event({}, 100.0, 1.0, 5.0, 3.0), PLACE)
    scale, velocity = gesture.motions
    assert (scale.quantity, velocity.quantity) == ("scale", "velocity")
    assert at(scale.segments, 0.0, 0.05, 0.1, 0.9, 1.1, 1.19999) == pytest.approx(
        [0.0, 1.0, 2.0, 2.0, 1.0, 0.0], abs=1e-6
    )
    assert at(velocity.segments, 0.05, 0.5, 1.1) == pytest.approx([-0.2, -0.4, -0.2])
    assert at(gesture.stops, 0.0, 0.025, 0.0499999) == pytest.approx([3.0, 4.0, 5.0], abs=1e-4)
    assert bow.gesture(Event({}, 100.0, 1.0, 3.0, 3.0), PLACE).stops == ()
    assert bow.gesture(Event({}, 100.0), PLACE).stop == pytest.approx(1.7)
    assert bow.gesture(Event({}, 100.0, 0.01), PLACE).stop == pytest.approx(0.3)
    attached = bow.attach("bow", site())
    (roll,) = attached.components.values()
    p = bow.parameters
    assert roll.stiffness[0] == pytest.approx(1 / (p.roll_compliance * p.roll_mass))
    assert roll.damping_rate[0] == pytest.approx(0.5 * p.roll_impedance / p.roll_mass)
    assert attached.connections[0].terms == (ta.Term("S.y", "pluck", 1.0), ta.Term("S.bow.roll", "mass", 1.0))
    assert attached.resting == ("S.bow.hair",)
    with pytest.raises(BundleError, match=r"must not be less than dynamic, 0\.9"):
        made("bow", static=0.8, dynamic=0.9).attach("bow", site())


def test_a_plectrum_draws_the_string_to_its_force() -> None:
    """The hand moves at its speed but for a smooth beginning; spring and dashpot pull with k (v t) + d v."""
    values = {"force": 3.0, "stiffness": 2000.0, "damping": 0.5, "mass": 5e-5, "speed": 0.2, "leave": 2e-3}
    edge = made("plectrum", **values)
    gesture = edge.gesture(Event(), PLACE)
    compliance = 0.1 * 0.55 / (70.0 * 0.65)
    travel = 3.0 * (1 / 2000.0 + compliance)
    drag = 2 * 0.5 * math.sqrt(2000.0 * 5e-5) * 0.2
    assert gesture.force(-1e-9) == pytest.approx(2000.0 * travel + drag, rel=1e-5)
    assert gesture.force(2e-3 - 1e-9) == pytest.approx(2000.0 * (travel + 0.2 * 2e-3) + drag, rel=1e-4)
    drawn = travel / 0.2
    start = -1.1 * drawn
    assert min(s.start for s in gesture.segments) == pytest.approx(start)
    assert gesture.force(start + 0.1 * drawn) == pytest.approx(drag / 2 + 2000.0 * 0.2 * 0.1 * drawn / 4)
    (pressed,) = gesture.motions
    assert at(pressed.segments, start, -1e-6, 1e-3) == pytest.approx([3.0, 3.0, 1.5])
    assert gesture.start == pytest.approx(start - 0.2 * drawn)
    tip = edge.attach("p", site()).components["S.p.tip"]
    w = math.sqrt(2000.0 / 5e-5)
    assert (abs(tip.poles[0]), -tip.poles[0].real) == (pytest.approx(w), pytest.approx(0.5 * w))


@pytest.mark.parametrize(("freq", "ramp"), [(100.0, 0.02), (25.0, 0.04), (0.0, 0.02)])
def test_a_pluck_ramps_for_a_period_at_least(freq: float, ramp: float) -> None:
    pluck = made("pluck_ramp", force=4.0, release_time=1e-3, angle_deg=30.0, from_bridge={"fraction": 0.25})
    gesture = pluck.gesture(Event({}, freq), PLACE)
    assert (gesture.start, gesture.stop, gesture.angle_deg) == (-ramp, 1e-3, 30.0)
    assert gesture.from_bridge == pytest.approx(0.1625)
    assert [gesture.force(x) for x in (-ramp / 2, 0.0, 5e-4)] == pytest.approx([2.0, 4.0, 2.0])
    assert gesture.hold == Hold(-ramp, -ramp / 2, 0.0, 0.5)
    assert made("pluck_ramp", linear=True).gesture(Event({}, freq), PLACE).hold is None
    assert made("pluck_ramp", hold_dashpot=0.0).gesture(Event({}, freq), PLACE).hold is None


def test_pulses_are_smooth_or_triangles() -> None:
    for shape, quarter in (("smooth", 1.0), ("triangle", 1.0)):
        pulse = made("force_pulse", force=2.0, duration=4e-3, shape=shape).gesture(Event(), PLACE)
        assert [pulse.force(x) for x in (0.0, 1e-3, 2e-3, 3e-3)] == pytest.approx([0.0, quarter, 2.0, quarter])
        assert pulse.stop == 4e-3
    bow = made("force_pulse", force=2.0, duration=4e-3).gesture(Event(), PLACE)
    assert bow.force(0.5e-3) == pytest.approx(2.0 * 2 * 0.25**2)
    assert made("force_pulse", at="body.p").gesture(Event(), PLACE).from_bridge is None


def test_slurs_of_the_left_hand() -> None:
    event = Event({"force": 4.0}, 100.0, 1.0, 5.0, 2.0, 0.6)
    slide = made("left_hand", action="slide").gesture(event, PLACE)
    assert at(slide.stops, -0.15, -0.075, -1e-7) == pytest.approx([2.0, 3.5, 5.0], abs=1e-4)
    assert (slide.start, slide.stop, slide.force(-0.1)) == (-0.15, 0.0, 0.0)
    hammer = made("left_hand", action="hammer_on", share=0.5, angle_deg=20.0).gesture(event, PLACE)
    assert [hammer.force(x) for x in (-3e-3, -2.25e-3, -1.5e-3, -0.75e-3)] == pytest.approx([0.0, 1.0, 2.0, 1.0])
    assert (hammer.from_bridge, hammer.angle_deg) == (0.65, 20.0)
    assert at(hammer.stops, -2e-3, 1.9e-3, 2e-3) == [2.0, 2.0, 0.0]
    off = made("left_hand", action="pull_off", time=0.01).gesture(event, PLACE)
    assert [off.force(x) for x in (-5e-3, 0.0, 1e-4)] == pytest.approx([0.6, 1.2, 0.6])
    assert (off.from_bridge, off.stop) == (0.6, pytest.approx(2e-4))
    far = made("left_hand", action="pull_off").gesture(Event({}, 100.0, length_before=0.9), PLACE)
    assert far.from_bridge == pytest.approx(0.99 * 0.65)
    none = made("left_hand", action="pull_off", from_bridge=0.2).gesture(Event({}, 100.0), PLACE)
    assert (none.from_bridge, none.start) == (0.2, -4e-3)


def test_a_finger_between_flesh_and_nail_goes_in_geometric_steps() -> None:
    for nail in (0.0, 0.5, 1.0):
        tip = made("finger_pluck", nail=nail).parameters.tip
        for name in ("edge", "width", "stiffness"):
            low, high = getattr(FLESH, name), getattr(NAIL, name)
            assert getattr(tip, name) == pytest.approx(low * (high / low) ** nail)
    own = made("finger_pluck", edge=1e-4, width=0.0, stiffness=500.0).parameters.tip
    assert (own.edge, own.width, own.stiffness) == (1e-4, 0.0, 500.0)


def test_a_finger_lands_draws_and_slips() -> None:
    """2 Z v at the landing, within 4 Z / stiffness; then to F; the slip lasts 4 Z edge / F or so."""
    finger = made("finger_pluck", force=3.0, stiffness=5e3, edge=5e-4, width=0.004, roughness=0.0, draw_time=0.03)
    gesture = finger.gesture(Event({}, 200.0), PLACE)
    Zs = 70.0 / (2 * 0.65 * 200.0)
    v = 3.0 * (0.1 * 0.55 / (70.0 * 0.65) + 1 / 5e3) / 0.03
    rise = 4 * Zs / 5e3
    assert [gesture.force(x) for x in (-0.03, -0.03 + rise / 2, -0.03 + rise)] == pytest.approx(
        [0.0, Zs * v, 2 * Zs * v]
    )
    assert gesture.force(-1e-9) == pytest.approx(3.0)
    assert gesture.force((rise - 0.03) / 2) == pytest.approx((2 * Zs * v + 3.0) / 2)
    assert (gesture.start, gesture.width, gesture.noise) == (-0.03, 0.004, None)
    assert gesture.hold == Hold(-0.03, -0.015, 0.0, 0.5)
    assert 0.0 < gesture.stop < 20 * Zs * 5e-4 / 3.0
    near = made("finger_pluck", from_bridge=0.001, width=0.05, roughness=0.0).gesture(Event({}, 200.0), PLACE)
    assert near.width == pytest.approx(0.0065)
    assert slip(0.0, 1.0, 1.0, FLESH, 1e-3) == ()
    loud = made("finger_pluck", force=2.0, linear=True, roughness=0.0)
    one, two = (loud.gesture(Event({"force": f}, 200.0), PLACE) for f in (2.0, 6.0))
    assert [s.c0 for s in two.segments] == pytest.approx([3 * s.c0 for s in one.segments])
    assert [s.start for s in two.segments] == [s.start for s in one.segments]
    assert one.hold is None


def test_a_touching_finger_comes_before_the_pluck_and_leaves_after_it() -> None:
    values = {"touch": {"fraction": 0.5}, "weight": 3.0, "lift": 0.04, "ease": 0.01, "force": 2.0, "width": 0.0}
    finger = made("stopping_finger", **values)
    gesture = finger.gesture(Event({}, 200.0), PLACE)
    assert len(gesture.motions) == 2
    lies = gesture.motions[0].segments
    assert at(lies, -0.03, -0.025, -0.02, 0.039, 0.045, 0.05) == pytest.approx([0.0, 1.5, 3.0, 3.0, 1.5, 0.0])
    assert gesture.touches == {}
    moved = finger.gesture(Event({"touch": 0.2}, 200.0), PLACE)
    (track,) = moved.touches.values()
    assert at(track, -0.03, 0.0) == pytest.approx([0.2, 0.2])
    broad = made("stopping_finger", **{**values, "width": 0.03})
    attached = broad.attach("f", site())
    xs = list(attached.places.values())
    assert np.mean(xs) == pytest.approx(0.325)
    n = len(xs)
    assert xs == pytest.approx([0.325 + 0.03 * ((j + 0.5) / n - 0.5) for j in range(n)])
    assert len(attached.connections) == 2 * n
    assert {round(c.law.stiffness * n, 6) for c in attached.connections} == {300.0}
    going = made("stopping_finger", **{**values, "touch": 0.3, "touch_end": 0.4}).gesture(Event({}, 200.0), PLACE)
    (track,) = going.touches.values()
    assert at(track, -0.03, 0.01, 0.0499999) == pytest.approx([0.3, 0.35, 0.4], abs=1e-4)


def test_wave_impedance_of_strings_known_and_not() -> None:
    assert impedance(Event({}, 100.0), PLACE) == pytest.approx(70.0 / (2 * 0.65 * 100.0))
    assert impedance(Event(), Place("S", 0.5)) == pytest.approx(70.0 / (2 * 0.5 * 200.0))


def test_loss_laws_by_their_equations() -> None:
    w, k = np.array([500.0, 4000.0]), np.array([5.0, 40.0])
    string = ta.StringData(70.0, 4e-3, 6e-5)
    bending = 6e-5 * k**2
    polymer = made("woodhouse", eta_f=1e-3, eta_b=0.02, eta_a=1.5).eta(w, k, string)
    np.testing.assert_allclose(polymer, (70.0 * (1e-3 + 1.5 / w) + bending * 0.02) / (70.0 + bending))
    rates = made("sigma", sigma0=0.5, sigma1=1e-3).eta(w, k, string)
    np.testing.assert_allclose(w * rates / 2, 0.5 + 1e-3 * k**2)
    metal = made("valette", diameter=5e-4, delta_ve=0.01, inverse_q_te=2e-4).eta(w, k, string)
    nu = w / (2 * np.pi)
    R = 2 * np.pi * 1.8e-5 + 2 * np.pi * 5e-4 * np.sqrt(np.pi * 1.8e-5 * 1.2 * nu)
    np.testing.assert_allclose(metal, R / (2 * np.pi * 4e-3 * nu) + 0.01 * bending / 70.0 + 2e-4)


def scene() -> Scene:
    points = {
        "p": BodyPoint(Z, {"heave": 1.0, "u": -0.5}),
        "q": BodyPoint(Z, {"u": 0.25}),
        "r": BodyPoint(Y, driven=False),
    }
    ends = {"S": (("S.z.bridge", (0.0, 0.6, 0.8)), ("S.y.bridge", (0.0, 0.8, -0.6)))}
    string_points = {"S.pluck": (("S.z", "pluck", (0.0, 0.6, 0.8)), ("S.y", "pluck", (0.0, 0.8, -0.6)))}
    forces = (BridgeForce("S.z.bridge", "p", -0.8), BridgeForce("S.z.bridge", "q", -0.2))
    return Scene(points, forces, string_points, ends, 1000.0, None)


def test_pickups_of_points_read_means_directions_and_forces() -> None:
    pair = made(
        "point_pickup",
        quantity="velocity",
        channels={"a": "body.p", "b": {"mean": ["body.p", "S.pluck"]}},
        direction="z",
    )
    assert (pair.channels, pair.unit) == (("a", "b"), "m/s")
    a, b = pair.rows("out", scene()).readouts
    assert (a.name, a.quantity, a.probes) == ("out.a", "velocity", (ta.Term("body", "p", 1.0),))
    factors = [(t.component, t.point, pytest.approx(t.factor)) for t in b.probes]
    assert factors == [("body", "p", 0.5), ("S.z", "pluck", 0.4), ("S.y", "pluck", -0.3)]
    force = made("point_pickup", quantity="force", at="S.bridge", direction="y")
    (row,) = force.rows("f", scene()).readouts
    assert (row.name, row.forces) == ("f.force", (("S.z.bridge", -0.6), ("S.y.bridge", -0.8)))
    for values, said in (
        ({"quantity": "force", "at": "body.p"}, "force can be read at S.bridge"),
        ({"quantity": "velocity", "at": "body.x"}, "there is no point 'body.x'"),
    ):
        with pytest.raises(BundleError, match=said):
            made("point_pickup", **values).rows("x", scene())
    assert Mean(mean=["a"]).mean == ["a"]


def test_a_coil_with_its_load_is_a_divider() -> None:
    """H S = S / (1 + (R + s L) Y) with Y of volume, input, capacitances and the tone control in series."""
    coil = made(
        "magnetic_pickup",
        at="pluck",
        sensitivity=0.2,
        coil={"resistance": 7e3, "inductance": 3.0, "capacitance": 1e-10},
        load={"volume": 5e5, "tone": 1e5, "tone_capacitor": 2e-8, "cable": 6e-10, "input": 2e6},
    )
    freq = np.array([50.0, 1000.0, 4000.0, 12000.0])
    s = 2j * np.pi * freq
    Yl = 1 / 5e5 + 1 / 2e6 + s * 7e-10 + s * 2e-8 / (1 + s * 2e-8 * 1e5)
    np.testing.assert_allclose(coil.circuit().response(freq), 0.2 / (1 + (7e3 + s * 3.0) * Yl), rtol=1e-9)
    (row,) = coil.rows("v", scene()).readouts
    assert [(t.component, t.factor) for t in row.probes] == [("S.z", 0.8), ("S.y", -0.6)]
    four = made(
        "magnetic_pickup", at="S.pluck", gap=3e-3, coil={"resistance": 7e3, "inductance": 3.0, "capacitance": 0.0}
    )
    names = [(r.name, r.quantity) for r in four.rows("v", scene()).readouts]
    assert names == [
        ("v.S.pluck.velocity.z", "velocity"),
        ("v.S.pluck.velocity.y", "velocity"),
        ("v.S.pluck.displacement.z", "displacement"),
        ("v.S.pluck.displacement.y", "displacement"),
    ]
    with pytest.raises(BundleError, match="no string has a point 'x'; there are pluck"):
        made("magnetic_pickup", at="x", coil={"resistance": 1.0, "inductance": 1.0, "capacitance": 0.0}).rows(
            "v", scene()
        )


def test_the_induced_voltage_is_the_rate_of_the_field_s_square() -> None:
    """d/dt B^2 / 2 of both strings re its slope at rest, by differences; unchanged for small motion."""
    gap, radius = 3e-3, 2e-3
    r = np.array([1e-3, 4e-3])
    b, slope = field(r, radius)
    np.testing.assert_allclose(b, 1 - r / np.sqrt(r * r + radius * radius))
    h = 1e-8
    np.testing.assert_allclose(slope, (field(r + h, radius)[0] - field(r - h, radius)[0]) / (2 * h), rtol=1e-6)
    rng = np.random.default_rng(1)
    v, x = rng.normal(size=(4,)), 1e-3 * rng.normal(size=(4,))  # z, y of two strings

    def square(time: float) -> float:
        z1, y1, z2, y2 = x + time * v
        return sum(
            0.5 * float(field(np.array(math.hypot(y, gap + z)), radius)[0]) ** 2 for z, y in ((z1, y1), (z2, y2))
        )

    rest, at_rest = field(np.array(gap), radius)
    expected = (square(1e-9) - square(-1e-9)) / 2e-9 / float(rest * at_rest)
    row = np.array([[v[0], v[1], x[0], x[1], v[2], v[3], x[2], x[3]]])
    assert induced(row, gap, radius)[0, 0] == pytest.approx(expected, rel=1e-4)
    small = induced(np.array([[1.0, 5.0, 0.0, 0.0]]), gap, radius)
    assert small[0, 0] == pytest.approx(1.0)


def test_a_low_cut_multiplies_the_response_by_a_high_pass() -> None:
    poles, residues = np.array([-5.0 + 600.0j, -20.0 + 2000.0j]), np.array([1.0 + 2.0j, -0.5 + 0.3j])
    cut = cut_low(poles, residues, 40.0)
    a, b = 2 * math.pi * 40.0 * 0.8, 2 * math.pi * 40.0 * 1.25

    def response(p: np.ndarray, r: np.ndarray, s: complex) -> complex:
        return complex(np.sum(r / (s - p) + r.conj() / (s - p.conj())))

    for w in (30.0, 250.0, 600.0, 5000.0):
        s = 1j * w
        whole = response(poles, cut[:2], s) + cut[2] / (s + a) + cut[3] / (s + b)
        assert whole == pytest.approx(response(poles, residues, s) * s * s / ((s + a) * (s + b)), rel=1e-9)


def test_eigenvectors_of_small_matrices() -> None:
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(3, 20))
    values, vectors = _eigen_2x2(a, b, c)
    for i in range(20):
        matrix = np.array([[a[i], b[i]], [b[i], c[i]]])
        np.testing.assert_allclose(values[i], np.linalg.eigvalsh(matrix), atol=1e-12)
        np.testing.assert_allclose(matrix @ vectors[i], vectors[i] * values[i], atol=1e-12)
        np.testing.assert_allclose(vectors[i].T @ vectors[i], np.eye(2), atol=1e-12)


def test_the_key_meets_its_felt_with_its_momentum() -> None:
    key = made(
        "key_noise",
        at="body.k",
        velocity=3.0,
        mass=0.2,
        ratio=6.0,
        contact=5e-3,
        travel=0.03,
        lead=4e-3,
        shank_share=0.0,
    )
    gesture = key.gesture(Event(), PLACE)
    start = 0.03 / 3.0 - 4e-3
    assert (gesture.start, gesture.stop) == (pytest.approx(start), pytest.approx(start + 5e-3))
    t = np.linspace(start, start + 5e-3, 20001)
    assert np.trapezoid(course(gesture.segments, t), t) == pytest.approx(-0.2 * 3.0 / 6.0, rel=1e-4)
    rest = made("key_noise", at="body.k", part="rest", speed=0.4, mass=0.2, fall=0.02, contact=4e-3).gesture(
        Event(), PLACE
    )
    t = np.linspace(0.02, 0.024, 20001)
    assert np.trapezoid(course(rest.segments, t), t) == pytest.approx(-0.2 * 0.4, rel=1e-4)
    assert (rest.noise, made("key_noise", at="body.k", velocity=0.0).gesture(Event(), PLACE)) == (None, Gesture(()))
    ring = made("key_noise", at="body.k", velocity=2.0, head=0.01, shank_freq=300.0, shank_loss=0.1, shank_share=0.5)
    noise = ring.gesture(Event(), PLACE).noise
    assert noise is not None
    w, times = 2 * math.pi * 300.0, np.arange(100) / 48000.0
    shape = 0.5 * 0.01 * 2.0 * w * np.exp(-0.1 * w * times) * np.sin(w * times)
    np.testing.assert_allclose(noise.values[:100], shape, atol=1e-12)
    assert len(noise.values) == math.ceil(math.log(1e4) / (0.1 * w) * 48000.0) + 1
    assert noise.values[-1] == 0.0


def test_bodies_of_tables_by_hand(tmp_path: Path) -> None:
    """Shapes over the root of the modal mass; heave and rock at u; a lever moves sideways; compliance of the rest."""
    (tmp_path / "m.csv").write_text("f_Hz,Q,modal_mass,a,b\n100,20,0.25,1,2\n300,30,4,1,-1\n")
    (tmp_path / "h.csv").write_text("f_Hz,zeta,heave,cross,rock\n100,0.02,4,2,1\n")
    (tmp_path / "r.csv").write_text("f_Hz,Q,a,b\n100,20,4,-2\n")

    def body(**values: Any) -> Any:
        return plugin("modal_table").from_values(values, Files(tmp_path))

    masses = body(table="m.csv", shapes="points", points={"a": {}, "x": {"column": "b", "driven": False}}).basis(1000.0)
    assert masses.right[masses.index("x")].real.tolist() == pytest.approx([4.0, -0.5])
    assert masses.natural_freq.tolist() == pytest.approx([100.0, 300.0])
    assert masses.damping_ratio.tolist() == pytest.approx([1 / 40, 1 / 60])
    assert body(table="m.csv", shapes="points", points={"a": {}}).basis(300.0).n_modes == 1
    points = {"l": {"u": -1.0}, "m": {"u": 0.0}, "r": {"u": 0.5}, "top": {"lever": 0.25, "direction": "y"}}
    rocking = body(
        table="h.csv", shapes="heave_rock", points=points, truncation={"residual_compliance": [1e-6, 1e-7, 4e-6]}
    )
    basis = rocking.basis(1000.0)
    # [[4, 2], [2, 1]] is one mode of heave 2 and rocking 1
    assert basis.n_modes == 1
    assert np.abs(basis.right[:, 0].real) == pytest.approx([1.0, 2.0, 2.5, 0.25])
    assert float(basis.right[0, 0].real * basis.right[3, 0].real) < 0.0
    assert rocking.points()["top"].coordinates == {"heave": 0.0, "u": -0.25}
    assert basis.residual[0, 2] == pytest.approx(1e-6 + 1e-7 * (0.5 - 1.0) + 4e-6 * -0.5)
    assert basis.residual[3, 1] == pytest.approx(1e-7 * -0.25)
    driven = body(table="r.csv", shapes="residues", reference="a", points={"a": {}, "b": {}}).basis(1000.0)
    assert driven.right[:, 0].real.tolist() == pytest.approx([2.0, -1.0])


def test_fractions_of_a_string_are_places() -> None:
    half = made("pluck_ramp", from_bridge=Fraction(fraction=0.5)).gesture(Event(), Place("S", 0.4))
    assert half.from_bridge == pytest.approx(0.2)


def smooth(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(3 * x**2 - 2 * x**3)


@pytest.mark.parametrize(
    ("name", "before", "factor", "begin", "place", "angle", "held"),
    [
        ("fretting", 0.65, 0.1, -0.015, 0.5, 180.0, 1.0),  # a finger comes
        ("fretting", 0.4, 0.1 * 0.5, -0.015, 0.99 * 0.4, 90.0, 1.0),  # one leaves: half as hard, beside its stop
        ("fretting", 0.0, 0.1 * 0.5, -0.015, 0.99 * 0.5, 90.0, 1.0),  # nothing was before
        ("touch", 0.65, 0.05, 0.0, None, 180.0, None),
    ],
)
def test_fingers_press_with_twice_the_impedance_times_their_speed(
    name: str, before: float, factor: float, begin: float, place: float | None, angle: float, held: float | None
) -> None:
    """A rise and a fall by 3 x^2 - 2 x^3, 48000 values a second; the skin damps while a finger comes or goes."""
    kind = {"fretting": "fretting_noise", "touch": "touch_noise"}[name]
    found = made(kind, roughness=0.0).gesture(
        Event(freq=100.0, stop=3.0, stop_before=1.0, length_before=before), Place("S", 0.5, 2, 60.0)
    )
    assert (found.segments, found.from_bridge, found.angle_deg) == ((), place, angle)
    assert found.hold == (None if held is None else Hold(begin, begin, 0.0, held))
    time, (rise, fall) = (0.015, (0.25, 0.02)) if name == "fretting" else (0.02, (0.025, 0.975))
    n, share = round(time * 48000), np.linspace(0.0, 1.0, round(time * 48000) + 1)
    assert (found.noise.start, found.noise.interval) == pytest.approx((begin, time / n))
    force = 2 * 60.0 / (2 * 0.5 * 100.0) * factor
    assert found.noise.values == pytest.approx(force * smooth(share / rise) * smooth((1 - share) / fall))
    rough = made(kind, roughness=0.5, hold_dashpot=0.0) if name == "fretting" else made(kind, roughness=0.5)
    other = rough.gesture(Event(freq=100.0, length_before=before), Place("S", 0.5, 2, 60.0))
    assert other.hold is None
    inner = slice(len(share) // 3, -len(share) // 3)
    ratio = other.noise.values[inner] / found.noise.values[inner] - 1.0
    assert 0.4 < ratio.std() < 0.6


def test_roughness_follows_the_force_of_its_segments() -> None:
    """Rising to 2 N in 0.01 s, then 1 N; none at both ends; the same numbers of a seed for all shares."""
    segments = (Segment(-0.01, 0.0, 0.0, 200.0), Segment(0.0, 0.02, 1.0))
    one, twice = roughness(segments, 0.1, 7), roughness(segments, 0.2, 7)
    n = len(one.values) - 1
    assert (one.start, one.interval) == pytest.approx((-0.01, 0.03 / n))
    np.testing.assert_allclose(twice.values, 2 * one.values)
    assert one.values[0] == one.values[-1] == 0.0
    times = -0.01 + np.arange(n + 1) * 0.03 / n
    white = np.random.Generator(np.random.PCG64(7)).standard_normal(n + 1)
    level = np.where(times < -1e-12, 200.0 * (times + 0.01), 1.0)
    inner = [i for i in range(1, n) if abs(times[i]) > 1e-9]  # between the segments either may count
    np.testing.assert_allclose(one.values[inner], (0.1 * level * white)[inner], rtol=1e-9, atol=1e-12)
    assert np.any(roughness(segments, 0.1, 8).values != one.values)
