"""Human variation: every note is played a little earlier or later, louder or softer, elsewhere and otherwise.

Each note has normal deviates of its own, drawn from the seed and its place in the score and cut at 2.5 standard
deviations. The same seed gives the same performance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tonewood.instrument.bundle.schema import HumanVariation
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.gestures import Fraction
from tonewood.performance.score.assignment import Assigned

#: standard deviations at which a deviate is cut
_MOST = 2.5
#: m, to which varied places are rounded: bases of strings are made once per place
_GRAIN = 5e-4


@dataclass(frozen=True)
class Deviates:
    """Deviates of one note, in standard deviations; of force, time, position, angle and nail."""

    force: float
    time: float
    place: float
    angle: float
    nail: float

    @classmethod
    def of(cls, seed: int, index: int) -> Deviates:
        """Draw those of the note with an index."""
        drawn = np.random.default_rng([seed, index]).standard_normal(5)
        return cls(*np.clip(drawn, -_MOST, _MOST).tolist())


def moved(assigned: Assigned, drawn: Deviates, variation: HumanVariation) -> Assigned:
    """Return a note earlier or later, and of another force if it has one; its string and stop stay."""
    note = assigned.note
    force = None if note.force is None else note.force * 10 ** (variation.force_db * drawn.force / 20)
    time = max(note.time + variation.time * drawn.time, 0.0)
    shift = time - note.time
    return replace(assigned, note=replace(note, time=time, force=force), end=assigned.end + shift)


def touched(
    values: Mapping[str, float], exciter: Exciter[Any], length: float, drawn: Deviates, variation: HumanVariation
) -> dict[str, float]:
    """Return values of an event with another position, angle and share of nail, where the exciter has them.

    values : of the event, in place of the exciter's own.
    length : m, speaking length of the string.
    """
    out, parameters = dict(values), exciter.parameters
    fields = type(parameters).model_fields
    from_bridge = values.get("from_bridge", getattr(parameters, "from_bridge", None))
    if from_bridge is not None:
        metres = from_bridge.fraction * length if isinstance(from_bridge, Fraction) else float(from_bridge)
        at = metres + variation.from_bridge * drawn.place
        out["from_bridge"] = min(max(round(at / _GRAIN) * _GRAIN, 0.02 * length), 0.98 * length)
    if "angle_deg" in fields:
        out["angle_deg"] = values.get("angle_deg", parameters.angle_deg) + variation.angle_deg * drawn.angle
    if "nail" in fields:
        out["nail"] = min(max(values.get("nail", parameters.nail) + variation.nail * drawn.nail, 0.0), 1.0)
    return out
