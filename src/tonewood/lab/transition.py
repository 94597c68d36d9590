"""The matrix-exponential counterpart of the modal updates: one dense step matrix in physical coordinates.

x = (u, u'), x' = A x + (0, M^-1 F): x+ = exp(A H) x + sum_i W_i F(t_i) with the same Lagrange polynomials as the modal
updates and phi-functions of the matrix (Chinnakonda 2007, p. 16). Per step it costs (2 n)^2 multiplications, the modal
update about 6 n; and it keeps every spurious mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.lab.assembled import Matrices, state_matrix
from tonewood.lab.interpolatory import Update, lagrange
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class Transition:
    """One update of the whole system: x+ = E x + sum_i W_i F(t_i).

    update : gives nodes and polynomials.  dt : s between samples.
    E : (2n, 2n).  W : (n_nodes, 2n, n).
    """

    update: Update
    dt: float
    E: Floats
    W: Floats

    @classmethod
    def of(cls, system: Matrices, update: Update, dt: float) -> Transition:
        """Build for even steps."""
        if not update.weighted:
            raise ValueError("transition matrices are made for weighted updates")
        n, H = len(system.M), dt * update.span
        A = state_matrix(system)
        nodes = update.nodes(np.linspace(0.0, H, update.span + 1)) / H
        L = lagrange(nodes)
        # exp of the augmented matrix holds H^(j+1) phi_(j+1)(A H) B, the flow of F = t^j / j!
        size, orders = 2 * n, nodes.size
        B = np.vstack([np.zeros((n, n)), sla.inv(system.M)])
        big = np.zeros((size + orders * n,) * 2)
        big[:size, :size] = A * H
        big[:size, size : size + n] = B * H
        for j in range(orders - 1):
            big[size + j * n : size + (j + 1) * n, size + (j + 1) * n : size + (j + 2) * n] = np.eye(n)
        full = np.asarray(sla.expm(big))[:size]
        moments = [factorial(j) * full[:, size + j * n : size + (j + 1) * n] for j in range(orders)]
        return cls(update, dt, full[:, :size], np.einsum("ij,jxf->ixf", L, np.array(moments)))

    def run(self, force: Callable[[Floats], ArrayLike], n: int, start: ArrayLike | None = None) -> Floats:
        """(n_updates + 1, 2 n_dof) u and u' over n samples of F(t) -> (n_times, n_dof)."""
        x = np.zeros(len(self.E)) if start is None else np.asarray(start, dtype=np.float64)
        span = self.update.span
        out = [x]
        for k in range(0, n - span, span):
            nodes = self.update.nodes(np.asarray(np.arange(k, k + span + 1) * self.dt, dtype=np.float64))
            x = self.E @ x + np.einsum("ixf,if->x", self.W, np.asarray(force(nodes)))
            out.append(x)
        return np.array(out)
