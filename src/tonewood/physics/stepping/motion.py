"""Between a mode's two numbers and its motion (q, q'), and the velocities that joined parts must share.

Displacement and velocity carry over when a string is stopped, bent or damped; z itself does not, because its meaning
depends on the pole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import State, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats


def to_motion(basis: ModalBasis, modes: Floats) -> tuple[Floats, Floats]:
    """Coordinates q (m sqrt(kg)) and q' of real modes, y = sum phi q, from their numbers (2, n_modes)."""
    x, y = modes
    a, b, c, *_ = basis.motion
    return a * x, b * x + c * y


def from_motion(basis: ModalBasis, q: Floats, velocity: Floats) -> Floats:
    """Return the numbers (2, n_modes) of real modes with coordinates q and q'."""
    *_, d, e, f = basis.motion
    return np.stack([d * q, e * q + f * velocity])


def share_velocities(system: System, state: State, joints: NDArray[np.bool_] | None = None) -> None:
    """Give rigidly joined points equal velocities by impulses at the joints: a plastic impact.

    v+ = v - Y A^T (A Y A^T)^+ A v with Y the velocity under a unit impulse, the projection in the mass norm: kinetic
    energy can only fall. Without it a struck body or a stopped string leaves the joint's velocities apart, and the
    constraint force then alternates from sample to sample for ever.

    joints : (m,) connections to look at, all where left out; only rigid ones take part. Drives with `impulses` pass
        the impulses of theirs on.
    """
    rigid = system.elimination.linear.rigid
    if joints is not None:
        rigid = rigid & joints
    if not rigid.any():
        return
    on = np.flatnonzero(rigid)
    gap = np.zeros(len(rigid))
    parts = [
        (name, compiled) for name, compiled in zip(system.names, system.compiled, strict=True) if compiled.gaps.size
    ]
    for name, compiled in parts:
        gap[compiled.gaps] += compiled.gap_velocity @ system.modes_of(state, name).reshape(-1)
    mobility = system.layout.gathered([c.gap_mobility for c in system.compiled])
    kick = np.zeros(len(rigid))
    kick[on] = -scaled_pinv(mobility[on[:, None], on]) @ gap[on]
    for name, compiled in parts:
        impulse = kick[compiled.gaps]
        if impulse.any():
            system.modes_of(state, name)[:] += (impulse @ compiled.gap_scatter).reshape(2, -1)
    for drive in system.drives:
        if drive.impulses and (impulse := kick[system.layout.places[drive.connection]]):
            compiled = system.compiled[system.slot(drive.component)]
            gained = drive.factor * impulse * compiled.form.B[compiled.basis.index(drive.point)]
            system.modes_of(state, drive.component)[:] += gained.T
