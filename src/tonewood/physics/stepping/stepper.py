"""The scheme in NumPy, sample by sample: in the words of `docs/theory.md`, and the reference of the kernel.

One step: propagate every component without connections, read the gaps, find the forces, correct:

    x_u = E x + injections,   g_u = sum A C x_u,   f = -G (g_u + gamma g) + G b',   x+ = x_u + W A^T f.

Nonlinear connections see their gaps with the linear ones eliminated (`connections`), and their forces are found
together (`law_solve`). The rising tension of a string, with its longitudinal motion where that is stepped, is one more
linear force along a direction known beforehand (`tension`, `geometric`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import NumericalError
from tonewood.physics.coupling.geometric_solve import rising_solve
from tonewood.physics.coupling.law_solve import FrictionBranch, Partners, find_forces, solve_branches
from tonewood.physics.coupling.laws import Friction
from tonewood.physics.coupling.phantom_solve import PhantomForces
from tonewood.physics.coupling.system import Injection, PrescribedMotion, State, System
from tonewood.physics.coupling.tension_solve import TensionsOverStep
from tonewood.physics.modal.propagator import apply

Floats = NDArray[np.float64]


@dataclass
class Statistics:
    """Counts of a stepper's nonlinear solves since it was made.

    Attributes
    ----------
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
    """One step."""

    x: list[Floats]
    forces: Floats
    series: Floats
    slip: Floats
    rising: TensionsOverStep | None
    mean: Floats  # psi_m of the rising tensions


class NumpyStepper:
    """Steps a `System`; slow and plain. Same interface as `kernel.KernelStepper`."""

    def __init__(self, system: System):
        self.system = system
        self.statistics = Statistics()
        self._tension = rising_solve(system)
        self._phantoms = PhantomForces(system)
        self._careful = False

    def run(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[PrescribedMotion] = ()
    ) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps.

        Returns
        -------
        out : (n, n_readouts).
        forces : (n, m) N, connection forces, each constant over its step.

        Raises
        ------
        NumericalError : the state is no longer finite, or a step's forces were not found; names component or
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
        tension = state.tension if state.tension.size else still.tension
        memory = state.phantoms if state.phantoms.size else still.phantoms
        memory[[not on for on in s.phantoms_on]] = 0.0
        moving = s.controlled(controls, state.sample, n)
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
            due = self._phantoms.advance(x, memory)
            for slot, vector, force in zip(self._phantoms.targets, self._phantoms.vectors, due, strict=True):
                free[slot] += force * vector
            self._check(free, time)  # before connections spread the fault to other components
            partners = self._partners({j: a[:, step] for j, a in moving.items()})
            done = self._step(x, free, guess, series, slip, tension, partners, time)
            start, x = x, done.x
            series, slip, guess = done.series, done.slip, done.forces
            forces[step] = done.forces
            self._check(x, time)
            for i, compiled in enumerate(s.compiled):
                after = np.einsum("rmx,mx->r", rows[i], x[i])
                value = np.where(compiled.difference, after - before[i], before[i])
                np.add.at(out[step], compiled.readouts, value)
            out[step] += s.force_weights() @ done.forces
            # last: velocities that pay for psi are no part of the step's mean acceleration
            if self._tension and done.rising:
                tension = self._tension.carried(start, x, done.rising, done.mean, tension, state.sample + step + 1)
            elif tension.size:
                tension = np.zeros_like(tension)
        for i, name in enumerate(s.names):
            s.modes_of(state, name)[:] = x[i].T
        if n:
            state.forces[:] = forces[-1]
        state.series, state.slip, state.tension, state.phantoms = series, slip, tension, memory
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
        velocity = np.array([law.velocity if isinstance(law, Friction) else 0.0 for law in laws])
        partners = Partners(offset, offset.copy(), velocity, np.ones(len(laws)))
        for j, values in moving.items():
            partners.offset[j], partners.offset_after[j], partners.velocity[j], partners.scale[j] = values
        return partners

    def _step(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, tension: Floats,
        partners: Partners, time: float,
    ) -> _Attempt:  # fmt: skip
        """Find the forces of one step."""

        def attempt() -> _Attempt:
            branches = {}
            if (nonlinear := self.system.nonlinear) is not None:
                pairs = zip(nonlinear.laws, nonlinear.index, strict=True)
                for i, (law, j) in enumerate(pairs):
                    if isinstance(law, Friction):
                        branches[i] = FrictionBranch(law, float(partners.scale[i]), float(slip[j]))
            start = [guess]  # of the forces: those tried last

            def solve() -> _Attempt:
                done = self._attempt(x, free, start[0], series, slip, tension, partners, branches)
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
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, tension: Floats,
        partners: Partners, branches: dict[int, FrictionBranch],
    ) -> _Attempt:  # fmt: skip
        """Find the forces, friction on its branches."""
        s = self.system
        linear, nonlinear = s.solve, s.nonlinear
        gap, gap_free = s.gaps(x), s.gaps(free)
        f = linear.constant - linear.apply(gap_free + linear.gamma * gap)
        rising = self._tension.over(x, free, f, tension) if self._tension else None
        mean = np.zeros(0)
        if rising is not None:
            mean = rising.mean(f)
            gap_free = gap_free + rising.reach @ mean
            f = f - linear.apply(rising.reach @ mean)
        series, slip = series.copy(), slip.copy()
        if nonlinear is not None:
            on, Z = nonlinear.index, nonlinear.Z
            lag = (1 - nonlinear.theta) / nonlinear.theta * series[on]
            here, before = gap_free[on] + nonlinear.from_linear @ f - lag, gap[on] + series[on]
            if rising is not None:
                moved = rising.reach[on] - nonlinear.from_linear @ linear.apply(rising.reach)
                answer = rising.answer(moved)
                Z = Z + moved @ answer
            found = find_forces(
                nonlinear.laws, Z, here, before, s.dt, partners, guess[on], branches, careful=self._careful
            )
            self.statistics.solves += 1
            self.statistics.iterations += found.iterations
            self.statistics.most_iterations = max(self.statistics.most_iterations, found.iterations)
            if not found.converged:
                strings = [t.name for t in s.rising]
                acting = [s.connections[j].name for j in on[found.forces != 0.0]] or strings
                names = ", ".join(acting or [s.connections[j].name for j in on])
                raise ValueError(f"the forces of {names} were not found")
            f = f - nonlinear.answer @ found.forces
            if rising is not None:
                more = answer @ found.forces
                mean = mean + more
                f = f - linear.apply(rising.reach @ more)
            f[on] = found.forces
            series[on] = nonlinear.residual @ found.forces / nonlinear.theta - lag
            for i, friction in branches.items():
                slip[on[i]] = friction.velocity
        after = [
            free[i] + np.einsum("p,pmx->mx", s.incidence(i).T @ f, c.W) for i, c in enumerate(s.compiled)
        ]  # fmt: skip
        if rising is not None:
            after = rising.after(after, mean)
        return _Attempt(after, f, series, slip, rising, mean)
