"""The scheme in NumPy, sample by sample: the same words as `docs/theory.md`, and what the kernel is held to.

One step: propagate every component without connections, read the gaps, find the forces, correct:

    x_u = E x + injections,   g_u = sum A C x_u,   f = -G (g_u + gamma g) + G b',   x+ = x_u + W A^T f.

Nonlinear connections see what the linear ones leave of their gaps (`connections`), and their forces are found together
(`law_solve`). A string whose tension rises is, at a given tension, a linear component with another x_u and W; its
tension is found around all this (`tension`), and so are the modal forces of strings with longitudinal motion
(`geometric`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.connections import LinearSolve, NonlinearSolve, linear_solve, nonlinear_solve
from tonewood.coupling.geometric_solve import GeometricSolve
from tonewood.coupling.law_solve import FrictionBranch, Partners, find_forces, solve_branches, stiffness
from tonewood.coupling.laws import Friction
from tonewood.coupling.system import Injection, PrescribedMotion, State, System
from tonewood.errors import NumericalError
from tonewood.modal.propagator import apply

Floats = NDArray[np.float64]

#: of the tension, N / N
TENSION_TOLERANCE = 1e-12
MAX_TENSION_ITERATIONS = 200


@dataclass
class Statistics:
    """Counts of a stepper's nonlinear solves since it was made.

    Attributes
    ----------
    steps : samples stepped.
    solves : nonlinear solves of a step's forces.
    iterations, most_iterations : of Newton's method on the forces, in all, and in one step at most.
    tension_iterations, most_tension_iterations : of the solve for the tensions.
    failures : steps whose forces were not found; each of them raised a `NumericalError`.
    redone : steps whose forces the ordinary iteration did not find, so that the search of last resort was asked.
    """

    steps: int = 0
    solves: int = 0
    iterations: int = 0
    most_iterations: int = 0
    tension_iterations: int = 0
    most_tension_iterations: int = 0
    failures: int = 0
    redone: int = 0


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One step at given tensions."""

    x: list[Floats]
    forces: Floats
    series: Floats
    slip: Floats
    stiffness: Callable[[], Floats] | None  # of the nonlinear connections, until the next attempt


