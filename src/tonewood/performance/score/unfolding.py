"""Order in which the measures of written music are played: repeats, endings, and jumps by signs.

Two customs differ in what a repeat sign without a beginning goes back to, and in when it counts:

=============  ===========================================  ==========================================================
custom         goes back to                                 counts
=============  ===========================================  ==========================================================
scores         the measure after the repeat sign before it  passes over all endings of a repeat, only where it is played
Guitar Pro     the last beginning, or the first measure     passes of each repeat sign by itself, also where the pass
                                                            skips its measure
=============  ===========================================  ==========================================================

After a jump no repeat is played; from a coda on they are again. In a score a jump obeys every ``fine`` and ``to_coda``
after it; one of Guitar Pro the sign that it names, e.g. ``da_capo_al_fine``, and one without a name none. Each jump is
taken once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import groupby

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import Allowance

#: measures that are played, and those looked at on the way
_MOST_MEASURES, _MOST_STEPS = 20_000, 200_000
#: jump -> the sign to which it leads; None is the beginning
_LEADS = {"da_capo": None, "dal_segno": "segno", "dal_segno_segno": "segno_segno"}
#: sign of leaving after a jump -> the sign to which it leads
_LEAVES = {"to_coda": "coda", "to_double_coda": "double_coda"}
#: what a jump obeys that names nothing, in a score
_ALL = frozenset({"fine", "coda", "double_coda"})


@dataclass
class Measure:
    """A measure of all parts: its length in quarter notes, tempo changes (at, bpm), repeats and jumps.

    opens : a repeat begins here.
    closes : how often it is played up to here, 0 for no repeat sign.
    endings : passes in which it is played; empty for all.
    signs : ``segno``, ``coda``, ``fine``, ``to_coda``, ``da_capo``, ``dal_segno``: marks and jumps.
    feel : (note value in quarter notes, share of two of them that the first one takes); None for even ones.
    holds : (from, to) in quarter notes, of notes under a fermata.
    """

    length: Fraction = Fraction(4)
    tempos: list[tuple[Fraction, float]] = field(default_factory=list)
    opens: bool = False
    closes: int = 0
    endings: frozenset[int] = frozenset()
    signs: set[str] = field(default_factory=set)
    feel: tuple[Fraction, Fraction] | None = None
    holds: set[tuple[Fraction, Fraction]] = field(default_factory=set)


def order(measures: Sequence[Measure], *, tablature: bool = False) -> list[int]:
    """Measures in the order in which they are played, repeats, endings and jumps unfolded.

    tablature : by the custom of Guitar Pro.
    Raises ScoreError : they would go on for more than 20000 measures, or ten times as many are passed over.
    """
    repeats: _Tablature | _Score = _Tablature(measures) if tablature else _Score(measures)
    jumps, exits = _targets(measures, tablature)
    steps = Allowance(_MOST_STEPS, "measures, repeats unfolded, with those that are left out")
    out: list[int] = []
    taken: set[tuple[int, str]] = set()
    obeyed: frozenset[str] | None = None  # since a jump
    i = 0
    while i < len(measures):
        steps.take()
        sounds = repeats.plays(i, jumped=obeyed is not None)
        if sounds:
            out.append(i)
            if len(out) > _MOST_MEASURES:
                raise ScoreError(f"more than {_MOST_MEASURES} measures, repeats unfolded")
        if obeyed is not None and sounds:
            if "fine" in obeyed and "fine" in measures[i].signs:
                break
            to = next((at for mark, at in exits[i].items() if mark in obeyed and at is not None), None)
            if to is not None:
                i, obeyed = to, None
                repeats.restart(i)
                continue
        following = repeats.after(i, sounds, jumped=obeyed is not None)
        if obeyed is None and (tablature or (sounds and following == i + 1)):
            back = next(((s, at) for s, at in jumps[i].items() if at is not None and (i, s) not in taken), None)
            if back is not None:
                taken.add((i, back[0]))
                following, obeyed = back[1], _obeyed(back[0], tablature)
                repeats.restart(following)
        i = following
    return out


def lost_jumps(measures: Sequence[Measure], *, tablature: bool = False) -> Counter[str]:
    """Jumps that lead nowhere, by name."""
    out: Counter[str] = Counter()
    for places in _targets(measures, tablature):
        for targets in places:
            for name, at in targets.items():
                leaves = name in _LEAVES.values()
                words = name if leaves else _base(name)
                out[_nowhere(words, leaves)] += at is None
    return +out


def _nowhere(name: str, leaves: bool) -> str:
    words = name.replace("_", " ")
    return f"to {words} without a {words}" if leaves else f"{words} without a {words.removeprefix('dal ')}"


def _base(jump: str) -> str:
    return jump.partition("_al_")[0]


def _obeyed(jump: str, tablature: bool) -> frozenset[str]:
    """Marks that are obeyed after a jump."""
    goal = jump.partition("_al_")[2]
    return frozenset({goal}) if goal else frozenset() if tablature else _ALL


def _targets(
    measures: Sequence[Measure], tablature: bool
) -> tuple[list[dict[str, int | None]], list[dict[str, int | None]]]:
    """Of each measure: jumps -> the measures they lead to, and marks to which its signs of leaving lead -> measures.

    In a score a jump leads to the first segno so far, and leaving to the next coda; in a tablature to the nearest one
    on that side, or else on the other.
    """
    jumps: list[dict[str, int | None]] = [{} for _ in measures]
    exits: list[dict[str, int | None]] = [{} for _ in measures]
    places: dict[str, list[int]] = {}
    for i, measure in enumerate(measures):
        for sign in measure.signs:
            places.setdefault(sign, []).append(i)
    seen: Counter[str] = Counter()
    for i, measure in enumerate(measures):
        for sign in measure.signs:
            seen[sign] += 1
        for sign in sorted(measure.signs):
            if (base := _base(sign)) in _LEADS:
                mark = _LEADS[base]
                there = places.get(mark, []) if mark else [0]
                n = seen[mark] if mark else 1
                back = there[(n - 1) if tablature else 0] if n else there[0] if tablature and there else None
                jumps[i][sign] = back
            elif sign in _LEAVES:
                mark = _LEAVES[sign]
                there, n = places.get(mark, []), seen[mark] - (mark in measure.signs)
                n += not tablature and mark in measure.signs
                forth = there[n] if n < len(there) else there[-1] if tablature and there else None
                exits[i][mark] = forth
    return jumps, exits


class _Score:
    def __init__(self, measures: Sequence[Measure]):
        self._measures = measures
        self._played: Counter[int] = Counter()
        #: of a measure whose ending another one follows, the highest pass that they name; 0 of others
        self._highest = [0] * len(measures)
        for bracketed, group in groupby(range(len(measures)), lambda i: bool(measures[i].endings)):
            its = list(group) if bracketed else []
            highest = max(map(max, {measures[i].endings for i in its}), default=0)
            for i in its:
                self._highest[i] = highest if measures[i].endings != measures[its[-1]].endings else 0
        self.restart(0)

    def restart(self, i: int) -> None:
        """Begin a repeat at a measure."""
        self._begin, self._passes = i, 1

    def plays(self, i: int, *, jumped: bool) -> bool:
        """Whether this pass plays a measure."""
        measure = self._measures[i]
        past = i > 0 and bool(self._measures[i - 1].endings) and not measure.endings
        if (measure.opens or past) and self._begin != i:
            self.restart(i)
        return not measure.endings or self._passes in measure.endings

    def after(self, i: int, sounds: bool, *, jumped: bool) -> int:
        """Return the next measure."""
        closes = self._measures[i].closes if sounds else 0
        spent = 0 < self._highest[i] <= self._passes  # the last pass ends before the last of the endings
        if closes > 1 and not jumped and not spent and self._played[i] < closes - 1:
            self._played[i] += 1
            self._passes += 1
            return self._begin
        if closes:
            self.restart(i + 1)
        return i + 1


@dataclass(eq=False)
class _Repeat:
    """A repeat of a tablature: its first measure, its repeat signs, and the passes that each has had in this round."""

    opening: int
    closings: list[int] = field(default_factory=list)
    passes: list[int] = field(default_factory=list)
    at: int = 0


class _Tablature:
    """Repeats as Guitar Pro has them: one in another, each with several repeat signs."""

    def __init__(self, measures: Sequence[Measure]):
        self._measures = measures
        self._of: list[_Repeat] = []
        open_repeats: list[_Repeat] = []
        n_begun = 0
        for i, measure in enumerate(measures):
            if measure.opens or not open_repeats:
                if measure.opens and open_repeats and open_repeats[-1].closings:
                    open_repeats.pop()
                    n_begun -= 1
                open_repeats.append(_Repeat(i))
                n_begun += measure.opens
            self._of.append(open_repeats[-1])
            if measure.closes > 1:
                open_repeats[-1].closings.append(i)
                if n_begun > 1:
                    open_repeats.pop()
                    n_begun -= 1
        self.restart(0)

    def restart(self, i: int) -> None:
        """Forget all repeats that have begun."""
        self._stack: list[_Repeat] = []
        self._endings: frozenset[int] = frozenset()

    def plays(self, i: int, *, jumped: bool) -> bool:
        """Whether this pass plays a measure; an ending lasts until the next one, or the end of its repeat."""
        if jumped:
            return True
        repeat, endings = self._of[i], self._measures[i].endings
        if i == repeat.opening and repeat.closings and repeat not in self._stack:
            repeat.passes, repeat.at = [0] * len(repeat.closings), 0
            self._stack.append(repeat)
            self._endings = frozenset()
        endings = endings or self._endings
        if not self._stack or not endings:
            return True
        self._endings = endings
        return self._stack[-1].passes[self._stack[-1].at] + 1 in endings

    def after(self, i: int, sounds: bool, *, jumped: bool) -> int:
        """Return the next measure."""
        closes = self._measures[i].closes
        if jumped or closes < 2 or not self._stack:
            return i + 1
        top = self._stack[-1]
        if top.passes[top.at] < closes - 1:
            top.passes[top.at] += 1
            top.passes[: top.at] = [0] * top.at
            top.at = 0
            self._endings = frozenset()
            return top.opening
        if top.at < len(top.closings) - 1:
            top.at += 1
        else:
            self._stack.pop()
        return i + 1


def number_endings(measures: Sequence[Measure]) -> None:
    """Let a repeat over endings be played once for each pass that they name."""
    last = {ends: max(ends, default=0) for ends in {measure.endings for measure in measures}}
    passes = 0  # of the measures since the repeat began
    for i, measure in enumerate(measures):
        passes = max(0 if measure.opens else passes, last[measure.endings])
        if measure.closes and measure.endings:
            following = last[measures[i + 1].endings] if i + 1 < len(measures) else 0
            measure.closes = max(measure.closes, passes, following)
