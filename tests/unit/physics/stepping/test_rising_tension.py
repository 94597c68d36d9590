"""Rising tension by an auxiliary variable: its direction, its equations, and psi put back."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from nonlinear_scenes import drawn, modulated_guitar

from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.base import MiddleOfStep
from tonewood.physics.coupling.potentials.coordinates import pay_from_motion
from tonewood.physics.coupling.potentials.solve import RESET_STEPS, PotentialSolve
from tonewood.physics.coupling.system import State, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

FRETS = Contact(1e7, 1.5, loss=0.2, offset=-2e-4)


def states(system: System, state: State):
    return [system.modes_of(state, name).T.copy() for name in system.names]


def moving(height: float, steps: int) -> tuple[System, State]:
    """Strings some time after they were let go."""
    system = modulated_guitar(frets=FRETS)
    state = drawn(system, height)
    NumpyStepper(system).run(state, steps)
    return system, state


def test_the_direction_is_the_gradient_of_psi() -> None:
    """Against central differences of sqrt(2 V), where nothing moves and no tension is counted on."""
    system, state = moving(1.0, 40)
    active, x = PotentialSolve(system).active[0], states(system, state)
    y = active.y(x)
    g = active.joined.direction(MiddleOfStep(y, y, active.compliance, 0.0, 0.0))
    step = 1e-4 * np.abs(y).max()
    for k in (0, 3, 11, active.n - 1):
        up, down = (np.sqrt(2 * active.joined.energy(y + sign * step * np.eye(active.n)[k])) for sign in (1, -1))
        assert g[k] == pytest.approx((up - down) / (2 * step), rel=1e-7, abs=1e-9 * np.abs(g).max())


@pytest.mark.parametrize("height", [0.1, 10.0, 300.0])
def test_the_matrix_is_at_least_one_and_its_means_fulfil_the_step(height: float) -> None:
    """M >= I; psi+ - psi = g . (y+ - y) for the motion that the means make, with the linear connections' forces."""
    system, state = moving(height, 70)
    solve, linear, x = PotentialSolve(system), system.solve, states(system, state)
    free = [np.einsum("mab,mb->ma", c.E, xi) for c, xi in zip(system.compiled, x, strict=True)]
    alone = linear.constant - linear.G @ (system.gaps(free) + linear.gamma * system.gaps(x))
    over = solve.over(x, free, alone, state.potentials)
    np.testing.assert_allclose(over.matrix, over.matrix.T, atol=1e-12 * np.abs(over.matrix).max())
    assert sla.eigvalsh(over.matrix).min() >= 1 - 1e-9
    mean = over.mean(alone)
    forces = alone - linear.G @ (over.reach @ mean)
    np.testing.assert_allclose(over.mean_under(forces), mean, rtol=1e-9)
    after = over.after(
        [f + np.einsum("p,pmx->mx", system.incidence(i).T @ forces, c.W)
         for i, (f, c) in enumerate(zip(free, system.compiled, strict=True))],
        mean,
    )  # fmt: skip
    psi = np.sqrt(2 * solve.energies(x, state.potentials))
    for q, p in enumerate(solve.active):
        way = sum(over.modal[i][1] @ (part.reading * (after[i][:, 0] - x[i][:, 0])) for i, part, _ in p.places)
        assert 2 * (mean[q] - psi[q]) == pytest.approx(way, rel=1e-8, abs=1e-12 * psi[q])


@pytest.mark.parametrize(("share", "left"), [(1e-3, False), (-1e-3, False), (30.0, True), (-1.0, False)])
def test_psi_is_put_back_at_the_cost_of_motion(share: float, left: bool) -> None:
    """Energy and displacements stay; more than a quarter of the kinetic energy is not asked for at once."""
    system, state = moving(10.0, 90)
    active, x = PotentialSolve(system).active[0], states(system, state)
    y, root = active.y(x), float(np.sqrt(2 * active.joined.energy(active.y(x))))
    psi, kinetic = (1 + share) * root, lambda: active.energy(x)
    before = kinetic() + 0.5 * psi * psi
    row = active.joined.end(y, 0.0, psi, kinetic, lambda cost: active.pay(x, cost))
    stored = active.joined.stored(y, row)
    assert (stored == pytest.approx(0.5 * root * root, rel=1e-12)) == (not left)
    assert kinetic() + stored == pytest.approx(before, rel=1e-12)
    np.testing.assert_array_equal(active.y(x), y)


def test_nothing_moves_modes_at_rest() -> None:
    system = modulated_guitar(frets=FRETS)
    active, x = PotentialSolve(system).active[0], states(system, system.start())
    assert active.pay(x, -0.3) == 0.0
    assert pay_from_motion([], [], 1.0) == 0.0
    assert not any(m.any() for m in x)


@pytest.mark.parametrize("cuts", [(RESET_STEPS,), (17,), (64, 5, 100), (1, 63, 64)])
def test_cuts_of_a_run_change_nothing_but_rounding(cuts: tuple[int, ...]) -> None:
    """psi is put back at samples counted from time 0, also where a run begins between two of them."""
    system = modulated_guitar(frets=FRETS)
    whole, pieces = drawn(system, 5.0), drawn(system, 5.0)
    for state in (whole, pieces):
        state.sample = -37
    expected, _ = KernelStepper(system).run(whole, 256)
    stepper, found, done, i = KernelStepper(system), [], 0, 0
    while done < 256:
        n = min(cuts[i % len(cuts)], 256 - done)
        found.append(stepper.run(pieces, n)[0])
        done, i = done + n, i + 1
    np.testing.assert_allclose(np.concatenate(found), expected, atol=1e-9 * np.abs(expected).max())
    total = stored_energy(system, whole).total
    assert stored_energy(system, pieces).total == pytest.approx(total, rel=1e-9)