class NumpyStepper:
    """Steps a `System`; slow and plain. Same interface as `kernel.KernelStepper`."""

    def __init__(self, system: System):
        self.system = system
        self.statistics = Statistics()
        self._geometric = GeometricSolve(system) if system.geometric else None
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
        NumericalError : the state is no longer finite, or a step's forces were not found; names what and when.
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
            self._check(free, time)  # before connections spread the fault to other components
            partners = self._partners({j: a[:, step] for j, a in moving.items()})
            done, tensions = self._step(x, free, guess, series, slip, tension[:, 0], partners, time)
            x, series, slip, guess = done.x, done.series, done.slip, done.forces
            tension = np.column_stack([tensions, tension[:, :2]])
            forces[step] = done.forces
            self._check(x, time)
            for i, compiled in enumerate(s.compiled):
                after = np.einsum("rmx,mx->r", rows[i], x[i])
                value = np.where(compiled.difference, after - before[i], before[i])
                np.add.at(out[step], compiled.readouts, value)
            out[step] += s.force_weights() @ done.forces
        for i, name in enumerate(s.names):
            s.modes_of(state, name)[:] = x[i].T
        if n:
            state.forces[:] = forces[-1]
        state.series, state.slip, state.tension = series, slip, tension
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
    ) -> tuple[_Attempt, Floats]:  # fmt: skip
        """Find tensions and forces of one step; `tension` (n_tensions,) is where to start."""

        def attempt() -> tuple[_Attempt, Floats]:
            branches = {}
            if (nonlinear := self.system.nonlinear) is not None:
                pairs = zip(nonlinear.laws, nonlinear.index, strict=True)
                for i, (law, j) in enumerate(pairs):
                    if isinstance(law, Friction):
                        branches[i] = FrictionBranch(law, float(partners.scale[i]), float(slip[j]))
            start = [guess]  # of the forces: those tried last

            def solve() -> tuple[_Attempt, Floats]:
                done = self._tensions(x, free, start[0], series, slip, tension, partners, branches, time)
                start[0] = done[0].forces
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

    def _tensions(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, tension: Floats,
        partners: Partners, branches: dict[int, FrictionBranch], time: float,
    ) -> tuple[_Attempt, Floats]:  # fmt: skip
        """Find tensions and forces, friction on its branches."""
        s = self.system
        strings = [
            (t, [s.slot(name) for name in law.components]) for t, law in enumerate(s.tensions) if s.tension_on[t]
        ]
        if self._geometric:
            return self._geometric_step(self._geometric, x, free, guess, series, slip, partners, branches, time)
        if not strings:
            return self._attempt(x, free, guess, series, slip, {}, partners, branches, time), np.zeros(len(s.tensions))
        parts = {i: part for _, slots in strings for i in slots if (part := s.compiled[i].tension) is not None}
        kappa = {t: parts[slots[0]].kappa for t, slots in strings}
        old = {t: sum(parts[i].stretch(x[i]) for i in slots) for t, slots in strings}
        T = {t: max(float(tension[t]), kappa[t] * old[t]) for t, _ in strings}
        for iteration in range(1, MAX_TENSION_ITERATIONS + 1):
            tensions = {i: T[t] for t, slots in strings for i in slots}
            done = self._attempt(x, free, guess, series, slip, tensions, partners, branches, time)
            converged = True
            for t, slots in strings:
                excess = T[t] - kappa[t] * (sum(parts[i].stretch(done.x[i]) for i in slots) + old[t])
                slope = 1 - kappa[t] * sum(parts[i].slope(x[i], done.x[i], T[t]) for i in slots)
                converged &= abs(excess) <= TENSION_TOLERANCE * T[t]
                T[t] = max(kappa[t] * old[t], T[t] - excess / slope)
            if converged:
                self.statistics.tension_iterations += iteration
                most = max(self.statistics.most_tension_iterations, iteration)
                self.statistics.most_tension_iterations = most
                return done, np.array([T.get(t, 0.0) for t in range(len(s.tensions))])
            guess = done.forces
        if self._careful:
            return self._bracketed(x, free, guess, series, slip, T, old, partners, branches, time)
        raise ValueError(f"the tensions of {', '.join(t.name for t in s.tensions)} were not found")

    def _bracketed(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats, T: dict[int, float],
        old: dict[int, float], partners: Partners, branches: dict[int, FrictionBranch], time: float,
    ) -> tuple[_Attempt, Floats]:  # fmt: skip
        """The same tension by tension, by brackets, until none changes any more; `old` are the stretches before.

        With the other tensions held, what a tension exceeds kappa (S+ + S) by has one zero, and is negative below and
        positive above it: the step is a monotone problem for each set of tensions held, whose solutions these zeros
        are. No slope is asked for. From string to string tensions answer each other through the body alone, weakly.
        """
        from scipy.optimize import brentq  # heavy, and seldom needed

        s = self.system
        slots = {t: [s.slot(name) for name in s.tensions[t].components] for t in T}
        parts = {i: part for among in slots.values() for i in among if (part := s.compiled[i].tension) is not None}
        done: list[_Attempt] = []

        def excess(t: int, tension: float) -> float:
            tried = {**T, t: tension}
            start = done[0].forces if done else guess
            found = self._attempt(
                x, free, start, series, slip, {i: tried[q] for q in slots for i in slots[q]}, partners, branches, time
            )
            done[:] = [found]
            return tension - parts[slots[t][0]].kappa * (sum(parts[i].stretch(found.x[i]) for i in slots[t]) + old[t])

        for _ in range(MAX_TENSION_ITERATIONS):
            still = True
            for t in T:
                least = parts[slots[t][0]].kappa * old[t]
                if abs(excess(t, T[t])) <= TENSION_TOLERANCE * T[t]:
                    continue
                still, high = False, max(T[t], least, 1e-300)
                while excess(t, high) < 0.0 and high < 1e300:
                    high *= 2.0
                if excess(t, least) < 0.0:
                    T[t] = float(brentq(lambda tension, t=t: excess(t, tension), least, high, xtol=1e-300, rtol=1e-15))
                else:
                    T[t] = least
            if still:
                return done[0], np.array([T.get(t, 0.0) for t in range(len(s.tensions))])
        raise ValueError(f"the tensions of {', '.join(t.name for t in s.tensions)} were not found")

    def _geometric_step(
        self, solve: GeometricSolve, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats,
        partners: Partners, branches: dict[int, FrictionBranch], time: float,
    ) -> tuple[_Attempt, Floats]:  # fmt: skip
        """One step of strings whose longitudinal motion is stepped."""
        done: list[_Attempt] = []

        def attempt(free: list[Floats]) -> list[Floats]:
            start = done[-1].forces if done else guess
            done[:] = [self._attempt(x, free, start, series, slip, {}, partners, branches, time)]
            return done[0].x

        def answer() -> Floats:
            return solve.compliance if done[0].stiffness is None else solve.answer(done[0].stiffness())

        _, iterations, found = solve.find(x, free, attempt, answer)
        if not found:
            names = ", ".join(g.name for g in self.system.geometric)
            raise ValueError(f"the forces of {names} were not found")
        self.statistics.tension_iterations += iterations
        self.statistics.most_tension_iterations = max(self.statistics.most_tension_iterations, iterations)
        return done[0], np.zeros(len(self.system.tensions))

    def _attempt(
        self, x: list[Floats], free: list[Floats], guess: Floats, series: Floats, slip: Floats,
        tension: dict[int, float], partners: Partners, branches: dict[int, FrictionBranch], time: float,
    ) -> _Attempt:  # fmt: skip
        """One step at given tensions (by component slot)."""
        s = self.system
        m = len(s.connections)
        free, W = list(free), [c.W for c in s.compiled]
        for i, T in tension.items():
            if (part := s.compiled[i].tension) is not None:
                free[i], W[i] = part.step(x[i], free[i], W[i], T)
        linear, nonlinear = self._solves(W, tension)

        def gaps(state: list[Floats]) -> Floats:
            total = np.zeros(m)
            for i, c in enumerate(s.compiled):
                if not s.driven[i]:
                    total += s.incidence(i) @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], state[i])
            return total

        gap, gap_free = gaps(x), gaps(free)
        f = linear.constant - linear.G @ (gap_free + linear.gamma * gap)
        series, slip, gives = series.copy(), slip.copy(), None
        if nonlinear is not None:
            on = nonlinear.index
            lag = (1 - nonlinear.theta) / nonlinear.theta * series[on]
            here, before = gap_free[on] + nonlinear.from_linear @ f - lag, gap[on] + series[on]
            found = find_forces(
                nonlinear.laws, nonlinear.Z, here, before, s.dt, partners, guess[on], branches, careful=self._careful
            )
            self.statistics.solves += 1
            self.statistics.iterations += found.iterations
            self.statistics.most_iterations = max(self.statistics.most_iterations, found.iterations)
            if not found.converged:
                strings = [t.name for t in s.tensions] + [g.name for g in s.geometric]
                acting = [s.connections[j].name for j in on[found.forces != 0.0]] or strings
                names = ", ".join(acting or [s.connections[j].name for j in on])
                raise ValueError(f"the forces of {names} were not found")
            f = f - nonlinear.answer @ found.forces
            f[on] = found.forces
            series[on] = nonlinear.residual @ found.forces / nonlinear.theta - lag
            for i, friction in branches.items():
                slip[on[i]] = friction.velocity
            gives = partial(
                stiffness, nonlinear.laws, nonlinear.Z, here, before, s.dt, partners, found.forces, branches
            )  # fmt: skip
        after = [
            free[i] + np.einsum("p,pmx->mx", s.incidence(i).T @ f, W[i]) for i in range(len(s.names))
        ]  # fmt: skip
        return _Attempt(after, f, series, slip, gives)

    def _solves(self, W: list[Floats], tension: dict[int, float]) -> tuple[LinearSolve, NonlinearSolve | None]:
        s = self.system
        if not tension:
            return s.solve, s.nonlinear
        compliance, residual = np.zeros((len(s.connections),) * 2), s.gap_matrix("residual")
        for i, c in enumerate(s.compiled):
            if not s.driven[i]:
                a = s.incidence(i)
                compliance += a @ np.einsum("pmx,qmx->pq", c.rows[: len(c.ports)], W[i]) @ a.T
        laws = [c.law for c in s.connections]
        linear = linear_solve(laws, compliance, residual, s.dt)
        return linear, nonlinear_solve(laws, linear, compliance, residual, s.dt)
