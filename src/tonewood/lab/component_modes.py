"""Component modes of a substructure with physical matrices: fixed-base modes with constraint modes, free-free modes.

The substructure M d'' + K d = F is joined to the rest of the world at its interface dofs, d = (d_bar, d_hat). Klosner &
Ranlet (1978) write its motion in either of two ways:

* fixed base (Eqs. 4-8): d = T* d_bar + phi_f q, the static response to the interface's displacement, T* = (I, T^c),
  T^c = -k_hat^-1 k_hat_bar (Eq. 19), plus modes with the interface held;
* free-free (Eqs. 21-25): d = phi q, rigid-body modes and, where dofs have no mass, modes of infinite frequency
  included: their modal mass is zero and their modal stiffness is not, so they follow their load without delay.

Complete, the two span the same motion. Truncated they do not, and which needs fewer modes depends on how stiffly the
substructure is mounted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices, real_modes
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class FixedBaseModes:
    """Modes with the interface held, and the static shapes that carry its motion inside.

    M, K : (n_dof, n_dof) kg, N/m of the free substructure.
    interface : (m,) dofs held; interior : (n_dof - m,) the others.
    constraint : (n_interior, m) T^c, interior displacement per unit displacement of each interface dof.
    shapes : (n_interior, n_modes) phi_f: of unit modal mass, and of unit modal stiffness where the mass is zero.
    omega : (n_modes,) rad/s, infinite for massless modes.
    """

    M: Floats
    K: Floats
    interface: NDArray[np.intp]
    interior: NDArray[np.intp]
    constraint: Floats
    shapes: Floats
    omega: Floats

    @property
    def transformation(self) -> Floats:
        """(n_dof, m + n_modes): d = transformation (d_bar, q), Eqs. 5-8."""
        m = self.interface.size
        out = np.zeros((self.M.shape[0], m + self.omega.size))
        out[self.interface, :m] = np.eye(m)
        out[np.ix_(self.interior, np.arange(m))] = self.constraint
        out[self.interior, m:] = self.shapes
        return out

    def truncated(self, n_modes: int) -> FixedBaseModes:
        """Keep the first modes only; the constraint modes stay."""
        return FixedBaseModes(
            self.M, self.K, self.interface, self.interior, self.constraint,
            self.shapes[:, :n_modes], self.omega[:n_modes],
        )  # fmt: skip

    def basis(self, points: Mapping[str, ArrayLike], C: ArrayLike | None = None) -> ModalBasis:
        """Free-interface modes of the reduced substructure: a component that can be joined at its interface.

        points : name -> (n_dof,) direction.
        C : (n_dof, n_dof) N s/m.
        """
        T = self.transformation
        damping = np.zeros_like(self.M) if C is None else np.asarray(C, dtype=np.float64)
        reduced = {name: np.asarray(direction, dtype=np.float64) @ T for name, direction in points.items()}
        mass, damping, stiffness = (_symmetric(T.T @ A @ T) for A in (self.M, damping, self.K))
        return basis_from_matrices(mass, damping, stiffness, reduced)


@dataclass(frozen=True, eq=False)
class FreeFreeModes:
    """Modes of the free substructure.

    shapes : (n_dof, n_modes) phi: of unit modal mass, and of unit modal stiffness where the mass is zero.
    omega : (n_modes,) rad/s, rising: 0 for rigid-body modes, infinite for massless ones.
    """

    shapes: Floats
    omega: Floats

    def truncated(self, n_modes: int) -> FreeFreeModes:
        """Keep the first modes of finite frequency, and those of infinite frequency."""
        keep = np.isinf(self.omega) | (np.arange(self.omega.size) < n_modes)
        return FreeFreeModes(self.shapes[:, keep], self.omega[keep])

    def basis(self, points: Mapping[str, ArrayLike]) -> ModalBasis:
        """Component with these modes at points, name -> (n_dof,); those of infinite frequency are its residual."""
        finite = np.isfinite(self.omega)
        rows = {name: np.asarray(direction, dtype=np.float64) @ self.shapes for name, direction in points.items()}
        soft = np.array([row[~finite] for row in rows.values()])
        return ModalBasis.real(
            self.omega[finite],
            np.zeros(int(finite.sum())),
            {name: row[finite] for name, row in rows.items()},
            residual=soft @ soft.T,
        )


def fixed_base_modes(
    M: ArrayLike, K: ArrayLike, interface: Sequence[int], n_modes: int | None = None
) -> FixedBaseModes:
    """Constraint modes and the lowest `n_modes` (all by default) modes with the interface dofs held.

    Raises ValueError : the held substructure can still move freely (its constraint modes are not determined).
    """
    import scipy.linalg as sla

    M, K = _symmetric(np.array(M, dtype=np.float64)), _symmetric(np.array(K, dtype=np.float64))
    fixed = np.zeros(M.shape[0], dtype=bool)
    fixed[list(interface)] = True
    inside, base = np.flatnonzero(~fixed), np.array(list(interface), dtype=np.intp)
    stiffness = K[np.ix_(inside, inside)]
    shapes, omega = _all_modes(M[np.ix_(inside, inside)], stiffness)
    if np.any(omega == 0):
        raise ValueError("held at its interface, the substructure can still move without strain")
    constraint = (
        -sla.solve(stiffness, K[np.ix_(inside, base)], assume_a="pos") if inside.size else np.zeros((0, base.size))
    )
    whole = FixedBaseModes(M, K, base, inside, constraint, shapes, omega)
    return whole if n_modes is None else whole.truncated(n_modes)


def free_free_modes(M: ArrayLike, K: ArrayLike, n_modes: int | None = None) -> FreeFreeModes:
    """Lowest `n_modes` (all by default) modes of the free substructure, and all those of infinite frequency."""
    shapes, omega = _all_modes(np.array(M, dtype=np.float64), np.array(K, dtype=np.float64))
    whole = FreeFreeModes(shapes, omega)
    return whole if n_modes is None else whole.truncated(n_modes)


def _all_modes(M: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Shapes and frequencies, massless ones last with unit modal stiffness."""
    import scipy.linalg as sla

    if M.size == 0:
        return np.zeros((0, 0)), np.zeros(0)
    shapes, omega, _, massless = real_modes(M, K)
    if massless.shape[1]:
        # static = Z (Z^T K Z)^-1 Z^T: columns of unit stiffness that span it
        k, V = sla.eigh(massless.T @ K @ massless)
        shapes = np.hstack([shapes, massless @ V / np.sqrt(k)])
        omega = np.concatenate([omega, np.full(k.size, np.inf)])
    return shapes, omega


def _symmetric(A: Floats) -> Floats:
    return np.asarray(0.5 * (A + A.T), dtype=np.float64)
