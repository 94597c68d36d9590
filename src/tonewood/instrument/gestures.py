"""What exciters share: places on strings, and smooth pieces of force."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from tonewood.errors import BundleError
from tonewood.instrument.contract import Place, Segment
from tonewood.params import Number, Parameters, quantity


class Fraction(Parameters):
    """A place as a share of the speaking length, from the bridge."""

    fraction: float = quantity("1", low=0.0, high=1.0, doc="0 is the bridge, 1 the nut or stop")


#: metres from the bridge, or ``{fraction: share of the speaking length}``
StringPlace = Annotated[Number, Field(ge=0.0)] | Fraction


def metres(place: StringPlace, on: Place) -> float:
    """Place in metres from the bridge; between 1 % of the string from the bridge and 1 % from the stop.

    A played place beyond the stop does not exist; the nearest that does is taken.
    """
    if on.length <= 0:
        raise BundleError(f"{on.name} is not a string: there is no place from its bridge")
    x = place.fraction * on.length if isinstance(place, Fraction) else float(place)
    return min(max(x, 0.01 * on.length), 0.99 * on.length)


def smooth_step(start: float, stop: float, low: float, high: float) -> tuple[Segment, ...]:
    """Force that goes from `low` to `high` (N) between two times (s) by two parabolas, level at both ends."""
    if stop <= start:
        return ()
    width, rise = stop - start, high - low
    middle, bend = start + width / 2, 2 * rise / width**2
    return (
        Segment(start, middle, low, 0.0, bend),
        Segment(middle, stop, low + rise / 2, 2 * rise / width, -bend),
    )
