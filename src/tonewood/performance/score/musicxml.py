"""MusicXML (partwise and timewise) and compressed MXL to written music.

Of a tablature the string, the fret, the tuning (``staff-tuning``) and the capo are read. Signs that cannot be followed
are counted by their element's name.

Source: MusicXML 4.0, W3C Music Notation Community Group, 2021.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.written import Curve, Measure, WrittenMusic, WrittenNote, WrittenPart, bend_curve
from tonewood.performance.score.xml_files import as_number, member, number_of, parsed, text_of

_STEPS = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
_DYNAMICS = {"pppp": 8, "ppp": 20, "pp": 33, "p": 49, "mp": 64, "mf": 80, "f": 96, "ff": 112, "fff": 126, "ffff": 127}
_UNITS = {"whole": 4.0, "half": 2.0, "quarter": 1.0, "eighth": 0.5, "16th": 0.25, "32nd": 0.125}
_SIGNS = {
    "staccato": "staccato", "staccatissimo": "staccato", "accent": "accent", "strong-accent": "marcato",
    "harmonic": "harmonic", "tap": "tapping", "wavy-line": "vibrato", "inverted-mordent": "", "fingering": "",
    "string": "", "fret": "", "hammer-on": "", "pull-off": "", "bend": "", "pluck": "", "up-bow": "", "down-bow": "",
    "trill-mark": "", "tremolo": "", "accidental-mark": "", "slur": "", "tied": "", "tuplet": "", "tenuto": "",
    "thumb-position": "", "open-string": "", "breath-mark": "", "slide": "", "glissando": "", "arpeggiate": "",
    "dynamics": "", "palm-mute": "palm_mute", "fermata": "", "golpe": "golpe",
}  # fmt: skip
#: durations per quarter note; others are damaged
_MOST_DIVISIONS = 16384
#: elements whose text is a number
_NUMBERS = {
    "alter", "bend-alter", "capo", "chromatic", "divisions", "duration", "fret", "octave", "octave-change",
    "per-minute", "string", "tremolo", "tuning-alter", "tuning-octave",
}  # fmt: skip
#: quarter notes per minute, and times that a measure is repeated
_TEMPOS, _MOST_TIMES = (4.0, 2000.0), 32
#: of the number of an ending
_MOST_DIGITS = 4


def read_musicxml(data: bytes, path: Path) -> WrittenMusic:
    """Read MusicXML; raises a `ScoreError` of one line for a file that is none."""
    if data[:2] == b"PK":
        container = parsed(member(data, "META-INF/container.xml", path), path)
        roots = [e.get("full-path", "") for e in container.iter() if _name(e) == "rootfile"]
        if not roots:
            raise ScoreError("names no score in its container", file=path)
        data = member(data, roots[0], path)
    root = parsed(data, path)
    if root.tag == "score-timewise":
        root = _partwise(root)
    if root.tag != "score-partwise":
        raise ScoreError(f"is no score but <{root.tag}>", file=path)
    names = {e.get("id"): text_of(e, "part-name") for e in root.iter("score-part")}
    title = text_of(root, "work/work-title") or text_of(root, "movement-title")
    music = WrittenMusic(path, [], [], {"title": title} if title else {})
    for element in root.iter():
        if element.tag in _NUMBERS and math.isnan(as_number(element.text or "", math.nan)):
            music.ignored[f"{element.tag} that cannot be read"] += 1
    for part in root.findall("part"):
        reader = _PartReader(WrittenPart(names.get(part.get("id"), "")), music)
        for i, measure in enumerate(part.findall("measure")):
            reader.measure(measure, i)
        music.parts.append(reader.part)
    _number_endings(music.measures)
    return music


def _name(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _partwise(root: Element) -> Element:
    """Return the score part by part."""
    out = Element("score-partwise")
    out.extend(e for e in root if e.tag != "measure")
    parts: dict[str, Element] = {}
    for measure in root.findall("measure"):
        for part in measure.findall("part"):
            name = part.get("id", "")
            if name not in parts:
                parts[name] = Element("part", {"id": name})
                out.append(parts[name])
            own = Element("measure", measure.attrib)
            own.extend(part)
            parts[name].append(own)
    return out


def _number_endings(measures: list[Measure]) -> None:
    """Let a repeat over endings be played once for each pass that they name."""
    begin = 0
    for i, measure in enumerate(measures):
        if measure.opens:
            begin = i
        if measure.closes:
            passes = max([n for m in measures[begin : i + 2] for n in m.endings], default=0)
            measure.closes = max(measure.closes, passes if measure.endings else 0)


class _PartReader:
    """Reads the measures of one part."""

    def __init__(self, part: WrittenPart, music: WrittenMusic):
        self.part, self.music = part, music
        self.divisions, self.transpose, self.velocity = 1, 0.0, 80
        self.tuning: dict[int, float] = {}
        self.ending: frozenset[int] = frozenset()
        #: voice or string -> mark that the next note of a slide, hammer-on or pull-off gets
        self.palm = False
        self.vibrato = False

    def _quarters(self, element: Element, path: str = "duration") -> Fraction:
        number = number_of(element, path, 0.0)
        self.music.ignored += Counter({f"{path} below 0": number < 0})
        return Fraction(max(number, 0.0)).limit_denominator(_MOST_DIVISIONS) / self.divisions

    def measure(self, element: Element, index: int) -> None:
        """Read one measure."""
        own = index == len(self.music.measures)
        if own:
            self.music.measures.append(Measure(Fraction(0)))
        measure = self.music.measures[index]
        notes: list[WrittenNote] = []
        now = longest = began = Fraction(0)
        n_chord = 0
        for child in element:
            if child.tag == "note":
                length = Fraction(0) if child.find("grace") is not None else self._quarters(child)
                chord = child.find("chord") is not None
                if not chord:
                    began, n_chord = now, 0
                    now += length
                sign = self._note(child, began, length, n_chord)
                if sign is not None:
                    notes.append(sign)
                    n_chord += 1
            elif child.tag in ("backup", "forward"):
                step = self._quarters(child)
                now = max(now + (step if child.tag == "forward" else -step), Fraction(0))
            elif child.tag == "attributes":
                self._attributes(child)
            elif child.tag in ("direction", "sound"):
                self._direction(child, now, measure)
            elif child.tag == "barline":
                self._barline(child, measure)
            longest = max(longest, now)
        measure.length = max(measure.length, longest)
        measure.endings = measure.endings or self.ending
        if self.ending and any(e.get("type") != "start" for e in element.iter("ending")):
            self.ending = frozenset()
        while len(self.part.measures) < index:
            self.part.measures.append([])
        self.part.measures.append(notes)

    def _attributes(self, element: Element) -> None:
        divisions = number_of(element, "divisions", 0.0)
        if 0 < divisions <= _MOST_DIVISIONS:
            self.divisions = max(int(divisions), 1)
        elif divisions:
            self.music.ignored[f"divisions outside 1 to {_MOST_DIVISIONS}"] += 1
        if (move := element.find("transpose")) is not None:
            self.transpose = number_of(move, "chromatic", 0.0) + 12 * number_of(move, "octave-change", 0.0)
        for staff in element.findall("staff-details"):
            self.part.capo = int(number_of(staff, "capo", self.part.capo))
            lines = staff.findall("staff-tuning")
            for line in lines:
                pitch = _pitch(line, "tuning-step", "tuning-alter", "tuning-octave")
                if pitch is not None:
                    # lines count from the lowest, strings from the highest
                    self.tuning[len(lines) + 1 - int(as_number(line.get("line", ""), 1.0))] = pitch

    def _direction(self, element: Element, now: Fraction, measure: Measure) -> None:
        sound = element if element.tag == "sound" else element.find("sound")
        bpm = None
        metronome = element.find("direction-type/metronome")
        if metronome is not None:
            unit = _UNITS.get(text_of(metronome, "beat-unit"), 1.0)
            unit *= 1.5 if metronome.find("beat-unit-dot") is not None else 1.0
            bpm = number_of(metronome, "per-minute", 0.0) * unit or None
        if sound is not None:
            for name in ("tempo", "dynamics"):
                if (said := sound.get(name)) is None:
                    continue
                if (number := as_number(said, math.nan)) != number:
                    self.music.ignored["tempo or dynamics that is no number"] += 1
                elif name == "tempo":
                    bpm = number
                else:
                    self.velocity = min(max(round(number * 0.9), 1), 127)
            jumps = {"segno": "segno", "coda": "coda", "fine": "fine", "tocoda": "to_coda", "dacapo": "da_capo"}
            jumps |= {"dalsegno": "dal_segno"}
            measure.signs |= {sign for name, sign in jumps.items() if sound.get(name, "no") not in ("", "no")}
            mute = text_of(sound, "play/mute")
            self.palm = mute == "palm" if mute else self.palm
        if bpm is not None and not _TEMPOS[0] <= bpm <= _TEMPOS[1]:
            self.music.ignored["tempo outside 4 to 2000"] += 1
        elif bpm is not None and (now, bpm) not in measure.tempos:
            measure.tempos.append((now, bpm))
        for kind in element.findall("direction-type/*"):
            if kind.tag == "dynamics":
                level = next((e.tag for e in kind if e.tag in _DYNAMICS), None)
                self.velocity = (
                    _DYNAMICS[level] if level and (sound is None or "dynamics" not in sound.attrib) else self.velocity
                )
            elif kind.tag in ("wedge", "pedal", "harp-pedals", "scordatura"):
                self.music.ignored[kind.tag] += kind.get("type") != "stop"

    def _barline(self, element: Element, measure: Measure) -> None:
        repeat, ending = element.find("repeat"), element.find("ending")
        if ending is not None and ending.get("type") == "start":
            numbers = ending.get("number", "1").replace(",", " ").split()
            self.ending = frozenset(int(n) for n in numbers if n.isdecimal() and len(n) <= _MOST_DIGITS) or frozenset(
                {1}
            )
            measure.endings = self.ending
        if repeat is not None and repeat.get("direction") == "forward":
            measure.opens = True
        elif repeat is not None:
            times = as_number(repeat.get("times", "2"), math.nan)
            self.music.ignored += Counter({f"repeat times outside 1 to {_MOST_TIMES}": not 1 <= times <= _MOST_TIMES})
            measure.closes = max(measure.closes, int(min(times, _MOST_TIMES)) if times >= 1 else 2)

    def _note(self, element: Element, at: Fraction, length: Fraction, place: int) -> WrittenNote | None:
        if element.find("rest") is not None or element.find("cue") is not None:
            return None
        pitch = _pitch(element.find("pitch"), "step", "alter", "octave")
        if pitch is None:
            self.music.ignored["unpitched note"] += 1
            return None
        signs, ignored = _signs(element)
        self.music.ignored += ignored
        if self.palm:
            signs.add("palm_mute")
        if text_of(element, "notehead") == "x":
            signs.add("dead")
        ties = [e.get("type") for e in element.findall("tie")]
        if any(e.get("type") == "let-ring" for e in element.findall("notations/tied")):
            signs.add("let_ring")
        technical = element.find("notations/technical")
        note = WrittenNote(
            at, length, pitch + self.transpose, velocity=self.velocity, signs=tuple(sorted(signs)),
            tied="stop" in ties, bend=_bend(technical),
            strum=place if element.find("notations/arpeggiate") is not None else 0,
        )  # fmt: skip
        ornaments = element.find("notations/ornaments")
        if ornaments is not None and ornaments.find("trill-mark") is not None:
            note = replace(note, trill=note.pitch + 2)
        strokes = number_of(ornaments, "tremolo", 0.0)
        if 0 < strokes <= 5:
            note = replace(note, tremolo=Fraction(1, 2 ** int(strokes)))
        return self._placed(note, technical)

    def _placed(self, note: WrittenNote, technical: Element | None) -> WrittenNote:
        """The note with its string and fret, if its pitch is there."""
        string, fret = number_of(technical, "string", -1.0), number_of(technical, "fret", -1.0)
        if string < 1 or fret < 0:
            return note
        if self.tuning and "harmonic" not in note.signs:
            # the fret counts from the capo, or from the nut
            left = note.pitch - self.tuning.get(int(string), -1e3)
            found = [left - self.part.capo] if left in (fret, fret + self.part.capo) else []
            if not found:
                self.music.ignored["string and fret that have another pitch than the note"] += 1
                return replace(note, string=int(string))
            fret = found[0]
        return replace(note, string=int(string), fret=int(fret))


def _pitch(element: Element | None, step: str, alter: str, octave: str) -> float | None:
    letter = text_of(element, step)
    if letter not in _STEPS:
        return None
    pitch = 12 * (number_of(element, octave, 4.0) + 1) + _STEPS[letter] + number_of(element, alter, 0.0)
    return pitch if 0.0 <= pitch <= 140.0 else None


def _signs(element: Element) -> tuple[set[str], Counter[str]]:
    """Signs of a note, and those that are not followed."""
    signs: set[str] = set()
    ignored: Counter[str] = Counter()
    for sign in _notated(element):
        name = _SIGNS.get(sign.tag)
        if name is None:
            ignored[sign.tag] += 1
        elif name:
            signs.add(name)
        if sign.get("type") == "stop":
            ending = {"hammer-on": "hammer_on", "pull-off": "pull_off", "slide": "slide", "glissando": "slide"}
            signs |= {ending[sign.tag]} if sign.tag in ending else set()
    return signs, ignored


def _notated(element: Element) -> Iterator[Element]:
    for notations in element.findall("notations"):
        for sign in notations:
            if sign.tag in ("articulations", "technical", "ornaments"):
                yield from sign
            else:
                yield sign


def _bend(technical: Element | None) -> Curve:
    """Course of a note's bends, one after the other, in equal parts of the note."""
    bends = [] if technical is None else technical.findall("bend")
    if not bends:
        return ()
    points: list[tuple[float, float]] = []
    value = 0.0
    for i, bend in enumerate(bends):
        target = 0.0 if bend.find("release") is not None else 100.0 * number_of(bend, "bend-alter", 0.0)
        begin = i / len(bends)
        points.append((begin, target if bend.find("pre-bend") is not None else value))
        points.append((begin + 0.5 / len(bends), target))
        value = target
    return bend_curve([*points, (1.0, value)])
