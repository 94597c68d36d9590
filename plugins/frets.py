"""Frets under a string, each a one-sided contact: with a low action, a crooked neck or a hard pluck the string buzzes.

The clearance under the open string goes in a straight line through its values at the first and the twelfth fret, plus a
relief (a hollow of the neck, deepest midway between nut and last fret), minus the extra height of single frets. A
stopped string runs straight from the crown of its fret to the bridge; frets behind the stop are out of play. Contact
law: K p^alpha (1 + loss p'), p the penetration.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

import tonewood.authoring as ta
from tonewood.authoring import Parameters

FretNumber = Annotated[str, Field(pattern=r"^[1-9][0-9]?$")]


class FretsParameters(Parameters):
    """Parameters of the frets."""

    action_first: float = ta.quantity("m", low=0.0, high=0.05, doc="clearance of the open string at the first fret")
    action_twelfth: float = ta.quantity("m", low=0.0, high=0.05, doc="clearance of the open string at half its length")
    relief: float = ta.quantity("m", low=0.0, high=0.01, default=0.0, doc="hollow of the neck, midway nut to last fret")
    heights: dict[FretNumber, ta.Number] = ta.described("number of a fret -> m by which it stands out", default={})
    stiffness: float = ta.quantity("N/m^exponent", low=0.0, high=1e16, default=1e9, doc="K of the contact")
    exponent: float = ta.quantity("1", low=1.0, high=4.0, default=1.5, doc="alpha of the contact")
    loss: float = ta.quantity("s/m", low=0.0, high=100.0, default=0.5, doc="of Hunt and Crossley")
    direction: ta.Direction = ta.described("from the frets to the string", default="z")


class Frets(ta.Attachment[FretsParameters]):
    """The frets; see the module."""

    api = 1
    effects = (ta.contact_effect("frets", "buzz and slap where the string reaches a fret"),)
    Parameters = FretsParameters

    def clearance(self, x: float, site: ta.Site) -> float:
        """Clearance under the open string x metres from the bridge, without heights of single frets, m."""
        p = self.parameters
        first, twelfth, last = site.stops[1], site.open_length / 2, site.stops[-1]
        height = p.action_first + (p.action_twelfth - p.action_first) * (first - x) / (first - twelfth)
        share = (site.open_length - x) / (site.open_length - last)
        return height + 4 * p.relief * share * (1 - share)

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """One contact for every stop of the string."""
        if len(site.stops) < 2:
            raise self.fault(f"string {site.string} has no stops, so it has no frets")
        p = self.parameters
        direction = ta.unit_vector(p.direction)

        def crown(x: float) -> float:
            number = min(range(1, len(site.stops)), key=lambda i: abs(site.stops[i] - x))
            return self.clearance(x, site) - p.heights.get(str(number), 0.0)

        places, connections = {}, []
        for number, x in enumerate(site.stops[1:], 1):
            point = f"{name}.{number}"
            # behind the stop, and under the stop itself, where the string is held
            places[point] = x if x < 0.999 * site.length else site.open_length
            law = ta.Contact(p.stiffness, p.exponent, p.loss, offset=-max(site.lowered(x, crown), 0.0))
            connections.append(ta.Connection(f"{site.string}.{point}", site.motion(point, direction), law))
        return ta.Attached(places, connections=tuple(connections))
