"""A pluck by a finger or plectrum that holds the string, draws it aside and lets it go.

The force grows smoothly for `ramp_time` (or one period of the note, if that is longer: a shorter ramp sounds by
itself), has its peak when the note begins, and falls to zero within `release_time`: 0.3 ms for a soft fingertip, 0.05
ms for a hard nail. Rise and fall are two parabolas each, so that force and its rate are continuous. While it draws the
string, the finger damps earlier motion by a dashpot, which dissipates only. Notes scale with their force; with
`linear`, without that dashpot, they superpose, too.
"""

from __future__ import annotations

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class PluckParameters(Parameters):
    """Parameters of the pluck."""

    force: float = ta.quantity("N", low=0.0, high=1000.0, default=2.0, doc="force at the moment of release")
    from_bridge: ta.StringPlace = ta.described("m, or {fraction: of the speaking length}", default=0.1)
    angle_deg: float = ta.quantity(
        "deg", low=-360.0, high=360.0, default=0.0, doc="of the force, from the first polarization to the second"
    )
    ramp_time: float = ta.quantity("s", low=1e-3, high=5.0, default=0.02, doc="time in which the force grows")
    release_time: float = ta.quantity("s", low=0.0, high=0.05, default=2e-4, doc="time in which the force vanishes")
    hold_dashpot: float = ta.quantity(
        "N s/m", low=0.0, high=100.0, default=0.5, doc="damping of the finger on the string"
    )
    linear: bool = ta.described(
        "notes superpose at fixed stops: there is no `hold_dashpot`", default=False, strict=True
    )


class PluckRamp(ta.Exciter[PluckParameters]):
    """The pluck; see the module."""

    api = 1
    effects = (ta.DAMPERS,)
    Parameters = PluckParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Force and finger; the release begins at time 0."""
        p = self.adjusted(event.values)
        ramp = max(p.ramp_time, 1.0 / event.freq if event.freq > 0 else 0.0)
        segments = ta.smooth_step(-ramp, 0.0, 0.0, p.force) + ta.smooth_step(0.0, p.release_time, p.force, 0.0)
        hold = ta.Hold(-ramp, -ramp / 2, 0.0, p.hold_dashpot) if p.hold_dashpot > 0 and not p.linear else None
        return ta.Gesture(segments, ta.metres(p.from_bridge, place), p.angle_deg, hold)
