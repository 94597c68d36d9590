"""Sampling rates of sound files that are read: resampling needs memory in proportion to a rate that a header claims."""

from __future__ import annotations

from pathlib import Path

from tonewood.errors import TonewoodError

#: Hz
_HIGHEST = 400_000


def check_rate(fs: int, file: str | Path, lowest: int = 8000) -> None:
    """Refuse a sound file of a sampling rate that no recording has.

    Parameters
    ----------
    fs : Hz.
    file : is named in the error.
    lowest : Hz.

    Raises
    ------
    TonewoodError : the rate is lower than `lowest`, or above 400 kHz.
    """
    if not lowest <= fs <= _HIGHEST:
        raise TonewoodError(f"has {fs} samples a second; {lowest} to {_HIGHEST} are allowed", file=file)
