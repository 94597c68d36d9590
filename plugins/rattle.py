"""A loose mass beside the string: a ring, a bead, a nail that buzzes when the string reaches it.

The mass hangs on a soft spring of its own, `clearance` away from the resting string, and is struck by one-sided
contact K p^alpha (1 + loss p').
"""

from __future__ import annotations

import math

from tonewood.authoring import (
    Attached,
    Attachment,
    Connection,
    Contact,
    Direction,
    Parameters,
    Site,
    Term,
    contact_effect,
    described,
    loose_mass,
    quantity,
    unit_vector,
)


class RattleParameters(Parameters):
    """Parameters of the mass."""

    from_bridge: float = quantity("m", low=0.0, high=5.0, doc="place on the string")
    mass: float = quantity("kg", low=1e-7, high=10.0, doc="of the loose part")
    clearance: float = quantity("m", low=0.0, high=0.05, doc="room between it and the resting string")
    freq: float = quantity("Hz", low=0.0, high=1e4, default=5.0, doc="of its own suspension")
    damping_ratio: float = quantity("1", low=0.0, high=5.0, default=0.3, doc="of its own suspension")
    stiffness: float = quantity("N/m^exponent", low=0.0, high=1e16, default=1e7, doc="K of the contact")
    exponent: float = quantity("1", low=1.0, high=4.0, default=1.5, doc="alpha of the contact")
    loss: float = quantity("s/m", low=0.0, high=100.0, default=0.5, doc="of Hunt and Crossley")
    direction: Direction = described("from the mass to the string", default="z")


class Rattle(Attachment[RattleParameters]):
    """The mass; see the module."""

    api = 1
    effects = (contact_effect("rattle", "a loose part struck by the string"),)
    Parameters = RattleParameters

    def attach(self, name: str, site: Site) -> Attached:
        """A mass for each string."""
        p = self.parameters
        if not p.from_bridge < site.open_length:
            raise self.fault(f"string {site.string} is {site.open_length:g} m long", "from_bridge")
        point, component, omega = f"{name}.at", f"{site.string}.{name}.mass", 2 * math.pi * p.freq
        terms = (*site.motion(point, unit_vector(p.direction)), Term(component, "mass", -1.0))
        law = Contact(p.stiffness, p.exponent, p.loss, offset=-p.clearance)
        return Attached(
            {point: p.from_bridge},
            {component: loose_mass(p.mass, omega, p.damping_ratio * omega)},
            (Connection(f"{site.string}.{point}", terms, law),),
        )
