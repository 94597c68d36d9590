"""A room about the instrument: each channel convolved with an impulse response. Never measured with the instrument.

``small`` and ``hall`` are boxes whose image sources `pyroomacoustics` sums (J. B. Allen and D. A. Berkley, J. Acoust.
Soc. Am. 65 (1979) 943), with one absorption for all walls after Sabine. A sound file holds a response of its own.
Either begins with its direct sound, which has a gain of 1: the room only adds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Box:
    """A room with plane walls.

    Attributes
    ----------
    size : m, length, width, height.
    t60 : s, after Sabine.
    source, listener : m, of the instrument and of the middle between the channels.
    """

    size: tuple[float, float, float]
    t60: float
    source: tuple[float, float, float]
    listener: tuple[float, float, float]


ROOMS = {
    "small": Box((5.2, 3.9, 2.6), 0.4, (1.3, 1.9, 1.1), (3.4, 2.1, 1.2)),
    "hall": Box((24.0, 15.0, 9.0), 1.6, (4.0, 7.1, 1.2), (12.0, 7.8, 1.4)),
}
#: m between the listeners' places of neighbouring channels
_APART = 0.3
#: s, longest response of a file
_LONGEST = 20.0


def room_response(room: str, fs: int, channels: int) -> Floats:
    """(n, channels) impulse responses, the direct sound first, of gain 1.

    Parameters
    ----------
    room : ``small``, ``hall``, or the name of a sound file with one channel or one for each of `channels`.

    Raises
    ------
    TonewoodError : pyroomacoustics is not installed; the file cannot be read or is silent.
    """
    if room in ROOMS:
        return _begun(_boxed(ROOMS[room], fs, channels), fs)
    return _begun(_read(room, fs, channels), fs)


def _boxed(box: Box, fs: int, channels: int) -> Floats:
    try:
        import pyroomacoustics as pra
    except ImportError:
        raise TonewoodError("needs pyroomacoustics: pip install 'tonewood[room]'", key="--room") from None
    absorption, order = pra.inverse_sabine(box.t60, box.size)
    shoebox = pra.ShoeBox(box.size, fs=fs, materials=pra.Material(absorption), max_order=order)
    shoebox.add_source(box.source)
    x, y, z = box.listener
    places = [(x, y + _APART * (c - (channels - 1) / 2), z) for c in range(channels)]
    shoebox.add_microphone_array(np.array(places).T)
    shoebox.compute_rir()
    found = [np.asarray(shoebox.rir[c][0], dtype=np.float64) for c in range(channels)]
    out = np.zeros((max(map(len, found)), channels))
    for c, response in enumerate(found):
        out[: len(response), c] = response
    return out


def _read(name: str, fs: int, channels: int) -> Floats:
    import math

    import soundfile as sf

    if not Path(name).is_file():
        known = ", ".join(ROOMS)
        raise TonewoodError(f"is {name!r}; {known} or the name of a sound file are allowed", key="--room")
    try:
        given, rate = sf.read(name, dtype="float64", always_2d=True)
    except sf.LibsndfileError as fault:
        raise TonewoodError(f"cannot be read: {fault.error_string}", file=name) from None
    if given.shape[1] not in (1, channels):
        raise TonewoodError(f"has {given.shape[1]} channels; 1 or {channels} are allowed", file=name)
    if not len(given) or not np.all(np.isfinite(given)) or len(given) > _LONGEST * rate:
        raise TonewoodError(f"up to {_LONGEST:g} s of finite samples are allowed", file=name)
    if rate != fs:
        from scipy.signal import resample_poly

        common = math.gcd(fs, rate)
        given = resample_poly(given, fs // common, rate // common)
    return np.asarray(np.broadcast_to(given, (len(given), channels)))


def _begun(responses: Floats, fs: int) -> Floats:
    """Responses from half a millisecond before the earliest direct sound on; the loudest channel's has a gain of 1."""
    largest = np.abs(responses).max(axis=0)
    if not np.all(largest > 0):
        raise TonewoodError("the response is silent", key="--room")
    direct = int(np.abs(responses).argmax(axis=0).min())
    first = max(0, direct - round(0.5e-3 * fs))
    return np.asarray(responses[first:] / largest.max())


class Room:
    """Convolve blocks of sound with impulse responses by overlap-add; the tail follows the last block.

    Parameters
    ----------
    responses : (n, channels).
    """

    def __init__(self, responses: Floats):
        self._responses = responses

    def process(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """Yield the blocks (m, channels) with the room's sound, and its reverberation after them."""
        from scipy.signal import fftconvolve

        rest = np.zeros((0, self._responses.shape[1]))
        for block in blocks:
            sound = fftconvolve(block, self._responses, axes=0)
            sound[: len(rest)] += rest
            yield sound[: len(block)]
            rest = sound[len(block) :]
        if len(rest):
            yield rest
