"""A fingerboard without frets: a flat board under the string, touched at closely spaced points.

The clearance under the open string goes in a straight line from the nut to the board's end. A stopped string runs
straight from the board at its stop to the bridge. The stiffness K is that of the whole board length; every point has
its share, so that a finer spacing approaches a distributed contact (penalty of van Walstijn, Bilbao and others).
"""

from __future__ import annotations

import numpy as np

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class FingerboardParameters(Parameters):
    """Parameters of the board."""

    end_from_bridge: float = ta.quantity("m", low=0.0, high=5.0, doc="place of the board's end")
    action_nut: float = ta.quantity("m", low=0.0, high=0.05, doc="clearance of the open string at the nut")
    action_end: float = ta.quantity("m", low=0.0, high=0.05, doc="clearance of the open string at the board's end")
    points: int = ta.described("number of contact points", default=24, ge=2, le=200, strict=True)
    stiffness: float = ta.quantity("N/m^exponent", low=0.0, high=1e16, default=1e8, doc="K of the whole board")
    exponent: float = ta.quantity("1", low=1.0, high=4.0, default=1.5, doc="alpha of the contact")
    loss: float = ta.quantity("s/m", low=0.0, high=100.0, default=2.0, doc="of Hunt and Crossley")
    direction: ta.Direction = ta.described("from the board to the string", default="z")


class Fingerboard(ta.Attachment[FingerboardParameters]):
    """The board; see the module."""

    api = 1
    effects = (ta.contact_effect("fingerboard", "slap where the string reaches the fingerboard"),)
    Parameters = FingerboardParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """Points in the middles of equal parts of the board."""
        p, whole = self.parameters, site.open_length
        if not p.end_from_bridge < whole:
            raise self.fault(f"string {site.string} is {whole:g} m long: no board ends there", "end_from_bridge")
        direction = ta.unit_vector(p.direction)

        def clearance(x: float) -> float:
            return p.action_nut + (p.action_end - p.action_nut) * (whole - x) / (whole - p.end_from_bridge)

        places, connections = {}, []
        shares = (np.arange(p.points) + 0.5) / p.points
        for i, x in enumerate(p.end_from_bridge + shares * (whole - p.end_from_bridge)):
            point = f"{name}.{i}"
            places[point] = float(x)
            offset = -max(site.lowered(float(x), clearance), 0.0)
            law = ta.Contact(p.stiffness / p.points, p.exponent, p.loss, offset=offset)
            connections.append(ta.Connection(f"{site.string}.{point}", site.motion(point, direction), law))
        return ta.Attached(places, connections=tuple(connections))
