"""Modes of a whole system of components and linear connections: the exact eigenproblem in continuous time.

    x' = A x + B f,   g = C x,      rigid: g + R f = 0,      spring and dashpot: f = -k g - r g'

with x the real states of all components (see `propagator.real_form`), B and C as the gaps see them. Forces are
eliminated: springs and dashpots, and the directions in which R gives way, at once; the others hold positions and
velocities, so that the motion stays in the null space N of [C; C A],

    f = -(C A B)^+ C A^2 x,     poles = eig N^T (A - B (C A B)^+ C A^2) N,

which is Udwadia and Kalaba's equation for a linear system; redundant constraints are legal. C B = 0 is used:
a force moves a component with mass through its velocity only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot
from tonewood.physics.modal.modes import BLOCK, PAIR, ModalBasis
from tonewood.physics.modal.propagator import real_form

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class CoupledModes:
    """Modes of the whole, by ascending frequency.

    Attributes
    ----------
    poles : (n,) 1/s, Im > 0.
    components : names.
    shares : (n, n_components) share of each mode's energy in each component.
    """

    poles: Complexes
    components: tuple[str, ...]
    shares: Floats

    @property
    def freq(self) -> Floats:
        """(n,) Im s / 2 pi, Hz."""
        return self.poles.imag / (2 * np.pi)

    @property
    def damping_rate(self) -> Floats:
        """(n,) 1/s."""
        return -self.poles.real

    def dominated_by(self, *names: str) -> NDArray[np.intp]:
        """Modes with the largest share of their energy in one of these components."""
        columns = [self.components.index(name) for name in names]
        return np.flatnonzero(np.isin(np.argmax(self.shares, axis=1), columns))


def coupled_modes(
    components: Mapping[str, ModalBasis], connections: Sequence[Connection], *, freq_upper: float | None = None
) -> CoupledModes:
    """Modes of components held together.

    Parameters
    ----------
    freq_upper : Hz; component modes above it are left out, their static compliance put into R. Coupled modes are then
        given up to half of it. The work grows with the cube of the number of modes: a few hundred are quick.
    """
    bases = dict(components)
    if freq_upper is not None:
        bases = {name: b.select(np.flatnonzero(b.natural_freq < freq_upper)) for name, b in bases.items()}
    forms = {name: real_form(basis) for name, basis in bases.items()}
    sizes = [2 * basis.n_modes for basis in bases.values()]
    starts = dict(zip(bases, np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int), strict=True))
    n, m = sum(sizes), len(connections)
    A, B, C, R = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n)), np.zeros((m, m))
    for name, basis in bases.items():
        form, at = forms[name], starts[name]
        for k in range(basis.n_modes):
            A[at + 2 * k : at + 2 * k + 2, at + 2 * k : at + 2 * k + 2] = form.A[k]
        rows = np.zeros((m, len(basis.points)))
        for j, connection in enumerate(connections):
            for term in connection.terms:
                if term.component == name:
                    rows[j, basis.index(term.point)] += term.factor
        end = at + 2 * basis.n_modes
        B[at:end] = np.einsum("jp,pmx->mxj", rows, form.B).reshape(-1, m)
        C[:, at:end] = np.einsum("jp,pmx->jmx", rows, form.C).reshape(m, -1)
        R += rows @ basis.residual @ rows.T
    A, N = _eliminated(A, B, C, R, connections)
    poles, vectors = sla.eig(N.T @ A @ N)
    keep = poles.imag > 0
    if freq_upper is not None:
        keep &= poles.imag < np.pi * freq_upper
    order = np.flatnonzero(keep)[np.argsort(poles.imag[keep])]
    states = N @ vectors[:, order]
    energy = np.stack([_energy(bases[name], states[starts[name] :][: 2 * bases[name].n_modes]) for name in bases])
    return CoupledModes(poles[order], tuple(bases), np.asarray((energy / energy.sum(axis=0)).T))


def _eliminated(A: Floats, B: Floats, C: Floats, R: Floats, connections: Sequence[Connection]) -> tuple[Floats, Floats]:
    """A with every force eliminated, and an orthonormal basis of the states the constraints allow."""
    rigid = np.array([isinstance(c.law, Rigid) for c in connections], dtype=bool)
    laws = [c.law for c in connections if isinstance(c.law, SpringDashpot)]
    if laws:
        k, r = np.diag([law.stiffness for law in laws]), np.diag([law.damping for law in laws])
        soft = C[~rigid]
        A = A - B[:, ~rigid] @ (k @ soft + r @ soft @ A)
    B, C, R = B[:, rigid], C[rigid], R[np.ix_(rigid, rigid)]
    if not rigid.any():
        return A, np.eye(len(A))
    give, U = sla.eigh(0.5 * (R + R.T))
    yields = give > 1e-12 * max(float(give[-1]), 0.0) if give[-1] > 0 else np.zeros(len(give), dtype=bool)
    way = U[:, yields]
    A = A - B @ (way / give[yields]) @ way.T @ C
    B, C = B @ U[:, ~yields], U[:, ~yields].T @ C
    if B.shape[1] == 0:
        return A, np.eye(len(A))
    CA = C @ A
    scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(CA @ B)), np.finfo(float).tiny))
    inverse = scale[:, None] * sla.pinv(scale[:, None] * (CA @ B) * scale, rtol=1e-10) * scale
    free = sla.null_space(np.vstack([C / sla.norm(C), CA / sla.norm(CA)]), rcond=1e-12)
    return A - B @ inverse @ CA @ A, free


def _energy(basis: ModalBasis, states: Complexes) -> Floats:
    """(n,) mean energy of motions x exp(s t), (2 n_modes, n); omega^2 |r| / (2 omega |l|) (|x1|^2 + |x2|^2) per pair.

    For mass-normalised real modes this is their kinetic and potential energy; for others the same up to the terms that
    two modes have in common, which belong to neither.
    """
    omega = np.sqrt(basis.stiffness)
    size_r, size_l = np.abs(basis.right).max(axis=0), np.abs(basis.left).max(axis=0)
    pair = basis.kind == PAIR
    weight = np.where(basis.kind == BLOCK, 0.25, omega * size_r / np.where(size_l > 0, size_l, 1.0) / 2)
    first, second = np.abs(states[0::2]) ** 2, np.abs(states[1::2]) ** 2
    block = basis.kind == BLOCK
    total = np.where(pair[:, None], first + second, first)
    total = np.where(block[:, None], basis.stiffness[:, None] * first + second, total)
    return np.asarray(weight @ total)
