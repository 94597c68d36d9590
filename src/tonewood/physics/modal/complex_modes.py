"""Complex modes of a component whose damping couples its real modes, rigid bodies and defective poles included.

With the real modes P of (M, K) and C~ = P^T C P the motion is written in energy coordinates s = (w, v): v are the
modal velocities and w = Omega q the elastic part of the modal displacements,

    s' = S s + (0, P^T f),    S = [[0, Omega], [-Omega, -C~]],    |s|^2 / 2 = energy.

S + S^T = -diag(0, 2 C~) is never positive for a passive component, so the null vectors of S from the right are those
from the left, and they can be split off without loss: the rest is regular, and rigid-body motion needs no
limit. S^T = J S J with J = diag(-I, I) makes every left eigenvector the right one with signs; with acoustic dofs the
signs of their rows turn once more (Fabre, Le Carrou & Chomette 2024, Eq. 16). In these coordinates Eq. 20 reads
Pi = (s^T J s) / lambda.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import BLOCK, PAIR, REAL
from tonewood.support.arrays import Complexes, Floats

#: poles nearer than this, relative to themselves, are treated together
_NEAR = 1e-3
#: the same for a pole and its own conjugate
_NEAR_AXIS = 0.1
#: pairing of left and right vectors below which two poles on the axis become a block, and a group is left as it is
_DEFECTIVE = 1e-4
#: deviation of two poles' motion from that of one double pole below which it is one, relative: the error of taking it
#: for one is then no larger than that of a block, which is rounding divided by the deviation
_EQUAL = 1e-8


#: pole, kind, stiffness, damping rate, right and left shape at all dofs
_Mode = tuple[complex, int, float, float, Complexes, Complexes]
ModeArrays = tuple[Complexes, NDArray[np.uint8], Floats, Floats, Complexes, Complexes]


def complex_modes(
    P: Floats, omega: Floats, damping: Floats, sign: Floats, *, least_pairing: float = 1e-4
) -> ModeArrays | None:
    """Modes of q'' + C~ q' + Omega^2 q = P^T f,  x = P q.

    P : (n_dof, n) mass-normalised real shapes.
    omega : (n,) rad/s, exactly 0 for rigid-body modes.
    damping : (n, n) C~, 1/s.
    sign : (n,) -1 for acoustic modes, 1 for structural ones.
    least_pairing : smallest singular value of the pairing of unit left and right vectors that still counts as simple
        poles; modes are exact to rounding divided by it.
    Returns poles, kind, stiffness, damping_rate : (n_modes,).
    right, left : (n_dof, n_modes).
    None, if poles off the real axis coincide (or more than two on it), which no simple modes can express.
    Raises ValueError : a rigid-body motion that damping neither brakes nor leaves alone: C~ is not positive
        semi-definite.
    """
    from tonewood.support.scipy_linalg import sla

    order = np.argsort(omega == 0, kind="stable")
    P, damping, sign, omega = P[:, order], damping[np.ix_(order, order)], sign[order], omega[order]
    e, m = int(np.count_nonzero(omega)), omega.size
    S = np.zeros((e + m, e + m))
    S[:e, e : 2 * e] = np.diag(omega[:e])
    S[e : 2 * e, :e] = -np.diag(omega[:e])
    S[e:, e:] = -damping
    steady, Q = _split(S, damping, omega, e)
    A = Q.T @ S @ Q
    signs = Q.T @ (np.concatenate([-sign[:e], sign])[:, None] * Q)
    force = Q.T[:, e:] @ P.T  # state rate per unit force at each dof
    moving = P @ Q[e:]  # velocity of each dof per unit state

    out = _rigid_modes(P, omega, e, steady, -Q[2 * e :] @ sla.solve(A, force)) if e < m else []
    poles, vectors = sla.eig(A)
    X = vectors.astype(np.complex128)  # real where all poles are
    blocks: list[NDArray[np.intp]] = []
    for group in _groups(poles):
        lam, vectors = poles[group], X[:, group]
        on_axis = group.size == 2 and bool(np.all(lam.imag == 0) or lam[0] == lam[1].conjugate())
        pairing = vectors.T @ signs @ vectors
        weakest = float(sla.svdvals(pairing)[-1])
        if on_axis and (weakest < _DEFECTIVE or np.any(lam.imag != 0)):
            X[:, group] = span = _real_span(A, lam)
            centre = lam.real.mean()
            if np.abs(span.T @ A @ span - centre * np.eye(2)).max() <= _EQUAL * abs(centre):
                # one real pole of two modes, which rounding may take for a pair: no block has it, two modes do
                X[:, group], poles[group] = span @ _inverse_root((span.T @ signs @ span).astype(np.complex128)), centre
            else:
                blocks.append(group)
        elif weakest < least_pairing:
            return None
        elif group.size > 1 and weakest >= _DEFECTIVE:
            X[:, group] = vectors @ _inverse_root(pairing)
    Y = sla.inv(X)
    inputs, rates = Y @ force, moving @ X
    for group in blocks:
        T = (Y[group] @ A @ X[:, group]).real
        out.append(_companion(T, rates[:, group].real, inputs[group].real, poles[group]))
    simple = np.ones(poles.size, dtype=bool)
    simple[[k for group in blocks for k in group]] = False
    for k in np.flatnonzero(simple & (poles.imag >= 0)):
        pole = complex(poles[k])
        right, left = rates[:, k] / pole, inputs[k]
        if pole.imag == 0:
            right, left = right.real.astype(np.complex128), left.real.astype(np.complex128)
        out.append((pole, PAIR if pole.imag else REAL, abs(pole) ** 2, -pole.real, right, left))

    out.sort(key=lambda mode: (abs(mode[0]), mode[0].real))
    return (
        np.array([mode[0] for mode in out], dtype=np.complex128),
        np.array([mode[1] for mode in out], dtype=np.uint8),
        np.array([mode[2] for mode in out]),
        np.array([mode[3] for mode in out]),
        np.stack([mode[4] for mode in out], axis=1),
        np.stack([mode[5] for mode in out], axis=1),
    )


def _split(S: Floats, damping: Floats, omega: Floats, e: int) -> tuple[Floats, Floats]:
    """Orthonormal null vectors of S, steady motion of rigid bodies that nothing brakes, and the rest of the space."""
    from tonewood.support.scipy_linalg import sla

    if e == omega.size:
        return np.zeros((S.shape[0], 0)), np.eye(S.shape[0])
    _, size, Vt = sla.svd(damping[e:, e:])
    free = Vt[size <= 1e-12 * np.abs(damping).max()].T
    k = free.shape[1]
    if k == 0:
        return np.zeros((S.shape[0], 0)), np.eye(S.shape[0])
    bent = -(damping[:e, e:] @ free) / omega[:e, None]
    full = sla.qr(np.concatenate([bent, np.zeros((e, k)), free]))[0]
    if np.abs(S.T @ full[:, :k]).max() > 1e-9 * np.abs(S).max():
        raise ValueError("a rigid-body motion feeds on its own damping: C is not positive semi-definite")
    return full[:, :k], full[:, k:]


def _rigid_modes(P: Floats, omega: Floats, e: int, steady: Floats, slip: Floats) -> list[_Mode]:
    """Modes of pole 0.

    A steady motion b' = l f carries the rigid bodies along, a' = b + ..., y = r a + (shape bent) b. The displacement
    `slip` (n_rigid, n_dof) that unit impulses leave behind in the rigid bodies goes along the steady motions as far as
    it can, and the rest of it is real poles at 0: bodies that damping brings to rest elsewhere.
    """
    from tonewood.support.scipy_linalg import sla

    travel, bent = steady[2 * e :], steady[:e] / omega[:e, None]
    carried, slid = P[:, e:] @ travel, sla.pinv(travel) @ slip if travel.size else np.zeros((0, P.shape[0]))
    shapes, inputs = carried + 1j * (P[:, :e] @ bent), carried + 1j * slid.T
    out: list[_Mode] = [(0j, BLOCK, 0.0, 0.0, r, ell) for r, ell in zip(shapes.T, inputs.T, strict=True)]
    U, size, Vt = sla.svd(slip - travel @ slid)
    for j in range(travel.shape[0] - travel.shape[1]):
        root = np.sqrt(size[j]) + 0j
        out.append((0j, REAL, 0.0, 0.0, P[:, e:] @ U[:, j] * root, Vt[j] * root))
    return out


def _groups(poles: Complexes) -> list[NDArray[np.intp]]:
    """Indices of poles that lie together, closed under conjugation; conjugates of such groups are left out."""
    free = list(range(poles.size))
    groups: list[NDArray[np.intp]] = []
    while free:
        group: list[int] = []
        new = [free[0]]
        while new:
            for j in new:
                free.remove(j)
            group += new
            new = [j for j in free if any(_are_near(poles[j], poles[i]) for i in group)]
        groups.append(np.array(sorted(group)))
    return [group for group in groups if np.any(poles[group].imag >= 0)]


def _are_near(one: complex, other: complex) -> bool:
    conjugate = one.imag != 0 and one == other.conjugate()
    return bool(abs(one - other) < (_NEAR_AXIS if conjugate else _NEAR) * abs(other))


def _inverse_root(pairing: Complexes) -> Complexes:
    """W^(-1/2) of a complex symmetric pairing; |W|^(-1/2) of a real one, so that real vectors stay real.

    It turns every vector as little as possible, so that each keeps its pole.
    """
    from tonewood.support.scipy_linalg import sla

    W = 0.5 * (pairing + pairing.T)
    if np.abs(W.imag).max() <= 1e-12 * np.abs(W).max():
        d, U = sla.eigh(W.real)
        return np.asarray(U / np.sqrt(np.abs(d)) @ U.T, dtype=np.complex128)
    return np.asarray(sla.inv(sla.sqrtm(W)), dtype=np.complex128)


def _real_span(A: Floats, lam: Complexes) -> Floats:
    """(n, 2) orthonormal basis of the motion of two poles near one another on or about the real axis."""
    from tonewood.support.scipy_linalg import sla

    centre = complex(lam.mean())
    reach = float(np.abs(lam - centre).max()) + 0.25 * _NEAR * abs(centre)
    inside: Callable[..., bool] = lambda pole: abs(pole - centre) <= reach  # noqa: E731
    _, vectors, count = sla.schur(A.astype(np.complex128), sort=inside)
    if count != 2:
        raise ValueError(f"poles about {centre:.6g} 1/s cannot be distinguished")
    return np.asarray(sla.svd(np.concatenate([vectors[:, :2].real, vectors[:, :2].imag], axis=1))[0][:, :2])


def _companion(T: Floats, motion: Floats, inputs: Floats, lam: Complexes) -> _Mode:
    """The block z' = T z + inputs f, y' = motion z as a ``BLOCK``: z = H (q, p), T H = H [[0, 1], [-w^2, -2 s]]."""
    from tonewood.support.scipy_linalg import sla

    trace, determinant = float(np.trace(T)), float(T[0, 0] * T[1, 1] - T[0, 1] * T[1, 0])
    trial = [np.array([np.cos(angle), np.sin(angle)]) for angle in np.linspace(0, np.pi, 8, endpoint=False)]
    second = max(trial, key=lambda h: abs((T @ h)[0] * h[1] - (T @ h)[1] * h[0]))
    H = np.stack([T @ second - trace * second, second], axis=1)
    shapes, driven = motion @ sla.solve(T, H), sla.solve(H, inputs)
    pole = complex(lam.real.max(), np.abs(lam.imag).max())
    return pole, BLOCK, determinant, -trace / 2, shapes[:, 0] + 1j * shapes[:, 1], driven[1] + 1j * driven[0]
