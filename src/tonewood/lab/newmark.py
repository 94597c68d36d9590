"""Direct time integration of M u'' + C u' + K u = F: Newmark's family and the HHT-alpha method.

    M a+ + (1 + alpha) C v+ - alpha C v + (1 + alpha) K u+ - alpha K u = F(t + (1 + alpha) h)
    u+ = u + h v + h^2 [(1/2 - beta) a + beta a+],    v+ = v + h [(1 - gamma) a + gamma a+]

alpha = 0, beta = 1/4, gamma = 1/2 is the average-acceleration method. HHT-alpha (Hilber, Hughes & Taylor 1977), alpha
in [-1/3, 0], beta = (1 - alpha)^2/4, gamma = 1/2 - alpha, is of second order and damps modes that it does not resolve:
for an infinite frequency its multipliers have moduli up to (1 + alpha)/(1 - alpha). The first acceleration is that of
equilibrium; a stiff mode that is out of balance at the start then overshoots in velocity, in proportion to omega h, and
damping that couples it to the others carries that over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.lab.assembled import Matrices
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Newmark:
    """A method of the family; see the module.

    name : short.  alpha, beta, gamma : unit-free.  order : stated order in h.
    """

    name: str
    alpha: float
    beta: float
    gamma: float
    order: int = 2

    def step_matrix(self, system: Matrices, h: float) -> tuple[Floats, Floats]:
        """T (3n, 3n) and p (3n, n): (u, h v, h^2 a)+ = T (u, h v, h^2 a) + p F; F at t + (1 + alpha) h."""
        n = len(system.M)
        one, b, g, w = np.eye(n), self.beta, self.gamma, 1 + self.alpha
        M, C, K = system.M / h**2, system.C / h, system.K
        lead = M + w * g * C + w * b * K
        past = np.hstack([
            -w * K + self.alpha * K,
            -w * C + self.alpha * C - w * K,
            -w * (1 - g) * C - w * (0.5 - b) * K,
        ])  # fmt: skip
        a, force = sla.solve(lead, past), sla.solve(lead, one)
        u = np.hstack([one, one, (0.5 - b) * one]) + b * a
        v = np.hstack([0 * one, one, (1 - g) * one]) + g * a
        return np.vstack([u, v, a]), np.vstack([b * force, g * force, force])

    def run(
        self,
        system: Matrices,
        h: float,
        n: int,
        start: tuple[ArrayLike, ArrayLike],
        force: Callable[[float], ArrayLike] | None = None,
    ) -> tuple[Floats, Floats]:
        """Displacements and velocities (n, n_dof) at 0, h, ... from the displacements and velocities `start`."""
        u0, v0 = (np.asarray(x, dtype=np.float64) for x in start)
        none = np.zeros(len(system.M))
        force_at_0 = np.asarray(none if force is None else force(0.0), dtype=np.float64)
        a0 = sla.solve(system.M, force_at_0 - system.C @ v0 - system.K @ u0)
        T, p = self.step_matrix(system, h)
        x = np.concatenate([u0, h * v0, h**2 * a0])
        out = np.empty((n, x.size))
        for k in range(n):
            out[k] = x
            x = T @ x
            if force is not None:
                x += p @ np.asarray(force((k + 1 + self.alpha) * h), dtype=np.float64)
        size = len(system.M)
        return out[:, :size], out[:, size : 2 * size] / h


def hht(alpha: float) -> Newmark:
    """HHT-alpha."""
    if not -1 / 3 <= alpha <= 0:
        raise ValueError(f"HHT-alpha takes alpha from -1/3 to 0, not {alpha}")
    return Newmark(f"HHT-alpha ({alpha:g})", alpha, (1 - alpha) ** 2 / 4, 0.5 - alpha)


AVERAGE_ACCELERATION = Newmark("average acceleration", 0.0, 0.25, 0.5)
HHT = hht(-0.3)
