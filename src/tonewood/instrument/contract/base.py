"""The plugin contract, version 1: the classes that parts of an instrument derive from.

A plugin is a class with parameters and formulas. It owns nothing that moves and never runs inside the sample loop:
before a render it is asked for arrays (modal bases, pieces of force, rows to read), and the engine does the rest.

====================  ==================================================================================
`Resonator`           a string: its length, tension, mass, stiffness and loss, from which its modes at every stop and
                      tension follow, and the maps of motion between them
`Loss`                a law of loss for strings: one formula (`losses`)
`Body`                the body that strings are joined to: one modal basis with named points
`Exciter`             gestures: known forces in time, and a finger's dashpot on the string meanwhile; an exciter that
                      reacts adds masses and contacts of its own
`Attachment`          frets, a curved bridge, loose parts: contacts and masses on strings
`Pickup`              channels of sound: quantities read at points, or a one-way modal bank
====================  ==================================================================================

A plugin is found by its entry point in the group ``tonewood.plugins``; the entry point's name is the word that a
bundle writes after ``plugin:``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tonewood.instrument.contract.attached import Attached, Site
from tonewood.instrument.contract.conversion import Conversion
from tonewood.instrument.contract.effects import BODY_MODES, OUTPUTS, SECOND_POLARIZATION, Effect
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.contract.losses import Loss
from tonewood.instrument.contract.plugin import API, P, Plugin
from tonewood.instrument.contract.string_motion import Longitudinal, StringMotion, levered
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.system import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.partial_decays import string_detuned
from tonewood.physics.modal.string_modes import string_basis, wavenumber
from tonewood.physics.modal.string_transfer import string_carry, string_transfer
from tonewood.physics.modal.views import SHOWN_TO, ModalViews
from tonewood.support.arrays import Floats
from tonewood.support.params import Vector, validated

if TYPE_CHECKING:
    from tonewood.physics.plate.radiation import Sources


class Resonator(Plugin[P]):
    """A string in one polarization: held at the nut or a stop, moved by a body at the bridge.

        mu u_tt + loss = T u_xx - EI u_xxxx + f(x, t),      u(0, t) the bridge's motion,  u(L - stop, t) = 0

    A uniform string states `length`, `tension`, `linear_density`, `bending_stiffness` and `loss`; its modes and the
    maps of motion between stops follow. A string that is not uniform overrides `basis`, `detuned` and `transfer`, all
    three. Places are metres from the bridge, so that they stay true when the string is stopped; stops are metres from
    the nut.
    """

    kind = "resonator"
    effects: ClassVar[tuple[Effect, ...]] = (SECOND_POLARIZATION,)

    @property
    @abstractmethod
    def length(self) -> float:
        """Speaking length of the open string, m."""

    @property
    @abstractmethod
    def tension(self) -> float:
        """Tension of the open string before tuning, N."""

    @property
    def linear_density(self) -> float:
        """Mass per length, kg/m; 0 where it is not uniform and the string makes modes of its own."""
        return 0.0

    @property
    def bending_stiffness(self) -> float:
        """EI, N m^2; 0 for a string without stiffness."""
        return 0.0

    def loss(self, omega: Floats, k: Floats, tension: float) -> Floats:
        """Return the loss factor eta = 2 sigma / omega of partials between fixed ends; often a `Loss` has it.

        Parameters
        ----------
        omega : (n,) rad/s, above 0, of the partials without loss.
        k : (n,) 1/m, their wavenumbers.
        tension : N; the tuner and bends change it.

        Returns
        -------
        (n,) or a single number, 0 or more.
        """
        raise NotImplementedError  # a string that makes its own modes needs no law

    @property
    def longitudinal(self) -> Longitudinal | None:
        """Longitudinal motion that is a component of its own, joined to the body; a potential couples it."""
        return None

    def potentials(self, string: StringMotion) -> Sequence[Potential]:
        """Return energies that the string stores beside those of its modes; none by default.

        Parameters
        ----------
        string : its components in the system.

        Returns
        -------
        One potential at most for each component: `ta.TensionModulation`, `ta.GeometricStretch`,
        `ta.DrivenLongitudinal`, or a `ta.ModalPotential` of one's own.
        """
        return ()

    @classmethod
    def left_out(cls) -> list[str]:
        """Return what the class must define and does not: the physics of a uniform string, or modes of its own."""

        def missing(names: Sequence[str]) -> list[str]:
            return [name for name in names if getattr(cls, name) is getattr(Resonator, name)]

        physics, modes = missing(_PHYSICS), missing(_MODES)
        needed = [] if not (physics and modes) else physics if "basis" in modes else modes
        return [*super().left_out(), *needed]

    def __init__(self, parameters: P, files: Files, key: str = ""):
        if left_out := self.left_out():  # as an abstract method of Python's would
            raise TypeError(f"{type(self).__name__} leaves out {', '.join(left_out)}")
        super().__init__(parameters, files, key)

    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ModalBasis:
        """Return the modes of the string with its bridge end free: all below `freq_upper`, by `ta.string_basis`.

        Parameters
        ----------
        freq_upper : Hz, highest natural frequency wanted.
        stop : m from the nut to the stop, 0 for the open string.
        tension : N, instead of the string's own.

        Returns
        -------
        Mass-normalised real modes with the point ``bridge`` and a shape for every place from 0 to the speaking length.

        Raises
        ------
        BundleError : more than 3000 modes, or none, lie below `freq_upper`.
        """
        actual, length = self.tension if tension is None else tension, self.length - stop
        density, stiffness = self.linear_density, self.bending_stiffness
        try:
            return string_basis(
                length, actual, density, stiffness, lambda w, k: self.loss(w, k, actual), freq_upper=freq_upper
            )
        except ValueError as fault:
            raise self.fault(str(fault)) from None

    def detuned(self, basis: ModalBasis, tension: float) -> ModalBasis:
        """Return a basis at another tension, as a bend or the tuner changes it: same shapes, by `ta.string_detuned`.

            omega^2 = T a_k + EI b_k

        The change of the shapes, which only bending stiffness causes, is left out: a tension raised by 50 cents raises
        the partials of a classical guitar's strings by 0.08 to 0.2 cent less, all nearly alike. Decay rates follow
        `loss` from the old frequency of each mode to its new one: on a classical guitar 200 cents leave those of
        partials on a rigid end within 0.6 % of the law.

        Parameters
        ----------
        basis : one of this string's, at any stop.
        tension : N.
        """
        return string_detuned(basis, tension, self.loss)

    def decay_rate(self, freq_rad: Floats, tension: float) -> Floats | None:
        """Return the law of loss, with which `tonewood check` compares; None where `loss` is not stated.

            sigma = omega eta(omega, k, T) / 2

        Parameters
        ----------
        freq_rad : (n,) rad/s, of partials between fixed ends.
        tension : N.

        Returns
        -------
        (n,) 1/s, sigma of each partial.
        """
        if type(self).loss is Resonator.loss or not self.linear_density > 0.0:
            return None
        k = wavenumber(freq_rad, tension, self.linear_density, self.bending_stiffness)
        return np.asarray(freq_rad * self.loss(freq_rad, k, tension) / 2, dtype=np.float64)

    def transfer(self, old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
        """Carry the string's motion from one stop to another, by `ta.string_transfer`.

        Parameters
        ----------
        old, new : bases of this string at two stops, or at two tensions.

        Returns
        -------
        displacement, velocity : (n_new, n_old), q_new = displacement @ q_old and q_new' = velocity @ q_old' of the
        modal coordinates q, y = sum phi q. Must keep the bridge's displacement and never raise the energy.
        """
        return string_transfer(old, new)

    def carried(self, old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Return one motion carried from one stop to another, as `transfer` would; override it where that is faster.

        Parameters
        ----------
        old, new : as for `transfer`.
        q, velocity : (n_old,) coordinates and their rates.
        """
        if type(self).transfer is Resonator.transfer:
            return string_carry(old, new, q, velocity)
        displacement, moving = self.transfer(old, new)
        return displacement @ q, moving @ velocity


