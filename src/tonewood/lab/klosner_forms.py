"""Equations of motion of a structure with an attached substructure, as Klosner & Ranlet (1978) write them.

The main structure S is in its modes, d_S = phi_S q_S (mass-normalised here, so mu_S = I), the substructure in
fixed-base or free-free modes; the interaction force F_bar on the substructure joins them. External forces may
act on the substructure too (Appendix A). Misprints put right: Eq. 31 (and A-33) needs the mass of the unconstrained
dofs, m_hat, as Eq. 20 has it; A-35 needs the transpose of T_cb; in A-42 the term Q_G is Q_delta.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.component_modes import FixedBaseModes, FreeFreeModes
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class MainStructure:
    """Undamped modes of S.

    omega : (n,) rad/s.
    interface : (m, n) mass-normalised shapes at the attachment points, phi_S_bar.
    loaded : (n,) mass-normalised shape where the external force on S acts.
    """

    omega: Floats
    interface: Floats
    loaded: Floats


@dataclass(frozen=True, eq=False)
class LinearForm:
    """x' = A x + on_main F_S + on_sub f_b: one external force on S and one force vector on the substructure's dofs.

    A : (n, n).  on_main : (n,).  on_sub : (n, n_dof) of the substructure.
    motion : (n_dof, n) displacement of the substructure's dofs; motion_sub : (n_dof, n_dof) directly from forces.
    interaction : (m, n) F_bar from the state; interaction_main (m,), interaction_sub (m, n_dof): directly from forces.
    """

    A: Floats
    on_main: Floats
    on_sub: Floats
    motion: Floats
    motion_sub: Floats
    interaction: Floats
    interaction_main: Floats
    interaction_sub: Floats


def fixed_base_form(main: MainStructure, sub: FixedBaseModes, *, as_printed: bool = True) -> LinearForm:
    """Rigidly attached substructure in fixed-base modes: Eqs. 15, 16 and 20, with forces on it A-11 and A-17.

    as_printed : F_bar from the stiffness forces of Eq. 16, exact for lumped masses and a complete set of modes (the
        step from A-14 to A-15 takes a full set for granted); otherwise the symmetric form A-6, A-7 that precedes it,
        which stays conservative and converges much faster when modes are left out.
    """
    base, inside = sub.interface, sub.interior
    phi, T = main.interface, sub.constraint
    n, k = main.omega.size, sub.omega.size
    if np.any(np.isinf(sub.omega)):
        raise ValueError("these forms take fixed-base modes of finite frequency: every inner dof needs mass")
    m_bar, m_hat = sub.M[np.ix_(base, base)], sub.M[np.ix_(inside, inside)]
    k_bar, k_cross = sub.K[np.ix_(base, base)], sub.K[np.ix_(base, inside)]
    scatter = np.zeros((n + k, sub.M.shape[0]))
    scatter[n:, inside] = sub.shapes.T
    if as_printed:
        if np.any(sub.M[np.ix_(base, inside)]):
            raise ValueError("Eqs. 16-20 assume a lumped mass")
        mass_force = np.hstack([m_bar @ phi, np.zeros((base.size, k))])
        stiff_force = np.hstack([(k_bar + k_cross @ T) @ phi, k_cross @ sub.shapes])
        M = np.block([[np.eye(n) + phi.T @ m_bar @ phi, np.zeros((n, k))], [sub.shapes.T @ m_hat @ T @ phi, np.eye(k)]])
        K = np.block([[np.diag(main.omega**2) + phi.T @ stiff_force[:, :n], phi.T @ stiff_force[:, n:]],
                      [np.zeros((k, n)), np.diag(sub.omega**2)]])  # fmt: skip
        scatter[:n, base] = phi.T
        direct = np.zeros((base.size, sub.M.shape[0]))
        direct[:, base] = -np.eye(base.size)
    else:
        W = sub.transformation @ sla.block_diag(phi, np.eye(k))
        M, K = W.T @ sub.M @ W, W.T @ sub.K @ W
        M[:n, :n] += np.eye(n)
        K[:n, :n] += np.diag(main.omega**2)
        scatter = W.T
        rows = sub.transformation[:, : base.size].T
        mass_force, stiff_force, direct = rows @ sub.M @ W, rows @ sub.K @ W, -rows
    load = np.concatenate([main.loaded, np.zeros(k)])
    rate = sla.solve(M, np.hstack([-K, load[:, None], scatter]))
    size = n + k
    A = np.block([[np.zeros((size, size)), np.eye(size)], [rate[:, :size], np.zeros((size, size))]])
    d = sub.transformation @ sla.block_diag(phi, np.eye(k))
    from_rate = mass_force @ rate
    return LinearForm(
        A,
        np.concatenate([np.zeros(size), rate[:, size]]),
        np.vstack([np.zeros((size, scatter.shape[1])), rate[:, size + 1 :]]),
        np.hstack([d, np.zeros_like(d)]),
        np.zeros((len(d),) * 2),
        np.hstack([from_rate[:, :size] + stiff_force, np.zeros((base.size, size))]),
        from_rate[:, size],
        from_rate[:, size + 1 :] + direct,
    )


def free_free_form(main: MainStructure, sub: FreeFreeModes, interface: NDArray[np.intp]) -> LinearForm:
    """Rigidly attached substructure in free-free modes: Eqs. 26 and 27 under the constraint of Eq. 22.

    Modes of infinite frequency follow their load, q = phi_bar^T F_bar (+ forces), and by Eq. 22 give F_bar without
    delay: with R = sum phi_bar phi_bar^T over them, R F_bar = phi_S_bar q_S - (finite modes). Where R has no stiffness
    to offer the second derivative of Eq. 22 gives F_bar instead (Udwadia & Kalaba's corrective force).
    """
    finite = np.isfinite(sub.omega)
    phi, shapes, soft = main.interface, sub.shapes[:, finite], sub.shapes[:, ~finite]
    n, k = main.omega.size, shapes.shape[1]
    size, n_dof = n + k, sub.shapes.shape[0]
    gap = np.hstack([phi, -shapes[interface]])
    squared = np.concatenate([main.omega, sub.omega[finite]]) ** 2
    scatter_main = np.concatenate([main.loaded, np.zeros(k)])
    scatter_sub = np.vstack([np.zeros((n, n_dof)), shapes.T])
    lag = -soft[interface] @ soft.T  # motion of its massless modes by forces on the substructure, seen in the gap
    r, V = sla.eigh(soft[interface] @ soft[interface].T)
    stiff = r > 1e-12 * max(float(r.max()), np.finfo(float).tiny)
    G = V[:, stiff] / r[stiff] @ V[:, stiff].T
    U = V[:, ~stiff]
    Y = gap @ gap.T
    if U.shape[1]:
        if soft.shape[1] and np.abs(U.T @ lag).max(initial=0.0) > 1e-12 * np.abs(soft).max() ** 2:
            raise ValueError("a force acts on massless dofs that the constraint makes stiff")
        project = U @ sla.solve(U.T @ Y @ U, U.T)
    else:
        project = np.zeros_like(Y)

    def corrective(from_gap: Floats, from_rate: Floats) -> Floats:
        forces = G @ from_gap
        return np.asarray(forces + project @ (from_rate - Y @ forces))

    F_state = corrective(gap, -gap * squared)
    F_main = corrective(np.zeros(len(gap)), gap @ scatter_main)
    F_sub = corrective(lag, gap @ scatter_sub)
    A = np.zeros((2 * size, 2 * size))
    A[:size, size:] = np.eye(size)
    A[size:, :size] = -np.diag(squared) - gap.T @ F_state
    motion = np.hstack([np.zeros((n_dof, n)), shapes]) + soft @ soft[interface].T @ F_state
    return LinearForm(
        A,
        np.concatenate([np.zeros(size), scatter_main - gap.T @ F_main]),
        np.vstack([np.zeros((size, n_dof)), scatter_sub - gap.T @ F_sub]),
        np.hstack([motion, np.zeros((n_dof, size))]),
        soft @ (soft[interface].T @ F_sub + soft.T),
        np.hstack([F_state, np.zeros((len(gap), size))]),
        F_main,
        F_sub,
    )


#: F_bar(delta, delta') of the mountings: (m,), (m,) -> (m,)
Mountings = Callable[[Floats, Floats], Floats]
#: (force on S, forces (n_dof,) on the substructure) at a time
Loads = Callable[[float], tuple[float, Floats]]


@dataclass(frozen=True, eq=False)
class NonlinearForm:
    """x'' = rate(t, x, x') of generalised coordinates, and the substructure's displacement motion @ x."""

    size: int
    rate: Callable[[float, Floats, Floats], Floats]
    motion: Floats


def fixed_base_nonlinear(main: MainStructure, sub: FixedBaseModes, law: Mountings, loads: Loads) -> NonlinearForm:
    """Substructure on nonlinear mountings in fixed-base modes: Eqs. 15, 30, 31, 32 (A-32 to A-34 with forces on it).

    Coordinates (q_S, d_bar, q_f); delta = phi_S_bar q_S - d_bar (Eq. 28). The interface dofs need mass.
    """
    base, inside = sub.interface, sub.interior
    n, m = main.omega.size, base.size
    phi, T = main.interface, sub.constraint
    m_bar, m_hat = sub.M[np.ix_(base, base)], sub.M[np.ix_(inside, inside)]
    k_bar, k_cross = sub.K[np.ix_(base, base)], sub.K[np.ix_(base, inside)]
    carried, lightness = sub.shapes.T @ m_hat @ T, sla.inv(m_bar)
    # Eq. 30 gives the foot's acceleration, foot @ x + lightness (F + f_bar), which Eq. 31 carries inside
    size = n + m + sub.omega.size
    foot = -lightness @ np.hstack([np.zeros((m, n)), k_bar + k_cross @ T, k_cross @ sub.shapes])
    stiff = np.diag(-(np.concatenate([main.omega, np.zeros(m), sub.omega]) ** 2))
    stiff[n : n + m] += foot
    stiff[n + m :] -= carried @ foot
    scatter = np.vstack([-phi.T, lightness, -carried @ lightness])
    on_main, on_sub = np.zeros(size), np.zeros((size, sub.M.shape[0]))
    on_main[:n] = main.loaded
    on_sub[n : n + m, base], on_sub[n + m :, base] = lightness, -carried @ lightness
    on_sub[n + m :, inside] = sub.shapes.T
    gap = np.hstack([phi, -np.eye(m), np.zeros((m, sub.omega.size))])
    motion = np.hstack([np.zeros((sub.M.shape[0], n)), sub.transformation])
    return NonlinearForm(size, _affine(stiff, scatter, gap, on_main, on_sub, law, loads), motion)


def free_free_nonlinear(
    main: MainStructure, sub: FreeFreeModes, interface: NDArray[np.intp], law: Mountings, loads: Loads
) -> NonlinearForm:
    """Substructure on nonlinear mountings in free-free modes: Eqs. 15, 32, 36, 37 (A-42, A-43 with forces on it)."""
    if np.any(np.isinf(sub.omega)):
        raise ValueError("under a nonlinear mounting the interface needs mass in this form")
    n, phi, foot = main.omega.size, main.interface, sub.shapes[interface]
    size = n + sub.omega.size
    stiff = -np.diag(np.concatenate([main.omega, sub.omega]) ** 2)
    gap = np.hstack([phi, -foot])
    on_main, on_sub = np.zeros(size), np.zeros((size, sub.shapes.shape[0]))
    on_main[:n], on_sub[n:] = main.loaded, sub.shapes.T
    motion = np.hstack([np.zeros((sub.shapes.shape[0], n)), sub.shapes])
    return NonlinearForm(size, _affine(stiff, -gap.T, gap, on_main, on_sub, law, loads), motion)


def _affine(
    stiff: Floats, scatter: Floats, gap: Floats, on_main: Floats, on_sub: Floats, law: Mountings, loads: Loads
) -> Callable[[float, Floats, Floats], Floats]:
    """Rate x'' = stiff x + scatter F_bar(gap x, gap x') + loads."""

    def rate(t: float, x: Floats, v: Floats) -> Floats:
        main, sub = loads(t)
        return np.asarray(stiff @ x + scatter @ law(gap @ x, gap @ v) + on_main * main + on_sub @ sub)

    return rate
