"""Gestures of the stopping hand alone: slides, hammer-ons, pull-offs.

``slide`` moves the stop from that of the note before to the note's own within `time`, and arrives when the note
begins; on a fretted string it sounds every fret on its way. ``hammer_on`` strikes the string at the new stop with a
short push of `share` times the note's force and holds it there: with the force F the string falls at the speed
F / (2 Z), Z = sqrt(T mu), and the waves that this sends out are the note. ``pull_off`` lets the note before go to a
lower stop, and drags the string along for `time` as the finger leaves: a small pluck where the stop was.

The stop changes on the engine's control grid: displacement and velocity of the string are projected to its new length,
which cannot raise their energy (`tonewood.physics.modal.string_transfer`), or with ``stops: {model: finger}`` a soft
finger moves along the string. All work of the hand is that of the pushes.
"""

from __future__ import annotations

from typing import Literal

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: s after a hammer-on's push until the stop has changed: more than a tick of the control grid
_STOPPED = 2e-3


class LeftHandParameters(Parameters):
    """Parameters of the hand."""

    action: Literal["slide", "hammer_on", "pull_off"] = ta.described("kind of slur")
    time: float | None = ta.quantity(
        "s", low=5e-4, high=5.0, default=None, doc="it takes; slide 0.15, hammer_on 0.003, pull_off 0.004"
    )
    force: float = ta.quantity("N", low=0.0, high=1000.0, default=2.0, doc="of the note, as a pluck would have it")
    share: float = ta.quantity("1", low=0.0, high=10.0, default=0.3, doc="of it that the stopping finger uses")
    angle_deg: float = ta.quantity(
        "deg", low=-360.0, high=360.0, default=0.0, doc="of its push, from the first polarization to the second"
    )
    from_bridge: ta.StringPlace = ta.described("where the other hand is meanwhile", default=0.1)


class LeftHand(ta.Exciter[LeftHandParameters]):
    """The hand; see the module."""

    api = 1
    Parameters = LeftHandParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """A slide ends at time 0, a push begins before it and ends there."""
        p = self.adjusted(event.values)
        time = p.time or {"slide": 0.15, "hammer_on": 3e-3, "pull_off": 4e-3}[p.action]
        force = p.share * p.force
        if p.action == "slide":
            course = ta.smooth_step(-time, 0.0, event.stop_before, event.stop)
            return ta.Gesture((ta.Segment(-time, 0.0, 0.0),), ta.metres(p.from_bridge, place), stops=course)
        if p.action == "hammer_on":
            push = ta.smooth_step(-time, -time / 2, 0.0, force) + ta.smooth_step(-time / 2, 0.0, force, 0.0)
            until = ta.Segment(-time, _STOPPED, event.stop_before)
            return ta.Gesture(push, place.length, p.angle_deg, stops=(until,))
        drag = ta.smooth_step(-time, 0.0, 0.0, force) + ta.smooth_step(0.0, 2e-4, force, 0.0)
        left = min(event.length_before, 0.99 * place.length)
        return ta.Gesture(drag, left if left > 0 else ta.metres(p.from_bridge, place), p.angle_deg)
