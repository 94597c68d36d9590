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


def share_velocities(system: System, state: State) -> None:
    """Give rigidly joined points equal velocities by impulses at the joints: a plastic impact.

    v+ = v - Y A^T (A Y A^T)^+ A v with Y the velocity under a unit impulse, the projection in the mass norm: kinetic
    energy can only fall. Without it a struck body or a stopped string leaves the joint's velocities apart, and the
    constraint force then alternates from sample to sample for ever.
    """
    rigid = np.array([isinstance(c.law, Rigid) for c in system.connections], dtype=bool)
    if not rigid.any():
        return
    m = len(system.connections)
    gap, mobility = np.zeros(m), np.zeros((m, m))
    impulses: list[Floats | None] = []
    for slot, (name, compiled) in enumerate(zip(system.names, system.compiled, strict=True)):
        if system.driven[slot]:
            impulses.append(None)
            continue
        a, x = system.incidence(slot), system.modes_of(state, name).T
        rows = compiled.form.rows("velocity", compiled.ports)
        B = compiled.form.B[compiled.ports]
        flat = rows.reshape(len(rows), -1)
        gap += a @ (flat @ x.reshape(-1))
        mobility += a @ (flat @ B.reshape(len(B), -1).T) @ a.T
        impulses.append(B)
    kick = np.zeros(m)
    kick[rigid] = -scaled_pinv(mobility[np.ix_(rigid, rigid)]) @ gap[rigid]
    for slot, (name, impulse) in enumerate(zip(system.names, impulses, strict=True)):
        if impulse is not None:
            system.modes_of(state, name)[:] += np.einsum("p,pmx->xm", system.incidence(slot).T @ kick, impulse)
