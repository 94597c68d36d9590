"""Pitch: note names, scales (Scala .scl), keyboard mappings (.kbm), and a tuning that turns notes into frequencies.

A key is a MIDI note number, a degree a step of the scale (degree 0 is 1/1), and the formal octave the interval after
which the scale repeats (its last pitch, whatever its size).

Formats: M. Op de Coul, Scala scale file format and keyboard mappings, huygens-fokker.org/scala.
"""

from __future__ import annotations

import math
import os
import re
from codecs import BOM_UTF8
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tonewood.errors import ScoreError
from tonewood.support.text_files import decoded, other_encoding

A4_KEY = 69
A4_FREQ = 440.0
# No instrument needs more than ten octaves between neighbours; it also keeps every frequency a finite number.
MAX_CENTS = 12_000.0
MAX_OCTAVES = 100
MAX_DEGREES = 10_000
MAX_FILE_BYTES = 2**20

_LETTERS = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
_ACCIDENTALS = {"#": 1, "♯": 1, "b": -1, "♭": -1}
_SHARPS = ("C", "C#", "D", "D#", "E", "F", "F#", "G", "G#", "A", "A#", "B")
_FLATS = ("C", "Db", "D", "Eb", "E", "F", "Gb", "G", "Ab", "A", "Bb", "B")
_NAME = re.compile(r"([A-Ga-g])((?:#|♯){0,2}|(?:b|♭){0,2})(-?[0-9]{1,2})")
_CENTS = re.compile(r"[+-]?([0-9]+\.[0-9]*|\.[0-9]+)")
_RATIO = re.compile(r"([0-9]{1,400})(?:/([0-9]{1,400}))?")


def note_number(name: str) -> int:
    """MIDI number of a note name: ``C4`` is 60, ``F#3`` 54, ``Bb2`` 46, ``C-1`` 0.

    Raises ScoreError : not a note name.
    """
    match = _NAME.fullmatch(name.strip())
    if match is None:
        raise ScoreError(f"{name!r} is not a note: letter A to G, # or b, octave are needed, as in F#3 (C4 is 60)")
    letter, accidentals, octave = match.groups()
    return 12 * (int(octave) + 1) + _LETTERS[letter.upper()] + sum(_ACCIDENTALS[a] for a in accidentals)


def note_name(number: float, *, flats: bool = False) -> str:
    """Name of the nearest MIDI note, with the cents beyond it if there are any: ``A4``, ``C4+25``."""
    key = math.floor(number + 0.5)
    cents = round(100 * (number - key))
    return f"{(_FLATS if flats else _SHARPS)[key % 12]}{key // 12 - 1}" + (f"{cents:+d}" if cents else "")


@dataclass(frozen=True)
class Scale:
    """Pitches of one period in cents above degree 0, which is not listed; the last is the formal octave."""

    name: str
    cents: tuple[float, ...]

    def cents_at(self, degree: int) -> float:
        """Cents of any degree above degree 0, through as many formal octaves as it takes."""
        periods, step = divmod(degree, len(self.cents))
        return periods * self.cents[-1] + (self.cents[step - 1] if step else 0.0)


EQUAL_12 = Scale("equal_12", tuple(100.0 * i for i in range(1, 13)))


@dataclass(frozen=True)
class KeyMap:
    """Which degree each key plays.

    degrees : degree of each key of the pattern, None where a key plays nothing; empty: key k plays k − middle.
    size : keys in the pattern; beyond the end of `degrees` they play nothing.
    middle : key on which the pattern starts.
    octave_degree : degree between two patterns; 0 is the scale's formal octave.
    first, last : keys that are tuned; those outside keep equal temperament with A4 at 440 Hz.
    reference_key, reference_freq : the key whose frequency (Hz) is given.
    """

    degrees: tuple[int | None, ...] = ()
    size: int = 0
    middle: int = 60
    octave_degree: int = 0
    first: int = -128
    last: int = 256
    reference_key: int = A4_KEY
    reference_freq: float = A4_FREQ

    def cents(self, key: int, scale: Scale) -> float | None:
        """Cents of a key above degree 0 of the middle key's pattern; None if the key plays nothing."""
        if self.size == 0:
            return scale.cents_at(key - self.middle)
        patterns, index = divmod(key - self.middle, self.size)
        degree = self.degrees[index] if index < len(self.degrees) else None
        if degree is None:
            return None
        return patterns * scale.cents_at(self.octave_degree or len(scale.cents)) + scale.cents_at(degree)


