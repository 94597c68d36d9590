"""A bow: dry friction between its hair and one point of the string.

|f| <= N mu_s while they stick; sliding, f = N [mu_d + (mu_s - mu_d) / (1 + |v| / v0)] against the slip v, the
hyperbola of Smith & Woodhouse (2000, J. Mech. Phys. Solids 48, 1633). Between Schelleng's least and greatest bow force
(1973, J. Acoust. Soc. Am. 53, 26),

    N_max = 2 Z v_b / (beta (mu_s - mu_d)),      N_min = Z^2 v_b / (2 beta^2 r (mu_s - mu_d)),

the string moves as Helmholtz saw it: one slip in each period. Z = sqrt(T mu), beta the bow's place as a share of the
length, r the resistance of the bridge. In each step the bow's work is f v_b h, and |f v| h becomes heat
(`tonewood.physics.coupling.laws.Friction`). The hair itself is stiff and light here.

The hair pushes on the string's surface, and the string rolls under it (McIntyre, Schumacher & Woodhouse 1983, J.
Acoust. Soc. Am. 74, 1325): besides its centre the surface moves by y with

    m y'' + 2 Z_R y' + y / C = f,      Z_R = mu c_R / 2,  c_R^2 = G / rho,  C = r^2 x (L - x) / (L G J),  m = mu w / 2

for a round string of one material, with torsional waves to both sides that do not come back, and the width w of the
hair. Friction that falls with speed needs that resistance: on a compliance without resistance, such as the residual
modes, it becomes unstable as steps get finer.
"""

from __future__ import annotations

import math

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class BowParameters(Parameters):
    """Parameters of the bow and its stroke."""

    from_bridge: ta.StringPlace = ta.described("m, or {fraction: of the speaking length}", default=0.05)
    force: float = ta.quantity("N", low=0.0, high=50.0, default=1.0, doc="with which it is pressed on the string")
    velocity: float = ta.quantity("m/s", low=-5.0, high=5.0, default=0.2, doc="of the hair; its sign is the stroke's")
    static: float = ta.quantity("1", low=0.0, high=5.0, default=0.8, doc="coefficient of friction at rest")
    dynamic: float = ta.quantity("1", low=0.0, high=5.0, default=0.3, doc="coefficient of friction at great speed")
    speed: float = ta.quantity("m/s", low=1e-4, high=10.0, default=0.1, doc="of half of the difference")
    attack_time: float = ta.quantity("s", low=1e-4, high=5.0, default=0.03, doc="in which force and velocity grow")
    release_time: float = ta.quantity("s", low=1e-4, high=5.0, default=0.05, doc="in which they vanish")
    roll_impedance: float = ta.quantity("N s/m", low=1e-3, high=1e4, default=4.0, doc="2 Z_R, of the string rolling")
    roll_compliance: float = ta.quantity("m/N", low=1e-9, high=1e-2, default=2e-5, doc="C, of the string rolling")
    roll_mass: float = ta.quantity("kg", low=1e-8, high=1e-2, default=1e-5, doc="m, of the string under the hair")
    sustain: float = ta.quantity("s", low=0.0, high=60.0, default=2.0, doc="of a note without an end")
    slide_time: float = ta.quantity(
        "s", low=0.0, high=5.0, default=0.0, doc="in which the stop slides under the bow from that of the note before"
    )
    direction: ta.Direction = ta.described("of the stroke", default="y")


class Bow(ta.Exciter[BowParameters]):
    """The bow; see the module."""

    api = 1
    effects = (ta.contact_effect("bow", "hair that sticks and slips, while a gesture moves it", basic=True),)
    Parameters = BowParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """The hair on the string, without force until a stroke begins."""
        p, hair = self.parameters, f"{site.string}.{name}.hair"
        if p.static < p.dynamic:
            raise self.fault(f"must not be less than dynamic, {p.dynamic:g}", "static")
        terms = site.motion("pluck", ta.unit_vector(p.direction))
        if not terms:
            raise self.fault(f"string {site.string} does not move in this direction", "direction")
        # for a normal force of 1 N: the scale of the partner's motion is then the bow force in N
        law = ta.Friction(1.0, p.static, p.dynamic, p.speed)
        # the string's surface under the hair rolls back as it is pushed
        surface, m = f"{site.string}.{name}.roll", p.roll_mass
        roll = ta.loose_mass(m, math.sqrt(1 / (p.roll_compliance * m)), 0.5 * p.roll_impedance / m)
        terms = (*terms, ta.Term(surface, "mass", 1.0))
        return ta.Attached(components={surface: roll}, connections=(ta.Connection(hair, terms, law),), resting=(hair,))

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """A stroke that begins at time 0."""
        p = self.adjusted(event.values)
        hair = f"{place.name}.{self.name}.hair"
        duration = event.duration if math.isfinite(event.duration) else p.sustain
        end = max(duration, p.attack_time)

        def course(value: float) -> tuple[ta.Segment, ...]:
            steady = (ta.Segment(p.attack_time, end, value),) if end > p.attack_time else ()
            grow = ta.smooth_step(0.0, p.attack_time, 0.0, value)
            return grow + steady + ta.smooth_step(end, end + p.release_time, value, 0.0)

        motions = (ta.Motion(hair, "scale", course(p.force)), ta.Motion(hair, "velocity", course(p.velocity)))
        slides = p.slide_time > 0 and event.stop != event.stop_before
        stops = ta.smooth_step(0.0, p.slide_time, event.stop_before, event.stop) if slides else ()
        return ta.Gesture((), ta.metres(p.from_bridge, place), motions=motions, stops=stops)
