"""Rising tension by an auxiliary variable: its direction, its equations, and psi put back."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from nonlinear_scenes import drawn, modulated_guitar

from tonewood import _kernel
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.base import MiddleOfStep
from tonewood.physics.coupling.potentials.coordinates import pay_from_motion
from tonewood.physics.coupling.potentials.solve import RESET_STEPS, PotentialSolve, cut_excess
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, State, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
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
        [f + np.einsum("p,pmx->mx", system.layout.incidence[i].T @ forces, c.W)
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


@pytest.mark.parametrize(("share", "kept"), [(5e-4, 5e-4), (-5e-4, -5e-4), (0.3, 1e-3), (-40.0, -1e-3)])
def test_an_excess_is_cut_to_a_thousandth_where_a_string_is_moved_from_outside(share: float, kept: float) -> None:
    """Of the string's modes alone; not where another string is moved, nor at rest."""
    system, state = moving(10.0, 90)
    at, mine = PotentialSolve(system).active[0], system.potentials[0].components
    value = at.joined.energy(at.y(states(system, state)))
    state.potentials[at.memory.start] = share * value
    before = state.potentials.copy()
    cut_excess(system, state, set(system.potentials[1].components))
    np.testing.assert_array_equal(state.potentials[at.memory], before[at.memory])
    cut_excess(system, state, {mine[-1]})
    assert state.potentials[at.memory] == pytest.approx([kept * value, *before[at.memory][1:]], rel=1e-12)
    state.potentials = np.zeros(0)
    cut_excess(system, state, set(mine))
    assert state.potentials.size == 0


@pytest.mark.parametrize(
    ("steps", "share", "left"), [(90, -0.5, False), (90, 0.5, False), (90, 30.0, True), (2, -0.9, True)]
)
def test_the_kernel_puts_psi_back_at_the_same_cost(steps: int, share: float, left: bool) -> None:
    """An excess of psi^2 / 2 by a share of V, either way, before a step at whose end psi is put back."""
    system, state = moving(10.0, steps)
    state.sample, active = -1, PotentialSolve(system).active[0]
    excess = share * active.joined.energy(active.y(states(system, state)))
    state.potentials[active.memory] = [excess, 0.0, 0.0]
    twin = state.copy()
    NumpyStepper(system).run(twin, 1)
    KernelStepper(system).run(state, 1)
    assert (abs(twin.potentials[active.memory][0]) > 0.1 * abs(excess)) == left
    np.testing.assert_allclose(state.modes, twin.modes, rtol=0, atol=1e-11 * np.abs(twin.modes).max())
    np.testing.assert_allclose(state.potentials, twin.potentials, rtol=1e-9, atol=1e-12 * abs(excess))


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


def chain(n: int, axial_stiffness: float) -> tuple[System, State]:
    """Components of two modes, each with a tension of its own, joined end to end and moving."""
    rng = np.random.default_rng(0)
    components, tensions = {}, []
    for name in (f"c{i}" for i in range(n)):
        omega = 2 * np.pi * np.sort(rng.uniform(200, 5000, 2))
        ends = {"left": rng.normal(size=2), "right": rng.normal(size=2)}
        components[name] = ModalBasis.real(omega, 0.01 * omega, ends, residual=1e-12 * np.eye(2))
        tensions.append(TensionModulation(name, (name,), axial_stiffness, 1.0, {name: rng.uniform(1, 2, 2)}))
    joints = [
        Connection(f"joint{i}", (Term(f"c{i}", "right"), Term(f"c{i + 1}", "left", -1.0))) for i in range(n - 1)
    ]  # fmt: skip
    readouts = [Readout(name, "displacement", (Term(name, "left"),)) for name in ("c0", f"c{n - 1}")]
    system = System.build(components, joints, readouts, dt=1 / 48000, potentials=tensions)
    state = system.start()
    for name in components:
        system.modes_of(state, name)[:] = 0.05 * rng.normal(size=(2, 2))
    return system, state


@pytest.mark.parametrize("isa", _kernel.instruction_sets())
@pytest.mark.parametrize(("axial_stiffness", "off"), [(1e6, 4.7e-6), (1e9, 4.6e-3), (1e12, 0.47)])
def test_many_tensions_are_solved_alike_near_the_diagonal_and_far_from_it(
    isa: str, axial_stiffness: float, off: float
) -> None:
    """`off`: the largest sum beside the diagonal, scaled; it grows over the run."""
    system, state = chain(20, axial_stiffness)
    over, twin, ours = PotentialSolve(system), state.copy(), state.copy()
    x = states(system, state)
    matrix = over.over(x, x, np.zeros(len(system.connections)), state.potentials).matrix
    size = np.sqrt(np.diag(matrix))
    apart = np.abs(matrix / np.outer(size, size)).sum(axis=1).max() - 1
    assert apart == pytest.approx(off, rel=0.02)
    expected, _ = NumpyStepper(system).run(twin, 20)  # neighbours part soon: the strongest are chaotic
    found, _ = KernelStepper(system, isa=isa).run(ours, 20)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
