"""A thin rectangular plate, simply supported along its edges, as the body of an instrument.

    rho h u_tt + D laplace^2 u = f,    D = E h^3 / (12 (1 - nu^2))
    omega_mn = sqrt(D / rho h) [(m pi / a)^2 + (n pi / b)^2],
    phi_mn = 2 / sqrt(rho h a b) sin(m pi x / a) sin(n pi y / b)        (1/sqrt(kg))

Leissa, *Vibration of Plates* (NASA SP-160, 1969), Eq. 4.20. Valid for wavelengths long against the thickness; every
mode has the same damping ratio.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import tonewood.authoring as ta


class PlatePoint(ta.Parameters):
    """A place on the plate."""

    x: float = ta.quantity("m", low=0.0, doc="from one corner along the length")
    y: float = ta.quantity("m", low=0.0, doc="from that corner along the width")


class PlateParameters(ta.Parameters):
    """Of the plate."""

    length: float = ta.quantity("m", low=0.01, high=5.0, doc="side along x")
    width: float = ta.quantity("m", low=0.01, high=5.0, doc="side along y")
    thickness: float = ta.quantity("m", low=1e-4, high=0.05, doc="of the plate")
    density: float = ta.quantity("kg/m^3", low=10.0, high=2e4, doc="of the material")
    young_modulus: float = ta.quantity("Pa", low=1e6, high=1e12, doc="of the material")
    poisson_ratio: float = ta.quantity("1", low=0.0, high=0.49, default=0.3, doc="of the material")
    damping_ratio: float = ta.quantity("1", low=1e-5, high=0.5, default=0.01, doc="of every mode")
    points: dict[str, PlatePoint] = ta.described("name -> place; motion is counted along z", min_length=1)


class RectangularPlate(ta.Body[PlateParameters]):
    """The plate; see the module."""

    api = 1
    Parameters = PlateParameters

    def points(self) -> Mapping[str, ta.BodyPoint]:
        """Every point moves along z; its coordinates give its place."""
        return {name: ta.BodyPoint((0.0, 0.0, 1.0), {"x": p.x, "y": p.y}) for name, p in self.parameters.points.items()}

    def basis(self, freq_upper: float) -> ta.ModalBasis:
        """Modes below `freq_upper` (Hz), by ascending frequency."""
        p = self.parameters
        for name, at in p.points.items():
            if at.x > p.length or at.y > p.width:
                raise self.fault(f"({at.x:g}, {at.y:g}) m does not lie on the plate", f"points.{name}")
        mass = p.density * p.thickness  # kg/m^2
        rigidity = p.young_modulus * p.thickness**3 / (12 * (1 - p.poisson_ratio**2))
        limit = 2 * np.pi * freq_upper / np.sqrt(rigidity / mass)  # largest squared wavenumber
        m = np.arange(1, int(p.length / np.pi * np.sqrt(limit)) + 1)
        n = np.arange(1, int(p.width / np.pi * np.sqrt(limit)) + 1)
        kx, ky = (k.ravel() for k in np.meshgrid(m * np.pi / p.length, n * np.pi / p.width))
        order = np.argsort(kx**2 + ky**2)
        order = order[(kx**2 + ky**2)[order] < limit]
        if order.size == 0:
            raise self.fault(f"has no mode below {freq_upper:g} Hz")
        kx, ky = kx[order], ky[order]
        omega = np.sqrt(rigidity / mass) * (kx**2 + ky**2)
        size = 2 / np.sqrt(mass * p.length * p.width)
        shapes = {name: size * np.sin(kx * at.x) * np.sin(ky * at.y) for name, at in p.points.items()}
        return ta.ModalBasis.real(omega, p.damping_ratio * omega, shapes)
