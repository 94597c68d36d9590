"""Taps from sound files, and from a microphone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import OutputError, TonewoodError
from tonewood.support.arrays import Floats
from tonewood.support.sound_rates import check_rate, read_samples
from tonewood.workshop.taps.cutting import Taps, cut_taps

#: characters of another library's message that are shown
_LONGEST = 64
#: s, most that is recorded, after the last tap, and of a piece
_MOST, _AFTER, _PIECE = 120.0, 2.5, 0.1
#: s that a take has to last before taps in it are counted
_FIRST = 1.0


def read_taps(paths: Sequence[Path], channel: int = 1) -> Taps:
    """Taps of sound files of one object: a file holds one tap or many.

    Parameters
    ----------
    paths : of .wav, .flac and what else libsndfile reads.
    channel : that is used, from 1.

    Raises
    ------
    TonewoodError : a file cannot be read, has no such channel, another rate than the first, or holds no tap.
    """
    whole: Taps | None = None
    for path in paths:
        samples, fs = _samples(path, channel)
        taps = cut_taps(samples, fs, path.name)
        whole = taps if whole is None else whole.joined(taps)
    if whole is None:
        raise TonewoodError("no file was given", key="FILES")
    return whole


def _samples(path: Path, channel: int) -> tuple[Floats, float]:
    import soundfile as sf

    if not path.is_file():
        raise TonewoodError("is not there", file=path)
    try:
        samples, fs = read_samples(path)
    except (sf.LibsndfileError, OSError) as fault:
        raise TonewoodError(f"is no sound file: {str(fault).splitlines()[0][:_LONGEST]}", file=path) from None
    if not len(samples):
        raise TonewoodError("holds no samples", file=path)
    check_rate(fs, path, lowest=1000)
    if not 1 <= channel <= samples.shape[1]:
        raise TonewoodError(f"is {channel}; 1 to {samples.shape[1]} are allowed", key="--channel", file=path)
    return samples[:, channel - 1], float(fs)


def record_taps(
    count: int,
    *,
    fs: int = 48000,
    device: Any = None,
    stream: Callable[..., Any] | None = None,
    tell: Callable[[int], None] = lambda heard: None,
) -> Floats:
    """Record from a microphone until so many taps were heard, or for two minutes.

    Parameters
    ----------
    count : of taps.
    fs : Hz.
    device : as sounddevice names it; None is the default.
    stream : class with sounddevice's ``InputStream`` interface, instead of that one.
    tell : called with the number of taps heard so far, whenever it rises.

    Raises
    ------
    OutputError : there is no sounddevice, no PortAudio or no microphone, or samples were lost.
    """
    pieces: list[Floats] = []
    make = stream or _input_stream()
    size, heard, since = round(_PIECE * fs), 0, 0.0
    with make(samplerate=fs, channels=1, dtype="float32", device=device) as microphone:
        while len(pieces) * _PIECE < _MOST:
            samples, lost = microphone.read(size)
            if lost:
                raise OutputError("samples of the microphone were lost: close other programs and record again")
            pieces.append(np.asarray(samples, dtype=np.float64).reshape(-1))
            if len(pieces) * _PIECE < _FIRST:
                continue
            now = _heard(np.concatenate(pieces), fs)
            since = since + _PIECE if now == heard else 0.0
            if now > heard:
                tell(now)
            heard = now
            if heard >= count and since >= _AFTER:
                break
    return np.concatenate(pieces)


def _heard(samples: Floats, fs: int) -> int:
    """How many taps are in it."""
    try:
        taps = cut_taps(samples, fs)
    except TonewoodError:  # none yet
        return 0
    return len(taps.samples)


def _input_stream() -> Callable[..., Any]:
    try:
        import sounddevice
    except ImportError:
        raise OutputError("recording needs sounddevice: pip install 'tonewood[play]'") from None
    except OSError:
        raise OutputError("recording needs the PortAudio library, which is not installed") from None

    def make(**options: Any) -> Any:
        try:
            return sounddevice.InputStream(**options)
        except (sounddevice.PortAudioError, ValueError) as error:
            raise OutputError(f"cannot open the microphone: {error}") from None

    return make
