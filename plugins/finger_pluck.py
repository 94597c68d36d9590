"""A pluck by a finger with a nail: it lands on the string, draws it aside, and lets it slip over its edge.

Landing. The finger moves at the speed v = F C / `draw_time`, with which it draws the string to the force F; C is the
string's compliance at the place plus that of the fingertip, 1 / `stiffness`. A string of impedance Z resists a sudden
speed v by 2 Z v: this force comes within 2 Z / `stiffness` of the first touch, and is the quiet burst before a note.

Slip. The force falls as the string passes the edge, whose radius is `edge`:

    f = F (1 - S(u / edge)),    S(x) = 3 x^2 - 2 x^3,    u' = v + (F - f) / (2 Z) + y',    m y'' = F - f - k y

u is the way of the string over the edge. It grows by the hand's speed, by the string's, which is let go into its wave
impedance (true until the first reflection comes back), and by that of the fingertip of mass m and stiffness k, which
leaps ahead as its load is gone. The hand's speed is at least edge / 0.5 s; otherwise the slip would
last hours at forces near zero. A string that is drawn further leaves faster, so the release lasts about 4 Z edge / F:
loud notes are brighter. With `nail` from 0 to 1 the edge goes from that of flesh to that of a nail, and so do the width
of the contact, over which the force is spread evenly, and the stiffness.

Roughness. From the first touch to the end of the slip the force has a random part of the rms `roughness` times the
force, in 48000 values per second, drawn from `seed`, the string, the stop and the force: the same note sounds the same.
Work of all these forces is counted as that of the gesture. While it draws the string, the finger damps earlier motion
by a dashpot, which dissipates only.

So notes neither scale with their force (the slip is faster at a higher one, the random part another) nor superpose
(the dashpot acts on all that the string does). With `linear` they do both under one course of stops (a stop, a slide
and the end of a note act on all that sounds, but depend on no force): every note has the course of the force that the
bundle's `force` has, times the ratio of the note's force to it, and there is no dashpot.

Sources: G. Cuzzucoli and V. Lombardo, A physical model of the classical guitar, including the player's touch, Computer
Music Journal 23(2), 1999 (phases of a pluck; finger as mass, spring, dashpot); D. Chadefaux, J.-L. Le Carrou and
B. Fabre, A model of harp plucking, J. Acoust. Soc. Am. 133, 2444 (2013) (sticking and slipping; the string's velocity
at release). Their slip is a threshold of friction; the edge here is this model's own, and so are its radii.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: N and Hz, of a string whose tension or pitch is not known: a nylon string's
_TENSION, _FREQ = 70.0, 200.0
#: Hz, values of the random force per second
_NOISE_FS = 48000.0
#: s, in which the hand alone moves the edge past the string at any force
_LONGEST_SLIP = 0.5
#: steps of the slip's integration, and those between which the force is made of two parabolas
_STEPS, _NODES = 60, (0, 3, 6, 12, 24, 36, 48, 60)


@dataclass(frozen=True)
class Tip:
    """Part of the finger that meets the string: m, m, N/m."""

    edge: float
    width: float
    stiffness: float


#: flesh without a nail, a nail alone
FLESH, NAIL = Tip(1.0e-3, 10e-3, 2e3), Tip(0.2e-3, 3e-3, 2e4)


class FingerPluckParameters(Parameters):
    """Parameters of the pluck."""

    force: float = ta.quantity("N", low=0.0, high=1000.0, default=2.0, doc="at which the string begins to slip")
    from_bridge: ta.StringPlace = ta.described("m, or {fraction: of the speaking length}", default=0.1)
    angle_deg: float = ta.quantity(
        "deg", low=-360.0, high=360.0, default=0.0, doc="of the force, from the first polarization to the second"
    )
    draw_time: float = ta.quantity("s", low=1e-3, high=5.0, default=0.02, doc="from the first touch to the slip")
    nail: float = ta.quantity(
        "1", low=0.0, high=1.0, default=0.8, doc="0 flesh, 1 nail: sets the values left out below"
    )
    edge: float | None = ta.quantity("m", low=1e-5, high=0.02, default=None, doc="radius of the edge; 1 to 0.2 mm")
    width: float | None = ta.quantity("m", low=0.0, high=0.05, default=None, doc="of the contact; 10 to 3 mm")
    stiffness: float | None = ta.quantity("N/m", low=10.0, high=1e7, default=None, doc="of the fingertip; 2e3 to 2e4")
    mass: float = ta.quantity("kg", low=1e-6, high=0.1, default=5e-4, doc="of the fingertip that leaps ahead")
    roughness: float = ta.quantity("1", low=0.0, high=1.0, default=4e-3, doc="rms of the force's random part, re it")
    seed: int = ta.described("of the random part", default=0, ge=0)
    hold_dashpot: float = ta.quantity(
        "N s/m", low=0.0, high=100.0, default=0.5, doc="damping of the finger on the string"
    )
    linear: bool = ta.described(
        "notes scale with their force and superpose at fixed stops: the slip is that of the bundle's `force`, "
        "without `hold_dashpot`",
        default=False,
        strict=True,
    )

    @property
    def tip(self) -> Tip:
        """Part that meets the string: between flesh and nail in geometric steps, where it is not given."""

        def between(flesh: float, nail: float) -> float:
            return float(flesh ** (1.0 - self.nail) * nail**self.nail)

        return Tip(
            between(FLESH.edge, NAIL.edge) if self.edge is None else self.edge,
            between(FLESH.width, NAIL.width) if self.width is None else self.width,
            between(FLESH.stiffness, NAIL.stiffness) if self.stiffness is None else self.stiffness,
        )


class FingerPluck(ta.Exciter[FingerPluckParameters]):
    """The finger; see the module."""

    api = 1
    effects = (ta.DAMPERS,)
    Parameters = FingerPluckParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Landing, drawing, slip; the slip begins at time 0."""
        p = self.adjusted(event.values)
        peak, force = p.force, self.parameters.force if p.linear else p.force
        if p.linear and force <= 0.0:
            raise self.fault(f"needs `force` above 0 N, of which the slip is taken; {self.key}.force is 0 N", "linear")
        tip, x = p.tip, ta.metres(p.from_bridge, place)
        tension, freq = place.tension or _TENSION, event.freq or _FREQ
        impedance = tension / (2 * place.length * freq)
        compliance = x * (place.length - x) / (tension * place.length) + 1 / tip.stiffness
        draw = max(p.draw_time, 1.0 / freq)
        speed = force * compliance / draw
        landed = min(2 * impedance * speed, 0.5 * force)
        rise = min(4 * impedance / tip.stiffness, 0.25 * draw)
        touch = ta.smooth_step(-draw, rise - draw, 0.0, landed)
        drawing = ta.smooth_step(rise - draw, 0.0, landed, force)
        release = slip(force, impedance, max(speed, tip.edge / _LONGEST_SLIP), tip, p.mass)
        hold = ta.Hold(-draw, -draw / 2, 0.0, p.hold_dashpot) if p.hold_dashpot > 0 and not p.linear else None
        segments = touch + drawing + release
        label = f"{p.seed} {place.name} {event.stop:g} {force!r} {x!r}"
        noise = roughness(segments, p.roughness, zlib.crc32(label.encode())) if p.roughness * force > 0 else None
        if p.linear:
            segments, noise = _scaled(segments, noise, peak / force)
        return ta.Gesture(segments, x, p.angle_deg, hold, width=min(tip.width, x, place.length - x), noise=noise)


