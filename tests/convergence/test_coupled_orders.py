"""Slopes of the error over the step: exact, second and fourth order."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from assembled import (
    Part,
    chain,
    connect,
    held_force,
    joined,
    merged,
    motion_readouts,
    poles_of,
    run_exact,
    step_map,
    uneven,
)
from tonewood.physics.coupling.connections import SpringDashpot
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

PARTS = {"a": chain(3, seed=1), "b": uneven(4, seed=2)}
WHOLE = merged(*PARTS.values())
JOINT = np.array([0, 0, 1.0, -1.0, 0, 0, 0])
STEPS = np.array([4e-4, 2e-4, 1e-4, 5e-5])  # omega h of the highest coupled mode: 0.6 down to 0.07


def slope(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def system_at(dt, law=None, residual=0.0):
    a = PARTS["a"].real_basis()
    soft = ModalBasis.real(
        np.sqrt(a.stiffness), a.damping_rate, dict(zip(a.points, a.right.real, strict=True)),
        residual=np.diag([0.0, 0.0, residual]),
    )  # fmt: skip
    bases = {"a": soft, "b": PARTS["b"].complex_basis()}
    return System.build(bases, [connect("c", PARTS, JOINT, law)], motion_readouts(PARTS), dt=dt)


def exact_poles(part):
    poles = sla.eigvals(part.state_matrices(np.zeros((0, part.n)))[0])
    poles = poles[poles.imag > 0]
    return poles[np.argsort(poles.imag)]


def spring(k, r):
    row = JOINT[None]
    return Part(WHOLE.M, WHOLE.C + r * row.T @ row, WHOLE.K + k * row.T @ row)


# law of the joint -> (law, residual compliance, continuous system, order of its poles)
CASES = {
    "rigid": (None, 0.0, joined(WHOLE, [JOINT])[1], 4.0),
    "rigid, yielding": (None, 4e-7, spring(1 / 4e-7, 0.0), 2.0),
    "spring": (SpringDashpot(2e5), 0.0, spring(2e5, 0.0), 2.0),
    "spring and dashpot": (SpringDashpot(2e5, 40.0), 0.0, spring(2e5, 40.0), 2.0),
}


@pytest.mark.parametrize(("law", "residual", "whole", "order"), CASES.values(), ids=CASES)
def test_order_of_coupled_poles(law, residual, whole, order):
    exact = exact_poles(whole)
    errors = []
    for dt in STEPS:
        ours = poles_of(step_map(system_at(dt, law, residual), KernelStepper), dt)
        errors.append(np.abs(ours - exact) / np.abs(exact))
    # each pole by itself, and the worst of them
    slopes = [slope(STEPS, e) for e in np.array(errors).T if e[-1] > 1e-12]
    assert len(slopes) >= 4
    assert np.all(np.abs(np.array(slopes) - order) < 0.12)


@pytest.mark.parametrize(("rows", "order"), [(slice(0, 7), 4.0), (slice(7, 14), 2.0)], ids=["displacement", "velocity"])
def test_order_of_forced_motion_through_a_rigid_joint(rows, order):
    """A smooth force on one part: displacements everywhere keep the order of the poles, velocities do not."""
    T, one = joined(WHOLE, [JOINT])
    errors = []
    for dt in STEPS:
        n = round(0.04 / dt)
        force = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 4
        system = system_at(dt)
        out, _ = KernelStepper(system).run(
            system.start(), n, [held_force(system.compiled[0].basis, "a", "n0", force, dt)]
        )
        states = run_exact(one, T[:1], force[:, None], dt)[:-1]
        exact = np.concatenate([states[:, : one.n] @ T.T, states[:, one.n :] @ T.T], axis=1)
        errors.append(np.abs(out[:, rows] - exact[:, rows]).max() / np.abs(exact[:, rows]).max())
    assert slope(STEPS, errors) == pytest.approx(order, abs=0.15)


def test_the_time_of_a_joints_force_is_the_middle_of_its_step():
    """Constant over a step, it is a mean: read there it is of second order, read at the end of first."""
    T, one = joined(WHOLE, [JOINT])
    at_middle, at_end = [], []
    for dt in STEPS:
        n = round(0.04 / dt)
        force = lambda t: np.sin(np.pi * t / 0.04) ** 4  # noqa: E731
        system = system_at(dt)
        held = held_force(system.compiled[0].basis, "a", "n0", force((np.arange(n) + 0.5) * dt), dt)
        _, forces = KernelStepper(system).run(system.start(), n, [held])
        quarter = dt / 4
        states = run_exact(one, T[:1], force((np.arange(4 * n) + 0.5) * quarter)[:, None], quarter)
        y, w = states[:, : one.n], states[:, one.n :]
        a = (np.outer(force(np.arange(4 * n + 1) * quarter), T[0]) - w @ one.C - y @ one.K) @ sla.inv(one.M)
        # the second part is moved by the joint alone, at its first dof
        exact = -(a @ T.T @ WHOLE.M + w @ T.T @ WHOLE.C + y @ T.T @ WHOLE.K)[:, 3]
        at_middle.append(np.abs(forces[:, 0] - exact[2::4]).max())
        at_end.append(np.abs(forces[:, 0] - exact[4::4]).max())
    assert slope(STEPS, at_middle) == pytest.approx(2.0, abs=0.15)
    assert slope(STEPS, at_end) == pytest.approx(1.0, abs=0.15)


def test_step_length_does_not_matter_without_connections():
    part = PARTS["b"]
    basis = part.complex_basis()
    for dt in (1e-5, 1e-3, 0.1):
        system = System.build({"b": basis}, [], motion_readouts({"b": part}), dt=dt)
        force = np.array([1.0, -2.0, 0.5, 0.0, 0.0])
        out, _ = KernelStepper(system).run(system.start(), 5, [held_force(basis, "b", "n1", force, dt)])
        exact = run_exact(part, np.eye(4)[[1]], force[:, None], dt)[:-1]
        for half in (slice(0, 4), slice(4, 8)):
            np.testing.assert_allclose(out[:, half], exact[:, half], atol=1e-9 * np.abs(exact[:, half]).max())


def test_residual_of_truncated_strings_converges_with_their_modes():
    """Strings joined at their free ends: the error that is left when dropped modes are folded into the residual."""
    length, c = 1.0, 200.0

    def string(n, fold):
        k = (np.arange(1, n + 1) - 0.5) * np.pi / length  # one end free, the other fixed; unit density
        shape = np.sin(k * length) * np.sqrt(2 / length)
        left = length / c**2 - np.sum(shape**2 / (k * c) ** 2)  # static compliance of all modes is L / T
        return ModalBasis.real(k * c, np.zeros(n), {"n0": shape}, residual=[[left if fold else 0.0]])

    one = {"a": chain(1, 1), "b": chain(1, 1)}
    counts, folded, dropped = np.array([10, 20, 40]), [], []
    for n in counts:
        for fold, errors in ((True, folded), (False, dropped)):
            dt = 2e-5 * 10 / n
            system = System.build(
                {"a": string(n, fold), "b": string(n, fold)}, [connect("c", one, np.array([1.0, -1.0]))], dt=dt
            )
            poles = poles_of(step_map(system, KernelStepper), dt).imag
            # together they are one fixed string of twice the length; its second mode has its node at the joint
            errors.append(np.abs(poles / (np.pi * c / length) - 1).min())
    assert slope(counts, folded) == pytest.approx(-3.0, abs=0.3)
    assert slope(counts, dropped) == pytest.approx(-1.0, abs=0.1)
    assert folded[-1] < 1e-2 * dropped[-1]
