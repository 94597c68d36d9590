"""Files of Guitar Pro 3 to 5 by pyguitarpro, within limits: by itself it trusts every count in the file."""

from __future__ import annotations

import logging
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import Allowance
from tonewood.performance.score.written import TIE_REACHES

#: measures, tracks, beats, and beats looked at for the fret of a tie
_MOST_HEADERS, _MOST_TRACKS, _MOST_BEATS, _MOST_LOOKS = 5000, 200, 60_000, 1_000_000
#: kind of a note that is counted
NO_STRING = "note on a string that the track does not have"
#: measures times tracks
_MOST_CELLS = 60_000


class _Bytes(BytesIO):
    """Bytes of a file that ends in the error pyguitarpro knows: beyond the end it would read nothing for ever."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return so many bytes."""
        if size is None or not 0 <= size <= len(self.getbuffer()) - self.tell():
            raise struct.error("the file ends early")
        return super().read(size)


def bounded_reader(data: bytes, path: Path, ignored: Counter[str]) -> Any:
    """Return a reader of pyguitarpro that counts measures, tracks and beats, and finds a beat in one step.

    ignored : counts notes on strings that their track does not have, which pyguitarpro passes over.
    Raises ScoreError : pyguitarpro is not installed; when it reads, a count is beyond its limit.
    """
    try:
        from guitarpro import io
        from guitarpro import models as gp
    except ImportError:
        raise ScoreError("Guitar Pro 3 to 5 need pyguitarpro: pip install 'tonewood[scores]'", file=path) from None
    stream = _Bytes(data)
    version = io.GPFileBase(stream, "cp1252").readVersion()
    version_tuple, kind = io.getVersionAndGPFile(version)
    beats, looks = Allowance(_MOST_BEATS, "beats", path), Allowance(_MOST_LOOKS, "beats between ties", path)

    class Bounded(kind):  # type: ignore[valid-type, misc]  # the file's version decides on the class
        def readMeasureHeaders(self, song: Any, measureCount: int, *more: Any) -> None:
            Allowance(_MOST_HEADERS, "measures", path).take(measureCount)
            super().readMeasureHeaders(song, measureCount, *more)

        def readTracks(self, song: Any, trackCount: int, channels: Any) -> None:
            Allowance(_MOST_TRACKS, "tracks", path).take(trackCount)
            Allowance(_MOST_CELLS, "measures of tracks", path).take(trackCount * len(song.measureHeaders))
            self.starts: tuple[Any, dict[Any, Any]] = (None, {})
            super().readTracks(song, trackCount, channels)

        def getBeat(self, voice: Any, start: Any) -> Any:
            if self.starts[0] is not voice:
                self.starts = voice, {beat.start: beat for beat in voice.beats}
            if start not in self.starts[1]:
                beats.take()
                beat = self.starts[1][start] = gp.Beat(voice)
                beat.start = start
                voice.beats.append(beat)
            return self.starts[1][start]

        def readNotes(self, track: Any, *more: Any) -> None:
            (flags,) = struct.unpack_from("B", stream.getbuffer(), stream.tell())
            there = sum(1 << 7 - string.number for string in track.strings)
            ignored[NO_STRING] += (flags & 0x7F & ~there).bit_count()
            super().readNotes(track, *more)

        def getTiedNoteValue(self, note: Any) -> int:
            voice = note.beat.voice
            row = next(i for i, v in enumerate(voice.measure.voices) if v is voice)
            for measure in voice.measure.track.measures[: -TIE_REACHES - 2 : -1]:
                looks.take()
                for beat in reversed(measure.voices[row].beats):
                    looks.take()
                    if beat is note.beat or beat.status == gp.BeatStatus.empty:
                        continue
                    for before in beat.notes:
                        if before.string == note.string:
                            return int(before.value)
            (stored,) = struct.unpack_from("b", stream.getbuffer(), stream.tell() - 1)
            return int(stored)

    return Bounded(stream, "cp1252", version=version, versionTuple=version_tuple)


@contextmanager
def unknown_counted(ignored: Counter[str]) -> Iterator[None]:
    """Count the signs that pyguitarpro does not know and would log on the screen."""
    log = logging.getLogger("guitarpro")

    class Counts(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            ignored["sign that is not known"] += 1

    handler, passes = Counts(), log.propagate
    log.addHandler(handler)
    log.propagate = False
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.propagate = passes
