"""The hammer against closed forms: a spring-faced mass on an endless string."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scene import instrument, play

import tonewood as tw

MASS, STIFFNESS, SPEED = 5e-4, 4e3, 1.5
HAMMER = {
    "plugin": "hammer", "from_bridge": 1.0, "velocity": SPEED, "mass": MASS, "stiffness": STIFFNESS, "exponent": 1.0,
    "clearance": 1e-3, "throw_time": 5e-4, "return_freq": 0.1, "return_damping": 0.0,
}  # fmt: skip
#: so long that reflections from the ends come too late: the hammer meets an impedance of 2 Z
LONG = {"length": 2.0, "note": None, "freq": 36.0, "bending_stiffness": 0.0, "freq_upper": 20000.0}


def test_contact_with_an_endless_string(tmp_path: Path) -> None:
    """m y'' = -F, F = K (y - u), u' = F / 2Z:  F'' + (K / 2Z) F' + (K / m) F = 0, F(0) = 0, F'(0) = K v."""
    played = play(instrument(tmp_path, LONG, exciters={"hammer": HAMMER}), duration=0.004)
    force = played.forces["S.hammer.felt"]
    touched = np.flatnonzero(force > 0)
    Z = np.sqrt(73.9 * 3.61e-3)
    decay = STIFFNESS / (4 * Z)
    omega = np.sqrt(STIFFNESS / MASS - decay**2)
    duration = np.pi / omega
    assert (touched[-1] - touched[0] + 1) * played.system.dt == pytest.approx(duration, rel=0.02)
    # forces are means over a step; the hammer comes at the note's time
    t = played.time + 0.5 * played.system.dt
    assert abs(t[touched[0]]) < 2.1e-5
    tau = np.clip(t, 0, duration)
    exact = STIFFNESS * SPEED / omega * np.exp(-decay * tau) * np.sin(omega * tau)
    assert np.abs(force - exact).max() < 0.03 * exact.max()
    # momentum that the string keeps: the mass leaves with v - (impulse) / m
    assert np.sum(force) * played.system.dt == pytest.approx(np.trapezoid(exact, t), rel=2e-3)


@pytest.mark.parametrize("speed", [0.3, 1.5])
def test_its_suspension_takes_nothing_from_its_velocity(tmp_path: Path, speed: float) -> None:
    """However it is hung it comes at the note's time as fast as it should: F = K v t at first."""
    first = {}
    for freq, ratio in ((0.1, 0.0), (10.0, 1.0)):
        hammer = {**HAMMER, "velocity": speed, "return_freq": freq, "return_damping": ratio}
        played = play(instrument(tmp_path, LONG, exciters={"hammer": hammer}), duration=0.001)
        force = played.forces["S.hammer.felt"]
        assert abs(played.time[force > 0][0]) < 2.2e-5
        first[freq] = force[(played.time > 1e-5) & (played.time < 1.3e-4)]
    np.testing.assert_allclose(first[10.0], first[0.1], rtol=0.02)


def test_the_driver_pays_for_everything(tmp_path: Path) -> None:
    """Energy of string and hammer is the work of the push less the losses, step by step."""
    hammer = {**HAMMER, "exponent": 2.5, "stiffness": 1e8, "loss": 0.3, "from_bridge": 0.1}
    played = play(instrument(tmp_path, exciters={"hammer": hammer}), duration=0.03, energy=True)
    trace = played.energy
    assert trace is not None
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < 1e-9
    supplied = sum(values.sum() for values in trace.supplied.values())
    assert supplied == pytest.approx(0.5 * MASS * SPEED**2, rel=1e-3)
    for values in trace.lost.values():
        assert values.min() >= -1e-12 * supplied


def test_a_pressed_tangent_stays(tmp_path: Path) -> None:
    """It rests on the string with the pressing force, and lets go when the note ends."""
    tangent = {**HAMMER, "velocity": 0.3, "press": 1.2, "from_bridge": 0.3, "return_freq": 2.0, "return_damping": 0.7,
               "loss": 1.0}  # fmt: skip
    string = {"loss": {"law": "sigma", "sigma0": 25.0, "sigma1": 1e-4}}
    played = play(instrument(tmp_path, string, exciters={"hammer": tangent}), duration=0.6, held=0.4)
    force = played.forces["S.hammer.felt"]
    pressed = force[(played.time > 0.3) & (played.time < 0.38)]
    # less the return spring's share: k (clearance + sag of string and felt)
    sag = 1e-3 + 1.2 * (0.3 * 0.35 / (0.65 * 73.9) + 1 / STIFFNESS)
    assert pressed.mean() == pytest.approx(1.2 - MASS * (2 * np.pi * 2.0) ** 2 * sag, rel=2e-2)
    assert not force[played.time > 0.55].any()


def test_a_tangent_strikes_again_at_once() -> None:
    """Notes that follow each other without a gap are as loud as the first: the key rises in between."""
    notes = [tw.Note(0.25 * i, 0.25, note=57, velocity_midi=90) for i in range(3)]
    sound = tw.render(tw.Score(notes), tw.load_instrument("clavichord"), fs=24000, max_duration=0.75).samples[:, 0]
    level = [20 * np.log10(sound[int(t * 24000) : int((t + 0.1) * 24000)].std()) for t in (0.0, 0.25, 0.5)]
    assert np.ptp(level) < 3
