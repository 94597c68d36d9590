"""Steps that the ordinary iteration does not find: the careful search ends at the same forces, or says what it lost."""

from __future__ import annotations

import numpy as np
import pytest
from geometric_scenes import AXIAL, BENDING, TENSION, longitudinal, plucked, transverse
from geometric_scenes import held_string as stretching_string
from nonlinear_scenes import drawn, modulated_guitar

from tonewood.errors import NumericalError
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact, Friction, solve
from tonewood.physics.coupling.potentials.solve import PotentialSolve
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

SOFT = Contact(1e5, 1.0, loss=0.3, offset=-2e-4)
BOWS = (
    Connection("bow", (Term("s1a", "f0"),), Friction(0.3, velocity=0.05)),
    Connection("rosin", (Term("s1a", "f1"),), Friction(0.5, velocity=-0.03)),
)


def run(system, state, n, step=NumpyStepper):
    made = step(system)
    out, forces = made.run(state, n)
    return out, forces, made.statistics


def close(ours, theirs, tolerance):
    assert np.abs(theirs).max() > 0
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * np.abs(theirs).max())


def test_steps_that_the_kernel_loses_are_made_again(monkeypatch):
    """The same motion, bit for bit alike however the run is cut at multiples of 64 samples."""
    system = modulated_guitar(frets=SOFT)
    expected, forces, _ = run(system, drawn(system, 5.0), 192, KernelStepper)
    ordinary, lost = KernelStepper._run, {5, 70, 71, 130}

    def losing(self, state, n, injections, controls):
        first = next((k for k in range(n) if state.sample + k in lost), None)
        if first is None:
            return ordinary(self, state, n, injections, controls)
        state.modes[:] = np.nan
        return first

    monkeypatch.setattr(KernelStepper, "_run", losing)
    out, found, statistics = run(system, drawn(system, 5.0), 192, KernelStepper)
    assert (statistics.redone, statistics.failures, statistics.steps) == (4, 0, 192)
    close(out, expected, 1e-9)
    close(found, forces, 1e-9)
    again, state = KernelStepper(system), drawn(system, 5.0)
    np.testing.assert_array_equal(np.concatenate([again.run(state, 64)[0] for _ in range(3)]), out)


def test_friction_by_newton_is_that_of_going_from_law_to_law(monkeypatch):
    system = modulated_guitar(frets=SOFT, extra=BOWS)
    expected, forces, before = run(system, drawn(system, 5.0), 40)
    monkeypatch.setattr(solve, "MAX_SWEEPS", 2)
    monkeypatch.setattr(solve, "FEW_SWEEPS", 2)
    out, found, statistics = run(system, drawn(system, 5.0), 40)
    assert before.redone == 0
    assert statistics.redone > 10
    close(out, expected, 1e-9)
    close(found, forces, 1e-9)


def stretching(n_modes=None, n_longitudinal=None):
    basis, motion = transverse(n_modes, bending=BENDING, eta=1e-3), longitudinal(n_longitudinal, eta=2e-3)
    return stretching_string(48000.0, ("y", "z"), basis=basis, motion=motion)


@pytest.mark.parametrize("share", [2.0, 10.0])
def test_a_slack_string_loses_energy(share):
    """Compressed by `share` of the stretch by its tension at rest."""
    system = stretching()
    state = plucked(system, 5e-3, ("y", "z"))
    active = PotentialSolve(system).active[0]
    string = active.joined
    views = [system.modes_of(state, name).T for name in system.names]
    motion = system.modes_of(state, system.potentials[0].longitudinal)
    rng = np.random.default_rng(8)
    motion[0] = rng.normal(size=len(motion[0]))
    strain = string.strains @ active.y(views)
    motion[0] *= -share * TENSION / AXIAL / strain[1]
    y = active.y(views)
    lowest = min(
        (string.squares(y) + string.strains @ y) @ wave
        for wave in np.cos(np.outer(np.linspace(0, np.pi, 60), np.arange(len(strain))))
    )
    assert AXIAL * lowest < -TENSION
    made, path = KernelStepper(system), [stored_energy(system, state).total]
    for _ in range(40):
        made.run(state, 10)
        path.append(stored_energy(system, state).total)
    assert np.diff(path).max() <= 1e-12 * path[0]
    assert made.statistics.failures == 0


@pytest.mark.parametrize("make", [NumpyStepper, KernelStepper])
def test_a_step_that_cannot_be_found_is_refused_in_one_line(monkeypatch, make):
    """And the error names string and time."""
    system = modulated_guitar(frets=SOFT)
    monkeypatch.setattr(solve, "newton", lambda laws, Z, free, old, dt, scale, guess, noise: (guess, 1, False))
    if make is KernelStepper:
        monkeypatch.setattr(KernelStepper, "_run", lambda *_: 0)
    made, state = make(system), drawn(system, 5.0)
    with pytest.raises(NumericalError, match=r"^the forces of [^\n]+ were not found at 0\.0+ s$"):
        made.run(state, 10)
    assert made.statistics.failures == 1
