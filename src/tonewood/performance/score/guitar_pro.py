"""Guitar Pro files to written music: 3 to 5 by pyguitarpro, 7 and 8 from the XML in their archive.

Source of the XML's meaning: files themselves; it is not documented. String 0 is the lowest; a bend of 100 is a whole
tone; the bits of a slide are 1 shift, 2 legato, 4 and 8 out of the note, 16 and 32 into it.
"""

from __future__ import annotations

import re
from collections import Counter
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.written import Curve, Measure, WrittenMusic, WrittenNote, WrittenPart, bend_curve
from tonewood.performance.score.xml_files import member, number_of, parsed, text_of

_QUARTER = 960
_NAMES = {"Whole": 4, "Half": 2, "Quarter": 1}
_DYNAMICS = {"PPP": 15, "PP": 31, "P": 47, "MP": 63, "MF": 79, "F": 95, "FF": 111, "FFF": 127}
_JUMPS = {
    "Segno": "segno", "Coda": "coda", "Fine": "fine", "DaCapo": "da_capo", "DaCapoAlFine": "da_capo",
    "DaCapoAlCoda": "da_capo", "DaSegno": "dal_segno", "DaSegnoAlFine": "dal_segno", "DaSegnoAlCoda": "dal_segno",
    "DaCoda": "to_coda",
}  # fmt: skip


def _jumps(name: str, ignored: Counter[str]) -> set[str]:
    """Sign of a direction, if it is one of `_JUMPS`."""
    ignored["direction that is not known"] += name not in _JUMPS
    return {_JUMPS[name]} if name in _JUMPS else set()


def read_guitar_pro(data: bytes, path: Path) -> WrittenMusic:
    """Read a file of Guitar Pro 3, 4 or 5.

    Raises
    ------
    ScoreError : pyguitarpro is not installed, or cannot read the file; one line.
    """
    try:
        import guitarpro
    except ImportError:
        raise ScoreError("Guitar Pro 3 to 5 need pyguitarpro: pip install 'tonewood[scores]'", file=path) from None
    try:
        song = guitarpro.parse(BytesIO(data))
    except Exception as error:  # whatever a damaged file makes of a reader without checks
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ScoreError(f"damaged Guitar Pro file: {reason}", file=path) from None
    music = WrittenMusic(path, [], [], {"title": song.title} if song.title else {})
    endings = 0
    for header in song.measureHeaders:
        numerator, denominator = header.timeSignature.numerator, header.timeSignature.denominator.value
        measure = Measure(Fraction(4 * numerator, denominator), opens=header.isRepeatOpen)
        measure.closes = header.repeatClose + 1 if header.repeatClose > 0 else 0
        # an ending lasts until the next one, or the end of its repeat
        endings = header.repeatAlternative or (0 if header.isRepeatOpen else endings)
        measure.endings = frozenset(i + 1 for i in range(8) if endings >> i & 1)
        endings = 0 if measure.closes else endings
        for direction in (header.direction, header.fromDirection):
            if direction is not None:
                measure.signs |= _jumps(direction.name.title().replace(" ", ""), music.ignored)
        music.measures.append(measure)
    if music.measures:
        music.measures[0].tempos.append((Fraction(0), float(song.tempo)))
    for track in song.tracks:
        part = WrittenPart(track.name.strip(), capo=track.offset)
        if track.isPercussionTrack:
            music.ignored["note of a percussion track"] += sum(
                len(beat.notes) for m in track.measures for v in m.voices for beat in v.beats
            )
        last: dict[int, Any] = {}
        for i, measure in enumerate(track.measures):
            notes: list[WrittenNote] = []
            for voice in measure.voices:
                for beat in voice.beats:
                    at = Fraction((beat.start or measure.header.start) - measure.header.start, _QUARTER)
                    change = beat.effect.mixTableChange
                    if change is not None and change.tempo is not None and i < len(music.measures):
                        tempo = (at, float(change.tempo.value))
                        if tempo not in music.measures[i].tempos:
                            music.measures[i].tempos.append(tempo)
                    if track.isPercussionTrack:
                        continue
                    notes += _beat(beat, at, track, last, music.ignored)
            part.measures.append(notes)
        music.parts.append(part)
    return music


