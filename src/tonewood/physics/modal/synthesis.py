"""From matrices M, C, K to modes, whatever the damping: the way into `ModalBasis` for discretised components.

Let P hold the real modes of (M, K), P^T M P = I, P^T K P = Omega^2, and C~ = P^T C P. Proportional damping leaves C~
diagonal, and the modes are real. Otherwise C~ couples them, and `complex_modes` takes them apart.

Results (kinds of `modes`):

* one of each pair of complex poles: ``PAIR``; a real pole: ``REAL``;
* two poles that coincide, or nearly, on the real axis: one ``BLOCK``, exact through the defect;
* rigid-body motion without damping: a ``BLOCK`` with omega = sigma = 0; with damping: a ``REAL`` pole at 0 and
  whatever pole its damping makes; a cavity closed by a wall: a ``BLOCK`` that reads p too (the wall bends under
  the pressure of a volume that keeps growing);
* dofs without mass: no mode, but residual compliance: modes of infinite frequency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.modal.complex_modes import complex_modes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.support.arrays import Floats

#: off-diagonal modal damping, relative to its row and column, that counts as none
_PROPORTIONAL = 1e-11
#: relative change of the damping that separates defective poles off the real axis
_NUDGE = 1e-10


def basis_from_matrices(
    M: ArrayLike,
    C: ArrayLike,
    K: ArrayLike,
    points: Mapping[str, ArrayLike] | Sequence[str],
    *,
    acoustic_dofs: Sequence[int] = (),
    metadata: Mapping[str, object] | None = None,
) -> ModalBasis:
    """All modes of M x'' + C x' + K x = D^T f,  y = D x.

    M, C, K : (n_dof, n_dof) kg, N s/m, N/m. Structural: symmetric, M and K positive semi-definite. With acoustic
        dofs: the velocity-potential form (Fabre et al. 2024, Eq. 10), C = [[Cs, -L], [L^T, Ca]], or the pressure form
        (Eq. 8), which is brought to it; the acoustic dofs are then potentials, and the pressure is their velocity.
    points : name -> (n_dof,) direction, or the names of all dofs in their order.
    acoustic_dofs : indices of the acoustic dofs.
    Returns ModalBasis : real modes under proportional damping, complex ones otherwise, in order of rising |pole|. Dofs
        without mass appear as residual compliance.
    Raises ValueError : matrices of unfitting shape or symmetry, not positive semi-definite, or mass missing where there
        is damping or no stiffness; poles too many of which coincide.
    """
    M, C, K = (np.array(a, dtype=np.float64) for a in (M, C, K))
    n = M.shape[0]
    if M.shape != (n, n) or C.shape != (n, n) or K.shape != (n, n):
        raise ValueError(f"M {M.shape}, C {C.shape} and K {K.shape} must be square and of one size")
    names, D = _directions(points, n)
    acoustic = np.zeros(n, dtype=bool)
    acoustic[list(acoustic_dofs)] = True
    if acoustic.any():
        M, C, K = velocity_potential_form(M, C, K, acoustic_dofs)
    sign = np.where(acoustic, -1.0, 1.0)
    _check_symmetric("M", M)
    _check_symmetric("K", K)
    _check_symmetric("C with the signs of its acoustic rows turned" if acoustic.any() else "C", sign[:, None] * C)

    parts = [real_modes(M[np.ix_(part, part)], K[np.ix_(part, part)]) for part in (~acoustic, acoustic) if part.any()]
    dofs = [np.flatnonzero(part) for part in (~acoustic, acoustic) if part.any()]
    P, static = np.zeros((n, sum(part[1].size for part in parts))), np.zeros((n, n))
    column = 0
    for where, (shapes, _, soft, massless) in zip(dofs, parts, strict=True):
        P[where, column : column + shapes.shape[1]] = shapes
        static[np.ix_(where, where)] = soft
        column += shapes.shape[1]
        if massless.size and np.abs(C[:, where] @ massless).max() > 1e-12 * np.abs(C).max():
            raise ValueError("damping acts on a dof without mass: give it mass, or leave the dof out")
    omega = np.concatenate([part[1] for part in parts])
    order = np.argsort(omega, kind="stable")
    omega, P = omega[order], P[:, order]
    modal_sign = np.sign(np.sum(sign[:, None] * P**2, axis=0))
    P = _aligned_with_damping(P, omega, C, modal_sign)
    damping = P.T @ C @ P
    residual = D @ static @ D.T
    if _is_diagonal(damping, P, C):
        shapes = D @ P
        named = {name: shapes[i] for i, name in enumerate(names)}
        return ModalBasis.real(omega, np.diag(damping) / 2, named, residual=residual, metadata=metadata)
    modes = complex_modes(P, omega, damping, modal_sign)
    if modes is None:
        elastic = np.flatnonzero(omega > 0)
        nudge = np.linspace(0.0, 1.0, elastic.size + 2)[1:-1] * _NUDGE * np.abs(damping).max()
        damping[elastic, elastic] += nudge
        modes = complex_modes(P, omega, damping, modal_sign, least_pairing=1e-8)
        if modes is None:
            raise ValueError("too many poles coincide for modes to exist")
    poles, kind, stiffness, damping_rate, right, left = modes
    return ModalBasis(
        poles=poles,
        kind=kind,
        stiffness=stiffness,
        damping_rate=damping_rate,
        points=names,
        right=D @ right,
        left=D @ left,
        residual=0.5 * (residual + residual.T),
        metadata=dict(metadata or {}),
    )


def velocity_potential_form(
    M: ArrayLike, C: ArrayLike, K: ArrayLike, acoustic_dofs: Sequence[int]
) -> tuple[Floats, Floats, Floats]:
    """Bring a vibro-acoustic system of displacements and pressures (Fabre et al. 2024, Eq. 8) to Eq. 10.

    M = [[Ms, 0], [L^T, Ma]], K = [[Ks, -L], [0, Ka]] become block-diagonal, and L moves into C = [[Cs, -L], [L^T, Ca]].
    The acoustic dofs become velocity potentials (their velocity is the pressure), and acoustic sources g' become g.
    A system that is in that form already is returned unchanged.
    """
    M, C, K = (np.array(a, dtype=np.float64) for a in (M, C, K))
    a = np.zeros(M.shape[0], dtype=bool)
    a[list(acoustic_dofs)] = True
    sa, as_ = np.ix_(~a, a), np.ix_(a, ~a)
    if not (np.any(M[as_]) or np.any(K[sa])):
        return M, C, K
    coupling = M[as_]
    size = np.abs(coupling).max(initial=0.0)
    stray = [M[sa], K[as_], C[sa], C[as_], K[sa] + coupling.T]
    if any(np.abs(block).max(initial=0.0) > 1e-10 * size for block in stray):
        raise ValueError(
            "a system of displacements and pressures has M = [[Ms, 0], [L^T, Ma]], K = [[Ks, -L], [0, Ka]]"
        )
    C[sa], C[as_] = -coupling.T, coupling
    M[as_], K[sa] = 0.0, 0.0
    return M, C, K


def initial_state(
    basis: ModalBasis, M: ArrayLike, C: ArrayLike, displacement: ArrayLike, velocity: ArrayLike
) -> Floats:
    """Modal state of a given motion, exact for a full basis and its projection for a part of it.

    A start from x0, v0 is the response of a system at rest to the momenta M v0 + C x0 (an impulse) and M x0 (a
    doublet):

        x(0) = B (M v0 + C x0) + A B M x0.

    basis : with one point per dof, in their order.
    M, C : (n_dof, n_dof) of the same component.
    displacement, velocity : (n_dof,) m, m/s.
    Returns (n_modes, 2) real state of every mode (see `propagator`).
    """
    M, C, x0, v0 = (np.asarray(a, dtype=np.float64) for a in (M, C, displacement, velocity))
    if len(basis.points) != M.shape[0]:
        raise ValueError(f"a basis with one point per dof is wanted: {len(basis.points)} points, {M.shape[0]} dofs")
    form = real_form(basis)
    impulse = np.einsum("pmx,p->mx", form.B, M @ v0 + C @ x0)
    doublet = np.einsum("pmx,p->mx", form.B, M @ x0)
    return np.asarray(impulse + np.einsum("mxy,my->mx", form.A, doublet))


def real_modes(M: Floats, K: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Modes of M x'' + K x = f with M and K symmetric positive semi-definite.

    Returns shapes : (n_dof, n_modes) mass-normalised, 1/sqrt(kg).
    omega : (n_modes,) rad/s, rising; exactly 0 for rigid-body modes.
    static : (n_dof, n_dof) m/N, compliance of the motion that has no mass (modes of infinite frequency).
    massless : (n_dof, n_massless) directions without mass.
    Raises ValueError : M or K is indefinite, or a direction has neither mass nor stiffness.
    """
    from tonewood.support.scipy_linalg import sla

    n = M.shape[0]
    scale = 1 / np.sqrt(np.where(np.diag(M) > 0, np.diag(M), 1.0))
    M, K = scale[:, None] * M * scale, scale[:, None] * K * scale
    mass, U = sla.eigh(M)
    if mass[0] < -1e-12 * n:
        raise ValueError(f"the mass matrix is not positive semi-definite: {mass[0]:.3g} of its scaled diagonal")
    null = mass < 1e-13 * n
    Z, T = U[:, null], np.eye(n)
    static = np.zeros((n, n))
    if null.any():
        if np.all(np.diag(M)[np.diag(M) < 0.5] == 0) and np.sum(np.diag(M) == 0) == null.sum():
            Z, Y = np.eye(n)[:, np.diag(M) == 0], np.eye(n)[:, np.diag(M) != 0]
        else:
            Y = U[:, ~null]
        stiffness = Z.T @ K @ Z
        k, V = sla.eigh(stiffness)
        if k[0] <= 1e-13 * np.abs(K).max():
            raise ValueError("a dof or direction has neither mass nor stiffness")
        soft = Z @ V / np.sqrt(k)
        static = soft @ soft.T
        T = Y - static @ K @ Y
    squared, Q = sla.eigh(T.T @ K @ T, T.T @ M @ T)
    shapes = T @ Q
    size = np.abs(T) @ np.abs(Q)
    rounding = 8 * n * np.sum(size * (np.abs(K) @ size), axis=0) + 16 * np.abs(K).max() * np.sum(shapes**2, axis=0)
    rounding *= np.finfo(float).eps
    if np.any(squared < -rounding):
        raise ValueError(f"the stiffness matrix is not positive semi-definite: omega^2 = {squared.min():.3g}")
    omega = np.sqrt(np.where(squared <= rounding, 0.0, squared))
    return scale[:, None] * shapes, omega, scale[:, None] * static * scale, scale[:, None] * Z


