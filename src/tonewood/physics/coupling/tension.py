"""Tension that rises with amplitude: the Kirchhoff-Carrier string, in modal coordinates.

A string of mass-normalised coordinates y and shape weights a (omega^2 = T0 a + EI b) stretches by S = sum a y^2, the
integral of u_x^2, and stores V = kappa S^2 / 2 besides, kappa = EA/(4 L). All its polarizations share the tension. With
psi = sqrt(kappa) S the potential is the square V = psi^2 / 2, and psi is stepped as a variable of its own, as in the
scalar auxiliary variable methods (Shen, Xu, Yang, J. Comput. Phys. 353 (2018) 407; for mechanical systems Bilbao,
Ducceschi, Zama, J. Comput. Phys. 472 (2023) 111697): over a step

    psi+ - psi = g . (y+ - y),      modal forces  -g psi_m,      psi_m = (psi+ + psi) / 2,

whose work is -[V+ - V] for any direction g that is known beforehand. So energy cannot rise whatever the step and the
amplitude, and the step is linear: the tension is one more connection of the string, along g. Here

    g = 2 sqrt(kappa) a (y_f + y) / 2 (1 - alpha),      alpha = w a T / 2,

y_f the coordinates after the step under all forces but the tension's and those of nonlinear connections, w the
displacement over one step per modal force: the gradient of psi in the middle of the step, the motion by the tension
itself included to first order by its value T extrapolated from the last three steps. T = 2 sqrt(kappa) psi_m is the
mean over the step; its time is the middle of it.

psi and sqrt(kappa) S part by the error of the steps. Every 64 samples psi is put back and the kinetic energy of the
string pays for it (`reset_psi`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.propagator import apply

Floats = NDArray[np.float64]


def stretch_weights(basis: ModalBasis) -> ArrayLike | None:
    """(n_modes,) a of a string's modes, 1 / (kg m), as its `metadata` have them; None if they do not."""
    return cast("ArrayLike | None", basis.metadata.get("stretch_part", basis.metadata.get("tension_part")))


