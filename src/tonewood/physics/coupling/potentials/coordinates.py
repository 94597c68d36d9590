"""Mass-normalised coordinates of a component's real modes, in which potentials are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.propagator import apply
from tonewood.support.arrays import Floats

#: share of the kinetic energy that is taken or given at once, at most
PAID_AT_ONCE = 0.25


@dataclass(frozen=True, eq=False)
class ModalCoordinates:
    """Coordinates y (m sqrt(kg)) of the n_modes real modes of one component.

    reading : (n_modes,) y = reading times the first number of the mode.
    kick : (n_modes, 2) state added by a unit modal force held over one step.
    velocity : (3, n_modes) y' per first and per second number, and second number per y'.
    stiffness : (n_modes,) omega^2, 1 / s^2.
    middle : (2, n_modes) weights of the middle of a step, `middle_of_step`.
    """

    reading: Floats
    kick: Floats
    velocity: Floats
    stiffness: Floats
    middle: Floats

    @classmethod
    def of(cls, basis: ModalBasis, dt: float, response: Floats) -> ModalCoordinates:
        """Make them of real modes.

        dt : s, step.
        response : (n_modes, 2, 2) h phi_1(A h), the response to an input held over it.
        """
        pair = basis.kind == PAIR
        kick = np.where(pair[:, None], [[0.0, -0.5]] / np.where(pair, basis.poles.imag, 1.0)[:, None], [[0.0, 1.0]])
        _, on_first, on_second, *_, per_velocity = basis.motion
        velocity = np.stack([on_first, on_second, per_velocity])
        over_step, stiffness = apply(response, kick), np.asarray(basis.stiffness)
        u = np.minimum(0.5 * dt * np.sqrt(stiffness), 0.5 * np.pi - 1e-6)
        return cls(np.where(pair, 2.0, 1.0), over_step, velocity, stiffness, middle_of_step(u))

    @cached_property
    def compliance(self) -> Floats:
        """(n_modes,) displacement over a step per modal force held over it, s^2."""
        return np.asarray(self.reading * self.kick[:, 0])

    def of_state(self, x: Floats, n: int) -> Floats:
        """(..., n) coordinates of the lowest n modes in states (..., n_modes, 2)."""
        return np.asarray(self.reading[:n] * x[..., :n, 0])

    def energy(self, x: Floats, n: int) -> float:
        """Energy of the lowest n modes in a state (n_modes, 2), J."""
        moving = (self.velocity[:2] * x.T).sum(axis=0)[:n]
        return float(0.5 * (moving @ moving + self.stiffness[:n] @ self.of_state(x, n) ** 2))


def middle_of_step(u: Floats) -> Floats:
    """(2, n) weights of the middle of a step for modes that turn by 2 u over it, u below pi / 2.

    With y* = K / (2 cos u) (y + y_f) + (1 - K cos u) / (2 sin^2 u) d the gradient of a potential, held over the step,
    moves a mode by K sin u / u of what it should, whether y moves by itself or is pushed: y_f is its end by itself, d
    what forces held over the step add to that. K = 1 would be half the step, K = cos u the mean of its ends. Here

        K = cos^5 u (1 + 8/3 s + 73/15 s^2 + 2528/336 s^3),      s = sin^2 u,

    which is u / sin u up to u^6, and falls to 0 at u = pi / 2: the highest modes are stable under a tension of up to
    1.7 times that at rest. A gain on the force would do the same for a mode alone; but where forces balance at a point,
    as those of a string and its bridge, it would leave a kink there, an error of first order.
    """
    c, s = np.cos(u), np.sin(u) ** 2
    K = c**5 * (1 + s * (8 / 3 + s * (73 / 15 + s * 2528 / 336)))
    by_force = np.where(u > 1e-4, (1 - K * c) / np.maximum(2 * s, 1e-300), 1 / 6)
    return np.stack([K / (2 * c), by_force])


def pay_from_motion(velocities: Sequence[Floats], states: Sequence[Floats], cost: float) -> float:
    """Scale velocities of modes so that their kinetic energy pays or receives an energy; displacements stay.

    No more than a quarter of the kinetic energy is taken or given at once.

    velocities : (3, n) of each part: y' per first and per second number, and second number per y'.
    states : (n_modes >= n, 2) of each part; changed in place.
    cost : J.
    Returns float
        Energy that was paid, J.
    """
    moving = [
        v[0] * x[: v.shape[1], 0] + v[1] * x[: v.shape[1], 1] for v, x in zip(velocities, states, strict=True)
    ]  # fmt: skip
    kinetic = 0.5 * sum(float(v @ v) for v in moving)
    paid = min(max(cost, -PAID_AT_ONCE * kinetic), PAID_AT_ONCE * kinetic)
    if not (kinetic > 0.0 and paid != 0.0):
        return 0.0
    factor = np.sqrt(1 - paid / kinetic) - 1
    for per, x, v in zip(velocities, states, moving, strict=True):
        x[: per.shape[1], 1] += factor * per[2] * v
    return paid
