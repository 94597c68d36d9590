"""Seconds of the quarter notes of written music: tempos and fermatas, with repeats unfolded."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from fractions import Fraction
from operator import itemgetter
from pathlib import Path

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import MAX_TIME, Allowance
from tonewood.performance.score.note import Beats
from tonewood.performance.score.unfolding import Measure

#: times its length that a note under a fermata lasts
HOLD = 1.5
#: quarter notes per minute
TEMPOS = (4.0, 2000.0)
#: tempo changes that are played
MOST_TEMPOS = 60_000
#: denominators of times are rounded to
_FINEST = 10**9
#: s by which grace notes may come before the first measure: all others are then later
_BEFORE = 2.0


def near(time: Fraction) -> Fraction:
    """Return a time, rounded where its denominator is beyond any that music has: sums of such would grow."""
    return time if time.denominator <= _FINEST else time.limit_denominator(_FINEST)


class ScoreClock:
    """Seconds of a time in quarter notes, with repeats unfolded."""

    def __init__(self, measures: Sequence[Measure], played: Sequence[int], file: Path):
        self.starts: list[Fraction] = []
        now, bpm = Fraction(0), 120.0
        self._at, self._time, self._bpm, self._late = [Fraction(0)], [0.0], [bpm], 0.0
        self._at_floats = [0.0]  # `_at` as floats: fractions take twenty times as long to compare
        tempos = [_tempos(m) for m in measures]
        changes = Allowance(MOST_TEMPOS, "tempo changes, repeats unfolded", file)
        for i in played:
            self.starts.append(now)
            changes.take(len(tempos[i]))
            for at, tempo, slower in tempos[i]:
                bpm = tempo or bpm
                self._enter(now + at, bpm * slower)
            now = near(now + measures[i].length)
        if not 0.0 <= (end := self.seconds(now)) <= MAX_TIME:
            raise ScoreError(f"{end:.6g} s of music, repeats unfolded: {MAX_TIME:.0f} s are allowed", file=file)

    def _enter(self, at: Fraction, bpm: float) -> None:
        self._time.append(self.seconds(at))
        self._at.append(at)
        self._at_floats.append(float(at))
        self._bpm.append(bpm)

    def seconds(self, at: Fraction) -> float:
        """Time of a quarter note, s."""
        i = bisect_right(self._at_floats, max(float(at), 0.0)) - 1
        return self._late + self._time[i] + float(at - self._at[i]) * 60.0 / self._bpm[i]

    def beats(self, measures: Sequence[Measure], played: Sequence[int]) -> Beats:
        """Tempos and measures as a score has them."""
        tempos = [(self._late + t, float(at), bpm) for t, at, bpm in zip(self._time, self._at, self._bpm, strict=True)]
        meters = [(float(at), float(measures[i].length)) for at, i in zip(self.starts, played, strict=True)]
        return Beats(tempos, [m for m in meters if m[1] > 0] or [(0.0, 4.0)])

    def begin_before(self, early: Iterable[Fraction]) -> None:
        """Let all come later by the first of notes before the first measure, at most by `_BEFORE`."""
        self._late = max((-t for t in map(self.seconds, early) if t >= -_BEFORE), default=0.0)


def _tempos(measure: Measure) -> list[tuple[Fraction, float | None, float]]:
    """(quarter notes, tempo if it changes, factor on it) of a measure, where notes are held.

    Of two tempos at one place the one read later holds: a tablature's first beat and later tracks change the tempo.
    """
    changes: dict[Fraction, float | None] = dict(measure.tempos)
    for hold in measure.holds:
        for at in hold:
            changes.setdefault(at, None)
    begun = sorted(float(begin) for begin, _ in measure.holds)
    ended = sorted(float(end) for _, end in measure.holds)
    return [
        (at, tempo, 1.0 / HOLD if bisect_right(begun, time) > bisect_right(ended, time) else 1.0)
        for time, at, tempo in sorted(((float(at), at, tempo) for at, tempo in changes.items()), key=itemgetter(0))
    ]
