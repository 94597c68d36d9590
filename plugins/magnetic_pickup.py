"""Magnetic pickup: the velocity of the strings over its poles, heard through its coil, controls and cable.

The field of a pole magnetises a string of soft iron, which sends a flux through the coil. The pole's face is a disk of
radius a with an even magnetic charge, whose field on its axis is B(r) = 1 - r / sqrt(r^2 + a^2) (charges on surfaces:
Horton & Moore, Am. J. Phys. 77 (2009) 144). Here r^2 = y^2 + (g + z)^2, with g the gap at rest: beside the axis the
field is taken as that at the same distance. The flux goes with B^2, and its rate, relative to that of a small motion
towards the pole, is the source voltage:

    e = S [B B'](r) / [B B'](g) [(g + z) z' + y y'] / r,        e = S z'  without `gap`

S is the sensitivity, V s/m; motion along the soundboard alone gives even harmonics only. The coil (R, L, C) feeds the
controls, the cable and the input; with the admittance Y = 1/R_volume + 1/R_input + s (C + C_cable) + Y_tone:

    H(s) = 1 / (1 + (R + s L) Y),        Y_tone = s C_tone / (1 + s C_tone R_tone)

A pole hears the mean of the string over its aperture: give the string's point a `width`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]
#: quantities that are read of each string, in order; motion towards the pole is along -z
_READ = (("velocity", 2), ("velocity", 1), ("displacement", 2), ("displacement", 1))


class Coil(Parameters):
    """Equivalent circuit of a pickup."""

    resistance: float = ta.quantity("ohm", low=0.0, high=1e6, doc="of the wire")
    inductance: float = ta.quantity("H", low=1e-3, high=100.0, doc="of the coil")
    capacitance: float = ta.quantity("F", low=0.0, high=1e-8, doc="between its windings")


class Load(Parameters):
    """All that the coil feeds."""

    volume: float = ta.quantity("ohm", low=1e3, high=1e8, default=250e3, doc="volume control, turned up")
    tone: float = ta.quantity("ohm", low=0.0, high=1e8, default=250e3, doc="tone control: resistance in series")
    tone_capacitor: float = ta.quantity("F", low=0.0, high=1e-5, default=0.0, doc="of the tone control; 0 without one")
    cable: float = ta.quantity("F", low=0.0, high=1e-7, default=500e-12, doc="cable")
    input: float = ta.quantity("ohm", low=1e3, high=1e9, default=1e6, doc="input resistance of the amplifier")


class MagneticPickupParameters(Parameters):
    """Parameters of the pickup."""

    at: str = ta.described("name of the point that the strings have over the poles, or of one string: STRING.POINT")
    sensitivity: float = ta.quantity(
        "V s/m", low=1e-6, high=1e3, default=0.1, doc="voltage per velocity, coil unloaded"
    )
    coil: Coil = ta.described("equivalent circuit")
    load: Load = ta.described("controls, cable and input", default=Load())
    gap: float | None = ta.quantity(
        "m", low=1e-4, high=0.05, default=None, doc="string at rest to the pole's face; without it the pickup is linear"
    )
    radius: float = ta.quantity("m", low=1e-4, high=0.05, default=2.4e-3, doc="of the pole's face")


class MagneticPickup(ta.Pickup[MagneticPickupParameters]):
    """The pickup; see the module."""

    api = 1
    Parameters = MagneticPickupParameters

    @property
    def channels(self) -> tuple[str, ...]:
        """Give one channel: the strings are mixed in the coil."""
        return ("voltage",)

    @property
    def unit(self) -> str:
        """Voltage."""
        return "V"

    def rows(self, name: str, scene: ta.Scene) -> ta.PickupRows:
        """Read the velocity of all strings at once, or each string's motion in both directions."""
        p = self.parameters
        over = [point for point in scene.string_points if p.at in (point, point.partition(".")[2])]
        if not over:
            points = sorted({point.partition(".")[2] for point in scene.string_points})
            raise self.fault(f"no string has a point {p.at!r}; there are {', '.join(points)}", "at")
        if p.gap is None:
            terms = tuple(term for point in over for term in _terms(scene, point, 2))
            return ta.PickupRows((ta.Readout(f"{name}.voltage", "velocity", terms),), conversion=self._conversion(None))
        readouts = []
        for point in over:
            for quantity_read, axis in _READ:
                # a string without a second plane has no motion there: its first plane's point with the factor 0
                terms = _terms(scene, point, axis) or (ta.Term(*scene.string_points[point][0][:2], 0.0),)
                readouts.append(ta.Readout(f"{name}.{point}.{quantity_read}.{'xyz'[axis]}", quantity_read, terms))
        return ta.PickupRows(tuple(readouts), conversion=self._conversion(p.gap))

    def circuit(self) -> ta.Circuit:
        """Return H(s) S, V s/m."""
        p = self.parameters
        coil, load = p.coil, p.load
        conductance = 1.0 / load.volume + 1.0 / load.input
        capacitance = coil.capacitance + load.cable
        source = np.array([coil.inductance, coil.resistance])
        lag = np.array([load.tone_capacitor * load.tone, 1.0])  # 1 + s C R of the tone control
        admittance = np.polyadd(
            np.polymul([capacitance, conductance], lag), np.array([load.tone_capacitor, 0.0])
        )  # times `lag`
        denominator = np.trim_zeros(np.polyadd(lag, np.polymul(source, admittance)), "f")
        numerator = np.trim_zeros(p.sensitivity * lag, "f")
        return ta.Circuit(tuple(map(float, numerator)), tuple(map(float, denominator)))

    def _conversion(self, gap: float | None) -> ta.Conversion:
        radius = self.parameters.radius
        function = None if gap is None else lambda readouts: induced(readouts, gap, radius)
        return ta.Conversion(function, self.circuit())


def field(r: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return B(r) and dB/dr (1/m) of a pole."""
    span = np.sqrt(r**2 + radius**2)
    return 1.0 - r / span, -(radius**2) / span**3


def induced(readouts: Floats, gap: float, radius: float) -> Floats:
    """Return the velocity (n, 1), m/s, of a small motion that induces as much.

    Parameters
    ----------
    readouts : (n, 4 strings) velocity along z and y, displacement along z and y of each string.
    gap, radius : m.
    """
    vz, vy, z, y = (readouts[:, i::4] for i in range(4))
    r = np.hypot(y, gap + z)
    rate = ((gap + z) * vz + y * vy) / np.maximum(r, 1e-9)
    (here, slope), (rest, slope_at_rest) = field(r, radius), field(np.array(gap), radius)
    return np.asarray(np.sum(here * slope / (rest * slope_at_rest) * rate, axis=1, keepdims=True))


def _terms(scene: ta.Scene, point: str, axis: int) -> tuple[ta.Term, ...]:
    return tuple(ta.Term(c, p, float(v[axis])) for c, p, v in scene.string_points[point] if abs(v[axis]) > 1e-12)
