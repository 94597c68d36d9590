"""Tension that rises with amplitude: the Kirchhoff-Carrier string, in modal coordinates.

A string of mass-normalised coordinates y and shape weights a (omega^2 = T0 a + EI b) stretches by S = sum a y^2, the
integral of u_x^2, and stores V = kappa S^2 / 2 besides, kappa = EA/(4 L). All its polarizations share the tension. With
psi = sqrt(kappa) S the potential is the square V = psi^2 / 2, and psi is stepped as a variable of its own
(`potentials.base`) along its gradient in the middle of the step,

    g = 2 sqrt(kappa) a y*,

y* as `ModalCoordinates.middle` has it. T = 2 sqrt(kappa) psi is the rise of the tension. Where it is so large that the
highest modes turn by more than a step allows, max alpha T > 1 with alpha = w a / 2, w the displacement over one step
per modal force, g is multiplied by 1 - k alpha / max alpha, k = 1 - 1 / (T max alpha).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.coupling.potentials.base import JoinedPotential, Kind, MiddleOfStep, Potential
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats


def stretch_weights(basis: ModalBasis) -> ArrayLike | None:
    """(n_modes,) a of a string's modes, 1 / (kg m), as its `metadata` have them; None if they do not."""
    return cast("ArrayLike | None", basis.metadata.get("stretch_part", basis.metadata.get("tension_part")))


@dataclass(frozen=True, eq=False)
class TensionModulation(Potential):
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
    label: ClassVar[str] = "tension"
    effect: ClassVar[str] = "tension_modulation"  # type: ignore[misc]  # of this kind always

    def __post_init__(self) -> None:
        if not (self.axial_stiffness >= 0.0 and 0.0 <= self.correction < np.pi):
            raise ValueError(f"{self.name}: EA must not be negative, nor the correction, which stays below pi")
        if not self.components or (self.length is not None and not self.length > 0.0):
            raise ValueError(f"{self.name}: a tension needs components and a length above 0")

    @property
    def transverse(self) -> tuple[str, ...]:
        """Its polarizations: all its components."""
        return self.components

    def share(self, component: str, basis: ModalBasis, dt: float) -> TensionShare:
        """Return the arrays of one component.

        Raises
        ------
        ValueError : the component has no weights, or does not tell its length.
        """
        declared = stretch_weights(basis) if self.weights is None else self.weights.get(component)
        if declared is None:
            raise ValueError(f"{self.name}: no weights for {component}")
        weights = np.array(declared, dtype=np.float64)
        if weights.shape != (basis.n_modes,) or weights.min(initial=0.0) < 0.0:
            raise ValueError(f"{self.name}: {component} needs {basis.n_modes} weights that are not negative")
        if self.correction > 0.0:
            x = np.minimum(np.sqrt(basis.stiffness) * dt, self.correction)
            weights /= np.sinc(x / np.pi)
        length = self.length if self.length is not None else cast(float, basis.metadata.get("length", 0.0))
        if not length > 0.0:
            raise ValueError(f"{self.name}: {component} does not tell its length")
        return TensionShare(weights, self.axial_stiffness / (4 * length))

    def join(self, shares: Sequence[TensionShare]) -> JoinedTension:
        """Return the string of all its polarizations."""
        return JoinedTension(tuple(shares))


@dataclass(frozen=True, eq=False)
class TensionShare:
    """One component's share of a tension.

    weights : (n_modes,) a.
    kappa : EA/(4 L), N/m.
    """

    weights: Floats
    kappa: float


@dataclass(frozen=True, eq=False)
class JoinedTension(JoinedPotential):
    """A string under rising tension as it is stepped."""

    shares: tuple[TensionShare, ...]

    @cached_property
    def sizes(self) -> tuple[int, ...]:  # type: ignore[override]  # found when first wanted
        """All modes of each component."""
        return tuple(len(share.weights) for share in self.shares)

    @cached_property
    def weights(self) -> Floats:
        """(n,) a of all coordinates."""
        return np.concatenate([share.weights for share in self.shares])

    @cached_property
    def root(self) -> float:
        """sqrt(kappa)."""
        return float(np.sqrt(self.shares[0].kappa))

    def psi(self, y: Floats) -> float:
        """sqrt(kappa) S, sqrt(J)."""
        return self.root * float(self.weights @ (y * y))

    def energy(self, y: Floats) -> float:
        """See `JoinedPotential`."""
        return 0.5 * self.psi(y) ** 2

    def direction(self, step: MiddleOfStep) -> Floats:
        """See `JoinedPotential`."""
        g, alpha = 2 * self.root * self.weights * step.middle, 0.5 * step.compliance * self.weights
        highest, tension = float(alpha.max(initial=0.0)), 2 * self.root * max(step.psi, 0.0)
        if tension * highest > 1.0:
            g *= 1 - (1 - 1 / (tension * highest)) * alpha / highest
        return np.asarray(g)

    def describe(self) -> dict[str, Any]:
        """See `JoinedPotential`; the weights are described with the components."""
        return {"kind": Kind.TENSION, "scale": self.shares[0].kappa}
