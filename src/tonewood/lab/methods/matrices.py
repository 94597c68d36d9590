"""Steps of methods as dense matrices, forces at both ends of a step included."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.methods import forms
from tonewood.lab.methods.problem import Problem, StepMap, system_map
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.support.arrays import Floats


def exact(ode: forms.Ode, dt: float) -> StepMap:
    """The exact flow of a form, forces held over each step: the measure for integrators, and no method by itself."""
    k, m = ode.G.shape
    big = np.zeros((k + m, k + m), dtype=np.result_type(ode.F, ode.G))
    big[:k, :k], big[:k, k:] = ode.F * dt, ode.G * dt
    full = sla.expm(big)
    return StepMap(dt, full[:k, :k], full[:k, k:], np.zeros((k, m)), ode.C, ode.embed)


def adams_bashforth_3(ode: forms.Ode, dt: float) -> StepMap:
    """q+ = q + dt/12 (23 d - 16 d_-1 + 5 d_-2),  d = F q + G u;  state (q, d_-1, d_-2).

    A motion that does not start from rest is given the past it would have had without forces, to second order.
    """
    k = len(ode.F)
    zero, eye = np.zeros((k, k)), np.eye(k)
    T = np.block([
        [eye + 23 * dt / 12 * ode.F, -16 * dt / 12 * eye, 5 * dt / 12 * eye],
        [ode.F, zero, zero],
        [zero, eye, zero],
    ])  # fmt: skip

    rate = ode.F @ ode.embed

    def past(ago: float) -> NDArray[Any]:
        return np.asarray(rate - ago * (ode.F @ rate) + ago**2 / 2 * (ode.F @ (ode.F @ rate)))

    now = np.concatenate([23 * dt / 12 * ode.G, ode.G, np.zeros_like(ode.G)])
    return StepMap(
        dt,
        T,
        now,
        np.zeros_like(now),
        np.concatenate([ode.C, np.zeros((len(ode.C), 2 * k))], axis=1),
        np.concatenate([ode.embed, past(dt), past(2 * dt)]),
    )


def velocity_verlet(problem: Problem, dt: float) -> StepMap:
    """q+ = q + dt v + dt^2/2 a;  a+ = P (phi u+ - K q+ - C (v + dt a));  v+ = v + dt/2 (a + a+); state (q, v, a)."""
    m = problem.real
    project, n = forms.corrective(m)[1], len(m.omega2)
    zero, eye = np.zeros((n, n)), np.eye(n)
    stiff, loss = project * m.omega2, project * (2 * m.sigma)
    q = np.concatenate([eye, dt * eye, dt**2 / 2 * eye], axis=1)
    a = -stiff @ q - loss @ np.concatenate([zero, eye, dt * eye], axis=1)
    v = np.concatenate([zero, eye, dt / 2 * eye], axis=1) + dt / 2 * a
    scatter = project @ m.inputs.T
    start = np.concatenate([np.eye(2 * n), -np.concatenate([stiff, loss], axis=1)])
    return StepMap(
        dt,
        np.concatenate([q, v, a]),
        np.zeros((3 * n, scatter.shape[1])),
        np.concatenate([np.zeros_like(scatter), dt / 2 * scatter, scatter]),
        np.concatenate([m.outs, np.zeros((len(m.outs), 2 * n))], axis=1),
        start @ forms.embedding(m),
    )


def held_position(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step, gap zero at its end: the scheme of this project, from its own arrays."""
    return system_map(problem.system(dt), *_ramp_weights(problem, dt, problem.input_columns))


def held_velocity(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step, gap at rest at its end."""
    _no_residual(problem)
    rows = problem.gap_rows @ problem.generator
    W = dt * _blocks(problem, dt)[1] @ problem.gap_columns
    correct = np.eye(len(W)) - W @ scaled_pinv(rows @ W) @ rows
    now, later = _ramp_weights(problem, dt, problem.input_columns)
    E = _blocks(problem, dt)[0]
    return StepMap(dt, correct @ E, correct @ now, correct @ later, problem.output_rows, np.eye(len(E)))


def held_acceleration(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step at the value that the acceleration constraint asks for at its beginning."""
    _no_residual(problem)
    A, rows, columns = problem.generator, problem.gap_rows, problem.gap_columns
    E, phi1, _ = _blocks(problem, dt)
    W = dt * phi1 @ columns
    solve = scaled_pinv(rows @ A @ columns)
    B = problem.input_columns
    now, later = _ramp_weights(problem, dt, B)
    return StepMap(
        dt,
        E - W @ solve @ rows @ A @ A,
        now - W @ solve @ rows @ A @ B,
        later,
        problem.output_rows,
        np.eye(len(A)),
    )


def linear_position(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force linear in time over the step, gap zero at its end; state (x, f). Unstable: do not use.

    The weight of the new force is less than half that of the old one, so that the force alternates and grows.
    """
    _no_residual(problem)
    rows, columns = problem.gap_rows, problem.gap_columns
    E = _blocks(problem, dt)[0]
    old, new = _ramp_weights(problem, dt, columns)
    solve = scaled_pinv(rows @ new)
    force = -solve @ rows @ np.concatenate([E, old], axis=1)
    now, later = _ramp_weights(problem, dt, problem.input_columns)
    force_now, force_later = -solve @ rows @ now, -solve @ rows @ later
    m = len(rows)
    return StepMap(
        dt,
        np.concatenate([np.concatenate([E, old], axis=1) + new @ force, force]),
        np.concatenate([now + new @ force_now, force_now]),
        np.concatenate([later + new @ force_later, force_later]),
        np.concatenate([problem.output_rows, np.zeros((len(problem.outputs), m))], axis=1),
        np.concatenate([np.eye(len(E)), np.zeros((m, len(E)))]),
    )


def _blocks(problem: Problem, dt: float) -> Floats:
    """(3, n, n) phi_0, phi_1, phi_2 of the uncoupled flow."""
    return np.array([sla.block_diag(*blocks) for blocks in problem.flow(dt, 2)])


def _ramp_weights(problem: Problem, dt: float, columns: Floats) -> tuple[Floats, Floats]:
    """State added over a step by a force that goes in a straight line from 1 to 0, and by one from 0 to 1."""
    _, phi1, phi2 = _blocks(problem, dt)
    return dt * (phi1 - phi2) @ columns, dt * phi2 @ columns


def _no_residual(problem: Problem) -> None:
    if np.any(problem.residual != 0):
        raise ValueError("this method has no place for residual compliance")
