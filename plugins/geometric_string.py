"""A string with longitudinal motion too: `tension_modulated_string` with longitudinal waves and phantom partials.

    strain e = u_x + (v_x^2 + w_x^2) / 2,   potential EA/2 int_0^L e^2 dx beside the tension at rest,

the exact string to fourth order in its motion; `tonewood.physics.coupling.potentials.longitudinal` has equations,
energy, and terms left out. The square of the slope has partials at sums and differences of the transverse frequencies,
f_m + f_n; it drives the longitudinal modes, n / (2 L) sqrt(EA / mu), and the bridge hears them: Conklin's phantom
partials, strong near a longitudinal mode (Bank & Sujbert 2005). The string's end moves along the string by the
projection of the body's motion on the inclined string, and by `bridge_leverage` times the body's motion (break angle
and rocking of the saddle); the longitudinal force acts on the body with the same factors.

Longitudinal modes are those below 0.45 of the sampling rate; higher ones follow quasi-statically and add nothing.
Transverse modes up to `freq_coupled` take part in the coupling, the others move as on `stiff_string`: their share of
the squared slope is small, and cost goes with the square of their number. Valid for slopes up to some 0.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np
from pydantic import model_validator
from tonewood.plugins.tension_modulated_string import TensionModulatedParameters, TensionModulatedString

import tonewood.authoring as ta


class GeometricParameters(TensionModulatedParameters):
    """Parameters of the open string."""

    axial_stiffness: float = ta.quantity("N", low=1.0, high=1e7, doc="E A")
    freq_coupled: float = ta.quantity(
        "Hz", low=20.0, high=1e5, default=4000.0, doc="transverse modes below it drive the longitudinal ones"
    )
    longitudinal_loss: float = ta.quantity(
        "1", low=0.0, high=1.0, default=2e-3, doc="loss factor of longitudinal modes, 2 sigma / omega"
    )
    bridge_leverage: float = ta.quantity(
        "1", low=-2.0, high=2.0, default=0.1, doc="motion of the string's end along it per motion of the body's point"
    )

    @model_validator(mode="after")
    def _stretches_little(self) -> Self:
        if self.axial_stiffness < self.tension:
            raise ValueError(
                f"axial_stiffness: {self.axial_stiffness:g} N under a tension of {self.tension:g} N stretch the string "
                "to more than twice its length; at least the tension is allowed"
            )
        return self


class GeometricString(TensionModulatedString):
    """The string; see the module."""

    api = 1
    effects = (*TensionModulatedString.effects, ta.LONGITUDINAL)
    Parameters = GeometricParameters
    parameters: GeometricParameters

    @property
    def longitudinal(self) -> ta.Longitudinal:
        """Motion along the string."""
        return ta.Longitudinal(self._longitudinal, self.parameters.bridge_leverage)

    def potentials(self, string: ta.StringMotion) -> Sequence[ta.Potential]:
        """The coupling to the longitudinal motion; where that is left out, the rising tension alone."""
        if string.longitudinal is None:
            return super().potentials(string)
        p = self.parameters
        return [ta.GeometricStretch(string.name, string.planes, string.longitudinal, p.axial_stiffness, p.freq_coupled)]

    def _longitudinal(self, freq_upper: float, stop: float) -> ta.ModalBasis:
        p = self.parameters

        def loss(freq_rad: np.ndarray, wavenumber: np.ndarray) -> np.ndarray:
            return np.full_like(freq_rad, p.longitudinal_loss)

        try:
            return ta.string_basis(
                p.length - stop, p.axial_stiffness, p.linear_density, 0.0, loss, freq_upper=freq_upper
            )
        except ValueError:
            raise self.fault(
                f"has no longitudinal mode below {freq_upper:g} Hz where it is {p.length - stop:g} m long: use "
                "tension_modulated_string, or more samples per second",
                "axial_stiffness",
            ) from None
