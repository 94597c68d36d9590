"""Written music, as MusicXML and tablatures have it, to a score: repeats, tempo, ties, ornaments, marks.

Readers fill `WrittenMusic`; times are quarter notes from the beginning of a measure. `performed` unfolds repeats, turns
quarter notes into seconds, and plays the signs as a player would:

=============  ========================================================================================================
tie            one note of both lengths
let ring       lasts until the next note on its string, without a string `RINGS` s
staccato       half of its length; a dead note `DEAD` s
grace note     takes `GRACE` of a quarter note, at most a quarter of it, from the note that follows it
tremolo        strokes of the written length; a trill alternates by hammer-ons and pull-offs
ornaments      turns and mordents in the first sixteenth of a note, shorter in notes below a quarter
strum          one string after the other, `STRUM` s apart, or as late as the file says
slides         one note whose stop moves: `Note.glides`; after a shift slide the string is struck again
bend, vibrato  controls ``bend`` on a channel of the string's own, with the whammy bar's; the last one
               holds on tied notes, and on a string that rings
fermata        `HOLD` times as long, for all parts
pedal          controllers of the part's channels; notes last until it comes up
swing          the first of two notes of a value is longer than the second, as `Measure.feel` says
accents        velocity +16 and +28, ghost notes -24
=============  ========================================================================================================

Other signs become `Note.marks`, for techniques that an instrument may have: `tonewood.performance.player.techniques`
looks them up, and counts those that it lacks. Signs that nothing can follow are counted by the reader in
`Score.ignored`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from operator import itemgetter
from pathlib import Path

from tonewood.errors import ScoreError
from tonewood.performance.score.bend_controls import VIBRATO_DEPTHS, bend_controls
from tonewood.performance.score.bend_curves import Curve
from tonewood.performance.score.limits import MAX_CONTROLS, MAX_NOTES, MAX_TIME, Allowance
from tonewood.performance.score.note import Control, Note, Score, ScorePart
from tonewood.performance.score.score_clock import MOST_TEMPOS, TEMPOS, ScoreClock, near
from tonewood.performance.score.unfolding import Measure, lost_jumps, order
from tonewood.support.garbage import without_collecting
from tonewood.support.text_files import one_line

RINGS, DEAD, STRUM = 8.0, 0.05, 0.012
GRACE = Fraction(1, 8)
#: notes that a grace note may be compared with in all
_MOST_COMPARED = 1_000_000
#: measures of all parts
_MOST_CELLS = 200_000
#: measures over which a tie or a slide of a tablature reaches back
TIE_REACHES = 3
#: pitches of notes
_PITCHES = (0.0, 140.0)
#: quarter notes: strokes shorter than this at the end of a tremolo belong to the one before
_REST = Fraction(1, 96)
#: ornament -> steps up and down of its notes, and their lengths as shares of a quarter note
_ORNAMENTS = {
    "turn": ((1, 0, -1), Fraction(1, 12)),
    "inverted_turn": ((-1, 0, 1), Fraction(1, 12)),
    "mordent": ((0, -1), Fraction(1, 8)),
    "inverted_mordent": ((0, 1), Fraction(1, 8)),
}
#: semitones to the next step of C major, or its neighbour on a black key, up and down from each pitch class
_STEP_UP, _STEP_DOWN = (2, 2, 2, 1, 1, 2, 2, 2, 2, 2, 1, 1), (1,) * 12
#: in the place of a string: that of notes without one that are bent beside others
_BENT = -1
#: semitones of a slide into or out of a note, and the most s and the share of the note that it takes
_SLIDE, _SLIDE_TIME, _SLIDE_SHARE = 2.0, 0.15, 0.4
_VELOCITIES = {"accent": 16, "marcato": 28, "ghost": -24}
#: signs that are played here; all others become marks
_PLAYED = {"let_ring", "staccato", "dead", *VIBRATO_DEPTHS, *_VELOCITIES, *_ORNAMENTS}


@dataclass(frozen=True, slots=True)
class WrittenNote:
    """One sign for a note.

    at, length : quarter notes from the beginning of its measure, and how long; 0 for a grace note.
    pitch : MIDI number that sounds.
    string : number of the string, 1 the highest; None where there is no tablature.
    fret : counted from the capo; None where there is no tablature.
    velocity : 1 to 127.
    signs : names of techniques and articulations, e.g. ``palm_mute``.
    tied : continues the note before it of this pitch (and string).
    bend, whammy : course of a bend, and of the bar that bends all strings.
    tremolo, trill : quarter notes of one stroke, and MIDI number of the other note.
    strum : place among the notes struck one after the other, 0 for the first.
    delay : quarter notes by which it is struck later, and is shorter, than written.
    partial : see `Note.partial`; 0 of a note that is no harmonic.
    arrives : how the finger comes from the note before on its string: ``legato`` slides without a new stroke, ``shift``
        slides and strikes again; empty if it does not.
    slides : ``into_from_below``, ``into_from_above``, ``out_down``, ``out_up``.
    steps : semitones down and up to the notes of an ornament; None for those of C major.
    in_chord : a grace note that begins with the one before it.
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
    whammy: Curve = ()
    delay: Fraction = Fraction(0)
    partial: int = 0
    arrives: str = ""
    slides: tuple[str, ...] = ()
    steps: tuple[int, int] | None = None
    in_chord: bool = False


