"""Recordings of single notes: a folder of files whose names or whose table tell the note, string, dynamic and place.

A name holds the note as a MIDI number alone (``57.wav``) or as a note name between other words (``A3.flac``,
``guitar_Fs4_loud.wav``), and, if the player varied it, a dynamic: pp, p, mp, mf, f, ff, soft, piano, loud, forte or
v1 to v127. A table (CSV) has the columns file, and as needed note, string, stop, dynamic and place (m from the bridge).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import gcd
from pathlib import Path

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.scales import note_name
from tonewood.support.arrays import Floats
from tonewood.support.sound_rates import LOUDEST, check_rate, check_whole
from tonewood.support.units import number_in

#: Hz, rate of the analysis, to which every recording is brought
FS = 44100
#: tables that are read without being named
TABLES = ("notes.csv", "recordings.csv")
SUFFIXES = {".wav", ".flac", ".aif", ".aiff", ".aifc", ".ogg", ".oga", ".mp3", ".w64", ".caf", ".rf64"}
#: dynamic -> MIDI velocity by custom
DYNAMICS = {
    "ppp": 16, "pp": 33, "p": 49, "mp": 64, "mf": 80, "f": 96, "ff": 112, "fff": 127,
    "pianissimo": 33, "soft": 49, "piano": 49, "medium": 72, "forte": 96, "loud": 96, "hard": 96, "fortissimo": 112,
}  # fmt: skip

_COLUMNS = ("file", "note", "string", "stop", "dynamic", "place")
_NOTE = re.compile(r"(?<![A-Za-z])([A-Ga-g])(#|♯|s|b|♭)?(-?\d)(?![0-9])")
_SEMITONES = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
_SIGNS = {"#": 1, "♯": 1, "s": 1, "b": -1, "♭": -1}
#: s, longest part of a file that is read, and shortest that is of use after the onset
_LONGEST, SHORTEST = 60.0, 0.35
#: consecutive samples at the largest value that are taken for clipping: more than a crest at 27 Hz has
_CLIPPED_RUN, _CLIPPED_LEVEL = 4, 1 - 1e-5


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded note.

    file : its name, for messages.
    note : MIDI number.
    string, stop : where it was played; None if nobody says.
    dynamic : MIDI velocity that stands for the player's dynamic; None if nobody says.
    place : m from the bridge; None if nobody says.
    samples : (n,) mono at `FS`.
    freq_upper : Hz, end of the band that the file holds.
    """

    file: str
    note: int
    samples: Floats
    string: str | None = None
    stop: float | None = None
    dynamic: float | None = None
    place: float | None = None
    freq_upper: float = FS / 2

    @property
    def freq(self) -> float:
        """Hz, of the note in equal temperament at 440 Hz."""
        return float(440.0 * 2 ** ((self.note - 69) / 12))


@dataclass(frozen=True, eq=False)
class Folder:
    """The recordings of a folder.

    recordings : by note, then from soft to loud.
    warnings : one line each, of files left out or treated specially.
    """

    recordings: tuple[Recording, ...]
    warnings: tuple[str, ...]

    @property
    def notes(self) -> tuple[int, ...]:
        """MIDI numbers there are, rising."""
        return tuple(sorted({r.note for r in self.recordings}))


def read_folder(folder: Path, *, table: Path | None = None, transpose: int = 0) -> Folder:
    """Read the recordings of a folder.

    folder : of sound files; ``notes.csv`` or ``recordings.csv`` in it is taken for the table.
    table : CSV file, with paths from its own folder.
    transpose : semitones added to the notes of names and table.
    Raises TonewoodError : there is no such folder, no sound file in it, none of use, or a table that cannot be read.
    """
    if not folder.is_dir():
        raise TonewoodError("there is no such folder; a folder of sound files, one a note, is wanted", file=folder)
    table = table or next((folder / name for name in TABLES if (folder / name).is_file()), None)
    warnings: list[str] = []
    rows = _listed(folder, warnings) if table is None else _tabled(table)
    recordings: list[Recording] = []
    for path, row in rows:
        try:
            recording, remarks = _read(path, replace(row, note=row.note + transpose))
        except TonewoodError as fault:
            warnings.append(f"left out: {fault}")
            continue
        recordings.append(recording)
        warnings += remarks
    if not recordings:
        reason = f"no recording is of use: {warnings[0]}" if warnings else f"holds no sound files ({_suffixes()})"
        raise TonewoodError(reason, file=folder)
    recordings.sort(key=lambda r: (r.note, r.dynamic or 0.0, r.file))
    return Folder(tuple(recordings), tuple(warnings))


