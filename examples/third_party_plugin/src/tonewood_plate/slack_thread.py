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


class ThreadEffect(ta.SwitchedConnections):
    """Switches a string's thread on before the string can reach the end of the slack, and off well below it.

    All that moves of it is the set of strings whose thread is on, which the engine keeps.
    """

    #: shares of the slack: a thread is switched on above the first and off below the second. The energy of a string
    #: that is not played would have to grow fourfold from one look to the next to reach the slack unseen
    ON, OFF = 0.5, 0.4
    #: points of the control grid (64 samples) between two looks; the second where all threads are on, since switching
    #: one off late loses only time
    LOOK, SELDOM = 16, 64

    def next_watch(self, sample: int, switching: ta.Switching) -> int:
        """Look at all strings at fixed samples, whatever is played."""
        return ta.next_multiple(sample, self.looks(switching))

    def looks(self, switching: ta.Switching) -> int:
        """Points of the control grid between two looks."""
        return self.LOOK if len(switching.on) < len(self.components) else self.SELDOM

    def watch(self, moment: ta.Moment, switching: ta.Switching) -> ta.Watched | None:
        """Compare a bound on the excursion at the knot with the slack; gestures switch the thread on at once."""
        if moment.sample % (64 * self.looks(switching)) and not (moment.moved or moment.fresh):
            return None
        wanted = set(moment.busy) & set(self.components)
        for string in self.components:
            share = self.ON if string not in switching.on else self.OFF
            excursion = self.excursion(moment.system, moment.state, string)
            slack = [self.slack(name) for name in self.names(string)]
            if np.any(excursion > share * np.array(slack)):
                wanted.add(string)
        return ta.Watched(frozenset(wanted), [(s, ta.Bound(), s not in wanted) for s in self.components])

    def slack(self, connection: str) -> float:
        """Slack of the thread of a connection ``STRING.PART.thread``, m."""
        return float(self.plugins[connection.split(".")[1]].parameters.slack)


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
