"""A bridge that the string wraps onto: the curved bone of a sitar, or a tanpura's bridge and its cotton thread.

The barrier's height over its width is a parabola, -(x - top)^2 / (2 radius), or level where no radius is given, and
lies at most at the resting string. The bridge carries it, so that the gap is the string's motion relative to its
own end. K is that of the whole width; every point has its share (van Walstijn, Bridges & Mehes 2016, "A real-time
synthesis oriented tanpura model", DAFx-16). The thread is a two-sided spring and dashpot over a width of its own, as
in the same paper. The string's residual compliance separates points closer than half the shortest wavelength.
"""

from __future__ import annotations

import math

import numpy as np

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class Thread(Parameters):
    """A soft thread between string and bridge."""

    from_bridge: float = ta.quantity("m", low=0.0, high=0.5, doc="its middle")
    width: float = ta.quantity("m", low=0.0, high=0.1, default=0.0, doc="over which it is spread")
    points: int = ta.described("number of points", default=2, ge=1, le=20, strict=True)
    stiffness: float = ta.quantity("N/m", low=0.0, high=1e9, doc="of the whole thread")
    damping: float = ta.quantity("N s/m", low=0.0, high=1e3, doc="of the whole thread")


class BarrierParameters(Parameters):
    """Parameters of the barrier."""

    start: float = ta.quantity("m", low=0.0, high=1.0, doc="edge next to the string's end, from the bridge point")
    stop: float = ta.quantity("m", low=1e-5, high=1.0, doc="edge towards the string")
    top: float = ta.quantity("m", low=0.0, high=1.0, default=0.0, doc="where it is highest")
    radius: float | None = ta.quantity("m", low=1e-3, high=1e3, default=None, doc="of curvature; level where left out")
    below: float = ta.quantity("m", low=0.0, high=0.05, default=0.0, doc="depth of the top under the resting string")
    points: int = ta.described("number of contact points", default=12, ge=1, le=100, strict=True)
    stiffness: float = ta.quantity("N/m^exponent", low=0.0, high=1e16, doc="K of the whole width")
    exponent: float = ta.quantity("1", low=1.0, high=4.0, default=1.0, doc="alpha of the contact")
    loss: float = ta.quantity("s/m", low=0.0, high=100.0, default=0.0, doc="of Hunt and Crossley")
    thread: Thread | None = ta.described("between string and bridge", default=None)
    direction: ta.Direction = ta.described("from the barrier to the string", default="z")


class BridgeBarrier(ta.Attachment[BarrierParameters]):
    """The barrier; see the module."""

    api = 1
    effects = (ta.contact_effect("bridge_barrier", "a string that rolls on and off a curved bridge"),)
    Parameters = BarrierParameters

    def height(self, x: float) -> float:
        """Height over the resting string's line x metres from the bridge, m; not above 0."""
        p = self.parameters
        return -p.below - (0.0 if p.radius is None else (x - p.top) ** 2 / (2 * p.radius))

    def attach(self, name: str, site: ta.Site) -> ta.Attached:
        """Points in the middles of equal parts of the widths."""
        p = self.parameters
        if not p.start < p.stop < site.length:
            raise self.fault(f"start {p.start:g} < stop {p.stop:g} < {site.length:g} m is wanted", "stop")
        direction = ta.unit_vector(p.direction)
        places: dict[str, float] = {}
        connections = []

        def against_bridge(point: str) -> tuple[ta.Term, ...]:
            return (*site.motion(point, direction), *site.motion("bridge", direction, -1.0))

        for i, x in enumerate(_middles(p.start, p.stop, p.points)):
            point = f"{name}.{i}"
            places[point] = x
            law = ta.Contact(p.stiffness / p.points, p.exponent, p.loss, offset=self.height(x))
            connections.append(ta.Connection(f"{site.string}.{point}", against_bridge(point), law))
        if p.thread is not None:
            t, half = p.thread, p.thread.width / 2
            for i, x in enumerate(_middles(t.from_bridge - half, t.from_bridge + half, t.points)):
                point = f"{name}.thread{i}"
                places[point] = x
                spring = ta.SpringDashpot(t.stiffness / t.points, t.damping / t.points)
                connections.append(ta.Connection(f"{site.string}.{point}", against_bridge(point), spring))
        if not all(math.isfinite(x) and x > 0 for x in places.values()):
            raise self.fault("lies beyond the string's end", "thread.from_bridge")
        return ta.Attached(places, connections=tuple(connections))


def _middles(start: float, stop: float, n: int) -> list[float]:
    return [float(start + (stop - start) * (i + 0.5) / n) for i in np.arange(n)]
