"""Written music, as MusicXML and tablatures have it, to a score: repeats, tempo, ties, ornaments, marks.

Readers fill `WrittenMusic`; times are quarter notes from the beginning of a measure. `performed` unfolds repeats, turns
quarter notes into seconds, and plays the signs as a player would:

=============  ========================================================================================================
tie            one note of both lengths
let ring       lasts until the next note on its string, without a string `RINGS` s
staccato       half of its length; a dead note `DEAD` s
grace note     takes `GRACE` of a quarter note, at most a quarter of it, from the note that follows it
tremolo        strokes of the written length; a trill alternates by hammer-ons and pull-offs
strum          one string after the other, `STRUM` s apart
bend, vibrato  controls ``bend`` on a channel of the string's own
accents        velocity +16 and +28, ghost notes -24
=============  ========================================================================================================

Other signs become `Note.marks`, for techniques that an instrument may have: `tonewood.performance.player.techniques`
looks them up, and counts those that it lacks. Signs that nothing can follow are counted by the reader in
`Score.ignored`.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from operator import itemgetter
from pathlib import Path

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import MAX_CONTROLS, MAX_NOTES, MAX_TIME, Allowance
from tonewood.performance.score.note import Control, Note, Score
from tonewood.support.garbage import without_collecting

RINGS, DEAD, STRUM = 8.0, 0.05, 0.012
GRACE = Fraction(1, 8)
#: Hz and cents of a vibrato, and s between two of its controls and of a bend's
_VIBRATO, _DEPTH, _TICK = 5.5, 35.0, 0.02
#: measures that are played, those looked at on the way, and measures of all parts
_MOST_MEASURES, _MOST_STEPS, _MOST_CELLS = 20_000, 200_000, 200_000
#: tempo changes that are played, and notes that a grace note may be compared with in all
_MOST_TEMPOS, _MOST_COMPARED = 100_000, 1_000_000
#: quarter notes per minute
_TEMPOS = (4.0, 2000.0)
#: pitches of notes
_PITCHES = (0.0, 140.0)
#: denominators of times are rounded to
_FINEST = 10**9
#: jump that leads nowhere -> name by which it is counted
_NOWHERE = {"dal_segno": "dal segno without a segno", "to_coda": "to coda without a coda"}
#: (share of the note, cents), in order of the share
Curve = tuple[tuple[float, float], ...]
_VELOCITIES = {"accent": 16, "marcato": 28, "ghost": -24}
#: signs that are played here; all others become marks
_PLAYED = {"let_ring", "staccato", "dead", "vibrato", *_VELOCITIES}


@dataclass(frozen=True)
class WrittenNote:
    """One sign for a note.

    Attributes
    ----------
    at, length : quarter notes from the beginning of its measure, and how long; 0 for a grace note.
    pitch : MIDI number that sounds.
    string : number of the string, 1 the highest; None where there is no tablature.
    fret : counted from the capo; None where there is no tablature.
    velocity : 1 to 127.
    signs : names of techniques and articulations, e.g. ``palm_mute``.
    tied : continues the note before it of this pitch (and string).
    bend : course of a bend.
    tremolo, trill : quarter notes of one stroke, and MIDI number of the other note.
    strum : place among the notes struck one after the other, 0 for the first.
    """

    at: Fraction
    length: Fraction
    pitch: float
    string: int | None = None
    fret: int | None = None
    velocity: int = 80
    signs: tuple[str, ...] = ()
    tied: bool = False
    bend: Curve = ()
    tremolo: Fraction | None = None
    trill: float | None = None
    strum: int = 0


@dataclass
class Measure:
    """A measure of all parts: its length in quarter notes, tempo changes (at, bpm), repeats and jumps.

    Attributes
    ----------
    opens : a repeat begins here.
    closes : how often it is played up to here, 0 for no repeat sign.
    endings : passes in which it is played; empty for all.
    signs : ``segno``, ``coda``, ``fine``, ``to_coda``, ``da_capo``, ``dal_segno``: marks and jumps.
    """

    length: Fraction = Fraction(4)
    tempos: list[tuple[Fraction, float]] = field(default_factory=list)
    opens: bool = False
    closes: int = 0
    endings: frozenset[int] = frozenset()
    signs: set[str] = field(default_factory=set)


@dataclass
class WrittenPart:
    """One part: its name, the notes of each measure, and the capo that its frets count from."""

    name: str
    measures: list[list[WrittenNote]] = field(default_factory=list)
    capo: int = 0


@dataclass
class WrittenMusic:
    """Content of a file of written music.

    Attributes
    ----------
    signs, cells, changes : notes, measures of parts and tempo changes that may be read yet.
    """

    file: Path
    measures: list[Measure]
    parts: list[WrittenPart]
    metadata: dict[str, str] = field(default_factory=dict)
    ignored: Counter[str] = field(default_factory=Counter)
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.signs = Allowance(MAX_NOTES, "notes", self.file)
        self.cells = Allowance(_MOST_CELLS, "measures of parts", self.file)
        self.changes = Allowance(_MOST_TEMPOS, "tempo changes", self.file)

    def tempo(self, measure: Measure, at: Fraction, bpm: float) -> None:
        """Enter a change of tempo, quarter notes per minute; one out of range is counted."""
        if not _TEMPOS[0] <= bpm <= _TEMPOS[1]:
            self.ignored["tempo outside 4 to 2000"] += 1
            return
        self.changes.take()
        measure.tempos.append((at, bpm))


def near(time: Fraction) -> Fraction:
    """Return a time, rounded where its denominator is beyond any that music has: sums of such would grow."""
    return time if time.denominator <= _FINEST else time.limit_denominator(_FINEST)


def order(measures: Sequence[Measure]) -> list[int]:
    """Measures in the order in which they are played, repeats, endings and jumps unfolded.

    Raises
    ------
    ScoreError : they would go on for more than 20000 measures, or ten times as many are passed over.
    """
    out: list[int] = []
    i = begin = 0
    passes, jumped = 1, False
    played: Counter[int] = Counter()
    targets = _targets(measures)
    steps = Allowance(_MOST_STEPS, "measures, repeats unfolded, with those that are left out")
    while i < len(measures):
        steps.take()
        measure = measures[i]
        past = i > 0 and bool(measures[i - 1].endings) and not measure.endings
        if (measure.opens or past) and begin != i:
            begin, passes = i, 1
        if not measure.endings or passes in measure.endings:
            out.append(i)
            if len(out) > _MOST_MEASURES:
                raise ScoreError(f"more than {_MOST_MEASURES} measures, repeats unfolded")
            if jumped and "fine" in measure.signs:
                break
            if jumped and "to_coda" in measure.signs:
                coda = targets[i]["to_coda"]
                if coda is not None:
                    i, jumped, begin, passes = coda, False, coda, 1
                    continue
            if measure.closes > 1 and not jumped and played[i] < measure.closes - 1:
                played[i] += 1
                passes += 1
                i = begin
                continue
            back = [j for jump, j in targets[i].items() if jump != "to_coda" and j is not None]
            if not jumped and back:
                i = back[0]
                jumped, begin, passes = True, i, 1
                continue
            if measure.closes:
                begin, passes = i + 1, 1
        i += 1
    return out


def _targets(measures: Sequence[Measure]) -> list[dict[str, int | None]]:
    """Jumps in each measure -> the measure each leads to: the first segno so far, the next coda; None without one."""
    out: list[dict[str, int | None]] = [{} for _ in measures]
    segno = coda = None
    for i, measure in enumerate(measures):
        segno = i if segno is None and "segno" in measure.signs else segno
        out[i] = {jump: at for jump, at in (("dal_segno", segno), ("da_capo", 0)) if jump in measure.signs}
    for i, measure in reversed(list(enumerate(measures))):
        if "to_coda" in measure.signs:
            out[i]["to_coda"] = coda
        coda = i if "coda" in measure.signs else coda
    return out


class _Clock:
    """Seconds of a time in quarter notes, with repeats unfolded."""

    def __init__(self, measures: Sequence[Measure], played: Sequence[int], file: Path):
        self.starts: list[Fraction] = []
        now, bpm = Fraction(0), 120.0
        self._at, self._time, self._bpm = [Fraction(0)], [0.0], [bpm]
        # of two tempos at one time the faster one
        tempos = [list(dict(sorted(m.tempos)).items()) for m in measures]
        changes = Allowance(_MOST_TEMPOS, "tempo changes, repeats unfolded", file)
        for i in played:
            self.starts.append(now)
            changes.take(len(tempos[i]))
            for at, tempo in tempos[i]:
                self._enter(now + at, tempo)
            now = near(now + measures[i].length)
        if not 0.0 <= (end := self.seconds(now)) <= MAX_TIME:
            raise ScoreError(f"{end:.6g} s of music, repeats unfolded: {MAX_TIME:.0f} s are allowed", file=file)

    def _enter(self, at: Fraction, bpm: float) -> None:
        self._time.append(self.seconds(at))
        self._at.append(at)
        self._bpm.append(bpm)

    def seconds(self, at: Fraction) -> float:
        """Time of a quarter note, s."""
        i = bisect_right(self._at, at) - 1
        return self._time[i] + float(at - self._at[i]) * 60.0 / self._bpm[i]


@dataclass
class _Sounding:
    """A note with its time in quarter notes from the beginning."""

    at: Fraction
    end: Fraction
    sign: WrittenNote


@without_collecting
def performed(music: WrittenMusic, parts: Sequence[int] | None = None) -> Score:
    """Play written music.

    Parameters
    ----------
    parts : numbers from 1 of those that are played; all where left out.

    Raises
    ------
    ScoreError : there are no such parts, or too many notes.
    """
    chosen = range(1, len(music.parts) + 1) if parts is None else parts
    for number in chosen:
        if not 1 <= number <= len(music.parts):
            names = ", ".join(f"{i} {p.name}".strip() for i, p in enumerate(music.parts, 1))
            raise ScoreError(f"there is no part {number}; there are {names}", file=music.file)
    try:
        played = order(music.measures)
    except ScoreError as error:
        raise ScoreError(error.reason, file=music.file) from None
    Allowance(_MOST_CELLS, "measures of parts, repeats unfolded", music.file).take(len(played) * len(chosen))
    clock = _Clock(music.measures, played, music.file)
    notes: list[Note] = []
    controls: list[Control] = []
    ignored = Counter(music.ignored)
    channels: dict[tuple[int, int], int] = {}
    signs, strokes = (Allowance(MAX_NOTES, "notes, repeats unfolded", music.file) for _ in range(2))
    bends = Allowance(MAX_CONTROLS, "controls of bends and vibrato", music.file)
    compared = Allowance(_MOST_COMPARED, "notes that begin together with grace notes", music.file)
    for number in chosen:
        part = music.parts[number - 1]
        sounding = _tied(part, played, clock.starts, signs, compared)
        following = _following(sounding)
        for i, one in enumerate(sounding):
            if not all(_PITCHES[0] <= p <= _PITCHES[1] for p in (one.sign.pitch, one.sign.trill or 0.0)):
                ignored["note whose pitch is out of range"] += 1
                continue
            if not 0.0 <= clock.seconds(one.at) <= clock.seconds(one.end) <= MAX_TIME:
                ignored["note that begins or ends beyond 6 hours"] += 1
                continue
            channel = channels.setdefault((number, one.sign.string or 0), len(channels) % 16)
            for note in _strokes(one, following.get(i), clock, part.capo, channel):
                strokes.take()
                notes.append(note)
            controls += _bends(one, channel, clock, bends)
    for jumps in _targets(music.measures):
        ignored.update(_NOWHERE[jump] for jump, at in jumps.items() if at is None)
    warnings = list(music.warnings)
    if len(channels) > 16 and controls:
        warnings.append("more than 16 strings: bends of some are those of others, too; choose fewer --tracks")
    notes.sort(key=lambda n: n.time)
    controls.sort(key=lambda c: c.time)
    return Score(notes, controls, (), warnings, music.file.stem, music.metadata, dict(+ignored), str(music.file))


def _tied(
    part: WrittenPart, played: Sequence[int], starts: Sequence[Fraction], most: Allowance, compared: Allowance
) -> list[_Sounding]:
    """Notes in order of time, ties joined and grace notes given their time."""
    out: list[_Sounding] = []
    latest: dict[tuple[int | None, float], _Sounding] = {}
    for i, start in zip(played, starts, strict=True):
        signs = part.measures[i] if i < len(part.measures) else []
        most.take(len(signs))
        for sign in sorted(signs, key=lambda s: s.at):
            key = sign.string, sign.pitch
            before = latest.get(key)
            at = start + sign.at
            if sign.tied and before is not None and before.end >= at - Fraction(1, 64):
                before.end = at + sign.length
                if sign.bend:
                    before.sign = replace(before.sign, bend=before.sign.bend or sign.bend)
                continue
            latest[key] = _Sounding(at, at + sign.length, sign)
            out.append(latest[key])
    out.sort(key=lambda s: s.at)
    grace = [s for s in out if s.end == s.at]
    together: dict[Fraction, list[_Sounding]] = defaultdict(list)
    for s in out if grace else ():
        if s.end > s.at:
            together[s.at].append(s)
    for note in grace:
        there = together[note.at]
        compared.take(len(there))
        main = [s for s in there if s.sign.string in (note.sign.string, None)] or there
        room = min([(s.end - s.at) / 4 for s in main], default=GRACE)
        note.end = near(note.at + min(GRACE, room))
        moved = {id(s) for s in main}
        together[note.at] = [note, *(s for s in there if id(s) not in moved)]
        for s in main:
            s.at = note.end
            together[s.at].append(s)
    return sorted(out, key=lambda s: s.at)


def _following(sounding: Sequence[_Sounding]) -> dict[int, Fraction]:
    """Index of a note -> when the next one on its string begins."""
    out: dict[int, Fraction] = {}
    latest: dict[int, int] = {}
    for i, one in enumerate(sounding):
        if one.sign.string is not None:
            if one.sign.string in latest:
                out[latest[one.sign.string]] = one.at
            latest[one.sign.string] = i
    return out


def _strokes(one: _Sounding, following: Fraction | None, clock: _Clock, capo: int, channel: int) -> Iterator[Note]:
    """Play one sign: a note, or the strokes of a tremolo or trill."""
    sign, signs = one.sign, set(one.sign.signs)
    marks = tuple(sorted(signs - _PLAYED)) + (("tablature",) if sign.fret is not None else ())
    velocity = min(max(sign.velocity + sum(_VELOCITIES.get(s, 0) for s in signs), 1), 127)
    begin, end = clock.seconds(one.at) + STRUM * sign.strum, clock.seconds(one.end)
    if "dead" in signs:
        marks, end = (*marks, "dead_note"), begin + DEAD
    elif "staccato" in signs:
        end = begin + (end - begin) / 2
    elif "let_ring" in signs:
        end = begin + RINGS if following is None and sign.string is None else end
        if sign.string is not None:
            end = clock.seconds(following) if following is not None else end + RINGS
    stop = None if sign.fret is None else float(sign.fret + capo)
    duration = max(end - begin, 0.02)
    note = Note(begin, duration, note=sign.pitch, stop=stop, velocity_midi=velocity, marks=marks, channel=channel)
    stroke = sign.tremolo if sign.tremolo else Fraction(1, 8) if sign.trill is not None else None
    if stroke is None or one.at + stroke >= one.end:
        yield note
        return
    n = math.ceil((one.end - one.at) / stroke)
    for i in range(n):
        start, stop_at = one.at + i * stroke, min(one.at + (i + 1) * stroke, one.end)
        time = clock.seconds(start)
        other = sign.trill is not None and i % 2 == 1
        pitch = sign.trill if other and sign.trill is not None else sign.pitch
        extra: tuple[str, ...] = ()
        if sign.trill is not None and i:
            extra = ("hammer_on",) if other == (sign.trill > sign.pitch) else ("pull_off",)
        fret = None if stop is None or stop + (pitch - sign.pitch) < 0 else stop + (pitch - sign.pitch)
        own = tuple(m for m in marks if i == 0 or m not in ("hammer_on", "pull_off", "slide"))
        yield replace(
            note, time=time, duration=max(clock.seconds(stop_at) - time, 0.02), note=pitch, stop=fret, marks=own + extra
        )


def _bends(one: _Sounding, channel: int, clock: _Clock, most: Allowance) -> list[Control]:
    """Controls of a note's bend and vibrato, back to 0 at its end."""
    sign = one.sign
    if not sign.bend and "vibrato" not in sign.signs:
        return []
    begin, end = clock.seconds(one.at), clock.seconds(one.end)
    n = max(math.ceil((end - begin) / _TICK), 1)
    most.take(n)
    out: list[Control] = []
    for i in range(n):
        share = i / n
        cents = _at(sign.bend, share)
        if "vibrato" in sign.signs:
            cents += _DEPTH * math.sin(math.pi * _VIBRATO * (end - begin) * share) ** 2
        value = float(round(cents))
        if not out or value != out[-1].value:
            out.append(Control(begin + (end - begin) * share, "bend", value, channel))
    return [*out, Control(end, "bend", 0.0, channel)]


def _at(curve: Curve, share: float) -> float:
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
