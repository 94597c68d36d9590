"""A stiff string whose tension rises as it stretches: `stiff_string` with Kirchhoff and Carrier's tension.

    T = T0 + EA/(2 L) int_0^L u_x^2 dx,    both polarizations together,

so that a hard pluck begins sharp and glides down, and its plane of motion turns. Over a step the tension is the exact
discrete gradient of EA/(8 L) S^2 (`tonewood.numerics.tension`): energy cannot rise. Valid while longitudinal waves
are quick against the partials of interest: the tension is one number for the whole speaking length. The part of the
string behind a stop or the nut, which would share the stretch, is left out.
"""

from __future__ import annotations

from tonewood.params import quantity
from tonewood.plugins.stiff_string import StiffString, StiffStringParameters


class TensionModulatedParameters(StiffStringParameters):
    """Of the open string."""

    axial_stiffness: float = quantity("N", low=0.0, high=1e7, doc="E A; 0 leaves the tension as it is")


class TensionModulatedString(StiffString):
    """The string; see the module."""

    api = 1
    Parameters = TensionModulatedParameters
    parameters: TensionModulatedParameters

    @property
    def axial_stiffness(self) -> float:
        """E A, N."""
        return self.parameters.axial_stiffness
