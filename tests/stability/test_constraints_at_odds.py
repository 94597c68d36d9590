"""Rigid joints that repeat, nearly repeat or contradict each other, points without mass, torn joints.

The joints allow the motion asked for; forces may be shared in any way.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from scenes import energies, guitar

from assembled import Part, chain, connect, held_force, joined, merged, motion_readouts, poles_of, run_held, step_map
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, share_velocities

DT = 1e-4
UNDAMPED = {"mass_damping": 0.0, "stiffness_damping": 0.0}
PARTS = {"a": chain(3, seed=1, **UNDAMPED), "b": chain(4, seed=2, **UNDAMPED)}
JOINT = np.array([0, 0, 1.0, -1.0, 0, 0, 0])
OTHER = np.array([0, 1.0, 0, 0, -1.0, 0, 0])
STEPS = 2000


def system_of(gaps, laws=None, residual=0.0):
    laws = laws or [Rigid()] * len(gaps)
    bases = {}
    for name, part in PARTS.items():
        basis = part.real_basis()
        shapes = dict(zip(basis.points, basis.right.real, strict=True))
        bases[name] = ModalBasis.real(
            np.sqrt(basis.stiffness), basis.damping_rate, shapes, residual=residual * np.eye(part.n)
        )
    links = [connect(f"c{j}", PARTS, row, law) for j, (row, law) in enumerate(zip(gaps, laws, strict=True))]
    return System.build(bases, links, motion_readouts(PARTS), dt=DT)


def pushed(system, steps=STEPS):
    """Displacements after a kick on the first mass."""
    kick = held_force(system.compiled[0].basis, "a", "n0", [1.0, 2.0, 1.0], DT)
    stepper = KernelStepper(system)
    out, forces = stepper.run(stepper.start(), steps, [kick])
    return out[:, :7], forces


@pytest.mark.parametrize("residual", [0.0, 1e-8])
@pytest.mark.parametrize("copies", [[JOINT, JOINT], [JOINT, OTHER, JOINT - OTHER, 3 * JOINT + OTHER], [JOINT] * 9])
def test_redundant_joints_change_nothing(copies, residual):
    """Motion is that of the joints counted once, to 1e-9; forces stay finite and of one size."""
    once = [JOINT] if all(np.array_equal(c, JOINT) for c in copies) else [JOINT, OTHER]
    u, forces = pushed(system_of(copies, residual=residual))
    expected, needed = pushed(system_of(once, residual=residual))
    assert np.abs(u - expected).max() < 1e-9 * np.abs(expected).max()
    assert np.abs(forces).max() <= 2 * np.abs(needed).max()


@pytest.mark.parametrize("offset", [1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 1e-15])
def test_nearly_redundant_joints_neither_tear_nor_explode(offset):
    """Two joints that differ by a little of a third: energy is kept after the kick, and each gap stays closed."""
    system = system_of([JOINT, JOINT + offset * OTHER])
    kick = held_force(system.compiled[0].basis, "a", "n0", [1.0, 2.0, 1.0], DT)
    stepper, state = KernelStepper(system), system.start()
    stepper.run(state, 3, [kick])
    account = EnergyAccount(system, state)
    E = [sum(account.stored(state).values())]
    for _ in range(20):
        out, _ = stepper.run(state, 100)
        E.append(sum(account.stored(state).values()))
        gaps = out[:, :7] @ np.array([JOINT, JOINT + offset * OTHER]).T
        assert np.abs(gaps).max() < 1e-6 * np.abs(out[:, :7]).max()
    assert np.abs(np.array(E) / E[0] - 1).max() < 1e-6


def test_contradicting_joints_converge_on_the_middle():
    """The same gap asked to be 1 mm and 3 mm: it is 2 mm, and stays there."""
    system = system_of([JOINT, JOINT], [Rigid(1e-3), Rigid(3e-3)])
    out, forces = KernelStepper(system).run(system.start(), STEPS)
    np.testing.assert_allclose(out[1:, :7] @ JOINT, 2e-3, rtol=1e-9)
    assert np.all(np.isfinite(forces))


def test_more_joints_than_motion():
    """Nine joints over seven masses: everything is held, and a push moves nothing."""
    rng = np.random.default_rng(4)
    system = system_of(list(rng.normal(size=(9, 7))))
    u, forces = pushed(system, 200)
    free, _ = pushed(system_of([JOINT]), 200)
    assert np.abs(u).max() < 1e-9 * np.abs(free).max()
    assert np.all(np.isfinite(forces))


def test_joint_of_a_point_that_does_not_move():
    """All shapes zero there: it is a wall, for one part; between two such points nothing happens at all."""
    still = ModalBasis.real([500.0, 900.0], [1.0, 1.0], {"n0": [0.0, 0.0], "n1": [1.0, 1.0]})
    part = chain(1, seed=3)
    wall = Connection("c", (Term("a", "n0"), Term("b", "n0", -1.0)))
    readouts = [Readout(n, "displacement", (Term(n, p),)) for n, p in (("a", "n0"), ("b", "n1"))]
    system = System.build({"a": part.real_basis(), "b": still}, [wall], readouts, dt=DT)
    stepper = KernelStepper(system)
    out, _ = stepper.run(stepper.start(), 100, [held_force(system.compiled[0].basis, "a", "n0", [1.0], DT)])
    assert np.abs(out).max() < 1e-20
    none = System.build({"a": still, "b": still}, [wall], dt=DT)
    _, forces = KernelStepper(none).run(none.start(), 10)
    np.testing.assert_array_equal(forces, 0.0)


def test_point_without_mass_is_a_spring():
    """A component of residual compliance alone, joined rigidly, holds with its static stiffness."""
    C = 2e-5
    nothing = ModalBasis.real(np.zeros(0), np.zeros(0), {"n0": np.zeros(0)}, residual=[[C]])
    part = PARTS["a"]
    joint = Connection("c", (Term("a", "n2"), Term("point", "n0", -1.0)))
    poles, expected = [], []
    for dt in (1e-4, 1e-5):
        system = System.build({"a": part.real_basis(), "point": nothing}, [joint], dt=dt)
        poles.append(poles_of(step_map(system, KernelStepper), dt))
        row = np.eye(3)[[2]]
        exact = sla.eigvals(Part(part.M, part.C, part.K + row.T @ row / C).state_matrices(row)[0])
        expected = np.sort(exact.imag[exact.imag > 0])
    np.testing.assert_allclose(poles[1].imag, expected, rtol=1e-5)
    # second order in the step, like any spring
    assert np.abs(poles[0].imag - expected).max() > 50 * np.abs(poles[1].imag - expected).max()


def test_massless_point_between_three_parts():
    """Three chains meet in a point that has no mass: the joints are those of a ring of differences."""
    parts = {n: chain(2, seed=s) for n, s in (("a", 1), ("b", 2), ("c", 3))}
    rows = np.zeros((3, 6))
    rows[0, [1, 3]], rows[1, [3, 5]], rows[2, [5, 1]] = (1, -1), (1, -1), (1, -1)  # the third repeats the others
    links = [connect(f"c{j}", parts, row) for j, row in enumerate(rows)]
    system = System.build({n: p.real_basis() for n, p in parts.items()}, links, dt=1e-5)
    ours = poles_of(step_map(system, KernelStepper), 1e-5)
    _, one = joined(merged(*parts.values()), rows)
    exact = sla.eigvals(one.state_matrices(np.zeros((0, one.n)))[0])
    exact = exact[exact.imag > 0]
    np.testing.assert_allclose(ours, exact[np.argsort(exact.imag)], rtol=1e-9)


def moving_joint(residual, velocity=1.0):
    """Two parts joined at rest, one of which is struck: the joint's velocities differ."""
    system = system_of([JOINT], residual=residual)
    basis = system.compiled[0].basis
    state = system.start()
    end = basis.right[basis.index("n2")].real
    v = velocity * end / (end @ end)
    system.modes_of(state, "a")[:] = from_motion(basis, np.zeros(3), v)
    return system, state


