"""A pluck while a finger lies on the string: harmonics by a light touch at a node, palm damping, a soft stop.

The finger is a mass on the spring and dashpot of the hand, and its skin a spring and dashpot between that mass and the
string, all at `touch`. It lies there from before the pluck until `lift` after it: light and lifted it leaves the
partials that have a node there; heavy and lasting it damps them all; stiff and heavy it stops the string softly. Its
weight goes from 0 to `weight` and back in `ease`; a growing weight puts in the little work of pressing a skin that is
not yet deflected. An event may change its place (by a controller), and it may move to `touch_end` until it leaves; the
change of the skin's energy on the way is work of the hand.
"""

from __future__ import annotations

import math

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: number of points at which a broad finger touches the string
_POINTS = 3


class FingerParameters(Parameters):
    """Parameters of the finger, and of the pluck beside it."""

    touch: ta.StringPlace = ta.described(
        "of the finger: m, or {fraction: of the speaking length}", default=ta.Fraction(fraction=0.5)
    )
    touch_end: ta.StringPlace | None = ta.described("of the finger when it leaves, if it moves meanwhile", default=None)
    width: float = ta.quantity("m", low=0.0, high=0.2, default=0.0, doc="over which it lies: a palm's edge is broad")
    weight: float = ta.quantity("1", low=0.0, high=100.0, default=1.0, doc="factor on the skin's stiffness and damping")
    mass: float = ta.quantity("kg", low=1e-5, high=1.0, default=2e-3, doc="of the fingertip")
    skin_stiffness: float = ta.quantity("N/m", low=0.0, high=1e6, default=300.0, doc="between string and fingertip")
    skin_damping: float = ta.quantity("N s/m", low=0.0, high=100.0, default=0.3, doc="between string and fingertip")
    hand_freq: float = ta.quantity("Hz", low=0.1, high=1000.0, default=15.0, doc="of the fingertip on the hand")
    hand_damping: float = ta.quantity("1", low=0.0, high=10.0, default=1.0, doc="damping ratio of the same")
    lift: float = ta.quantity("s", low=0.0, high=60.0, default=0.04, doc="how long after the pluck the finger leaves")
    ease: float = ta.quantity("s", low=1e-4, high=1.0, default=5e-3, doc="in which it comes and goes")
    force: float = ta.quantity("N", low=0.0, high=200.0, default=2.0, doc="of the pluck, at the moment of release")
    from_bridge: ta.StringPlace = ta.described("of the pluck: m, or {fraction: of the speaking length}", default=0.1)
    angle_deg: float = ta.quantity(
        "deg", low=-360.0, high=360.0, default=0.0, doc="of the pluck, from the first polarization to the second"
    )
    ramp_time: float = ta.quantity("s", low=1e-3, high=5.0, default=0.02, doc="time in which the plucking force grows")
    release_time: float = ta.quantity("s", low=0.0, high=0.05, default=2e-4, doc="time in which it vanishes")
    hold_dashpot: float = ta.quantity("N s/m", low=0.0, high=100.0, default=0.5, doc="damping of the plucking finger")


class StoppingFinger(ta.Exciter[FingerParameters]):
    """The finger and the pluck; see the module."""

    api = 1
    effects = (
        ta.contact_effect("stopping_finger", "a soft finger, while a gesture lays it on the string", basic=True),
        ta.DAMPERS,
    )
    Parameters = FingerParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """Fingertip and skin in every direction the string moves in."""
        p, prefix, on = self.parameters, f"{site.string}.{name}", ta.Place(site.string, site.length)
        omega = 2 * math.pi * p.hand_freq
        middle, n = ta.metres(p.touch, on), self._points
        places = {f"{name}.touch{j}": ta.metres(middle + dx, on) for j, dx in enumerate(self._spread, 1)}
        law = ta.HardeningSpring(p.skin_stiffness / n, damping=p.skin_damping / n)
        components, connections = {}, []
        for i, (component, _) in enumerate(site.polarizations, 1):
            tip = f"{prefix}.tip{i}"
            components[tip] = ta.loose_mass(p.mass, omega, p.hand_damping * omega)
            for j, point in enumerate(places, 1):
                terms = (ta.Term(component, point), ta.Term(tip, "mass", -1.0))
                connections.append(ta.Connection(f"{prefix}.skin{i}{j}", terms, law))
        return ta.Attached(places, components, tuple(connections), resting=tuple(c.name for c in connections))

    @property
    def _points(self) -> int:
        return 1 if self.parameters.width == 0.0 else _POINTS

    @property
    def _spread(self) -> list[float]:
        """Places of the points, m from the middle."""
        n = self._points
        return [self.parameters.width * ((j - 0.5) / n - 0.5) for j in range(1, n + 1)]

    def _course(
        self, p: FingerParameters, place: ta.Place, begin: float, end: float
    ) -> dict[str, tuple[ta.Segment, ...]]:
        """Courses of the points' places: at the event's place, or on the way to `touch_end`; empty at the bundle's."""
        last = p.touch if p.touch_end is None else p.touch_end
        if p.touch == last == self.parameters.touch:
            return {}
        first, last = ta.metres(p.touch, place), ta.metres(last, place)
        return {
            f"{self.name}.touch{j}": ta.smooth_step(
                begin, end, ta.metres(first + dx, place), ta.metres(last + dx, place)
            )
            for j, dx in enumerate(self._spread, 1)
        }

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """The finger comes before the pluck's force grows; the pluck's release begins at time 0."""
        p = self.adjusted(event.values)
        ramp = max(p.ramp_time, 1.0 / event.freq if event.freq > 0 else 0.0)
        segments = ta.smooth_step(-ramp, 0.0, 0.0, p.force) + ta.smooth_step(0.0, p.release_time, p.force, 0.0)
        lies = (
            *ta.smooth_step(-ramp - p.ease, -ramp, 0.0, p.weight),
            ta.Segment(-ramp, p.lift, p.weight),
            *ta.smooth_step(p.lift, p.lift + p.ease, p.weight, 0.0),
        )
        skins = [f"skin{i}{j}" for i in range(1, place.planes + 1) for j in range(1, self._points + 1)]
        motions = tuple(ta.Motion(f"{place.name}.{self.name}.{skin}", "scale", lies) for skin in skins)
        hold = ta.Hold(-ramp, -ramp / 2, 0.0, p.hold_dashpot) if p.hold_dashpot > 0 else None
        course = self._course(p, place, -ramp - p.ease, p.lift + p.ease)
        return ta.Gesture(segments, ta.metres(p.from_bridge, place), p.angle_deg, hold, motions=motions, touches=course)