def _beat(beat: Any, at: Fraction, track: Any, last: dict[int, Any], ignored: Counter[str]) -> list[WrittenNote]:
    """Notes of one beat; `last` has the note before on each string."""
    length = Fraction(beat.duration.time, _QUARTER)
    common: set[str] = set()
    if beat.effect.slapEffect.name != "none":
        common.add({"slapping": "slap", "popping": "pop", "tapping": "tapping"}[beat.effect.slapEffect.name])
    if beat.effect.vibrato:
        common.add("vibrato")
    ignored["fade in"] += beat.effect.fadeIn
    ignored["rasgueado"] += beat.effect.hasRasgueado
    stroke = beat.effect.stroke.direction.name
    ordered = sorted(beat.notes, key=lambda n: n.string, reverse=stroke != "up")
    out = []
    for place, note in enumerate(ordered):
        effect, kind = note.effect, note.type.name
        if kind == "rest":
            continue
        before = last.get(note.string)
        string = next((s for s in track.strings if s.number == note.string), None)
        if string is None:
            ignored["note on a string that the track does not have"] += 1
            continue
        fret = before.value if kind == "tie" and before is not None else note.value
        pitch = float(string.value + track.offset + fret)
        signs = set(common)
        flags = {"palm_mute": effect.palmMute, "let_ring": effect.letRing, "vibrato": effect.vibrato}
        flags |= {"staccato": effect.staccato, "ghost": effect.ghostNote, "accent": effect.accentuatedNote}
        flags |= {"marcato": effect.heavyAccentuatedNote, "dead": kind == "dead"}
        signs |= {name for name, on in flags.items() if on}
        signs |= _arrival(before, note.value)
        for slide in effect.slides:
            if slide.name.startswith(("into", "out")):
                ignored["slide into or out of a note"] += 1
        if effect.harmonic is not None:
            name = type(effect.harmonic).__name__
            fret, pitch = _harmonic(fret, pitch, name == "NaturalHarmonic", signs, ignored)
        bar = beat.effect.tremoloBar
        bend = _points(effect.bend, 50.0) if effect.bend else _points(bar, 50.0) if bar else ()
        if effect.grace is not None:
            own = ("hammer_on",) if effect.grace.transition.name == "hammer" else ()
            grace = float(string.value + track.offset + effect.grace.fret)
            out.append(WrittenNote(at, Fraction(0), grace, note.string, effect.grace.fret, signs=()))
            signs |= set(own)
        picking, trill = effect.tremoloPicking, effect.trill
        out.append(
            WrittenNote(
                at,
                length,
                pitch,
                note.string,
                fret,
                note.velocity,
                tuple(sorted(signs)),
                kind == "tie",
                bend,
                tremolo=Fraction(picking.duration.time, _QUARTER) if picking else None,
                trill=float(string.value + track.offset + trill.fret) if trill else None,
                strum=place if stroke != "none" else 0,
            )
        )
        if kind != "tie":
            last[note.string] = note
    return out


def _arrival(before: Any, fret: int) -> set[str]:
    """Signs that a note has from the one before it on its string."""
    if before is None:
        return set()
    signs = set()
    if before.effect.hammer and before.value != fret:
        signs.add("hammer_on" if fret > before.value else "pull_off")
    if any(slide.name in ("shiftSlideTo", "legatoSlideTo") for slide in before.effect.slides):
        signs.add("slide")
    return signs


def _harmonic(fret: int, pitch: float, natural: bool, signs: set[str], ignored: Counter[str]) -> tuple[int, float]:
    """Fret and pitch of the string under a harmonic: the open string, touched at fret 12."""
    if natural and fret == 12:
        signs.add("harmonic")
        return 0, pitch - 12
    ignored["harmonic other than the octave's, plucked as a note"] += 1
    return fret, pitch


def _points(effect: Any, unit: float) -> Curve:
    return bend_curve([(p.position / effect.maxPosition, unit * p.value) for p in effect.points])


def read_gpif(data: bytes, path: Path) -> WrittenMusic:
    """Read a file of Guitar Pro 7 or 8: ``Content/score.gpif`` in a zip archive."""
    root = parsed(member(data, "Content/score.gpif", path), path)
    if root.tag != "GPIF":
        raise ScoreError(f"is no Guitar Pro score but <{root.tag}>", file=path)
    return _Gpif(root, path).music()


