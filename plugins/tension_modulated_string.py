"""A stiff string whose tension rises as it stretches: `stiff_string` with Kirchhoff and Carrier's tension.

    T = T0 + EA/(2 L) int_0^L u_x^2 dx,    both polarizations together,

so that a hard pluck begins sharp and glides down, and its plane of motion turns. The root of the potential EA/(8 L) S^2
is stepped as a variable of its own (`tonewood.physics.coupling.potentials.tension`): energy cannot rise. Valid while
longitudinal waves are quick against the partials of interest: the tension is one number for the whole speaking length.
The part of the string behind a stop or the nut, which would share the stretch, is left out.

S = int u_x^2 is a sum of squares of modal coordinates, sum a y^2, but for a coupling that bending stiffness makes. The
weights a are scaled so that S of the string's fundamental between fixed ends is exact; unscaled it would be too small
by some 1.5 sqrt(EI/T) / L, 0.8 % for a plain steel string of .7 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from tonewood.plugins.stiff_string import StiffString, StiffStringParameters

import tonewood.authoring as ta


class TensionModulatedParameters(StiffStringParameters):
    """Parameters of the open string."""

    axial_stiffness: float = ta.quantity("N", low=0.0, high=1e7, doc="E A; 0 leaves the tension as it is")


class TensionModulatedString(StiffString):
    """The string; see the module."""

    api = 1
    effects = (*StiffString.effects, ta.TENSION_MODULATION)
    Parameters = TensionModulatedParameters
    parameters: TensionModulatedParameters

    def potentials(self, string: ta.StringMotion) -> Sequence[ta.Potential]:
        """The rising tension."""
        stiffness = self.parameters.axial_stiffness
        return [ta.TensionModulation(string.name, string.planes, stiffness)] if stiffness > 0.0 else []

    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ta.ModalBasis:
        """As `StiffString.basis`, with the weights of the stretch, ``stretch_part``, in its metadata."""
        basis = super().basis(freq_upper, stop=stop, tension=tension)
        metadata = basis.metadata
        vec, weights = (cast(NDArray[np.float64], metadata[key]) for key in ("vec", "tension_part"))
        if len(vec) < 2:
            return basis
        length, density = cast(float, metadata["length"]), cast(float, metadata["linear_density"])
        # modal coordinates of sin(pi x / L): y = vec^T M e_1, with the mass matrix of `string_modes`
        y = density * length * (vec[0] / np.pi + vec[1] / 2)
        scale = np.pi**2 / (2 * length) / float(weights @ y**2)
        return replace(basis, metadata={**metadata, "stretch_part": scale * weights})