@dataclass(frozen=True)
class Tuning:
    """Frequencies of notes: a scale on keys, with the reference key at `reference_freq` Hz (A4 at 440).

    Raises ScoreError : the reference frequency is not positive, or the reference key plays nothing.
    """

    scale: Scale = EQUAL_12
    key_map: KeyMap = KeyMap()
    reference_freq: float = A4_FREQ

    def __post_init__(self) -> None:
        if not 1.0 <= self.reference_freq <= 20_000.0:
            raise ScoreError(f"reference frequency {self.reference_freq} Hz: 1 to 20000 Hz are allowed")
        if self.key_map.cents(self.key_map.reference_key, self.scale) is None:
            raise ScoreError(f"reference key {self.key_map.reference_key} plays no degree of the scale")

    def freq(self, note: float) -> float:
        """Frequency in Hz; a fractional note lies between its neighbouring keys in proportion of cents.

        Raises ScoreError : a key needed plays nothing in this tuning, or lies beyond `MAX_OCTAVES`.
        """
        octaves = self._cents(note) / 1200
        if abs(octaves) > MAX_OCTAVES:
            raise ScoreError(
                f"note {note:g} lies {octaves:g} octaves from the reference frequency; {MAX_OCTAVES} are allowed"
            )
        return self.reference_freq * math.exp2(octaves)

    def cents_between(self, low: float, high: float) -> float:
        """Interval from one note to another in cents."""
        return self._cents(high) - self._cents(low)

    def note(self, freq: float) -> float:
        """The note, whole or fractional, that sounds at `freq` Hz: `freq(note(f))` is f.

        Beyond the keys from −128 to 256, and in gaps of unmapped keys, the nearest key counts, 100 cents to a note.
        """
        if not (0 < freq < math.inf):
            raise ScoreError(f"frequency {freq} Hz: it must be positive")
        sought = 1200 * math.log2(freq / self.reference_freq)
        guess = self.key_map.reference_key + sought / 100
        between: list[float] = []
        nearest = (math.inf, 0.0)
        below: float | None = None
        for key in range(-128, 257):
            here = self._key_cents(key)
            if here is not None:
                nearest = min(nearest, (abs(sought - here), key + (sought - here) / 100))
                if below is not None and below <= sought <= here and below < here:
                    between.append(key - 1 + (sought - below) / (here - below))
            below = here
        return min(between, key=lambda n: abs(n - guess), default=nearest[1])

    def _cents(self, note: float) -> float:
        low = math.floor(note)
        cents = self._mapped(low)
        if note == low:
            return cents
        return cents + (note - low) * (self._mapped(low + 1) - cents)

    def _mapped(self, key: int) -> float:
        cents = self._key_cents(key)
        if cents is None:
            raise ScoreError(f"key {key} ({note_name(key)}) plays nothing in the tuning {self.scale.name!r}")
        return cents

    def _key_cents(self, key: int) -> float | None:
        """Cents above the reference frequency, None if the key plays nothing."""
        if not self.key_map.first <= key <= self.key_map.last:
            return 100.0 * (key - A4_KEY) + 1200 * math.log2(A4_FREQ / self.reference_freq)
        cents = self.key_map.cents(key, self.scale)
        reference = self.key_map.cents(self.key_map.reference_key, self.scale)
        return None if cents is None or reference is None else cents - reference


def read_tuning(
    scl: str | os.PathLike[str] | None = None,
    kbm: str | os.PathLike[str] | None = None,
    *,
    reference_freq: float | None = None,
) -> Tuning:
    """Tuning from Scala files.

    scl : scale file; None is twelve equal steps.
    kbm : keyboard mapping; None puts degree 0 on key 60, one degree per key, and the reference on A4 (key 69).
    reference_freq : Hz of the reference key; None takes the mapping's, or 440.
    """
    scale = EQUAL_12 if scl is None else read_scl(scl)
    key_map = KeyMap() if kbm is None else read_kbm(kbm)
    try:
        return Tuning(scale, key_map, key_map.reference_freq if reference_freq is None else reference_freq)
    except ScoreError as error:
        raise ScoreError(error.reason, file=scl if kbm is None else kbm) from None