@dataclass
class WrittenPart:
    """One part: its name, the notes of each measure, and the capo that its frets count from.

    program, n_drums : see `ScorePart`.
    pedals : (measure, quarter notes in it, s later, controller, its value) of moves of pedals.
    """

    name: str
    measures: list[list[WrittenNote]] = field(default_factory=list)
    capo: int = 0
    program: int | None = None
    n_drums: int = 0
    pedals: list[tuple[int, Fraction, float, str, float]] = field(default_factory=list)


@dataclass
class WrittenMusic:
    """Content of a file of written music.

    tablature : repeats are by the custom of Guitar Pro, see `tonewood.performance.score.unfolding`.
    signs, cells, changes : notes, measures of parts and tempo changes that may be read yet.
    """

    file: Path
    measures: list[Measure]
    parts: list[WrittenPart]
    metadata: dict[str, str] = field(default_factory=dict)
    ignored: Counter[str] = field(default_factory=Counter)
    warnings: list[str] = field(default_factory=list)
    tablature: bool = False

    def __post_init__(self) -> None:
        self.signs = Allowance(MAX_NOTES, "notes", self.file)
        self.cells = Allowance(_MOST_CELLS, "measures of parts", self.file)
        self.changes = Allowance(MOST_TEMPOS, "tempo changes", self.file)

    def tempo(self, measure: Measure, at: Fraction, bpm: float) -> None:
        """Enter a change of tempo, quarter notes per minute; one out of range is counted."""
        if not TEMPOS[0] <= bpm <= TEMPOS[1]:
            self.ignored["tempo outside 4 to 2000"] += 1
            return
        self.changes.take()
        measure.tempos.append((at, bpm))


@dataclass(slots=True)
class _Sounding:
    """A note with its time in quarter notes from the beginning, notes that are tied to it, and where its stop goes."""

    at: Fraction
    end: Fraction
    sign: WrittenNote
    #: (quarter note, written note that is bent from there on)
    bent: list[tuple[Fraction, WrittenNote]] = field(default_factory=list)
    #: measure in which it ends
    measure: int = 0
    #: (quarter note, MIDI number) of the stop's arrivals
    glides: list[tuple[Fraction, float]] = field(default_factory=list)