#: what a uniform string states, and what a string of its own modes does
_PHYSICS, _MODES = ("linear_density", "loss"), ("basis", "detuned", "transfer")


@dataclass(frozen=True, slots=True)
class BodyPoint:
    """A named place of a body.

    Attributes
    ----------
    direction : unit vector along which the point's displacement is counted (x nut to bridge, y to treble, z out).
    coordinates : of the point, with names of the body's plugin, e.g. ``u`` along the bridge.
    driven : whether strings may end and exciters may push here; False for a point that is only read.
    """

    direction: Vector
    coordinates: Mapping[str, float] = field(default_factory=dict)
    driven: bool = True


class Body(Plugin[P], ModalViews):
    """The body that strings are joined to; with tables and figures of its modes."""

    kind = "body"
    effects: ClassVar[tuple[Effect, ...]] = (BODY_MODES,)
    #: numbers in place of its parameters that make a coarse basis within half a second: `tonewood desk` plays it until
    #: the exact one is made; none where that takes no longer
    preview: ClassVar[Mapping[str, float]] = {}

    @abstractmethod
    def basis(self, freq_upper: float) -> ModalBasis:
        """Return the modes below `freq_upper` (Hz); the static compliance of the others goes into the residual.

        Real modes may have ``radiated`` in their metadata, (n_modes,) share of each mode's loss that is sound: accounts
        of energy then have an entry ``body.sound``.
        """

    @abstractmethod
    def points(self) -> Mapping[str, BodyPoint]:
        """Return every point of the basis with its direction."""

    def potentials(self, component: str) -> Sequence[Potential]:
        """Return energies that the body stores beside those of its modes, which must then be real; none by default.

        Parameters
        ----------
        component : of the body in the system.
        """
        return ()

    def sources(self, freq_upper: float) -> Sources | None:
        """Return volume sources of the modes of ``basis(freq_upper)``, in its order; None where they are not known."""
        return None

    def mass(self) -> float | None:
        """Return the mass of the plates with all that is glued to them, kg; None where it is not known."""
        return None

    def facts(self) -> Sequence[str]:
        """Return lines about the body for `tonewood modes`; none by default."""
        return ()

    def _viewed(self) -> tuple[ModalBasis, Mapping[str, str]]:
        basis = self.basis(SHOWN_TO)
        return basis, {point: point for point in basis.points}


