"""Reverberation: impulse responses of rooms, computed or from a file, and their convolution with a sound.

``studio``, ``small`` and ``hall`` are boxes whose image sources `pyroomacoustics` sums (J. B. Allen and D. A. Berkley,
J. Acoust. Soc. Am. 65 (1979) 943), with one absorption for all walls after Sabine. A sound file can give another
response. Each response begins with the direct sound at a gain of 1, so the room only adds to it. In a box the
reverberation re the direct sound depends on the distance: both are equally strong where 16 pi d^2 is the room's
absorption, 0.161 V / T60 after Sabine, thus at d = 0.057 sqrt(V / T60) (m, m^3, s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Floats
from tonewood.support.sound_rates import LOUDEST, check_rate, check_whole


@dataclass(frozen=True, slots=True)
class Box:
    """A room with plane walls.

    size : m, length, width, height.
    t60 : s, after Sabine.
    source : m, place of the instrument.
    towards : direction from the instrument to the microphones.
    distance : m, of the microphones where none is asked for.
    """

    size: tuple[float, float, float]
    t60: float
    source: tuple[float, float, float]
    towards: tuple[float, float, float]
    distance: float

    def places(self, distance: float, channels: int) -> Floats:
        """(3, channels) m, positions of the microphones, side by side across their distance from the instrument."""
        ahead = np.array(self.towards) / np.linalg.norm(self.towards)
        across = np.cross(ahead, (0.0, 0.0, 1.0))
        offset = _APART * (np.arange(channels) - (channels - 1) / 2)
        at = np.array(self.source) + distance * ahead
        return np.asarray(at[:, None] - np.outer(across, offset))


ROOMS = {
    "studio": Box((6.5, 5.0, 3.0), 0.3, (2.1, 2.2, 1.1), (1.0, 0.15, 0.05), 0.7),
    "small": Box((5.2, 3.9, 2.6), 0.4, (1.3, 1.9, 1.1), (1.0, 0.1, 0.05), 0.6),
    "hall": Box((24.0, 15.0, 9.0), 1.6, (4.0, 7.1, 1.2), (1.0, 0.09, 0.02), 2.0),
}
#: m between neighbouring microphones; least from a wall
_APART, _FROM_WALL = 0.3, 0.3
#: s, longest response of a file
_LONGEST = 20.0
#: samples to each side from which values between samples are interpolated
_NEAR = 64
#: frames of a part of the convolution
_PART = 1024
#: s after the direct sound between which the mix's gain sets in
_DIRECT = (1e-3, 2.5e-3)


def room_response(room: str, fs: int, channels: int, *, distance: float | None = None, mix_db: float = 0.0) -> Floats:
    """(n, channels) impulse responses, the direct sound first, of gain 1.

    room : ``studio``, ``small``, ``hall``, or a sound file with one channel or one for each of `channels`.
    distance : m, from the instrument to the microphones in a box; the box's own where left out.
    mix_db : dB, gain of everything later than the direct sound.
    Raises TonewoodError : pyroomacoustics is not installed; the file cannot be read or is silent; the microphones would
        stand in a wall, or a distance is asked for in a file's room.
    """
    if room in ROOMS:
        responses = _boxed(ROOMS[room], fs, channels, distance)
    elif distance is not None:
        raise TonewoodError(f"is for {', '.join(ROOMS)}; the response of a file has its own", key="room_distance")
    else:
        responses = _read(room, fs, channels)
    responses = _begun(responses, fs)
    return responses if mix_db == 0.0 else responses * _after_direct(responses, fs, 10 ** (mix_db / 20))


def reverberation_db(responses: Floats, fs: int) -> float:
    """Energy later than the direct sound re that of the direct sound, dB, of all channels."""
    late = _after_direct(responses, fs, 0.0)
    direct = float(np.sum((responses * late) ** 2))
    whole = float(np.sum(responses**2))
    return 10 * float(np.log10(max(whole - direct, 1e-30) / direct))


def _after_direct(responses: Floats, fs: int, gain: float) -> Floats:
    """(n, channels) factors: 1 for the direct sound of each channel, `gain` after it."""
    time = np.arange(len(responses))[:, None] / fs - np.abs(responses).argmax(axis=0) / fs
    begin, end = _DIRECT
    share = np.clip((time - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(1.0 + (gain - 1.0) * 0.5 * (1.0 - np.cos(np.pi * share)))


def _boxed(box: Box, fs: int, channels: int, distance: float | None) -> Floats:
    places = box.places(box.distance if distance is None else distance, channels)
    size = np.array(box.size)[:, None]
    if np.any(places < _FROM_WALL) or np.any(places > size - _FROM_WALL):
        farthest = max(d for d in np.arange(0.1, 60.0, 0.1) if np.all(box.places(d, 2) <= size - _FROM_WALL))
        raise TonewoodError(f"is {distance:g} m; 0.1 to {farthest:.1f} m are allowed in this room", key="room_distance")
    try:
        import pyroomacoustics as pra
    except ImportError:
        raise TonewoodError("needs pyroomacoustics: pip install 'tonewood[room]'", key="room") from None
    absorption, order = pra.inverse_sabine(box.t60, box.size)
    shoebox = pra.ShoeBox(box.size, fs=fs, materials=pra.Material(absorption), max_order=order)
    shoebox.add_source(box.source)
    shoebox.add_microphone_array(places)
    shoebox.compute_rir()
    responses = [np.asarray(shoebox.rir[c][0], dtype=np.float64) for c in range(channels)]
    out = np.zeros((max(map(len, responses)), channels))
    for c, response in enumerate(responses):
        out[: len(response), c] = response
    return out


def _read(name: str, fs: int, channels: int) -> Floats:
    import math

    import soundfile as sf

    if not Path(name).is_file():
        names = ", ".join(ROOMS)
        raise TonewoodError(f"is {name!r}; {names} or the name of a sound file are allowed", key="room")
    try:
        rate = sf.info(name).samplerate
        check_rate(rate, name)
        check_whole(Path(name))
        response, _ = sf.read(name, frames=int(_LONGEST * rate) + 1, dtype="float64", always_2d=True)
    except sf.LibsndfileError as fault:
        raise TonewoodError(f"cannot be read: {fault.error_string}", file=name) from None
    if response.shape[1] not in (1, channels):
        raise TonewoodError(f"has {response.shape[1]} channels; 1 or {channels} are allowed", file=name)
    if not len(response) or not np.all(np.abs(response) <= LOUDEST) or len(response) > _LONGEST * rate:
        raise TonewoodError(f"up to {_LONGEST:g} s of finite samples are allowed", file=name)
    if rate != fs:
        from scipy.signal import resample_poly

        common = math.gcd(fs, rate)
        response = resample_poly(response, fs // common, rate // common)
    return np.asarray(np.broadcast_to(response, (len(response), channels)))


def _begun(responses: Floats, fs: int) -> Floats:
    """Responses from half a millisecond before the earliest direct sound on; the loudest channel's has a gain of 1.

    The gain is the largest value between samples, too: a direct sound that comes half a sample late has a largest
    sample of 0.64 of it.
    """
    direct = np.abs(responses).argmax(axis=0)
    largest = max(_peak(response, int(k)) for response, k in zip(responses.T, direct, strict=True))
    if not np.all(np.abs(responses).max(axis=0) > 0):
        raise TonewoodError("the response is silent", key="room")
    first = max(0, int(direct.min()) - round(0.5e-3 * fs))
    return np.asarray(responses[first:] / largest)


def _peak(response: Floats, k: int) -> float:
    """Largest value of a band-limited response within a sample of sample k."""
    first = max(0, k - _NEAR)
    near = np.arange(first, min(len(response), k + _NEAR + 1))
    between = k + np.linspace(-1.0, 1.0, 129)
    return float(np.abs(np.sinc(between[:, None] - near) @ response[near]).max())


class Room:
    """Convolve a sound with impulse responses; the samples do not depend on its pieces, to the last bit.

    The convolution is partitioned (W. G. Gardner, J. Audio Eng. Soc. 43 (1995) 127): the sound that comes out is up
    to 1023 frames shorter than what went in, until the last piece brings the rest and the reverberation.

    responses : (n, channels).
    sources : channel of the dry sound for each of the channels; the same numbers where left out.
    memory : arrays that hold all that moves, for snapshots.
    """

    def __init__(self, responses: Floats, sources: Sequence[int] | None = None):
        channels = responses.shape[1]
        self._sources = list(range(channels)) if sources is None else list(sources)
        parts = -(-len(responses) // _PART)
        padded = np.zeros((parts * _PART, channels))
        padded[: len(responses)] = responses
        self._responses = np.fft.rfft(padded.reshape(parts, _PART, channels), 2 * _PART, axis=1)
        self._length = len(responses)
        dry = max(self._sources) + 1
        self._spectra = np.zeros((parts, _PART + 1, dry), dtype=np.complex128)
        self._rest, self._waiting = np.zeros((_PART, channels)), np.zeros((0, dry))

    @property
    def memory(self) -> tuple[NDArray[np.complex128], Floats, Floats]:
        """Copies of spectra of earlier parts, sound that is still due, and sound that waits for a part to be full."""
        return self._spectra.copy(), self._rest.copy(), self._waiting.copy()

    @memory.setter
    def memory(self, arrays: tuple[NDArray[np.complex128], Floats, Floats]) -> None:
        spectra, rest, waiting = arrays
        self._spectra, self._rest, self._waiting = spectra.copy(), rest.copy(), waiting.copy()

    def add(self, sound: Floats, *, last: bool = False) -> Floats:
        """Take a piece (m, dry channels) and return the sound (k, channels) that is complete."""
        waiting = np.concatenate([self._waiting, sound])
        due = len(waiting) + self._length - 1
        if last:
            waiting = np.concatenate([waiting, np.zeros((-due % _PART + due - len(waiting), waiting.shape[1]))])
        whole = len(waiting) // _PART
        out = [self._part(waiting[i * _PART : (i + 1) * _PART]) for i in range(whole)]
        self._waiting = waiting[whole * _PART :]
        done = np.concatenate(out) if out else np.zeros((0, self._rest.shape[1]))
        return done[:due] if last else done

    def _part(self, sound: Floats) -> Floats:
        self._spectra = np.roll(self._spectra, 1, axis=0)
        self._spectra[0] = np.fft.rfft(sound, 2 * _PART, axis=0)
        both = np.fft.irfft(np.sum(self._spectra[:, :, self._sources] * self._responses, axis=0), 2 * _PART, axis=0)
        done, self._rest = both[:_PART] + self._rest, both[_PART:]
        return np.asarray(done)
