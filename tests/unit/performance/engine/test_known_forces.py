"""Readouts where a known force acts, with modes left out: their compliance follows the force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
import tonewood.authoring as ta
from tonewood.instrument.contract.gestures import Gesture, smooth_step
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.timeline import Play, Timeline

Floats = NDArray[np.float64]
FS = 48000
LENGTH, TENSION, PLUCKED, READ = 0.9, 58.8, 0.15, 0.155
SLOW, FORCE = 1.0, 2.0


def scene(freq_upper: float, quantity: str, at: float = PLUCKED) -> Model:
    """The monochord's string without bending stiffness, all but rigidly held, read at a place."""
    changes = {
        "strings.A2.bending_stiffness": 0.0,
        "strings.A2.freq_upper": freq_upper,
        "strings.A2.loss": {"law": "sigma", "sigma0": 20.0},
        "strings.A2.end_compliance": 0.0,
        "strings.A2.polarizations": ["z"],
        "strings.A2.points": {"here": {"from_bridge": at}},
        "tuning.compensate": "none",
        "stops.kind": "none",
        "outputs": [{"name": "p", "plugin": "point_pickup", "quantity": quantity, "at": "A2.here", "full_scale": 1.0}],
    }
    return assemble(tw.load_instrument("monochord").replace(changes), FS)


def drawn(model: Model, duration: float) -> Floats:
    """Read while a force grows smoothly to FORCE within SLOW seconds and stays."""
    pull = (*smooth_step(0.0, SLOW, 0.0, FORCE), ta.Segment(SLOW, 10.0, FORCE))
    play = Play(0.0, Gesture(pull, PLUCKED), string="A2")
    return Engine(model, Timeline([], [play])).advance(round(duration * FS / 64))[:, 0]


def static(x: float) -> float:
    """F a (L - x) / (L T) with a the nearer of both places to the bridge, m; a rigid bridge."""
    near, far = min(x, PLUCKED), max(x, PLUCKED)
    return FORCE * near * (LENGTH - far) / (LENGTH * TENSION)


@pytest.mark.parametrize("freq_upper", [1000.0, 4000.0])
@pytest.mark.parametrize("at", [PLUCKED, READ, 0.4])
def test_displacement_under_a_slow_pull_is_the_static_one(freq_upper: float, at: float) -> None:
    model = scene(freq_upper, "displacement", at)
    bridge = model.system.compiled[model.system.slot("body")].basis.static_compliance()[0, 0]
    # the bridge follows the share (L - a) / L of the force, the string's place the share (L - x) / L of the bridge
    moved = FORCE * bridge * (1 - PLUCKED / LENGTH) * (1 - at / LENGTH)
    assert drawn(model, SLOW + 0.5)[-1] == pytest.approx(static(at) + moved, rel=2e-4)


def test_velocity_is_the_rate_of_the_displacement() -> None:
    """Integrated over the pull it gives the displacement; so do two integrations of the acceleration."""
    y, v, a = (drawn(scene(1000.0, quantity), 1.2 * SLOW) for quantity in ("displacement", "velocity", "acceleration"))
    integral = np.cumsum(0.5 * (v[1:] + v[:-1])) / FS
    assert np.abs(integral - y[1:]).max() < 1e-4 * y.max()
    rate = np.cumsum(a)[:-1] / FS
    assert np.abs(rate - v[1:]).max() < 1e-9 * np.abs(v).max()


def test_nothing_is_added_elsewhere_or_after_the_gesture() -> None:
    """The whole basis needs no more than rounding; after the release the sound is that of the modes alone."""
    model = scene(1000.0, "displacement")
    gesture = Gesture(smooth_step(0.0, 0.01, 0.0, FORCE) + smooth_step(0.01, 0.0105, FORCE, 0.0), PLUCKED)
    engine = Engine(model, Timeline([], [Play(0.0, gesture, string="A2")]))
    got = engine.advance(20)[:, 0]
    first = engine.system.slot("A2.z")
    basis = engine.system.compiled[first].basis
    row = 2 * basis.right[basis.index("here")].real
    after = round(0.0105 * FS) + 1
    tail = Engine(model, Timeline([], [Play(0.0, gesture, string="A2")]))
    tail.advance(10)
    assert tail.state.sample > after
    now = float(row @ np.asarray(tail.system.modes_of(tail.state, "A2.z"))[0])
    assert got[tail.state.sample] == pytest.approx(now, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("noisy", [False, True])
def test_a_gesture_of_an_hour_is_computed_as_far_as_it_is_reached(noisy: bool) -> None:
    """F = 1 + 0.002 t - 1e-7 t^2, and lines between 3 and 5 N every second: few numbers at a time, at any time."""
    pull, lines = (1.0, 2e-3, -1e-7), np.tile([3.0, 5.0], 1800)
    noise = ta.SampledForce(0.0, 1.0, lines) if noisy else None
    play = Play(0.3 / FS, Gesture((ta.Segment(0.0, 3600.0, *pull),), PLUCKED, noise=noise), string="A2")
    one = Engine(scene(1000.0, "displacement"), Timeline([], [play]))
    for ticks in (1, 126, 1, 200, 300):
        one.advance(ticks)
        assert sum(i.values.size for i in one.gestures.injections) < 2e5
        one.gestures.reach(one.state.sample + 1)
        (acting,) = (i for i in one.gestures.injections if i.start <= one.state.sample < i.stop)
        t = (one.state.sample - 0.3) / FS
        mean = 3.0 + 2.0 * (t + 0.5 / FS) if noisy else 0.0
        force = [pull[0] + t * (pull[1] + t * pull[2]) + mean, pull[1] + 2 * t * pull[2], pull[2]]
        assert acting.values[:, one.state.sample - acting.start] == pytest.approx(force, rel=1e-12)
    for _ in range(2):  # what was reached is not computed again
        one.gestures.reach(one.state.sample + 20_000)
        starts = [i.start for i in one.gestures.injections]
        assert len(set(starts)) == len(starts) > 2
