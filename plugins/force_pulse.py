"""A short known force: a tap on the body, a hammer without a mass, a test impulse.

``smooth``: up and down by two parabolas each, like a raised cosine. ``triangle``: straight up and down. Both have the
impulse force x duration / 2.
"""

from __future__ import annotations

from typing import Literal

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class PulseParameters(Parameters):
    """Parameters of the pulse."""

    at: str | None = ta.described("point it acts on, e.g. body.bridge_G3; left out: the string played", default=None)
    force: float = ta.quantity("N", low=-1e4, high=1e4, default=1.0, doc="peak")
    duration: float = ta.quantity("s", low=1e-6, high=1.0, default=1e-3, doc="from first to last contact")
    shape: Literal["smooth", "triangle"] = ta.described("course of the force", default="smooth")
    from_bridge: ta.StringPlace = ta.described("on a string: m, or {fraction: of its length}", default=0.1)
    angle_deg: float = ta.quantity(
        "deg", low=-360.0, high=360.0, default=0.0, doc="on a string: direction of the force"
    )


class ForcePulse(ta.Exciter[PulseParameters]):
    """The pulse; see the module."""

    api = 1
    Parameters = PulseParameters

    @property
    def at(self) -> str | None:
        """``component.point`` it acts on, or None."""
        return self.parameters.at

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Force from time 0 on."""
        p = self.adjusted(event.values)
        half, end = p.duration / 2, p.duration
        if p.shape == "smooth":
            segments = ta.smooth_step(0.0, half, 0.0, p.force) + ta.smooth_step(half, end, p.force, 0.0)
        else:
            slope = p.force / half
            segments = (ta.Segment(0.0, half, 0.0, slope), ta.Segment(half, end, p.force, -slope))
        if self.at is not None:
            return ta.Gesture(segments)
        return ta.Gesture(segments, ta.metres(p.from_bridge, place), p.angle_deg)
