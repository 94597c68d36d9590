"""Assigns notes to strings as they come, without knowing the notes that follow.

The cost is that of `fingering`, of one chord after the other, and the cheapest way to play a chord is final:

    position · Σ stops + shift · |hand − hand before| + stretch · max(0, span − 3)² + cut · Σ weight of ended notes

A sounding note weighs 1 while its key is down, `PEDALLED` while only the pedal holds it, and 0 afterwards; the same
stop struck again costs nothing. A note always gets a string if one of them has its pitch: if all of these sound, the
one that costs least is taken, and the note on it ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.errors import ScoreError
from tonewood.instrument.scales import Tuning
from tonewood.performance.score.assignment import Assigned, PlaceResolver, PlayableString, StringMatching, by_importance
from tonewood.performance.score.fingering import HAND_SPAN, REACH, Chord, FingeringCosts, Option, ways_to_play
from tonewood.performance.score.note import Dropped, Note

#: weight of a note that only the pedal holds
PEDALLED = 0.5


@dataclass(frozen=True, slots=True)
class Sounding:
    """A note on a string now: its stop, and its weight from 0 (let go) to 1 (key down)."""

    stop: float
    weight: float


class CausalAssignment:
    """Hand of a player who reads nothing ahead.

    Parameters
    ----------
    strings, channel_per_string, tuning, costs : as for `assign`.

    Attributes
    ----------
    hand : stop under the first finger.
    """

    def __init__(
        self,
        strings: Sequence[PlayableString],
        *,
        channel_per_string: bool = False,
        tuning: Tuning | None = None,
        costs: FingeringCosts | None = None,
    ):
        self.strings, self.hand = strings, 1.0
        self._costs = costs or FingeringCosts()
        self._resolver = PlaceResolver(strings, tuning or Tuning(), channel_per_string)

    def assign(
        self, notes: Sequence[Note], sounding: Mapping[str, Sounding]
    ) -> tuple[list[Assigned], list[tuple[int, Dropped]]]:
        """Give every note of a chord a string and a stop.

        Parameters
        ----------
        notes : that begin together.
        sounding : string -> note that sounds on it now.

        Returns
        -------
        assigned : in the order of the notes, without an end.
        dropped : (index of the note, reason) of those that cannot be played.
        """
        dropped: list[tuple[int, Dropped]] = []
        playable: list[tuple[int, list[Option]]] = []
        for i, note in enumerate(notes):
            try:
                playable.append((i, self._resolver.options(note)))
            except ScoreError as error:
                dropped.append((i, _drop(note, error.reason)))
        voices = [(notes[i], options) for i, options in playable]
        matching = StringMatching(len(self.strings))
        kept = {j for j in by_importance(voices) if matching.add(voices[j][1])}
        for j, (i, _) in enumerate(playable):
            if j not in kept:
                why = f"no string is free beside the other {len(voices) - 1} notes at its moment"
                dropped.append((i, _drop(notes[i], why)))
        chord = [voices[j] for j in sorted(kept)]
        if not chord:
            return [], dropped
        chosen = self._cheapest(chord, sounding)
        return [
            Assigned(note, self.strings[o.string].name, o.stop, self._resolver.cents(note, o), math.inf)
            for (note, _), o in zip(chord, chosen, strict=True)
        ], dropped

    def _cheapest(self, chord: list[tuple[Note, list[Option]]], sounding: Mapping[str, Sounding]) -> tuple[Option, ...]:
        """Choose the cheapest way to play a chord, and move the hand there."""
        n, costs = len(self.strings), self._costs
        now = Chord(0.0, (0.0,) * len(chord), (1.0,) * len(chord), tuple(tuple(options) for _, options in chord))
        ways = ways_to_play(now, n, costs)
        stop, weight = np.zeros(n), np.zeros(n)
        for i, string in enumerate(self.strings):
            if (note := sounding.get(string.name)) is not None:
                stop[i], weight[i] = note.stop, note.weight
        stopped = np.isfinite(ways.low)
        one, other = np.where(stopped, ways.high - HAND_SPAN, -math.inf), np.where(stopped, ways.low, math.inf)
        hand = np.clip(self.hand, np.minimum(one, other), np.maximum(one, other))
        ended = ways.used & (stop != ways.stop)
        far = (stop < hand[:, None] - REACH) | (stop > hand[:, None] + HAND_SPAN + REACH)
        ended |= ~ways.used & (stop > 0) & far
        total = ways.cost + costs.shift * np.abs(hand - self.hand) + costs.cut * (ended * weight).sum(axis=1)
        best = int(np.argmin(total))
        self.hand = float(hand[best])
        return ways.choice[best]


def _drop(note: Note, reason: str) -> Dropped:
    return Dropped(note.time, note.note, note.channel, reason)
