"""Standard MIDI Files byte by byte: chunks, tracks, events, and a list of their errors.

The reader is this project's own, not mido's: a damaged file must still give its readable part. mido gives up
the whole file at the first fault, with whichever exception the fault happens to raise, and takes SMPTE division for
a number of ticks per beat. Here a track that cannot be parsed is kept up to that byte, and the next chunk is searched
for; only a file without header or tracks is refused. Every byte is read a bounded number of times.

Format: The Complete MIDI 1.0 Detailed Specification, "Standard MIDI Files 1.0" (RP-001), MIDI Manufacturers
Association 1996.
"""

from __future__ import annotations

import codecs
from dataclasses import dataclass, field
from fractions import Fraction

from tonewood.errors import ScoreError
from tonewood.support.text_files import one_line

MAX_TRACKS = 2000
MAX_MESSAGES = 1_000_000
_DATA_BYTES = {0x80: 2, 0x90: 2, 0xA0: 2, 0xB0: 2, 0xC0: 1, 0xD0: 1, 0xE0: 2}
_SYSTEM_DATA_BYTES = {0xF1: 1, 0xF2: 2, 0xF3: 1}
#: bytes that are kept of a text
_LONGEST_TEXT = 200
_TEXTS = {0x02: "copyright", 0x03: "title"}


class Findings:
    """Oddities met while reading, one line per kind: the first in full, the rest as a count."""

    def __init__(self) -> None:
        self._first: dict[str, str] = {}
        self._count: dict[str, int] = {}

    def add(self, kind: str, where: str = "") -> None:
        """Note one oddity of this kind."""
        self._first.setdefault(kind, where)
        self._count[kind] = self._count.get(kind, 0) + 1

    def lines(self) -> tuple[str, ...]:
        """One line per kind, in the order in which the kinds first occurred."""
        return tuple(
            kind + (f": {where}" if where else "") + (f" (and {n} more)" if (n := self._count[kind] - 1) else "")
            for kind, where in self._first.items()
        )


@dataclass
class Track:
    """One MTrk chunk: messages (tick, status, data 1, data 2), tempos (tick, µs per quarter), texts,
    and meters (tick, upper and lower number).

    System exclusive messages stand among the others without their data.
    """

    messages: list[tuple[int, int, int, int]] = field(default_factory=list)
    tempos: list[tuple[int, int]] = field(default_factory=list)
    meters: list[tuple[int, int, int]] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)
    end: int = 0


@dataclass(frozen=True)
class MidiFile:
    """Tracks and time base: `ticks_per_quarter`, or `tick_s` where SMPTE division fixes the tick in seconds."""

    format: int
    tracks: list[Track]
    ticks_per_quarter: int
    tick_s: Fraction | None


class _BrokenTrackError(Exception):
    """The track cannot be followed beyond this byte."""

    def __init__(self, reason: str, pos: int):
        super().__init__(reason)
        self.pos = pos


def parse_smf(data: bytes, findings: Findings, *, file: str | None = None) -> MidiFile:
    """Read the bytes of a .mid or .rmi file.

    data : the whole file.
    findings : takes one entry per oddity that could be read over.
    file : name for error messages.
    Raises ScoreError : no MIDI header, no track, an unusable time division, or more events than `MAX_MESSAGES`.
    """
    data = _unwrap_riff(data, file)
    if data[:4] != b"MThd":
        what = f"it begins with {data[:4]!r}, not b'MThd'" if data else "it is empty"
        raise ScoreError(f"not a Standard MIDI File: {what}", file=file)
    header_length = int.from_bytes(data[4:8], "big")
    if len(data) < 14 or header_length < 6:
        raise ScoreError("the MIDI header is broken off: 6 bytes are needed after its length", file=file)
    file_format, declared, division = (int.from_bytes(data[i : i + 2], "big") for i in (8, 10, 12))
    if file_format > 2:
        findings.add(f"format {file_format} is unknown (0, 1 and 2 exist): read as format 1")
        file_format = 1
    ticks_per_quarter, tick_s = _time_base(division, file)

    pos = 8 + header_length
    if not _chunk_follows(data, pos):
        findings.add(f"the header's length {header_length} is wrong")
        pos = 14
    tracks = _read_tracks(data, pos, findings, file)
    if not tracks:
        raise ScoreError("no track (MTrk chunk) in the file", file=file)
    if len(tracks) != declared:
        findings.add(f"the header announces {declared} track(s), the file holds {len(tracks)}")
    if file_format == 0 and len(tracks) > 1:
        findings.add("format 0 with more than one track: read as format 1")
        file_format = 1
    return MidiFile(file_format, tracks, ticks_per_quarter, tick_s)


