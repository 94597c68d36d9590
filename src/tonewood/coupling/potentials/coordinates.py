"""Mass-normalised coordinates of a component's real modes, in which potentials are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.modal.modes import PAIR, ModalBasis
from tonewood.modal.propagator import apply, flow

Floats = NDArray[np.float64]

#: share of the kinetic energy that is taken or given at once, at most
PAID_AT_ONCE = 0.25


@dataclass(frozen=True, eq=False)
class ModalCoordinates:
    """Coordinates y (m sqrt(kg)) of the n_modes real modes of one component.

    Attributes
    ----------
    reading : (n_modes,) y = reading times the first number of the mode.
    kick : (n_modes, 2) state added by a unit modal force held over one step.
    velocity : (3, n_modes) y' per first and per second number, and second number per y'.
    stiffness : (n_modes,) omega^2, 1 / s^2.
    middle : (3, n_modes) displacement after half a step per displacement before the step, per that after it without
        port forces, and per displacement that port forces held over the step add to it.
    gain : (n_modes,) x / sin x, x = omega h / 2 up to pi / 2: a force held over the step, times this, moves a mode as
        an impulse in the middle of the step does.
    """

    reading: Floats
    kick: Floats
    velocity: Floats
    stiffness: Floats
    middle: Floats
    gain: Floats

    @classmethod
    def of(cls, basis: ModalBasis, dt: float, E: Floats, held: Floats) -> ModalCoordinates:
        """Make them of real modes.

        Parameters
        ----------
        dt : s, step.
        E, held : (n_modes, 2, 2) propagator of a step, and h phi_1(A h), the response to an input held over it.
        """
        pair = basis.kind == PAIR
        kick = np.where(pair[:, None], [[0.0, -0.5]] / np.where(pair, basis.poles.imag, 1.0)[:, None], [[0.0, 1.0]])
        _, on_first, on_second, *_, per_velocity = basis.motion
        velocity = np.stack([on_first, on_second, per_velocity])
        over_step, stiffness = apply(held, kick), np.asarray(basis.stiffness)
        half, half_held = flow(basis, 0.5 * dt)
        moved = 0.5 * dt * apply(half_held, kick)[:, 0]
        moves, reached = E[:, 0, 1] != 0.0, over_step[:, 0] != 0.0
        after = np.where(moves, half[:, 0, 1], 0.0) / np.where(moves, E[:, 0, 1], 1.0)
        by_ports = np.where(reached, moved, 0.0) / np.where(reached, over_step[:, 0], 1.0)
        x = np.minimum(0.5 * dt * np.sqrt(stiffness), 0.5 * np.pi)
        return cls(
            np.where(pair, 2.0, 1.0), over_step, velocity, stiffness,
            np.stack([half[:, 0, 0] - after * E[:, 0, 0], after, by_ports]), 1 / np.sinc(x / np.pi),
        )  # fmt: skip

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


def pay_from_motion(velocities: Sequence[Floats], states: Sequence[Floats], cost: float) -> float:
    """Scale velocities of modes so that their kinetic energy pays or receives an energy; displacements stay.

    No more than a quarter of the kinetic energy is taken or given at once.

    Parameters
    ----------
    velocities : (3, n) of each part: y' per first and per second number, and second number per y'.
    states : (n_modes >= n, 2) of each part; changed in place.
    cost : J.

    Returns
    -------
    float
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
