"""The NumPy stepper against dense matrices in physical coordinates, stepped with scipy's exponential."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from assembled import chain, connect, held_force, held_force_matrices, merged, run_exact, run_held, uneven
from tonewood.errors import NumericalError
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Drive, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.physics.stepping.stepper import NumpyStepper

STEPS = 120


def displacements(parts, quantity="displacement"):
    return [
        Readout(f"{name}.n{i}", quantity, (Term(name, f"n{i}"),)) for name, part in parts.items() for i in range(part.n)
    ]


@pytest.mark.parametrize("dt", [1e-4, 1e-2])
def test_alone_a_component_follows_its_matrices(rng, dt):
    part = uneven(5, seed=1)
    basis = part.complex_basis()
    system = System.build({"a": basis}, [], displacements({"a": part}), dt=dt)
    force = rng.normal(size=(STEPS, 1))
    out, forces = NumpyStepper(system).run(system.start(), STEPS, [held_force(basis, "a", "n2", force[:, 0], dt)])
    exact = run_exact(part, part.rows(["n2"]), force, dt)[:-1, : part.n]
    np.testing.assert_allclose(out, exact, atol=1e-11 * np.abs(exact).max())
    assert forces.shape == (STEPS, 0)


PARTS = {"a": chain(3, seed=1), "b": uneven(4, seed=2)}
BASES = {"a": PARTS["a"].real_basis(), "b": PARTS["b"].complex_basis()}
JOINT = np.array([0, 0, 1.0, -1.0, 0, 0, 0])
SECOND = np.array([0.5, 0, 0, 0, -2.0, 0, 1.0])
LAWS = {
    "rigid": [Rigid()],
    "two rigid": [Rigid(), Rigid()],
    "offset": [Rigid(), Rigid(2e-4)],
    "spring": [SpringDashpot(3e5)],
    "dashpot": [SpringDashpot(0.0, 500.0)],
    "both": [SpringDashpot(3e5, 50.0, 1e-4), SpringDashpot(1e9, 0.0)],
    "mixed": [Rigid(), SpringDashpot(3e5, 50.0)],
}


@pytest.mark.parametrize("dt", [2e-4, 5e-3])
@pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
def test_connected_components_follow_the_assembled_matrices(rng, laws, dt):
    gaps = [JOINT, SECOND][: len(laws)]
    links = [connect(f"c{j}", PARTS, row, law) for j, (row, law) in enumerate(zip(gaps, laws, strict=True))]
    system = System.build(BASES, links, displacements(PARTS), dt=dt)
    force = rng.normal(size=(STEPS, 1))
    out, forces = NumpyStepper(system).run(system.start(), STEPS, [held_force(BASES["a"], "a", "n0", force[:, 0], dt)])
    whole = merged(*PARTS.values())
    states, expected = run_held(whole, gaps, laws, np.eye(7)[:1], force, dt)
    np.testing.assert_allclose(out, states[:-1, :7], atol=1e-9 * np.abs(states[:, :7]).max())
    np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max())


def test_residual_compliance_softens_a_rigid_joint(rng):
    dt, R = 5e-4, 3e-7
    soft = ModalBasis.real(
        np.sqrt(BASES["a"].stiffness), BASES["a"].damping_rate,
        dict(zip(BASES["a"].points, BASES["a"].right.real, strict=True)), residual=np.diag([0.0, 0.0, R]),
    )  # fmt: skip
    system = System.build({"a": soft, "b": BASES["b"]}, [connect("c", PARTS, JOINT)], displacements(PARTS), dt=dt)
    force = rng.normal(size=(STEPS, 1))
    out, forces = NumpyStepper(system).run(system.start(), STEPS, [held_force(soft, "a", "n0", force[:, 0], dt)])
    states, expected = run_held(
        merged(*PARTS.values()), [JOINT], [Rigid()], np.eye(7)[:1], force, dt, residual=np.array([[R]])
    )
    np.testing.assert_allclose(out, states[:-1, :7], atol=1e-9 * np.abs(states[:, :7]).max())
    np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max())


def test_what_each_readout_means():
    """Displacement and velocity at the beginning of a step; acceleration and force as means over it."""
    dt = 1e-3
    part = uneven(3, seed=4)
    basis = part.complex_basis()
    probes = (Term("a", "n1", 2.0), Term("a", "n2", -1.0))
    readouts = [Readout(q, q, probes) for q in ("displacement", "velocity", "acceleration")]
    readouts.append(Readout("force", "force", (), (("spring", 3.0),)))
    spring = Connection("spring", (Term("a", "n0"),), SpringDashpot(1e4))
    system = System.build({"a": basis}, [spring], readouts, dt=dt)
    force = np.zeros((STEPS, 1))
    force[0] = 1.0
    out, forces = NumpyStepper(system).run(system.start(), STEPS, [held_force(basis, "a", "n1", force[:, 0], dt)])
    states, expected = run_held(part, part.rows(["n0"]), [SpringDashpot(1e4)], part.rows(["n1"]), force, dt)
    row = np.array([0.0, 2.0, -1.0])
    u, v = states[:, :3] @ row, states[:, 3:] @ row
    np.testing.assert_allclose(out[:, 0], u[:-1], atol=1e-10 * np.abs(u).max())
    np.testing.assert_allclose(out[:, 1], v[:-1], atol=1e-10 * np.abs(v).max())
    np.testing.assert_allclose(out[:, 2], np.diff(v) / dt, atol=1e-10 * np.abs(np.diff(v) / dt).max())
    np.testing.assert_allclose(out[:, 3], 3 * expected[:, 0], atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(forces, expected, atol=1e-10 * np.abs(expected).max())


def test_driven_component_hears_the_force_and_gives_nothing_back(rng):
    dt = 1e-3
    part, mic = chain(3, seed=1), uneven(3, seed=9)
    basis, mic_basis = part.real_basis(), mic.complex_basis()
    ground = Connection("ground", (Term("a", "n2"),))
    system = System.build(
        {"a": basis, "mic": mic_basis}, [ground], [Readout("mic", "displacement", (Term("mic", "n2"),))],
        dt=dt, drives=[Drive("mic", "n0", "ground", -2.0)],
    )  # fmt: skip
    force = rng.normal(size=STEPS)
    out, forces = NumpyStepper(system).run(system.start(), STEPS, [held_force(basis, "a", "n0", force, dt)])
    alone = System.build({"a": basis}, [ground], dt=dt)
    _, same = NumpyStepper(alone).run(alone.start(), STEPS, [held_force(basis, "a", "n0", force, dt)])
    np.testing.assert_array_equal(forces, same)
    heard = run_exact(mic, mic.rows(["n0"]), -2.0 * forces, dt)[:-1, 2]
    np.testing.assert_allclose(out[:, 0], heard, atol=1e-10 * np.abs(heard).max())


def test_runs_continue_where_they_stopped(rng):
    dt = 1e-3
    links = [connect("c", PARTS, JOINT), connect("d", PARTS, SECOND, SpringDashpot(1e4, 2.0))]
    system = System.build(BASES, links, displacements(PARTS), dt=dt)
    injection = held_force(BASES["b"], "b", "n3", rng.normal(size=60), dt, start=17)
    whole = system.start()
    out, forces = NumpyStepper(system).run(whole, STEPS, [injection])
    cut = system.start()
    pieces = [NumpyStepper(system).run(cut, n, [injection]) for n in (1, 16, 0, 40, STEPS - 57)]
    np.testing.assert_array_equal(np.concatenate([p[0] for p in pieces]), out)
    np.testing.assert_array_equal(np.concatenate([p[1] for p in pieces]), forces)
    np.testing.assert_array_equal(cut.modes, whole.modes)
    np.testing.assert_array_equal(cut.forces, forces[-1])
    assert cut.sample == whole.sample == STEPS


def test_starting_state_moves_on_as_the_matrices_say():
    part = chain(4, seed=6)
    basis = part.real_basis()
    dt = 1e-3
    system = System.build({"a": basis}, [], displacements({"a": part}), dt=dt)
    state = system.start()
    start = np.concatenate([np.linspace(1e-3, 4e-3, 4), [0.1, -0.2, 0.3, 0.0]])
    # numbers of the modes that give these displacements and velocities
    form = real_form(basis)
    rows = np.concatenate([form.rows(q, np.arange(4)).reshape(4, -1) for q in ("displacement", "velocity")])
    system.modes_of(state, "a")[:] = sla.solve(rows, start).reshape(-1, 2).T
    out, _ = NumpyStepper(system).run(state, STEPS)
    E, _ = held_force_matrices(part, np.zeros((0, 4)), dt)
    expected = [start]
    for _ in range(STEPS - 1):
        expected.append(E @ expected[-1])
    np.testing.assert_allclose(out, np.array(expected)[:, :4], atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_reported_with_component_and_time(bad):
    system = System.build(BASES, [connect("c", PARTS, JOINT)], dt=1e-3)
    state = system.start()
    NumpyStepper(system).run(state, 8)
    system.modes_of(state, "b")[0, 1] = bad
    with pytest.raises(NumericalError, match=r"b is no longer finite at 0\.008000 s"):
        NumpyStepper(system).run(state, 8)