def _unwrap_riff(data: bytes, file: str | None) -> bytes:
    """The `data` chunk of a RIFF RMID file; anything else as it is."""
    if data[:4] != b"RIFF":
        return data
    if data[8:12] == b"RMID":
        pos = 12
        while pos + 8 <= len(data):
            length = int.from_bytes(data[pos + 4 : pos + 8], "little")
            if data[pos : pos + 4] == b"data":
                return data[pos + 8 : pos + 8 + length]
            pos += 8 + length + length % 2
    raise ScoreError("a RIFF file without MIDI in it (RMID form with a data chunk is needed)", file=file)


def _time_base(division: int, file: str | None) -> tuple[int, Fraction | None]:
    """Ticks per quarter, or seconds per tick for SMPTE division (high byte −frames/s, low byte ticks/frame)."""
    if not division & 0x8000:
        if division == 0:
            raise ScoreError("time division 0: 1 to 32767 ticks per quarter note are allowed", file=file)
        return division, None
    frames, ticks = 256 - (division >> 8), division & 0xFF
    if frames not in (24, 25, 29, 30) or ticks == 0:
        raise ScoreError(
            f"SMPTE time division of {frames} frames/s and {ticks} ticks per frame: 24, 25, 29 or 30 frames/s and "
            "1 to 255 ticks are allowed",
            file=file,
        )
    # 29 stands for "30 drop frame": frame numbers are dropped, the frames run at 30000/1001 per second
    rate = Fraction(30000, 1001) if frames == 29 else Fraction(frames)
    return 1, 1 / (rate * ticks)


def _chunk_follows(data: bytes, pos: int) -> bool:
    """Whether a chunk can begin at `pos`: four letters and a length, or the end of the file (padding allowed)."""
    if pos >= len(data):
        return pos == len(data)
    name = data[pos : pos + 4]
    return (len(data) - pos >= 8 and all(0x20 <= c < 0x7F for c in name)) or not any(data[pos : pos + 8])


def _read_tracks(data: bytes, pos: int, findings: Findings, file: str | None) -> list[Track]:
    tracks: list[Track] = []
    room = MAX_MESSAGES
    while pos + 8 <= len(data):
        name, length = data[pos : pos + 4], int.from_bytes(data[pos + 4 : pos + 8], "big")
        body, end = pos + 8, pos + 8 + length
        if name == b"MTrk":
            label = f"track {len(tracks) + 1}"
            track, pos = _read_track(data, body, end, room, label, findings)
            tracks.append(track)
            room -= len(track.messages) + len(track.tempos) + len(track.meters)
            if room < 0 or len(tracks) > MAX_TRACKS:
                limit = f"{MAX_MESSAGES} MIDI messages, tempos and meters" if room < 0 else f"{MAX_TRACKS} tracks"
                raise ScoreError(f"more than {limit}", file=file)
        elif end <= len(data) and _chunk_follows(data, end) and any(name):
            findings.add("unknown chunk skipped", repr(name.decode("latin-1")))
            pos = end
        else:
            chunk = data.find(b"MTrk", pos)
            if chunk < 0 and any(data[pos:]):
                findings.add("stray bytes at the end of the file")
            elif chunk >= 0:
                findings.add("stray bytes between chunks skipped", f"at byte {pos}")
            pos = chunk if chunk >= 0 else len(data)
    return tracks


def _read_track(data: bytes, body: int, end: int, room: int, label: str, findings: Findings) -> tuple[Track, int]:
    """One track, and where to look for the next chunk; a length field that cannot be true is read over."""
    limit = end
    if end > len(data):
        limit = len(data)
    elif not _chunk_follows(data, end):
        limit = data.find(b"MTrk", end)
        limit = len(data) if limit < 0 else limit
    if limit != end:
        findings.add("the track's length is wrong", f"{label} says {end - body} bytes")
    track = Track()
    try:
        stopped = _read_events(data, body, limit, room, label, track, findings)
    except _BrokenTrackError as fault:
        findings.add("broken track, kept up to the fault", f"{label}, byte {fault.pos}: {fault}")
        stopped = fault.pos
    return track, end if limit == end else stopped