class Exciter(Plugin[P]):
    """Turns each event into a gesture."""

    kind = "exciter"

    @property
    def at(self) -> str | None:
        """``component.point`` that it always acts on; None if it acts on the string of the event."""
        return None

    @property
    def recovery(self) -> float:
        """Time that it needs between the end of an event and the next event on the same string, s.

        A note that is followed at once ends earlier by this time, at most by half of its duration: a key has to rise
        before it can be struck again.
        """
        return 0.0

    def adjusted(self, values: Mapping[str, float]) -> P:
        """Return the parameters with an event's values in place of the bundle's.

        Raises
        ------
        BundleError : a value is out of its range, or of a parameter this exciter does not have.
        """
        if not values:
            return self.parameters
        merged = {**self.parameters.model_dump(by_alias=True), **values}
        return validated(type(self.parameters), merged, key=self.key, file=self.files.manifest)

    def attach(self, name: str, site: Site) -> Attached | None:
        """Return components and connections that it adds to a string: a hammer's mass and felt, a bow's hair.

        They act on the string's point ``pluck``, which follows the place of the gesture. None for known forces alone.

        Parameters
        ----------
        name : of the part in the bundle; names of components and connections begin with ``STRING.name``.
        site : geometry of the string at one stop.
        """
        return None

    @abstractmethod
    def gesture(self, event: Event, place: Place) -> Gesture:
        """Return the forces of one event.

        Parameters
        ----------
        event : values that it changes, pitch, duration, stops.
        place : string with its length and tension at this stop, or point of the body.
        """


