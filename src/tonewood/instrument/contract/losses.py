"""Loss laws of strings: loss factor eta(omega, k) of a partial between fixed ends, sigma = omega eta / 2.

Measurements of strings give this loss factor; `tonewood.physics.modal.string_modes` finds the loss of the modes with
which the partials on a rigid bridge decay by the law. The law is chosen by its key ``law`` in a bundle: ``woodhouse``,
``sigma`` or ``valette``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tonewood.support.params import Parameters, described, quantity

Floats = NDArray[np.float64]


class StringLoss(Parameters, ABC):
    """A loss law: its parameters, and the loss factor."""

    @abstractmethod
    def eta(
        self, freq_rad: Floats, wavenumber: Floats, *, tension: float, linear_density: float, bending_stiffness: float
    ) -> Floats:
        """Loss factor 1/Q of partials between fixed ends, 1; not below 0.

        Parameters
        ----------
        freq_rad : (n,) rad/s, above 0, without loss.
        wavenumber : (n,) 1/m.
        tension, linear_density, bending_stiffness : N, kg/m, N m^2.
        """


class Woodhouse(StringLoss):
    """Friction, air and bending losses of a polymer string.

        eta = [T (eta_f + eta_a / omega) + EI eta_b k^2] / [T + EI k^2]

    Woodhouse (2004), Acta Acustica 90, 945, Eq. 8 (k = n pi / L there).
    """

    law: Literal["woodhouse"] = described("chooses this law")
    eta_f: float = quantity("1", low=0.0, high=1.0, doc="loss of stretching, the same at every frequency")
    eta_b: float = quantity("1", low=0.0, high=1.0, doc="loss of bending")
    eta_a: float = quantity("1/s", low=0.0, high=1e3, doc="loss to the air")

    def eta(
        self, freq_rad: Floats, wavenumber: Floats, *, tension: float, linear_density: float, bending_stiffness: float
    ) -> Floats:
        """As `StringLoss.eta`."""
        bending = bending_stiffness * wavenumber**2
        lost = tension * (self.eta_f + self.eta_a / freq_rad) + bending * self.eta_b
        return np.asarray(lost / (tension + bending))


class Sigma(StringLoss):
    """sigma = sigma0 + sigma1 k^2: u_tt = ... - 2 sigma0 u_t + 2 sigma1 u_txx.

    Bensa, Bilbao, Kronland-Martinet & Smith (2003), J. Acoust. Soc. Am. 114, 1095, Eq. 6.
    """

    law: Literal["sigma"] = described("chooses this law")
    sigma0: float = quantity("1/s", low=0.0, high=1e4, doc="damping rate at low frequency")
    sigma1: float = quantity("m^2/s", low=0.0, high=1.0, default=0.0, doc="growth of the damping rate with k^2")

    def eta(
        self, freq_rad: Floats, wavenumber: Floats, *, tension: float, linear_density: float, bending_stiffness: float
    ) -> Floats:
        """As `StringLoss.eta`."""
        return np.asarray(2 * (self.sigma0 + self.sigma1 * wavenumber**2) / freq_rad)


class Valette(StringLoss):
    """Air, visco-elastic and thermo-elastic losses of a metal string.

        eta = R / (2 pi mu nu) + delta_ve EI k^2 / T + inverse_q_te,   nu = omega / 2 pi,
        R = 2 pi eta_air + 2 pi d sqrt(pi eta_air rho_air nu)

    Valette & Cuesta, *Mécanique de la corde vibrante* (1993); in this form Issanchou, Bilbao, Le Carrou, Touzé &
    Doaré (2017), J. Sound Vib. 393, 219.
    """

    law: Literal["valette"] = described("chooses this law")
    diameter: float = quantity("m", low=1e-5, high=0.05, doc="of the string, as the air meets it")
    delta_ve: float = quantity("1", low=0.0, high=1.0, doc="visco-elastic loss angle of bending")
    inverse_q_te: float = quantity("1", low=0.0, high=1.0, default=0.0, doc="thermo-elastic and dislocation loss")
    air_viscosity: float = quantity("kg/(m s)", low=0.0, high=1e-3, default=1.8e-5, doc="dynamic viscosity of air")
    air_density: float = quantity("kg/m^3", low=0.0, high=10.0, default=1.2, doc="density of air")

    def eta(
        self, freq_rad: Floats, wavenumber: Floats, *, tension: float, linear_density: float, bending_stiffness: float
    ) -> Floats:
        """As `StringLoss.eta`."""
        viscous, nu = self.air_viscosity, freq_rad / (2 * np.pi)
        drag = 2 * np.pi * (viscous + self.diameter * np.sqrt(np.pi * viscous * self.air_density * nu))
        bending = self.delta_ve * bending_stiffness * wavenumber**2 / tension
        return np.asarray(drag / (freq_rad * linear_density) + bending + self.inverse_q_te)


#: the three laws, distinguished by their key ``law``
LossLaw = Annotated[Woodhouse | Sigma | Valette, Field(discriminator="law")]