def nyquist(forces):
    """Alternating part of the last of a run's forces, and their size."""
    f = forces[-400:, 0]
    sign = (-1.0) ** np.arange(f.size)
    return abs(np.mean(f * sign)), np.abs(f).max()


def test_torn_velocities_ring_for_ever_in_a_joint_that_does_not_yield():
    """The trap itself: without projection the force alternates from step to step and hardly decays."""
    system, state = moving_joint(0.0)
    _, forces = KernelStepper(system).run(state, 4000)
    alternating, size = nyquist(forces)
    assert alternating > 0.9 * size


def test_velocities_made_equal_do_not_ring():
    """The plastic impact takes kinetic energy, then energy is kept; the alternating force falls a thousandfold."""
    system, torn = moving_joint(0.0)
    state = torn.copy()
    share_velocities(system, state)
    before, after = (sum(EnergyAccount(system, x).stored(x).values()) for x in (torn, state))
    assert after < before
    E = energies(system, state.copy(), 20, 200)
    assert np.abs(E / after - 1).max() < 1e-10
    alternating, size = nyquist(KernelStepper(system).run(state, 4000)[1])
    assert alternating < 0.02 * size
    assert alternating < 1e-3 * nyquist(KernelStepper(system).run(torn, 4000)[1])[0]