@dataclass(frozen=True, eq=False)
class TensionModulation:
    """The common tension of one string's polarizations.

    The diagonal form S = sum a y^2 is exact for a string without bending stiffness and good to 1e-3 of the mean S
    otherwise; V made of it is an exact potential of its own, and the linear part stays exact.

    Attributes
    ----------
    name : of the string.
    components : its polarizations: components of real modes.
    axial_stiffness : EA, N.
    length : L, m; None takes ``length`` of the first component's `metadata` (the speaking length).
    weights : component -> (n_modes,) a, 1 / (kg m); None takes ``stretch_part`` of the components' `metadata`, or
        else ``tension_part``, and follows them when a basis is exchanged.
    correction : with c > 0 each weight is multiplied by x / sin x, x = min(omega h, c). The average over the
        step raises partials by sin x / x of the rise that the tension asks for; this undoes it for weak partials on
        strong low ones, at the price of a larger error of S in bright tones. A higher rate is the exact cure.
    """

    name: str
    components: tuple[str, ...]
    axial_stiffness: float
    length: float | None = None
    weights: Mapping[str, ArrayLike] | None = None
    correction: float = 0.0

    def __post_init__(self) -> None:
        if not (self.axial_stiffness >= 0.0 and 0.0 <= self.correction < np.pi):
            raise ValueError(f"{self.name}: EA must not be negative, nor the correction, which stays below pi")
        if not self.components or (self.length is not None and not self.length > 0.0):
            raise ValueError(f"{self.name}: a tension needs components and a length above 0")

    def part(self, component: str, basis: ModalBasis, dt: float, held: Floats) -> TensionShare:
        """Arrays of one component.

        Parameters
        ----------
        held : (n_modes, 2, 2) h phi_1(A h), the response to an input held over a step.

        Raises
        ------
        ValueError : the component's modes are not real, or it has no weights.
        """
        if not basis.is_real:
            raise ValueError(f"{self.name}: the modes of {component} must be real")
        known = stretch_weights(basis) if self.weights is None else self.weights.get(component)
        if known is None:
            raise ValueError(f"{self.name}: no weights for {component}")
        weights = np.array(known, dtype=np.float64)
        if weights.shape != (basis.n_modes,) or weights.min(initial=0.0) < 0.0:
            raise ValueError(f"{self.name}: {component} needs {basis.n_modes} weights that are not negative")
        if self.correction > 0.0:
            x = np.minimum(np.sqrt(basis.stiffness) * dt, self.correction)
            weights /= np.sinc(x / np.pi)
        pair = basis.kind == PAIR
        kick = np.where(pair[:, None], [[0.0, -0.5]] / np.where(pair, basis.poles.imag, 1.0)[:, None], [[0.0, 1.0]])
        length = self.length if self.length is not None else cast(float, basis.metadata.get("length", 0.0))
        if not length > 0.0:
            raise ValueError(f"{self.name}: {component} does not tell its length")
        reading = np.where(pair, 2.0, 1.0)
        _, on_first, on_second, *_, per_velocity = basis.motion
        return TensionShare(
            weights, reading, apply(held, kick), np.stack([on_first, on_second, per_velocity]),
            self.axial_stiffness / (4 * length),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class TensionShare:
    """One component's share of a tension.

    Attributes
    ----------
    weights : (n_modes,) a.
    reading : (n_modes,) y = reading times the first number of the mode.
    kick : (n_modes, 2) state added by a unit modal force held over one step.
    velocity : (3, n_modes) y' per first and per second number, and second number per y'.
    kappa : EA/(4 L), N/m.
    """

    weights: Floats
    reading: Floats
    kick: Floats
    velocity: Floats
    kappa: float

    @cached_property
    def half(self) -> Floats:
        """(n_modes,) alpha per newton of tension."""
        return np.asarray(0.5 * self.reading * self.kick[:, 0] * self.weights)

    def stretch(self, x: Floats) -> float:
        """S of a state (n_modes, 2), m."""
        return float(self.weights @ (self.reading * x[:, 0]) ** 2)

    def direction(self, x: Floats, free: Floats, tension: float) -> Floats:
        """(n_modes,) g over a step from x to `free` under all forces but the tension's, which is about `tension`."""
        alpha = self.half * tension
        middle = 0.5 * self.reading * (free[:, 0] + x[:, 0])
        return np.asarray(2 * np.sqrt(self.kappa) * self.weights * middle * (1 - alpha))


def pay_from_motion(velocities: Sequence[Floats], states: Sequence[Floats], cost: float) -> float:
    """Scale a string's velocities so that its kinetic energy pays or receives an energy; displacements stay.

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
    paid = min(max(cost, -0.25 * kinetic), 0.25 * kinetic)
    if not (kinetic > 0.0 and paid != 0.0):
        return 0.0
    factor = np.sqrt(1 - paid / kinetic) - 1
    for per, x, v in zip(velocities, states, moving, strict=True):
        x[: per.shape[1], 1] += factor * per[2] * v
    return paid


def reset_psi(parts: Sequence[TensionShare], states: Sequence[Floats], excess: float) -> float:
    """Put a string's psi back to sqrt(kappa) S, its kinetic energy paying or receiving the difference of potential.

    Parameters
    ----------
    states : (n_modes, 2) of each part; changed in place.
    excess : psi - sqrt(kappa) S, sqrt(J).

    Returns
    -------
    float
        The excess that is left, sqrt(J).
    """
    root = np.sqrt(parts[0].kappa) * sum(part.stretch(x) for part, x in zip(parts, states, strict=True))
    before = root + excess
    cost = 0.5 * (root - before) * (root + before)
    paid = pay_from_motion([part.velocity for part in parts], states, cost)
    if paid == cost:
        return 0.0
    return float(np.sqrt(before * before + 2 * paid) - root) if paid else excess
