"""The plugin contract, version 1: the classes that parts of an instrument derive from.

A plugin is a class with parameters and formulas. It owns nothing that moves and never runs inside the sample loop:
before a render it is asked for arrays (modal bases, pieces of force, rows to read), and the engine does the rest.

====================  ==================================================================================
`Resonator`           a string: modal bases for every stop and tension, and the maps of motion between them
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
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import BundleError
from tonewood.instrument.contract.attached import Attached, Site
from tonewood.instrument.contract.contract_checks import CHECKS, check_results
from tonewood.instrument.contract.effects import BODY_MODES, OUTPUTS, SECOND_POLARIZATION, Effect
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.system import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.views import SHOWN_TO, ModalViews
from tonewood.support.params import Parameters, Vector, validated
from tonewood.support.tables import properties_html

if TYPE_CHECKING:
    from tonewood.physics.plate.radiation import Sources

API = 1

Floats = NDArray[np.float64]
P = TypeVar("P", bound=Parameters)


class Plugin(ABC, Generic[P]):
    """Base of all kinds.

    Parameters
    ----------
    parameters : already checked against `Parameters`.
    files : the bundle's folder, for tables.
    key : of the part in the bundle, e.g. ``strings.E2``, for errors.
    """

    #: version of this contract the plugin was written for
    api: ClassVar[int] = API
    #: the kind's name, set by the base classes here
    kind: ClassVar[str]
    #: effects of the plugin that a render may leave out
    effects: ClassVar[tuple[Effect, ...]] = ()
    #: pydantic model of the keys the plugin takes in a bundle
    Parameters: ClassVar[type[Parameters]]

    def __init_subclass__(cls, **options: Any):
        """Check the results of the methods that the class defines; see `contract_checks`."""
        super().__init_subclass__(**options)
        check_results(cls, CHECKS.get(getattr(cls, "kind", ""), {}), lambda plugin, reason: plugin.fault(reason))

    def __init__(self, parameters: P, files: Files, key: str = ""):
        self.parameters = parameters
        self.files = files
        self.key = key

    @classmethod
    def from_values(cls, values: Mapping[str, Any], files: Files | None = None, key: str = "") -> Plugin[P]:
        """Make one from plain values, as they stand in a bundle.

        Parameters
        ----------
        values : name of a parameter -> value.
        files : folder of the bundle, for tables; none by default.
        key : of the part in the bundle, for errors.

        Raises
        ------
        BundleError : a value is unknown, missing or out of range.
        """
        files = files or Files(None)
        return cls(validated(cls.Parameters, values, key=key, file=files.manifest), files, key)  # type: ignore[arg-type]  # Parameters of this very class

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.key or self.kind})"

    def _repr_html_(self) -> str:
        heading = f"{type(self).__name__}, {self.kind} {self.key}".rstrip()
        return properties_html(heading, self.parameters.model_dump(mode="json", by_alias=True))

    @property
    def name(self) -> str:
        """Name of the part in the bundle: the last word of its key."""
        return self.key.rpartition(".")[2]

    def fault(self, reason: str, key: str = "") -> BundleError:
        """Return an error with this reason that names the bundle's file and the part's key, and a `key` below it."""
        return BundleError(reason, file=self.files.manifest, key=".".join(k for k in (self.key, key) if k))


@dataclass(frozen=True, slots=True)
class Longitudinal:
    """Motion along a string, stepped with the transverse one; see `tonewood.physics.coupling.potentials.longitudinal`.

    Attributes
    ----------
    basis : highest frequency (Hz) and stop (m from the nut) -> modes along the string with its bridge end free, made by
        `ta.string_basis` with EA as tension.
    bridge_leverage : displacement of the string's end towards the nut per displacement of the body's point, in
        addition to the projection on the inclined string.
    """

    basis: Callable[[float, float], ModalBasis]
    bridge_leverage: float


@dataclass(frozen=True, slots=True)
class StringMotion:
    """Components of a string in the system, for its potentials.

    Attributes
    ----------
    name : of the string: that of its potential, or the beginning of it.
    planes : components of its polarizations.
    longitudinal : component of its longitudinal motion; None where that is not stepped.
    end_shares : body point -> share of its displacement in that of the string's end along the string.
    """

    name: str
    planes: tuple[str, ...]
    longitudinal: str | None
    end_shares: Mapping[str, float]

    def onto_body(self, leverage: float = 0.0) -> tuple[tuple[str, str, float], ...]:
        """Return (component, point, share), ...: on which a tension at the bridge acts, times the share.

        Parameters
        ----------
        leverage : share added at the point that moves most along the string, which turns about the bridge.
        """
        return tuple(("body", point, share) for point, share in levered(self.end_shares, leverage).items())


def levered(end_shares: Mapping[str, float], leverage: float) -> dict[str, float]:
    """Return shares of body points in the motion along a string, `leverage` added to the largest one."""
    shares = dict(end_shares)
    shares[max(shares, key=lambda point: abs(shares[point]))] += leverage
    return {point: share for point, share in shares.items() if abs(share) > 1e-12}


class Resonator(Plugin[P]):
    """A string in one polarization: held at the nut or a stop, moved by a body at the bridge.

    Places are metres from the bridge, so that they stay true when the string is stopped.
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

    @abstractmethod
    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ModalBasis:
        """Return the modes of the string with its bridge end free.

        Parameters
        ----------
        freq_upper : Hz, highest natural frequency wanted.
        stop : m from the nut to the stop, 0 for the open string.
        tension : N, instead of the string's own.

        Returns
        -------
        Mass-normalised real modes with the point ``bridge`` and a shape for every place from 0 to the speaking length.
        """

    @abstractmethod
    def detuned(self, basis: ModalBasis, tension: float) -> ModalBasis:
        """Return `basis` (one of this string's) at another tension: same shapes, new frequencies and losses."""

    def decay_rate(self, freq_rad: Floats, tension: float) -> Floats | None:
        """Return the law of loss, with which `tonewood check` compares; None where the bases say how they meet it.

        Bases of `ta.string_basis` and `ta.with_partial_decays` say so: ``loss_error`` in their metadata.

        Parameters
        ----------
        freq_rad : (n,) rad/s, of partials between fixed ends.
        tension : N.

        Returns
        -------
        (n,) 1/s, sigma of each partial.
        """
        return None

    @abstractmethod
    def transfer(self, old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
        """Carry the string's motion from one stop to another.

        Parameters
        ----------
        old, new : bases of this string at two stops, or at two tensions.

        Returns
        -------
        displacement, velocity : (n_new, n_old), q_new = displacement @ q_old and q_new' = velocity @ q_old' of the
        modal coordinates q, y = sum phi q. Must keep the bridge's displacement and never raise the energy.
        """

    def carried(self, old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Return one motion carried from one stop to another; override it where that is faster.

        Parameters
        ----------
        old, new : as for `transfer`.
        q, velocity : (n_old,) coordinates and their rates.
        """
        displacement, moving = self.transfer(old, new)
        return displacement @ q, moving @ velocity


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
    readouts : one per channel, in order.
    components : one-way components of its own, short name -> basis.
    drives : forces of connections that drive these components.
    body_inputs : body point -> (component, point, factor): inputs that a known force on that point drives, too.
    """

    readouts: tuple[Readout, ...]
    components: Mapping[str, ModalBasis] = field(default_factory=dict)
    drives: tuple[Drive, ...] = ()
    body_inputs: Mapping[str, tuple[tuple[str, str, float], ...]] = field(default_factory=dict)


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
KINDS: dict[str, type[Plugin[Any]]] = {c.kind: c for c in (Resonator, Body, Exciter, Attachment, Pickup)}


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the scalar product of two directions `a` and `b`; 0 if it is below 1e-12."""
    value = math.fsum(x * y for x, y in zip(a, b, strict=True))
    return 0.0 if abs(value) < 1e-12 else value
