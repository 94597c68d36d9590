"""How far the damping of a body couples its modes, and the modes without that coupling.

The modes of a body whose damping is not proportional are complex: its points do not pass through zero together. Three
descriptions of one body (Fabre, Le Carrou & Chomette 2024, section 3) are distinguished here by a *damping case*:

* ``complex``: the modes as they are (their case 1);
* ``proportional``: falsely complex modes, real shapes phi = Re(psi sqrt(2j Im lambda)) taken back to
  psi = phi / sqrt(2j Im lambda) (their case 2);
* ``block``: damping couples the modes of a group, and nothing else (Balmes 1997). Groups come from Hasselman's
  separation criterion; within each the shapes are moved as little as possible to be those of a second-order system.

All three keep the poles. Over- and critically damped modes and rigid-body modes are left as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.support.arrays import Complexes, Floats

CASES = ("complex", "proportional", "block")


def phase_collinearity(shapes: ArrayLike) -> Floats:
    """Modal phase collinearity MPC(u) = (|u^H conj(u)| / |u|^2)^2 of each column: 1 for a real mode, 0 for a wave.

    shapes : (n_points, n_modes) complex, e.g. the right shapes of a basis.
    Returns (n_modes,), in [0, 1]; 1 for a column of zeros. Fabre et al. 2024, section 3.1.
    """
    u = np.asarray(shapes, dtype=np.complex128)
    size = np.sum(np.abs(u) ** 2, axis=0)
    same = np.abs(np.sum(u * u, axis=0))
    return np.asarray(np.divide(same, size, out=np.ones_like(size), where=size > 0) ** 2)


def separation(basis: ModalBasis) -> Floats:
    """Hasselman's criterion 2 zeta_j omega_j / |omega_j - omega_k|, (n_modes, n_modes); infinite on the diagonal.

    Damping couples modes j and k little where both [j, k] and [k, j] are far below 1. Hasselman 1976; Fabre et al.
    2024, Eq. 39.
    """
    omega = np.sqrt(basis.stiffness)
    with np.errstate(divide="ignore", invalid="ignore"):
        out = 2 * np.abs(basis.damping_rate)[:, None] / np.abs(omega[:, None] - omega)
    np.fill_diagonal(out, np.inf)
    # two undamped modes of one frequency are not coupled by damping
    return np.where(np.isnan(out), 0.0, out)


def damping_groups(basis: ModalBasis, threshold: float = 0.2) -> list[NDArray[np.intp]]:
    """Groups of modes that damping couples: connected where the separation criterion exceeds `threshold`.

    Returns Index arrays, each ascending, ordered by their first mode; together they hold every mode once.
    """
    if not threshold > 0:
        raise ValueError(f"a separation threshold must be above 0, not {threshold}")
    linked = separation(basis) > threshold
    linked = linked | linked.T
    groups: list[NDArray[np.intp]] = []
    left = set(range(basis.n_modes))
    while left:
        group, edge = set(), {min(left)}
        while edge:
            group |= edge
            edge = {int(k) for j in edge for k in np.flatnonzero(linked[j])} - group
        groups.append(np.array(sorted(group), dtype=np.intp))
        left -= group
    return groups


def with_damping_case(basis: ModalBasis, case: str, threshold: float = 0.2) -> ModalBasis:
    """Return the body under another damping case (Fabre et al. 2024, section 3).

    Parameters
    ----------
    basis : complex modes of one body; left shapes must be +-(right)/Pi, as those of a reciprocal body are.
    case : ``complex``, ``proportional`` or ``block``.
    threshold : of the separation criterion; used by ``block`` alone.

    Returns
    -------
    A basis with the same poles and points; real modes are returned as they are. At acoustic points (where the left
    shape has the other sign, Fabre et al. 2024, Eq. 16) the velocity potential of a real mode is imaginary, and is
    kept so.

    Raises
    ------
    ValueError : unknown case, or shapes that are not those of a reciprocal body.
    """
    if case not in CASES:
        raise ValueError(f"a damping case is complex, proportional or block, not {case!r}")
    pairs = np.flatnonzero(basis.kind == PAIR)
    if case == "complex" or pairs.size == 0 or basis.is_real:
        return basis
    normal, sign = reciprocal_shapes(basis)
    turn = np.where(sign < 0, 1j, 1.0)[:, None]
    # rows in other units than the rest must not outweigh them when shapes are moved "as little as possible"
    weight = np.ones((len(sign), 1))
    if (sign < 0).any() and (sign > 0).any():
        weight[sign < 0] = np.linalg.norm(normal[sign > 0]) / (np.linalg.norm(normal[sign < 0]) or 1.0)
    flat = weight * normal / turn
    if case == "proportional":
        groups = [np.array([k]) for k in pairs]
    else:
        groups = [g[basis.kind[g] == PAIR] for g in damping_groups(basis, threshold)]
    right, left = basis.right.copy(), basis.left.copy()
    for group in groups:
        if group.size == 0:
            continue
        # mass-normalised: a mode of its own group has real shapes, and the basis of such modes is real
        root = np.sqrt(2j * basis.poles[group].imag)
        shapes = proper_shapes(flat[:, group]).shapes * root / weight
        shapes = turn * (shapes.real if group.size == 1 else shapes)
        right[:, group], left[:, group] = shapes, sign[:, None] * shapes / root**2
    return replace(basis, right=right, left=left, metadata={**basis.metadata, "damping_case": case})


def reciprocal_shapes(basis: ModalBasis) -> tuple[Complexes, Floats]:
    """Shapes scaled so that Pi = 1, and the sign s of each point: left = s right.

    Returns shapes : (n_points, n_modes); columns of modes that are not of kind ``PAIR`` are as they were.
    sign : (n_points,) +1, or -1 for points that are acoustic to the first driven point (or it to them).
    """
    pair = basis.kind == PAIR
    r, ell = basis.right[:, pair], basis.left[:, pair]
    work = np.abs(r) * np.abs(ell)
    reference = int(np.argmax(work.sum(axis=1) > 0))
    here, there = r[reference] * ell, ell[reference] * r
    size = np.sum(np.abs(here) + np.abs(there), axis=1)
    sign = np.where(np.sum(np.abs(here + there), axis=1) < 1e-6 * size, -1.0, 1.0)
    wrong = np.sum(np.abs(here - sign[:, None] * there), axis=1) > 1e-6 * size
    if wrong.any():
        name = basis.points[int(np.flatnonzero(wrong)[0])]
        raise ValueError(
            f"the shapes at {name!r} are not reciprocal: apply the damping case to the modes as identified"
        )
    largest = np.argmax(work, axis=0)
    column = np.arange(r.shape[1])
    den = sign[largest] * ell[largest, column]
    norm = np.where(den != 0, r[largest, column] / np.where(den != 0, den, 1.0), 1.0)
    shapes = basis.right.copy()
    shapes[:, pair] = r / np.sqrt(norm.astype(np.complex128))
    return shapes, sign


@dataclass(frozen=True, eq=False)
class ProperShapes:
    """Shapes psi = A (I + i U), A real, U orthogonal: just those that satisfy Re(psi psi^T) = 0.

    A : (n_points, n_modes) real.
    U : (n_modes, n_modes) orthogonal; -I for the modes of proportional damping.
    """

    A: Floats
    U: Floats

    @property
    def shapes(self) -> Complexes:
        """(n_points, n_modes) complex, for Pi = 1."""
        return np.asarray(self.A + 1j * (self.A @ self.U))


def proper_shapes(shapes: Complexes) -> ProperShapes:
    """The nearest shapes (least squares) that are modes of a second-order system: 2 Re sum psi psi^T = 0.

    Without it a force would move the body instantaneously. With psi = X + iY Balmes (1997) finds them from an
    algebraic Riccati equation; for real symmetric multipliers of the condition it reads

        W (X X^T) W = Y Y^T,    psi_proper = [ (I + W) X + i (I + W^-1) Y ] / 2,    W > 0.

    The same minimum is reached without solving it where X X^T is singular (fewer modes than points): the condition
    says that Im psi = (Re psi) U with an orthogonal U, and over those |psi - A (I + iU)| is least for the orthogonal
    polar factor U of X^T Y, with A = (X + Y U^T) / 2.

    shapes : (n_points, n_modes) complex, scaled so that Pi = 1. One mode alone becomes falsely complex,
        Re(psi sqrt(2j omega)) / sqrt(2j omega).
    """
    X, Y = shapes.real, shapes.imag
    P, s, Qh = np.linalg.svd(X.T @ Y)
    used = s > 1e-13 * max(float(s.max(initial=0.0)), np.finfo(float).tiny)
    U = P[:, used] @ Qh[used]
    rest_p, rest_q = P[:, ~used], Qh[~used].T
    if rest_p.size:
        # not seen at the points: as near to proportional damping (U = -I) as can be
        a, _, bh = np.linalg.svd(rest_q.T @ rest_p)
        U = U - rest_p @ bh.T @ a.T @ rest_q.T
    return ProperShapes(np.asarray(0.5 * (X + Y @ U.T)), np.asarray(U))


def hermitian_mass_inverse(shapes: Complexes, poles: Complexes, norm: ArrayLike = 1.0) -> Complexes:
    """Inverse of the Hermitian modal mass matrix psi^H M psi of a structural body, from its modes alone.

    M_h^-1 = psi^+ [2 Re(psi Pi^-1 Lambda psi^T)] (psi^+)^H; the bracket is M^-1 of the body (Fabre et al. 2024,
    Eqs 21, 28 and A.1-A.4).

    shapes : (n_points, n_modes) of full column rank: at least as many points as modes.
    poles : (n_modes,) 1/s, one of each pair.
    norm : (n_modes,) or scalar, Pi.
    Returns (n_modes, n_modes) Hermitian.
    Raises ValueError : the shapes are not of full column rank.
    """
    psi = np.asarray(shapes, dtype=np.complex128)
    values = np.linalg.svdvals(psi)
    if psi.shape[0] < psi.shape[1] or values[-1] <= 1e-12 * values[0]:
        raise ValueError("the modal mass matrix needs at least as many independent points as modes")
    inverse_mass = 2 * ((psi * (poles / np.asarray(norm, dtype=np.complex128))) @ psi.T).real
    pinv = np.linalg.pinv(psi)
    out = pinv @ inverse_mass @ pinv.conj().T
    return np.asarray(0.5 * (out + out.conj().T))
