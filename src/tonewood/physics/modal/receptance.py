"""Receptance of components at their ports, at complex frequency; the modes of a coupled system follow from it.

    H(s) = sum_k r_k l_k^T / (s - lambda_k) + conj. part + sum_blocks r l^T / (s^2 + 2 sigma s + omega^2) + R

Components joined rigidly by forces f move freely where [sum A H(s) A^T] f = 0: a mode of the whole is a zero of the
determinant, whatever the number of modes of the parts. The matrix is as small as the number of joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.physics.modal.modes import BLOCK, PAIR, ModalBasis
from tonewood.support.arrays import Complexes, Floats

#: moments of the integrals that `Joint.zeros_within` takes, per Hankel matrix, and their smallest singular value
_MOMENTS, _RANK = 3, 1e-7


@dataclass(frozen=True, eq=False)
class Ports:
    """One component at some rows over its points.

    poles : (n,) 1/s, both of each pair.
    right, left : (p, n).
    weight : (n,) energy of |z|^2 = 1: omega |r| / |l| / 2 over all points of the component.
    stiffness, damping_rate : (b,) of modes kept as second-order blocks.
    block_right, block_left : (p, b).
    residual : (p, p) m/N.
    """

    poles: Complexes
    right: Complexes
    left: Complexes
    weight: Floats
    stiffness: Floats
    damping_rate: Floats
    block_right: Complexes
    block_left: Complexes
    residual: Floats

    @classmethod
    def of(cls, basis: ModalBasis, rows: Floats) -> Ports:
        """See `basis` through `rows` (p, n_points)."""
        block, pair = basis.kind == BLOCK, basis.kind == PAIR
        single = ~block
        right, left = rows @ basis.right, rows @ basis.left

        def full(values: Complexes) -> Complexes:
            return np.concatenate([values[..., single], np.conj(values[..., pair])], axis=-1)

        size_r, size_l = np.abs(basis.right).max(axis=0), np.abs(basis.left).max(axis=0)
        weight = np.sqrt(basis.stiffness) * size_r / np.where(size_l > 0, size_l, 1.0) / 2
        return cls(
            poles=full(basis.poles),
            right=full(right),
            left=full(left),
            weight=np.concatenate([weight[single], weight[pair]]),
            stiffness=basis.stiffness[block],
            damping_rate=basis.damping_rate[block],
            block_right=right[:, block],
            block_left=left[:, block],
            residual=np.asarray(rows @ basis.residual @ rows.T),
        )

    def energy(self, s: complex, force: Complexes) -> float:
        """Mean modal energy, J, of the motion under port forces f exp(s t), (p,) N."""
        z = (self.left.T @ force) / (s - self.poles)
        total = float(np.sum(self.weight * np.abs(z) ** 2))
        if self.stiffness.size:
            q = (self.block_left.T @ force) / (s**2 + 2 * self.damping_rate * s + self.stiffness)
            total += float(np.sum((abs(s) ** 2 + self.stiffness) / 4 * np.abs(q) ** 2))
        return total


class Joint:
    """Components joined at p gaps: M(s), the sum of their receptances.

    parts : each with p ports, one per gap (rows of zeros where it does not take part).
    """

    def __init__(self, parts: Sequence[Ports]):
        self.parts = tuple(parts)
        self.size = parts[0].residual.shape[0]
        self._poles = np.concatenate([p.poles for p in parts])
        self._right, self._left = (
            np.concatenate([getattr(p, side) for p in parts], axis=1) for side in ("right", "left")
        )
        self._stiffness = np.concatenate([p.stiffness for p in parts])
        self._damping_rate = np.concatenate([p.damping_rate for p in parts])
        self._block_right = np.concatenate([p.block_right for p in parts], axis=1)
        self._block_left = np.concatenate([p.block_left for p in parts], axis=1)
        self._residual = np.sum([p.residual for p in parts], axis=0)

    def receptance(self, s: complex) -> tuple[Complexes, Complexes]:
        """M(s) and its derivative, (p, p) each; what a search asks for most often."""
        away = s - self._poles
        if not away.all():  # at a pole, as of a mode that no gap moves: a rounding error beside it
            away[away == 0] = np.spacing(abs(s))
        reach = 1 / away
        reached = self._right * reach
        M, D = reached @ self._left.T + self._residual, -(reached * reach) @ self._left.T
        if self._stiffness.size:
            at = np.array([s])
            for out, slope in ((M, False), (D, True)):
                blocks = _blocks(at, self._stiffness, self._damping_rate, slope)[0]
                out += (self._block_right * blocks) @ self._block_left.T
        return np.asarray(M), np.asarray(D)

    def receptances(self, s: Complexes, slope: bool = False) -> Complexes:
        """(n, p, p) M at n places, or M'."""
        reach = 1 / (s[:, None, None] - self._poles)
        out = (
            -(self._right * reach**2) @ self._left.T if slope else (self._right * reach) @ self._left.T + self._residual
        )
        if self._stiffness.size:
            blocks = _blocks(s, self._stiffness, self._damping_rate, slope)
            out = out + (self._block_right * blocks[:, None]) @ self._block_left.T
        return np.asarray(out)

    def determinant(self, s: complex) -> tuple[complex, complex]:
        """Return det M and its derivative, det M tr(M^-1 M')."""
        M, D = self.receptance(s)
        if self.size == 1:
            return complex(M[0, 0]), complex(D[0, 0])
        if self.size == 2:
            det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
            slope = D[0, 0] * M[1, 1] + M[0, 0] * D[1, 1] - D[0, 1] * M[1, 0] - M[0, 1] * D[1, 0]
            return complex(det), complex(slope)
        from scipy.linalg.lapack import zgetrf, zgetri  # OpenBLAS solves by threads, however few the unknowns are

        # near a zero M is as good as singular, which `solve` would warn of
        lu, pivots, singular = zgetrf(M)
        if singular:
            return 0j, 0j
        det = complex(np.prod(np.diag(lu))) * (-1) ** int(np.count_nonzero(pivots != np.arange(self.size)))
        return det, det * complex(np.sum(zgetri(lu, pivots)[0].T * D))

    def condensed(self, s: complex) -> tuple[complex, complex]:
        """Return S = M_00 - M_01 M_11^-1 M_10, the first gap's receptance while the others are closed, and S'."""
        M, D = self.receptance(s)
        right, left = np.linalg.solve(M[1:, 1:], M[1:, :1]), np.linalg.solve(M[1:, 1:].T, M[:1, 1:].T).T
        slope = D[:1, :1] - D[:1, 1:] @ right - left @ D[1:, :1] + left @ D[1:, 1:] @ right
        return complex(M[0, 0] - (M[:1, 1:] @ right)[0, 0]), complex(slope[0, 0])

    def null(self, s: complex) -> tuple[Complexes, Complexes]:
        """Right and left null vectors v, w of M at a zero s, norm 1: M v = 0, w M = 0; v are the gaps' forces."""
        M = self.receptance(s)[0]
        if self.size == 1:
            return np.ones(1, dtype=np.complex128), np.ones(1, dtype=np.complex128)
        if self.size == 2:
            # at a zero the adjugate has rank 1 and is v w
            adjugate = np.array([[M[1, 1], -M[0, 1]], [-M[1, 0], M[0, 0]]])
            i, j = np.unravel_index(int(np.argmax(np.abs(adjugate))), (2, 2))
            v, w = adjugate[:, j], adjugate[i]
            return v / np.sqrt(np.vdot(v, v).real), w / np.sqrt(np.vdot(w, w).real)
        U, _, Vh = np.linalg.svd(M)
        return np.asarray(Vh[-1].conj()), np.asarray(U[:, -1].conj())

    def shares(self, s: complex) -> Floats:
        """(n_parts,) share of the modal energy in each part, in the mode at a zero s."""
        force = self.null(s)[0]
        energy = np.array([part.energy(s, force) for part in self.parts])
        return np.asarray(energy / energy.sum())

    def newton(
        self,
        start: complex,
        *,
        multiply: Sequence[complex] = (),
        divide: Sequence[complex] = (),
        first: bool = False,
        tolerance: float = 1e-11,
        steps: int = 40,
    ) -> complex | None:
        """A zero of det M prod (s - multiply) / prod (s - divide) from `start`; None if it does not converge.

        Poles of det M near the start are to be multiplied out, zeros already found divided out. `first` takes S of
        `condensed` for det M: a mode of the first gap and one of another at the same frequency are a double zero of
        det M, whose place is known to half of the digits only, but a simple one of S.
        """  # fmt: skip
        s = complex(start)
        for _ in range(steps):
            det, slope = self.condensed(s) if first else self.determinant(s)
            if det == 0:
                return s
            rate = slope / det
            rate += sum(1 / (s - pole) for pole in multiply if s != pole)
            rate -= sum(1 / (s - zero) for zero in divide if s != zero)
            step = 1 / rate if rate != 0 else 0.05 * abs(s)
            if abs(step) > 0.05 * abs(s):
                step *= 0.05 * abs(s) / abs(step)
            s -= step
            if abs(step) <= tolerance * abs(s):
                return s if s.imag > 0 else None
        return None

    def zeros(self, starts: Sequence[complex], *, multiply: Sequence[complex] = ()) -> list[complex]:
        """Zeros of det M, each once, one for each start that leads to another."""
        roots: list[complex] = []
        for start in starts:
            s = self.newton(start, multiply=multiply, divide=roots)
            if s is not None and all(abs(s - other) > 1e-9 * abs(s) for other in roots):
                roots.append(s)
        return roots

    def zeros_within(
        self, centre: complex, radius: float, *, starts: Sequence[complex] = (), places: int = 48
    ) -> list[complex]:
        """Every zero of M within a circle, by integrals of M^-1 along it, each made exact by Newton's rule.

        The poles of M are none of M^-1. Moments A_k = sum_j u_j^(k + 1) M(z_j)^-1, k = 0 .. 5, u = (z - centre) /
        radius, as block Hankel matrices H_0 of A_0 .. A_4 and H_1 of A_1 .. A_5: the eigenvalues of H_0^+ H_1 are the
        zeros' u, up to three per port. Newton's rule from there removes the error of a finite number of `places`; zeros
        outside the circle are dropped. A zero whose residue is small beside others may be missed: `starts` are further
        places from which Newton's rule begins.

        Source: W.-J. Beyn, Linear Algebra and its Applications 436 (2012) 3839, section 5.
        """
        u = np.exp(2j * np.pi * (np.arange(places) + 0.5) / places)
        inverse = np.array([np.linalg.inv(M) for M in self.receptances(centre + radius * u)])
        scale = np.abs(inverse).max()
        moments = [np.einsum("j,jab->ab", u ** (k + 1), inverse / scale) / places for k in range(2 * _MOMENTS)]

        def hankel(first: int) -> Complexes:
            return np.block([[moments[first + i + j] for j in range(_MOMENTS)] for i in range(_MOMENTS)])

        U, size, Vh = np.linalg.svd(hankel(0))
        rank = int(np.count_nonzero(size > _RANK * size[0]))
        small = (U[:, :rank].conj().T @ hankel(1) @ Vh[:rank].conj().T) / size[:rank]
        roots: list[complex] = []
        for start in (*(centre + radius * np.linalg.eigvals(small)), *starts):
            s = self.newton(complex(start))
            if s is not None and abs(s - centre) <= radius and all(abs(s - other) > 1e-9 * abs(s) for other in roots):
                roots.append(s)
        return sorted(roots, key=lambda s: s.imag)


