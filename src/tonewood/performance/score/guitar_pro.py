"""Guitar Pro files to written music: 3 to 5 by pyguitarpro, 7 and 8 from the XML in their archive.

Source of the XML's meaning: files themselves; it is not documented. String 0 is the lowest; a bend of 100 is a whole
tone; the bits of a slide are 1 shift, 2 legato, 4 and 8 out of the note, 16 and 32 into it.
"""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.guitar_pro_file import bounded_reader, unknown_counted
from tonewood.performance.score.limits import Allowance, number, whole
from tonewood.performance.score.written import Curve, Measure, WrittenMusic, WrittenNote, WrittenPart, bend_curve, near
from tonewood.performance.score.xml_files import member, number_of, parsed, text_of

_QUARTER = 960
#: measures of files of versions 7 and 8
_MOST_MEASURES = 20_000
#: quarter notes in a measure; parts of a whole note; notes of a tuplet; frets; bits of flags; ids in lists
_LONGEST, _SHORTEST, _MOST_OF_TUPLET, _FRETS, _FLAGS, _MOST_REFERENCES = 1024, 4096, 1000, 99, 2**16, 300_000
#: largest bend, quarter tones; elements of one bar, beat or note, which may be read very often
_BENDS, _MOST_OF_ONE = 96.0, 300
#: elements, and texts of so many characters, that may be read again and again in all
_MOST_READ, _CHARACTERS = 20_000_000, 16
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
    music = WrittenMusic(path, [], [])
    try:
        with unknown_counted(music.ignored):
            song = bounded_reader(data, path).readSong()
            _fill(music, song)
    except Exception as error:  # whatever a damaged file makes of a reader without checks, and of its objects
        limit = error if isinstance(error, ScoreError) else error.__cause__
        if isinstance(limit, ScoreError):
            raise limit from None
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ScoreError(f"damaged Guitar Pro file: {reason}", file=path) from None
    return music


def _fill(music: WrittenMusic, song: Any) -> None:
    """Take over a song of pyguitarpro."""
    music.metadata |= {"title": song.title} if song.title else {}
    endings = 0
    for header in song.measureHeaders:
        over = whole(header.timeSignature.numerator, 1, 255)
        under = whole(header.timeSignature.denominator.value, 1, 255)
        music.ignored["time signature that cannot be read"] += over is None or under is None
        measure = Measure(Fraction(4 * (over or 4), under or 4), opens=header.isRepeatOpen)
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
        music.tempo(music.measures[0], Fraction(0), float(song.tempo))
    for track in song.tracks:
        capo = whole(track.offset, 0, _FRETS)
        music.ignored["capo that cannot be read"] += capo is None
        part = WrittenPart(track.name.strip(), capo=capo or 0)
        if track.isPercussionTrack:
            music.ignored["note of a percussion track"] += sum(
                len(beat.notes) for m in track.measures for v in m.voices for beat in v.beats
            )
        last: dict[int, Any] = {}
        for i, measure in enumerate(track.measures):
            music.cells.take()
            notes: list[WrittenNote] = []
            for voice in measure.voices:
                for beat in voice.beats:
                    at = Fraction((beat.start or measure.header.start) - measure.header.start, _QUARTER)
                    change = beat.effect.mixTableChange
                    if change is not None and change.tempo is not None and i < len(music.measures):
                        music.tempo(music.measures[i], at, float(change.tempo.value))
                    if track.isPercussionTrack:
                        continue
                    music.signs.take(len(beat.notes))
                    notes += _beat(beat, at, track, part.capo, last, music.ignored)
            part.measures.append(notes)
        music.parts.append(part)


def _beat(
    beat: Any, at: Fraction, track: Any, capo: int, last: dict[int, Any], ignored: Counter[str]
) -> list[WrittenNote]:
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
        pitch = float(string.value + capo + fret)
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
            grace = float(string.value + capo + effect.grace.fret)
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
                trill=float(string.value + capo + trill.fret) if trill else None,
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
    points = [(p.position / effect.maxPosition, unit * p.value) for p in effect.points]
    return bend_curve([(share, cents) for share, cents in points if abs(cents) <= 50.0 * _BENDS])


def read_gpif(data: bytes, path: Path) -> WrittenMusic:
    """Read a file of Guitar Pro 7 or 8: ``Content/score.gpif`` in a zip archive."""
    root = parsed(member(data, "Content/score.gpif", path), path)
    if root.tag != "GPIF":
        raise ScoreError(f"is no Guitar Pro score but <{root.tag}>", file=path)
    return _Gpif(root, path).music()


def _times(text: str) -> int:
    """How often a measure is played up to a repeat sign, at most 32; 0 where it does not say."""
    count = number(text, 0.0, 1e9)
    return 0 if count is None else int(min(count, 32))


