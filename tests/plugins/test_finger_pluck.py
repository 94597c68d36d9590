"""The finger's pluck against its own equations solved by other means, and in the engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plugins.finger_pluck import NAIL, slip
from scipy.integrate import solve_ivp
from tests.plugins.scene import STRING, instrument

import tonewood as tw
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.contract.registry import plugin
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.modal.points import spread
from tonewood.physics.stepping.forcing import SampledForce, course

LENGTH, TENSION, FREQ = 0.65, 70.0, 220.0
IMPEDANCE = TENSION / (2 * LENGTH * FREQ)


def pluck(event: Event | None = None, **values: Any) -> Gesture:
    exciter = plugin("finger_pluck").from_values({"roughness": 0.0, **values})
    assert isinstance(exciter, Exciter)
    return exciter.gesture(event or Event(freq=FREQ), Place("A2", LENGTH, 2, TENSION))


def fall_time(force: float, **values: Any) -> float:
    """From 90 % to 10 % of the force, s."""
    g = pluck(force=force, **values)
    t = np.linspace(0.0, g.stop, 20001)
    f = course(g.segments, t) / force
    return float(t[np.argmax(f < 0.1)] - t[np.argmax(f < 0.9)])


@pytest.mark.parametrize("force", [1e-300, 1e-9, 1e-3])
def test_a_slip_at_forces_near_zero_ends(force: float) -> None:
    """At 1e-9 N the hand that draws the string in 0.02 s needs a day to move its edge past it."""
    g = pluck(force=force, roughness=4e-3)
    assert g.stop < 0.501
    assert g.noise is not None
    assert len(g.noise.values) < 48000


@pytest.mark.parametrize(("force", "mass"), [(0.5, 5e-4), (2.0, 5e-4), (2.0, 5e-5), (4.0, 1.0)])
def test_the_slip_is_that_of_its_equation_of_motion(force: float, mass: float) -> None:
    """u' = v + (F - f) / 2 Z + y', m y'' = F - f - k y, by an adaptive Runge-Kutta method."""
    speed = 0.1

    def rates(_: float, z: Any) -> Any:
        x = min(z[0] / NAIL.edge, 1.0)
        gone = force * (3 * x * x - 2 * x**3)
        return [speed + gone / (2 * IMPEDANCE) + z[2], z[2], (gone - NAIL.stiffness * z[1]) / mass]

    def off(_: float, z: Any) -> float:
        return float(z[0] - NAIL.edge)

    off.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(rates, (0.0, 0.1), [0.0, 0.0, 0.0], events=off, rtol=1e-9, atol=1e-12, dense_output=True)
    end = float(found.t_events[0][0])
    segments = slip(force, IMPEDANCE, speed, NAIL, mass)
    assert segments[-1].stop == pytest.approx(end, rel=0.03)
    t = np.linspace(0.0, end, 400)
    x = np.clip(found.sol(t)[0] / NAIL.edge, 0.0, 1.0)
    # shifted by the rounding of its length to steps
    mine = course(segments, t * segments[-1].stop / end)
    assert np.abs(mine - force * (1 - 3 * x**2 + 2 * x**3)).max() < 0.03 * force


def test_force_and_rate_are_continuous() -> None:
    g = pluck(force=3.0)
    for a, b in zip(g.segments, g.segments[1:], strict=False):
        d = a.stop - a.start
        assert b.start == pytest.approx(a.stop, abs=1e-12)
        assert abs(a.c0 + a.c1 * d + a.c2 * d * d - b.c0) < 1e-9
        assert abs(a.c1 + 2 * a.c2 * d - b.c1) * d < 1e-3 * 3.0


def test_louder_is_shorter_and_flesh_is_longer() -> None:
    """The release lasts in proportion to edge / force."""
    assert fall_time(1.0) / fall_time(4.0) == pytest.approx(4.0, rel=0.05)
    assert fall_time(2.0, edge=4e-4) / fall_time(2.0, edge=2e-4) == pytest.approx(2.0, rel=0.1)
    assert fall_time(2.0, nail=0.0) > 3 * fall_time(2.0, nail=1.0)


def test_the_landing_is_the_strings_resistance_to_the_hands_speed() -> None:
    force, x, stiffness, draw = 2.0, 0.1, 1e4, 0.02
    g = pluck(force=force, from_bridge=x, stiffness=stiffness, draw_time=draw)
    speed = force * (x * (LENGTH - x) / (TENSION * LENGTH) + 1 / stiffness) / draw
    landed = g.start + 4 * IMPEDANCE / stiffness
    assert g.start == -draw
    assert g.force(landed) == pytest.approx(2 * IMPEDANCE * speed)
    assert g.force(0.0) == pytest.approx(force)


def test_the_random_part_is_the_same_for_the_same_note_and_follows_the_force() -> None:
    one, again, other, louder = (
        pluck(roughness=0.01, force=f, seed=s).noise for f, s in ((2.0, 0), (2.0, 0), (2.0, 1), (2.5, 0))
    )
    assert one is not None
    assert again is not None
    assert other is not None
    assert louder is not None
    assert np.array_equal(one.values, again.values)
    assert not np.allclose(one.values, other.values)
    assert abs(np.corrcoef(one.values[:900], louder.values[:900])[0, 1]) < 0.2
    times = one.start + one.interval * np.arange(len(one.values))
    level = course(pluck().segments, times)
    near = level > 0.5
    ratio = one.values[near] / level[near]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(0.01, rel=0.2)
    assert abs(ratio.mean()) < 0.002
    assert pluck(roughness=0.0).noise is None


def test_the_energy_of_a_noisy_pluck_is_accounted_for(tmp_path: Path) -> None:
    made = instrument(tmp_path, exciters={"pluck": {"plugin": "finger_pluck", "from_bridge": 0.2, "roughness": 0.05}})
    audio = tw.render(
        tw.Score([tw.Note(0.05, 0.1, string="S", stop=0, force=2.0)]), made, max_duration=0.1, energy=True
    )
    assert audio.energy is not None
    assert audio.energy.peak > 1e-4
    assert audio.energy.worst_residual < 1e-9


def test_sampled_force_is_what_its_lines_say() -> None:
    """The impulse over all steps is the area under straight lines, whatever the step."""
    values = np.array([0.0, 1.0, -2.0, 3.0, 0.5, 0.0])
    force = SampledForce(-1e-3, 5e-4, values)
    assert force.stop == pytest.approx(1.5e-3)
    area = 5e-4 * values.sum()
    for dt in (1e-5, 2e-6):
        made = force.course(dt, time=0.02, first=0)
        assert made.values[0].sum() * dt == pytest.approx(area, rel=2e-3)
    times = np.array([-2e-3, -0.9e-3, 0.3e-3, 2e-3])
    assert force.rate(times) == pytest.approx((force.at(times + 1e-7) - force.at(times - 1e-7)) / 2e-7)
    assert force.after(0.0).at(np.array([0.25e-3]))[0] == pytest.approx(0.5)
    assert force.course(1e-5, time=0.02, first=2025).start == 2025


@pytest.mark.parametrize("width", [2e-3, 8e-3])
def test_a_contact_of_some_width_is_the_mean_over_it(width: float, tmp_path: Path) -> None:
    """The shape's mean, by a sum over 2001 places."""
    model = assemble(instrument(tmp_path, {**STRING, "freq_upper": 8000.0}), 48000)
    basis = next(iter(model.strings["S"].bases(0, pluck_from_bridge=0.2).values()))
    assert basis.shape is not None
    wide = spread(basis, "pluck", width)
    places = 0.2 + width * (np.arange(2001) - 1000) / 2001
    mean = np.mean([basis.shape(x) for x in places], axis=0)
    scale = np.abs(mean).max()
    assert np.abs(wide.right[wide.index("pluck")].real - mean).max() < 1e-3 * scale
    assert np.abs(basis.shape(0.2) - mean).max() > 2e-3 * scale * (width / 2e-3) ** 2 / 2
