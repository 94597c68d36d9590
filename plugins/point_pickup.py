"""Channels that read the motion of points, or the force of strings on their bridge.

Displacement and velocity are read at each sample's time; acceleration and force are means over the sample that begins
there. ``body.NAME`` reads along the point's own direction, ``STRING.NAME`` along `direction` through both
polarizations; ``STRING.bridge`` with quantity ``force`` is the force of that string on the body.
"""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

import tonewood.authoring as ta
from tonewood.authoring import Parameters

UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N"}


class Mean(Parameters):
    """Several points heard together."""

    mean: list[str] = ta.described("points whose mean is read", min_length=1)


Places = str | Mean


class PointPickupParameters(Parameters):
    """Parameters of the pickup."""

    quantity: Literal["displacement", "velocity", "acceleration", "force"] = ta.described("quantity read")
    at: Places | None = ta.described("point, or {mean: [points]}: one channel with the group's name", default=None)
    channels: dict[str, Places] | None = ta.described(
        "name -> point or {mean: [points]}: several channels", default=None
    )
    direction: ta.Direction = ta.described("direction in which points of strings are read", default="z")

    @model_validator(mode="after")
    def _one_way(self) -> PointPickupParameters:
        if (self.at is None) == (not self.channels):
            raise ValueError("either `at` or `channels` is wanted")
        return self


class PointPickup(ta.Pickup[PointPickupParameters]):
    """The pickup; see the module."""

    api = 1
    Parameters = PointPickupParameters

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels; of a single one the quantity."""
        return tuple(self.parameters.channels) if self.parameters.channels else (self.parameters.quantity,)

    @property
    def unit(self) -> str:
        """Unit of the quantity read."""
        return UNITS[self.parameters.quantity]

    def rows(self, name: str, scene: ta.Scene) -> ta.PickupRows:
        """One readout per channel."""
        sources = self.parameters.channels or {self.channels[0]: self.parameters.at or ""}
        return ta.PickupRows(
            tuple(self._readout(f"{name}.{channel}", source, scene) for channel, source in sources.items())
        )

    def _readout(self, name: str, source: Places, scene: ta.Scene) -> ta.Readout:
        points = source.mean if isinstance(source, Mean) else [source]
        share, direction = 1.0 / len(points), ta.unit_vector(self.parameters.direction)
        if self.parameters.quantity == "force":
            forces: list[tuple[str, float]] = []
            for point in points:
                string, _, end = point.partition(".")
                if string not in scene.end_forces or end != "bridge":
                    allowed = ", ".join(f"{s}.bridge" for s in scene.end_forces)
                    raise self.fault(f"force can be read at {allowed}; not at {point!r}")
                forces += [(connection, -share * ta.dot(v, direction)) for connection, v in scene.end_forces[string]]
            return ta.Readout(name, "force", forces=tuple(f for f in forces if f[1] != 0.0))
        probes: list[ta.Term] = []
        for point in points:
            component, _, point_name = point.partition(".")
            if component == "body" and point_name in scene.body_points:
                probes.append(ta.Term("body", point_name, share))
            elif point in scene.string_points:
                probes += [ta.Term(c, p, share * ta.dot(v, direction)) for c, p, v in scene.string_points[point]]
            else:
                choices = [f"body.{p}" for p in scene.body_points] + list(scene.string_points)
                raise self.fault(f"there is no point {point!r}; there are {', '.join(choices)}")
        return ta.Readout(name, self.parameters.quantity, tuple(p for p in probes if p.factor != 0.0))
