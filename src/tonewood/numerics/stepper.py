"""The scheme in NumPy, sample by sample: the same words as `docs/theory.md`, and what the kernel is held to.

One step: propagate every component without connections, read the gaps, find the forces, correct:

    x_u = E x + injections,   g_u = sum A C x_u,   f = -G (g_u + gamma g) + G b',   x+ = x_u + W A^T f.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import NumericalError
from tonewood.numerics.propagator import apply
from tonewood.numerics.system import Injection, State, System

Floats = NDArray[np.float64]


class NumpyStepper:
    """Steps a `System`; slow and plain. Same interface as `kernel.KernelStepper`."""

    def __init__(self, system: System):
        self.system = system

    def run(self, state: State, n: int, injections: Sequence[Injection] = ()) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps.

        Returns
        -------
        out : (n, n_readouts).
        forces : (n, m) N, connection forces, each constant over its step.

        Raises
        ------
        NumericalError : the state is no longer finite; names component and time.
        """
        s, solve = self.system, self.system.solve
        m = len(s.connections)
        x = [s.modes_of(state, name).T.copy() for name in s.names]
        incidence = [s.incidence(i) for i in range(len(s.names))]
        ports = [len(c.ports) for c in s.compiled]
        out, forces = np.zeros((n, len(s.readouts))), np.zeros((n, m))
        two_way = [i for i, one_way in enumerate(s.driven) if not one_way]

        def check(i: int, step: int) -> None:
            if not np.all(np.isfinite(x[i])):
                t = (state.sample + step) * s.dt
                raise NumericalError(f"{s.names[i]} is no longer finite at {t:.6f} s")

        def gaps() -> Floats:
            total = np.zeros(m)
            for i in two_way:
                total += incidence[i] @ np.einsum("pmx,mx->p", s.compiled[i].rows[: ports[i]], x[i])
            return total

        for step in range(n):
            gap = gaps()
            before = [np.einsum("rmx,mx->r", c.rows[p:], xi) for c, p, xi in zip(s.compiled, ports, x, strict=True)]
            for i, compiled in enumerate(s.compiled):
                x[i] = apply(compiled.E, x[i])
            for injection in injections:
                k = state.sample + step - injection.start
                if 0 <= k < injection.values.shape[1]:
                    x[s.slot(injection.component)] += np.einsum("v,vmx->mx", injection.values[:, k], injection.vectors)
            for i in range(len(x)):
                check(i, step)  # before connections spread the fault to other components
            f = solve.constant - solve.G @ (gaps() + solve.gamma * gap)
            forces[step] = f
            for i, compiled in enumerate(s.compiled):
                x[i] += np.einsum("p,pmx->mx", incidence[i].T @ f, compiled.W)
                check(i, step)
                after = np.einsum("rmx,mx->r", compiled.rows[ports[i] :], x[i])
                value = np.where(compiled.difference, after - before[i], before[i])
                np.add.at(out[step], compiled.readouts, value)
            out[step] += s.force_weights() @ f
        for i, name in enumerate(s.names):
            s.modes_of(state, name)[:] = x[i].T
        if n:
            state.forces[:] = forces[-1]
        state.sample += n
        return out, forces
