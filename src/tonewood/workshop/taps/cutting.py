"""Find the onset of each tap in a recording, and how long each rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import butter, decimate, sosfilt

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Floats

#: s, block over which the level is taken; blocks over which its rise is measured
_BLOCK, _BEFORE = 2e-3, 8
#: rise of the level that is a tap, as a ratio of powers (12 dB), and least power of one re the strongest (-30 dB)
_RISE, _WEAKEST = 16.0, 1e-3
#: s after the onset until hand and body are apart; shortest ringing of a tap that is used, s
CONTACT, SHORTEST = 5e-3, 0.1
#: shortest (unless the next tap comes earlier) and longest time that is analysed, s
LEAST, MOST = 0.25, 4.0
#: s, block of the ring-out; ratio of power to that of the noise at which a tap has decayed
_SLOW, _DECAYED = 0.02, 2.0
#: Hz, below this is handling noise
_RUMBLE = 30.0
#: Hz, least rate of prediction; samples from which the next one is predicted; its regularisation re the mean power
_PREDICTED, _ORDER, _RIDGE = 4000.0, 40, 1e-9
#: s before a sample of which its error of prediction is the largest of a strike; the error's power re its median
_APART, _UNLIKE = (4e-3, 12e-3), 30.0
#: samples in a row at full scale that are clipped
_CLIPPED = 3


@dataclass(frozen=True, eq=False)
class Taps:
    """Free motion after taps.

    Attributes
    ----------
    samples : of each tap, from the end of the contact until the next tap begins.
    fs : Hz.
    decays : s, of each tap until its level is 3 dB above the noise, or until the next tap.
    left_out : taps that were not used and why, a line each.
    """

    samples: tuple[Floats, ...]
    fs: float
    decays: tuple[float, ...]
    left_out: tuple[str, ...] = ()

    @property
    def ring_out(self) -> float:
        """Median time that a tap rings, s."""
        return float(np.median(self.decays))

    def joined(self, other: Taps) -> Taps:
        """Return the taps of two recordings of one object.

        Parameters
        ----------
        other : taps of the second, at the same rate.

        Raises
        ------
        TonewoodError : their rates differ.
        """
        if other.fs != self.fs:
            raise TonewoodError(f"recordings of {self.fs:g} and {other.fs:g} Hz; one rate is allowed", key="FILES")
        return Taps(self.samples + other.samples, self.fs, self.decays + other.decays, self.left_out + other.left_out)

    def analysed(self) -> list[Floats]:
        """Return the taps' samples at the same length: a median ring-out, and not beyond the next tap.

        Raises
        ------
        TonewoodError : there is no tap; the message says why those recorded were left out.
        """
        samples = self.usable()
        n = round(min(max(self.ring_out, LEAST), MOST) * self.fs)
        n = min(n, *(x.size for x in samples))
        return [x[:n] for x in samples]

    def usable(self) -> tuple[Floats, ...]:
        """Return the taps' samples.

        Raises
        ------
        TonewoodError : there is no tap; the message says why those recorded were left out.
        """
        if not self.samples:
            raise TonewoodError(f"no tap can be used: {'; '.join(self.left_out[:2])}", key="FILES")
        return self.samples


def cut_taps(samples: Floats, fs: float, name: str = "recording", full_scale: float = 1.0) -> Taps:
    """Cut a recording into taps.

    A tap is a rise of the level by 12 dB, to within 30 dB of the strongest. While another one rings it is such a rise
    of the error of linear prediction: free motion, a sum of decaying sines, follows from its own past, and a strike
    does not. The first 5 ms of a tap are left out: the hand is still on the body. It ends 20 ms before the next. The
    noise is the quietest tenth of the recording.

    Parameters
    ----------
    samples : (n,) of one channel, in any unit.
    fs : Hz.
    name : of the recording, in messages.
    full_scale : at which samples are clipped; infinite if they cannot be.

    Raises
    ------
    TonewoodError : samples are not finite, or there is no tap.
    """
    if not np.all(np.isfinite(samples)):
        raise TonewoodError("holds a sample that is not a finite number", key=name)
    # less the first sample, from rest: a constant is no rise
    x = sosfilt(butter(2, _RUMBLE, "high", fs=fs, output="sos"), samples - samples[:1].sum())
    starts = _onsets(x, fs)
    if not starts.size:
        raise TonewoodError(
            "holds no tap: nothing rises by 12 dB within 16 ms; begin to record before the tap", key=name
        )
    starts, quiet = _with_strikes(x, fs, starts), _noise(x, fs)
    kept: list[Floats] = []
    ended: list[float] = []
    left_out: list[str] = []
    for start, stop in zip(starts, [*(starts[1:] - round(0.02 * fs)), x.size], strict=True):
        first, at = start + round(CONTACT * fs), f"{name}: tap at {start / fs:.2f} s left out"
        rings = _ring_out(x[first:stop], fs, quiet) / fs
        if stop - first < SHORTEST * fs:
            left_out.append(f"{at}: {'another one follows' if stop < x.size else 'the recording ends'} too early")
        elif rings < SHORTEST:
            left_out.append(f"{at}: it rings for {rings:.2g} s only; {SHORTEST:g} s or more are needed")
        elif _clipped(samples[first:stop] / full_scale):
            left_out.append(f"{at}: it is clipped; turn the level down")
        else:
            kept.append(samples[first:stop])
            ended.append(rings)
    return Taps(tuple(kept), fs, tuple(ended), tuple(left_out))


def _powers(x: Floats, block: float) -> tuple[int, Floats]:
    """Samples of a block of about `block`, and the mean power of each."""
    size = max(1, round(block))
    return size, np.mean(np.square(x[: x.size // size * size]).reshape(-1, size), axis=1)


def _onsets(x: Floats, fs: float) -> NDArray[np.intp]:
    """Samples at which taps begin."""
    size, power = _powers(x, _BLOCK * fs)
    if power.size <= _BEFORE or not power.max() > 0:
        return np.zeros(0, dtype=np.intp)
    floor = max(float(np.quantile(power, 0.1)), 1e-9 * power.max())  # a file may begin within a tap
    before = np.convolve(np.pad(power, (_BEFORE, 0)), np.ones(_BEFORE) / _BEFORE, mode="valid")[: power.size]
    rising = np.flatnonzero((power > _RISE * (before + floor)) & (power > _WEAKEST * power.max()))
    out: list[int] = []
    for block in rising:
        if not out or block - out[-1] > 2 * _BEFORE:
            out.append(int(block))
    return np.asarray(out, dtype=np.intp) * size


def _with_strikes(x: Floats, fs: float, starts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Onsets, and those of strikes while another tap rings."""
    q = max(1, int(fs // _PREDICTED))
    y = decimate(x, q, ftype="fir") if q > 1 else x
    out: list[int] = []
    for start, stop in zip(starts, [*starts[1:], x.size], strict=True):
        at: int | None = int(start)
        while at is not None:
            out.append(at)
            first, last = at // q + round(CONTACT * fs / q), stop // q - round(CONTACT * fs / q)
            strike = _strike(y[first:last], fs / q)
            at = None if strike is None else (first + strike) * q
    return np.asarray(out, dtype=np.intp)


def _strike(x: Floats, fs: float) -> int | None:
    """Sample of the first strike within what rings freely from the first sample on."""
    near, far = (round(s * fs) for s in _APART)
    if x.size < 4 * _ORDER + far:
        return None
    past = sliding_window_view(x[:-1], _ORDER)
    normal = past.T @ past
    normal[np.diag_indices(_ORDER)] += _RIDGE * (np.trace(normal) / _ORDER + np.finfo(float).tiny)
    error = x[_ORDER:] - past @ np.linalg.solve(normal, past.T @ x[_ORDER:])
    power = uniform_filter1d(error**2, max(1, round(_BLOCK * fs)))
    before = np.full(power.size, np.inf)
    before[far:] = maximum_filter1d(power, far - near, origin=(far - near - 1) // 2 - (far - near) + 1)[: -far or None]
    least = max(_WEAKEST * float(np.mean(x[: round(_SLOW * fs)] ** 2)), _UNLIKE * float(np.median(power)))
    strikes = np.flatnonzero((power > _RISE * before) & (power > least))
    return int(strikes[0]) + _ORDER if strikes.size else None


def _noise(x: Floats, fs: float) -> float:
    """Power of the quietest tenth of the recording."""
    power = _powers(x, _SLOW * fs)[1]
    return float(np.quantile(power[power > 0], 0.1)) if np.any(power > 0) else 0.0


def _ring_out(x: Floats, fs: float, quiet: float) -> int:
    """Samples until the level has fallen to that of the noise."""
    size, power = _powers(x, _SLOW * fs)
    loud = np.flatnonzero(power > _DECAYED * quiet)
    return min(x.size, int((loud[-1] + 1) * size)) if loud.size else 0


def _clipped(x: Floats) -> bool:
    """Whether some samples in a row stand at full scale."""
    full = (np.abs(x) >= 0.999).astype(np.int8)
    return bool(np.convolve(full, np.ones(_CLIPPED, dtype=np.int8)).max(initial=0) >= _CLIPPED)