class Attachment(Plugin[P]):
    """Adds contacts and masses to strings: frets, a curved bridge, loose parts."""

    kind = "connection"

    @abstractmethod
    def attach(self, name: str, site: Site) -> Attached:
        """Return places, components and connections on a string at a stop.

        Parameters
        ----------
        name : the part's key in the bundle.
        site : geometry of the string at this stop. At every stop the same names and terms; laws may differ.
        """


@dataclass(frozen=True, slots=True)
class BridgeForce:
    """Force of a string's end, or of something added to the body, on one point of the body.

    Attributes
    ----------
    connection : its name in the system.
    point : the body's point.
    factor : force on the body along the point's direction per connection force.
    """

    connection: str
    point: str
    factor: float


@dataclass(frozen=True)
class Scene:
    """Points and forces of an assembled instrument that a pickup can read.

    Attributes
    ----------
    body_points : name -> place and direction.
    bridge_forces : of every string polarization that moves the body, and of the parts added to the body.
    string_points : ``string.point`` -> (component, point, unit vector of that polarization), for each polarization.
    end_forces : string -> (connection, unit vector): force of the string on its bridge is minus the connection's.
    freq_upper : Hz, highest frequency that will be stepped.
    body : plugin of the body, for pickups that hear its whole surface.
    """

    body_points: Mapping[str, BodyPoint]
    bridge_forces: tuple[BridgeForce, ...]
    string_points: Mapping[str, tuple[tuple[str, str, Vector], ...]]
    end_forces: Mapping[str, tuple[tuple[str, Vector], ...]]
    freq_upper: float
    body: Body[Any] | None = None


@dataclass(frozen=True)
class PickupRows:
    """Readouts and components that a pickup adds to the system.

    Attributes
    ----------
    readouts : one per channel, in order; any number where the conversion has a function.
    components : one-way components of its own, short name -> basis.
    drives : forces of connections that drive these components.
    body_inputs : body point -> (component, point, factor): inputs that a known force on that point drives, too.
    conversion : of readouts to channels, outside of the step; None: channels are readouts.
    """

    readouts: tuple[Readout, ...]
    components: Mapping[str, ModalBasis] = field(default_factory=dict)
    drives: tuple[Drive, ...] = ()
    body_inputs: Mapping[str, tuple[tuple[str, str, float], ...]] = field(default_factory=dict)
    conversion: Conversion | None = None


class Pickup(Plugin[P]):
    """A group of output channels."""

    kind = "pickup"
    effects: ClassVar[tuple[Effect, ...]] = (OUTPUTS,)

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in order."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the quantity read."""

    @abstractmethod
    def rows(self, name: str, scene: Scene) -> PickupRows:
        """Return the readouts of the channels.

        Parameters
        ----------
        name : of the group of channels; the name of every component added begins with it.
        scene : points and forces that can be read.
        """


#: kind -> base class; a plugin derives from exactly one of them
KINDS: dict[str, type[Plugin[Any]]] = {c.kind: c for c in (Resonator, Loss, Body, Exciter, Attachment, Pickup)}


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the scalar product of two directions `a` and `b`; 0 if it is below 1e-12."""
    value = math.fsum(x * y for x, y in zip(a, b, strict=True))
    return 0.0 if abs(value) < 1e-12 else value


__all__ = [
    "API",
    "KINDS",
    "Attachment",
    "Body",
    "BodyPoint",
    "BridgeForce",
    "Exciter",
    "Longitudinal",
    "Loss",
    "Pickup",
    "PickupRows",
    "Plugin",
    "Resonator",
    "Scene",
    "StringMotion",
    "dot",
    "levered",
]