def _read_events(data: bytes, pos: int, limit: int, room: int, label: str, track: Track, findings: Findings) -> int:
    """Append events to `track` until its end-of-track, and return the byte after it.

    Meta and system messages leave the running status as it is: the specification ends it there, but a data byte
    would otherwise have no meaning at all, and many files rely on it.
    """
    messages = track.messages
    tick = running = 0
    while pos < limit:
        if len(messages) + len(track.tempos) + len(track.meters) > room:
            return limit
        delta, pos = _variable_length(data, pos, limit)
        tick += delta
        track.end = tick
        if pos >= limit:
            raise _BrokenTrackError("the file ends inside an event", pos)
        status = data[pos]
        if status == 0xFF:
            pos = _read_meta(data, pos, limit, tick, label, track, findings)
            if pos < 0:
                return -pos
            continue
        if status in (0xF0, 0xF7):
            length, pos = _variable_length(data, pos + 1, limit)
            messages.append((tick, 0xF0, 0, 0))
            if pos + length > limit:
                raise _BrokenTrackError(f"a system exclusive message of {length} bytes leaves the track", pos)
            pos += length
            continue
        if status > 0xF0:
            findings.add("system message that does not belong in a file, skipped", f"{label}, 0x{status:02X}")
            pos += 1 + _SYSTEM_DATA_BYTES.get(status, 0)
            continue
        if status & 0x80:
            running = status
            pos += 1
        elif not running:
            raise _BrokenTrackError(f"data byte 0x{status:02X} without a status byte before it", pos)
        count = _DATA_BYTES[running & 0xF0]
        if pos + count > limit:
            raise _BrokenTrackError("the file ends inside an event", pos)
        first, second = data[pos], data[pos + 1] if count == 2 else 0
        if (first | second) & 0x80:
            findings.add("data byte over 127, its top bit ignored", f"{label}, byte {pos}")
        messages.append((tick, running, first & 0x7F, second & 0x7F))
        pos += count
    findings.add("no end-of-track event", label)
    return limit


def _read_meta(data: bytes, pos: int, limit: int, tick: int, label: str, track: Track, findings: Findings) -> int:
    """Read the meta event at `pos`; the byte after it, negative for end of track."""
    if pos + 1 >= limit:
        raise _BrokenTrackError("the file ends inside an event", pos)
    kind = data[pos + 1]
    length, start = _variable_length(data, pos + 2, limit)
    pos = start + length
    if kind == 0x2F:
        return -min(pos, limit)
    if pos > limit:
        raise _BrokenTrackError(f"a meta event of {length} bytes leaves the track", start)
    if kind == 0x51:
        tempo = int.from_bytes(data[start:pos], "big") if length == 3 else 0
        if tempo:
            track.tempos.append((tick, tempo))
        else:
            findings.add("tempo event without a valid tempo, ignored", f"{label}, tick {tick}")
    elif kind == 0x58 and length >= 2 and data[start] and data[start + 1] <= 6:
        track.meters.append((tick, data[start], 2 ** data[start + 1]))
    elif kind in _TEXTS:
        track.texts.setdefault(_TEXTS[kind], _clean_text(data[start:pos]))
    return pos


def _variable_length(data: bytes, pos: int, limit: int) -> tuple[int, int]:
    value = 0
    for i in range(pos, min(pos + 4, limit)):
        byte = data[i]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, i + 1
    raise _BrokenTrackError("a number of variable length does not end", min(pos + 4, limit))


def _clean_text(raw: bytes) -> str:
    """Beginning of the text of a meta event on one line: UTF-8 if it is that, else Latin-1."""
    kept = raw[:_LONGEST_TEXT]
    try:
        # a letter of several bytes may be cut at the end
        text = codecs.getincrementaldecoder("utf-8")().decode(kept, final=len(raw) <= _LONGEST_TEXT)
    except UnicodeDecodeError:
        text = kept.decode("latin-1")
    return one_line(text)
