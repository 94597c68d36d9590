"""A string on a bed of soft rubber whose force grows with the third power of the displacement.

    V = k/4 int_0^L (u_y^2 + u_z^2)^2 dx,

in addition to the energy of a string under tension. A loud note starts sharp and glides down. Both planes act on the
same rubber.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tonewood.authoring as ta


class BeddedStringParameters(ta.Parameters):
    """Of the open string and its bed."""

    length: float = ta.quantity("m", low=0.02, high=5.0, doc="nut to bridge")
    tension: float = ta.quantity("N", low=0.1, high=5000.0, doc="tension before tuning")
    linear_density: float = ta.quantity("kg/m", low=1e-5, high=0.1, doc="mass per length")
    t60: float = ta.quantity("s", low=0.01, high=100.0, doc="time in which each partial falls by 60 dB")
    bed: float = ta.quantity("N/m^4", low=0.0, high=1e14, doc="k, force per length and cubed displacement")


class Bed(ta.PotentialEnergy):
    """V by the motion at 64 places, of the 24 lowest modes of each plane."""

    def __init__(self, planes: Sequence[ta.ModalBasis], stiffness: float):
        length = float(planes[0].metadata["length"])
        places = (np.arange(64) + 0.5) / 64 * length
        self.shapes = [np.array([np.asarray(b.shape(x)).real[:24] for x in places]) for b in planes]
        self.sizes = tuple(shape.shape[1] for shape in self.shapes)
        self.stiffness = stiffness * length / 64

    def gradient(self, y: np.ndarray) -> tuple[float, np.ndarray]:
        """V, J, and dV/dy."""
        parts = np.split(y, np.cumsum(self.sizes)[:-1])
        u = [shape @ part for shape, part in zip(self.shapes, parts, strict=True)]
        square = sum(plane**2 for plane in u)
        pulls = [self.stiffness * (square * plane) @ shape for plane, shape in zip(u, self.shapes, strict=True)]
        return 0.25 * self.stiffness * float(square @ square), np.concatenate(pulls)


class BeddedString(ta.Resonator[BeddedStringParameters]):
    """The string; see the module."""

    api = 1
    Parameters = BeddedStringParameters
    length = property(lambda self: self.parameters.length)
    tension = property(lambda self: self.parameters.tension)

    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ta.ModalBasis:
        """Its modes with the bridge end free."""
        p, rate = self.parameters, np.log(1000.0) / self.parameters.t60
        loss = lambda omega, k: 2 * rate / omega  # noqa: E731
        pull = p.tension if tension is None else tension
        return ta.string_basis(p.length - stop, pull, p.linear_density, 0.0, loss, freq_upper=freq_upper)

    def detuned(self, basis: ta.ModalBasis, tension: float) -> ta.ModalBasis:
        """The same modes at another tension."""
        freq_rad = np.sqrt(tension * np.asarray(basis.metadata["tension_part"]))
        return ta.retuned(basis, freq_rad, basis.damping_rate, {"tension": tension})

    def transfer(self, old: ta.ModalBasis, new: ta.ModalBasis) -> tuple[np.ndarray, np.ndarray]:
        """Motion from one stop to another."""
        return ta.string_transfer(old, new)

    def potentials(self, string: ta.StringMotion) -> Sequence[ta.Potential]:
        """The bed's energy."""
        return [ta.ModalPotential(string.name, string.planes, lambda bases: Bed(bases, self.parameters.bed))]
