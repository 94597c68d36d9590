"""Bounds of sound files that are read.

Resampling needs memory in proportion to the rate that a header claims, and a compressed megabyte may hold hours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError

#: Hz
_HIGHEST = 400_000
#: samples of all channels (480 MB): ten minutes of two at 48 kHz
MOST_SAMPLES = 60_000_000
#: largest sample, whose square is still far from the largest number
LOUDEST = 1e30
#: bytes of a WAV file's samples from which on programs mean that they did not know the length
_UNKNOWN = 0x7FF00000


def check_rate(fs: int, file: str | Path, lowest: int = 8000) -> None:
    """Refuse a sound file of a sampling rate that no recording has.

    fs : Hz.
    file : is named in the error.
    lowest : Hz.
    Raises TonewoodError : the rate is lower than `lowest`, or above 400 kHz.
    """
    if not lowest <= fs <= _HIGHEST:
        raise TonewoodError(f"has {fs} samples a second; {lowest} to {_HIGHEST} are allowed", file=file)


def check_whole(path: Path) -> None:
    """Refuse a WAV file that ends before its samples do; libsndfile reads what is there and says nothing.

    Raises TonewoodError : the file is cut short. A length that a program could not know as it began is no promise.
    """
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        head = stream.read(12)
        if head[:4] != b"RIFF" or head[8:] != b"WAVE":
            return
        while len(chunk := stream.read(8)) == 8:
            length, begin = int.from_bytes(chunk[4:], "little"), stream.tell()
            if chunk[:4] == b"data":
                if size - begin < length < _UNKNOWN:
                    raise TonewoodError(
                        f"is cut short: {size - begin} of {length} bytes of samples are there", file=path
                    )
                return
            stream.seek(begin + length + length % 2)


def read_samples(path: Path) -> tuple[NDArray[np.float64], int]:
    """Read a whole sound file: samples, (n, channels), and their rate, Hz.

    Raises TonewoodError : it holds more than `MOST_SAMPLES`, is cut short, or has a sample that no recording has.
    Raises OSError, soundfile.LibsndfileError : it cannot be read.
    """
    import soundfile as sf

    check_whole(path)
    with path.open("rb") as stream, sf.SoundFile(stream) as file:
        most = MOST_SAMPLES // file.channels
        samples = file.read(most + 1, dtype="float64", always_2d=True)
        if len(samples) > most:
            raise TonewoodError(
                f"lasts longer than {most / file.samplerate:.0f} s; "
                f"{MOST_SAMPLES} samples of {file.channels} channel(s) are allowed: cut it",
                file=path,
            )
        peak = max(samples.max(initial=0.0), -samples.min(initial=0.0))
        if LOUDEST < peak < np.inf:
            raise TonewoodError(f"has a sample of {peak:.3g}; up to {LOUDEST:g} are allowed", file=path)
        return samples, int(file.samplerate)
