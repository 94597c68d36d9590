"""A loose mass beside the string: a ring, a bead, a nail that buzzes when the string reaches it.

The mass hangs on a soft spring of its own, `clearance` away from the resting string, and is struck by one-sided
contact K p^alpha (1 + loss p').
"""

from __future__ import annotations

import math

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class RattleParameters(Parameters):
    """Parameters of the mass."""

    from_bridge: float = ta.quantity("m", low=0.0, high=5.0, doc="place on the string")
    mass: float = ta.quantity("kg", low=1e-7, high=10.0, doc="of the loose part")
    clearance: float = ta.quantity("m", low=0.0, high=0.05, doc="room between it and the resting string")
    freq: float = ta.quantity("Hz", low=0.0, high=1e4, default=5.0, doc="of its own suspension")
    damping_ratio: float = ta.quantity("1", low=0.0, high=5.0, default=0.3, doc="of its own suspension")
    stiffness: float = ta.quantity("N/m^exponent", low=0.0, high=1e16, default=1e7, doc="K of the contact")
    exponent: float = ta.quantity("1", low=1.0, high=4.0, default=1.5, doc="alpha of the contact")
    loss: float = ta.quantity("s/m", low=0.0, high=100.0, default=0.5, doc="of Hunt and Crossley")
    direction: ta.Direction = ta.described("from the mass to the string", default="z")


class Rattle(ta.Attachment[RattleParameters]):
    """The mass; see the module."""

    api = 1
    effects = (ta.contact_effect("rattle", "a loose part struck by the string"),)
    Parameters = RattleParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """A mass for each string."""
        p = self.parameters
        if not p.from_bridge < site.open_length:
            raise self.fault(f"string {site.string} is {site.open_length:g} m long", "from_bridge")
        point, component, omega = f"{name}.at", f"{site.string}.{name}.mass", 2 * math.pi * p.freq
        terms = (*site.motion(point, ta.unit_vector(p.direction)), ta.Term(component, "mass", -1.0))
        law = ta.Contact(p.stiffness, p.exponent, p.loss, offset=-p.clearance)
        return ta.Attached(
            {point: p.from_bridge},
            {component: ta.loose_mass(p.mass, omega, p.damping_ratio * omega)},
            (ta.Connection(f"{site.string}.{point}", terms, law),),
        )
