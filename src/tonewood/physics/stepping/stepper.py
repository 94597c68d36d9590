"""The scheme in NumPy, sample by sample: in the words of `docs/theory.md`, and the reference of the kernel.

One step: propagate every component without connections, read the gaps, find the forces, correct:

    x_u = E x + injections,   g_u = sum A C x_u,   f = -G (g_u + gamma g) + G b',   x+ = x_u + W A^T f.

Nonlinear connections see their gaps with the linear ones eliminated (`connections`), and their forces are found
together (`laws.solve`). Each potential (a rising tension, a coupling to longitudinal motion) is one more linear force
along a direction known beforehand (`potentials`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.errors import NumericalError
from tonewood.physics.coupling.laws.friction import Friction, FrictionBranch, solve_branches
from tonewood.physics.coupling.laws.solve import Partners, find_forces
from tonewood.physics.coupling.potentials.solve import DrivenForces, PotentialSolve, PotentialsOverStep
from tonewood.physics.coupling.system import Injection, PrescribedMotion, State, System
from tonewood.physics.modal.propagator import apply
from tonewood.physics.stepping.forcing import controlled
from tonewood.support.arrays import Floats


@dataclass
class Statistics:
    """Counts of a stepper's nonlinear solves since it was made.

    steps : samples stepped.
    solves : nonlinear solves of a step's forces.
    iterations, most_iterations : of Newton's method on the forces, in all, and in one step at most.
    failures : steps whose forces were not found; each of them raised a `NumericalError`.
    redone : steps whose forces the ordinary iteration did not find, so that the search of last resort was asked.
    """

    steps: int = 0
    solves: int = 0
    iterations: int = 0
    most_iterations: int = 0
    failures: int = 0
    redone: int = 0


@dataclass(frozen=True, eq=False)
class _Attempt:
    x: list[Floats]
    forces: Floats
    series: Floats
    slip: Floats
    over: PotentialsOverStep | None
    mean: Floats  # psi_m of the potentials


class NumpyStepper:
    """Steps a `System`; slow and plain. Same interface as `kernel.KernelStepper`."""

    def __init__(self, system: System):
        self.system = system
        self.statistics = Statistics()
        self._potentials, self._driven = PotentialSolve(system), DrivenForces(system)
        self._careful = False

    def run(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[PrescribedMotion] = ()
    ) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps.

        Returns out : (n, n_readouts).
        forces : (n, m) N, connection forces, each constant over its step.
        Raises NumericalError : the state is no longer finite, or a step's forces were not found; names component or
            connection, and time.
        """
        s = self.system
        m = len(s.connections)
        x = [s.modes_of(state, name).T.copy() for name in s.names]
        rows = [c.rows[len(c.ports) :] for c in s.compiled]
        out, forces = np.zeros((n, len(s.readouts))), np.zeros((n, m))
        still = s.start()
        series = state.series if state.series.size else still.series
        if s.nonlinear is not None:
            series = s.nonlinear.carried_series(series)
        slip = state.slip if state.slip.size else still.slip
        memory = s.potentials.checked(state.potentials)
        moving = controlled(s, controls, state.sample, n)
        guess = np.asarray(state.forces, dtype=np.float64)

        for step in range(n):
            time = (state.sample + step) * s.dt
            before = [np.einsum("rmx,mx->r", r, xi) for r, xi in zip(rows, x, strict=True)]
            free = [apply(c.E, xi) for c, xi in zip(s.compiled, x, strict=True)]
            for injection in injections:
                k = state.sample + step - injection.start
                if 0 <= k < injection.values.shape[1]:
                    free[s.slot(injection.component)] += np.einsum(
                        "v,vmx->mx", injection.values[:, k], injection.vectors
                    )
            due = self._driven.advance(x, memory)
            for slot, vector, force in zip(self._driven.targets, self._driven.vectors, due, strict=True):
                free[slot] += force * vector
            self._check(free, time)  # before connections spread the fault to other components
            partners = self._partners({j: a[:, step] for j, a in moving.items()})
            done = self._step(x, free, guess, series, slip, memory, partners, time)
            x = done.x
            series, slip, guess = done.series, done.slip, done.forces
            forces[step] = done.forces
            self._check(x, time)
            for i, compiled in enumerate(s.compiled):
                after = np.einsum("rmx,mx->r", rows[i], x[i])
                value = np.where(compiled.difference, after - before[i], before[i])
                np.add.at(out[step], compiled.readouts, value)
            out[step] += s.layout.force_weights @ done.forces
            # last: velocities that pay for psi are no part of the step's mean acceleration
            if done.over is not None:
                memory = self._potentials.carried(x, done.over, done.mean, memory, state.sample + step + 1)
        for i, name in enumerate(s.names):
            s.modes_of(state, name)[:] = x[i].T
        if n:
            state.forces[:] = forces[-1]
        state.series, state.slip, state.potentials = series, slip, memory
        s.check_potentials(state)
        state.sample += n
        self.statistics.steps += n
        return out, forces

    def _check(self, x: list[Floats], time: float) -> None:
        for name, modes in zip(self.system.names, x, strict=True):
            if not np.all(np.isfinite(modes)):
                raise NumericalError(f"{name} is no longer finite at {time:.6f} s")

    def _partners(self, moving: dict[int, Floats]) -> Partners:
        laws = self.system.nonlinear.laws if self.system.nonlinear else ()
        offset = np.array([law.offset for law in laws])
        velocity = np.array([law.velocity for law in laws])
        partners = Partners(offset, offset.copy(), velocity, np.ones(len(laws)))
        for j, values in moving.items():
            partners.offset[j], partners.offset_after[j], partners.velocity[j], partners.scale[j] = values
        return partners

    def _step(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, memory: Floats,
        partners: Partners, time: float,
    ) -> _Attempt:  # fmt: skip
        def attempt() -> _Attempt:
            branches = {}
            if (nonlinear := self.system.nonlinear) is not None:
                pairs = zip(nonlinear.laws, nonlinear.index, strict=True)
                for i, (law, j) in enumerate(pairs):
                    if isinstance(law, Friction):
                        branches[i] = FrictionBranch(law, float(partners.scale[i]), float(slip[j]))
            start = [guess]  # of the forces: those tried last

            def solve() -> _Attempt:
                done = self._attempt(x, free, start[0], series, slip, memory, partners, branches)
                start[0] = done.forces
                return done

            return solve_branches(list(branches.values()), solve)

        try:
            return attempt()
        except ValueError:
            pass
        self.statistics.redone += 1
        self._careful = True
        try:
            return attempt()
        except ValueError as fault:
            self.statistics.failures += 1
            raise NumericalError(f"{fault} at {time:.6f} s") from None
        finally:
            self._careful = False

    def _attempt(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, memory: Floats,
        partners: Partners, branches: dict[int, FrictionBranch],
    ) -> _Attempt:  # fmt: skip
        """Find the forces, friction on its branches."""
        s = self.system
        linear, nonlinear = s.solve, s.nonlinear
        gap, gap_free = s.gaps(x), s.gaps(free)
        f = linear.constant - linear.apply(gap_free + linear.gamma * gap)
        over = self._potentials.over(x, free, f, memory) if self._potentials.active else None
        mean = np.zeros(0)
        if over is not None:
            mean = over.mean(f)
            gap_free = gap_free + over.reach @ mean
            f = f - linear.apply(over.reach @ mean)
        series, slip = series.copy(), slip.copy()
        if nonlinear is not None:
            on, Z = nonlinear.index, nonlinear.Z
            lag = (1 - nonlinear.theta) / nonlinear.theta * series[on]
            here, before = gap_free[on] + nonlinear.from_linear @ f - lag, gap[on] + series[on]
            if over is not None:
                moved = over.reach[on] - nonlinear.from_linear @ linear.apply(over.reach)
                answer = over.answer(moved)
                Z = Z + moved @ answer
            solution = find_forces(
                nonlinear.laws, Z, here, before, s.dt, partners, guess[on], branches, careful=self._careful
            )
            self.statistics.solves += 1
            self.statistics.iterations += solution.iterations
            self.statistics.most_iterations = max(self.statistics.most_iterations, solution.iterations)
            if not solution.converged:
                acting = [s.connections[j].name for j in on[solution.forces != 0.0]] or [p.name for p in s.potentials]
                names = ", ".join(acting or [s.connections[j].name for j in on])
                raise ValueError(f"the forces of {names} were not found")
            f = f - nonlinear.answer @ solution.forces
            if over is not None:
                more = answer @ solution.forces
                mean = mean + more
                f = f - linear.apply(over.reach @ more)
            f[on] = solution.forces
            series[on] = nonlinear.residual @ solution.forces / nonlinear.theta - lag
            for i, friction in branches.items():
                slip[on[i]] = friction.velocity
        after = [
            free[i] + np.einsum("p,pmx->mx", s.layout.incidence[i].T @ f, c.W) for i, c in enumerate(s.compiled)
        ]  # fmt: skip
        if over is not None:
            after = over.after(after, mean)
        return _Attempt(after, f, series, slip, over, mean)
