"""A string of an assembled instrument: its components, and their bases at every stop, bend and damping."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import BundleError
from tonewood.instrument.bundle.schema import Finger
from tonewood.instrument.contract.attached import Attached, Site
from tonewood.instrument.contract.base import Attachment, Exciter, Longitudinal, Resonator, StringMotion
from tonewood.instrument.model.finger import POINT, compliance, fingertips, laid_down
from tonewood.instrument.model.kept_tunings import KeptTunings
from tonewood.instrument.model.string_setup import GivenTension, LongitudinalMotion, Polarization, Stopping
from tonewood.instrument.model.tuning import StringOnBody, TunedStop, no_mode, tune
from tonewood.physics.coupling.connections import Connection
from tonewood.physics.modal.damper import damper_rates
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.points import below, damped, moved, with_points
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.physics.modal.string_transfer import retuned, string_carry, string_transfer
from tonewood.support.units import cents, ratio_of_cents

Floats = NDArray[np.float64]

#: a note that needs this many times the bundle's tension, or this many times less, is a mistake
_RETENSION = 5.0
#: cached bases of stops between whole ones: a slide passes hundreds
_PASSING_STOPS = 32
#: bases with their named points that are kept for other tensions: of the last stops and places of a pluck
_PLACED = 8


class StringModel:
    """One string; immutable but for caches of the bases that it has made.

    Attributes
    ----------
    name : of the string.
    polarizations : one or two, the first is the one kept when effects are left out.
    open_note : note number of the open string.
    stopping : its stops.
    longitudinal : its longitudinal motion, if that is stepped.
    potentials : energies that it stores beside those of its modes, those that are left out among them.
    pluck_from_bridge, pluck_width : m, place of the pluck where a gesture gives none, and how far it is spread.
    group : strings that a note on the first of them plays together; itself among them.
    touching : attachments and exciters that may add parts to it, by name.
    freq_upper : Hz, of its modes at the first guess of its tension.
    damper : resistance (N s/m), place and width (m, from the bridge) of the felt that rests on it; None without one.

    Parameters
    ----------
    end_shares : body point -> share of its displacement in that of the string's end along the string.
    scatter : stop -> cents by which the second polarization is sharper than its `detune` says.
    kept : tunings of open strings from an earlier run.
    """

    def __init__(
        self,
        name: str,
        resonator: Resonator[Any],
        polarizations: tuple[Polarization, ...],
        *,
        open_note: float,
        stopping: Stopping,
        body: Ports,
        freq_upper: float,
        freq_limit: float,
        end_compliance: float,
        points: Mapping[str, float],
        tilt_deg: float,
        pluck_from_bridge: float,
        scatter: Callable[[float], float] | None = None,
        touching: Mapping[str, Attachment[Any] | Exciter[Any]] | None = None,
        longitudinal: LongitudinalMotion | None = None,
        end_shares: Mapping[str, float] | None = None,
        pluck_width: float = 0.0,
        group: tuple[str, ...] = (),
        damper: tuple[float, float, float] | None = None,
        kept: KeptTunings | None = None,
    ):
        self.name, self.resonator, self.polarizations = name, resonator, polarizations
        self.longitudinal = longitudinal
        planes, own = tuple(p.component for p in polarizations), longitudinal.component if longitudinal else None
        motion = StringMotion(name, planes, own, dict(end_shares or {}))
        self.potentials = tuple(resonator.potentials(motion))
        self.open_note, self.stopping, self.points = open_note, stopping, dict(points)
        self.pluck_from_bridge, self.pluck_width = pluck_from_bridge, pluck_width
        self.group, self.damper = group or (name,), damper
        self._of_key, self._kept = bool(group), kept
        self._body, self.freq_upper, self._freq_limit = body, freq_upper, freq_limit
        self._end_compliance, self._tilt_deg = end_compliance, tilt_deg
        self.touching, self._scatter = dict(touching or {}), scatter
        self._attached: dict[float, tuple[Attached, ...]] = {}
        self._tuned: dict[float, tuple[TunedStop | None, float]] = {}
        self._bases: dict[float, ModalBasis] = {}
        #: stop, points, those that do not move, width of the pluck -> basis with them at the first guess of its tension
        self._placed: dict[tuple[object, ...], ModalBasis] = {}
        self._gains: dict[float, float] = {}
        #: number of modes and length -> decay rates that the damper adds
        self._damper_rates: dict[tuple[int, float], Floats] = {}
        self._longitudinal_bases: dict[float, ModalBasis] = {}

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its components in the system, the first polarization first, longitudinal motion last."""
        return tuple(p.component for p in self.ends)

    @property
    def all_components(self) -> tuple[str, ...]:
        """Names of its components, then those that attachments, exciters and a finger add to it."""
        return (*self.components, *(name for a in self.attached() for name in a.components))

    @property
    def ends(self) -> tuple[Polarization | LongitudinalMotion, ...]:
        """Motions that are joined to the bridge: polarizations, then longitudinal motion."""
        return (*self.polarizations, *([self.longitudinal] if self.longitudinal else []))

    @property
    def n_stops(self) -> int:
        """Highest stop; 0 for a string that is only played open."""
        return self.stopping.count

    @property
    def stop_freqs(self) -> tuple[float, ...]:
        """Pitch of every whole stop from 0 (open) on, Hz."""
        return tuple(self.freq(stop) for stop in range(self.n_stops + 1))

    def freq(self, stop: float = 0) -> float:
        """Pitch that a stop should sound, Hz: its note, transposed with the open string if the tension is held."""
        return self.stopping.freq(stop) * self._raised

    @property
    def given_tension(self) -> GivenTension:
        """The bundle's tension and the one used."""
        held = "tension" if self._tension_held or self.stopping.compensate == "none" else "pitch"
        stretch = self.stopping.stretch_cents
        return GivenTension(self.name, self.resonator.tension, self.tension(0.0), held, cents(self._raised), stretch)

    @property
    def _tension_held(self) -> bool:
        return self.stopping.hold == "tension" and self.stopping.compensate != "none"

    @cached_property
    def _raised(self) -> float:
        """Ratio of the open string's pitch at the bundle's tension to its note; 1 where the pitch is held."""
        if not self._tension_held:
            return 1.0
        return self._as_it_stands(0.0).modes[0].freq / self.stopping.freq(0)

    def _as_it_stands(self, stop: float) -> TunedStop:
        """The string at a stop, at the bundle's tension."""
        tension, string = self.resonator.tension, self.coupled(stop)
        freq = held_freq(string.bases(tension)[0]) or self.stopping.freq(stop)
        modes = string.modes(tension, freq)
        if not modes:
            raise self._without_mode(stop, no_mode(string.bases(tension)[0], freq))
        return TunedStop(modes[0].freq, tension, modes)

    def position(self, stop: float) -> float:
        """Place of a stop, m from the nut: where the ideal string sounds the stop's pitch."""
        if not (0 <= stop <= self.n_stops and (self.stopping.continuous or stop == int(stop))):
            kind = "" if self.stopping.continuous else "whole "
            raise ValueError(f"string {self.name} has {kind}stops from 0 to {self.n_stops}, not {stop:g}")
        return self.resonator.length * (1.0 - self.stopping.freq(0) / self.stopping.freq(stop))

    def length(self, stop: float = 0) -> float:
        """Speaking length at a stop, m."""
        return self.resonator.length - self.position(stop)

    def site(self, stop: float = 0) -> Site:
        """Geometry of the string at a stop, for attachments and exciters."""
        open_length = self.resonator.length
        stops = tuple(self.length(i) for i in range(self.n_stops + 1))
        polarizations = tuple((p.component, p.direction) for p in self.polarizations)
        group = self.group if self._of_key else ()
        return Site(self.name, open_length, self.length(stop), stops, polarizations, group)

    def attached(self, stop: float = 0) -> tuple[Attached, ...]:
        """Places, components and connections that attachments, exciters and a finger add to the string at a stop."""
        if stop not in self._attached:
            site = self.site(stop)
            # pairs: an exciter may have the name of the soft finger
            found = [(name, part.attach(name, site)) for name, part in self.touching.items()]
            if self.stopping.finger is not None:
                found.append((POINT, fingertips(self.stopping.finger, site, self._left_under_finger(stop))))
            self._attached[stop] = tuple(a.owned_by(self.name, part) for part, a in found if a is not None)
        return self._attached[stop]

    def connections(self, stop: float = 0) -> tuple[Connection, ...]:
        """Connections of `attached`; at every stop the same ones, with laws that may differ."""
        return tuple(c for a in self.attached(stop) for c in a.connections)

    def tuned(self, stop: float = 0) -> TunedStop:
        """Tension and coupled modes of a stop; at the bundle's tension where it asks for no compensation."""
        return self._tune(stop)[0] or self._as_it_stands(float(stop))

    def tension(self, stop: float = 0) -> float:
        """Tension of the first polarization at a stop, N."""
        return self._tune(0.0 if self.stopping.compensate == "open_only" else stop)[1]

    def under(self, tension: float, stop: float = 0) -> TunedStop:
        """Coupled modes of a stop at a given tension (N), without tuning.

        Raises
        ------
        BundleError : none lies near the pitch of the stop.
        """
        string = self.coupled(stop)
        modes = string.modes(tension, self.freq(stop))
        if not modes:
            raise self._without_mode(stop, no_mode(string.bases(tension)[0], self.freq(stop)))
        return TunedStop(self.freq(stop), tension, modes)

    def coupled(self, stop: float = 0) -> StringOnBody:
        """The string at a stop on its body, at any tension."""
        base = self._untuned(stop)

        def bases(tension: float) -> list[ModalBasis]:
            return [self.resonator.detuned(base, tension * self._detune(p, stop) ** 2) for p in self.polarizations]

        return StringOnBody(bases, self._body, min(self.pluck_from_bridge, 0.9 * self.length(stop)))

    def bases(
        self,
        stop: float = 0,
        *,
        bend_cents: float = 0.0,
        added_damping: float = 0.0,
        pluck_from_bridge: float | None = None,
        pluck_width: float = 0.0,
        touches: Mapping[str, float] | None = None,
        whole: bool = False,
    ) -> dict[str, ModalBasis]:
        """Component -> basis, with the points ``bridge``, ``pluck`` and those named in the bundle.

        Parameters
        ----------
        stop : 0 is open; a fraction on a continuous string.
        bend_cents : change of pitch by a change of tension.
        added_damping : 1/s, added to every mode's damping rate.
        pluck_from_bridge : m; the string's usual place where left out. Must lie on the speaking part.
        pluck_width : m, of the string about that place over which the point ``pluck`` is a mean; 0 for the usual one.
        touches : point that a part attaches to the string -> m, in place of the part's own place.
        whole : keep also modes that the tension has raised above the limit.
        """
        length = self.length(stop)
        pluck = self._pluck(stop, pluck_from_bridge)
        places = {name: x for a in self.attached(stop) for name, x in a.places.items()} | dict(touches or {})
        beyond = [name for name, x in places.items() if not 0 <= x < length]
        here = {"pluck": pluck, **self.points, **{n: x for n, x in places.items() if n not in beyond}}
        if self.stopping.finger is not None:
            if stop > 0:
                here[POINT] = self._under_finger(stop, self.stopping.finger)
            else:
                beyond.append(POINT)
        end = self._end(stop)
        base, tension = self._untuned(end), self.tension(end)
        if bend_cents:
            tension *= ratio_of_cents(bend_cents * self._bend_gain(end)) ** 2
        out: dict[str, ModalBasis] = {}
        width = pluck_width or self.pluck_width
        placed = self._with_points(end, here, beyond, width)
        for polarization in self.polarizations:
            own = tension * self._detune(polarization, end) ** 2
            basis = self.resonator.detuned(placed, own)
            if basis.points != placed.points or not (whole or np.all(basis.natural_freq < self._freq_limit)):
                # modes above the limit leave their compliance at points that are read afterwards
                basis = self.resonator.detuned(base, own)
                basis = with_points(basis if whole else below(basis, self._freq_limit), here, beyond, width)
            out[polarization.component] = basis
        if self.longitudinal:
            out[self.longitudinal.component] = self._longitudinal(end, self.longitudinal.motion)
        return damped(out, added_damping) if added_damping else out

    def plucked_at(
        self, bases: Mapping[str, ModalBasis], stop: float, place: float | None, width: float
    ) -> dict[str, ModalBasis]:
        """Return bases of a stop with the point ``pluck`` elsewhere; `place` and `width` as those of `bases`."""
        pluck, width, out = self._pluck(stop, place), width or self.pluck_width, dict(bases)
        for name in (p.component for p in self.polarizations):
            out[name] = moved(bases[name], "pluck", pluck, width)
        return out

    def _pluck(self, stop: float, place: float | None) -> float:
        """Place of the pluck, m from the bridge; the usual one where none is given."""
        length = self.length(stop)
        pluck = min(self.pluck_from_bridge, 0.9 * length) if place is None else place
        if not 0 <= pluck <= length:
            raise ValueError(f"string {self.name} is {length:g} m long at stop {stop:g}; {pluck:g} m is not on it")
        return pluck

    def _with_points(self, end: float, here: Mapping[str, float], beyond: Sequence[str], width: float) -> ModalBasis:
        """Return the basis of a stop at a first guess of its tension with these points; the last ones are cached."""
        key = (end, tuple(here.items()), tuple(beyond), width)
        if key not in self._placed:
            if len(self._placed) >= _PLACED:
                del self._placed[next(iter(self._placed))]
            self._placed[key] = with_points(self._untuned(end), here, beyond, width)
        return self._placed[key]

    def under_damper(self, bases: Mapping[str, ModalBasis], share: float) -> dict[str, ModalBasis]:
        """Return bases of the string with a share of its damper's loss added; see `tonewood.physics.modal.damper`."""
        out = dict(bases)
        for name in (p.component for p in self.polarizations if self.damper is not None):
            basis = bases[name]
            key = basis.n_modes, cast(float, basis.metadata["length"])
            if key not in self._damper_rates:
                self._damper_rates[key] = damper_rates(basis, *(self.damper or (0.0, 0.0, 0.0)))
            rates = share * self._damper_rates[key]
            out[name] = retuned(basis, np.sqrt(basis.stiffness), basis.damping_rate + rates)
        return out

    def _detune(self, polarization: Polarization, stop: float) -> float:
        """Frequency ratio of a polarization to the first one at a stop."""
        if self._scatter is None or polarization is self.polarizations[0]:
            return polarization.detune
        return polarization.detune * ratio_of_cents(self._scatter(stop))

    def plane_cents(self, stop: float = 0) -> tuple[float, ...]:
        """Return the pitch of each polarization at a stop over the first one's, cents, as the bundle splits them."""
        return tuple(cents(self._detune(p, self._end(stop))) for p in self.polarizations)

    def n_modes(self, stop: float = 0) -> int:
        """Modes per polarization of a stop before tension raises any above the limit."""
        return self._untuned(self._end(stop)).n_modes

    def weights(self, angle_deg: float) -> dict[str, float]:
        """Share of each component in a force (or motion) at an angle from the first direction towards the second.

        The tilt is that of the string's principal axes: a force along the first direction as the bundle names it moves
        both polarizations where they are tilted.
        """
        angle = math.radians(angle_deg - self._tilt_deg)
        parts = (math.cos(angle), math.sin(angle))
        return {p.component: parts[i] for i, p in enumerate(self.polarizations)}

    def transfer(self, component: str, old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
        """Matrices that carry modal displacement and velocity from one stop's basis to another's."""
        self._own(component)
        if self._is_longitudinal(component):
            return string_transfer(old, new)
        if self.stopping.finger is not None:
            return laid_down(old, new)
        return self.resonator.transfer(old, new)

    def carried(
        self, component: str, old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats
    ) -> tuple[Floats, Floats]:
        """One motion, modal coordinates q and q', carried from one stop's basis to another's."""
        self._own(component)
        if self._is_longitudinal(component):
            same = old.metadata["length"] == new.metadata["length"]
            return (q, velocity) if same else string_carry(old, new, q, velocity)
        if self.stopping.finger is not None:
            displacement, moving = laid_down(old, new)
            return displacement @ q, moving @ velocity
        return self.resonator.carried(old, new, q, velocity)

    def _is_longitudinal(self, component: str) -> bool:
        return self.longitudinal is not None and component == self.longitudinal.component

    def _longitudinal(self, stop: float, motion: Longitudinal) -> ModalBasis:
        """Longitudinal modes at a stop, cached; bends do not change them."""
        if stop not in self._longitudinal_bases:
            if len(self._longitudinal_bases) >= _PASSING_STOPS:
                del self._longitudinal_bases[next(iter(self._longitudinal_bases))]
            self._longitudinal_bases[stop] = motion.basis(self._freq_limit, self.position(stop))
        return self._longitudinal_bases[stop]

    def _end(self, stop: float) -> float:
        """Stop that ends the modes of the string: 0 under a soft finger, which leaves the whole string in motion."""
        return stop if self.stopping.finger is None else 0.0

    def _under_finger(self, stop: float, finger: Finger) -> float:
        """Place of a soft finger for the pitch of a stop, m from the bridge.

        The ideal stop's compensation is a tension; here, where all stops share the open string's, it is a length, and
        between whole stops it is interpolated. A stiff string is bent across the finger, not hinged there, and speaks
        as if it were sqrt(EI/T) / 2 shorter: half of the shortening by a clamp.
        """
        length, tension = self.length(stop), self.tension(0.0)
        if self.stopping.compensate == "each_stop":
            low = math.floor(stop)
            share, ideal = stop - low, self._ideal_tension(low)
            if share > 0:
                ideal += share * (self._ideal_tension(low + 1) - ideal)
            length *= math.sqrt(tension / ideal)
        stiffness = self._untuned(0.0).metadata.get("bending_stiffness", 0.0)
        bent = math.sqrt(cast(float, stiffness) / tension) / 2
        return length + bent - tension * compliance(finger, self.freq(stop)).real

    def _left_under_finger(self, stop: float) -> float | None:
        """Residual compliance of the string under a soft finger, m/N; None on the open string."""
        finger = self.stopping.finger
        if finger is None or stop == 0:
            return None
        x, left = self._under_finger(stop, finger), self._untuned(0.0).residual_at
        return 0.0 if left is None else float(left(x, x))

    def _ideal_tension(self, stop: int) -> float:
        return self._tune(float(stop))[1]

    def _own(self, component: str) -> None:
        if component not in self.components:
            raise ValueError(f"string {self.name} has the components {', '.join(self.components)}, not {component!r}")

    def _untuned(self, stop: float) -> ModalBasis:
        """Basis of a stop at a first guess of its tension, cached; `detuned` takes it to any other tension."""
        if stop not in self._bases:
            # the open string's tension, once known, is the best guess for every stop
            guess = self._tuned[0.0][1] if stop > 0.0 and 0.0 in self._tuned else self._first_guess()
            basis = self.resonator.basis(self.freq_upper, stop=self.position(stop), tension=guess)
            if basis.n_modes < 2:  # a single mode moves with the bridge: a string held there would have none
                raise self.resonator.fault(
                    f"{self.freq_upper:g} Hz leave {basis.n_modes} of the modes at stop {stop:g}; "
                    f"{self.freq(stop):.2f} Hz need 2 or more: raise freq_upper, or the sampling rate",
                    "freq_upper",
                )
            bridge = basis.index("bridge")
            residual = basis.residual.copy()
            residual[bridge, bridge] += self._end_compliance
            passing = [s for s in self._bases if s != int(s)]
            if len(passing) >= _PASSING_STOPS:
                del self._bases[passing[0]]
            self._bases[stop] = replace(basis, residual=residual)
        return self._bases[stop]

    def _first_guess(self) -> float:
        """Tension of a rigidly held string of this pitch: f is proportional to the root of the tension."""
        if self._kept is not None and self.name in self._kept.known:
            return self._kept.known[self.name][0]
        nominal = self.resonator.tension
        if self._tension_held or self.stopping.compensate == "none":
            return nominal
        freq = held_freq(self.resonator.basis(min(self.freq_upper, 12 * self.freq(0)), tension=nominal))
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
        if stop not in self._gains:
            base, tension, trial = self._untuned(stop), self.tension(stop), 50.0
            pair = (self.resonator.detuned(base, t) for t in (tension, tension * ratio_of_cents(trial) ** 2))
            low, high = (held_freq(basis) for basis in pair)
            self._gains[stop] = 1.0 if low is None or high is None else trial / cents(high / low)
        return self._gains[stop]

    def _tune(self, stop: float) -> tuple[TunedStop | None, float]:
        stop = float(stop)
        if stop not in self._tuned:
            how = self.stopping.compensate
            if how == "none":
                self._tuned[stop] = (None, self.resonator.tension)
            elif stop == 0 and self._tension_held:
                self._tuned[stop] = (self._as_it_stands(stop), self.resonator.tension)
            elif how == "open_only" and stop > 0:
                tension = self.tension(0.0)
                self._tuned[stop] = (self.under(tension, stop), tension)
            else:
                if stop == 0 and self._kept is not None and self.name in self._kept.known:
                    found = self._kept.known[self.name][1]
                    self._tuned[stop] = (found, found.tension)
                    return self._tuned[stop]
                guess = self.tension(0.0) if stop > 0 else self._first_guess()
                try:
                    found = tune(self.coupled(stop), self.freq(stop), guess)
                except ValueError as fault:
                    raise self._without_mode(stop, str(fault)) from None
                self._tuned[stop] = (found, found.tension)
                if stop == 0 and self._kept is not None:
                    self._kept.add(self.name, guess, found)
        return self._tuned[stop]

    def _without_mode(self, stop: float, reason: str) -> BundleError:
        return self.resonator.fault(f"at stop {stop:g}: {reason}", "note")


def held_freq(basis: ModalBasis) -> float | None:
    """Lowest frequency (Hz) of a string held at its bridge, where the compliance of its free end vanishes.

    It lies an octave above the lowest one with the bridge free, or little more; None if it is not found there.
    """
    ports = Ports.of(basis, np.eye(len(basis.points))[[basis.index("bridge")]])
    octave = 2 * math.sqrt(float(basis.stiffness.min()))
    zero = Joint([ports]).newton(octave * complex(-1e-5, 1.0), steps=80)
    return None if zero is None else zero.imag / (2 * math.pi)
