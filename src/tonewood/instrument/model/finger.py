"""A soft finger as the stop of a string: the whole string stays, and a fingertip holds it at one point.

Between string and ground stand the skin, a spring k_s and a dashpot r_s, and behind it the fingertip, a mass m that
the hand presses on the board, a spring m w^2 and a dashpot 2 d m w. Seen from the string its compliance is

    C(s) = 1 / (k_s + r_s s) + 1 / (m s^2 + 2 d w m s + m w^2),

by which a string of tension T speaks as if it were T C longer: the finger is laid so much nearer to the bridge. The
part behind the finger goes on moving, and the finger damps both. The finger's spring is unloaded where the string is
pressed down: when the finger comes, the static shape under forces at finger and bridge takes the displacement away that
it meets, the projection in the energy norm that leaves the bridge where it is, so that energy can only fall. When the
finger slides, the same shape carries the deflection u to the new place, so that the skin's energy stays and the
string's changes by (u^2 - u_new^2) / 2 C_x, C_x the string's own compliance there: work of the hand, no more than that
of the deflection. Without this the force of the spring would jump from step to step, which is audible.
"""

from __future__ import annotations

import math

import numpy as np

from tonewood.instrument.bundle.schema import Finger
from tonewood.instrument.contract.attached import Attached, Site, loose_mass
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

#: point of the string under the finger
POINT = "finger"


def fingertips(finger: Finger, site: Site, *, stopped: bool) -> Attached:
    """One fingertip per polarization; on a string that is not stopped its skin has no effect."""
    components, connections = {}, []
    law = SpringDashpot(finger.skin_stiffness, finger.skin_damping) if stopped else SpringDashpot()
    omega = 2 * math.pi * finger.freq
    for i, (component, _) in enumerate(site.polarizations, 1):
        tip = f"{site.string}.fingertip{i}"  # no part can have this name, as an exciter may be called finger
        components[tip] = loose_mass(finger.mass, omega, finger.damping_ratio * omega)
        terms = (Term(component, POINT), Term(tip, "mass", -1.0))
        connections.append(Connection(f"{site.string}.{POINT}.skin{i}", terms, law))
    return Attached(components=components, connections=tuple(connections))


def compliance(finger: Finger, freq: float) -> complex:
    """C at a frequency (Hz), m/N."""
    s, omega = 2j * math.pi * freq, 2 * math.pi * finger.freq
    tip = finger.mass * (s * s + 2 * finger.damping_ratio * omega * s + omega * omega)
    return 1 / (finger.skin_stiffness + finger.skin_damping * s) + 1 / tip


def laid_down(old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
    """Matrices that carry modal displacement and velocity when the finger moves, comes or leaves.

    old, new : the same modes, with the point ``finger``, which does not move where the string is open.
    """
    here, before = new.right[new.index(POINT)].real, old.right[old.index(POINT)].real
    same = np.eye(new.n_modes, old.n_modes)
    if not here.any():
        return same, same
    rows = np.stack([here, new.right[new.index("bridge")].real])
    softened = rows / new.stiffness
    correction = np.linalg.solve(rows @ softened.T, np.stack([here - before, np.zeros(new.n_modes)]))
    return same - softened.T @ correction @ same, same
