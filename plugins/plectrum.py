"""A plectrum: a tip on a spring, drawn across the string until the string slips off.

The driver moves at `speed`; between it and the tip is a spring of `stiffness`, and the tip, of `mass`, drags the string
along by dry friction (`tonewood.physics.coupling.laws.Friction`). While they stick, the force on the string follows
from

    F = (X(t) - u) k,    u = C F,      so that F = X(t) / (1 / k + C),

C = x (L - x) / (T L) the string's compliance at the place. At F = `force` it slips: the tip jumps ahead on its own
spring, the force falls along the friction curve (half of it is gone at the slip of `slip_speed`, all but `dynamic` at
great speed), and within `leave` of the note's time the tip has left the string. The driver starts so early that the
slip falls on the note's time; a string that still vibrates slips somewhat sooner or later. A fast, stiff plectrum
sounds hard; slow and soft it becomes the known force of `pluck_ramp`.

The driver's work is that of the force k X(t) on a tip held by k: the energy of tip and spring is counted from there.
Friction dissipates only.
"""

from __future__ import annotations

import math

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class PlectrumParameters(Parameters):
    """Parameters of the plectrum and its stroke."""

    force: float = ta.quantity("N", low=1e-3, high=200.0, default=2.0, doc="at which the string slips off")
    from_bridge: ta.StringPlace = ta.described("m, or {fraction: of the speaking length}", default=0.1)
    stiffness: float = ta.quantity("N/m", low=10.0, high=1e6, default=2e3, doc="of the plectrum between hand and tip")
    damping: float = ta.quantity("1", low=0.0, high=10.0, default=0.3, doc="damping ratio of the tip on its spring")
    mass: float = ta.quantity("kg", low=1e-6, high=1e-2, default=5e-5, doc="that moves with the tip")
    speed: float = ta.quantity("m/s", low=1e-3, high=10.0, default=0.15, doc="of the hand")
    dynamic: float = ta.quantity("1", low=0.0, high=1.0, default=0.0, doc="share of the force left at great slip")
    slip_speed: float = ta.quantity("m/s", low=1e-4, high=10.0, default=0.05, doc="at which half of the rest is gone")
    leave: float = ta.quantity("s", low=1e-4, high=0.05, default=1e-3, doc="in which the tip leaves after the slip")
    direction: ta.Direction = ta.described("in which it plucks", default="z")


class Plectrum(ta.Exciter[PlectrumParameters]):
    """The plectrum; see the module."""

    api = 1
    effects = (ta.contact_effect("plectrum", "an edge that sticks and slips, while a gesture moves it", basic=True),)
    Parameters = PlectrumParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """The tip, and the friction between it and the string."""
        p, point = self.parameters, f"{site.string}.{name}"
        terms = site.motion("pluck", ta.unit_vector(p.direction))
        if not terms:
            raise self.fault(f"string {site.string} does not move in this direction", "direction")
        omega = math.sqrt(p.stiffness / p.mass)
        # for a limit of 1 N: the scale of the partner's motion is then the force of slip in N
        law = ta.Friction(1.0, 1.0, p.dynamic, p.slip_speed, residual=True)
        return ta.Attached(
            components={f"{point}.tip": ta.loose_mass(p.mass, omega, p.damping * omega)},
            connections=(ta.Connection(f"{point}.edge", (*terms, ta.Term(f"{point}.tip", "mass", -1.0)), law),),
            inputs={f"{point}.spring": ((f"{point}.tip", "mass", 1.0),)},
            resting=(f"{point}.edge",),
        )

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """The hand moves on for `leave` after the slip and stays until the tip is at rest."""
        p = self.adjusted(event.values)
        point, x = f"{place.name}.{self.name}", ta.metres(p.from_bridge, place)
        compliance = x * (place.length - x) / (place.tension * place.length) if place.tension > 0 else 0.0
        travel = p.force * (1 / p.stiffness + compliance)
        drawn = travel / p.speed
        # the hand's motion begins smoothly: at constant acceleration over the first fifth of the time
        early = 0.2 * drawn
        start, k = -drawn - early / 2, p.stiffness * p.speed
        drag = 2 * p.damping * math.sqrt(p.stiffness * p.mass) * p.speed  # of the dashpot that moves with the driver
        end = travel + p.speed * p.leave
        back = max(20 / math.sqrt(p.stiffness / p.mass), 5e-3)
        pull = (
            ta.Segment(start, start + early, 0.0, drag / early, k / (2 * early)),
            ta.Segment(start + early, p.leave, k * early / 2 + drag, k),
            # the free tip returns to rest so slowly that it does not ring
            *ta.smooth_step(p.leave, p.leave + back, p.stiffness * end, 0.0),
        )
        pressed = (
            *ta.smooth_step(start - early, start, 0.0, p.force),
            ta.Segment(start, 0.0, p.force),
            *ta.smooth_step(0.0, p.leave, p.force, 0.0),
        )
        motions = (ta.Motion(f"{point}.edge", "scale", pressed),)
        return ta.Gesture(pull, x, on=f"{point}.spring", motions=motions)
