"""A stiff string in one polarization: held at the nut or a stop, moved by a body at the bridge.

    mu u_tt + loss = T u_xx - EI u_xxxx + f(x, t),    no moment at either end

Modes and their derivation: `tonewood.physics.modal.string_modes`; loss laws: `tonewood.plugins.loss_laws`.
Valid for small slopes (no change of tension with amplitude) and for wavelengths long against the diameter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]


class StiffStringParameters(Parameters):
    """Parameters of the open string."""

    length: float = ta.quantity("m", low=0.02, high=5.0, doc="speaking length of the open string, nut to bridge")
    tension: float = ta.quantity(
        "N", low=1.0, high=2000.0, usual=(10.0, 1500.0), doc="tension of the open string; the tuner adjusts it"
    )
    linear_density: float = ta.quantity("kg/m", low=1e-5, high=0.3, doc="mass per length")
    bending_stiffness: float = ta.quantity("N m^2", low=0.0, high=1.0, default=0.0, doc="E I; 0 is an ideal string")
    loss: ta.LossLaw = ta.described("loss law and its numbers")


class StiffString(ta.Resonator[StiffStringParameters]):
    """The string; see the module."""

    api = 1
    Parameters = StiffStringParameters

    @property
    def length(self) -> float:
        """Speaking length of the open string, m."""
        return self.parameters.length

    @property
    def tension(self) -> float:
        """Tension of the open string before tuning, N."""
        return self.parameters.tension

    @property
    def linear_density(self) -> float:
        """Mass per length, kg/m."""
        return self.parameters.linear_density

    @property
    def bending_stiffness(self) -> float:
        """E I, N m^2."""
        return self.parameters.bending_stiffness

    def loss(self, omega: Floats, k: Floats, tension: float) -> Floats:
        """Loss factor by the law that the bundle names."""
        p = self.parameters
        return p.loss.eta(omega, k, ta.StringData(tension, p.linear_density, p.bending_stiffness))
