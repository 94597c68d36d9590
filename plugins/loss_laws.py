"""Loss laws of strings: loss factor eta(omega, k) of a partial between fixed ends, sigma = omega eta / 2.

Measurements of strings give this loss factor; `tonewood.physics.modal.string_modes` finds the loss of the modes with
which the partials on a rigid bridge decay by the law.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]


class WoodhouseParameters(Parameters):
    """Loss factors of a polymer string."""

    eta_f: float = ta.quantity("1", low=0.0, high=1.0, doc="loss of stretching, the same at every frequency")
    eta_b: float = ta.quantity("1", low=0.0, high=1.0, doc="loss of bending")
    eta_a: float = ta.quantity("1/s", low=0.0, high=1e3, doc="loss to the air")


class Woodhouse(ta.Loss[WoodhouseParameters]):
    """Friction, air and bending losses of a polymer string.

        eta = [T (eta_f + eta_a / omega) + EI eta_b k^2] / [T + EI k^2]

    Woodhouse (2004), Acta Acustica 90, 945, Eq. 8 (k = n pi / L there).
    """

    api = 1
    Parameters = WoodhouseParameters

    def eta(self, omega: Floats, k: Floats, string: ta.StringData) -> Floats:
        """As `Loss.eta`."""
        p, bending = self.parameters, string.bending_stiffness * k**2
        lost = string.tension * (p.eta_f + p.eta_a / omega) + bending * p.eta_b
        return np.asarray(lost / (string.tension + bending))


class SigmaParameters(Parameters):
    """Damping rates."""

    sigma0: float = ta.quantity("1/s", low=0.0, high=1e4, doc="damping rate at low frequency")
    sigma1: float = ta.quantity("m^2/s", low=0.0, high=1.0, default=0.0, doc="growth of the damping rate with k^2")


class Sigma(ta.Loss[SigmaParameters]):
    """Damping rates that grow with the square of the wavenumber.

        sigma = sigma0 + sigma1 k^2:    u_tt = ... - 2 sigma0 u_t + 2 sigma1 u_txx

    Bensa, Bilbao, Kronland-Martinet & Smith (2003), J. Acoust. Soc. Am. 114, 1095, Eq. 6.
    """

    api = 1
    Parameters = SigmaParameters

    def eta(self, omega: Floats, k: Floats, string: ta.StringData) -> Floats:
        """As `Loss.eta`."""
        return np.asarray(2 * (self.parameters.sigma0 + self.parameters.sigma1 * k**2) / omega)


class ValetteParameters(Parameters):
    """Losses of a metal string in air."""

    diameter: float = ta.quantity("m", low=1e-5, high=0.05, doc="of the string, as the air meets it")
    delta_ve: float = ta.quantity("1", low=0.0, high=1.0, doc="visco-elastic loss angle of bending")
    inverse_q_te: float = ta.quantity("1", low=0.0, high=1.0, default=0.0, doc="thermo-elastic and dislocation loss")
    air_viscosity: float = ta.quantity("kg/(m s)", low=0.0, high=1e-3, default=1.8e-5, doc="dynamic viscosity of air")
    air_density: float = ta.quantity("kg/m^3", low=0.0, high=10.0, default=1.2, doc="density of air")


class Valette(ta.Loss[ValetteParameters]):
    """Air, visco-elastic and thermo-elastic losses of a metal string.

        eta = R / (2 pi mu nu) + delta_ve EI k^2 / T + inverse_q_te,   nu = omega / 2 pi,
        R = 2 pi eta_air + 2 pi d sqrt(pi eta_air rho_air nu)

    Valette & Cuesta, *Mécanique de la corde vibrante* (1993); in this form Issanchou, Bilbao, Le Carrou, Touzé &
    Doaré (2017), J. Sound Vib. 393, 219.
    """

    api = 1
    Parameters = ValetteParameters

    def eta(self, omega: Floats, k: Floats, string: ta.StringData) -> Floats:
        """As `Loss.eta`."""
        p, nu = self.parameters, omega / (2 * np.pi)
        drag = 2 * np.pi * (p.air_viscosity + p.diameter * np.sqrt(np.pi * p.air_viscosity * p.air_density * nu))
        bending = p.delta_ve * string.bending_stiffness * k**2 / string.tension
        return np.asarray(drag / (omega * string.linear_density) + bending + p.inverse_q_te)
