"""Steps of methods as dense matrices, from other code than the compiled loop's arrays; free motion only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from tonewood.lab.methods import Problem, StepMap, forms
from tonewood.lab.methods.step_map import held_position
from tonewood.physics.coupling.inverse import scaled_pinv

Map = Callable[[Problem, float], StepMap]


def free(dt: float, T: np.ndarray, output: np.ndarray, embed: np.ndarray) -> StepMap:
    """A step without known forces."""
    none = np.zeros((len(T), 1))
    return StepMap(dt, T, none, none, output, embed)


def adams_bashforth_3(ode: forms.Ode, dt: float) -> StepMap:
    """q+ = q + dt/12 (23 d - 16 d_-1 + 5 d_-2),  d = F q;  state (q, d_-1, d_-2).

    A motion that does not start from rest is given the past it would have had, to second order.
    """
    k, rate = len(ode.F), ode.F @ ode.embed
    zero, eye = np.zeros((k, k)), np.eye(k)
    T = np.block([
        [eye + 23 * dt / 12 * ode.F, -16 * dt / 12 * eye, 5 * dt / 12 * eye],
        [ode.F, zero, zero],
        [zero, eye, zero],
    ])  # fmt: skip
    past = [rate - ago * (ode.F @ rate) + ago**2 / 2 * (ode.F @ (ode.F @ rate)) for ago in (dt, 2 * dt)]
    output = np.concatenate([ode.C, np.zeros((len(ode.C), 2 * k))], axis=1)
    return free(dt, T, output, np.concatenate([ode.embed, *past]))


def velocity_verlet(problem: Problem, dt: float) -> StepMap:
    """q+ = q + dt v + dt^2/2 a;  a+ = -P (K q+ + C (v + dt a));  v+ = v + dt/2 (a + a+); state (q, v, a)."""
    m = problem.real
    project, n = forms.corrective(m)[1], len(m.omega2)
    zero, eye = np.zeros((n, n)), np.eye(n)
    stiff, loss = project * m.omega2, project * (2 * m.sigma)
    q = np.concatenate([eye, dt * eye, dt**2 / 2 * eye], axis=1)
    a = -stiff @ q - loss @ np.concatenate([zero, eye, dt * eye], axis=1)
    v = np.concatenate([zero, eye, dt / 2 * eye], axis=1) + dt / 2 * a
    start = np.concatenate([np.eye(2 * n), -np.concatenate([stiff, loss], axis=1)])
    output = np.concatenate([m.outs, np.zeros((len(m.outs), 2 * n))], axis=1)
    return free(dt, np.concatenate([q, v, a]), output, start @ forms.embedding(m))


def flow(problem: Problem, dt: float) -> list[np.ndarray]:
    """phi_0, phi_1, phi_2 (n, n) of the uncoupled flow."""
    return [sla.block_diag(*blocks) for blocks in problem.flow(dt, 2)]


def held_velocity(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step, gap at rest at its end."""
    E, phi1, _ = flow(problem, dt)
    rows, W = problem.gap_rows @ problem.generator, dt * phi1 @ problem.gap_columns
    return free(dt, E - W @ scaled_pinv(rows @ W) @ rows @ E, problem.output_rows, np.eye(len(E)))


def held_acceleration(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step at the value that the acceleration constraint asks for at its beginning."""
    E, phi1, _ = flow(problem, dt)
    A, rows, columns = problem.generator, problem.gap_rows, problem.gap_columns
    T = E - dt * phi1 @ columns @ scaled_pinv(rows @ A @ columns) @ rows @ A @ A
    return free(dt, T, problem.output_rows, np.eye(len(E)))


def linear_position(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force linear in time over the step, gap zero at its end; state (x, f)."""
    E, phi1, phi2 = flow(problem, dt)
    rows, old, new = problem.gap_rows, dt * (phi1 - phi2) @ problem.gap_columns, dt * phi2 @ problem.gap_columns
    before = np.concatenate([E, old], axis=1)
    force = -scaled_pinv(rows @ new) @ rows @ before
    m = len(rows)
    output = np.concatenate([problem.output_rows, np.zeros((len(problem.outputs), m))], axis=1)
    embed = np.concatenate([np.eye(len(E)), np.zeros((m, len(E)))])
    return free(dt, np.concatenate([before + new @ force, force]), output, embed)


#: method -> its step, written out
MAPS: dict[str, Map] = {
    "held_position": held_position,
    "held_velocity": held_velocity,
    "p0": held_acceleration,
    "linear_position": linear_position,
    "ab3": lambda problem, dt: adams_bashforth_3(forms.general(problem), dt),
    "verlet": velocity_verlet,
}
