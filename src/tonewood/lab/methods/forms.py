"""Udwadia and Kalaba's equation in modal coordinates, as the literature writes it: an ordinary differential equation.

Each form gives q' = F q + G u + H b, y = C q for the constrained system. They describe one motion: the unconstrained
motion plus the least correction that satisfies A y'' = b. They ask different things of the components:

* `physical`: matrices M, C, K (Udwadia & Kalaba 1992; Fabre et al. 2024, Eqs 1-7);
* `general`: complex modes, left and right shapes; acoustic dofs allowed (Fabre et al. 2024, Eqs 24-27);
* `compact`: complex modes of structures, and their Hermitian modal mass (Eqs 28-32);
* `real`: real modes (Antunes & Debut 2017; Fabre's Eqs 11-12).

The constraint is one of accelerations, so all have two poles at zero per constraint: gaps may drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.lab.assembled import Matrices
from tonewood.lab.methods.problem import Array, Problem, RealModes
from tonewood.physics.coupling.connections import Term
from tonewood.physics.modal.damping import hermitian_mass_inverse, reciprocal_shapes
from tonewood.physics.modal.modes import PAIR
from tonewood.support.arrays import Complexes, Floats


@dataclass(frozen=True, eq=False)
class Ode:
    """q' = F q + G u + H b,  y = Re(C q).

    F : (k, k) 1/s.
    G : (k, n_inputs).
    C : (n_outputs, k).
    embed : (k, n) puts a state of `Problem.generator` into q.
    H : (k, n_constraints), of the accelerations b that the constraints ask for, m/s^2.
    """

    F: Array
    G: Array
    C: Array
    embed: Array
    H: Array


def physical(system: Matrices, constraints: ArrayLike, directions: ArrayLike, outputs: ArrayLike) -> Ode:
    """Eq. 7: x'' = x_u'' + M^-1/2 B^+ (b - A x_u''),  M x_u'' = D^T f - C x' - K x,  B = A M^-1/2; state (x, x').

    system : matrices of the uncoupled subsystems, on the diagonal.
    constraints : A (m, n_dof), of any rank.
    directions : (n_inputs, n_dof) of the known forces.
    outputs : (n_outputs, n_dof).
    """
    A, D, Y = (np.asarray(a, dtype=np.float64) for a in (constraints, directions, outputs))
    n = len(system.M)
    values, vectors = sla.eigh(system.M)
    root_inverse = (vectors / np.sqrt(values)) @ vectors.T
    correct = root_inverse @ sla.pinv(A @ root_inverse)
    free = root_inverse @ root_inverse @ np.concatenate([-system.K, -system.C, D.T], axis=1)
    motion = free - correct @ (A @ free)
    return Ode(
        F=np.concatenate([np.eye(2 * n)[n:], motion[:, : 2 * n]]),
        G=np.concatenate([np.zeros_like(D.T), motion[:, 2 * n :]]),
        C=np.concatenate([Y, np.zeros_like(Y)], axis=1),
        embed=np.eye(2 * n),
        H=np.concatenate([np.zeros_like(correct), correct]),
    )


def general(problem: Problem) -> Ode:
    """Eq. 26: q' = (I - (Pi L)^-1/2 B_l^T (B_r B_l^T)^+ A_r L)(L q + Pi^-1 psi_l^T f), B_* = A_* (Pi^-1 L)^1/2.

    Coordinates are one mode of each pair, then their conjugates; Pi = 1, its value is held in the left shapes.
    Rigid-body, critically and over-damped modes have no place in it.
    """
    poles = _all_poles(problem)
    right = {name: basis.right for name, basis in problem.components.items()}
    left = {name: basis.left for name, basis in problem.components.items()}
    A_r, A_l = _gaps(problem, right), _gaps(problem, left)
    root = np.sqrt(poles)
    B_r, B_l = A_r * root, A_l * root
    correction = (B_l / root).T @ sla.pinv(B_r @ B_l.T)
    project = np.eye(len(poles)) - correction @ (A_r * poles)
    return Ode(
        F=project * poles,
        G=project @ _points(problem, left, problem.inputs).T,
        C=_points(problem, right, problem.outputs),
        embed=_embed(np.ones(len(poles) // 2)),
        H=correction,
    )


def compact(problem: Problem) -> Ode:
    """Eq. 31: q' = (I - Pi^-1 [conj(M^1/2 E^+); M^1/2 E^+] A L)(L q + Pi^-1 psi^T f), E = A M^-1/2.

    M = psi^H M psi is the Hermitian modal mass matrix, found from the shapes (Eq. A.4): every component needs as
    many independent points as it has modes, and none that are acoustic.
    """
    poles = _all_poles(problem)
    half = len(poles) // 2
    normal, scale, inverses = {}, [], []
    for name, basis in problem.components.items():
        normal[name], sign = reciprocal_shapes(basis)
        if np.any(sign < 0):
            raise ValueError(f"{name!r} has acoustic points: use the general form")
        inverses.append(hermitian_mass_inverse(normal[name], basis.poles))
        largest = np.argmax(np.abs(basis.right), axis=0), np.arange(basis.n_modes)
        scale.append(basis.right[largest] / normal[name][largest])
    A = _gaps(problem, normal)
    mass_root_inverse = _root(np.asarray(sla.block_diag(*inverses)))
    mass_root = sla.inv(mass_root_inverse)
    E = A[:, :half] @ mass_root_inverse
    correction = np.concatenate([mass_root.conj() @ sla.pinv(E.conj()), mass_root @ sla.pinv(E)])
    project = np.eye(2 * half) - correction @ (A * poles)
    return Ode(
        F=project * poles,
        G=project @ _points(problem, normal, problem.inputs).T,
        C=_points(problem, normal, problem.outputs),
        embed=_embed(np.concatenate(scale)),
        H=correction,
    )


def real(problem: Problem) -> Ode:
    """Eqs 11-12: q'' = q_u'' - M^-1/2 B^+ A q_u'',  M q_u'' = phi^T f - C q' - K q,  B = A M^-1/2; state (q, q').

    Any damping of the modes, rigid bodies included.
    """
    modes = problem.real
    n = len(modes.omega2)
    zero = np.zeros((n, n))
    correction, project = corrective(modes)
    return Ode(
        F=np.block([[zero, np.eye(n)], [-project * modes.omega2, -project * (2 * modes.sigma)]]),
        G=np.concatenate([np.zeros_like(modes.inputs.T), project @ modes.inputs.T]),
        C=np.concatenate([modes.outs, np.zeros_like(modes.outs)], axis=1),
        embed=embedding(modes),
        H=np.concatenate([np.zeros_like(correction), correction]),
    )


def corrective(modes: RealModes) -> tuple[Floats, Floats]:
    """A^+ (n, m), and I - A^+ A (n, n), which leaves the accelerations that the constraints allow."""
    inverse = np.asarray(sla.pinv(modes.gaps), dtype=np.float64)
    return inverse, np.eye(len(modes.omega2)) - inverse @ modes.gaps


def embedding(modes: RealModes) -> Floats:
    """(2n, 2n) state of `Problem.generator` -> (q, q')."""
    blocks = np.asarray(sla.block_diag(*modes.read))
    return np.concatenate([blocks[0::2], blocks[1::2]])


def _all_poles(problem: Problem) -> Complexes:
    """(2n,) one of each pair, then the conjugates."""
    for name, basis in problem.components.items():
        if np.any(basis.kind != PAIR):
            raise ValueError(f"complex-mode forms need under-damped modes; {name!r} has others")
    poles = np.concatenate([basis.poles for basis in problem.components.values()])
    return np.concatenate([poles, poles.conj()])


def _gaps(problem: Problem, shapes: Mapping[str, Complexes]) -> Complexes:
    """(m, 2n) shapes at the gaps, and their conjugates."""
    half = problem.gather(shapes, problem.gaps)
    return np.concatenate([half, half.conj()], axis=1)


def _points(problem: Problem, shapes: Mapping[str, Complexes], terms: Sequence[Term]) -> Complexes:
    half = problem.gather(shapes, [(t,) for t in terms])
    return np.concatenate([half, half.conj()], axis=1)


def _embed(scale: Complexes | Floats) -> Complexes:
    """(2n, 2n): (Re z, Im z) of each mode -> [scale z; conj]."""
    half = np.kron(np.diag(scale), np.array([[1.0, 1.0j]]))
    return np.concatenate([half, half.conj()])


def _root(matrix: Complexes) -> Complexes:
    """Hermitian square root."""
    values, vectors = sla.eigh(matrix)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.conj().T)