@pytest.mark.parametrize("residual", [1e-8, 1e-7, 1e-6])
def test_a_yielding_joint_does_not_alternate(residual):
    """Torn velocities become vibration of the joint's own spring on the masses beside it, below Nyquist."""
    system, state = moving_joint(residual)
    kinetic = sum(EnergyAccount(system, state).stored(state).values())
    _, forces = KernelStepper(system).run(state, 4000)
    alternating, size = nyquist(forces)
    assert alternating < 1e-3 * size
    # and cannot hold more than the energy of the impact: f^2 (2R) / 2
    assert (forces**2).max() * residual <= kinetic * (1 + 1e-9)


def test_struck_body_with_strings_on_it_keeps_its_energy():
    """A tap on a body that carries strings, over the joint: energy is kept whatever rings."""
    for residual in (0.0, 2e-9):
        system = guitar(eta=0.0, zeta=0.0, residual=residual)
        stepper, state = KernelStepper(system), system.start()
        tap = held_force(system.compiled[0].basis, "body", "top", np.hanning(30), system.dt)
        stepper.run(state, 64, [tap])
        E = energies(system, state, 20, 2000)
        assert np.abs(E / E[0] - 1).max() < 1e-10


def test_joint_torn_open_closes_in_one_step_and_stays_closed():
    """An inconsistent displacement is an impact: the gap closes, energy stays finite and then does not rise."""
    system = system_of([JOINT])
    state = system.start()
    basis = system.compiled[0].basis
    end = basis.right[basis.index("n2")].real
    system.modes_of(state, "a")[:] = from_motion(basis, 1e-3 * end / (end @ end), np.zeros(3))
    out, _ = KernelStepper(system).run(state, 2)
    gaps = out[:, :7] @ JOINT
    assert gaps[0] == pytest.approx(1e-3)
    assert abs(gaps[1]) < 1e-12
    E = energies(system, state, 20, 200)
    assert np.abs(E / E[0] - 1).max() < 1e-9


def test_springs_as_stiff_as_can_be_are_rigid():
    """k = 1e16 N/m: the motion of the rigid joint once damping has taken the spring's own ringing."""
    gaps, laws = [JOINT], [SpringDashpot(1e16, 1e9)]
    u, _ = pushed(system_of(gaps, laws), 500)
    kick = np.zeros((500, 1))
    kick[:3, 0] = 1.0, 2.0, 1.0
    rigid, _ = run_held(merged(*PARTS.values()), gaps, [Rigid()], np.eye(7)[:1], kick, DT)
    assert np.abs(u - rigid[:-1, :7]).max() < 1e-6 * np.abs(u).max()
