"""Places, components and connections that attachments and exciters add to a string: plain data.

The methods `attach` of both kinds of plugins return it. Every name in it begins with the names of the string and of the
part, ``STRING.PART.``, so that names are unique.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from numpy.typing import ArrayLike

from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import Segment, course
from tonewood.support.arrays import Floats
from tonewood.support.params import Vector


@dataclass(frozen=True, slots=True)
class Site:
    """Geometry of a string at one stop, for attachments and exciters.

    Attributes
    ----------
    string : its name.
    open_length : m, nut to bridge.
    length : m, of the speaking part at this stop.
    stops : m from the bridge, place of every whole stop; the first is the nut.
    polarizations : component and unit vector of each plane of motion, tilt included.
    group : strings that one note plays together, the one that gives the pitch first; empty for a string by itself.
    """

    string: str
    open_length: float
    length: float
    stops: tuple[float, ...]
    polarizations: tuple[tuple[str, Vector], ...]
    group: tuple[str, ...] = ()

    @property
    def leader(self) -> str:
        """The string on which a note plays all of the group."""
        return self.group[0] if self.group else self.string

    def motion(self, point: str, direction: Vector, factor: float = 1.0) -> tuple[Term, ...]:
        """Return the terms of a gap for the displacement of a point of the string along a direction, times `factor`.

        Parameters
        ----------
        point : name of a place on the string.
        direction : unit vector (x nut to bridge, y to treble, z out).
        """
        shares = ((c, sum(a * b for a, b in zip(p, direction, strict=True))) for c, p in self.polarizations)
        return tuple(Term(c, point, factor * share) for c, share in shares if abs(share) > 1e-12)

    def lowered(self, x: float, clearance: Callable[[float], float]) -> float:
        """Return the clearance under the string x metres from the bridge when it is pressed down at its stop, m.

        `clearance` is the one under the open string. The stopped string is straight from the bridge to where its stop
        lies: c(x) - c(l) x / l.
        """
        if self.length >= self.open_length:
            return clearance(x)
        return clearance(x) - clearance(self.length) * x / self.length


@dataclass(frozen=True)
class Attached:
    """Places, components and connections that a part adds to one string.

    Attributes
    ----------
    places : point on the string -> m from the bridge. Points beyond the speaking part do not move: a fret behind the
        stop is out of play.
    components : masses of its own.
    connections : between points of the string, of these components, and the ground. At every stop a part must return
        the same ones, in name and terms; their laws may differ.
    inputs : name -> (component, point, factor), ...: points that the forces of a gesture act on which names the input.
    resting : connections that act only while a gesture moves them, and cost nothing at other times.
    """

    places: Mapping[str, float] = field(default_factory=dict)
    components: Mapping[str, ModalBasis] = field(default_factory=dict)
    connections: tuple[Connection, ...] = ()
    inputs: Mapping[str, tuple[tuple[str, str, float], ...]] = field(default_factory=dict)
    resting: tuple[str, ...] = ()

    def owned_by(self, string: str, part: str) -> Attached:
        """Return the same with the string and the part named in every connection."""
        marked = tuple(replace(c, role="attached", owner=string, part=part) for c in self.connections)
        return replace(self, connections=marked)


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of a nonlinear connection's partner in a gesture.

    Attributes
    ----------
    connection : as `Attached` names it.
    quantity : ``offset`` (m, gap of zero compression), ``velocity`` (m/s, of a friction's partner) or ``scale``
        (factor on the force, not negative).
    segments : values over time, s relative to the event, like those of a force; 0 before and after them.
    """

    connection: str
    quantity: Literal["offset", "velocity", "scale"]
    segments: tuple[Segment, ...]

    def course(self, times: ArrayLike) -> Floats:
        """Return the values at times (n,); 0 outside the segments."""
        return course(self.segments, times)


def loose_mass(mass: float, freq_rad: float = 0.0, damping_rate: float = 0.0) -> ModalBasis:
    """Return a lump that moves along one line, with the point ``mass``; on a spring if `freq_rad` > 0.

    Parameters
    ----------
    mass : kg.
    freq_rad : rad/s, sqrt(k/m).
    damping_rate : sigma = c / 2m, 1/s.
    """
    return ModalBasis.real([freq_rad], [damping_rate], {"mass": [1.0]}, modal_mass=mass)


__all__ = ["Attached", "Motion", "Site", "loose_mass"]