class _Gpif:
    """Tables of a Guitar Pro 7 score, by id."""

    def __init__(self, root: Element, path: Path):
        self.root, self.path = root, path
        self.ignored: Counter[str] = Counter()
        self.tables = {
            kind: {e.get("id", ""): e for e in root.findall(f"{kind}s/{kind}")}
            for kind in ("Bar", "Voice", "Beat", "Note", "Rhythm")
        }

    def music(self) -> WrittenMusic:
        """All tracks."""
        title = text_of(self.root, "Score/Title")
        bars = self.root.findall("MasterBars/MasterBar")
        out = WrittenMusic(self.path, [self._measure(bar) for bar in bars], [], {"title": title} if title else {})
        for change in self.root.findall("MasterTrack/Automations/Automation"):
            if text_of(change, "Type") == "Tempo":
                i, share = int(number_of(change, "Bar", 0.0)), number_of(change, "Position", 0.0)
                value = text_of(change, "Value").split()
                if (
                    0 <= i < len(out.measures)
                    and value
                    and re.fullmatch(r"\d+(\.\d+)?", value[0])
                    and float(value[0]) > 0
                ):
                    at = Fraction(share).limit_denominator(960) * out.measures[i].length
                    out.measures[i].tempos.append((at, float(value[0])))
        column = 0
        for track in self.root.findall("Tracks/Track"):
            staves = track.findall("Staves/Staff") or [track]
            for staff in staves:
                values = {p.get("name"): p for p in staff.findall("Properties/Property")}
                tuning = [
                    float(x) for x in text_of(values.get("Tuning"), "Pitches").split() if x.lstrip("-").isdecimal()
                ]
                part = WrittenPart(text_of(track, "Name"), capo=int(number_of(values.get("CapoFret"), "Fret", 0.0)))
                self.last: dict[int, tuple[int, Element]] = {}
                part.measures = [self._bar(text_of(bar, "Bars").split(), column, tuning, part.capo) for bar in bars]
                out.parts.append(part)
                column += 1
        out.ignored = +self.ignored
        return out

    def _measure(self, bar: Element) -> Measure:
        over, _, under = text_of(bar, "Time", "4/4").partition("/")
        good = over.isdecimal() and under.isdecimal() and int(under) > 0
        measure = Measure(Fraction(4 * int(over), int(under)) if good else Fraction(4))
        if (repeat := bar.find("Repeat")) is not None:
            measure.opens = repeat.get("start") == "true"
            count = repeat.get("count", "2")
            measure.closes = min(int(count), 32) if repeat.get("end") == "true" and count.isdecimal() else 0
        measure.endings = frozenset(int(n) for n in text_of(bar, "AlternateEndings").split() if n.isdecimal())
        for sign in (text_of(e, ".") for e in bar.findall("Directions/*")):
            measure.signs |= _jumps(sign, self.ignored)
        return measure

    def _bar(self, bars: list[str], column: int, tuning: list[float], capo: int) -> list[WrittenNote]:
        bar = self.tables["Bar"].get(bars[column]) if column < len(bars) else None
        out: list[WrittenNote] = []
        for voice in text_of(bar, "Voices").split():
            at = Fraction(0)
            for number in text_of(self.tables["Voice"].get(voice), "Beats").split():
                beat = self.tables["Beat"].get(number)
                if beat is None:
                    self.ignored["beat that is not in the file"] += 1
                    continue
                grace = beat.find("GraceNotes") is not None
                length = Fraction(0) if grace else self._length(beat)
                out += self._beat(beat, at, length, tuning, capo)
                at += length
        return out

    def _length(self, beat: Element) -> Fraction:
        reference = beat.find("Rhythm")
        rhythm = None if reference is None else self.tables["Rhythm"].get(reference.get("ref", ""))
        name = text_of(rhythm, "NoteValue", "Quarter")
        digits = re.match(r"\d+", name)
        length = Fraction(_NAMES[name]) if name in _NAMES else Fraction(4, int(digits[0])) if digits else Fraction(1, 2)
        dots = None if rhythm is None else rhythm.find("AugmentationDot")
        n_dots = int(dots.get("count", "1")) if dots is not None and dots.get("count", "1").isdecimal() else 0
        length *= 2 - Fraction(1, 2 ** min(n_dots, 4))
        tuplet = None if rhythm is None else rhythm.find("PrimaryTuplet")
        if tuplet is not None:
            num = tuplet.get("num") or text_of(tuplet, "Num", "1")
            den = tuplet.get("den") or text_of(tuplet, "Den", "1")
            if num.isdecimal() and den.isdecimal() and int(num) > 0:
                length *= Fraction(int(den), int(num))
        return length

    def _beat(self, beat: Element, at: Fraction, length: Fraction, tuning: list[float], capo: int) -> list[WrittenNote]:
        values = {p.get("name"): p for p in beat.findall("Properties/Property")}
        common = {sign for name, sign in (("Slapped", "slap"), ("Popped", "pop")) if name in values}
        velocity = _DYNAMICS.get(text_of(beat, "Dynamic"), 79)
        strokes = {"1/2": 2, "1/4": 4, "1/8": 8}.get(text_of(beat, "Tremolo"))
        for name in ("WhammyBar", "FadeIn", "Fadding", "Rasgueado"):
            self.ignored[name.lower()] += name in values or beat.find(name) is not None
        brush = text_of(values.get("Brush"), "Direction")
        numbers = text_of(beat, "Notes").split()
        notes = [(n, self.tables["Note"].get(n)) for n in numbers]
        out = [self._note(note, at, length, tuning, capo, velocity, common) for _, note in notes if note is not None]
        found = sorted((n for n in out if n is not None), key=lambda n: n.pitch, reverse=brush == "Up")
        return [
            WrittenNote(
                n.at,
                n.length,
                n.pitch,
                n.string,
                n.fret,
                n.velocity,
                n.signs,
                n.tied,
                n.bend,
                tremolo=Fraction(1, strokes) if strokes else None,
                trill=n.trill,
                strum=i if brush else 0,
            )
            for i, n in enumerate(found)
        ]

    def _note(
        self,
        note: Element,
        at: Fraction,
        length: Fraction,
        tuning: list[float],
        capo: int,
        velocity: int,
        common: set[str],
    ) -> WrittenNote | None:
        values = {p.get("name"): p for p in note.findall("Properties/Property")}
        row, fret = (
            int(number_of(values.get("String"), "String", -1.0)),
            int(number_of(values.get("Fret"), "Fret", -1.0)),
        )
        if not 0 <= row < len(tuning) or fret < 0:
            self.ignored["note without string and fret"] += 1
            return None
        string, pitch, signs = len(tuning) - row, tuning[row] + capo + fret, set(common)
        switches = {"PalmMuted": "palm_mute", "Muted": "dead", "Tapped": "tapping"}
        signs |= {sign for name, sign in switches.items() if _on(values.get(name))}
        accent = int(number_of(note, "Accent", 0.0))
        bits = {1: "staccato", 4: "marcato", 8: "accent"}
        signs |= {sign for bit, sign in bits.items() if accent & bit}
        elements = {"LetRing": "let_ring", "Vibrato": "vibrato", "AntiAccent": "ghost"}
        signs |= {sign for name, sign in elements.items() if note.find(name) is not None}
        tie = note.find("Tie")
        tied = tie is not None and tie.get("destination") == "true"
        if (before := self.last.get(row)) is not None and not tied:
            earlier = {p.get("name"): p for p in before[1].findall("Properties/Property")}
            if _on(earlier.get("HopoOrigin")) and fret != before[0]:
                signs.add("hammer_on" if fret > before[0] else "pull_off")
            if int(number_of(earlier.get("Slide"), "Flags", 0.0)) & 3:
                signs.add("slide")
        self.ignored["slide into or out of a note"] += bool(int(number_of(values.get("Slide"), "Flags", 0.0)) & 60)
        self.last[row] = fret, note
        if _on(values.get("Harmonic")):
            kind = text_of(values.get("HarmonicType"), "HType")
            touched = round(number_of(values.get("HarmonicFret"), "HFret", float(fret)))
            fret, pitch = _harmonic(
                touched if kind == "Natural" else fret,
                tuning[row] + capo + (touched if kind == "Natural" else fret),
                kind == "Natural",
                signs,
                self.ignored,
            )
        trill = number_of(note, "Trill", -1.0)
        return WrittenNote(
            at, length, pitch, string, fret, velocity, tuple(sorted(signs)), tied, _gpif_bend(values),
            trill=trill if trill > 0 else None,
        )  # fmt: skip


def _on(value: Element | None) -> bool:
    return value is not None and value.find("Enable") is not None


def _gpif_bend(values: dict[str | None, Element]) -> Curve:
    if not _on(values.get("Bended")):
        return ()

    def number(name: str, default: float) -> float:
        return number_of(values.get(name), "Float", default)

    origin, middle, last = (number(f"Bend{n}Value", 0.0) for n in ("Origin", "Middle", "Destination"))
    points = [(number("BendOriginOffset", 0.0), origin), (number("BendDestinationOffset", 100.0), last)]
    if "BendMiddleValue" in values:
        points += [(number("BendMiddleOffset1", 50.0), middle), (number("BendMiddleOffset2", 50.0), middle)]
    return bend_curve([(share / 100.0, 2.0 * value) for share, value in points])
