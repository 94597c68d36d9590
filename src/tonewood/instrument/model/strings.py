"""A string of an assembled instrument: its components, what touches it, and its motion from stop to stop."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

from tonewood.instrument.contract.attached import Attached, Site
from tonewood.instrument.contract.base import Attachment, Exciter, StringMotion
from tonewood.instrument.model.finger import POINT, fingertips, laid_down
from tonewood.instrument.model.string_bases import StringBases, StringPlaces
from tonewood.instrument.model.string_setup import LongitudinalMotion, Polarization
from tonewood.instrument.model.string_tuning import StringTuning
from tonewood.instrument.model.tuning import TunedStop
from tonewood.physics.coupling.connections import Connection
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_transfer import string_carry, string_transfer
from tonewood.support.arrays import Floats


class StringModel:
    """One string; immutable but for what its parts keep of their results.

    name : of the string.
    open_note : note number of the open string.
    tuning : geometry (`tuning.stops`), tensions and coupled modes of its stops.
    resonator : its plugin.
    polarizations : one or two; the first is the one kept when effects are left out.
    stopping, n_stops : its stops, and the highest; 0 for a string that is only played open.
    places : of pluck, damper and named points on it.
    modes : its bases at every stop, bend and damping.
    longitudinal : its longitudinal motion, if that is stepped.
    potentials : energies that it stores beside those of its modes, those that are left out among them.
    group : strings that a note on the first of them plays together; itself among them.
    touching : attachments and exciters that may add parts to it, by name.
    freq_limit : Hz, no mode is stepped above it.
    tilt_deg : of its principal axes.
    end_shares : body point -> share of its displacement in that of the string's end along the string.
    """

    def __init__(
        self,
        name: str,
        tuning: StringTuning,
        places: StringPlaces,
        *,
        open_note: float,
        freq_limit: float,
        tilt_deg: float,
        touching: Mapping[str, Attachment[Any] | Exciter[Any]] | None = None,
        longitudinal: LongitudinalMotion | None = None,
        end_shares: Mapping[str, float] | None = None,
        group: tuple[str, ...] = (),
    ):
        self.name, self.open_note, self.tuning, self.places = name, open_note, tuning, places
        self.resonator, self.polarizations = tuning.resonator, tuning.untuned.polarizations
        self.stopping, self.n_stops = tuning.stops.stopping, tuning.stops.count
        self.longitudinal = longitudinal
        planes, lengthwise = (
            tuple(p.component for p in self.polarizations),
            longitudinal.component if longitudinal else None,
        )
        self.potentials = tuple(
            self.resonator.potentials(StringMotion(name, planes, lengthwise, dict(end_shares or {})))
        )
        self.group, self._of_key = group or (name,), bool(group)
        self.touching, self._tilt_deg = dict(touching or {}), tilt_deg
        self.modes = StringBases(tuning, places, longitudinal, freq_limit)
        self._attached: dict[float, tuple[Attached, ...]] = {}

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its components in the system, the first polarization first, longitudinal motion last."""
        return tuple(p.component for p in self.ends)

    @property
    def ends(self) -> tuple[Polarization | LongitudinalMotion, ...]:
        """Motions that are joined to the bridge: polarizations, then longitudinal motion."""
        return (*self.polarizations, *([self.longitudinal] if self.longitudinal else []))

    def for_live(self) -> StringModel:
        """Return the string with tensions between whole stops from a table, see `StringTuning.interpolated`."""
        tuning = self.tuning.interpolated()
        if tuning is self.tuning:
            return self
        other = copy(self)
        other.tuning, other._attached = tuning, {}
        other.modes = self.modes.tuned_by(tuning)
        return other

    def freq(self, stop: float = 0) -> float:
        """Return the pitch that a stop should sound, Hz."""
        return self.tuning.freq(stop)

    def tension(self, stop: float = 0) -> float:
        """Return the tension of the first polarization at a stop, N."""
        return self.tuning.tension(stop)

    def tuned(self, stop: float = 0) -> TunedStop:
        """Return tension and coupled modes of a stop."""
        return self.tuning.tuned(stop)

    def length(self, stop: float = 0) -> float:
        """Return the speaking length at a stop, m."""
        return self.tuning.stops.length(stop)

    def site(self, stop: float = 0) -> Site:
        """Geometry of the string at a stop, for attachments and exciters."""
        stops = self.tuning.stops
        polarizations = tuple((p.component, p.direction) for p in self.polarizations)
        group = self.group if self._of_key else ()
        return Site(self.name, stops.open_length, stops.length(stop), stops.lengths, polarizations, group)

    def attached(self, stop: float = 0) -> tuple[Attached, ...]:
        """Places, components and connections that attachments, exciters and a finger add to the string at a stop."""
        if stop not in self._attached:
            site = self.site(stop)
            # pairs: an exciter may have the name of the soft finger
            parts = [(name, part.attach(name, site)) for name, part in self.touching.items()]
            self._check_places([a for _, a in parts])
            if self.stopping.finger is not None:
                parts.append((POINT, fingertips(self.stopping.finger, site, stopped=stop != 0)))
            self._attached[stop] = tuple(a.owned_by(self.name, part) for part, a in parts if a is not None)
        return self._attached[stop]

    def _check_places(self, parts: Sequence[Attached | None]) -> None:
        """Refuse places that the open string does not have, and names of points that are there already."""
        taken, longest = {"bridge", "pluck", *self.places.points}, self.tuning.stops.open_length
        for plugin, part in zip(self.touching.values(), parts, strict=True):
            for point, x in {} if part is None else part.places.items():
                who = f"{type(plugin).__name__}.attach puts {point!r} on string {self.name}"
                if point in taken:
                    raise plugin.fault(f"{who}, which has a point of this name; names begin with the part's")
                if not 0.0 <= x <= longest:
                    raise plugin.fault(f"{who} {x:g} m from the bridge; 0 to {longest:g} m are allowed")
                taken.add(point)

    def connections(self, stop: float = 0) -> tuple[Connection, ...]:
        """Connections of `attached`; at every stop the same ones, with laws that may differ."""
        return tuple(c for a in self.attached(stop) for c in a.connections)

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

        stop : 0 is open; a fraction on a continuous string.
        bend_cents : change of pitch by a change of tension.
        added_damping : 1/s, added to every mode's damping rate.
        pluck_from_bridge : m; the string's usual place where left out. Must lie on the speaking part.
        pluck_width : m, of the string about that place over which the point ``pluck`` is a mean; 0 for the usual one.
        touches : point that a part attaches to the string -> m, in place of the part's own place.
        whole : keep also modes that the tension has raised above the limit.
        """
        attached = {name: x for a in self.attached(stop) for name, x in a.places.items()} | dict(touches or {})
        return self.modes.at(
            stop,
            attached,
            bend_cents=bend_cents,
            added_damping=added_damping,
            pluck_from_bridge=pluck_from_bridge,
            pluck_width=pluck_width,
            whole=whole,
        )

    def n_modes(self, stop: float = 0) -> int:
        """Modes per polarization of a stop before tension raises any above the limit."""
        return self.tuning.base(self.tuning.stops.end(stop)).n_modes

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
        if self._is_longitudinal(component):
            return string_transfer(old, new)
        if self.stopping.finger is not None:
            return laid_down(old, new)
        return self.resonator.transfer(old, new)

    def carried(
        self, component: str, old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats
    ) -> tuple[Floats, Floats]:
        """One motion, modal coordinates q and q', carried from one stop's basis to another's."""
        if self._is_longitudinal(component):
            same = old.metadata["length"] == new.metadata["length"]
            return (q, velocity) if same else string_carry(old, new, q, velocity)
        if self.stopping.finger is not None:
            displacement, moving = laid_down(old, new)
            return displacement @ q, moving @ velocity
        return self.resonator.carried(old, new, q, velocity)

    def _is_longitudinal(self, component: str) -> bool:
        if component not in self.components:
            raise ValueError(f"string {self.name} has the components {', '.join(self.components)}, not {component!r}")
        return self.longitudinal is not None and component == self.longitudinal.component
