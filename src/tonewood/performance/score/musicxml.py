"""MusicXML (partwise and timewise) and compressed MXL to written music.

Of a tablature the string, the fret, the tuning (``staff-tuning``) and the capo are read. Signs that cannot be followed
are counted by their element's name.

Source: MusicXML 4.0, W3C Music Notation Community Group, 2021.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from operator import itemgetter
from pathlib import Path
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import Allowance, number, whole
from tonewood.performance.score.musicxml_harmonics import kind_of_pitch, not_heard, sounding
from tonewood.performance.score.musicxml_pitch import neighbours, pitch_of
from tonewood.performance.score.musicxml_words import (
    DYNAMICS,
    MOST_DIVISIONS,
    bend_of,
    divisions_of,
    from_lowest,
    jump_sign,
    meter_of,
    offset_of,
    passes_of,
    signs_of,
    strum_of,
    velocity_of,
    written_tempo,
)
from tonewood.performance.score.score_clock import near
from tonewood.performance.score.unfolding import Measure, number_endings
from tonewood.performance.score.written import WrittenMusic, WrittenNote, WrittenPart
from tonewood.performance.score.xml_files import MOST, member, number_of, parsed, text_of

#: velocity that a hairpin adds or takes where no dynamics follow, and quarter notes after its end in which they may
_HAIRPIN, _HAIRPIN_ENDS = 16, Fraction(1)
#: s for which a pedal is up where it changes
_PEDAL_UP = 0.06
#: elements whose text is a number
_NUMBERS = {
    "alter", "bend-alter", "capo", "chromatic", "divisions", "duration", "fifths", "fret", "octave", "octave-change",
    "string", "tremolo", "tuning-alter", "tuning-octave",
}  # fmt: skip
_PROGRAM = "midi-instrument/midi-program"
#: kinds of what is left out, from which on names of signs are left out, and characters of a name
_MOST_UNKNOWN, _LONGEST_SIGN = 100, 40
#: times that a measure is repeated, number of a line of a staff, parts, numbers of one ending
_MOST_TIMES, _MOST_LINES, _MOST_PARTS, _MOST_NUMBERS = 32, 1000, 2000, 100


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


@dataclass(slots=True)
class _Content:
    """What all parts write into a measure.

    empty : quarter notes by the time signature of parts without a note or rest in it.
    overfull : whether parts go beyond their time signature; some may, and some not.
    """

    empty: Fraction = Fraction(0)
    overfull: set[bool] = field(default_factory=set)


class _Reader:
    """Reads measures as soon as they end in the file, part by part or measure by measure."""

    def __init__(self, music: WrittenMusic):
        self.music, self._contents = music, list[_Content]()
        #: element of a part, or its name in a score by measures -> its reader
        self._parts: dict[Element | str, _PartReader] = {}
        self._allowed = Allowance(_MOST_PARTS, "parts", music.file)

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
            self._allowed.take()
            self._parts[part] = _PartReader(WrittenPart(""), self.music, self._contents)
        return self._parts[part]

    def music_of(self, root: Element) -> WrittenMusic:
        """Return all parts, named."""
        music = self.music
        title = text_of(root, "work/work-title") or text_of(root, "movement-title")
        composer = text_of(root, "identification/creator[@type='composer']")
        music.metadata |= {k: text for k, text in (("title", title), ("composer", composer)) if text}
        names = {e.get("id"): text_of(e, "part-name") for e in root.iter("score-part")}
        if root.tag == "score-partwise":  # parts without a measure, too
            self._parts = {part: self._reader(part) for part in root.findall("part")}
        programs = {e.get("id"): whole(text_of(e, _PROGRAM), 1, 128) for e in root.iter("score-part")}
        ids = [e.get("id") for e in root.iter("score-part") if e.find(_PROGRAM) is not None]
        music.ignored["midi-program outside 1 to 128"] += sum(programs[part] is None for part in ids)
        starts = [Fraction(0)]
        for measure, content in zip(music.measures, self._contents, strict=True):
            measure.length = measure.length or content.empty
            several = len(content.overfull) > 1
            music.ignored["measure that some parts make longer than its time signature"] += several
            starts.append(near(starts[-1] + measure.length))
        for part, reader in self._parts.items():
            reader.hairpins(starts)
            number = part if isinstance(part, str) else part.get("id")
            reader.part.name, reader.part.program = names.get(number, ""), programs.get(number)
            music.parts.append(reader.part)
        if not any(reader.sounded for reader in self._parts.values()):
            for measure, sign in (one for reader in self._parts.values() for one in reader.written):
                measure.signs.add(sign)
        number_endings(music.measures)
        return music


class _PartReader:
    def __init__(self, part: WrittenPart, music: WrittenMusic, contents: list[_Content]):
        self.part, self.music, self.contents = part, music, contents
        self.divisions, self.velocity, self.staves = Fraction(0), 80, 1
        self.transpose: dict[str, float] = {}  # number of a staff, "" for all others -> semitones
        self.tuning: dict[int, float] = {}
        self.ending: frozenset[int] = frozenset()
        self.palm = False
        self.fifths = 0
        #: quarter notes of a measure by the time signature
        self.meter = Fraction(0)
        self.feel: tuple[Fraction, Fraction] | None = None
        #: (measure, quarter notes, velocity) of dynamics, and (measure, quarter notes, kind) of ends of hairpins
        self.levels: list[tuple[int, Fraction, int]] = []
        self.wedges: list[tuple[int, Fraction, str]] = []
        #: measures back to the one that a sign of repetition plays again; 0 where there is none
        self.simile = 0
        #: whether a sound says a jump, and (measure, sign) of jumps and marks that are only written
        self.sounded, self.written = False, list[tuple[Measure, str]]()

    def _quarters(self, element: Element) -> Fraction:
        ticks = number(text_of(element, "duration"), -MOST, MOST)
        length = Fraction(max(ticks or 0.0, 0.0)).limit_denominator(MOST_DIVISIONS)
        self.music.ignored[f"{element.tag} without a duration"] += element.find("duration") is None
        self.music.ignored["duration below 0"] += ticks is not None and ticks < 0
        if ticks is not None and ticks >= 0 and element.tag == "note":
            self.music.ignored["note whose duration is 0"] += not length
        return length / self.divisions

    def measure(self, element: Element) -> None:
        """Read the next measure."""
        index = len(self.part.measures)
        self.music.cells.take()
        if index == len(self.music.measures):
            self.music.measures.append(Measure(Fraction(0)))
            self.contents.append(_Content())
        measure, content = self.music.measures[index], self.contents[index]
        for e in element.iter():
            if e.tag in _NUMBERS and number(e.text or "", -MOST, MOST) is None:
                self.music.ignored[f"{e.tag} that cannot be read"] += 1
        notes: list[WrittenNote] = []
        now = longest = began = Fraction(0)
        n_chord = 0
        silent, octaves = not_heard(element)
        self.music.ignored["harmonic whose sounding pitch is not written, played at the octave"] += octaves
        if not self.divisions:  # they may stand after the first notes
            self.divisions = next(filter(None, map(divisions_of, element.findall("attributes"))), Fraction(1))
            has_divisions = element.find("note/duration") is None or element.find("attributes/divisions") is not None
            self.music.ignored["part without divisions"] += not has_divisions
        for child in element:
            if child.tag == "note":
                length = Fraction(0) if child.find("grace") is not None else self._quarters(child)
                chord = child.find("chord") is not None
                if not chord:
                    began, n_chord = now, 0
                    now = near(now + length)
                if length and child.find("cue") is None and child.find("notations/fermata") is not None:
                    measure.holds.add((began, began + length))
                sign = None if child in silent else self._note(child, began, length, n_chord)
                if sign is not None:
                    notes.append(replace(sign, in_chord=True) if chord and not length else sign)
                    n_chord += 1
            elif child.tag in ("backup", "forward"):
                now = near(now + (1 if child.tag == "forward" else -1) * self._quarters(child))
                self.music.ignored["backup beyond the beginning of its measure"] += now < 0
                now = max(now, Fraction(0))
            elif child.tag == "attributes":
                self._attributes(child)
            elif child.tag in ("direction", "sound"):
                self._direction(child, now, measure)
            elif child.tag == "barline":
                self._barline(child, measure)
            longest = max(longest, now)
        from_lowest(notes)
        if self.simile and not any(n.find("rest") is None for n in element.findall("note")):
            notes = list(self.part.measures[index - self.simile]) if self.simile <= index else []
            self.music.signs.take(len(notes))
        measure.feel = measure.feel or self.feel
        measure.length = max(measure.length, longest)
        measure.endings = measure.endings or self.ending
        if self.ending and any(e.get("type") != "start" for e in element.iter("ending")):
            self.ending = frozenset()
        self.part.measures.append(notes)
        if element.find("note") is None:
            content.empty = max(content.empty, self.meter)
        if longest and self.meter:
            content.overfull.add(longest > self.meter)

    def _attributes(self, element: Element) -> None:
        self.divisions = divisions_of(element) or self.divisions
        wrong = number(text_of(element, "divisions"), -MOST, MOST) is not None and not divisions_of(element)
        self.music.ignored[f"divisions outside 1/{MOST_DIVISIONS} to {MOST_DIVISIONS}"] += wrong
        self.music.ignored["fifths outside -7 to 7"] += abs(number_of(element, "key/fifths", 0.0)) > 7
        self.meter = meter_of(element, self.meter)
        self.staves = whole(text_of(element, "staves"), 1, _MOST_LINES) or self.staves
        self.fifths = int(number_of(element, "key/fifths", self.fifths, -7.0, 7.0))
        for style in element.findall("measure-style"):
            self._simile(style)
        for move in element.findall("transpose"):
            steps = number_of(move, "chromatic", 0.0) + 12 * number_of(move, "octave-change", 0.0)
            staff_number = move.get("number", "")
            if not staff_number:
                self.transpose.clear()
            self.transpose[staff_number] = steps
            self.music.ignored["transposition that doubles"] += move.find("double") is not None
        for staff in element.findall("staff-details"):
            capo = number_of(staff, "capo", self.part.capo)
            self.music.ignored[f"capo outside 0 to {_MOST_LINES}"] += not 0 <= capo <= _MOST_LINES
            self.part.capo = int(capo) if 0 <= capo <= _MOST_LINES else self.part.capo
            lines = staff.findall("staff-tuning")
            for line in lines:
                pitch = pitch_of(line, "tuning-step", "tuning-alter", "tuning-octave")
                if pitch is not None:
                    # lines count from the lowest, strings from the highest
                    self.tuning[len(lines) + 1 - (whole(line.get("line", ""), -_MOST_LINES, _MOST_LINES) or 1)] = pitch

    def _simile(self, style: Element) -> None:
        """Note which measures are played again; signs for a beat, and for one staff of several, are counted."""
        beat, sign = style.find("beat-repeat"), style.find("measure-repeat")
        self.music.ignored["beat-repeat"] += beat is not None and beat.get("type") == "start"
        if sign is None:
            return
        back = whole(sign.text or "", 1, _MOST_TIMES) if sign.get("type") == "start" else 0
        self.music.ignored["measure-repeat that cannot be read"] += back is None
        several = back and style.get("number") is not None and self.staves > 1
        self.music.ignored["measure-repeat on one of several staves"] += bool(several)
        self.simile = 0 if several else back or 0

    def _direction(self, element: Element, now: Fraction, measure: Measure) -> None:
        sound = element if element.tag == "sound" else element.find("sound")
        now = max(near(now + offset_of(element, sound, self.music.ignored) / self.divisions), Fraction(0))
        bpm = written_tempo(element, self.music.ignored)
        before = self.velocity
        if sound is not None:
            for name in ("tempo", "dynamics"):
                if (text := sound.get(name)) is None:
                    continue
                if (value := number(text, -MOST, MOST)) is None:
                    self.music.ignored["tempo or dynamics that is no number"] += 1
                elif name == "tempo":
                    bpm = value
                else:
                    self.music.ignored["dynamics beyond velocities 1 to 127"] += not 1 <= round(value * 0.9) <= 127
                    self.velocity = velocity_of(value)
            jumps = {"segno": "segno", "coda": "coda", "fine": "fine", "tocoda": "to_coda", "dacapo": "da_capo"}
            jumps |= {"dalsegno": "dal_segno"}
            said_jumps = {sign for name, sign in jumps.items() if sound.get(name, "no") not in ("", "no")}
            measure.signs |= said_jumps
            self.sounded = self.sounded or bool(said_jumps)
            measure.opens = measure.opens or sound.get("forward-repeat") == "yes"
            self.music.ignored["sound of some passes only, obeyed in all"] += sound.get("time-only") is not None
            self.music.ignored["change of instrument within a part"] += sound.find("midi-instrument") is not None
            self.music.ignored["pizzicato"] += sound.get("pizzicato") is not None
            mute = text_of(sound, "play/mute")
            self.palm = mute == "palm" if mute else self.palm
            if (feel := sound.find("swing")) is not None:
                self._feel(feel)
        if bpm is not None:
            self.music.tempo(measure, now, bpm)
        index, dynamics = len(self.part.measures), sound is not None and "dynamics" in sound.attrib
        for kind in element.findall("direction-type/*"):
            if sign := jump_sign(kind):
                self.written.append((measure, sign))
            if kind.tag == "dynamics":
                dynamics = dynamics or self._level(kind)
            elif kind.tag == "wedge":
                self.wedges.append((index, now, kind.get("type", "")))
            elif kind.tag in ("harp-pedals", "scordatura"):
                self.music.ignored[kind.tag] += 1
        if dynamics or self.velocity != before:
            self.levels.append((index, now, self.velocity))
        self._pedals(element, sound, index, now)

    def _level(self, element: Element) -> bool:
        """Take the loudness of written dynamics; returns whether they are a level. Others, as sfz, are counted."""
        level = next((e.tag for e in element if e.tag in DYNAMICS), None)
        if level is None:
            self._count(Counter(e.tag for e in element))
            return False
        self.velocity = DYNAMICS[level]
        return True

    def _count(self, names: Counter[str]) -> None:
        """Count signs that are not followed by their names, as far as these are not too many."""
        for name, n in names.items():
            short = name[:_LONGEST_SIGN]
            if short not in self.music.ignored and len(self.music.ignored) >= _MOST_UNKNOWN:
                short = "other signs that are not known"
            self.music.ignored[short] += n

    def _feel(self, element: Element) -> None:
        """How long the first of two notes is, from here on."""
        unit = Fraction(1, 4) if text_of(element, "swing-type") == "16th" else Fraction(1, 2)
        first, second = (whole(text_of(element, name), 1, 99) for name in ("first", "second"))
        self.feel = (unit, Fraction(first, first + second)) if first and second else None
        self.music.ignored["swing that cannot be read"] += self.feel is None and element.find("straight") is None

    def _pedals(self, element: Element, sound: Element | None, index: int, now: Fraction) -> None:
        """Enter moves of the pedals: signs, or what their sound says, which may be between up and down."""
        moves = self.part.pedals
        sounded = False
        names = {"damper-pedal": "cc64", "sostenuto-pedal": "cc66", "soft-pedal": "cc67"}
        for name, kind in names.items() if sound is not None else ():
            text = (sound.get(name, "") if sound is not None else "").strip()
            share = {"yes": 100.0, "no": 0.0}.get(text, number(text, 0.0, 100.0))
            if share is not None:
                moves.append((index, now, 0.0, kind, share / 100.0))
                sounded = True
            self.music.ignored[f"{name} that cannot be read"] += bool(text) and share is None
        for sign in element.findall("direction-type/pedal") if not sounded else ():
            how = sign.get("type", "")
            if how in ("stop", "discontinue", "change"):
                moves.append((index, now, 0.0, "cc64", 0.0))
                if how == "stop":
                    moves.append((index, now, 0.0, "cc66", 0.0))
            if how in ("start", "resume", "change"):
                moves.append((index, now, _PEDAL_UP if how == "change" else 0.0, "cc64", 1.0))
            elif how == "sostenuto":
                moves.append((index, now, 0.0, "cc66", 1.0))

    def hairpins(self, starts: list[Fraction]) -> None:
        """Let notes grow and fade between dynamics; after a hairpin without any that follow they keep its end.

        The first dynamics within a hairpin end it.

        starts : quarter notes at which measures begin.
        """
        levels = sorted(((starts[i] + at, velocity) for i, at, velocity in self.levels), key=itemgetter(0))
        times = [time for time, _ in levels]
        ramps: list[tuple[Fraction, Fraction, Fraction, int, int]] = []  # begin, end, until, velocities
        begun: tuple[Fraction, bool] | None = None
        for i, at, kind in self.wedges:
            if kind in ("crescendo", "diminuendo"):
                begun = starts[i] + at, kind == "crescendo"
            elif kind == "stop" and begun is not None:
                (begin, up), end = begun, starts[i] + at
                n = bisect_right(times, begin)
                before = levels[n - 1][1] if n else 80
                if ramps and ramps[-1][1] > (times[n - 1] if n else 0):
                    before = ramps[-1][4]
                until = times[n] if n < len(levels) else starts[-1] + 1
                after = levels[n][1] if n < len(levels) and until <= end + _HAIRPIN_ENDS else before
                if after == before or (after > before) != up:
                    after = min(max(before + (_HAIRPIN if up else -_HAIRPIN), 1), 127)
                ramps.append((begin, min(max(end, begin), until), until, before, after))
                begun = None
        self.music.ignored["hairpin without an end"] += begun is not None
        begins = [ramp[0] for ramp in ramps]
        for i, signs in enumerate(self.part.measures if ramps else ()):
            for k, sign in enumerate(signs):
                time = starts[i] + sign.at
                n = bisect_right(begins, time)
                if n and time < ramps[n - 1][2]:
                    begin, end, _, low, high = ramps[n - 1]
                    share = float((time - begin) / (end - begin)) if time < end else 1.0
                    signs[k] = replace(sign, velocity=round(low + (high - low) * share))

    def _barline(self, element: Element, measure: Measure) -> None:
        repeat, ending = element.find("repeat"), element.find("ending")
        self.music.ignored["fermata of a barline"] += element.find("fermata") is not None
        self.music.ignored["repeat that is played after a jump, too"] += (
            repeat is not None and repeat.get("after-jump") == "yes"
        )
        if ending is not None and ending.get("type") == "start":
            words = ending.get("number", "1").replace(",", " ").split()
            passes = [passes_of(word) for word in words[:_MOST_NUMBERS]]
            lost = not all(passes) or len(passes) < len(words)
            self.music.ignored["number of an ending that cannot be read"] += lost
            self.ending = frozenset[int]().union(*passes) or frozenset({1})
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
        written = element.find("pitch")
        pitch = pitch_of(written, "step", "alter", "octave")
        if pitch is None:
            self.music.ignored["unpitched note" if written is None else "note whose pitch cannot be read"] += 1
            self.part.n_drums += written is None
            return None
        self.music.ignored["note of some passes only, played in all"] += element.get("time-only") is not None
        self.music.ignored["attack or release of a note"] += "attack" in element.attrib or "release" in element.attrib
        self.music.ignored["octave that is not whole"] += number_of(written, "octave", 4.0) % 1 > 0
        self.music.ignored["pitch without an octave"] += written is not None and written.find("octave") is None
        self.music.signs.take()
        signs, ignored = signs_of(element)
        self._count(ignored)
        for dynamics in element.findall("notations/dynamics"):
            if self._level(dynamics):
                self.levels.append((len(self.part.measures), at, self.velocity))
        if self.palm:
            signs.add("palm_mute")
        if text_of(element, "notehead") == "x":
            signs.add("dead")
        drawn = [e.get("type") for e in element.findall("notations/tied")]
        ties = [e.get("type") for e in element.findall("tie")] or drawn  # some programs write only the drawn tie
        if "let-ring" in drawn:
            signs.add("let_ring")
        technical = element.find("notations/technical")
        moved = self.transpose.get(text_of(element, "staff", "1"), self.transpose.get("", 0.0))
        share = number(element.get("dynamics", ""), 0, MOST)
        note = WrittenNote(
            at, length, pitch + moved, velocity=self.velocity if share is None else velocity_of(share),
            signs=tuple(sorted(signs)),
            tied="stop" in ties, bend=bend_of(technical),
            strum=strum_of(element.find("notations/arpeggiate"), place), steps=neighbours(element, self.fifths),
        )  # fmt: skip
        ornaments = element.find("notations/ornaments")
        if ornaments is not None and ornaments.find("trill-mark") is not None:
            up = neighbours(element, self.fifths)[1]
            note = replace(note, trill=note.pitch + up, signs=tuple(s for s in note.signs if s != "vibrato"))
        free = ornaments is not None and ornaments.find("tremolo[@type='unmeasured']") is not None
        strokes = 3.0 if free else number_of(ornaments, "tremolo", 0.0)
        alternates = ornaments is not None and ornaments.find("tremolo[@type='start']") is not None
        self.music.ignored["tremolo between two notes, each repeated"] += alternates
        if 0 < strokes <= 5:
            note = replace(note, tremolo=Fraction(1, 2 ** int(strokes)))
        self.music.ignored["tremolo outside 0 to 5 strokes"] += not 0 <= strokes <= 5
        return self._placed(note, technical, kind_of_pitch(element))

    def _placed(self, note: WrittenNote, technical: Element | None, kind: str) -> WrittenNote:
        """The note with its string and fret, if its pitch is there."""
        string, fret = number_of(technical, "string", -1.0), number_of(technical, "fret", -1.0)
        if string < 1 or fret < 0:
            return sounding(note, False, None) if kind == "sounding-pitch" else note
        if kind == "sounding-pitch":
            base = self.tuning.get(int(string))
            natural = technical is not None and technical.find("harmonic/artificial") is None
            if base is not None:
                base += self.part.capo + (0.0 if natural else fret)
            return sounding(replace(note, string=int(string), fret=int(fret)), natural, base)
        if self.tuning and "harmonic" not in note.signs:
            # the fret counts from the capo, or from the nut
            left = note.pitch - self.tuning.get(int(string), -1e3)
            frets = [left - self.part.capo] if left in (fret, fret + self.part.capo) else []
            if not frets:
                self.music.ignored["string and fret that have another pitch than the note"] += 1
                return replace(note, string=int(string))
            fret = frets[0]
        return replace(note, string=int(string), fret=int(fret))
