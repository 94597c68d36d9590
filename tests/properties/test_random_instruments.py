"""Properties of any instrument: no energy from nothing, reciprocity, linearity, invariances, exactness."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from instruments import build, instruments

from assembled import held_force, joined, merged, run_exact, run_held
from tonewood.physics.coupling.connections import Rigid
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import BLOCK_SIZE, Injection
from tonewood.physics.stepping.kernel import KernelStepper

STEPS = 80
FEW = settings(max_examples=12)


def push(instrument, dof, forces, start=0):
    name, point = instrument.dof(dof)
    return held_force(instrument.basis(name), name, point, forces, instrument.dt, start)


def motion(instrument, injections, steps=STEPS):
    """Displacements and velocities (steps, n) of all dofs."""
    out, _ = KernelStepper(instrument.system).run(instrument.system.start(), steps, injections)
    return out[:, : instrument.n], out[:, instrument.n : 2 * instrument.n]


def alone(instrument, *dofs):
    """Displacement (m) that 1 N gives the lightest of these masses in one step when nothing holds it.

    Joints may hold a driven mass fast; its motion is then the rounding of this, 1e-11 of it at worst.
    """
    return instrument.dt**2 / np.diag(merged(*instrument.parts.values()).M)[list(dofs)].min()


def energy(instrument, u, v):
    """(steps,) mechanical energy of all parts, springs and residual compliance, from the matrices."""
    whole = merged(*instrument.parts.values())
    total = 0.5 * np.einsum("ti,ij,tj->t", v, whole.M, v) + 0.5 * np.einsum("ti,ij,tj->t", u, whole.K, u)
    g = u @ instrument.gaps.T
    stiffness = np.array([0.0 if isinstance(law, Rigid) else law.stiffness for law in instrument.laws])
    held = np.einsum("tj,jk,tk->t", g, scaled_pinv(instrument.residual), g) if instrument.residual.any() else 0.0
    return total + 0.5 * g**2 @ stiffness + 0.5 * held


@FEW
@given(instrument=instruments(), dof=st.integers(0, 10**6), seed=st.integers(0, 10**6))
def test_energy_never_rises_by_more_than_the_work_put_in(instrument, dof, seed):
    dof %= instrument.n
    force = np.zeros(STEPS)
    force[: STEPS // 2] = np.random.default_rng(seed).normal(size=STEPS // 2)
    u, v = motion(instrument, [push(instrument, dof, force)], STEPS + 1)
    E = energy(instrument, u, v)
    work = force * np.diff(u[:, dof])
    scale = E.max() + np.abs(work).max() + np.abs(force).max() ** 2 * alone(instrument, dof)
    assert np.all(np.diff(E) - work <= 1e-9 * scale)
    assert E[-1] <= E[STEPS // 2] + 1e-9 * scale


@FEW
@given(instrument=instruments(), dofs=st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)))
def test_drive_and_listener_may_change_places(instrument, dofs):
    a, b = (d % instrument.n for d in dofs)
    pulse = np.array([1.0, -0.5, 0.25])
    there = motion(instrument, [push(instrument, a, pulse)])[0][:, b]
    back = motion(instrument, [push(instrument, b, pulse)])[0][:, a]
    assert np.abs(there - back).max() <= 1e-8 * np.abs(there).max() + 1e-10 * alone(instrument, a, b)


@FEW
@given(instrument=instruments(), seed=st.integers(0, 10**6))
def test_responses_add_up(instrument, seed):
    rng = np.random.default_rng(seed)
    dofs = rng.integers(instrument.n, size=2)
    one, other = (push(instrument, int(dof), rng.normal(size=40)) for dof in dofs)
    scaled = Injection(other.component, other.start, other.vectors, -3.0 * other.values)
    first, second = motion(instrument, [one])[0], motion(instrument, [other])[0]
    both = motion(instrument, [one, scaled])[0]
    peak = max(np.abs(first).max(), np.abs(second).max())
    assert np.abs(both - (first - 3 * second)).max() <= 1e-9 * peak + 1e-10 * alone(instrument, *dofs)


@FEW
@given(instrument=instruments(), seed=st.integers(0, 10**6), shift=st.integers(1, 70))
def test_a_later_force_has_the_same_response_later(instrument, seed, shift):
    rng = np.random.default_rng(seed)
    dof, force = int(rng.integers(instrument.n)), rng.normal(size=30)
    now = motion(instrument, [push(instrument, dof, force)])[0]
    later = motion(instrument, [push(instrument, dof, force, shift)], STEPS + shift)[0]
    assert not later[: shift + 1].any()
    if shift % BLOCK_SIZE == 0:
        np.testing.assert_array_equal(later[shift:], now)
    assert np.abs(later[shift:] - now).max() <= 1e-9 * np.abs(now).max() + 1e-10 * alone(instrument, dof)


@settings(max_examples=8)
@given(instrument=instruments(20), seed=st.integers(0, 10**6))
def test_blocks_of_any_size_give_the_same_motion(instrument, seed):
    rng = np.random.default_rng(seed)
    steps = 520
    dof = int(rng.integers(instrument.n))
    injections = [push(instrument, dof, rng.normal(size=100), int(rng.integers(50)))]
    stepper = KernelStepper(instrument.system)
    whole, _ = stepper.run(stepper.start(), steps, injections)
    peak = np.abs(whole).max(axis=0)
    for size in (1, 7, 63, 64, 65, 511, 512, steps):
        state, parts = stepper.start(), []
        while state.sample < steps:
            parts.append(stepper.run(state, min(size, steps - state.sample), injections)[0])
        out = np.concatenate(parts)
        if size % BLOCK_SIZE == 0 or size == steps:
            np.testing.assert_array_equal(out, whole)
        # steps of hundreds of radians leave phases no more digits than this
        moved, limit = slice(0, instrument.n), 1e-10 * alone(instrument, dof)
        assert np.all(np.abs(out - whole)[:, moved] <= 1e-9 * peak[moved].max() + limit)


@settings(max_examples=10)
@given(
    seed=st.integers(0, 10**6), n_strings=st.integers(1, 40), complex_body=st.booleans(),
    yielding=st.booleans(), extra=st.integers(0, 2), dt=st.sampled_from([1e-5, 2e-4, 3e-3]),
)  # fmt: skip
def test_motion_is_that_of_the_assembled_system_with_held_forces(seed, n_strings, complex_body, yielding, extra, dt):
    """Dense matrices, scipy's exponential, and the laws written out: nothing of the modes is left in it."""
    instrument = build(seed, n_strings, 4, complex_body, yielding, extra, dt)
    force = np.random.default_rng(seed).normal(size=(STEPS, 1))
    u, _ = motion(instrument, [push(instrument, 1, force[:, 0])])
    whole = merged(*instrument.parts.values())
    states, _ = run_held(
        whole, instrument.gaps, instrument.laws, np.eye(instrument.n)[[1]], force, dt, residual=instrument.residual
    )
    expected = states[:-1, : instrument.n]
    assert np.abs(u - expected).max() <= 1e-9 * np.abs(expected).max() + 1e-10 * alone(instrument, 1)


@settings(max_examples=6)
@given(seed=st.integers(0, 10**6), n_strings=st.integers(1, 12), complex_body=st.booleans())
def test_motion_is_that_of_the_continuous_system_as_the_step_shrinks(seed, n_strings, complex_body):
    """Rigid joints: displacements to 1e-9 of the exponential of the whole."""
    instrument = build(seed, n_strings, 5, complex_body, False, 0, 1e-6, springs=False)
    steps = 400
    force = np.repeat(np.random.default_rng(seed).normal(size=10), 40)[:, None]
    u, _ = motion(instrument, [push(instrument, 0, force[:, 0])], steps)
    T, one = joined(merged(*instrument.parts.values()), instrument.gaps)
    exact = run_exact(one, T[:1], force, instrument.dt)[:-1, : one.n] @ T.T
    assert np.abs(u - exact).max() <= 1e-9 * np.abs(exact).max()
