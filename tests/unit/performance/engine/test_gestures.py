"""Gestures compiled for the steppers: times of partners, noise among known forces, how long a press lasts."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.contract.attached import Motion
from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.player import playing, strokes
from tonewood.performance.player.gestures import Active, courses, places, quasi_static
from tonewood.performance.player.timeline import Play
from tonewood.physics.stepping.forcing import SampledForce, Segment

DT = 1 / 8000


def test_partners_move_at_ends_of_steps_and_press_at_their_middles() -> None:
    """Straight lines: the mean over a step is the value at its middle."""
    ramp = (Segment(0.0, 0.1, 1.0, 30.0),)
    motions = (Motion("a", "velocity", ramp), Motion("b", "offset", ramp), Motion("c", "scale", ramp))
    time = 0.01003
    velocity, offset, scale = courses(Play(time, Gesture((), motions=motions)), DT, 100)
    n = velocity.velocity.size
    assert n == scale.scale.size == offset.offset.size - 1
    assert n > 700
    k = np.arange(100, 400)
    np.testing.assert_allclose(velocity.velocity[:300], 1.0 + 30.0 * ((k + 0.5) * DT - time), rtol=1e-12)
    np.testing.assert_allclose(scale.scale[:300], 1.0 + 30.0 * ((k + 0.5) * DT - time), rtol=1e-12)
    np.testing.assert_allclose(offset.offset[:300], 1.0 + 30.0 * (k * DT - time), rtol=1e-12)


@pytest.mark.parametrize("window", [1, 64, 300])
def test_partners_move_in_windows_as_at_once(window: int) -> None:
    """The windows follow each other to the end of the gesture, and end at multiples of their length."""
    ramp = (Segment(0.0, 0.1, 1.0, 30.0), Segment(0.1, 0.15, 4.0, -9.0, 2.0))
    for quantity in ("velocity", "offset", "scale"):
        play = Play(0.01003, Gesture((), motions=(Motion("a", quantity, ramp),)))
        (whole,), pieces = courses(play, DT, 100), courses(play, DT, 100, window=window)
        while pieces[-1].further:
            pieces.append(pieces[-1].further())
        assert [p.start for p in pieces[1:]] == [p.stop for p in pieces[:-1]]
        assert {p.start % window for p in pieces[1:]} == {0}
        assert max(p.stop - p.start for p in pieces) <= window
        values = [getattr(p, quantity) for p in pieces]
        if quantity == "offset":  # it is known at the beginning of the first step too, and there the pieces meet
            assert all(a[-1] == b[0] for a, b in pairwise(values))
            values = [values[0][:1], *(v[1:] for v in values)]
        np.testing.assert_array_equal(np.concatenate(values), getattr(whole, quantity))


@pytest.mark.parametrize(("quantity", "order"), [("displacement", 0), ("velocity", 1)])
def test_noise_moves_what_is_left_out_as_the_other_forces_do(quantity: str, order: int) -> None:
    """The sum is linear in the force: noise that continues the segments is as good as segments."""
    changes = {
        "strings.A2.freq_upper": 800.0,
        "strings.A2.points": {"here": {"from_bridge": 0.16}},
        "outputs": [{"name": "p", "plugin": "point_pickup", "quantity": quantity, "at": "A2.here", "full_scale": 1.0}],
    }
    model = assemble(tw.load_instrument("monochord").replace(changes), 8000)
    flat, rise = Segment(0.0, 0.02, 1.0), Segment(0.0, 0.02, 1.0, 40.0)
    noise = SampledForce(0.0, 0.01, np.array([0.0, 0.4, 0.8]))

    def added(*segments: Segment, noise: SampledForce | None = None) -> Any:
        gesture = Gesture(segments, 0.15, noise=noise)
        play = Play(0.0, gesture, string="A2")
        return quasi_static([Active(play, 1e9)], model, model.system, 10, 100)

    both, whole, without = added(flat, noise=noise), added(rise), added(flat)
    assert places(Play(0.0, Gesture((flat,), 0.15), string="A2"), model)
    np.testing.assert_allclose(both, whole, rtol=1e-9)
    assert np.abs(both).max() > (1.1 if order == 0 else 10) * np.abs(without).max()


def test_a_press_that_the_next_blow_cuts_short_lasts_half_of_its_note(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tangent needs its recovery before the next blow, but keeps half of the time that it has."""
    durations = []

    def event(*values: Any) -> Any:
        durations.append(values[2])
        return made(*values)

    made = strokes.Event
    monkeypatch.setattr(strokes, "Event", event)
    model = assemble(tw.load_instrument("clavichord"), 16000)
    recovery = model.exciter("tangent", next(iter(model.strings))).recovery
    for apart, held in ((0.1, 0.05), (0.5, 0.5 - recovery)):
        durations.clear()
        notes = [tw.Note(i * apart, apart, note=57, technique="tangent") for i in range(2)]
        playing.perform(tw.Score(notes), model)
        assert durations[0] == pytest.approx(held, rel=1e-6)
