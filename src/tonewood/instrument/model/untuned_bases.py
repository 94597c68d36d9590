"""Bases of a string at each stop before it is tuned, and its planes at any tension."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tonewood.instrument.contract.base import Resonator
from tonewood.instrument.model.stop_table import StopTable
from tonewood.instrument.model.string_setup import Polarization
from tonewood.instrument.model.tuning import ends_at_rest
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.support.units import ratio_of_cents

#: kept bases of stops between whole ones: a slide passes hundreds
PASSING_STOPS = 32


class UntunedBases:
    """Bases of a string at a first guess of its tension, kept; `Resonator.detuned` takes them to any other tension.

    resonator : of the string.
    stops : its geometry.
    polarizations : one or two.
    freq_upper : Hz, highest mode at the guess.
    end_compliance : m/N, of the string's seat on the bridge.
    scatter : stop -> cents by which the second polarization is sharper than its `detune` says.
    """

    def __init__(
        self,
        resonator: Resonator[Any],
        stops: StopTable,
        polarizations: Sequence[Polarization],
        freq_upper: float,
        end_compliance: float,
        scatter: Callable[[float], float] | None = None,
    ):
        self.resonator, self.stops, self.polarizations = resonator, stops, tuple(polarizations)
        self.freq_upper, self._end_compliance, self._scatter = freq_upper, end_compliance, scatter
        self._bases: dict[float, ModalBasis] = {}

    def at(self, stop: float, guess: Callable[[], float]) -> ModalBasis:
        """Return the basis of a stop; `guess` gives its tension (N) where it has not been computed yet.

        Raises BundleError : less than two modes lie below `freq_upper`.
        """
        if stop not in self._bases:
            basis = self.resonator.basis(self.freq_upper, stop=self.stops.position(stop), tension=guess())
            if basis.n_modes < 2:  # a single mode moves with the bridge: a string held there would have none
                raise self.resonator.fault(
                    f"{self.freq_upper:g} Hz leave {basis.n_modes} of the modes at stop {stop:g}; "
                    f"{self.stops.freq(stop):.2f} Hz need 2 or more: raise freq_upper, or the sampling rate",
                    "freq_upper",
                )
            bridge = basis.index("bridge")
            residual = basis.residual.copy()
            residual[bridge, bridge] += self._end_compliance
            passing = [s for s in self._bases if s != int(s)]
            if len(passing) >= PASSING_STOPS:
                del self._bases[passing[0]]
            self._bases[stop] = replace(basis, residual=residual)
        return self._bases[stop]

    def detune(self, polarization: Polarization, stop: float) -> float:
        """Return the frequency ratio of a polarization to the first one at a stop."""
        if self._scatter is None or polarization is self.polarizations[0]:
            return polarization.detune
        return polarization.detune * ratio_of_cents(self._scatter(stop))

    def planes(self, base: ModalBasis, tension: float, stop: float) -> list[ModalBasis]:
        """Return the bases of all polarizations at a stop.

        base : basis of the stop, at any tension.
        tension : N, of the first polarization.
        """
        return [self.resonator.detuned(base, tension * self.detune(p, stop) ** 2) for p in self.polarizations]


def held_freq(basis: ModalBasis) -> float | None:
    """Lowest frequency (Hz) of a string held at its bridge, where the compliance of its free end vanishes.

    It lies an octave above the lowest one with the bridge free, or little more; None if it is not found there.
    """
    if ends_at_rest(basis):
        return float(basis.natural_freq.min())
    ports = Ports.of(basis, np.eye(len(basis.points))[[basis.index("bridge")]])
    zero = Joint([ports]).newton(2 * math.sqrt(basis.stiffness.min()) * complex(-1e-5, 1.0), steps=80)
    return None if zero is None else zero.imag / (2 * math.pi)
