"""A hammer: a mass with a felt that is thrown at the string and jumps back; or a tangent that stays on it.

The mass rests `clearance` away on a soft, damped spring. A short push gives it its `velocity`, and a small force keeps
it against that spring, so that it meets the resting string at the note's time; then felt and string decide:
f = K p^alpha (1 + loss p'), p the compression (Hunt & Crossley; for piano felt alpha is 2 to 3.5). One head with one
felt per string strikes all strings of its key. With `press` a force holds it against the string for as long as the note
lasts, as a clavichord's key holds its tangent; it then divides the string. Struck again at once it is let go a little
before, so that it has fallen back. The driver's work is that of all known forces on the mass; the contact can only
store or dissipate energy.

A suspension that brings the hammer back within 50 ms would also brake it by a tenth or more while it touches the
string. For `free_time` after the blow a known force makes up for it, on the course that the hammer takes against the
string's wave impedance and its echo from the nearer end:

    m x'' = -sum_i f(x - y),    y' = (f(t) - f(t - tau)) / (2 Z),    Z = T / (2 L f1),    tau = 2 d / (2 L f1).

Only the force that brings it back depends on how good that course is, not the blow.
"""

from __future__ import annotations

import math
from itertools import pairwise

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: periods of its suspension after which a hammer that was thrown is away from the string for good
_FALLS = 2.0
#: moments at which the force on a hammer that touches the string is known, and steps from one to the next
_NODES, _STEPS = 32, 32


class HammerParameters(Parameters):
    """Parameters of the hammer."""

    from_bridge: ta.StringPlace = ta.described("m, or {fraction: of the speaking length}", default=0.1)
    velocity: float = ta.quantity("m/s", low=0.0, high=20.0, default=2.0, doc="with which it meets the string")
    mass: float = ta.quantity("kg", low=1e-6, high=1.0, doc="of the hammer's head, or of tangent and key")
    stiffness: float = ta.quantity("N/m^exponent", low=0.0, high=1e16, doc="K of the felt")
    exponent: float = ta.quantity("1", low=1.0, high=6.0, default=2.5, doc="alpha of the felt")
    loss: float = ta.quantity("s/m", low=0.0, high=100.0, default=0.0, doc="of Hunt and Crossley")
    clearance: float = ta.quantity("m", low=1e-5, high=0.1, default=2e-3, doc="from its rest to the string")
    throw_time: float = ta.quantity("s", low=1e-4, high=0.1, default=1.5e-3, doc="of the push; shorter if it must be")
    return_freq: float = ta.quantity("Hz", low=0.1, high=100.0, default=4.0, doc="of the spring that brings it back")
    return_damping: float = ta.quantity("1", low=0.0, high=5.0, default=0.7, doc="damping ratio of that spring")
    free_time: float = ta.quantity(
        "s", low=0.0, high=0.05, default=0.0, doc="after it met the string, until the spring may brake it"
    )
    press: float = ta.quantity("N", low=0.0, high=50.0, default=0.0, doc="with which it is held against the string")
    press_time: float = ta.quantity("s", low=1e-4, high=1.0, default=3e-3, doc="in which that force grows and vanishes")
    sustain: float = ta.quantity("s", low=0.0, high=60.0, default=2.0, doc="of a press without an end")
    felt_width: float = ta.quantity("m", low=0.0, high=0.1, default=0.0, doc="of the string that the felt covers")
    direction: ta.Direction = ta.described("in which it strikes", default="z")


