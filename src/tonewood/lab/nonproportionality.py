"""How far from proportional the damping of M, C, K is, in numbers, and their change by a reduction to real modes.

Three indices, 0 for proportional damping, from a work the thesis names (Chinnakonda 2007, ref. 9) and older ones:

* `coupling`: share of the off-diagonal in the modal damping C* = P^T C P, |nondiag C*| / |C*| (Frobenius);
* `commutator`: |C M^-1 K - K M^-1 C| against its largest possible value (Caughey & O'Kelly's condition for real modes);
* `imaginary_part`: of each complex mode, turned so that its real part is largest (after Liu, Kujath & Zheng 2000).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from tonewood.lab.assembled import Matrices
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import real_modes
from tonewood.support.arrays import Floats


def modal_damping(system: Matrices) -> Floats:
    """(n_modes, n_modes) C* = P^T C P, 1/s, modes by rising frequency."""
    shapes = real_modes(system.M, system.K)[0]
    return np.asarray(shapes.T @ system.C @ shapes)


def coupling(system: Matrices) -> float:
    """|nondiag C*| / |C*| in the Frobenius norm, 0 to 1; 0 without damping."""
    C = modal_damping(system)
    size = float(sla.norm(C))
    return float(sla.norm(C - np.diag(np.diag(C)))) / size if size > 0 else 0.0


def commutator(system: Matrices) -> float:
    """|C* Omega^2 - Omega^2 C*| / (2 |C*| |Omega^2|), 0 to 1: the commutator in mass-normalised coordinates."""
    shapes, omega, _, _ = real_modes(system.M, system.K)
    C = shapes.T @ system.C @ shapes
    size = 2 * float(sla.norm(C)) * float(sla.norm(omega**2))
    return float(sla.norm(C * omega**2 - omega[:, None] ** 2 * C)) / size if size > 0 else 0.0


def imaginary_part(basis: ModalBasis) -> Floats:
    """(n_modes,) |Im psi| / |Re psi| of each right shape, turned so that its real part is largest; 0 to 1."""
    turn = np.exp(-0.5j * np.angle(np.sum(basis.right**2, axis=0)))
    psi = basis.right * turn
    size = sla.norm(psi.real, axis=0)
    return np.asarray(np.divide(sla.norm(psi.imag, axis=0), size, out=np.zeros_like(size), where=size > 0))


def reduced(system: Matrices, n_modes: int) -> Matrices:
    """The first step of the thesis' two-step analysis: the lowest real modes, q'' + C* q' + Omega^2 q = Q (Eq. 2.2)."""
    shapes, omega, _, _ = real_modes(system.M, system.K)
    P = shapes[:, :n_modes]
    return Matrices(np.eye(n_modes), P.T @ system.C @ P, np.diag(omega[:n_modes] ** 2))


def reduction_shapes(system: Matrices, n_modes: int) -> Floats:
    """(n_dof, n_modes) P_r: u = P_r q."""
    return real_modes(system.M, system.K)[0][:, :n_modes]