def _directions(points: Mapping[str, ArrayLike] | Sequence[str], n: int) -> tuple[tuple[str, ...], Floats]:
    if not isinstance(points, Mapping):
        if len(points) != n:
            raise ValueError(f"{len(points)} names for {n} dofs; give all, or a mapping of names to directions")
        return tuple(points), np.eye(n)
    rows = [np.asarray(direction, dtype=np.float64) for direction in points.values()]
    for name, row in zip(points, rows, strict=True):
        if row.shape != (n,):
            raise ValueError(f"point {name!r}: a direction has {n} entries, not {row.shape}")
    return tuple(points), np.array(rows).reshape(len(rows), n)


def _check_symmetric(name: str, A: Floats) -> None:
    if not np.all(np.isfinite(A)):
        raise ValueError(f"{name} is not finite")
    if np.abs(A - A.T).max(initial=0.0) > 1e-9 * np.abs(A).max(initial=0.0):
        raise ValueError(f"{name} is not symmetric")


def _aligned_with_damping(P: Floats, omega: Floats, C: Floats, sign: Floats) -> Floats:
    """Turn the shapes of equal frequencies, which are free, so that their own damping is diagonal."""
    from tonewood.support.scipy_linalg import sla

    P = P.copy()
    start = 0
    top = omega.max(initial=0.0)
    for stop in range(1, omega.size + 1):
        if stop < omega.size and omega[stop] - omega[start] <= 1e-12 * omega[start] + 1e-14 * top:
            continue
        if stop - start > 1:
            for value in (1.0, -1.0):
                group = start + np.flatnonzero(sign[start:stop] == value)
                if group.size > 1:
                    block = P[:, group].T @ C @ P[:, group]
                    P[:, group] = P[:, group] @ sla.eigh(0.5 * (block + block.T))[1]
        start = stop
    return P


def _is_diagonal(damping: Floats, P: Floats, C: Floats) -> bool:
    d = np.sqrt(np.abs(np.diag(damping)))
    rounding = 64 * np.finfo(float).eps * (np.abs(P).T @ np.abs(C) @ np.abs(P))
    off = np.abs(damping - np.diag(np.diag(damping)))
    return bool(np.all(off <= _PROPORTIONAL * np.outer(d, d) + rounding))
