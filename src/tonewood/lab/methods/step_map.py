"""Steps as dense matrices: the scheme of this project from the arrays that its steppers use, and the exact flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

from tonewood.lab.methods.forms import Ode
from tonewood.lab.methods.problem import Array, Problem
from tonewood.physics.coupling.system import System
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class StepMap:
    """One step of a linear method: x(n+1) = T x(n) + now u(n) + next u(n+1),  y(n) = output x(n).

    dt : s.
    T : (k, k) real or complex; multi-step methods keep their past in x.
    now, next : (k, n_inputs) x per force at the beginning and at the end of the step.
    output : (n_outputs, k).
    embed : (k, n) puts a state of `Problem.generator` into x.
    """

    dt: float
    T: Array
    now: Array
    next: Array
    output: Array
    embed: Array

    def run(self, forces: ArrayLike, start: ArrayLike | None = None) -> Floats:
        """Displacements at t = 0, dt, 2 dt, ...

        forces : (n, n_inputs) N at the same times.
        start : (n_state,) state of `Problem.generator`, rest if left out.
        Returns (n, n_outputs) m.
        """
        rest = np.zeros(self.embed.shape[1])
        return self.advance(self.embed @ (rest if start is None else np.asarray(start, dtype=np.float64)), forces)[0]

    def advance(self, x: Array, forces: ArrayLike) -> tuple[Floats, Array]:
        """Displacements (n, n_outputs) from the state x (k,) on, and the state at the last of them."""
        u = np.asarray(forces, dtype=np.float64)
        scatters = u[:-1] @ self.now.T + u[1:] @ self.next.T
        out = np.empty((len(u), len(self.output)))
        out[0] = (self.output @ x).real
        for n, scatter in enumerate(scatters, start=1):
            x = self.T @ x + scatter
            out[n] = (self.output @ x).real
        return out, x

    def spectrum(self, freq: ArrayLike, start: ArrayLike) -> NDArray[np.complex128]:
        """(n_freq, n_outputs) sum over all samples of y(n) exp(-2 pi i f n dt) dt, of the free motion from `start`."""
        z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64)) * self.dt)
        x = self.embed @ np.asarray(start, dtype=np.float64)
        eye = np.eye(len(self.T))
        return np.array([self.output @ sla.solve(eye - self.T / zk, x) * self.dt for zk in z])

    def multipliers(self) -> NDArray[np.complex128]:
        """(k,) eigenvalues of T."""
        return np.asarray(sla.eigvals(self.T), dtype=np.complex128)

    def poles(self) -> NDArray[np.complex128]:
        """(k,) poles in 1/s that the method gives in place of the true ones; parasitic ones among them."""
        multipliers = self.multipliers()
        return np.asarray(np.log(multipliers[multipliers != 0]) / self.dt, dtype=np.complex128)


def system_map(system: System, now: Floats | None = None, later: Floats | None = None) -> StepMap:
    """The step of a compiled `System` as a matrix, from the arrays that the steppers use.

    system : its readouts must be displacements.
    now, later : (n_state, n_inputs) state added within the step by unit forces at its two ends.
    """
    ports = [len(c.ports) for c in system.compiled]
    E = sla.block_diag(*(block for c in system.compiled for block in c.E))
    gap = np.concatenate([
        (not one_way) * (system.layout.incidence[i] @ c.rows[: ports[i]].reshape(ports[i], -1))
        for i, (c, one_way) in enumerate(zip(system.compiled, system.layout.driven, strict=True))
    ], axis=1)  # fmt: skip
    scatter = np.concatenate([
        c.W.reshape(ports[i], -1).T @ system.layout.incidence[i].T for i, c in enumerate(system.compiled)
    ])  # fmt: skip
    size = len(E)
    correct = np.eye(size) - scatter @ system.solve.G @ gap
    output = np.zeros((len(system.readouts), size))
    start = 0
    for c, p in zip(system.compiled, ports, strict=True):
        stop = start + 2 * c.basis.n_modes
        for row, channel in zip(c.rows[p:].reshape(-1, stop - start), c.readouts, strict=True):
            output[channel, start:stop] += row
        start = stop
    none = np.zeros((size, 0))
    return StepMap(
        system.dt,
        correct @ E - scatter @ system.solve.G @ (system.solve.gamma[:, None] * gap),
        none if now is None else correct @ now,
        none if later is None else correct @ later,
        output,
        np.eye(size),
    )


def held_position(problem: Problem, dt: float) -> StepMap:
    """Exact flow, force held over the step, gap zero at its end: the scheme of this project.

    Forces on the driven points go in a straight line from one sample to the next.
    """
    _, phi1, phi2 = (sla.block_diag(*blocks) for blocks in problem.flow(dt, 2))
    columns = problem.input_columns
    return system_map(problem.system(dt), dt * (phi1 - phi2) @ columns, dt * phi2 @ columns)


def exact(ode: Ode, dt: float) -> StepMap:
    """The exact flow of a form, forces held over each step: the measure for integrators, and no method by itself."""
    k, m = ode.G.shape
    big = np.zeros((k + m, k + m), dtype=np.result_type(ode.F, ode.G))
    big[:k, :k], big[:k, k:] = ode.F * dt, ode.G * dt
    full = sla.expm(big)
    return StepMap(dt, full[:k, :k], full[:k, k:], np.zeros((k, m)), ode.C, ode.embed)