@without_collecting
def performed(music: WrittenMusic, parts: Sequence[int] | None = None) -> Score:
    """Play written music.

    parts : numbers from 1 of those that are played; all where left out.
    Raises ScoreError : there are no such parts, or too many notes.
    """
    chosen = range(1, len(music.parts) + 1) if parts is None else parts
    for number in chosen:
        if not 1 <= number <= len(music.parts):
            names = ", ".join(f"{i} {one_line(p.name)[:40]}".strip() for i, p in enumerate(music.parts[:20], 1))
            names += f" and {len(music.parts) - 20} more" if len(music.parts) > 20 else ""
            raise ScoreError(f"there is no part {number}; there are {names}", file=music.file)
    try:
        played = order(music.measures, tablature=music.tablature)
    except ScoreError as error:
        raise ScoreError(error.reason, file=music.file) from None
    Allowance(_MOST_CELLS, "measures of parts, repeats unfolded", music.file).take(len(played) * len(chosen))
    clock = ScoreClock(music.measures, played, music.file)
    notes: list[Note] = []
    controls: list[Control] = []
    ignored = Counter(music.ignored)
    channels: dict[tuple[int, int], int] = {}
    its_channels: dict[int, list[int]] = defaultdict(list)
    signs, strokes = (Allowance(MAX_NOTES, "notes, repeats unfolded", music.file) for _ in range(2))
    bends = Allowance(MAX_CONTROLS, "controls of bends and vibrato", music.file)
    compared = Allowance(_MOST_COMPARED, "notes that begin together with grace notes", music.file)
    about: list[ScorePart] = []
    parts_played = [
        (number, _graced(_sounding(music, music.parts[number - 1], played, clock.starts, signs), compared))
        for number in chosen
    ]
    clock.begin_before(one.at for _, sounding in parts_played for one in sounding if one.at < 0)
    for number, sounding in parts_played:
        following, apart, own_notes = _following(sounding), _bent_beside_others(sounding), list[Note]()
        struck: list[tuple[_Sounding, int, float, int, int]] = []  # channel, begin of the next, range of its notes
        for i, one in enumerate(sounding):
            if not all(_PITCHES[0] <= p <= _PITCHES[1] for p in (one.sign.pitch, one.sign.trill or 0.0)):
                ignored["note whose pitch is out of range"] += 1
                continue
            if not 0.0 <= clock.seconds(one.at) <= clock.seconds(one.end) <= MAX_TIME:
                ignored["note that begins or ends beyond 6 hours"] += 1
                continue
            if (key := (number, one.sign.string or (_BENT if i in apart else 0))) not in channels:
                channels[key] = len(channels) % 16
                its_channels[number].append(channels[key])
            channel = channels[key]
            first, then = len(own_notes), following.get(i)
            own_notes += _strokes(one, then, clock, music.parts[number - 1], channel, strokes)
            next_begins = math.inf if then is None else clock.seconds(then)
            struck.append((one, channel, next_begins, first, len(own_notes)))
        pedals = _pedalled(music.parts[number - 1], played, clock, its_channels[number], own_notes, bends)
        for one, channel, next_begins, first, last in struck:
            end = clock.seconds(one.end)
            if one.sign.string is not None:  # its channel bends no other string
                end = min(max(end, *(n.time + n.duration for n in own_notes[first:last])), next_begins)
            controls += bend_controls(one.bent, one.at, one.end, end, channel, clock, bends)
        controls += pedals
        notes += own_notes
        part = music.parts[number - 1]
        programs = {part.program: len(own_notes)} if own_notes else {}
        about.append(ScorePart(number, one_line(part.name), (), programs, part.n_drums))
    ignored.update(lost_jumps(music.measures, tablature=music.tablature))
    reached = set(played)
    for number in chosen:
        left = (len(signs) for i, signs in enumerate(music.parts[number - 1].measures) if i not in reached)
        ignored["note in a measure that no pass reaches"] += sum(left)
    warnings = list(music.warnings)
    if len(channels) > 16 and controls:
        warnings.append("more than 16 strings: bends of some are those of others, too; choose fewer --tracks")
    notes.sort(key=lambda n: n.time)
    controls.sort(key=lambda c: c.time)
    beats = clock.beats(music.measures, played)
    metadata = {name: one_line(text) for name, text in music.metadata.items()}
    return Score(
        notes, controls, (), warnings, music.file.stem, metadata, dict(+ignored), str(music.file), about, beats
    )