class Star(Joint):
    """One component with p ports, and at each of them another one with one port: strings on a body.

    centre : with p ports.
    rays : p components with one port each; they meet through the centre only.
    """

    def __init__(self, centre: Ports, rays: Sequence[Ports]):
        super().__init__([centre])
        self.parts = (centre, *rays)
        self._rays = tuple(rays)
        self._ray_poles = np.concatenate([r.poles for r in rays])
        self._ray_residues = np.concatenate([(r.right * r.left)[0] for r in rays])
        self._first = np.cumsum([0, *(r.poles.size for r in rays[:-1])])
        self._diagonal = np.array([r.residual[0, 0] for r in rays])

    def receptance(self, s: complex) -> tuple[Complexes, Complexes]:
        """M(s) and its derivative, (p, p) each."""
        at = np.array([s])
        return self.receptances(at)[0], self.receptances(at, slope=True)[0]

    def receptances(self, s: Complexes, slope: bool = False) -> Complexes:
        """(n, p, p) M at n places, or M'."""
        out = super().receptances(s, slope)
        reach = 1 / (s[:, None] - self._ray_poles)
        terms = self._ray_residues * (-(reach**2) if slope else reach)
        on = np.arange(self.size)
        out[:, on, on] += np.add.reduceat(terms, self._first, axis=1) + (0.0 if slope else self._diagonal)
        for i, ray in enumerate(self._rays):
            if ray.stiffness.size:
                out[:, i, i] += (
                    _blocks(s, ray.stiffness, ray.damping_rate, slope) @ (ray.block_right * ray.block_left)[0]
                )
        return out

    def shares(self, s: complex) -> Floats:
        """(p + 1,) share of the modal energy in the centre and in each ray, in the mode at a zero s."""
        force = self.null(s)[0]
        rays = [ray.energy(s, force[i : i + 1]) for i, ray in enumerate(self._rays)]
        energy = np.array([self.parts[0].energy(s, force), *rays])
        return np.asarray(energy / energy.sum())


def _blocks(s: Complexes, stiffness: Floats, damping_rate: Floats, slope: bool) -> Complexes:
    """(n, b) 1 / (s^2 + 2 sigma s + omega^2), or its derivative."""
    below = 1 / (s[:, None] ** 2 + 2 * damping_rate * s[:, None] + stiffness)
    return np.asarray(-2 * (s[:, None] + damping_rate) * below**2 if slope else below)
