"""MusicXML (partwise and timewise) and compressed MXL to written music.

Of a tablature the string, the fret, the tuning (``staff-tuning``) and the capo are read. Signs that cannot be followed
are counted by their element's name.

Source: MusicXML 4.0, W3C Music Notation Community Group, 2021.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import number, whole
from tonewood.performance.score.unfolding import Measure
from tonewood.performance.score.written import Curve, WrittenMusic, WrittenNote, WrittenPart, bend_curve, near
from tonewood.performance.score.xml_files import MOST, member, number_of, parsed, text_of

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
#: kinds of what is left out, from which on names of signs are no longer told, and characters of a name
_MOST_UNKNOWN, _LONGEST_SIGN = 100, 40
#: times that a measure is repeated, number of an ending, and of a line of a staff
_MOST_TIMES, _MOST_ENDING, _MOST_LINES = 32, 9999, 1000


def read_musicxml(data: bytes, path: Path) -> WrittenMusic:
    """Read MusicXML; raises a `ScoreError` of one line for a file that is none."""
    pieces: Iterable[bytes] = (data,)
    if data[:2] == b"PK":
        container = parsed(member(data, "META-INF/container.xml", path), path)
        roots = [e.get("full-path", "") for e in container.iter() if _name(e) == "rootfile"]
        if not roots:
            raise ScoreError("names no score in its container", file=path)
        pieces = member(data, roots[0], path)
    reader = _Reader(WrittenMusic(path, [], []))
    root = parsed(pieces, path, reader.cell)
    if root.tag not in ("score-partwise", "score-timewise"):
        raise ScoreError(f"is no score but <{root.tag}>", file=path)
    return reader.music_of(root)


def _name(element: Element) -> str:
    return element.tag.rpartition("}")[2]


class _Reader:
    """Reads measures as soon as they end in the file, part by part or measure by measure."""

    def __init__(self, music: WrittenMusic):
        self.music = music
        #: element of a part, or its name in a score by measures -> its reader
        self._parts: dict[Element | str, _PartReader] = {}

    def cell(self, above: list[Element], element: Element) -> bool:
        """Read an element if it is a measure of a part; returns whether it was."""
        tags = above[0].tag, above[1].tag, element.tag
        if tags == ("score-partwise", "part", "measure"):
            self._reader(above[1]).measure(element)
        elif tags == ("score-timewise", "measure", "part"):
            self._reader(element.get("id", "")).measure(element)
        else:
            return False
        return True

    def _reader(self, part: Element | str) -> _PartReader:
        if part not in self._parts:
            self._parts[part] = _PartReader(WrittenPart(""), self.music)
        return self._parts[part]

    def music_of(self, root: Element) -> WrittenMusic:
        """Return all parts, named."""
        music = self.music
        title = text_of(root, "work/work-title") or text_of(root, "movement-title")
        music.metadata |= {"title": title} if title else {}
        names = {e.get("id"): text_of(e, "part-name") for e in root.iter("score-part")}
        if root.tag == "score-partwise":  # parts without a measure, too
            self._parts = {part: self._reader(part) for part in root.findall("part")}
        for part, reader in self._parts.items():
            reader.part.name = names.get(part if isinstance(part, str) else part.get("id"), "")
            music.parts.append(reader.part)
        _number_endings(music.measures)
        return music


def _number_endings(measures: list[Measure]) -> None:
    """Let a repeat over endings be played once for each pass that they name."""
    passes = 0  # of the measures since the repeat began
    for i, measure in enumerate(measures):
        passes = max([0 if measure.opens else passes, *measure.endings])
        if measure.closes and measure.endings:
            following = measures[i + 1].endings if i + 1 < len(measures) else ()
            measure.closes = max([measure.closes, passes, *following])


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
        quarters = number_of(element, path, 0.0)
        self.music.ignored[f"{path} below 0"] += quarters < 0
        return Fraction(max(quarters, 0.0)).limit_denominator(_MOST_DIVISIONS) / self.divisions

    def measure(self, element: Element) -> None:
        """Read the next measure."""
        index = len(self.part.measures)
        self.music.cells.take()
        if index == len(self.music.measures):
            self.music.measures.append(Measure(Fraction(0)))
        measure = self.music.measures[index]
        for e in element.iter():
            if e.tag in _NUMBERS and number(e.text or "", -MOST, MOST) is None:
                self.music.ignored[f"{e.tag} that cannot be read"] += 1
        notes: list[WrittenNote] = []
        now = longest = began = Fraction(0)
        n_chord = 0
        for child in element:
            if child.tag == "note":
                length = Fraction(0) if child.find("grace") is not None else self._quarters(child)
                chord = child.find("chord") is not None
                if not chord:
                    began, n_chord = now, 0
                    now = near(now + length)
                sign = self._note(child, began, length, n_chord)
                if sign is not None:
                    notes.append(sign)
                    n_chord += 1
            elif child.tag in ("backup", "forward"):
                step = self._quarters(child)
                now = near(max(now + (step if child.tag == "forward" else -step), Fraction(0)))
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
            self.part.capo = int(number_of(staff, "capo", self.part.capo, 0.0, _MOST_LINES))
            lines = staff.findall("staff-tuning")
            for line in lines:
                pitch = _pitch(line, "tuning-step", "tuning-alter", "tuning-octave")
                if pitch is not None:
                    # lines count from the lowest, strings from the highest
                    self.tuning[len(lines) + 1 - (whole(line.get("line", ""), -_MOST_LINES, _MOST_LINES) or 1)] = pitch

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
                if (value := number(said, -MOST, MOST)) is None:
                    self.music.ignored["tempo or dynamics that is no number"] += 1
                elif name == "tempo":
                    bpm = value
                else:
                    self.velocity = min(max(round(value * 0.9), 1), 127)
            jumps = {"segno": "segno", "coda": "coda", "fine": "fine", "tocoda": "to_coda", "dacapo": "da_capo"}
            jumps |= {"dalsegno": "dal_segno"}
            measure.signs |= {sign for name, sign in jumps.items() if sound.get(name, "no") not in ("", "no")}
            mute = text_of(sound, "play/mute")
            self.palm = mute == "palm" if mute else self.palm
        if bpm is not None:
            self.music.tempo(measure, now, bpm)
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
            self.ending = frozenset(n for n in (whole(n, 0, _MOST_ENDING) for n in numbers) if n is not None)
            self.ending = self.ending or frozenset({1})
            measure.endings = self.ending
        if repeat is not None and repeat.get("direction") == "forward":
            measure.opens = True
        elif repeat is not None:
            times = number(repeat.get("times", "2"), 1, MOST)
            self.music.ignored[f"repeat times outside 1 to {_MOST_TIMES}"] += times is None or times > _MOST_TIMES
            measure.closes = max(measure.closes, int(min(times, _MOST_TIMES)) if times is not None else 2)

    def _note(self, element: Element, at: Fraction, length: Fraction, place: int) -> WrittenNote | None:
        if element.find("rest") is not None or element.find("cue") is not None:
            return None
        pitch = _pitch(element.find("pitch"), "step", "alter", "octave")
        if pitch is None:
            self.music.ignored["unpitched note"] += 1
            return None
        self.music.signs.take()
        signs, ignored = _signs(element)
        for name, n in ignored.items():
            short = name[:_LONGEST_SIGN]
            if short not in self.music.ignored and len(self.music.ignored) >= _MOST_UNKNOWN:
                short = "other signs that are not known"
            self.music.ignored[short] += n
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
