"""Modes of a component with masses, springs and dashpots fixed to it.

At points a = P y of a component x' = A x + B f, y = C x, lumps pull with

    f = -(M a'' + D a' + K a),    M, D, K diagonal and not negative,

so that with a'' = P C A^2 x + P C A B f the component obeys x' = (A - B G) x + (B - B N) f_other,

    G = (1 + M P C A B P^T)^-1 P (K C + D C A + M C A^2),    N = (1 + M P C A B P^T)^-1 M P C A B.

A finite force causes no jump of velocity: C B = 0. With Z the impedance of the lumps the mobility becomes
Y - Y_a (1/Z + Y_aa)^-1 Y_a; for a single mass m, at the mass, Y / (1 + i omega m Y). A passive component with such
lumps is passive. The modes are complex where damping couples them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form

#: frequency of the modes that stand for a residual compliance, re the highest mode
_FAR = 1e3
#: condition of the eigenvectors beyond which modes cannot be distinguished
_WORST = 1e12


def loaded(basis: ModalBasis, rows: ArrayLike, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> ModalBasis:
    """Fix lumps to a component.

    A residual compliance R is represented by modes at 1000 times the highest frequency, with an error of 1e-6 of its
    motion there. A lump with a mass is in series with R; a spring or a dashpot without mass acts on the modes only, as
    in `physics.coupling.connections`.

    rows : (n, n_points) share of each point's displacement in that of each lump.
    mass, damping, stiffness : (n,) kg, N s/m, N/m.
    Returns The modes of the whole, the same points, and the R that is left.
    Raises ValueError : a number is negative, or modes coincide so that they cannot be distinguished.
    """
    from tonewood.support.scipy_linalg import sla

    P = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    M, D, K = (np.broadcast_to(np.asarray(x, dtype=np.float64), len(P)) for x in (mass, damping, stiffness))
    if min(M.min(initial=0.0), D.min(initial=0.0), K.min(initial=0.0)) < 0:
        raise ValueError("mass, damping and stiffness must not be negative")
    if not len(P) or not basis.n_modes:
        return basis
    whole, far = _with_residual_modes(basis)
    form, n, n_points = real_form(whole), 2 * whole.n_modes, len(basis.points)
    A = np.zeros((n, n))
    for i, block in enumerate(form.A):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    B, C = form.B.reshape(n_points, n).T, form.C.reshape(n_points, n)
    read = P @ C
    read[M == 0, 2 * basis.n_modes :] = 0.0
    inject = B @ P.T
    inject[2 * basis.n_modes :, M == 0] = 0.0
    inertia = M[:, None] * (read @ A)
    solve = sla.inv(np.eye(len(P)) + inertia @ inject)
    G = solve @ (K[:, None] * read + D[:, None] * (read @ A) + inertia @ A)
    poles, vectors = sla.eig(A - inject @ G)
    if np.divide(*sla.svdvals(vectors)[[0, -1]]) > _WORST:
        raise ValueError("modes coincide, and cannot be distinguished")
    entry = sla.solve(vectors, (B - inject @ (solve @ (inertia @ B))).astype(np.complex128))
    upper = poles.imag >= 0
    right, left = C @ vectors[:, upper], entry[upper].T
    loaded = ModalBasis.complex(
        poles[upper], dict(zip(basis.points, right, strict=True)), dict(zip(basis.points, left, strict=True))
    )
    loaded = loaded.select(np.flatnonzero(loaded.natural_freq < 0.1 * far))
    return replace(loaded, metadata=dict(basis.metadata))


def with_masses(basis: ModalBasis, masses: Mapping[str, float]) -> ModalBasis:
    """Return the component beside free masses, each with a point of its name: one component, not joined yet.

    masses : point -> kg.
    """
    if not masses:
        return basis
    n, p = len(masses), len(basis.points)
    free = ModalBasis.real(
        np.zeros(n), np.zeros(n), dict(zip(masses, np.eye(n), strict=True)), modal_mass=[*masses.values()]
    )
    values: dict[str, Any] = {
        name: np.concatenate([getattr(basis, name), getattr(free, name)])
        for name in ("poles", "kind", "stiffness", "damping_rate")
    }
    for name in ("right", "left"):
        values[name] = np.zeros((p + n, basis.n_modes + n), dtype=np.complex128)
        values[name][:p, : basis.n_modes], values[name][p:, basis.n_modes :] = getattr(basis, name), getattr(free, name)
    residual = np.pad(basis.residual, (0, n))
    return replace(
        basis, **values, points=(*basis.points, *masses), residual=residual, shape=None, residual_at=None, places={}
    )


def at_first_points(basis: ModalBasis, n: int) -> ModalBasis:
    """Return the component with its first n points alone."""
    return replace(
        basis, points=basis.points[:n], right=basis.right[:n], left=basis.left[:n], residual=basis.residual[:n, :n]
    )


def _with_residual_modes(basis: ModalBasis) -> tuple[ModalBasis, float]:
    """The basis with undamped modes in place of its residual compliance, and their frequency, Hz."""
    from tonewood.support.scipy_linalg import sla

    omega = _FAR * float(np.sqrt(basis.stiffness.max()))
    values, vectors = sla.eigh(basis.residual)
    clear = values > 1e-12 * np.abs(basis.residual).max(initial=0.0)
    shapes = vectors[:, clear] * np.sqrt(values[clear]) * omega
    n = shapes.shape[1]
    residual_modes = ModalBasis.real(np.full(n, omega), np.zeros(n), dict(zip(basis.points, shapes, strict=True)))

    def both(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(basis, name), getattr(residual_modes, name)], axis=-1)

    more: dict[str, Any] = {n: both(n) for n in ("poles", "kind", "stiffness", "damping_rate", "right", "left")}
    more |= {"residual": np.zeros_like(basis.residual), "shape": None, "residual_at": None, "places": {}}
    whole = replace(basis, **more)
    return whole, omega / (2 * np.pi)
