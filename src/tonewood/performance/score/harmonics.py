"""Harmonics of a string: the partial that a light finger leaves, touching at a fret, and its pitch.

A finger at k/n of the string's length leaves the partials that have a node there; the lowest is the n-th. That node
lies above fret

    f = -12 lg(1 - k/n) / lg 2,

and the partial sounds 12 lg(n) / lg 2 semitones above the string, in whole semitones 12, 19, 24, 28, 31, 34, 36.

Source: N. H. Fletcher and T. D. Rossing, The Physics of Musical Instruments (Springer 1998), section 2.3.
"""

from __future__ import annotations

import math
from collections import Counter
from functools import cache

#: highest partial, and the largest distance of a touch from its node, frets
_HIGHEST, _NEAR = 8, 0.7


@cache
def _nodes() -> tuple[tuple[float, int], ...]:
    """Frets over which nodes lie, and the lowest partial of each."""
    return tuple(
        (-12 * math.log2(1 - k / n), n) for n in range(2, _HIGHEST + 1) for k in range(1, n) if math.gcd(k, n) == 1
    )


def partial_at(fret: float) -> int | None:
    """Number of the partial that a touch at a fret (counted from the stop) leaves; None where no node is near."""
    away, partial = min((abs(node - fret), n) for node, n in _nodes())
    return partial if away <= _NEAR else None


def middle_node(partial: int) -> float:
    """Place of the node of a partial that is next to the middle, as a share of the length.

    A finger there damps the lower partials most, and leaves the same ones as at the partial's other nodes.
    """
    return max(k for k in range(1, partial) if math.gcd(k, partial) == 1 and 2 * k <= partial) / partial


def antinode_near(partial: int, share: float) -> float:
    """Point nearest to `share` at which a partial moves most; both are shares of the length.

    A pluck there drives the partial well and twice its frequency not at all: what is an antinode of one is a node of
    the other.
    """
    i = min(max(round(partial * share - 0.5), 0), partial - 1)
    return (2 * i + 1) / (2 * partial)


def interval(partial: int) -> int:
    """Semitones of a partial above its string, to the nearest whole one."""
    return round(12 * math.log2(partial))


def touched(fret: int, pitch: float, node: float, natural: bool, ignored: Counter[str]) -> tuple[int, float, int]:
    """Stop, pitch and partial of a harmonic of a tablature.

    fret, pitch : where the note is written, and as it would sound there.
    node : frets from the stop to the touch; of a natural harmonic the stop is the open string.
    ignored : counts those that touch no node, which are plucked as written.
    """
    partial = partial_at(node)
    if partial is None:
        ignored["harmonic that touches no node, plucked as a note"] += 1
        return fret, pitch, 0
    if natural:
        return 0, pitch - fret + interval(partial), partial
    return fret, pitch + interval(partial), partial
