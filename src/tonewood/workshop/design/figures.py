"""Figures of a body that targets are about, from its resonances: frequencies, mean mobility, mass, wolf notes.

The mean mobility of a band is the mean of 20 lg |Y(f)| over lg f, dB re 1 m/s/N. A string and a body mode make a wolf
where their coupling is strong,

    K = (2 Q / pi) sqrt(2 m / M) > 1,

Q and M of the mode at the string's end, m = mu L of the string that plays the mode's frequency (C. E. Gough, Acustica
49 (1981) 124). The figure is the largest min(1200 lg2 K, cents by which the mode lies inside the range) over the modes
and strings: 0 or less where no note of the range is a wolf.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.physics.plate.whole_body import LowModes
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.design.task import Target

#: points of a band
_POINTS = 400
#: modes below this share of the fourth are rigid-body motion, which is not counted
_RIGID = 1e-2


class Resonances(Protocol):
    """Modes of a body with all that is fixed to it."""

    @property
    def freq(self) -> Floats:
        """(n,) Hz, ascending."""

    @property
    def quality(self) -> Floats:
        """(n,) Q."""

    @property
    def squares(self) -> Floats:
        """(p, n) 1/kg, squared shapes at the body's points: 1 / M."""

    @property
    def mass(self) -> float | None:
        """kg; None where it is not known."""

    @property
    def named(self) -> Mapping[str, int]:
        """Numbers of the modes that have a name."""

    def mobility(self, point: int, freq: Floats) -> Complexes:
        """(f,) m/s/N, of a point at frequencies (f,) Hz."""


@dataclass(frozen=True, eq=False)
class DrawnResonances:
    """Of a drawn body."""

    modes: LowModes

    @property
    def freq(self) -> Floats:
        """(n,) Hz."""
        return self.modes.freq

    @property
    def quality(self) -> Floats:
        """(n,) Q."""
        return np.asarray(1 / np.maximum(self.modes.loss, 1e-12))

    @property
    def squares(self) -> Floats:
        """(p, n) 1/kg."""
        return np.asarray(self.modes.shapes**2)

    @property
    def mass(self) -> float | None:
        """Kg."""
        return self.modes.mass

    @property
    def named(self) -> Mapping[str, int]:
        """A0 and T1."""
        return self.modes.named

    def mobility(self, point: int, freq: Floats) -> Complexes:
        """(f,) m/s/N: i omega (sum phi^2 / (omega_k^2 - omega^2 + i omega omega_k eta_k) + R)."""
        w, omega = 2 * np.pi * freq[:, None], 2 * np.pi * self.modes.freq
        receptance = self.modes.shapes[point] ** 2 / (omega**2 - w**2 + 1j * w * omega * self.modes.loss)
        return np.asarray(1j * w[:, 0] * (receptance.sum(axis=1) + self.modes.residual[point, point]))


@dataclass(frozen=True, slots=True)
class StringEnd:
    """A string that ends on the body.

    name : its name.
    point : number of the body's point.
    mass_freq : kg Hz, its mass times its frequency, the same at every stop.
    low, high : Hz, pitches that it plays.
    """

    name: str
    point: int
    mass_freq: float
    low: float
    high: float


def string_ends(instrument: Instrument) -> list[StringEnd]:
    """Strings of uniform mass that end on the body, by their first polarization."""
    ends, names = [], list(instrument.body.points())
    count = instrument.spec.stops.count
    for name, part in instrument.spec.strings.items():
        string = instrument.resonators[name]
        pitch = instrument.tuning.freq(instrument.open_note(name))
        if part.body_points and string.linear_density > 0:
            product = string.linear_density * string.length * pitch
            high = pitch * 2 ** (count / 12)
            ends.append(StringEnd(name, names.index(part.body_points[0]), product, pitch, high))
    return ends


def figures(
    targets: Sequence[Target], resonances: Resonances, points: Sequence[str], ends: Sequence[StringEnd]
) -> Floats:
    """(targets,) figures, each in the unit of its target.

    Raises TonewoodError : the body has no such mode, or its mass is not known.
    """
    return np.array([_figure(target, resonances, points, ends) for target in targets])


def _figure(target: Target, resonances: Resonances, points: Sequence[str], ends: Sequence[StringEnd]) -> float:
    if target.kind == "mass":
        if resonances.mass is None:
            raise TonewoodError(f"{target.text!r}: the mass of a measured body is not known", key="targets")
        return resonances.mass
    if target.kind == "mobility":
        freq = np.geomspace(*target.band, _POINTS)
        return float(np.mean(20 * np.log10(np.abs(resonances.mobility(points.index(target.at), freq)))))
    if target.kind == "wolf":
        return worst_wolf(resonances, ends, target.band)
    moves = np.flatnonzero(resonances.freq > _RIGID * resonances.freq[:4].max(initial=0.0))
    modes = {str(k + 1): int(mode) for k, mode in enumerate(moves)} | dict(resonances.named)
    if target.mode not in modes:
        named = ", ".join(resonances.named) or "none has a name"
        raise TonewoodError(
            f"{target.text!r}: this body has no such mode; of {len(moves)} modes looked at, {named}: "
            "`mode N` counts them",
            key="targets",
        )
    return float(resonances.freq[modes[target.mode]])


def worst_wolf(resonances: Resonances, ends: Sequence[StringEnd], band: tuple[float, float]) -> float:
    """Figure of the module's first lines, cents; -1200 where no mode comes near."""
    worst = -1200.0
    freq, quality, squares = resonances.freq, resonances.quality, resonances.squares
    for end in ends:
        low, high = max(band[0], end.low * 2 ** (-1 / 24)), min(band[1], end.high * 2 ** (1 / 24))
        near = np.flatnonzero((freq > low / 2) & (freq < 2 * high))
        if low > high or not len(near):
            continue
        inside = 1200 * np.minimum(np.log2(freq[near] / low), np.log2(high / freq[near]))
        mass = end.mass_freq / freq[near]
        strong = 2 * quality[near] / np.pi * np.sqrt(2 * mass * squares[end.point, near])
        worst = max(worst, float(np.max(np.minimum(1200 * np.log2(np.maximum(strong, 1e-9)), inside))))
    return worst


__all__ = ["DrawnResonances", "Resonances", "StringEnd", "figures", "string_ends", "worst_wolf"]