def note_of_name(stem: str) -> int | None:
    """Return the MIDI number that a file's name tells: a number alone, or the first note name in it; None without."""
    if re.fullmatch(r"\d{1,3}", stem):
        return int(stem)
    match = _NOTE.search(stem)
    if match is None:
        return None
    letter, sign, octave = match.groups()
    return _SEMITONES[letter.upper()] + _SIGNS.get(sign or "", 0) + 12 * (int(octave) + 1)


def dynamic_of(text: str) -> float | None:
    """Return the MIDI velocity of the first dynamic among the words of a text; None without one."""
    words = re.split(r"[\s_\-.,()]+", text.lower())
    for word in sorted(words, key=len):  # `piano` may be the instrument: pp, mf come first
        if word in DYNAMICS:
            return float(DYNAMICS[word])
        if (match := re.fullmatch(r"(?:v|vel|velocity)(\d{1,3})", word)) and 1 <= int(match[1]) <= 127:
            return float(match[1])
    return None


def _listed(folder: Path, warnings: list[str]) -> list[tuple[Path, Recording]]:
    """Sound files of a folder, with what their names tell."""
    rows = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in SUFFIXES or path.name.startswith("."):
            continue
        note = note_of_name(path.stem)
        if note is None:
            warnings.append(f"left out: {path.name}: no note in its name (A3, 57); a table can tell it: {TABLES[0]}")
            continue
        dynamic = None if path.stem.isdigit() else dynamic_of(path.stem)
        rows.append((path, Recording(path.name, note, np.zeros(0), dynamic=dynamic)))
    return rows


def _tabled(table: Path) -> list[tuple[Path, Recording]]:
    """Rows of a table."""
    try:
        text = table.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise TonewoodError(f"cannot be read: {fault}", file=table) from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    rows = list(csv.DictReader(lines, skipinitialspace=True))
    header = [name.strip() for name in (csv.DictReader(lines).fieldnames or [])]
    unknown = [name for name in header if name not in _COLUMNS]
    if "file" not in header or unknown:
        wrong = f"column {unknown[0]!r} is unknown" if unknown else "a column `file` is missing"
        raise TonewoodError(f"{wrong}; the columns {', '.join(_COLUMNS)} are allowed", file=table, line=1)
    out: list[tuple[Path, Recording]] = []
    for i, row in enumerate(rows, 2):
        cells = {(k or "").strip(): (v or "").strip() for k, v in row.items() if isinstance(v, str)}
        if None in row:
            raise TonewoodError(
                f"has more cells than the {len(header)} names above; decimal points, and commas between cells, are "
                "allowed", file=table, line=i,
            )  # fmt: skip
        path, recording = _row(cells, table, i)
        if any(path == other for other, _ in out):
            raise TonewoodError(f"lists {cells['file']!r} a second time; once is allowed", file=table, line=i)
        out.append((path, recording))
    if not out:
        raise TonewoodError("has no rows", file=table)
    return out


def _row(cells: Mapping[str, str], table: Path, line: int) -> tuple[Path, Recording]:
    path = table.parent / cells["file"]
    if not path.is_file():
        raise TonewoodError(f"there is no file {cells['file']!r}", file=table, line=line, key="file")
    string = cells.get("string") or None
    placed = string is not None and bool(cells.get("stop"))
    name = cells.get("note") or ("" if placed else path.stem)
    note = note_of_name(name)
    if note is None and (name or not placed):
        raise TonewoodError(f"is {name!r}; A3 or 57, or string and stop are wanted", file=table, line=line, key="note")
    words = cells.get("dynamic", "")
    dynamic = float(words) if words.isascii() and words.isdigit() else dynamic_of(words)
    if words and (dynamic is None or not 1 <= dynamic <= 127):
        allowed = f"{', '.join(DYNAMICS)} or 1 to 127"
        raise TonewoodError(f"is {words!r}; {allowed} are allowed", file=table, line=line, key="dynamic")
    return path, Recording(
        path.name, -1 if note is None else note, np.zeros(0), string=string, dynamic=dynamic,
        stop=_number(cells, "stop", 0.0, 200.0, table, line), place=_number(cells, "place", 1e-3, 5.0, table, line),
    )  # fmt: skip


