"""Cloth between the strings: a dashpot spread over a part of each string that is to stay quiet.

A clavichord's listing, a muted string's felt, the hand's edge on the strings by the bridge.
"""

from __future__ import annotations

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class ListingParameters(Parameters):
    """Parameters of the cloth."""

    from_bridge: float = ta.quantity("m", low=0.0, high=5.0, doc="its middle")
    width: float = ta.quantity("m", low=0.0, high=1.0, doc="over which it is spread")
    points: int = ta.described("number of points", default=4, ge=1, le=50, strict=True)
    stiffness: float = ta.quantity("N/m", low=0.0, high=1e6, default=0.0, doc="of all of it")
    damping: float = ta.quantity("N s/m", low=0.0, high=1e3, doc="of all of it")


class Listing(ta.Attachment[ListingParameters]):
    """The cloth; see the module."""

    api = 1
    Parameters = ListingParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """Springs and dashpots to the ground, in every direction the string moves in."""
        p = self.parameters
        start = p.from_bridge - p.width / 2
        if not (start > 0 and start + p.width < site.open_length):
            raise self.fault(f"does not lie on string {site.string}, {site.open_length:g} m long", "from_bridge")
        law = ta.SpringDashpot(p.stiffness / p.points, p.damping / p.points)
        places, connections = {}, []
        for i in range(p.points):
            point = f"{name}.{i}"
            places[point] = start + p.width * (i + 0.5) / p.points
            for plane, (component, _) in enumerate(site.polarizations):
                connections.append(ta.Connection(f"{site.string}.{point}.{plane}", (ta.Term(component, point),), law))
        return ta.Attached(places, connections=tuple(connections))