def slip(force: float, impedance: float, speed: float, tip: Tip, mass: float) -> tuple[ta.Segment, ...]:
    """Force of a string that slips over an edge from time 0 on, see the module; continuous with its rate.

    Parameters
    ----------
    force : N, at the beginning.
    impedance : N s/m, of the string to one side.
    speed : m/s, of the hand.
    mass : kg, of the fingertip.
    """
    if force <= 0:
        return ()
    n, dx = _STEPS, 1.0 / _STEPS
    time = ahead = leap = 0.0
    times, rates = [0.0], [speed]
    for i in range(n):
        # the middle of the step: S is known along the way
        x = (i + 0.5) * dx
        gone = force * x * x * (3.0 - 2.0 * x)
        rate = speed + gone / (2 * impedance) + leap
        dt = tip.edge * dx / rate
        # implicit, as light tips on stiff springs move faster than the steps
        leap = (leap + dt * (gone - tip.stiffness * ahead) / mass) / (1 + dt * dt * tip.stiffness / mass)
        ahead += dt * leap
        time += dt
        x = (i + 1) * dx
        times.append(time)
        rates.append(max(speed + force * x * x * (3.0 - 2.0 * x) / (2 * impedance) + leap, speed))
    out: list[ta.Segment] = []
    for a, b in pairwise(_NODES):
        (f0, d0), (f1, d1) = (_force_and_rate(force, i * dx, rates[i] / tip.edge) for i in (a, b))
        out += _pair(times[a], times[b], f0, d0, f1, d1)
    return tuple(out)


def _scaled(
    segments: tuple[ta.Segment, ...], noise: ta.SampledForce | None, factor: float
) -> tuple[tuple[ta.Segment, ...], ta.SampledForce | None]:
    louder = tuple(replace(s, c0=factor * s.c0, c1=factor * s.c1, c2=factor * s.c2) for s in segments)
    return louder, None if noise is None else replace(noise, values=factor * noise.values)


def _force_and_rate(force: float, x: float, rate: float) -> tuple[float, float]:
    """Force (N) and its rate (N/s) at a share x of the way that grows at `rate` (1/s)."""
    return force * (1 - x * x * (3 - 2 * x)), -force * 6 * x * (1 - x) * rate


def _pair(start: float, stop: float, f0: float, d0: float, f1: float, d1: float) -> tuple[ta.Segment, ta.Segment]:
    """Two parabolas that meet in the middle and have these values (N) and rates (N/s) at both ends."""
    half = (stop - start) / 2
    middle_rate = (f1 - f0) / half - (d0 + d1) / 2
    c2 = (middle_rate - d0) / (2 * half)
    middle = f0 + half * (d0 + c2 * half)
    return (
        ta.Segment(start, start + half, f0, d0, c2),
        ta.Segment(start + half, stop, middle, middle_rate, (d1 - middle_rate) / (2 * half)),
    )


def roughness(segments: tuple[ta.Segment, ...], share: float, seed: int) -> ta.SampledForce:
    """Random force with an rms of `share` times the force of the segments at each moment."""
    start, stop = segments[0].start, segments[-1].stop
    n = max(math.ceil((stop - start) * _NOISE_FS), 2)
    times = start + np.arange(n + 1) * (stop - start) / n
    numbers = np.array([(s.start, s.stop, s.c0, s.c1, s.c2) for s in segments])
    segment = numbers[np.minimum(np.searchsorted(numbers[:, 1], times, side="right"), len(segments) - 1)]
    begin, end, c0, c1, c2 = segment.T
    u = times - begin
    level = np.where((begin <= times) & (times < end), c0 + u * (c1 + u * c2), 0.0)
    white = np.random.Generator(np.random.PCG64(seed)).standard_normal(n + 1)
    values = share * level * white
    values[0] = values[-1] = 0.0
    return ta.SampledForce(start, (stop - start) / n, values)
