"""Lists of poles and shapes: one of each conjugate pair, both, or as real states.

A component with real forces and displacements has poles in conjugate pairs. Three forms of the same thing:

* *half*: one of each pair (Im > 0) and the real poles (Im = 0), as a modal basis stores them;
* *full*: the half list followed by the conjugates of its pairs, state [z; conj(z_pairs)];
* *real*: state x, a unitary transform of the full one, x = sqrt(2) (Re z, Im z) for a pair and x = z for a real pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.errors import PassivityError
from tonewood.support.arrays import Complexes, Floats


def conjugate_weights(poles: Complexes) -> Floats:
    """Weight c of each mode in y = sum c Re(r z): 2 for one of a pair, 1 for a real pole.  (n,)"""
    return np.where(poles.imag == 0.0, 1.0, 2.0)


def halve(poles: Complexes, right: Complexes, left: Complexes) -> tuple[Complexes, Complexes, Complexes, float]:
    """Half list of a list that may hold both poles of each pair, and how far it is from being closed.

    A list without poles below the real axis is taken as a half list. Shapes are compared as residues r l^T, so a
    mode and its conjugate may be normalised differently. Of a real pole r and l are turned to real numbers.

    poles : (n,) 1/s.
    right, left : (n_ports, n) shapes.
    Returns poles, right, left of the half list, and the largest misfit between a mode and its conjugate: of the pole
    relative to the pole or of the residue relative to the residue; inf where a pole has no partner.
    """
    misfit = 0.0
    keep = np.flatnonzero(poles.imag >= 0.0)
    if keep.size < poles.size:
        above = [int(k) for k in np.flatnonzero(poles.imag > 0.0)]
        below = [int(k) for k in np.flatnonzero(poles.imag < 0.0)]
        for k in below:
            if not above:
                misfit = float("inf")
                break
            gaps = np.abs(poles[above] - np.conj(poles[k]))
            near = [j for j, gap in zip(above, gaps, strict=True) if gap <= gaps.min() + 1e-9 * abs(poles[k])]
            misfits = [_misfit(poles, right, left, j, k) for j in near]
            best = int(np.argmin(misfits))
            misfit = max(misfit, misfits[best])
            above.remove(near[best])
        if above:
            misfit = float("inf")
    poles, right, left = poles[keep], right[:, keep].copy(), left[:, keep].copy()
    for k in np.flatnonzero(poles.imag == 0.0).tolist():
        turn_r, turn_l = _turn_to_real(right[:, k]), _turn_to_real(left[:, k])
        r, l_ = right[:, k] * turn_r, left[:, k] * turn_l
        factor = 1.0 / (turn_r * turn_l)
        size = float(np.abs(r).max(initial=0.0) * np.abs(l_).max(initial=0.0))
        if size > 0.0:
            lost = np.outer(r, l_) * factor
            misfit = max(misfit, float(np.abs(lost - np.outer(r.real, l_.real) * factor.real).max()) / size)
        right[:, k], left[:, k] = r.real, l_.real * factor.real
    return poles, right, left, misfit


def _turn_to_real(shape: Complexes) -> complex:
    """Unit factor that makes a complex shape as nearly real as can be."""
    square = complex(np.sum(shape**2))
    return 1.0 + 0j if square == 0 else complex(np.exp(-0.5j * np.angle(square)))


def _misfit(poles: Complexes, right: Complexes, left: Complexes, j: int, k: int) -> float:
    one, other = np.outer(right[:, j], left[:, j]), np.conj(np.outer(right[:, k], left[:, k]))
    size = max(float(np.abs(one).max(initial=0.0)), float(np.abs(other).max(initial=0.0)))
    of_residue = float(np.abs(one - other).max(initial=0.0)) / size if size > 0.0 else 0.0
    return max(of_residue, float(np.abs(poles[j] - np.conj(poles[k])) / np.abs(poles[k])))


@dataclass(frozen=True, eq=False)
class RealStates:
    """A half list as real states:  x' = A x + B f,  y = R x,  y' = C x + D f  with C = R A, D = R B.

    A : (N, N) block-diagonal, 1/s.  B : (N, n_ports).  R : (n_ports, N).  N = 2 n_pairs + n_real.
    to_full : (N, N) unitary, full state = to_full x.
    """

    A: Floats
    B: Floats
    R: Floats
    to_full: Complexes

    @property
    def C(self) -> Floats:
        """(n_ports, N) velocities of the ports from the state."""
        return self.R @ self.A

    @property
    def D(self) -> Floats:
        """(n_ports, n_ports) direct term of the mobility, 2 Re sum r l^T: zero for a body with mass."""
        return self.R @ self.B


def real_form(poles: Complexes, right: Complexes, left: Complexes) -> RealStates:
    """Real states of a half list; see `RealStates`. Raises PassivityError on poles below the real axis."""
    if np.any(poles.imag < 0.0):
        raise PassivityError("one of each conjugate pair of poles is wanted, the one with Im > 0")
    n = poles.size
    pairs = np.flatnonzero(poles.imag > 0.0)
    size = n + pairs.size
    U = np.zeros((size, size), dtype=np.complex128)
    U[np.arange(n), np.arange(n)] = 1.0
    second = n + np.arange(pairs.size)
    half = np.sqrt(0.5)
    U[pairs, pairs] = U[second, pairs] = half
    U[pairs, second], U[second, second] = 1j * half, -1j * half
    full_poles, full_right, full_left = extend(poles, right, left)
    A = np.zeros((size, size))
    A[np.arange(size), np.arange(size)] = full_poles.real
    A[pairs, second], A[second, pairs] = -poles.imag[pairs], poles.imag[pairs]
    return RealStates(A, (U.conj().T @ full_left.T).real, (full_right @ U).real, U)


def extend(poles: Complexes, right: Complexes, left: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Full list of a half list: itself, followed by the conjugates of its pairs."""
    pairs = poles.imag != 0.0
    return (
        np.concatenate([poles, np.conj(poles[pairs])]),
        np.concatenate([right, np.conj(right[:, pairs])], axis=1),
        np.concatenate([left, np.conj(left[:, pairs])], axis=1),
    )
