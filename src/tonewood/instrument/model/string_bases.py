"""Bases of a tuned string with its named points, at every stop, bend and damping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from tonewood.instrument.contract.base import Longitudinal
from tonewood.instrument.model.finger import POINT
from tonewood.instrument.model.string_setup import LongitudinalMotion
from tonewood.instrument.model.string_tuning import StringTuning
from tonewood.instrument.model.untuned_bases import PASSING_STOPS
from tonewood.physics.modal.damper import damper_rates
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.points import below, damped, moved, with_points
from tonewood.physics.modal.string_transfer import retuned
from tonewood.support.arrays import Floats

#: bases with their named points that are kept for other tensions: of the last stops and places of a pluck
_PLACED = 8


@dataclass(frozen=True, slots=True)
class StringPlaces:
    """Places on a string, m from the bridge.

    pluck, pluck_width : of the pluck where a gesture gives none, and how far it is spread.
    points : those that the bundle names.
    widths : name of a point -> width (m) of the string about it whose mean it stands for.
    damper : resistance (N s/m), place and width (m) of the felt that rests on it; None without one.
    """

    pluck: float
    pluck_width: float = 0.0
    points: Mapping[str, float] = field(default_factory=dict)
    widths: Mapping[str, float] = field(default_factory=dict)
    damper: tuple[float, float, float] | None = None


class StringBases:
    """Bases of a string as the engine steps it; the last ones are kept.

    tuning : tensions of its stops.
    places : on it.
    longitudinal : its longitudinal motion, if that is stepped.
    freq_limit : Hz, no mode is stepped above it.
    """

    def __init__(
        self, tuning: StringTuning, places: StringPlaces, longitudinal: LongitudinalMotion | None, freq_limit: float
    ):
        self.tuning, self.places, self._longitudinal, self._limit = tuning, places, longitudinal, freq_limit
        #: stop, points, those that do not move, width of the pluck -> basis with them at the first guess of its tension
        self._placed: dict[tuple[object, ...], ModalBasis] = {}
        #: number of modes and length -> decay rates that the damper adds
        self._damper_rates: dict[tuple[int, float], Floats] = {}
        self._lengthwise: dict[float, ModalBasis] = {}

    def tuned_by(self, tuning: StringTuning) -> StringBases:
        """Return bases of the same string by another table of tensions."""
        return StringBases(tuning, self.places, self._longitudinal, self._limit)

    def at(
        self,
        stop: float,
        attached: Mapping[str, float],
        *,
        bend_cents: float,
        added_damping: float,
        pluck_from_bridge: float | None,
        pluck_width: float,
        whole: bool,
    ) -> dict[str, ModalBasis]:
        """Return component -> basis; `attached`: points of parts -> m, the others as for `StringModel.bases`."""
        stops = self.tuning.stops
        length, end = stops.length(stop), stops.end(stop)
        beyond = [name for name, x in attached.items() if not 0 <= x < length]
        here = {"pluck": self._pluck(stop, pluck_from_bridge), **self.places.points}
        here |= {name: x for name, x in attached.items() if name not in beyond}
        if stops.stopping.finger is not None:
            if stop > 0:
                here[POINT] = self.tuning.under_finger(stop)
            else:
                beyond.append(POINT)
        untuned, base, tension = self.tuning.untuned, self.tuning.base(end), self.tuning.bent(end, bend_cents)
        out: dict[str, ModalBasis] = {}
        width = pluck_width or self.places.pluck_width
        placed = self._with_points(end, here, beyond, width)
        for polarization in untuned.polarizations:
            plane_tension = tension * untuned.detune(polarization, end) ** 2
            basis = untuned.resonator.detuned(placed, plane_tension)
            if basis.points != placed.points or not (whole or np.all(basis.natural_freq < self._limit)):
                # modes above the limit leave their compliance at points that are read afterwards
                basis = untuned.resonator.detuned(base, plane_tension)
                basis = with_points(basis if whole else below(basis, self._limit), here, beyond, self._widths(width))
            out[polarization.component] = basis
        if self._longitudinal:
            out[self._longitudinal.component] = self._lengthwise_basis(end, self._longitudinal.motion)
        return damped(out, added_damping) if added_damping else out

    def plucked_at(
        self, bases: Mapping[str, ModalBasis], stop: float, position: float | None, width: float
    ) -> dict[str, ModalBasis]:
        """Bases of a stop with the point ``pluck`` elsewhere; `position`, `width` as for `StringModel.bases`."""
        pluck, width, out = self._pluck(stop, position), width or self.places.pluck_width, dict(bases)
        for name in (p.component for p in self.tuning.untuned.polarizations):
            out[name] = moved(bases[name], "pluck", pluck, width)
        return out

    def under_damper(self, bases: Mapping[str, ModalBasis], share: float) -> dict[str, ModalBasis]:
        """Return bases of the string with a share of its damper's loss added; see `tonewood.physics.modal.damper`."""
        out = dict(bases)
        if self.places.damper is None:
            return out
        for name in (p.component for p in self.tuning.untuned.polarizations):
            basis = bases[name]
            key = basis.n_modes, cast(float, basis.metadata["length"])
            if key not in self._damper_rates:
                self._damper_rates[key] = damper_rates(basis, *self.places.damper)
            rates = share * self._damper_rates[key]
            out[name] = retuned(basis, np.sqrt(basis.stiffness), basis.damping_rate + rates)
        return out

    def _pluck(self, stop: float, position: float | None) -> float:
        """Place of the pluck, m from the bridge; the usual one where none is given."""
        length = self.tuning.stops.length(stop)
        pluck = min(self.places.pluck, 0.9 * length) if position is None else position
        if not 0 <= pluck <= length:
            string = self.tuning.stops.string
            raise ValueError(f"string {string} is {length:g} m long at stop {stop:g}; {pluck:g} m is not on it")
        return pluck

    def _with_points(self, end: float, here: Mapping[str, float], beyond: Sequence[str], width: float) -> ModalBasis:
        """Return the basis of a stop at a first guess of its tension with these points; the last ones are kept."""
        key = (end, tuple(here.items()), tuple(beyond), width)
        if key not in self._placed:
            if len(self._placed) >= _PLACED:
                del self._placed[next(iter(self._placed))]
            self._placed[key] = with_points(self.tuning.base(end), here, beyond, self._widths(width))
        return self._placed[key]

    def _widths(self, pluck: float) -> dict[str, float]:
        """Return the widths (m) of points that stand for a mean, that of the pluck among them."""
        return {**self.places.widths, **({"pluck": pluck} if pluck else {})}

    def _lengthwise_basis(self, stop: float, motion: Longitudinal) -> ModalBasis:
        """Longitudinal modes at a stop, kept; bends do not change them."""
        if stop not in self._lengthwise:
            if len(self._lengthwise) >= PASSING_STOPS:
                del self._lengthwise[next(iter(self._lengthwise))]
            self._lengthwise[stop] = motion.basis(self._limit, self.tuning.stops.position(stop))
        return self._lengthwise[stop]
