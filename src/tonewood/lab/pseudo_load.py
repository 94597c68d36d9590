"""Real modes with the damping that couples them moved to the right-hand side (Chinnakonda 2007, Eq. 2.3).

    q'' + 2 xi Omega q' + Omega^2 q = Q(t) - X q',    X = nondiag(C*),    C* = P^T C P

(printed with Omega for both omega and omega^2). The right-hand side is taken as linear over each step, and each mode
carries it exactly. The unknown end value of q' is found

* in one shot (Henkel & Mar 1993, the thesis' ref. 5): one linear system of the size of the real modes per step;
* by Picard's iteration (Fromme & Golberg 1998, ref. 11): from a guess of q' over a window of steps, again and again;
  it converges to the same motion, the faster the weaker X and the shorter the window.

Neither is exact for a piecewise linear load, because q' is not piecewise linear: both are of second order, where
complex modes (P1) make no error at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.errors import NumericalError
from tonewood.lab.assembled import Matrices
from tonewood.lab.interpolatory import P1
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import flow, real_form
from tonewood.physics.modal.synthesis import real_modes
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class PseudoLoad:
    """A system in real modes, the off-diagonal modal damping apart.

    shapes : (n_dof, n_modes) mass-normalised.  basis : modes with the diagonal of C*, driven at ``0``, ``1``, ...
    coupling : (n_modes, n_modes) X, 1/s.
    """

    shapes: Floats
    basis: ModalBasis
    coupling: Floats

    @classmethod
    def of(cls, system: Matrices) -> PseudoLoad:
        """Split the modal damping of a system with mass at every dof."""
        shapes, omega, _, _ = real_modes(system.M, system.K)
        damping = shapes.T @ system.C @ shapes
        named = {str(k): row for k, row in enumerate(np.eye(omega.size))}
        basis = ModalBasis.real(omega, np.diag(damping) / 2, named)
        return cls(shapes, basis, damping - np.diag(np.diag(damping)))

    def _step(self, h: float) -> tuple[Floats, Floats, Floats]:
        """E (n, 2, 2), W1, W2 (n, 2) of (q, q') per unit load at the two ends of a step."""
        form = real_form(self.basis)
        every = np.arange(self.basis.n_modes)
        read = np.stack([form.C[every, every], form.rows("velocity", every)[every, every]], axis=1)
        E = read @ flow(self.basis, h, 0)[0] @ sla.inv(read)
        W = np.einsum("mxy,imyz,mz->imx", read, P1.weights(self.basis, h, [0.0, 1.0]), form.B[every, every])
        return E, W[0], W[1]

    def one_shot(self, forces: ArrayLike, h: float, start: tuple[ArrayLike, ArrayLike] | None = None) -> Floats:
        """Displacements (n, n_dof) at 0, h, ... of forces (n, n_dof) N sampled there."""
        Q, q, v = self._begin(forces, start)
        E, W1, W2 = self._step(h)
        X = self.coupling
        lead = sla.lu_factor(np.eye(len(X)) + W2[:, 1, None] * X)
        out = np.empty_like(Q)
        for k in range(len(Q)):
            out[k] = q
            if k + 1 == len(Q):
                break
            now, later = Q[k] - X @ v, Q[k + 1]
            free = np.stack([q, v], axis=1)
            moved = np.einsum("mxy,my->mx", E, free) + W1 * now[:, None] + W2 * later[:, None]
            v = sla.lu_solve(lead, moved[:, 1])
            q = moved[:, 0] - W2[:, 0] * (X @ v)
        return np.asarray(out @ self.shapes.T)

    def picard(
        self,
        forces: ArrayLike,
        h: float,
        start: tuple[ArrayLike, ArrayLike] | None = None,
        *,
        window: int = 1,
        rtol: float = 1e-13,
        max_iterations: int = 500,
    ) -> tuple[Floats, float]:
        """Return the response by iteration over windows of some steps.

        Returns displacements : (n, n_dof).  iterations : mean number per window.
        Raises NumericalError : an iteration does not converge within `max_iterations`, or overflows.
        """
        Q, q, v = self._begin(forces, start)
        E, W1, W2 = self._step(h)
        X = self.coupling
        out = np.empty_like(Q)
        out[0] = q
        total, windows = 0, 0
        for first in range(0, len(Q) - 1, window):
            last = min(first + window, len(Q) - 1)
            speed = np.repeat(v[None], last - first + 1, axis=0)
            for _ in range(max_iterations):
                total += 1
                load = Q[first : last + 1] - speed @ X.T
                state = np.stack([q, v], axis=1)
                new, path = speed.copy(), [q]
                for k in range(last - first):
                    state = np.einsum("mxy,my->mx", E, state) + W1 * load[k][:, None] + W2 * load[k + 1][:, None]
                    new[k + 1] = state[:, 1]
                    path.append(state[:, 0])
                change, size = np.abs(new - speed).max(), np.abs(new).max()
                speed = new
                if not np.isfinite(size):
                    raise NumericalError(f"Picard's iteration overflows over a window of {window} steps")
                if change <= rtol * max(size, 1e-300):
                    break
            else:
                raise NumericalError(f"Picard's iteration does not converge in {max_iterations}")
            out[first + 1 : last + 1] = path[1:]
            q, v = path[-1], speed[-1]
            windows += 1
        return np.asarray(out @ self.shapes.T), total / max(windows, 1)

    def _begin(self, forces: ArrayLike, start: tuple[ArrayLike, ArrayLike] | None) -> tuple[Floats, Floats, Floats]:
        f = np.asarray(forces, dtype=np.float64)
        n = self.coupling.shape[0]
        if start is None:
            return f @ self.shapes, np.zeros(n), np.zeros(n)
        back = sla.pinv(self.shapes)
        return f @ self.shapes, back @ np.asarray(start[0]), back @ np.asarray(start[1])
