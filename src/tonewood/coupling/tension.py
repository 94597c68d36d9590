"""Tension that rises with amplitude: the Kirchhoff-Carrier string, in modal coordinates.

A string of mass-normalised coordinates y and shape weights a (omega^2 = T0 a + EI b) stretches by S = sum a y^2, the
integral of u_x^2, and stores V = EA/(8 L) S^2 besides. All its polarizations share the tension. Over a step

    T = EA/(4 L) (S+ + S),      force on coordinate k:  -T a_k (y_k+ + y_k) / 2,

the exact discrete gradient: its work is -[V(S+) - V(S)], so energy cannot rise whatever the step and the amplitude.
For given T the step is linear: with w the displacement over one step per modal force and alpha = w a T / 2,

    y+ = (y_u + w phi f - alpha y) / (1 + alpha),

and T is the root of T - EA/(4 L) (S+(T) + S), which only rises: the part is strongly monotone, so that one solution
exists together with all contacts. T is the mean over the step; its time is the middle of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.modal.modes import PAIR, ModalBasis
from tonewood.modal.propagator import apply

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
    correction : with c > 0 each weight is multiplied by x / sin x, x = min(omega h, c). The discrete gradient tunes
        partials by sin x / x of what the tension should; this undoes it for weak partials on strong low ones, at the
        price of a larger error of S in bright tones. A higher rate is the exact cure.
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
        return TensionShare(weights, np.where(pair, 2.0, 1.0), apply(held, kick), self.axial_stiffness / (4 * length))


@dataclass(frozen=True, eq=False)
class TensionShare:
    """One component's share of a tension.

    Attributes
    ----------
    weights : (n_modes,) a.
    reading : (n_modes,) y = reading times the first number of the mode.
    kick : (n_modes, 2) state added by a unit modal force held over one step.
    kappa : EA/(4 L), N/m.
    """

    weights: Floats
    reading: Floats
    kick: Floats
    kappa: float

    def stretch(self, x: Floats) -> float:
        """S of a state (n_modes, 2), m."""
        return float(self.weights @ (self.reading * x[:, 0]) ** 2)

    def step(self, x: Floats, free: Floats, W: Floats, tension: float) -> tuple[Floats, Floats]:
        """Motion without port forces, and response to them, while the tension is higher by `tension`.

        Parameters
        ----------
        x, free : (n_modes, 2) state before, and after a step without forces.
        W : (n_ports, n_modes, 2) state added by unit port forces.
        """
        half = 0.5 * self.weights * tension
        yields = 1.0 / (1.0 + self.reading * self.kick[:, 0] * half)
        y, y_free = self.reading * x[:, 0], self.reading * free[:, 0]
        of_motion = half * yields * (y_free + y)
        of_ports = half * yields * self.reading * W[..., 0]
        return free - self.kick * of_motion[:, None], W - self.kick * of_ports[..., None]

    def slope(self, x: Floats, after: Floats, tension: float) -> float:
        """dS+/dT at constant port forces, m/N."""
        w = self.reading * self.kick[:, 0]
        yields = 1.0 / (1.0 + 0.5 * w * self.weights * tension)
        y, y_after = self.reading * x[:, 0], self.reading * after[:, 0]
        return float(-np.sum(self.weights**2 * w * yields * y_after * (y + y_after)))
