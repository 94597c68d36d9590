"""Between a mode's two numbers and its motion (q, q'), and the velocities that joined parts must share.

Displacement and velocity are what carries over when a string is stopped, bent or damped: z itself does not, because
its meaning depends on the pole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.connections import Rigid, scaled_pinv
from tonewood.numerics.modes import PAIR, ModalBasis
from tonewood.numerics.system import State, System

Floats = NDArray[np.float64]


def to_motion(basis: ModalBasis, modes: Floats) -> tuple[Floats, Floats]:
    """Coordinates q (m sqrt(kg)) and q' of real modes, y = sum phi q, from their numbers (2, n_modes)."""
    x, y = modes
    pair, lam = basis.kind == PAIR, basis.poles
    q = np.where(pair, 2 * x, x)
    return q, np.where(pair, 2 * (lam.real * x - lam.imag * y), y)


def from_motion(basis: ModalBasis, q: Floats, velocity: Floats) -> Floats:
    """Return the numbers (2, n_modes) of real modes with coordinates q and q'."""
    pair, lam = basis.kind == PAIR, basis.poles
    turn = np.where(pair, lam.imag, 1.0)
    return np.stack([np.where(pair, q / 2, q), np.where(pair, (lam.real * q - velocity) / (2 * turn), velocity)])


def share_velocities(system: System, state: State, joints: NDArray[np.bool_] | None = None) -> None:
    """Give rigidly joined points equal velocities by impulses at the joints: a plastic impact.

    v+ = v - Y A^T (A Y A^T)^+ A v with Y the velocity under a unit impulse, the projection in the mass norm: kinetic
    energy can only fall. Without it a struck body or a stopped string leaves the joint's velocities apart, and the
    constraint force then alternates from sample to sample for ever.

    Parameters
    ----------
    joints : (m,) connections to look at, all where left out; only rigid ones take part.
    """
    rigid = np.array([isinstance(c.law, Rigid) for c in system.connections], dtype=bool)
    if joints is not None:
        rigid &= joints
    if not rigid.any():
        return
    m = len(system.connections)
    gap, mobility = np.zeros(m), np.zeros((m, m))
    parts = [
        (name, compiled, system.incidence(slot), np.flatnonzero(rigid[compiled.gaps]))
        for slot, (name, compiled) in enumerate(zip(system.names, system.compiled, strict=True))
    ]
    for name, compiled, incidence, joined in parts:
        if joined.size:
            on = compiled.gaps[joined]
            a = incidence[on]
            x = np.array(system.modes_of(state, name).T, dtype=np.float64)
            gap[on] += a @ (compiled.velocity.reshape(len(compiled.ports), -1) @ x.reshape(-1))
            mobility[on[:, None], on] += a @ compiled.mobility @ a.T
    kick = np.zeros(m)
    kick[rigid] = -scaled_pinv(mobility[np.ix_(rigid, rigid)]) @ gap[rigid]
    for name, compiled, incidence, joined in parts:
        if joined.size:
            on = compiled.gaps[joined]
            impulse = incidence[on].T @ kick[on]
            B = compiled.form.B[compiled.ports]
            system.modes_of(state, name)[:] += (impulse @ B.reshape(len(B), -1)).reshape(-1, 2).T