def _sounding(
    music: WrittenMusic, part: WrittenPart, played: Sequence[int], starts: Sequence[Fraction], most: Allowance
) -> list[_Sounding]:
    """Notes with their times, ties and slides joined."""
    out: list[_Sounding] = []
    latest: dict[tuple[int | None, float], _Sounding] = {}
    #: the same by their end, too: two voices may hold one pitch, and a tie goes on where its own note ends
    ending: dict[tuple[int | None, float, Fraction], _Sounding] = {}
    on_string: dict[int, _Sounding] = {}
    for i, start in zip(played, starts, strict=True):
        signs = part.measures[i] if i < len(part.measures) else []
        most.take(len(signs))
        feel = music.measures[i].feel
        for sign in sorted(signs, key=lambda s: float(s.at)):
            at, end = _swung(sign, feel)
            at, end = start + at, start + end
            key = sign.string, sign.pitch
            before = ending.get((*key, at)) or latest.get(key)
            if music.tablature and sign.string is not None:
                before = on_string.get(sign.string)  # a harmonic's sound goes on where the tied note is none
            if sign.tied and before is not None and _reaches(before, at, i, music.tablature):
                before.end, before.measure = max(before.end, end), i
                ending[*key, before.end] = before
                before.bent.append((at, sign))
                continue
            last = on_string.get(sign.string) if sign.string is not None else None
            if sign.arrives and last is not None and _reaches(last, at, i, music.tablature) and last.at < at:
                last.glides.append((at, sign.pitch))
                if sign.arrives == "legato" and _is_plain(sign):
                    last.end, last.measure = end, i
                    last.bent.append((at, sign))
                    latest[key] = last
                    continue
            one = latest[key] = ending[*key, end] = _Sounding(at, end, sign, [(at, sign)], i)
            if sign.string is not None:
                on_string[sign.string] = one
            out.append(one)
    return out


def _reaches(before: _Sounding, at: Fraction, measure: int, tablature: bool) -> bool:
    """Whether a tie or slide begins at a note before: where they touch, in a tablature also over rests."""
    return before.end >= at - Fraction(1, 64) or (tablature and abs(measure - before.measure) <= TIE_REACHES)


def _swung(sign: WrittenNote, feel: tuple[Fraction, Fraction] | None) -> tuple[Fraction, Fraction]:
    """Beginning and end of a note in its measure; one of the value that swings moves by its place in the pair."""
    begin, end = sign.at, sign.at + sign.length
    if feel is None or sign.length != feel[0] or sign.at % feel[0]:
        return begin, end
    later = 2 * feel[0] * feel[1] - feel[0]
    return (begin + later, end) if sign.at % (2 * feel[0]) else (begin, end + later)


def _is_plain(sign: WrittenNote) -> bool:
    """Whether a note that a slide reaches is not struck for another reason."""
    struck = sign.tremolo is not None or sign.trill is not None or sign.partial
    return not struck and not {"dead", *_ORNAMENTS} & set(sign.signs)


def _graced(out: list[_Sounding], compared: Allowance) -> list[_Sounding]:
    """Notes in order of time, grace notes without a length given theirs."""
    out.sort(key=lambda s: float(s.at))
    grace = [s for s in out if s.end == s.at]
    together: dict[Fraction, list[_Sounding]] = defaultdict(list)
    for s in out if grace else ():
        if s.end > s.at:
            together[s.at].append(s)
    chords: list[list[_Sounding]] = []
    for note in grace:
        if note.sign.in_chord and chords and chords[-1][0].at == note.at:
            chords[-1].append(note)
        else:
            chords.append([note])
    for chord in reversed(chords):  # each takes its time from the one after it
        at, there = chord[0].at, together[chord[0].at]
        compared.take(len(there) * len(chord))
        later: dict[int, tuple[_Sounding, Fraction]] = {}
        for note in chord:
            main = [s for s in there if s.sign.string in (note.sign.string, None)] or there
            room = min([(s.end - s.at) / 4 for s in main], default=GRACE)
            note.end = near(at + min(GRACE, room))
            later |= {id(s): (s, note.end) for s in main}
        together[at] = [*chord, *(s for s in there if id(s) not in later)]
        for s, begin in later.values():
            s.at = begin
            together[begin].append(s)
    return sorted(out, key=lambda s: float(s.at))


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


