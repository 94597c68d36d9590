"""Guitar Pro files to written music: 3 to 5 by pyguitarpro, and what all versions have in common.

String 1 is the highest; a bend or whammy of 1 is half a semitone. Which signs belong to the older formats alone: an
artificial harmonic of version 3 has no place, and is touched as many frets beyond its stop as that has.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from tonewood.errors import ScoreError
from tonewood.performance.score.bend_curves import Curve, bend_curve
from tonewood.performance.score.guitar_pro_file import NO_STRING, bounded_reader, unknown_counted
from tonewood.performance.score.harmonics import interval, partial_at, touched
from tonewood.performance.score.limits import whole
from tonewood.performance.score.unfolding import Measure
from tonewood.performance.score.written import WrittenMusic, WrittenNote, WrittenPart

_QUARTER = 960
#: frets near which a string has a node of a low partial
_NODES = frozenset({2, 3, 4, 5, 7, 8, 9, 10, 12, 14, 15, 16, 17, 19, 21, 22, 24})
FRETS = 99
GRADUAL = "gradual change of tempo, made at once"
#: what a table of the mix changes that nothing plays
_MIX = ("instrument", "volume", "balance", "chorus", "reverb", "phaser", "tremolo")
#: largest bend, quarter tones
_BENDS = 96.0
DYNAMICS = {"PPP": 15, "PP": 31, "P": 47, "MP": 63, "MF": 79, "F": 95, "FF": 111, "FFF": 127}
#: quarter notes of a grace note: one, one of two, one of more
GRACES = (Fraction(1, 8), Fraction(1, 16), Fraction(1, 32))
#: (note value in quarter notes, share of the first of two) by name of the feel
FEELS = {
    f"{feel}{value}": (unit, share)
    for value, unit in (("8th", Fraction(1, 2)), ("16th", Fraction(1, 4)))
    for feel, share in (("Triplet", Fraction(2, 3)), ("Dotted", Fraction(3, 4)), ("Scottish", Fraction(1, 4)))
}
#: fingers of a rasgueado -> their strokes, down from the lowest string and up
RASGUEADOS = {
    "ii": "du", "mi": "dd", "mii": "ddu", "pmp": "udd", "pei": "udd", "pai": "udd", "ami": "ddd", "ppp": "ddu",
    "amii": "dddu", "amip": "dddu", "eami": "dddd", "eamii": "ddddu", "peami": "ddddu",
}  # fmt: skip
#: duration of a brush, parts of a quarter note, by that of pyguitarpro, parts of a whole note
_BRUSHES = {128: 32, 64: 32, 32: 16, 16: 8, 8: 4, 4: 2}
_SLIDES = {
    "outDownwards": "out_down", "outUpwards": "out_up",
    "intoFromBelow": "into_from_below", "intoFromAbove": "into_from_above",
}  # fmt: skip
_MARKS = {
    "Segno": "segno", "SegnoSegno": "segno_segno", "Coda": "coda", "DoubleCoda": "double_coda", "Fine": "fine",
    "DaCoda": "to_coda", "DaDoubleCoda": "to_double_coda",
}  # fmt: skip
_JUMPS = {"DaCapo": "da_capo", "DaSegno": "dal_segno", "DaSegnoSegno": "dal_segno_segno"}
_GOALS = {"": "", "AlFine": "_al_fine", "AlCoda": "_al_coda", "AlDoubleCoda": "_al_double_coda"}
_DIRECTIONS = _MARKS | {f"{j}{g}": f"{jump}{goal}" for j, jump in _JUMPS.items() for g, goal in _GOALS.items()}


def jump(name: str, ignored: Counter[str]) -> set[str]:
    """Sign of a direction of Guitar Pro; one that is not known is counted."""
    ignored["direction that is not known"] += name not in _DIRECTIONS
    return {_DIRECTIONS[name]} if name in _DIRECTIONS else set()


def strummed(notes: Sequence[WrittenNote], up: bool, spread: Fraction) -> list[WrittenNote]:
    """Notes of a chord struck one string after the other in `spread` quarter notes, from the lowest one or up."""
    struck = sorted((n for n in notes if not n.tied), key=lambda n: n.string or 0, reverse=not up)
    step = spread / max(len(struck) - 1, 1)
    return [*(n for n in notes if n.tied), *(replace(n, delay=i * step) for i, n in enumerate(struck))]


def read_guitar_pro(data: bytes, path: Path) -> WrittenMusic:
    """Read a file of Guitar Pro 3, 4 or 5.

    Raises ScoreError : pyguitarpro is not installed, or cannot read the file; one line.
    """
    music = WrittenMusic(path, [], [], tablature=True)
    try:
        with unknown_counted(music.ignored):
            song = bounded_reader(data, path, music.ignored).readSong()
            _fill(music, song)
    except Exception as error:  # whatever a damaged file makes of a reader without checks, and of its objects
        limit = error if isinstance(error, ScoreError) else error.__cause__
        if isinstance(limit, ScoreError):
            raise limit from None
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ScoreError(f"damaged Guitar Pro file: {reason}", file=path) from None
    return music


def _fill(music: WrittenMusic, song: Any) -> None:
    texts = {"title": song.title, "composer": song.music or song.artist}
    music.metadata |= {name: text for name, text in texts.items() if text}
    for header in song.measureHeaders:
        over = whole(header.timeSignature.numerator, 1, 255)
        under = whole(header.timeSignature.denominator.value, 1, 255)
        music.ignored["time signature that cannot be read"] += over is None or under is None
        measure = Measure(Fraction(4 * (over or 4), under or 4), opens=header.isRepeatOpen)
        measure.closes = header.repeatClose + 1 if header.repeatClose > 0 else 0
        measure.endings = frozenset(i + 1 for i in range(8) if header.repeatAlternative >> i & 1)
        feel = {"eighth": "Triplet8th", "sixteenth": "Triplet16th"}.get(header.tripletFeel.name)
        measure.feel = FEELS.get(feel or "")
        for direction in (header.direction, header.fromDirection):
            if direction is not None:
                measure.signs |= jump(direction.name.title().replace(" ", ""), music.ignored)
        music.measures.append(measure)
    if music.measures:
        music.tempo(music.measures[0], Fraction(0), float(song.tempo))
    for track in song.tracks:
        music.parts.append(_Track(track, music, song.versionTuple).part())


@dataclass(eq=False)
class _Before:
    """The note before on a string: its fret, and how its finger leaves it."""

    fret: int
    hammer: bool = False
    slide: str = ""


class _Track:
    """A track of pyguitarpro, and what its notes need to know of those before."""

    def __init__(self, track: Any, music: WrittenMusic, version: tuple[int, ...] | None):
        self.track, self.music, self.ignored = track, music, music.ignored
        self.version = version or (5,)
        capo = whole(track.offset, 0, FRETS)
        self.ignored["capo that cannot be read"] += capo is None
        self.capo = capo or 0
        self.open = {s.number: s.value for s in track.strings}
        self.last: dict[int, _Before] = {}

    def part(self) -> WrittenPart:
        """Return its measures."""
        track, music = self.track, self.music
        self.ignored["mute of a track"] += bool(track.isMute)
        instrument = whole(track.channel.instrument, 0, 127)
        part = WrittenPart(track.name.strip(), capo=self.capo, program=None if instrument is None else instrument + 1)
        for i, measure in enumerate(track.measures):
            music.cells.take()
            notes: list[WrittenNote] = []
            for beat in (beat for voice in measure.voices for beat in voice.beats):
                at = Fraction((beat.start or measure.header.start) - measure.header.start, _QUARTER)
                if beat.effect.mixTableChange is not None and i < len(music.measures):
                    self._change(beat.effect.mixTableChange, music.measures[i], at)
                if track.isPercussionTrack:
                    self.ignored["note of a percussion track"] += len(beat.notes)
                    part.n_drums += len(beat.notes)
                    continue
                music.signs.take(len(beat.notes))
                notes += self._beat(beat, at)
            part.measures.append(notes)
        return part

    def _change(self, change: Any, measure: Measure, at: Fraction) -> None:
        """Enter a change of tempo; changes of the mix are counted."""
        if change.tempo is not None:
            self.music.tempo(measure, at, float(change.tempo.value))
            self.ignored[GRADUAL] += change.tempo.duration > 0
        for name in _MIX:
            self.ignored[f"change of {name}"] += getattr(change, name) is not None
        self.ignored["wah"] += change.wah is not None and change.wah.value >= 0

    def _beat(self, beat: Any, at: Fraction) -> list[WrittenNote]:
        effect, length = beat.effect, Fraction(beat.duration.time, _QUARTER)
        signs = {"vibrato"} if effect.vibrato else set()
        if effect.slapEffect.name != "none":
            signs.add({"slapping": "slap", "popping": "pop", "tapping": "tapping"}[effect.slapEffect.name])
        self.ignored["fade"] += bool(effect.fadeIn)
        on_beat = any(n.effect.grace is not None and n.effect.grace.isOnBeat for n in beat.notes)
        grace_length = min(GRACES[0], length / 2) if on_beat else Fraction(0)
        bar = effect.tremoloBar
        every = WrittenNote(
            at + grace_length, length - grace_length, 0.0, signs=tuple(signs),
            whammy=_points(bar, 50.0, self.ignored) if bar else (),
        )  # fmt: skip
        graces: list[WrittenNote] = []
        notes: list[WrittenNote] = []
        for note in beat.notes:
            if note.string not in self.open:
                self.ignored[NO_STRING] += 1
            elif note.type.name != "rest":
                graces += self._grace(note, at)
                notes.append(self._note(note, every))
        stroke = effect.stroke
        if effect.hasRasgueado:
            each = every.length / 2
            strokes = [(replace(n, length=each), replace(n, at=n.at + each, length=each)) for n in notes]
            self.music.signs.take(len(notes))
            down, up = ([pair[i] for pair in strokes] for i in range(2))
            notes = [*strummed(down, False, each / 4), *strummed(up, True, each / 4)]
        elif stroke.direction.name != "none":
            parts = _BRUSHES.get(stroke.value, 32)
            notes = strummed(notes, stroke.direction.name == "up", Fraction(1, parts))
        return [*graces, *notes]

    def _grace(self, note: Any, at: Fraction) -> list[WrittenNote]:
        """Grace note of a note: before its place, or on it."""
        grace, string = note.effect.grace, note.string
        if grace is None:
            return []
        begin, fret = at if grace.isOnBeat else at - GRACES[0], max(grace.fret, 0)  # a dead one may have none
        before = self.last.get(string)
        out = WrittenNote(
            begin, GRACES[0], float(self.open[string] + self.capo + fret), string, fret,
            velocity=grace.velocity, signs=("dead",) if grace.isDead else (), arrives=before.slide if before else "",
        )  # fmt: skip
        transition = grace.transition.name
        if self.version[0] < 5:  # pyguitarpro takes the byte of the duration for it, and the other way round
            byte = 7 - (int(grace.duration).bit_length() - 1)
            transition = {1: "slide", 2: "bend", 3: "hammer"}.get(byte, "none")
        self.last[string] = _Before(fret, transition == "hammer", "legato" if transition == "slide" else "")
        return [out]

    def _note(self, note: Any, every: WrittenNote) -> WrittenNote:
        effect, kind, string = note.effect, note.type.name, note.string
        before = self.last.get(string)
        tied = kind == "tie"
        fret = note.value
        pitch = float(self.open[string] + self.capo + fret)
        flags = {"palm_mute": effect.palmMute, "let_ring": effect.letRing, "vibrato": effect.vibrato}
        flags |= {"staccato": effect.staccato, "ghost": effect.ghostNote, "accent": effect.accentuatedNote}
        flags |= {"marcato": effect.heavyAccentuatedNote, "dead": kind == "dead"}
        signs = {*every.signs, *(name for name, on in flags.items() if on)}
        arrives = ""
        if before is not None and not tied:
            arrives = before.slide
            if before.hammer and before.fret != fret:
                signs.add("hammer_on" if fret > before.fret else "pull_off")
        if not tied or before is None:
            self.last[string] = before = _Before(fret)
        before.hammer, before.slide = effect.hammer, ""
        slides = {slide.name for slide in effect.slides}
        before.slide = "shift" if "shiftSlideTo" in slides else "legato" if "legatoSlideTo" in slides else ""
        partial = 0
        if effect.harmonic is not None:
            fret, pitch, partial = self._harmonic(effect.harmonic, fret, pitch)
        picking, trill = effect.tremoloPicking, effect.trill
        stroke = trill.duration if trill else picking.duration if picking else None
        return replace(
            every, pitch=pitch, string=string, fret=fret, velocity=note.velocity, signs=tuple(sorted(signs)), tied=tied,
            bend=_points(effect.bend, 50.0, self.ignored) if effect.bend else (), partial=partial, arrives=arrives,
            tremolo=Fraction(stroke.time, _QUARTER) if stroke else None,
            trill=float(self.open[string] + self.capo + trill.fret) if trill else None,
            slides=tuple(sorted(_SLIDES[name] for name in slides & set(_SLIDES))),
        )  # fmt: skip

    def _harmonic(self, harmonic: Any, fret: int, pitch: float) -> tuple[int, float, int]:
        """Stop, pitch and partial of a harmonic: where it is touched, or what it sounds."""
        name = type(harmonic).__name__
        node = 12.0
        if name == "NaturalHarmonic":
            return touched(fret, pitch, float(fret), True, self.ignored)
        if name == "TappedHarmonic" and harmonic.fret is not None:
            node = float(harmonic.fret - fret) if partial_at(harmonic.fret - fret) else node
        elif name == "ArtificialHarmonic" and self.version[0] == 4:  # touched 5, 7 or 12 frets beyond the stop
            fifth = harmonic.pitch is not None and harmonic.pitch.value != int(pitch) % 12
            node = 5.0 if fifth else 7.0 if getattr(harmonic.octave, "name", "") == "quindicesima" else 12.0
        elif name == "ArtificialHarmonic" and harmonic.pitch is not None:
            octaves = max(int(getattr(harmonic.octave, "value", harmonic.octave) or 0), 1)
            steps = (harmonic.pitch.value - int(pitch)) % 12 + 12 * octaves
            partial = round(2 ** (steps / 12))
            return fret, pitch + interval(partial), partial
        elif name == "ArtificialHarmonic" and self.version[0] == 3 and fret in _NODES:
            node = float(fret)
        return touched(fret, pitch, node, False, self.ignored)


def _points(effect: Any, unit: float, ignored: Counter[str]) -> Curve:
    points = [(p.position / effect.maxPosition, unit * p.value) for p in effect.points]
    within = [(share, cents) for share, cents in points if abs(cents) <= 50.0 * _BENDS]
    ignored[f"point of a bend beyond {_BENDS / 2:g} semitones"] += len(points) - len(within)
    return bend_curve(within)
