"""Coordinates of modes, and the plastic impact that gives joined points one velocity."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from assembled import chain, connect, merged
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.motion import from_motion, share_velocities, to_motion

MIXED = ModalBasis.real([0.0, 0.0, 50.0, 50.0, 50.0, 50.0], [0.0, 3.0, 0.0, 1.0, 50.0, 200.0], {"p": np.arange(1.0, 7)})


def test_motion_is_the_displacement_and_velocity_that_rows_read(rng):
    modes = rng.normal(size=(2, 6))
    q, v = to_motion(MIXED, modes)
    form = real_form(MIXED)
    np.testing.assert_allclose(MIXED.right.real @ q, np.einsum("pmx,xm->p", form.C, modes), rtol=1e-12)
    speed = np.einsum("pmx,xm->p", form.rows("velocity", np.array([0])), modes)
    np.testing.assert_allclose(MIXED.right.real @ v, speed, rtol=1e-12)


def test_motion_and_back(rng):
    modes = rng.normal(size=(2, 6))
    np.testing.assert_allclose(from_motion(MIXED, *to_motion(MIXED, modes)), modes, rtol=1e-12, atol=1e-14)


def moving(parts, links, u, v, dt=1e-3):
    """A system whose dofs, in the order of `parts`, have displacements u and velocities v."""
    bases = {name: part.real_basis() for name, part in parts.items()}
    system = System.build(bases, links, dt=dt)
    state, start = system.start(), 0
    for name, part in parts.items():
        _, shapes = sla.eigh(part.K, part.M)
        inverse = shapes.T @ part.M
        span = slice(start, start + part.n)
        system.modes_of(state, name)[:] = from_motion(bases[name], inverse @ u[span], inverse @ v[span])
        start += part.n
    return system, state


def velocities(system, state):
    out = []
    for name, compiled in zip(system.names, system.compiled, strict=True):
        rows = compiled.form.rows("velocity", np.arange(len(compiled.basis.points)))
        out.append(np.einsum("pmx,xm->p", rows, system.modes_of(state, name)))
    return np.concatenate(out)


def test_impact_conserves_momentum_and_loses_least(rng):
    parts = {"a": chain(3, seed=1), "b": chain(4, seed=2)}
    gaps = np.array([[0, 0, 1.0, -1.0, 0, 0, 0], [0, 1.0, 0, 0, 0, -0.5, 0]])
    links = [connect(f"c{j}", parts, row) for j, row in enumerate(gaps)]
    links.append(connect("spring", parts, np.array([1.0, 0, 0, 0, 0, 0, 1.0]), SpringDashpot(1e5, 10.0)))
    u, v = rng.normal(size=(2, 7))
    system, state = moving(parts, links, u, v)
    share_velocities(system, state)
    M = merged(*parts.values()).M
    # the nearest allowed velocity in the mass norm, from the conditions of a minimum
    big = np.block([[M, gaps.T], [gaps, np.zeros((2, 2))]])
    expected = sla.solve(big, np.concatenate([M @ v, np.zeros(2)]))[:7]
    after = velocities(system, state)
    np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-12)
    assert after @ M @ after < v @ M @ v
    np.testing.assert_allclose(gaps @ after, 0.0, atol=1e-12)


def test_impact_of_two_free_masses_is_the_textbook_one():
    parts = {"a": chain(1, seed=1, fixed=False), "b": chain(1, seed=2, fixed=False)}
    m = [parts[n].M[0, 0] for n in "ab"]
    system, state = moving(parts, [connect("c", parts, np.array([1.0, -1.0]))], np.zeros(2), np.array([3.0, -1.0]))
    share_velocities(system, state)
    np.testing.assert_allclose(velocities(system, state), (3 * m[0] - m[1]) / sum(m), rtol=1e-12)


def test_equal_velocities_stay_and_displacements_always_do(rng):
    parts = {"a": chain(2, seed=1), "b": chain(2, seed=3)}
    links = [connect("c", parts, np.array([0, 1.0, -1.0, 0]))]
    v = np.array([0.3, 0.7, 0.7, -2.0])
    system, state = moving(parts, links, rng.normal(size=4), v)
    before = state.modes.copy()
    share_velocities(system, state)
    np.testing.assert_allclose(state.modes, before, atol=1e-12)


def test_redundant_joints_act_as_one():
    parts = {"a": chain(2, seed=1), "b": chain(2, seed=3)}
    row = np.array([0, 1.0, -1.0, 0])
    v = np.array([0.3, 0.7, -0.2, -2.0])
    once, state = moving(parts, [connect("c", parts, row)], np.zeros(4), v)
    twice, other = moving(parts, [connect("c", parts, row), connect("d", parts, -2 * row)], np.zeros(4), v)
    share_velocities(once, state)
    share_velocities(twice, other)
    np.testing.assert_allclose(other.modes, state.modes, atol=1e-12)


def test_springs_do_not_share_velocities():
    parts = {"a": chain(2, seed=1)}
    spring = Connection("s", (Term("a", "n0"),), SpringDashpot(1e9))
    system, state = moving(parts, [spring], np.zeros(2), np.array([1.0, 2.0]))
    before = state.modes.copy()
    share_velocities(system, state)
    np.testing.assert_array_equal(state.modes, before)


@pytest.mark.parametrize("seed", range(3))
def test_driven_components_take_no_part(seed):
    from tonewood.physics.coupling.system import Drive

    rng = np.random.default_rng(seed)
    basis = chain(3, seed=seed).real_basis()
    ground = Connection("g", (Term("a", "n2"),))
    system = System.build({"a": basis, "mic": basis}, [ground], dt=1e-3, drives=[Drive("mic", "n0", "g")])
    state = system.start()
    for name in "a", "mic":
        system.modes_of(state, name)[:] = rng.normal(size=(2, 3))
    heard = system.modes_of(state, "mic").copy()
    share_velocities(system, state)
    np.testing.assert_array_equal(system.modes_of(state, "mic"), heard)
    assert abs(velocities(system, state)[2]) < 1e-9


def test_components_without_modes_or_ports_take_no_part_in_an_impact() -> None:
    """A component without modes is legal; a part that nothing is joined to has no ports."""
    one, none = ModalBasis.real([10.0], [0.1], {"end": [1.0]}), ModalBasis.real([], [], {"end": []})
    joint = Connection("joint", (Term("a", "end"), Term("b", "end", -1.0)), Rigid())
    empty = Connection("empty", (Term("c", "end"), Term("b", "end", -1.0)), Rigid())
    system = System.build({"a": one, "b": one, "c": none, "alone": one}, [joint, empty], dt=1e-3)
    state = system.start()
    system.modes_of(state, "a")[:] = from_motion(one, np.array([0.2]), np.array([3.0]))
    share_velocities(system, state, np.array([True, False]))
    for name in ("a", "b"):
        assert to_motion(one, system.modes_of(state, name))[1] == pytest.approx([1.5])
    assert compile_force("c", none, "end", [Segment(0.0, 2.5e-3, 1.0)], 1e-3)[0].vectors.shape[1:] == (0, 2)
