"""Fingering of least cost for a sequence of chords: a beam search over positions of the hand and ringing strings.

The cost of a piece is the sum over its chords of

    position · Σ stops                          low positions
  + shift    · |hand − hand before|             few and small shifts
  + stretch  · max(0, span − 3)²                four neighbouring frets are comfortable, more cost, none is forbidden
  + cut      · Σ time cut off ended notes       as a fraction of their duration, 0 for the same stop struck again

The hand is the stop under the first finger; it begins at stop 1 and covers `HAND_SPAN` more. It moves only when the
stopped notes of a chord lie outside it, and then as little as possible; open strings leave it where it is. A stopped
note that still rings more than `REACH` stops outside the hand's new place counts as ended too (its finger has to
leave), though it is left to ring.

The state between two chords is the hand's place and, for each string that still rings, its stop, its end and whether
a finger holds it. States that are equal are merged, the cheapest kept: without a limit on their number the search
would be exact. The beam keeps the `BEAM_WIDTH` cheapest, and of each chord the `MAX_FINGERINGS` cheapest ways to play
it; the work is then proportional to the number of chords.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

HAND_SPAN = 3.0
REACH = 1.0
BEAM_WIDTH = 64
MAX_FINGERINGS = 96
# Notes that end this close to the next one's beginning are taken as legato, not as cut
LEGATO = 0.001


@dataclass(frozen=True)
class FingeringCosts:
    """Weights of the cost, in units of a shift by one stop."""

    position: float = 0.1
    shift: float = 1.0
    stretch: float = 1.0
    cut: float = 6.0


class Option(NamedTuple):
    """A way to play a note: index of the string, stop (0 is open)."""

    string: int
    stop: float


@dataclass(frozen=True)
class Chord:
    """Notes that begin together at `time` (s): for each its end, its duration and where it can be played.

    It must be possible to play all of them on different strings.
    """

    time: float
    ends: tuple[float, ...]
    durations: tuple[float, ...]
    options: tuple[tuple[Option, ...], ...]


class _Partial(NamedTuple):
    """Some notes of a chord in place: their cost by themselves, strings taken (bits), lowest, highest, sum of stops."""

    cost: float
    taken: int
    places: tuple[Option, ...]
    low: float
    high: float
    total: float

    def with_note(self, option: Option, costs: FingeringCosts) -> _Partial:
        """One note more."""
        string, stop = option
        low, high, total = self.low, self.high, self.total
        if stop > 0:
            low, high, total = min(low, stop), max(high, stop), total + stop
        cost = costs.position * total + costs.stretch * max(0.0, high - low - HAND_SPAN) ** 2
        return _Partial(cost, self.taken | 1 << string, (*self.places, option), low, high, total)


class Fingerings(NamedTuple):
    """Ways to play one chord, as arrays over (way, string); `choice` is over (way, note)."""

    choice: list[tuple[Option, ...]]
    used: NDArray[np.bool_]
    stop: NDArray[np.float64]
    end: NDArray[np.float64]
    duration: NDArray[np.float64]
    cost: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class _States(NamedTuple):
    """Hypotheses after a chord: cost and hand per state, the rest over (state, string)."""

    cost: NDArray[np.float64]
    hand: NDArray[np.float64]
    end: NDArray[np.float64]
    duration: NDArray[np.float64]
    stop: NDArray[np.float64]
    stopped: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sounding:
    """A note on a string before the first chord: its stop, and its weight from 0 (let go) to 1 (key down)."""

    stop: float
    weight: float


def hand_after(hand: float, chosen: Sequence[Option]) -> float:
    """Return where the first finger is after a chord: moved no farther than its stopped notes ask for."""
    stops = [option.stop for option in chosen if option.stop > 0]
    if not stops:
        return hand
    ends = max(stops) - HAND_SPAN, min(stops)
    return min(max(hand, min(ends)), max(ends))


def finger(
    chords: Sequence[Chord],
    n_strings: int,
    costs: FingeringCosts,
    *,
    hand: float = 1.0,
    sounding: Mapping[int, Sounding] | None = None,
) -> tuple[list[tuple[Option, ...]], float]:
    """Choose a string and a stop for every note of every chord.

    hand : stop under the first finger before the first chord.
    sounding : string -> note on it at time 0.
    Returns chosen : per chord one option per note, on different strings.
    cost : of the whole piece, as defined above.
    """
    stops, ends = np.zeros((1, n_strings)), np.full((1, n_strings), -math.inf)
    for i, note in (sounding or {}).items():
        stops[0, i], ends[0, i] = note.stop, note.weight or -math.inf
    stopped = (stops > 0).astype(float)
    states = _States(np.zeros(1), np.array([hand]), ends, np.ones((1, n_strings)), stops, stopped)
    steps: list[tuple[list[tuple[Option, ...]], NDArray[np.int16], NDArray[np.int16]]] = []
    for i, chord in enumerate(chords):
        ways = ways_to_play(chord, n_strings, costs)
        until = chords[i + 1].time if i + 1 < len(chords) else math.inf
        states, parent, way = _advance(states, ways, chord.time, until, costs)
        steps.append((ways.choice, parent, way))
    best = int(np.argmin(states.cost))
    cost = float(states.cost[best])
    chosen: list[tuple[Option, ...]] = []
    for choice, parent, way in reversed(steps):
        chosen.append(choice[way[best]])
        best = int(parent[best])
    return chosen[::-1], cost


def ways_to_play(chord: Chord, n_strings: int, costs: FingeringCosts) -> Fingerings:
    """Ways to play a chord: all of them, or the cheapest by themselves if there are many."""
    order = sorted(range(len(chord.options)), key=lambda i: len(chord.options[i]))
    partial = [_Partial(0.0, 0, (), math.inf, 0.0, 0.0)]
    for rank, i in enumerate(order):
        grown = [
            way.with_note(option, costs)
            for way in partial
            for option in chord.options[i]
            if not way.taken >> option.string & 1
        ]
        grown.sort(key=itemgetter(0))
        if len(grown) > MAX_FINGERINGS:
            grown = _cheapest_completable(grown, [chord.options[j] for j in order[rank + 1 :]])
        partial = grown
    unsort = sorted(range(len(order)), key=order.__getitem__)
    choice = [tuple(way.places[j] for j in unsort) for way in partial]

    shape = (len(choice), n_strings)
    used, stop = np.zeros(shape, dtype=bool), np.zeros(shape)
    end, duration = np.zeros(shape), np.ones(shape)
    rows = np.arange(len(choice))
    for note in range(len(chord.options)):
        string = np.array([places[note].string for places in choice])
        used[rows, string] = True
        stop[rows, string] = [places[note].stop for places in choice]
        end[rows, string] = chord.ends[note]
        duration[rows, string] = chord.durations[note]
    low = np.where(stop > 0, stop, math.inf).min(axis=1)
    return Fingerings(choice, used, stop, end, duration, np.array([way.cost for way in partial]), low, stop.max(axis=1))


class StringMatching:
    """Notes matched to strings, one each; adding a note moves earlier ones aside where that helps.

    The sets of notes that can be matched are the independent sets of a (transversal) matroid: taking notes greedily
    by importance keeps as many as any choice could, and the most important ones.

    taken : strings, as bits, that are given to no note.
    """

    def __init__(self, taken: int = 0):
        self._taken = taken
        self._options: dict[int, Sequence[Option]] = {}  # of the note on each string

    def copy(self) -> StringMatching:
        """A matching to try on."""
        other = StringMatching(self._taken)
        other._options = dict(self._options)
        return other

    def add(self, options: Sequence[Option]) -> bool:
        """Match one more note; False, and nothing changes, if that is impossible."""
        return self._augment(options, set())

    def _augment(self, options: Sequence[Option], tried: set[int]) -> bool:
        for option in options:
            string = option.string
            if string not in tried and not self._taken >> string & 1:
                tried.add(string)
                if string not in self._options or self._augment(self._options[string], tried):
                    self._options[string] = options
                    return True
        return False


def _cheapest_completable(ways: list[_Partial], rest: list[tuple[Option, ...]]) -> list[_Partial]:
    """The first `MAX_FINGERINGS` that leave strings for the rest of the chord."""
    kept: list[_Partial] = []
    completable: dict[int, bool] = {}
    for way in ways:
        if way.taken not in completable:
            matching = StringMatching(way.taken)
            completable[way.taken] = all(matching.add(options) for options in rest)
        if completable[way.taken]:
            kept.append(way)
            if len(kept) == MAX_FINGERINGS:
                break
    return kept


def _advance(
    states: _States, ways: Fingerings, time: float, until: float, costs: FingeringCosts
) -> tuple[_States, NDArray[np.int16], NDArray[np.int16]]:
    """Play every way from every state; keep the cheapest, and where each came from."""
    # arrays below are over (state, way) or (state, way, string)
    stopped = np.isfinite(ways.low)
    one, other = np.where(stopped, ways.high - HAND_SPAN, -math.inf), np.where(stopped, ways.low, math.inf)
    hand = np.clip(states.hand[:, None], np.minimum(one, other), np.maximum(one, other))
    remains = np.maximum(states.end - time, 0.0) / states.duration
    lost = remains[:, None, :] * (ways.used & (states.stop[:, None, :] != ways.stop))
    left = (states.stopped[:, None, :] > 0) & ~ways.used
    left &= (states.stop[:, None, :] < hand[:, :, None] - REACH) | (
        states.stop[:, None, :] > hand[:, :, None] + HAND_SPAN + REACH
    )
    lost += remains[:, None, :] * left
    total = states.cost[:, None] + ways.cost + costs.shift * np.abs(hand - states.hand[:, None])
    total += costs.cut * lost.sum(axis=2)

    # more than the beam keeps, as equal states will be merged
    flat = total.ravel()
    n_first = min(4 * BEAM_WIDTH, flat.size)
    first = np.argpartition(flat, n_first - 1)[:n_first] if n_first < flat.size else np.arange(flat.size)
    first = first[np.lexsort((first, flat[first]))]
    parent, way = np.divmod(first, total.shape[1])
    used = ways.used[way]
    end = np.where(used, ways.end[way], states.end[parent])
    rings = end > until + LEGATO
    stop = np.where(rings, np.where(used, ways.stop[way], states.stop[parent]), 0.0)
    duration = np.where(rings, np.where(used, ways.duration[way], states.duration[parent]), 1.0)
    is_stopped = np.where(used, ways.stop[way] > 0, (states.stopped[parent] > 0) & ~left[parent, way]) & rings
    end = np.where(rings, end, -math.inf)
    hand = hand[parent, way]

    table = np.ascontiguousarray(np.column_stack([hand, end, duration, stop, is_stopped]))
    rows = table.view(np.dtype((np.void, table.dtype.itemsize * table.shape[1]))).ravel()
    kept = np.sort(np.unique(rows, return_index=True)[1])[:BEAM_WIDTH]
    after = _States(
        flat[first[kept]], hand[kept], end[kept], duration[kept], stop[kept], is_stopped[kept].astype(float)
    )
    return after, parent[kept].astype(np.int16), way[kept].astype(np.int16)
