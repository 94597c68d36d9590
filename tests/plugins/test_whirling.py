"""Both polarizations share one tension: the plane of a hard pluck turns, and energy never rises, however hard it is.

In one mode the two coordinates obey z'' + omega0^2 z + eps |z|^2 z = 0, z = x + i y, with
omega0^2 = (T p^2 + EI p^4) / mu and eps = EA p^4 / 4 mu. Of z = R e^(i w t) + L e^(-i w t) the two circles turn at
omega0 + eps (|R|^2 + 2 |L|^2) / 2 omega0 and the same with R and L exchanged, so that an ellipse of half axes a, b
precesses at eps a b / 4 omega0 against its sense of turning.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray
from scene import instrument, play
from test_tension_modulated_string import STEEL

from tonewood.instrument.model.assembly import Model, assemble
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion

Floats = NDArray[np.float64]
P, DENSITY = np.pi / STEEL["length"], STEEL["linear_density"]
OMEGA = np.sqrt((STEEL["tension"] * P**2 + STEEL["bending_stiffness"] * P**4) / DENSITY)
EPS = STEEL["axial_stiffness"] * P**4 / (4 * DENSITY)
#: samples per second, and from one to the next that is looked at
FS, STEP = 16000, 4


def turned(a: float, b: float, seconds: float, folder: Path) -> tuple[Floats, Floats]:
    """Fundamental (n, 2) of an ellipse of half axes a and b (m) let go, and the energy each 64 steps."""
    two = {**STEEL, "polarizations": ["z", "y"], "split_cents": 0.0, "tilt_deg": 0.0, "freq_upper": 250.0}
    model: Model = assemble(instrument(folder, two), FS)
    state, stepper, rows, out, energy = model.system.start(), KernelStepper(model.system), {}, [], []
    for component, place, speed in (("S.z", a, 0.0), ("S.y", 0.0, b * OMEGA)):
        basis = model.system.compiled[model.system.slot(component)].basis
        vec, sine = cast(Floats, basis.metadata["vec"]), np.zeros(basis.n_modes)
        sine[1] = 1.0
        unit = sla.solve(vec, sine)
        model.system.modes_of(state, component)[:] = from_motion(basis, place * unit, speed * unit)
        rows[component] = (basis, vec[1])
    for i in range(0, int(seconds * FS), STEP):
        out.append([row @ to_motion(b, model.system.modes_of(state, c))[0] for c, (b, row) in rows.items()])
        if i % 64 == 0:
            energy.append(stored_energy(model.system, state).total)
        stepper.run(state, STEP)
    assert stepper.statistics.failures == 0
    return np.array(out), np.array(energy)


def axis(xy: Floats, start: float) -> float:
    """Direction of the longest diameter over some periods from `start` (s), radians."""
    n, first = round(8 * 2 * np.pi / OMEGA * FS / STEP), int(start * FS / STEP)
    z = xy[first : first + n] @ [1, 1j]
    return 0.5 * float(np.angle(np.sum(z**2)))


@pytest.mark.slow
@pytest.mark.parametrize("sense", [1, -1])
def test_an_ellipse_precesses(tmp_path: Path, sense: int) -> None:
    """At the closed form's rate, and as an independent solution of the two equations does."""
    from scipy.integrate import solve_ivp

    a, b, seconds = 2e-3, sense * 0.5e-3, 1.0
    xy, energy = turned(a, b, seconds + 0.15, tmp_path)
    rate = (axis(xy, seconds) - axis(xy, 0.0)) / seconds
    assert rate == pytest.approx(-EPS * a * b / (4 * OMEGA), rel=0.01)
    # a trace of it goes into the all but rigid body
    assert np.all(np.diff(energy) < 1e-9 * energy[0])
    assert energy[-1] > (1 - 1e-6) * energy[0]

    def exact(_: float, s: Floats) -> Floats:
        return np.concatenate([s[2:], -(OMEGA**2 + EPS * (s[:2] @ s[:2])) * s[:2]])

    time = np.arange(len(xy)) * STEP / FS
    there = solve_ivp(exact, (0, time[-1]), [a, 0, 0, b * OMEGA], t_eval=time, rtol=1e-10, atol=1e-14, method="DOP853")
    found = there.y[:2].T
    assert (axis(found, seconds) - axis(found, 0.0)) / seconds == pytest.approx(rate, rel=3e-3)


def test_a_flat_motion_stays_flat(tmp_path: Path) -> None:
    xy, _ = turned(2e-3, 0.0, 0.2, tmp_path)
    assert not xy[:, 1].any()


def hard(folder: Path, **string: Any) -> Any:
    """A slack, limp string with 190 modes and more below 21 kHz in each of two polarizations."""
    values = {**STEEL, "length": 0.65, "tension": 44.0, "bending_stiffness": 1e-6, "freq_upper": 22050.0,
              "polarizations": ["z", "y"],
              "tilt_deg": 20.0, "loss": {"law": "sigma", "sigma0": 0.5, "sigma1": 1e-4}, **string}  # fmt: skip
    return instrument(folder, values)


def test_190_modes_and_1000_newtons(tmp_path: Path) -> None:
    """Released at 1000 N, far beyond the strength of any string: the energy budget closes, step by step."""
    made = hard(tmp_path)
    assert assemble(made, 48000).strings["S"].n_modes() >= 190
    played = play(made, {"force": 1000.0}, duration=0.02, energy=True)
    trace = played.energy
    assert trace is not None
    assert trace.worst_residual < 1e-9
    free = trace.total[trace.time > 2.5e-4]
    assert np.all(np.diff(free) <= 1e-11 * trace.peak)


@pytest.mark.validate
def test_a_million_steps(tmp_path: Path) -> None:
    """20 s after 1000 N, with very small losses: energy, looked at each 500 steps, never rises."""
    made = hard(tmp_path, loss={"law": "sigma", "sigma0": 0.02, "sigma1": 1e-6})
    model = assemble(made, 48000)
    state, stepper = model.system.start(), KernelStepper(model.system)
    for component, force in (("S.z", 1000.0), ("S.y", 300.0)):
        basis = model.system.compiled[model.system.slot(component)].basis
        vec = cast(Floats, basis.metadata["vec"])
        k = np.arange(1, len(vec)) * np.pi / 0.65
        # the bridge at rest, the string drawn aside 0.2 m from it
        bent = np.concatenate([[0.0], 2 / 0.65 * force * np.sin(0.2 * k) / (44.0 * k**2)])
        q = sla.solve(vec, bent)
        model.system.modes_of(state, component)[:] = from_motion(basis, q, np.zeros_like(q))
    energy = [stored_energy(model.system, state).total]
    for _ in range(2000):
        stepper.run(state, 500)
        energy.append(stored_energy(model.system, state).total)
    assert stepper.statistics.failures == 0
    assert np.all(np.diff(energy) <= 1e-12 * energy[0])
    assert 0 < energy[-1] < energy[0]
