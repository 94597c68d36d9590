"""Limits of scores: numbers of a file within bounds, and counts that end in one line while a file is read."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from numbers import Real

from tonewood.errors import ScoreError
from tonewood.support.units import number_in

#: most notes of written music (the densest file takes some 7 s to read), and most controls
MAX_NOTES, MAX_CONTROLS = 60_000, 400_000
#: s, end of a score
MAX_TIME = 6 * 3600.0
#: characters of a number
_LONGEST = 40


def number(said: object, low: float, high: float) -> float | None:
    """Number that a text or a field of a file says, written with the digits 0 to 9.

    said : the text, or the field's number.
    low, high : both ends are allowed.
    Returns The number; None where it is none, or beyond the bounds.
    """
    if isinstance(said, str):
        value = number_in(said) if len(said) <= _LONGEST else math.nan
    else:
        try:
            value = float(said) if isinstance(said, Real) else math.nan
        except OverflowError:
            value = math.nan
    return value if low <= value <= high else None


def whole(said: object, low: int, high: int) -> int | None:
    """Whole part of a `number`; None where there is none, or beyond the bounds."""
    value = number(said, low, high)
    return None if value is None else int(value)


@dataclass
class Allowance:
    """What may be counted yet of a kind while a file is read.

    most : the limit.
    kind : name of the things counted, in the plural.
    file : for the error.
    """

    most: int
    kind: str
    file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        self.left = self.most

    def take(self, n: int = 1) -> None:
        """Count some; raises a `ScoreError` of one line beyond the limit."""
        self.left -= n
        if self.left < 0:
            raise ScoreError(f"more than {self.most} {self.kind}", file=self.file)
