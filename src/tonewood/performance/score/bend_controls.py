"""Controls of pitch for the bends, the whammy bar and the vibrato of a written note."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Protocol

from tonewood.performance.score.bend_curves import Curve, value_at
from tonewood.performance.score.limits import Allowance
from tonewood.performance.score.note import Control
from tonewood.performance.score.score_clock import ScoreClock

#: Hz of a vibrato, and s between two of its controls and of a bend's
_VIBRATO, _TICK = 5.5, 0.02
#: cents of vibrato by sign
VIBRATO_DEPTHS = {"vibrato": 35.0, "wide_vibrato": 80.0}


class BentSign(Protocol):
    """What a written note says of its pitch."""

    @property
    def tied(self) -> bool:
        """Whether it goes on from the note before."""

    @property
    def bend(self) -> Curve:
        """Its bend."""

    @property
    def whammy(self) -> Curve:
        """That of the bar."""

    @property
    def signs(self) -> tuple[str, ...]:
        """Names of its other signs."""


def _held(curve: Curve) -> Curve:
    """Where a bend has ended, for a tied note without one of its own."""
    return ((0.0, curve[-1][1]),) if curve and curve[-1][1] else ()


def bend_controls(
    bent: Sequence[tuple[Fraction, BentSign]],
    begins: Fraction,
    ends: Fraction,
    until: float,
    channel: int,
    clock: ScoreClock,
    most: Allowance,
) -> list[Control]:
    """Controls of a note's bends, whammy and vibrato; the last bend holds until the note sounds no more.

    bent : times, in whole notes, and signs of the note and of those tied to it.
    begins, ends : of the note, whole notes.
    until : s, when its string is silent or another note begins on it.
    """
    out: list[Control] = []
    bend: Curve = ()
    bar: Curve = ()
    for i, (at, sign) in enumerate(bent):
        if not sign.tied:  # struck, or a slide to another fret
            bend, bar = (), ()
        bend, bar = sign.bend or _held(bend), sign.whammy or _held(bar)
        depth = sum(VIBRATO_DEPTHS.get(name, 0.0) for name in sign.signs)
        if not (bend or bar or depth):
            if out:
                out.append(Control(clock.seconds(at), "bend", 0.0, channel))
            continue
        begin = clock.seconds(max(at, begins))
        end = clock.seconds(bent[i + 1][0] if i + 1 < len(bent) else ends)
        moves = depth or len(bend) > 1 or len(bar) > 1
        n = max(math.ceil((end - begin) / _TICK), 1) if moves else 1
        most.take(n)
        for k in range(n):
            share = k / n
            cents = value_at(bend, share) + value_at(bar, share)
            cents += depth * math.sin(math.pi * _VIBRATO * (end - begin) * share) ** 2
            value = float(round(cents))
            if not out or value != out[-1].value:
                out.append(Control(begin + (end - begin) * share, "bend", value, channel))
    out = [control for control in out if control.time < until]
    return [*out, Control(until, "bend", 0.0, channel)] if out else []