def _number(cells: Mapping[str, str], key: str, low: float, high: float, table: Path, line: int) -> float | None:
    if not (text := cells.get(key, "")):
        return None
    value = number_in(text)
    if not low <= value <= high:
        raise TonewoodError(f"is {text!r}; {low:g} to {high:g} is allowed", file=table, line=line, key=key)
    return value


def _read(path: Path, row: Recording) -> tuple[Recording, list[str]]:
    """Samples of a file, mono at `FS`, and remarks.

    Raises TonewoodError : it cannot be read, is silent, not finite, clipped, or shorter than is of use.
    """
    import soundfile as sf

    try:
        check_whole(path)
        with sf.SoundFile(path) as file:
            fs = int(file.samplerate)
            samples = file.read(int(_LONGEST * fs), dtype="float64", always_2d=True)
    except (sf.LibsndfileError, RuntimeError, OSError) as fault:
        raise TonewoodError(f"cannot be read: {str(fault).splitlines()[0]}", file=path.name) from None
    if row.note > 127 or (row.note < 0 and row.stop is None):
        raise TonewoodError(f"is of note {row.note}; 0 to 127 are allowed", file=path.name)
    if not len(samples) or not np.all(np.abs(samples) <= LOUDEST):
        raise TonewoodError("holds no finite samples", file=path.name)
    check_rate(fs, path.name)
    x, remarks = _mono(samples, path.name)
    peak = float(np.abs(x).max())
    if peak < 1e-5:
        raise TonewoodError("is silent", file=path.name)
    if n := clipped(x):
        raise TonewoodError(f"is clipped: {n} samples in a row, at least, lie at its largest value", file=path.name)
    upper = fs / 2
    if fs != FS:
        from scipy.signal import resample_poly

        common = gcd(FS, fs)
        x = resample_poly(x, FS // common, fs // common)
    if not len(x) > SHORTEST * FS:
        raise TonewoodError(f"lasts {len(x) / FS:.2f} s; {SHORTEST:g} s or more are wanted", file=path.name)
    x = x - x.mean()
    return replace(row, samples=np.asarray(x, dtype=np.float64), freq_upper=min(upper, FS / 2)), remarks


def _mono(samples: Floats, name: str) -> tuple[Floats, list[str]]:
    """Mean of the channels; the strongest one where they cancel each other."""
    if samples.shape[1] == 1:
        return samples[:, 0], []
    power = np.mean(samples**2, axis=0)
    mean = samples.mean(axis=1)
    if np.mean(mean**2) < 0.1 * power.max() and np.count_nonzero(power > 0.1 * power.max()) > 1:
        best = int(np.argmax(power))
        return samples[:, best], [f"{name}: its channels cancel each other; channel {best + 1} is taken alone"]
    return mean, []


def clipped(x: Floats) -> int:
    """Return the longest run of samples at the largest or smallest value, if it is that of clipping; 0 otherwise."""
    most = 0
    for sign in (1.0, -1.0):
        top = float((sign * x).max())
        if top <= 0:
            continue
        flat = np.concatenate([[False], sign * x >= _CLIPPED_LEVEL * top, [False]])
        edges = np.flatnonzero(np.diff(flat.astype(np.int8)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= _CLIPPED_RUN:
                most = max(most, int(stop - start))
    return most


def named(notes: Iterable[int]) -> str:
    """Names of notes, with blanks between them."""
    return " ".join(note_name(note) for note in notes)


def _suffixes() -> str:
    return ", ".join(sorted(SUFFIXES))
