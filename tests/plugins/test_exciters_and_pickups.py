"""Forces of gestures by their integrals and ends; readouts of pickups."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tonewood.errors import BundleError
from tonewood.instrument.contract.base import BodyPoint, Exciter, Scene
from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.contract.registry import plugin
from tonewood.physics.coupling.connections import Term

STRING = Place("G3", 0.65)
NOTE = Event(freq=196.0)


def pluck(event: Event = NOTE, **values: Any) -> Gesture:
    exciter = plugin("pluck_ramp").from_values(values)
    assert isinstance(exciter, Exciter)
    return exciter.gesture(event, STRING)


def pulse(place: Place = STRING, **values: Any) -> Gesture:
    exciter = plugin("force_pulse").from_values(values)
    assert isinstance(exciter, Exciter)
    return exciter.gesture(Event(), place)


def impulse(gesture: Gesture) -> float:
    return sum(s.c0 * (d := s.stop - s.start) + s.c1 * d**2 / 2 + s.c2 * d**3 / 3 for s in gesture.segments)


def steps(gesture: Gesture) -> tuple[float, float]:
    """Largest jump of force, and of its rate times the shortest piece."""
    jump = kink = 0.0
    for a, b in zip(gesture.segments, gesture.segments[1:], strict=False):
        d = a.stop - a.start
        jump = max(jump, abs(a.c0 + a.c1 * d + a.c2 * d * d - b.c0))
        kink = max(kink, abs(a.c1 + 2 * a.c2 * d - b.c1) * d)
    return jump, kink


def test_pluck_releases_on_the_note() -> None:
    g = pluck(force=3.0, ramp_time=0.02, release_time=2e-4)
    assert g.start == -0.02
    assert g.stop == pytest.approx(2e-4)
    assert g.force(-1e-9) == pytest.approx(3.0)
    assert g.force(1e-4) == pytest.approx(1.5)
    assert g.force(-0.01) == pytest.approx(1.5)
    assert g.force(3e-4) == 0.0
    assert impulse(g) == pytest.approx(3.0 * (0.02 + 2e-4) / 2)
    assert max(steps(g)) < 1e-12


def test_a_low_note_is_drawn_for_a_period() -> None:
    assert pluck(Event(freq=30.0), ramp_time=0.02).start == pytest.approx(-1 / 30)


def test_the_finger_only_damps_while_it_holds() -> None:
    g = pluck(hold_dashpot=0.5, ramp_time=0.02)
    assert g.hold is not None
    assert [g.hold.at(t) for t in (-0.021, -0.02, 0.0, 0.1)] == [0.0, 0.0, 0.0, 0.0]
    grown = [g.hold.at(t) for t in np.linspace(-0.02, -1e-6, 40)]
    assert (np.diff(grown) >= 0).all()
    assert grown[-1] == 0.5
    assert pluck(hold_dashpot=0.0).hold is None


def test_an_instant_release() -> None:
    g = pluck(release_time=0.0, force=2.0)
    assert g.stop == 0.0
    assert g.force(-1e-12) == pytest.approx(2.0)


def test_places_and_events() -> None:
    assert pluck(from_bridge=0.1).from_bridge == 0.1
    assert pluck(from_bridge={"fraction": 0.4}).from_bridge == pytest.approx(0.26)
    assert pluck(from_bridge=0.9).from_bridge == pytest.approx(0.99 * 0.65)
    changed = pluck(Event({"force": 1.0, "from_bridge": 0.05, "angle_deg": 90.0}), force=4.0)
    assert (changed.force(-1e-9), changed.from_bridge, changed.angle_deg) == (pytest.approx(1.0), 0.05, 90.0)
    with pytest.raises(BundleError, match="force: is 1000000 N; at most 1000 N is allowed"):
        pluck(Event({"force": 1e6}))
    with pytest.raises(BundleError, match="no_such: is not a known key"):
        pluck(Event({"no_such": 1.0}))


@pytest.mark.parametrize("shape", ["smooth", "triangle"])
def test_pulse(shape: str) -> None:
    g = pulse(force=5.0, duration=1e-3, shape=shape)
    assert impulse(g) == pytest.approx(5.0 * 1e-3 / 2)
    assert g.force(0.5e-3) == pytest.approx(5.0)
    assert g.start == 0.0
    assert g.force(0.25e-3) == pytest.approx(2.5)
    assert steps(g)[0] < 1e-12
    assert (steps(g)[1] < 1e-12) == (shape == "smooth")


def test_pulse_on_the_body_has_no_place_on_a_string() -> None:
    g = pulse(Place("body.p"), at="body.p")
    assert g.from_bridge is None
    with pytest.raises(BundleError, match=r"body\.p is not a string"):
        pulse(Place("body.p"))


Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
TILTED = ((0.0, 0.6, 0.8), (0.0, 0.8, -0.6))
SCENE = Scene(
    body_points={"p": BodyPoint(Z), "q": BodyPoint(Z)},
    bridge_forces=(),
    string_points={"E2.pick": (("E2.z", "pick", TILTED[0]), ("E2.y", "pick", TILTED[1]))},
    end_forces={"E2": (("E2.z.bridge", TILTED[0]), ("E2.y.bridge", TILTED[1]))},
    freq_upper=20000.0,
)


def pickup(**values: Any) -> Any:
    return plugin("point_pickup").from_values(values, key="outputs.x")


def test_mean_of_body_points() -> None:
    p = pickup(quantity="acceleration", at={"mean": ["body.p", "body.q"]})
    (readout,) = p.rows("x", SCENE).readouts
    assert (p.channels, p.unit, readout.quantity) == (("acceleration",), "m/s^2", "acceleration")
    assert readout.probes == (Term("body", "p", 0.5), Term("body", "q", 0.5))


def test_a_string_is_heard_through_both_polarizations() -> None:
    p = pickup(quantity="velocity", channels={"up": "E2.pick", "board": "body.p"})
    up, board = p.rows("x", SCENE).readouts
    assert up.probes == (Term("E2.z", "pick", 0.8), Term("E2.y", "pick", -0.6))
    assert (up.name, board.name) == ("x.up", "x.board")
    (side,) = pickup(quantity="displacement", at="E2.pick", direction="y").rows("x", SCENE).readouts
    assert side.probes == (Term("E2.z", "pick", 0.6), Term("E2.y", "pick", 0.8))


def test_force_of_a_string_on_its_bridge() -> None:
    (readout,) = pickup(quantity="force", at="E2.bridge").rows("x", SCENE).readouts
    assert readout.forces == (("E2.z.bridge", -0.8), ("E2.y.bridge", 0.6))


def test_pickup_faults() -> None:
    with pytest.raises(BundleError, match=r"outputs\.x: there is no point 'body\.r'; there are body\.p, body\.q, E2"):
        pickup(quantity="velocity", at="body.r").rows("x", SCENE)
    with pytest.raises(BundleError, match=r"force can be read at E2\.bridge; not at 'body\.p'"):
        pickup(quantity="force", at="body.p").rows("x", SCENE)
    with pytest.raises(BundleError, match="either `at` or `channels` is wanted"):
        pickup(quantity="velocity")
    with pytest.raises(BundleError, match="quantity"):
        pickup(quantity="smell", at="body.p")


@pytest.mark.parametrize(
    ("name", "jump"),
    [
        ("pluck_ramp", 0.0), ("finger_pluck", 0.0), ("force_pulse", 0.0), ("bow", 0.0), ("stopping_finger", 0.0),
        ("plectrum", 0.01),  # the hand stops at once when the tip is free
    ],
)  # fmt: skip
def test_forces_and_motions_of_a_hand_begin_and_end_at_zero_and_do_not_jump(name: str, jump: float) -> None:
    exciter = plugin(name).from_values({})
    assert isinstance(exciter, Exciter)
    for event in (Event(freq=220.0, duration=0.5), Event(freq=30.0, duration=0.02)):
        gesture = exciter.gesture(event, Place("A2", 0.65, 2, 70.0))
        courses = [course for course in (gesture.segments, *(m.segments for m in gesture.motions)) if course]
        assert courses
        assert min(course[0].start for course in courses) == gesture.start
        for course in courses:
            ends = [s.c0 + s.c1 * (s.stop - s.start) + s.c2 * (s.stop - s.start) ** 2 for s in course]
            most = max(map(abs, ends))
            assert most > 0
            assert course[0].c0 == 0.0
            assert abs(ends[-1]) < 1e-12 * most
            for end, one, other in zip(ends, course, course[1:], strict=False):
                assert other.start == pytest.approx(one.stop, abs=1e-12)
                assert abs(other.c0 - end) <= max(jump, 1e-12) * most
