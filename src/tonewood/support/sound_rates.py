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


def check_rate(fs: int, file: str | Path, lowest: int = 8000) -> None:
    """Refuse a sound file of a sampling rate that no recording has.

    fs : Hz.
    file : is named in the error.
    lowest : Hz.
    Raises TonewoodError : the rate is lower than `lowest`, or above 400 kHz.
    """
    if not lowest <= fs <= _HIGHEST:
        raise TonewoodError(f"has {fs} samples a second; {lowest} to {_HIGHEST} are allowed", file=file)


def read_samples(path: Path) -> tuple[NDArray[np.float64], int]:
    """Read a whole sound file: samples, (n, channels), and their rate, Hz.

    Raises TonewoodError : it holds more than `MOST_SAMPLES`.
    Raises OSError, soundfile.LibsndfileError : it cannot be read.
    """
    import soundfile as sf

    with path.open("rb") as stream, sf.SoundFile(stream) as file:
        most = MOST_SAMPLES // file.channels
        samples = file.read(most + 1, dtype="float64", always_2d=True)
        if len(samples) > most:
            raise TonewoodError(
                f"lasts longer than {most / file.samplerate:.0f} s; "
                f"{MOST_SAMPLES} samples of {file.channels} channel(s) are allowed: cut it",
                file=path,
            )
        return samples, int(file.samplerate)
