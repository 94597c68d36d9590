"""Tuning of one string on its body: the tension of each stop, kept once it is known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from functools import cached_property
from typing import cast

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.model.finger import compliance
from tonewood.instrument.model.kept_tunings import KeptTunings
from tonewood.instrument.model.string_setup import GivenTension
from tonewood.instrument.model.tuning import StringOnBody, TunedStop, no_mode, tune
from tonewood.instrument.model.untuned_bases import UntunedBases, held_freq
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Ports
from tonewood.support.arrays import Floats
from tonewood.support.units import cents, ratio_of_cents

#: a note that needs this many times the bundle's tension, or this many times less, is a mistake
_RETENSION = 5.0
#: cents by which the middle of two stops may miss their mean tension in a table; narrowest distance of its stops
_SMOOTH, _NARROWEST = 1.0, 1 / 8


class StringTuning:
    """Table of a string's tensions: stop -> tension and coupled modes; an entry is computed when it is first needed.

    stops : geometry.
    untuned : bases before tuning.
    resonator : plugin of the string.
    body : `Ports` of the body, one row per polarization.
    pluck_from_bridge : m, for the strength of coupled modes.
    kept : tunings of open strings from an earlier run.
    """

    def __init__(self, untuned: UntunedBases, body: Ports, pluck_from_bridge: float, kept: KeptTunings | None = None):
        self.stops, self.untuned, self.resonator = untuned.stops, untuned, untuned.resonator
        self._body, self._pluck, self._kept = body, pluck_from_bridge, kept
        self._tuned: dict[float, tuple[TunedStop | None, float]] = {}
        self._gains: dict[float, float] = {}
        self._interpolates = False

    def freq(self, stop: float = 0) -> float:
        """Return the pitch that a stop should sound, Hz: its note, transposed where the tension is held."""
        return self.stops.freq(stop) * self._raised

    @property
    def freqs(self) -> tuple[float, ...]:
        """Pitch of every whole stop from 0 (open) on, Hz."""
        return tuple(self.freq(stop) for stop in range(self.stops.count + 1))

    @property
    def given(self) -> GivenTension:
        """The bundle's tension and the one used."""
        stopping, tension = self.stops.stopping, self.resonator.tension
        constant = "tension" if self._tension_held or stopping.compensate == "none" else "pitch"
        raised = cents(self._raised)
        return GivenTension(self.stops.string, tension, self.tension(0.0), constant, raised, stopping.stretch_cents)

    def prepare(self, stops: Iterable[float], bent: Iterable[float] = ()) -> None:
        """Tune stops ahead, and what bends of the `bent` ones need, so that no note waits for it."""
        for stop in sorted(bent):
            self._bend_gain(stop)
        for stop in sorted(set(stops)):
            if self.stops.stopping.finger is None:
                self.tension(stop)
            else:
                self.under_finger(stop)

    def interpolated(self) -> StringTuning:
        """Return this tuning with a table of tensions in place of a search at each stop between whole ones.

        A slide passes hundreds of stops, and a search takes some ms: live, the table is computed before the sound.
        """
        if not self.stops.stopping.continuous or self.stops.stopping.compensate != "each_stop":
            return self
        table = copy(self)
        table._gains, table._interpolates = {}, True
        return table

    def prepare_all(self) -> None:
        """Compute all that a player who does not know the notes may need: tensions, and what bends change."""
        if self._interpolates:
            self.tension(0.5)
        for stop in range(self.stops.count + 1):
            self._bend_gain(stop)

    @cached_property
    def table(self) -> tuple[Floats, Floats]:
        """Stops, and the logarithms of their tensions: whole stops, and as many between as `_SMOOTH` asks for."""
        log = {float(stop): math.log(self._tune(stop)[1]) for stop in range(self.stops.count + 1)}
        steps = [(float(stop), stop + 1.0) for stop in range(self.stops.count)]
        while steps:
            low, high = steps.pop()
            middle = (low + high) / 2
            log[middle] = math.log(self._tune(middle)[1])
            # the pitch goes with the root of the tension
            error = 600 * math.log2(math.e) * abs(log[middle] - (log[low] + log[high]) / 2)
            if error > _SMOOTH and high - low > _NARROWEST:
                steps += [(low, middle), (middle, high)]
        stops = sorted(log)
        return np.array(stops), np.array([log[stop] for stop in stops])

    def tuned(self, stop: float = 0) -> TunedStop:
        """Return tension and coupled modes of a stop; at the bundle's tension where it asks for no compensation."""
        return self._tune(stop)[0] or self._as_it_stands(float(stop))

    def tension(self, stop: float = 0) -> float:
        """Return the tension of the first polarization at a stop, N."""
        if self._interpolates and stop != int(stop):
            return math.exp(float(np.interp(stop, *self.table)))
        return self._tune(0.0 if self.stops.stopping.compensate == "open_only" else stop)[1]

    def under(self, tension: float, stop: float = 0) -> TunedStop:
        """Return the coupled modes of a stop at a given tension (N), without tuning.

        Raises BundleError : none lies near the pitch of the stop.
        """
        return self._at(tension, stop, self.freq(stop))

    def coupled(self, stop: float = 0) -> StringOnBody:
        """Return the string at a stop on its body, at any tension."""
        base, pluck = self.base(stop), min(self._pluck, 0.9 * self.stops.length(stop))
        return StringOnBody(lambda tension: self.untuned.planes(base, tension, stop), self._body, pluck)

    def base(self, stop: float) -> ModalBasis:
        """Return the basis of a stop at a first guess of its tension."""
        # the open string's tension, once known, is the best guess for every stop
        guess = self._tuned[0.0][1] if stop > 0.0 and 0.0 in self._tuned else None
        return self.untuned.at(stop, self._first_guess if guess is None else lambda: guess)

    def plane_cents(self, stop: float = 0) -> tuple[float, ...]:
        """Return the pitch of each polarization at a stop over the first one's, cents, as the bundle splits them."""
        end = self.stops.end(stop)
        return tuple(cents(self.untuned.detune(p, end)) for p in self.untuned.polarizations)

    def bent(self, stop: float, bend_cents: float) -> float:
        """Return the tension of a stop that is bent by so many cents, N."""
        tension = self.tension(stop)
        return tension * ratio_of_cents(bend_cents * self._bend_gain(stop)) ** 2 if bend_cents else tension

    def under_finger(self, stop: float) -> float:
        """Return the position of a soft finger for the pitch of a stop, m from the bridge.

        The ideal stop's compensation is a tension; here, where all stops share the open string's, it is a length, and
        between whole stops it is interpolated. A stiff string is bent across the finger, not hinged there, and speaks
        as if it were sqrt(EI/T) / 2 shorter: half of the shortening by a clamp.
        """
        finger = self.stops.stopping.finger
        if finger is None:
            raise ValueError(f"string {self.stops.string} is stopped by no soft finger")
        length, tension = self.stops.length(stop), self.tension(0.0)
        if self.stops.stopping.compensate == "each_stop":
            low = math.floor(stop)
            share, ideal = stop - low, self._tune(float(low))[1]
            if share > 0:
                ideal += share * (self._tune(float(low + 1))[1] - ideal)
            length *= math.sqrt(tension / ideal)
        stiffness = self.base(0.0).metadata.get("bending_stiffness", 0.0)
        bent = math.sqrt(cast(float, stiffness) / tension) / 2
        return length + bent - tension * compliance(finger, self.freq(stop)).real

    @property
    def _tension_held(self) -> bool:
        return self.stops.stopping.hold == "tension" and self.stops.stopping.compensate != "none"

    @cached_property
    def _raised(self) -> float:
        """Ratio of the open string's pitch at the bundle's tension to its note; 1 where the pitch is held."""
        if not self._tension_held:
            return 1.0
        return self._as_it_stands(0.0).modes[0].freq / self.stops.freq(0)

    def _as_it_stands(self, stop: float) -> TunedStop:
        """The string at a stop, at the bundle's tension."""
        tension = self.resonator.tension
        freq = held_freq(self.coupled(stop).bases(tension)[0]) or self.stops.freq(stop)
        at = self._at(tension, stop, freq)
        return TunedStop(at.modes[0].freq, tension, at.modes)

    def _at(self, tension: float, stop: float, freq: float) -> TunedStop:
        string = self.coupled(stop)
        modes = string.modes(tension, freq)
        if not modes:
            raise self._without_mode(stop, no_mode(string.bases(tension)[0], freq))
        return TunedStop(freq, tension, modes)

    def _first_guess(self) -> float:
        """Tension of a rigidly held string of this pitch: f is proportional to the root of the tension."""
        if self._kept is not None and self.stops.string in self._kept.entries:
            return self._kept.entries[self.stops.string][0]
        nominal = self.resonator.tension
        if self._tension_held or self.stops.stopping.compensate == "none":
            return nominal
        basis = self.resonator.basis(min(self.untuned.freq_upper, 12 * self.freq(0)), tension=nominal)
        freq = held_freq(basis)
        guess = nominal if freq is None else nominal * (self.freq(0) / freq) ** 2
        if not 1 / _RETENSION <= guess / nominal <= _RETENSION:
            raise self.resonator.fault(
                f"{self.freq(0):.2f} Hz needs a tension of {guess:.3g} N where the bundle says {nominal:g} N; up to "
                f"{_RETENSION:g} times more or less is allowed",
                "note",
            )
        return guess

    def _bend_gain(self, stop: float) -> float:
        """Cents of tension per cent of pitch: not quite 1, because the shapes do not change with the tension."""
        if self._interpolates and stop != (under := int(stop)):
            return self._bend_gain(under) + (stop - under) * (self._bend_gain(under + 1) - self._bend_gain(under))
        if stop not in self._gains:
            base, tension, trial = self.base(stop), self.tension(stop), 50.0
            pair = (self.resonator.detuned(base, t) for t in (tension, tension * ratio_of_cents(trial) ** 2))
            low, high = (held_freq(basis) for basis in pair)
            self._gains[stop] = 1.0 if low is None or high is None or low == high else trial / cents(high / low)
        return self._gains[stop]

    def _tune(self, stop: float) -> tuple[TunedStop | None, float]:
        stop = float(stop)
        if stop not in self._tuned:
            self._tuned[stop] = self._new(stop)
        return self._tuned[stop]

    def _new(self, stop: float) -> tuple[TunedStop | None, float]:
        """Tuning of a stop that is not known yet: coupled modes where they are computed, and the tension."""
        how, string = self.stops.stopping.compensate, self.stops.string
        if how == "none":
            return None, self.resonator.tension
        if stop == 0 and self._tension_held:
            return self._as_it_stands(stop), self.resonator.tension
        if (fretted := self.stops.stopping.fretted) is not None and stop > 0:
            tension, ratio = fretted.raised(int(stop), self.tension(0.0)), fretted.ratio(int(stop))
            modes = self._at(tension, stop, self.freq(0) * ratio).modes
            return TunedStop(modes[0].freq, tension, modes), tension
        if how == "open_only" and stop > 0:
            tension = self.tension(0.0)
            return self.under(tension, stop), tension
        if stop == 0 and self._kept is not None and string in self._kept.entries:
            entry = self._kept.entries[string][1]
            return entry, entry.tension
        guess = self.tension(0.0) if stop > 0 else self._first_guess()
        try:
            tuned = tune(self.coupled(stop), self.freq(stop), guess)
        except ValueError as fault:
            raise self._without_mode(stop, str(fault)) from None
        if stop == 0 and self._kept is not None:
            self._kept.add(string, guess, tuned)
        return tuned, tuned.tension

    def _without_mode(self, stop: float, reason: str) -> BundleError:
        return self.resonator.fault(f"at stop {stop:g}: {reason}", "note")
