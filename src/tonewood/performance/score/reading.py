"""Reads a score of any format that is known: MIDI, MusicXML, Guitar Pro."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tonewood.errors import ScoreError
from tonewood.performance.score.channel_reader import DRUM
from tonewood.performance.score.file_bytes import file_bytes
from tonewood.performance.score.midi import read_midi
from tonewood.performance.score.note import Control, Note, Score
from tonewood.performance.score.xml_files import MAX_BYTES, member, members

if TYPE_CHECKING:
    from tonewood.performance.score.written import WrittenMusic

#: the score in an archive of Guitar Pro 7 or 8
GPIF = "Content/score.gpif"
FORMATS = ".mid, .musicxml, .mxl, .gp3, .gp4, .gp5, .gpx, .gp"

#: suffix -> name of the format, and how its files begin
_BEGINNINGS = {
    **dict.fromkeys((".musicxml", ".xml"), ("MusicXML", "'<'")),
    **dict.fromkeys((".mxl", ".gp"), ("an archive of a score", "'PK'")),
    **dict.fromkeys((".gp3", ".gp4", ".gp5"), ("Guitar Pro", "its name and version")),
    ".gpx": ("Guitar Pro", "'BCFZ' or 'BCFS'"),
}


def read_score(
    path: str | os.PathLike[str],
    *,
    start: float = 0.0,
    stop: float | None = None,
    tracks: Sequence[int] | None = None,
    transpose: float = 0.0,
    tempo: float = 1.0,
) -> Score:
    """Read a score: a MIDI file, MusicXML or MXL, Guitar Pro 3 to 8; its bytes decide, not its name.

    Parameters
    ----------
    path : the file.
    start, stop : s, the excerpt to read, as for `read_midi`; counted at the score's own tempo.
    tracks : parts to read, from 1; of a MIDI file channels. All where left out, but channel 10, percussion.
    transpose : semitones added to every note; a fret moves with it.
    tempo : factor on the speed.

    Raises
    ------
    ScoreError : the file cannot be read, or a setting is out of range; one line.
    """
    path = Path(path)
    if not 0.0 <= start < (math.inf if stop is None else stop):
        raise ScoreError(f"excerpt from {start} s to {stop} s: 0 <= start < stop is needed", file=path)
    if not 0.05 <= tempo <= 20.0:
        raise ScoreError(f"a tempo of {tempo!r} times the score's: 0.05 to 20 are allowed", file=path)
    if not -48.0 <= transpose <= 48.0:
        raise ScoreError(f"transposed by {transpose!r} semitones: -48 to 48 are allowed", file=path)
    music = read_written(path)
    if music is None:
        score = read_midi(path, start=start, stop=stop, percussion=tracks is not None and 10 in tracks)
        score = score if tracks is None else _channels(score, tracks)
    else:
        from tonewood.performance.score.written import performed

        score = performed(music, tracks)
        score = score if not start and stop is None else _excerpt(score, start, stop)
        score = replace(score, beats=None) if start else score
    return score if transpose == 0.0 and tempo == 1.0 else _moved(score, transpose, tempo)


def read_written(path: Path) -> WrittenMusic | None:
    """Read a file of written music; None for anything else, which may be a MIDI file."""
    data = file_bytes(path, MAX_BYTES)
    if data[:4] == b"MThd":
        return None
    # most scores are MIDI files: readers of the others are imported when they are needed
    from tonewood.performance.score.gpif import read_gpif
    from tonewood.performance.score.gpx import gpx_score
    from tonewood.performance.score.guitar_pro import read_guitar_pro
    from tonewood.performance.score.musicxml import read_musicxml

    if data[:2] == b"PK":
        if GPIF in members(data, path):
            return read_gpif(member(data, GPIF, path), path)
        return read_musicxml(data, path)
    if data[:4] in (b"BCFZ", b"BCFS"):
        return read_gpif((gpx_score(data, path),), path)
    if data[1:20].startswith(b"FICHIER GUITAR PRO"):
        return read_guitar_pro(data, path)
    head = data[:512].lstrip(b"\xef\xbb\xbf \t\r\n")
    if head[:1] == b"<" or head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return read_musicxml(data, path)
    if path.suffix.lower() == ".abc" or head[:2] == b"X:":
        reason = "ABC is not read; converted it is: by abc2midi (abcmidi) to .mid, or by abc2xml to .musicxml"
        raise ScoreError(reason, file=path)
    if path.suffix.lower() in (".mscz", ".mscx", ".ptb", ".tg", ".ly", ".sib"):
        raise ScoreError(f"{path.suffix} is not read; {FORMATS} are", file=path)
    if path.suffix.lower() in _BEGINNINGS:
        kind, beginning = _BEGINNINGS[path.suffix.lower()]
        raise ScoreError(f"is not {kind}: it {f'does not begin with {beginning}' if head else 'is empty'}", file=path)
    return None


def _channels(score: Score, tracks: Sequence[int]) -> Score:
    """Notes and controls of some channels, counted from 1; with the master of a zone of MPE those of the zone."""
    there = sorted({(n.channel or 0) + 1 for n in score.notes} | {p.number for p in score.parts if p.programs})
    for track in tracks:
        if track not in there:
            raise ScoreError(f"there is no channel {track}; there are {', '.join(map(str, there))}", file=score.place)
    zones = [at for part in score.parts if part.number in tracks for at in part.channels]
    indices = {track - 1 for track in (*tracks, *zones)}
    notes = [n for n in score.notes if (n.channel or 0) in indices]
    controls = [c for c in score.controls if (c.channel or 0) in indices]
    parts = [part for part in score.parts if part.number in tracks]
    warnings = [text for text in score.warnings if not text.startswith(DRUM)]
    return replace(score, notes=notes, controls=controls, parts=parts, warnings=warnings)


def _excerpt(score: Score, start: float, stop: float | None) -> Score:
    """Notes that begin in an excerpt, ended at its end, with times counted from its beginning."""
    until = math.inf if stop is None else stop
    notes = [
        replace(
            n,
            time=n.time - start,
            duration=min(n.duration, until - n.time),
            held=None if n.held is None else min(n.held, until - n.time),
        )
        for n in score.notes
        if start <= n.time < until
    ]
    before = {(c.kind, c.channel): replace(c, time=0.0) for c in score.controls if c.time < start}
    within = [replace(c, time=c.time - start) for c in score.controls if start <= c.time < until]
    return replace(score, notes=notes, controls=[*before.values(), *within])


def _moved(score: Score, semitones: float, tempo: float) -> Score:
    """The score transposed, and played faster by a factor."""

    def note(n: Note) -> Note:
        pitch = None if n.note is None else n.note + semitones
        stop = n.stop if n.stop is None or pitch is None else n.stop + semitones
        marks = n.marks
        if stop is not None and (stop < 0 or stop != int(stop)):
            stop = None
        return replace(
            n,
            time=n.time / tempo,
            duration=max(n.duration / tempo, 1e-3),
            glides=tuple((time / tempo, steps) for time, steps in n.glides),
            note=pitch,
            stop=stop,
            marks=marks,
            held=None if n.held is None else max(n.held / tempo, 1e-3),
        )

    def control(c: Control) -> Control:
        return replace(c, time=c.time / tempo)

    beats = score.beats and replace(score.beats, tempos=[(t / tempo, q, b * tempo) for t, q, b in score.beats.tempos])
    notes, controls = [note(n) for n in score.notes], [control(c) for c in score.controls]
    return replace(score, notes=notes, controls=controls, beats=beats)