def _bent_beside_others(sounding: Sequence[_Sounding]) -> set[int]:
    """Indices of notes without a string that are bent while others sound: their channel bends none of those."""
    out: set[int] = set()
    until = Fraction(0)  # of the notes before
    for i, one in enumerate(sounding):
        beside = until > one.at or (i + 1 < len(sounding) and sounding[i + 1].at < one.end)
        bent = any(s.bend or s.whammy or not VIBRATO_DEPTHS.keys().isdisjoint(s.signs) for _, s in one.bent)
        if one.sign.string is None and beside and bent:
            out.add(i)
        until = max(until, one.end)
    return out


def _strokes(
    one: _Sounding, following: Fraction | None, clock: ScoreClock, part: WrittenPart, channel: int, most: Allowance
) -> Iterator[Note]:
    """Play one sign: a note, or the notes of an ornament, a tremolo or a trill."""
    sign, signs = one.sign, set(one.sign.signs)
    marks = tuple(sorted(signs - _PLAYED)) + (("tablature",) if sign.fret is not None else ())
    velocity = min(max(sign.velocity + sum(_VELOCITIES.get(s, 0) for s in signs), 1), 127)
    late = min(sign.delay, (one.end - one.at) / 2)
    begin, end = clock.seconds(one.at + late) + STRUM * sign.strum, clock.seconds(one.end)
    if "dead" in signs:
        marks, end = (*marks, "dead_note"), begin + DEAD
    elif "staccato" in signs:
        end = begin + (end - begin) / 2
    elif "let_ring" in signs:
        end = begin + RINGS if following is None and sign.string is None else end
        if sign.string is not None:
            end = clock.seconds(following) if following is not None else end + RINGS
    stop = None if sign.fret is None else float(sign.fret + part.capo)
    duration = max(end - begin, 0.02)
    note = Note(
        begin, duration, note=sign.pitch, stop=stop, velocity_midi=velocity, marks=marks, channel=channel,
        partial=sign.partial or None, glides=_glides(one, begin, duration, clock), program=part.program,
    )  # fmt: skip
    notes = _split(one, most)
    if len(notes) < 2:
        yield note
        return
    for i, (at, until, pitch, extra) in enumerate(notes):
        time = begin if i == 0 else clock.seconds(at)
        fret = None if stop is None or stop + (pitch - sign.pitch) < 0 else stop + (pitch - sign.pitch)
        own_marks = tuple(m for m in marks if i == 0 or m not in ("hammer_on", "pull_off", "slide"))
        yield replace(
            note, time=time, duration=max(clock.seconds(until) - time, 0.02), note=pitch, stop=fret,
            marks=own_marks + extra, glides=(),
        )  # fmt: skip


