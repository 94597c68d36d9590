"""Courses of bends over a note."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import itemgetter

#: (share of the note, cents), in order of the share
Curve = tuple[tuple[float, float], ...]


def value_at(curve: Curve, share: float) -> float:
    """Value of a curve between its points."""
    if not curve:
        return 0.0
    if len(curve) == 1 or not curve[0][0] <= share <= curve[-1][0]:
        return curve[0][1] if share < curve[0][0] else curve[-1][1]
    i = max(bisect_left(curve, share, key=itemgetter(0)), 1)
    (a, low), (b, high) = curve[i - 1 : i + 1]
    return high if b == a else low + (high - low) * (share - a) / (b - a)


def bend_curve(points: Sequence[tuple[float, float]]) -> Curve:
    """Curve through points (share of the note, cents) in any order; nothing where all are 0."""
    ordered = tuple(sorted((min(max(share, 0.0), 1.0), cents) for share, cents in points))
    return ordered if any(cents for _, cents in ordered) else ()