class _Gpif:
    """Tables of a Guitar Pro 7 score, by id."""

    def __init__(self, root: Element, path: Path):
        self.root, self.path = root, path
        self.references = Allowance(_MOST_REFERENCES, "bars, voices, beats and notes in lists", path)
        self.tables = {
            kind: {e.get("id", ""): e for e in root.findall(f"{kind}s/{kind}")}
            for kind in ("Bar", "Voice", "Beat", "Note", "Rhythm")
        }
        self.read = Allowance(_MOST_READ, "elements and texts read again and again", path)
        #: element of a table -> its properties by name; what it takes to read it
        self._properties: dict[Element, dict[str | None, Element]] = {}
        self._sizes: dict[Element, int] = {}
        for kind, table in self.tables.items():
            for element in table.values():
                if len(element) + len(element.findall("*/*")) > _MOST_OF_ONE:
                    raise ScoreError(f"a {kind} of more than {_MOST_OF_ONE} elements", file=path)
                self._sizes[element] = sum(1 + len(e.text or "") // _CHARACTERS for e in element.iter())

    def _entry(self, kind: str, number: str) -> Element | None:
        """Element of a table, read once more: a long one that is listed often is work without end."""
        element = self.tables[kind].get(number)
        self.read.take(0 if element is None else self._sizes[element])
        return element

    def music(self) -> WrittenMusic:
        """All tracks."""
        title = text_of(self.root, "Score/Title")
        out = self.out = WrittenMusic(self.path, [], [], {"title": title} if title else {})
        self.ignored = out.ignored
        bars = self.root.findall("MasterBars/MasterBar")
        Allowance(_MOST_MEASURES, "measures", self.path).take(len(bars))
        out.measures += [self._measure(bar) for bar in bars]
        columns = [self._ids(bar, "Bars") for bar in bars]
        for change in self.root.findall("MasterTrack/Automations/Automation"):
            if text_of(change, "Type") == "Tempo":
                self._tempo(change)
        column = 0
        for track in self.root.findall("Tracks/Track"):
            staves = track.findall("Staves/Staff") or [track]
            for staff in staves:
                values = {p.get("name"): p for p in staff.findall("Properties/Property")}
                pitches = text_of(values.get("Tuning"), "Pitches").split()
                tuning = [pitch for pitch in (number(x, -128.0, 256.0) for x in pitches) if pitch is not None]
                self.ignored["tuning of a string that cannot be read"] += len(pitches) - len(tuning)
                capo = int(number_of(values.get("CapoFret"), "Fret", 0.0, 0.0, _FRETS))
                part = WrittenPart(text_of(track, "Name"), capo=capo)
                self.last: dict[int, tuple[int, Element]] = {}
                for ids in columns:
                    out.cells.take()
                    part.measures.append(self._bar(ids[column], tuning, capo) if column < len(ids) else [])
                out.parts.append(part)
                column += 1
        return out

    def _ids(self, element: Element | None, path: str) -> list[str]:
        """Ids that an element lists."""
        ids = text_of(element, path).split()
        self.references.take(len(ids))
        return ids

    def _tempo(self, change: Element) -> None:
        """Enter a change of tempo, if it says a measure, a place in it and a number."""
        i = whole(text_of(change, "Bar", "0"), 0, len(self.out.measures) - 1)
        share = number(text_of(change, "Position", "0"), 0.0, 1.0)
        value = number(" ".join(text_of(change, "Value").split()[:1]), 0.0, 1e9)
        if i is None or share is None or value is None:
            self.ignored["tempo that cannot be read"] += 1
            return
        at = Fraction(share).limit_denominator(_QUARTER) * self.out.measures[i].length
        self.out.tempo(self.out.measures[i], at, value)

    def _measure(self, bar: Element) -> Measure:
        over, _, under = text_of(bar, "Time", "4/4").partition("/")
        upper, lower = whole(over, 1, _LONGEST), whole(under, 1, _SHORTEST)
        self.ignored["time signature that cannot be read"] += upper is None or lower is None
        measure = Measure(Fraction(4) if upper is None or lower is None else Fraction(4 * upper, lower))
        if (repeat := bar.find("Repeat")) is not None:
            measure.opens = repeat.get("start") == "true"
            measure.closes = _times(repeat.get("count", "2")) if repeat.get("end") == "true" else 0
        endings = [whole(n, 0, 9999) for n in self._ids(bar, "AlternateEndings")]
        measure.endings = frozenset(n for n in endings if n is not None)
        for sign in (text_of(e, ".") for e in bar.findall("Directions/*")):
            measure.signs |= _jumps(sign, self.ignored)
        return measure

    def _bar(self, number: str, tuning: list[float], capo: int) -> list[WrittenNote]:
        out: list[WrittenNote] = []
        for voice in self._ids(self._entry("Bar", number), "Voices"):
            at = Fraction(0)
            for beat_id in self._ids(self._entry("Voice", voice), "Beats"):
                beat = self._entry("Beat", beat_id)
                if beat is None:
                    self.ignored["beat that is not in the file"] += 1
                    continue
                grace = beat.find("GraceNotes") is not None
                length = Fraction(0) if grace else self._length(beat)
                out += self._beat(beat, at, length, tuning, capo)
                at = near(at + length)
        return out

    def _values(self, element: Element) -> dict[str | None, Element]:
        if element not in self._properties:
            self._properties[element] = {p.get("name"): p for p in element.findall("Properties/Property")}
        return self._properties[element]

    def _length(self, beat: Element) -> Fraction:
        reference = beat.find("Rhythm")
        rhythm = None if reference is None else self._entry("Rhythm", reference.get("ref", ""))
        name = text_of(rhythm, "NoteValue", "Quarter")
        part = whole(name.rstrip("thnds"), 1, _SHORTEST)  # 16th, 32nd
        length = Fraction(_NAMES[name]) if name in _NAMES else Fraction(4, part) if part else Fraction(1, 2)
        self.ignored["note value that cannot be read"] += name not in (*_NAMES, "Eighth") and part is None
        dots = None if rhythm is None else rhythm.find("AugmentationDot")
        n_dots = 0 if dots is None else number(dots.get("count", "1"), 0.0, 1e9)
        length *= 2 - Fraction(1, 2 ** int(min(n_dots or 0, 4)))
        tuplet = None if rhythm is None else rhythm.find("PrimaryTuplet")
        if tuplet is not None:
            num = whole(tuplet.get("num") or text_of(tuplet, "Num", "1"), 1, _MOST_OF_TUPLET)
            den = whole(tuplet.get("den") or text_of(tuplet, "Den", "1"), 1, _MOST_OF_TUPLET)
            if num is None or den is None:
                self.ignored["tuplet that cannot be read"] += 1
            else:
                length *= Fraction(den, num)
        return length

    def _beat(self, beat: Element, at: Fraction, length: Fraction, tuning: list[float], capo: int) -> list[WrittenNote]:
        values = self._values(beat)
        common = {sign for name, sign in (("Slapped", "slap"), ("Popped", "pop")) if name in values}
        velocity = _DYNAMICS.get(text_of(beat, "Dynamic"), 79)
        strokes = {"1/2": 2, "1/4": 4, "1/8": 8}.get(text_of(beat, "Tremolo"))
        for name in ("WhammyBar", "FadeIn", "Fadding", "Rasgueado"):
            self.ignored[name.lower()] += name in values or beat.find(name) is not None
        brush = text_of(values.get("Brush"), "Direction")
        listed = self._ids(beat, "Notes")
        self.out.signs.take(len(listed))
        notes = [self._entry("Note", n) for n in listed]
        out = [self._note(note, at, length, tuning, capo, velocity, common) for note in notes if note is not None]
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
        values = self._values(note)
        row = int(number_of(values.get("String"), "String", -1.0))
        fret = int(number_of(values.get("Fret"), "Fret", -1.0, 0.0, _FRETS))
        if not 0 <= row < len(tuning) or fret < 0:
            self.ignored["note without string and fret"] += 1
            return None
        string, pitch, signs = len(tuning) - row, tuning[row] + capo + fret, set(common)
        switches = {"PalmMuted": "palm_mute", "Muted": "dead", "Tapped": "tapping"}
        signs |= {sign for name, sign in switches.items() if _on(values.get(name))}
        accent = int(number_of(note, "Accent", 0.0, 0.0, _FLAGS))
        bits = {1: "staccato", 4: "marcato", 8: "accent"}
        signs |= {sign for bit, sign in bits.items() if accent & bit}
        elements = {"LetRing": "let_ring", "Vibrato": "vibrato", "AntiAccent": "ghost"}
        signs |= {sign for name, sign in elements.items() if note.find(name) is not None}
        tie = note.find("Tie")
        tied = tie is not None and tie.get("destination") == "true"
        if (before := self.last.get(row)) is not None and not tied:
            earlier = self._values(before[1])
            if _on(earlier.get("HopoOrigin")) and fret != before[0]:
                signs.add("hammer_on" if fret > before[0] else "pull_off")
            if int(number_of(earlier.get("Slide"), "Flags", 0.0, 0.0, _FLAGS)) & 3:
                signs.add("slide")
        self.ignored["slide into or out of a note"] += bool(
            int(number_of(values.get("Slide"), "Flags", 0.0, 0.0, _FLAGS)) & 60
        )
        self.last[row] = fret, note
        if _on(values.get("Harmonic")):
            kind = text_of(values.get("HarmonicType"), "HType")
            touched = round(number_of(values.get("HarmonicFret"), "HFret", float(fret), 0.0, _FRETS))
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
        return number_of(values.get(name), "Float", default, -50.0 * _BENDS, 50.0 * _BENDS)

    origin, middle, last = (number(f"Bend{n}Value", 0.0) for n in ("Origin", "Middle", "Destination"))
    points = [(number("BendOriginOffset", 0.0), origin), (number("BendDestinationOffset", 100.0), last)]
    if "BendMiddleValue" in values:
        points += [(number("BendMiddleOffset1", 50.0), middle), (number("BendMiddleOffset2", 50.0), middle)]
    return bend_curve([(share / 100.0, 2.0 * value) for share, value in points])
