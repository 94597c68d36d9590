"""The XML of Guitar Pro 6, 7 and 8 to written music.

Source of its meaning: files themselves, and what alphaTab (2026) plays of them; it is not documented. String 0 is the
lowest; a bend or whammy of 100 is a whole tone; the bits of a slide are 1 shift, 2 legato, 4 and 8 out of the note
downwards and upwards, 16 and 32 into it from below and above, 64 and 128 of a pick.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.bend_curves import Curve, bend_curve
from tonewood.performance.score.guitar_pro import DYNAMICS, FEELS, FRETS, GRACES, GRADUAL, RASGUEADOS, jump, strummed
from tonewood.performance.score.harmonics import touched
from tonewood.performance.score.limits import Allowance, number, whole
from tonewood.performance.score.score_clock import near
from tonewood.performance.score.unfolding import Measure
from tonewood.performance.score.written import WrittenMusic, WrittenNote, WrittenPart
from tonewood.performance.score.xml_files import number_of, parsed, text_of

_Value = TypeVar("_Value")
_QUARTER = 960
#: times that a measure is repeated
_MOST_TIMES = 128
#: measures
_MOST_MEASURES = 20_000
#: quarter notes in a measure; parts of a whole note; notes of a tuplet; bits of flags; ids in lists
_LONGEST, _SHORTEST, _MOST_OF_TUPLET, _FLAGS, _MOST_REFERENCES = 1024, 4096, 1000, 2**16, 300_000
#: largest bend, hundredths of a whole tone; elements of one bar, beat or note, which may be read very often
_BENDS, _MOST_OF_ONE = 4800.0, 300
#: elements, and texts of so many characters, that may be read again and again in all
_MOST_READ, _CHARACTERS = 20_000_000, 16
_VALUES = {"Long": 16, "DoubleWhole": 8, "Whole": 4, "Half": 2, "Quarter": 1}
#: quarter notes that a tempo counts, by the number after it
_TEMPO_UNITS = {"1": 0.5, "2": 1.0, "3": 1.5, "4": 2.0, "5": 3.0}
#: second number of a move of the sustain pedal -> its controller
_PEDALS = {"1": 1.0, "3": 0.0}
#: strokes of a tremolo, quarter notes
_TREMOLOS = {"1/2": Fraction(1, 2), "1/4": Fraction(1, 4), "1/8": Fraction(1, 8)}
_ORNAMENTS = {
    "Turn": "turn", "InvertedTurn": "inverted_turn", "UpperMordent": "inverted_mordent", "LowerMordent": "mordent",
}  # fmt: skip
_SLIDES = {4: "out_down", 8: "out_up", 16: "into_from_below", 32: "into_from_above"}
#: signs of a beat and of a note that are counted: nothing plays them
_UNPLAYED = {
    "Fadding": "fade", "FadeIn": "fade", "Wah": "wah", "Golpe": "golpe", "Hairpin": "hairpin", "Fermata": "fermata",
}  # fmt: skip
#: id of an arpeggio's or brush's duration, in parts of a quarter note, and that where there is none
_BRUSH_TIME, _BRUSH = "687935489", 30
#: measures that a sign of repetition goes back
_SIMILES = {"Simple": 1, "FirstOfDouble": 2, "SecondOfDouble": 2}


def read_gpif(pieces: Iterable[bytes], path: Path) -> WrittenMusic:
    """Read the XML of Guitar Pro 6, 7 or 8 from its bytes in pieces."""
    root = parsed(pieces, path)
    if root.tag != "GPIF":
        raise ScoreError(f"is no Guitar Pro score but <{root.tag}>", file=path)
    return _Gpif(root, path).music()


class _Gpif:
    """Tables of a score, by id."""

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
        self.ignored[f"{kind.lower()} that is not in the file"] += element is None and number != "-1"
        self.read.take(0 if element is None else self._sizes[element])
        return element

    def music(self) -> WrittenMusic:
        """All tracks."""
        composer = text_of(self.root, "Score/Music") or text_of(self.root, "Score/Artist")
        texts = {"title": text_of(self.root, "Score/Title"), "composer": composer}
        texts = {name: text for name, text in texts.items() if text}
        out = self.out = WrittenMusic(self.path, [], [], texts, tablature=True)
        self.ignored = out.ignored
        bars = self.root.findall("MasterBars/MasterBar")
        Allowance(_MOST_MEASURES, "measures", self.path).take(len(bars))
        out.measures += [self._measure(bar) for bar in bars]
        columns = [self._ids(bar, "Bars") for bar in bars]
        self.longest = Fraction(0)  # in the first measure
        column = 0
        for track in self.root.findall("Tracks/Track"):
            for staff in track.findall("Staves/Staff") or [track]:
                out.parts.append(self._staff(track, staff, columns, column))
                column += 1
        if self.root.find("MasterTrack/Anacrusis") is not None and out.measures and self.longest:
            out.measures[0].length = min(self.longest, out.measures[0].length)
        for change in self.root.findall("MasterTrack/Automations/Automation"):
            if text_of(change, "Type") == "Tempo":
                self._tempo(change)
        return out

    def _staff(self, track: Element, staff: Element, columns: list[list[str]], column: int) -> WrittenPart:
        values = {p.get("name"): p for p in staff.findall("Properties/Property")}
        pitches = text_of(values.get("Tuning"), "Pitches").split()
        self.tuning = [pitch for pitch in (number(x, -128.0, 256.0) for x in pitches) if pitch is not None]
        self.ignored["tuning of a string that cannot be read"] += len(pitches) - len(self.tuning)
        capo = number(text_of(values.get("CapoFret"), "Fret", "0"), 0.0, FRETS)
        self.ignored["capo that cannot be read"] += capo is None
        self.ignored["capo on some strings"] += number_of(values.get("PartialCapoFret"), "Fret", 0.0) > 0
        self.capo = int(capo or 0)
        midi = track.find("GeneralMidi")
        self.ignored["mute of a track"] += text_of(track, "PlaybackState") == "Mute"
        self.drums = text_of(track, "InstrumentSet/Type") == "drumKit" or (
            midi is not None and midi.get("table") == "Percussion"
        )
        named = text_of(track, "Sounds/Sound/MIDI/Program") or text_of(midi, "Program")
        part = self.part = WrittenPart(text_of(track, "Name"), capo=self.capo, program=_program(named))
        self._pedals(track)
        #: string -> fret and element of the last note on it
        self.last: dict[int, tuple[int, Element]] = {}
        for i, ids in enumerate(columns):
            self.out.cells.take()
            bar = self._entry("Bar", ids[column]) if column < len(ids) else None
            back = _SIMILES.get(text_of(bar, "SimileMark"), 0)
            if 0 < back <= i:
                part.measures.append(part.measures[i - back])
            else:
                part.measures.append(self._bar(bar, first=i == 0))
        return part

    def _known(self, table: Mapping[str, _Value], name: str, what: str) -> _Value | None:
        """Value of a name; one that is not known is counted."""
        self.ignored[f"{what} that is not known"] += bool(name) and name not in table
        return table.get(name)

    def _ids(self, element: Element | None, path: str) -> list[str]:
        ids = text_of(element, path).split()
        self.references.take(len(ids))
        return ids

    def _place(self, change: Element) -> tuple[int, Fraction] | None:
        """Measure of a change, and quarter notes in it; None where it does not say them."""
        i = whole(text_of(change, "Bar", "0"), 0, len(self.out.measures) - 1)
        share = number(text_of(change, "Position", "0"), 0.0, 1.0)
        if i is None or share is None:
            return None
        return i, Fraction(share).limit_denominator(_QUARTER) * self.out.measures[i].length

    def _tempo(self, change: Element) -> None:
        """Enter a change of tempo, if it states a measure, a position in it and a number."""
        beats, unit, *_ = [*text_of(change, "Value").split(), "", ""]
        position, value = self._place(change), number(beats, 0.0, 1e9)
        if position is None or value is None:
            self.ignored["tempo that cannot be read"] += 1
            return
        self.ignored[GRADUAL] += text_of(change, "Linear") == "true"
        self.out.tempo(self.out.measures[position[0]], position[1], value * _TEMPO_UNITS.get(unit, 1.0))

    def _pedals(self, track: Element) -> None:
        """Enter moves of the sustain pedal of a track."""
        for change in track.findall("Automations/Automation"):
            if text_of(change, "Type") == "SustainPedal":
                position, value = self._place(change), _PEDALS.get(text_of(change, "Value").partition(" ")[2])
                self.ignored["sustain pedal that cannot be read"] += position is None or value is None
                if position is not None and value is not None:
                    self.part.pedals.append((*position, 0.0, "cc64", value))

    def _measure(self, bar: Element) -> Measure:
        over, _, under = text_of(bar, "Time", "4/4").partition("/")
        upper, lower = whole(over, 1, _LONGEST), whole(under, 1, _SHORTEST)
        self.ignored["time signature that cannot be read"] += upper is None or lower is None
        measure = Measure(Fraction(4) if upper is None or lower is None else Fraction(4 * upper, lower))
        if (repeat := bar.find("Repeat")) is not None:
            measure.opens = repeat.get("start") == "true"
            times = whole(repeat.get("count", "2"), 0, _MOST_TIMES)
            self.ignored[f"repeat count outside 0 to {_MOST_TIMES}"] += times is None
            measure.closes = (2 if times is None else times) if repeat.get("end") == "true" else 0
        endings = [whole(n, 0, 9999) for n in self._ids(bar, "AlternateEndings")]
        measure.endings = frozenset(n for n in endings if n is not None)
        for sign in (text_of(e, ".") for e in bar.findall("Directions/*")):
            measure.signs |= jump(sign, self.ignored)
        feel = text_of(bar, "TripletFeel").replace("NoTripletFeel", "")
        measure.feel = self._known(FEELS, feel, "swing")
        self.ignored["fermata"] += len(bar.findall("Fermatas/Fermata"))
        return measure

    def _bar(self, bar: Element | None, first: bool) -> list[WrittenNote]:
        out: list[WrittenNote] = []
        for voice in self._ids(bar, "Voices"):
            at = Fraction(0)
            grace: list[Element] = []
            for beat_id in self._ids(self._entry("Voice", voice), "Beats"):
                beat = self._entry("Beat", beat_id)
                if beat is None:
                    continue
                if beat.find("GraceNotes") is not None:
                    grace.append(beat)
                    continue
                length = self._length(beat)
                grace_length = self._graces(grace, at, out)
                grace = []
                out += self._beat(beat, at + grace_length, max(length - grace_length, length / 2))
                at = near(at + length)
            for i, beat in enumerate(grace):  # with no beat after them in their measure
                each = GRACES[min(len(grace), len(GRACES)) - 1]
                out += self._beat(beat, at + i * each, each)
            if first:
                self.longest = max(self.longest, at)
        return out

    def _graces(self, beats: list[Element], at: Fraction, out: list[WrittenNote]) -> Fraction:
        """Play beats of grace notes before a place, or from it on; returns the time they take from the beat there."""
        if not beats:
            return Fraction(0)
        each = GRACES[min(len(beats), len(GRACES)) - 1]
        on_beat = text_of(beats[0], "GraceNotes") == "OnBeat"
        begin = at if on_beat else at - each * len(beats)
        for i, beat in enumerate(beats):
            out += self._beat(beat, begin + i * each, each)
        return each * len(beats) if on_beat else Fraction(0)

    def _values(self, element: Element) -> dict[str | None, Element]:
        if element not in self._properties:
            self._properties[element] = {p.get("name"): p for p in element.findall("Properties/Property")}
        return self._properties[element]

    def _length(self, beat: Element) -> Fraction:
        reference = beat.find("Rhythm")
        rhythm = None if reference is None else self._entry("Rhythm", reference.get("ref", ""))
        name = text_of(rhythm, "NoteValue", "Quarter")
        part = whole(name.rstrip("thnds"), 1, _SHORTEST)  # 16th, 32nd
        length = Fraction(_VALUES[name]) if name in _VALUES else Fraction(4, part) if part else Fraction(1, 2)
        self.ignored["note value that cannot be read"] += name not in (*_VALUES, "Eighth") and part is None
        dots = None if rhythm is None else rhythm.find("AugmentationDot")
        n_dots = 0 if dots is None else number(dots.get("count", "1"), 0.0, 1e9)
        length *= 2 - Fraction(1, 2 ** int(min(n_dots or 0, 4)))
        for kind in ("PrimaryTuplet", "SecondaryTuplet"):
            tuplets = [] if rhythm is None else rhythm.findall(kind)
            if not tuplets:
                continue
            tuplet, *others = tuplets
            self.ignored["second tuplet of a kind"] += len(others)
            num = whole(tuplet.get("num") or text_of(tuplet, "Num", "1"), 1, _MOST_OF_TUPLET)
            den = whole(tuplet.get("den") or text_of(tuplet, "Den", "1"), 1, _MOST_OF_TUPLET)
            if num is None or den is None:
                self.ignored["tuplet that cannot be read"] += 1
            else:
                length *= Fraction(den, num)
        return length

    def _beat(self, beat: Element, at: Fraction, length: Fraction) -> list[WrittenNote]:
        values = self._values(beat)
        listed = self._ids(beat, "Notes")
        self.out.signs.take(len(listed))
        if self.drums:
            self.ignored["note of a percussion track"] += len(listed)
            self.part.n_drums += len(listed)
            return []
        for name, counted in _UNPLAYED.items():
            self.ignored[counted] += name in values or beat.find(name) is not None
        common = {sign for name, sign in (("Slapped", "slap"), ("Popped", "pop")) if name in values}
        common |= _vibrato(text_of(values.get("VibratoWTremBar"), "Strength"))
        every = WrittenNote(
            at, length, 0.0, velocity=self._known(DYNAMICS, text_of(beat, "Dynamic"), "dynamic") or 79,
            signs=tuple(common), tremolo=self._known(_TREMOLOS, text_of(beat, "Tremolo"), "tremolo"),
            whammy=_whammy(beat, values),
        )  # fmt: skip
        if beat.find("DeadSlapped") is not None:
            self.out.signs.take(len(self.tuning))
            return [
                replace(every, length=min(length, Fraction(1, 16)), pitch=pitch, string=n, fret=0, signs=("dead",))
                for n, pitch in zip(range(len(self.tuning), 0, -1), self.tuning, strict=True)
            ]
        notes = [self._entry("Note", n) for n in listed]
        sounding = [n for n in (self._note(e, every) for e in notes if e is not None) if n is not None]
        brush = text_of(values.get("Brush"), "Direction") or text_of(beat, "Arpeggio")
        rasgueado = text_of(values.get("Rasgueado"), "Rasgueado").partition("_")
        if rasgueado[0] in RASGUEADOS:
            return self._rasgueado(sounding, RASGUEADOS[rasgueado[0]], rasgueado[2] == "2")
        self.ignored["rasgueado that is not known"] += bool(rasgueado[0])
        if not brush:
            return sounding
        ticks = [text_of(x, "Int") for x in beat.findall("XProperties/XProperty") if x.get("id") == _BRUSH_TIME]
        spread = whole(ticks[0] if ticks else "", 0, 2 * _QUARTER)
        return strummed(sounding, brush == "Up", Fraction(_BRUSH if spread is None else spread, _QUARTER))

    def _rasgueado(self, notes: list[WrittenNote], fingers: str, anapaest: bool) -> list[WrittenNote]:
        """Strokes of several fingers, one after the other in the time of a beat; each is a brush of a quarter of it."""
        out: list[WrittenNote] = []
        if not notes:
            return out
        shares = [1, 1, 2] if anapaest and len(fingers) == 3 else [1] * len(fingers)
        self.out.signs.take(len(notes) * len(fingers))
        at, unit = notes[0].at, notes[0].length / sum(shares)
        for finger, share in zip(fingers, shares, strict=True):
            stroke = [replace(n, at=at, length=share * unit) for n in notes]
            out += strummed(stroke, finger == "u", share * unit / 4)
            at += share * unit
        return out

    def _note(self, note: Element, every: WrittenNote) -> WrittenNote | None:
        values = self._values(note)
        row = int(number_of(values.get("String"), "String", -1.0))
        fret = int(number_of(values.get("Fret"), "Fret", -FRETS - 1.0, -FRETS, FRETS))
        signs = set(every.signs) | self._signs(note, values)
        tie = note.find("Tie")
        tied = tie is not None and tie.get("destination") == "true"
        on_string = 0 <= row < len(self.tuning) and fret >= -FRETS
        if on_string and fret < 0:  # below the open string, in a notation by pitch
            return replace(every, pitch=self.tuning[row] + self.capo + fret, signs=tuple(sorted(signs)), tied=tied)
        if not on_string:
            octave, tone = number_of(values.get("Octave"), "Number", -1.0), number_of(values.get("Tone"), "Step", 0.0)
            if octave < 0:
                self.ignored["note without string and fret"] += 1
                return None
            return replace(every, pitch=12.0 * octave + tone, signs=tuple(sorted(signs)), tied=tied)
        string, pitch = len(self.tuning) - row, self.tuning[row] + self.capo + fret
        arrives = ""
        if (before := self.last.get(row)) is not None and not tied:
            earlier = self._values(before[1])
            if _on(earlier.get("HopoOrigin")) and fret != before[0]:
                signs.add("hammer_on" if fret > before[0] else "pull_off")
            flags = _flags(earlier)
            arrives = "shift" if flags & 1 else "legato" if flags & 2 else ""
        self.ignored["pick slide"] += bool(_flags(values) & 192)
        self.last[row] = fret, note
        partial, kind = 0, text_of(values.get("HarmonicType"), "HType", "NoHarmonic")
        if kind != "NoHarmonic" and (_on(values.get("Harmonic")) or "HarmonicFret" in values):
            natural = kind == "Natural"
            node = number_of(values.get("HarmonicFret"), "HFret", float(fret) if natural else 12.0, 0.0, FRETS)
            fret, pitch, partial = touched(fret, pitch, node, natural, self.ignored)
        trill = number_of(note, "Trill", -1.0)
        return replace(
            every, pitch=pitch, string=string, fret=fret, signs=tuple(sorted(signs)), tied=tied,
            bend=_curve(lambda name: text_of(values.get(f"Bend{name}"), "Float")) if _on(values.get("Bended")) else (),
            trill=trill if trill > 0 else None, partial=partial, arrives=arrives,
            tremolo=Fraction(1, 4) if trill > 0 else every.tremolo,
            slides=tuple(name for bit, name in _SLIDES.items() if _flags(values) & bit),
        )  # fmt: skip

    def _signs(self, note: Element, values: dict[str | None, Element]) -> set[str]:
        switches = {"PalmMuted": "palm_mute", "Muted": "dead", "Tapped": "tapping", "LeftHandTapped": "tapping"}
        signs = {sign for name, sign in switches.items() if _on(values.get(name))}
        accent = int(number_of(note, "Accent", 0.0, 0.0, _FLAGS))
        bits = {1: "staccato", 4: "marcato", 8: "accent"}
        signs |= {sign for bit, sign in bits.items() if accent & bit}
        signs |= {
            sign for name, sign in (("LetRing", "let_ring"), ("AntiAccent", "ghost")) if note.find(name) is not None
        }
        signs |= _vibrato(text_of(note, "Vibrato"))
        ornament = self._known(_ORNAMENTS, text_of(note, "Ornament"), "ornament")
        if ornament is not None:
            signs.add(ornament)
        return signs


def _program(text: str) -> int | None:
    """Program of General MIDI, from 1, of one that is counted from 0."""
    program = whole(text, 0, 127)
    return None if program is None else program + 1


def _on(value: Element | None) -> bool:
    return value is not None and value.find("Enable") is not None


def _flags(values: dict[str | None, Element]) -> int:
    return int(number_of(values.get("Slide"), "Flags", 0.0, 0.0, _FLAGS))


def _vibrato(strength: str) -> set[str]:
    return {"Wide": {"wide_vibrato"}, "Slight": {"vibrato"}}.get(strength, set())


def _whammy(beat: Element, values: dict[str | None, Element]) -> Curve:
    """Course of the whammy bar over a beat: properties of it, or attributes of an element."""
    whammy = beat.find("Whammy")
    if whammy is not None:
        return _curve(lambda name: whammy.get(name[0].lower() + name[1:], ""))
    if "WhammyBar" in values:
        return _curve(lambda name: text_of(values.get(f"WhammyBar{name}"), "Float"))
    return ()


def _curve(text: Callable[[str], str]) -> Curve:
    """Course through an origin, a middle that is held between two places, and a destination."""

    def value(name: str, default: float) -> float:
        reading = number(text(name), -_BENDS, _BENDS)
        return default if reading is None else reading

    points = [(value("OriginOffset", 0.0), value("OriginValue", 0.0))]
    if number(text("MiddleValue"), -_BENDS, _BENDS) is not None:
        points += [(value(f"MiddleOffset{i}", 50.0), value("MiddleValue", 0.0)) for i in (1, 2)]
    points.append((value("DestinationOffset", 100.0), value("DestinationValue", 0.0)))
    return bend_curve([(share / 100.0, 2.0 * cents) for share, cents in points])