def _split(one: _Sounding, most: Allowance) -> list[tuple[Fraction, Fraction, float, tuple[str, ...]]]:
    """(beginning, end, pitch, marks) of each note that a sign is played as, in quarter notes."""
    sign = one.sign
    ornament = next((_ORNAMENTS[s] for s in sign.signs if s in _ORNAMENTS), None)
    out: list[tuple[Fraction, Fraction, float, tuple[str, ...]]] = []
    if ornament is not None:
        most.take(len(ornament[0]) + 1)
        at, shorter = one.at, min(one.end - one.at, Fraction(1))
        tone = int(sign.pitch) % 12
        for step in ornament[0]:
            down, up = sign.steps or (_STEP_DOWN[tone], _STEP_UP[tone])
            pitch = sign.pitch + (up if step > 0 else -down if step < 0 else 0)
            out.append((at, at + ornament[1] * shorter, pitch, ()))
            at += ornament[1] * shorter
        return [*out, (at, one.end, sign.pitch, ())]
    stroke = sign.tremolo if sign.tremolo else Fraction(1, 8) if sign.trill is not None else None
    n = 1 if stroke is None else math.ceil((one.end - one.at - _REST) / stroke)
    most.take(max(n, 1))
    if stroke is None:
        return []
    pitches = sign.pitch, sign.pitch if sign.trill is None else sign.trill
    for i in range(n):
        pitch, before = pitches[i % 2], pitches[1 - i % 2]
        extra: tuple[str, ...] = ()
        if sign.trill is not None and i:
            extra = ("hammer_on",) if pitch > before else ("pull_off",)
        out.append((one.at + i * stroke, min(one.at + (i + 1) * stroke, one.end), pitch, extra))
    return out


def _glides(one: _Sounding, begin: float, duration: float, clock: ScoreClock) -> tuple[tuple[float, float], ...]:
    """Where the stop of a note goes, see `Note.glides`."""
    sign, slides = one.sign, set(one.sign.slides)
    take = min(_SLIDE_TIME, _SLIDE_SHARE * duration)
    frets = _SLIDE if sign.fret is None else min(_SLIDE, float(sign.fret))
    out: list[tuple[float, float]] = []
    if slides & {"into_from_below", "into_from_above"}:
        out += [(0.0, -frets if "into_from_below" in slides else _SLIDE), (take, 0.0)]
    out += [(clock.seconds(at) - begin, pitch - sign.pitch) for at, pitch in one.glides]
    for _, last in one.bent[1:]:
        slides |= {s for s in last.slides if s.startswith("out")}
    reached = out[-1][1] if out else 0.0
    if "out_down" in slides or "out_up" in slides:
        down = -min(_SLIDE, sign.fret + reached) if sign.fret is not None else -_SLIDE
        out.append((duration, reached + (_SLIDE if "out_up" in slides else down)))
    return tuple((min(time, duration), steps) for time, steps in out if time >= 0.0)


def _pedalled(
    part: WrittenPart,
    played: Sequence[int],
    clock: ScoreClock,
    channels: Sequence[int],
    notes: list[Note],
    most: Allowance,
) -> list[Control]:
    """Controls of a part's pedals; its notes that end under the sustain pedal last until that comes up."""
    if not part.pedals:
        return []
    by_measure: dict[int, list[tuple[Fraction, float, str, float]]] = defaultdict(list)
    for i, at, late, kind, value in part.pedals:
        by_measure[i].append((at, late, kind, value))
    moves: list[tuple[float, str, float]] = []
    for i, start in zip(played, clock.starts, strict=True):
        most.take(len(by_measure.get(i, ())) * max(len(channels), 1))
        moves += [(clock.seconds(start + at) + late, kind, value) for at, late, kind, value in by_measure.get(i, ())]
    moves.sort(key=itemgetter(0))
    sustain = [(time, value >= 0.5) for time, kind, value in moves if kind == "cc64"]
    times = [time for time, _ in sustain]
    ups: list[float] = [math.inf] * (len(sustain) + 1)  # next time at which it is up, from each move on
    for i in reversed(range(len(sustain))):
        ups[i] = ups[i + 1] if sustain[i][1] else sustain[i][0]
    last = max((n.time + n.duration for n in notes), default=0.0)
    for i, note in enumerate(notes):
        end = note.time + note.duration
        k = bisect_right(times, end) - 1
        if k >= 0 and sustain[k][1]:
            until = max(min(ups[k], last), end)
            notes[i] = replace(note, duration=until - note.time, held=note.duration)
    return [Control(time, kind, value, channel) for time, kind, value in moves for channel in channels]
