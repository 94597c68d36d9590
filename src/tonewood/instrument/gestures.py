"""Helpers of exciters: places on strings, and smooth segments of force."""

from __future__ import annotations

from functools import cache
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


_OPTIONAL = StringPlace | None
#: share of the speaking length next to either end where a string is not played
_NEAREST = 0.01


def metres(place: StringPlace, on: Place) -> float:
    """Place in metres from the bridge, limited to 1 % of the speaking length from either end.

    A place behind the stop cannot be played; the nearest place before it is taken.
    """
    if on.length <= 0:
        raise BundleError(f"{on.name} is not a string: there is no place from its bridge")
    x = place.fraction * on.length if isinstance(place, Fraction) else float(place)
    return min(max(x, _NEAREST * on.length), (1 - _NEAREST) * on.length)


@cache
def _place_fields(kind: type[Parameters]) -> tuple[str, ...]:
    return tuple(name for name, field in kind.model_fields.items() if field.annotation in (StringPlace, _OPTIONAL))


def places(parameters: Parameters, open_length: float, length: float) -> dict[str, float]:
    """Places among parameters, given in metres or as shares of the speaking length: name -> m from the bridge.

    Raises
    ------
    ValueError : a place lies beyond the open string; names it.
    """
    found = {}
    for name in _place_fields(type(parameters)):
        place = getattr(parameters, name)
        if place is None:
            continue
        found[name] = place.fraction * length if isinstance(place, Fraction) else float(place)
        if found[name] > open_length:
            raise ValueError(
                f"{name} is {found[name]:g} m; places up to {open_length:g} m, the open string, are allowed"
            )
    return found


def is_played(x: float, length: float) -> bool:
    """Whether `metres` leaves a place x (m) from the bridge unchanged on this speaking length (m)."""
    return _NEAREST * length <= x <= (1 - _NEAREST) * length


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
