"""A slack thread tied from a string to the frame: it pulls the string back beyond the slack.

    V(d) = 0 for |d| <= s,    k/2 (|d| - s)^2 beyond,

with d the displacement of the string at the knot along `direction`, s the slack and k the stiffness of the thread.
It is solved for at every step. While the string cannot reach the end of the slack the thread does nothing: there it is
switched off, and nothing is lost. `ThreadEffect` decides that.
"""

from __future__ import annotations

import numpy as np

import tonewood.authoring as ta


class SlackThreadParameters(ta.Parameters):
    """Of the thread."""

    from_bridge: float = ta.quantity("m", low=0.0, high=5.0, doc="place of the knot on the string")
    slack: float = ta.quantity("m", low=1e-6, high=0.05, doc="displacement at which the thread is stretched")
    stiffness: float = ta.quantity("N/m", low=0.0, high=1e8, default=2e4, doc="of the stretched thread")
    direction: ta.Direction = ta.described("in which the thread pulls", default="z")


class ThreadEffect(ta.ConnectionsInReach):
    """Switches a string's thread on before the string can reach the end of the slack, and off well below it."""

    def reach(self, connection: str) -> float:
        """Slack of the thread, m."""
        return float(self.parameters(connection).slack)


class SlackThread(ta.Attachment[SlackThreadParameters]):
    """The thread; see the module."""

    api = 1
    effects = (
        ta.Effect(
            "slack_thread", "a thread that pulls a string back", "additive", "every gesture on the string",
            "a bound on the string's excursion at the knot", cost=lambda n: 20.0 * n, runtime=ThreadEffect,
        ),
    )  # fmt: skip
    Parameters = SlackThreadParameters

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """A knot on the string, and the potential between it and the frame."""
        p, point = self.parameters, f"{name}.thread"
        if not p.from_bridge < site.open_length:
            raise self.fault(f"string {site.string} is {site.open_length:g} m long", "from_bridge")
        s, k = p.slack, p.stiffness
        # V = c0 + c1 u + c2 u^2 + c3 u^3 from each of the knots -2s, -s, s up to the next one, 2s
        pieces = np.array([[k * s**2 / 2, -k * s, k / 2, 0.0], [0.0] * 4, [0.0, 0.0, k / 2, 0.0]])
        law = ta.SampledPotential(np.array([-2 * s, -s, s, 2 * s]), pieces)
        terms = site.motion(point, ta.unit_vector(p.direction))
        return ta.Attached({point: p.from_bridge}, connections=(ta.Connection(f"{site.string}.{point}", terms, law),))
