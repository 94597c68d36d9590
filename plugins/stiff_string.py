"""A stiff string in one polarization: held at the nut or a stop, moved by a body at the bridge.

    mu u_tt + loss = T u_xx - EI u_xxxx + f(x, t),    no moment at either end

Modes and their derivation: `tonewood.physics.modal.string_modes`; loss laws: `tonewood.instrument.contract.losses`.
Valid for small slopes (no change of tension with amplitude) and for wavelengths long against the diameter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.authoring import (
    LossLaw,
    ModalBasis,
    Parameters,
    Resonator,
    described,
    quantity,
    string_basis,
    string_carry,
    string_detuned,
    string_transfer,
    wavenumber,
)

Floats = NDArray[np.float64]

#: limit of the number of modes: cost and memory grow with its square
MOST_MODES = 3000


class StiffStringParameters(Parameters):
    """Parameters of the open string."""

    length: float = quantity("m", low=0.02, high=5.0, doc="speaking length of the open string, nut to bridge")
    tension: float = quantity(
        "N", low=1.0, high=2000.0, usual=(10.0, 1500.0), doc="tension of the open string; the tuner adjusts it"
    )
    linear_density: float = quantity("kg/m", low=1e-5, high=0.3, doc="mass per length")
    bending_stiffness: float = quantity("N m^2", low=0.0, high=1.0, default=0.0, doc="E I; 0 is an ideal string")
    loss: LossLaw = described("loss law and its numbers")


class StiffString(Resonator[StiffStringParameters]):
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

    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ModalBasis:
        """Every mode below `freq_upper` (Hz) of the string stopped `stop` metres from the nut."""
        p = self.parameters
        actual = p.tension if tension is None else tension
        k = wavenumber(2 * np.pi * freq_upper, actual, p.linear_density, p.bending_stiffness)
        count = int((p.length - stop) / np.pi * k)
        if count > MOST_MODES:
            raise self.fault(f"has some {count} modes below {freq_upper:g} Hz; at most {MOST_MODES} are allowed")
        try:
            return string_basis(
                p.length - stop,
                actual,
                p.linear_density,
                p.bending_stiffness,
                lambda freq_rad, wavenumber: self._eta(freq_rad, wavenumber, actual),
                freq_upper=freq_upper,
            )
        except ValueError as fault:
            raise self.fault(str(fault)) from None

    def detuned(self, basis: ModalBasis, tension: float) -> ModalBasis:
        """Same shapes, omega^2 = T a_k + EI b_k: how a bend or the tuner changes a string.

        The change of the shapes, which only bending stiffness causes, is left out: a tension raised by 50
        cents raises the partials of a classical guitar's strings by 0.08 to 0.2 cent less, all nearly alike. Decay
        rates follow the law from the old frequency of each mode to its new one: on a classical guitar 200 cents leave
        those of partials on a rigid end within 0.6 % of the law.
        """
        return string_detuned(basis, tension, self._eta)

    def transfer(self, old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
        """Projections of displacement and velocity; see `tonewood.physics.modal.string_transfer`."""
        return string_transfer(old, new)

    def carried(self, old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Project one motion; see `transfer`."""
        return string_carry(old, new, q, velocity)

    def _eta(self, freq_rad: Floats, wavenumber: Floats, tension: float) -> Floats:
        p = self.parameters
        return p.loss.eta(
            freq_rad,
            wavenumber,
            tension=tension,
            linear_density=p.linear_density,
            bending_stiffness=p.bending_stiffness,
        )