class Hammer(ta.Exciter[HammerParameters]):
    """The hammer; see the module."""

    api = 1
    effects = (ta.contact_effect("hammer", "a mass thrown at the string, while a gesture moves it", basic=True),)
    Parameters = HammerParameters

    @property
    def recovery(self) -> float:
        """Half a period of its return, once a press is over."""
        p = self.parameters
        return p.press_time + 0.5 / p.return_freq if p.press > 0.0 else 0.0

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """Return the felt on each string, and one mass for all strings of a key."""
        p, point = self.parameters, f"{site.leader}.{name}"
        terms = (*site.motion("pluck", ta.unit_vector(p.direction)), ta.Term(f"{point}.head", "mass", -1.0))
        if len(terms) < 2:
            raise self.fault(f"string {site.string} does not move in this direction", "direction")
        felt = ta.Contact(p.stiffness, p.exponent, p.loss, offset=-p.clearance)
        connections = (ta.Connection(f"{site.string}.{name}.felt", terms, felt),)
        resting = tuple(c.name for c in connections) if site.group else ()
        if site.string != site.leader:
            return ta.Attached(connections=connections, resting=resting)
        omega = 2 * math.pi * p.return_freq
        return ta.Attached(
            components={f"{point}.head": ta.loose_mass(p.mass, omega, p.return_damping * omega)},
            connections=connections,
            inputs={f"{point}.push": ((f"{point}.head", "mass", 1.0),)},
            resting=resting,
        )

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Push, flight, and the force that keeps it there; it arrives at time 0."""
        p = self.adjusted(event.values)
        on, at = f"{place.name}.{self.name}.push", ta.metres(p.from_bridge, place)
        if p.velocity == 0.0:
            return ta.Gesture((ta.Segment(0.0, 1e-3, 0.0),), at, on=on)
        throw = min(p.throw_time, p.clearance / p.velocity)
        # distance covered during the push, whose rise and fall are alike: throw x velocity / 2
        start = -(throw + (p.clearance - throw * p.velocity / 2) / p.velocity)
        peak = 2 * p.mass * p.velocity / throw
        half = start + throw / 2
        push = ta.smooth_step(start, half, 0.0, peak) + ta.smooth_step(half, start + throw, peak, 0.0)
        # compensates the velocity that the suspension takes away on the way
        omega = 2 * math.pi * p.return_freq
        drag, pull = 2 * p.return_damping * omega * p.mass * p.velocity, omega**2 * p.mass
        kept = ta.smooth_step(start, start + throw, 0.0, drag)
        segments = tuple(_sum(piece, kept[i // 2]) for i, piece in enumerate(push))
        segments += (ta.Segment(start + throw, 0.0, drag + pull * throw * p.velocity / 2, pull * p.velocity),)
        if p.free_time > 0.0:
            segments += self._made_up_for(p, event, place, at)
        if p.press > 0.0:
            release = max(event.duration if math.isfinite(event.duration) else p.sustain, 2 * p.press_time)
            segments += ta.smooth_step(0.0, p.press_time, 0.0, p.press)
            segments += (ta.Segment(p.press_time, release, p.press),)
            segments += ta.smooth_step(release, release + p.press_time, p.press, 0.0)
        # of a key: its felts act until the hammer has fallen back
        away = p.free_time + _FALLS / p.return_freq
        motions = tuple(
            ta.Motion(f"{string}.{self.name}.felt", "scale", (ta.Segment(start, away, factor),))
            for string, factor in place.strings
        )
        return ta.Gesture(segments, at, on=on, motions=motions)

    def _made_up_for(self, p: HammerParameters, event: ta.Event, place: ta.Place, at: float) -> tuple[ta.Segment, ...]:
        """Force that balances the suspension from the blow on, as far as the hammer's course is foreseen."""
        omega = 2 * math.pi * p.return_freq
        times, x, v = _course(p, event, place, at)
        force = [
            p.mass * (2 * p.return_damping * omega * v_ + omega**2 * (p.clearance + x_))
            for x_, v_ in zip(x, v, strict=True)
        ]
        return tuple(
            ta.Segment(a, b, f, (g - f) / (b - a)) for (a, f), (b, g) in pairwise(zip(times, force, strict=True))
        )


def _course(
    p: HammerParameters, event: ta.Event, place: ta.Place, at: float
) -> tuple[list[float], list[float], list[float]]:
    """Times, places from the resting string and velocities of a hammer from the blow on, `_NODES` of each."""
    speed = 2 * place.length * (event.freq or 1.0)
    impedance = max(place.tension, 1.0) / speed
    n_strings = sum(factor > 0 for _, factor in place.strings) or 1
    softer = max((factor for _, factor in place.strings), default=1.0)
    dt = p.free_time / (_NODES * _STEPS)
    echo = max(1, round(2 * min(at, place.length - at) / speed / dt))
    times, xs, vs = [0.0], [0.0], [p.velocity]
    past: list[float] = []
    x, v, y, slide = 0.0, p.velocity, 0.0, 0.0
    for i in range(_NODES * _STEPS):
        gap = x - y
        felt = softer * p.stiffness * gap**p.exponent * max(1 + p.loss * (v - slide), 0.0) if gap > 0 else 0.0
        past.append(felt)
        slide = (felt - (past[i - echo] if i >= echo else 0.0)) / (2 * impedance)
        v -= n_strings * felt / p.mass * dt
        x, y = x + v * dt, y + slide * dt
        if (i + 1) % _STEPS == 0:
            times.append((i + 1) * dt)
            xs.append(x)
            vs.append(v)
    return times, xs, vs


def _sum(a: ta.Segment, b: ta.Segment) -> ta.Segment:
    """Product of two courses, over the times of the first."""
    c0, c1, c2 = b.shifted(a.start - b.start)
    return ta.Segment(a.start, a.stop, a.c0 + c0, a.c1 + c1, a.c2 + c2)