def read_scl(path: str | os.PathLike[str]) -> Scale:
    """Read a Scala scale file: ratios or cents, one pitch per line.

    Raises ScoreError : names the file, the line and the value that is wrong.
    """
    lines = _lines(path)
    _, name = next(lines, (0, ""))
    number, text = next(lines, (0, ""))
    count = _integer(text, 1, MAX_DEGREES, "number of notes", number, path)
    cents = tuple(_pitch(text, number, path) for number, text in lines if text)
    if len(cents) != count:
        raise ScoreError(f"{len(cents)} pitches where line {number} announces {count}", file=path)
    if cents[-1] <= 0:
        raise ScoreError(f"the formal octave (last pitch) is {cents[-1]:g} cents: it must rise", file=path)
    return Scale(name or Path(path).stem, cents)


def read_kbm(path: str | os.PathLike[str]) -> KeyMap:
    """Read a Scala keyboard mapping. Raises ScoreError : names the file, the line and the value that is wrong."""
    lines = ((number, text) for number, text in _lines(path) if text)

    def integer(what: str, high: int) -> int:
        number, text = next(lines, (0, ""))
        return _integer(text, 0, high, what, number, path)

    size = integer("size of the map", MAX_DEGREES)
    first, last, middle, reference_key = (
        integer(what, 127) for what in ("first key", "last key", "middle key", "reference key")
    )
    number, text = next(lines, (0, ""))
    freq = _number(text)
    if not 1.0 <= freq <= 20_000.0:
        raise ScoreError(f"{_at(number)}reference frequency {text!r}: 1 to 20000 Hz are allowed", file=path)
    octave_degree = integer("formal octave", MAX_DEGREES)
    degrees = tuple(
        None if text.split()[0] in ("x", "X") else _integer(text, 0, MAX_DEGREES, "degree (or x)", number, path)
        for number, text in lines
    )
    if size and len(degrees) > size:
        raise ScoreError(f"{len(degrees)} keys are mapped where the size of the map is {size}", file=path)
    if first > last:
        raise ScoreError(f"first key {first} lies above last key {last}", file=path)
    return KeyMap(degrees if size else (), size, middle, octave_degree, first, last, reference_key, freq)


def _lines(path: str | os.PathLike[str]) -> Iterator[tuple[int, str]]:
    """Numbered lines without comments (those that begin with an exclamation mark)."""
    try:
        if not Path(path).is_file():
            raise ScoreError("no such file", file=path)
        with open(path, "rb") as file:
            raw = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ScoreError(error.strerror or str(error), file=path) from None
    if len(raw) > MAX_FILE_BYTES:
        raise ScoreError(f"larger than {MAX_FILE_BYTES} bytes, which no scale needs", file=path)
    if reason := other_encoding(raw):
        raise ScoreError(reason, file=path)
    try:
        text = decoded(raw, file=path, error=ScoreError) if raw.startswith(BOM_UTF8) else raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return ((i, line.strip()) for i, line in enumerate(lines, 1) if not line.startswith("!"))


def _pitch(text: str, number: int, path: str | os.PathLike[str]) -> float:
    """Cents of a pitch line: a value with a point is cents, any other a ratio; the rest of the line is a remark."""
    word = text.split()[0]
    cents = math.nan
    if _CENTS.fullmatch(word):
        cents = float(word)
    elif match := _RATIO.fullmatch(word):
        over, under = int(match[1]), int(match[2] or 1)
        if over and under:
            cents = 1200 * (math.log2(over) - math.log2(under))
    if math.isnan(cents):
        raise ScoreError(f"{_at(number)}{word!r} is not a pitch: a ratio (3/2) or cents (701.955)", file=path)
    if abs(cents) > MAX_CENTS:
        raise ScoreError(f"{_at(number)}{word!r}: pitches within {MAX_CENTS:.0f} cents are allowed", file=path)
    return cents


def _integer(text: str, low: int, high: int, what: str, number: int, path: str | os.PathLike[str]) -> int:
    word = text.split()[0] if text else ""
    if not re.fullmatch(r"[0-9]{1,9}", word) or not low <= int(word) <= high:
        raise ScoreError(f"{_at(number)}{what} is {word!r}: a whole number from {low} to {high} is needed", file=path)
    return int(word)


def _number(text: str) -> float:
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        return math.nan


def _at(number: int) -> str:
    return f"line {number}: " if number else "the file ends too early: "
