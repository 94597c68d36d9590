"""Compare the partials of two sounds: pitch, decay and level.

A motion that contacts or a bow make sensitive differs from stroke to stroke, however it is computed. Only properties
that strokes have in common can be compared there: the mean energy of a partial in the course of the note, and its mean
pitch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.support.arrays import Complexes, Floats

#: partials that are looked for, and how far below the loudest they may be, dB
PARTIALS, RANGE_DB = 20, 40.0


@dataclass(frozen=True, slots=True)
class PartialErrors:
    """Partials of a sound against those of another; medians and worst.

    cents, cents_worst : pitch.
    decay, decay_worst : decay rate, relative.
    level, level_worst : dB.
    partials : how many were compared.
    waveform : ||x - y|| / ||y|| in the first second, after the delay of x is taken out; None for several strokes.
    delay : that delay, s. Forces and accelerations are read as their mean over the step that begins at a sample: half
        a step early.
    """

    cents: float
    cents_worst: float
    decay: float
    decay_worst: float
    level: float
    level_worst: float
    partials: int
    waveform: float | None = None
    delay: float | None = None


def compare(sounds: ArrayLike, truths: ArrayLike, fs: float, freq: float, let_go: float = 0.0) -> PartialErrors:
    """Compare the partials of two sounds, or of strokes of one with the same strokes of the other.

    Each partial is shifted to zero frequency, smoothed by a Hann window of eight periods of `freq` and looked at four
    times in a window. With a and b the results, and A and B the means over strokes of |a|^2 and |b|^2:

    * pitch: slope of arg(a / b), weighted by |b|^2, mean over strokes;
    * level: 10 lg (sum A / sum B);
    * decay: slope of 10 lg E(t), least squares weighted by sqrt E, E(t) = int_t A dt being the energy still to come
      (Schroeder's backward integration, as ISO 3382-1 has it), and the rate of the exponential that has that slope in
      as long a time: a number where partials beat or feed each other, too. The weight stands for the limits of level
      in that standard, which would jump from one beat to the next.

    sounds, truths : (n,) or (n_strokes, n), beginning together.
    freq : Hz, of the first partial; the others are sought near its multiples, and found where `truths` is loudest.
    let_go : s, of a note that is driven until then: pitch and level are those before, decay is that after it. 0 if the
        string is left alone from the first.
    """
    ours, theirs = np.atleast_2d(sounds), np.atleast_2d(truths)
    length = int(8 * fs / freq)
    starts = np.arange(0, min(ours.shape[1], theirs.shape[1]) - length, length // 4)
    t = np.asarray((starts + 0.5 * length) / fs, dtype=np.float64)
    reach = 0.5 * length / fs
    heard, free = (t + reach < let_go, t - reach > let_go) if let_go > 0 else (t > 0, t > 0)
    freqs = _partials(theirs[0][: int(let_go * fs) or None], fs, freq)
    a, b = (_envelopes(x, fs, freqs, length, starts) for x in (ours, theirs))
    A, B = (np.mean(np.abs(x) ** 2, axis=0) for x in (a, b))
    sums = B[:, heard].sum(axis=1)
    kept = np.flatnonzero(sums >= sums.max() * 10 ** (-RANGE_DB / 10))
    cents = [_detuning(t[heard], a[:, k, heard], b[:, k, heard], freqs[k]) for k in kept]
    decay = [abs(_decay(t[free], A[k, free]) / _decay(t[free], B[k, free]) - 1) for k in kept]
    level = np.abs(10 * np.log10(A[kept][:, heard].sum(axis=1) / sums[kept]))
    (c, c_worst), (d, d_worst), (v, v_worst) = ((float(np.median(x)), float(np.max(x))) for x in (cents, decay, level))
    wave = waveform(ours[0], theirs[0], fs) if len(ours) == len(theirs) == 1 else (None, None)
    return PartialErrors(c, c_worst, d, d_worst, v, v_worst, len(kept), *wave)


def waveform(sound: Floats, truth: Floats, fs: float) -> tuple[float, float]:
    """Relative error of a waveform in the first second, and the delay (s) that was taken out before.

    The delay is the slope of the phase of X Y* over frequency, weighted by |X Y|, found anew twice after it is taken
    out.
    """
    from scipy.fft import irfft, rfft, rfftfreq

    n = min(len(sound), len(truth), round(fs))
    window = np.hanning(n + 2)[1:-1]
    x, y, freq = rfft(sound[:n] * window), rfft(truth[:n] * window), rfftfreq(n, 1 / fs)
    if not (size := float(np.sum((truth[:n] * window) ** 2))):
        return 0.0, 0.0
    delay = 0.0
    for _ in range(3):
        pair = x * np.exp(2j * np.pi * freq * delay) * np.conj(y)
        weight = np.abs(pair) * freq
        delay -= float(np.sum(weight * np.angle(pair)) / np.sum(weight * freq)) / (2 * np.pi)
    shifted = irfft(x * np.exp(2j * np.pi * freq * delay), n)
    return float(np.sqrt(np.sum((shifted - truth[:n] * window) ** 2) / size)), delay


def _partials(truth: Floats, fs: float, freq: float) -> list[float]:
    """Frequencies of the partials, Hz: maxima of the spectrum, each sought near where the last ones lead to."""
    from scipy.fft import rfft, rfftfreq

    n = 8 * len(truth)
    spectrum, grid = np.abs(rfft(truth * np.hanning(len(truth)), n)), rfftfreq(n, 1 / fs)
    out: list[float] = []
    for k in range(1, PARTIALS + 1):
        guess = freq if k == 1 else out[-1] * k / (k - 1)
        near = np.flatnonzero(np.abs(grid - guess) < 0.12 * freq)
        if guess > 0.4 * fs or not len(near):
            break
        out.append(float(grid[near[np.argmax(spectrum[near])]]))
    return out


def _envelopes(sounds: Floats, fs: float, freqs: Sequence[float], length: int, starts: NDArray[np.intp]) -> Complexes:
    """(n_strokes, n_partials, n_looks)."""
    window = np.hanning(length + 2)[1:-1]
    turn = -2j * np.pi * np.asarray(freqs) / fs
    carriers = (window / window.sum())[:, None] * np.exp(np.arange(length)[:, None] * turn)
    looks = [(sounds[:, s : s + length] @ carriers) * np.exp(s * turn) for s in starts]
    return np.stack(looks, axis=-1)


def _detuning(t: Floats, a: Complexes, b: Complexes, freq: float) -> float:
    """Cents between two partials (n_strokes, n_looks) near `freq`, without its sign."""
    pairs = [(np.unwrap(np.angle(x * np.conj(y))), np.abs(y)) for x, y in zip(a, b, strict=True)]
    slopes = [float(np.polynomial.polynomial.polyfit(t, turned, 1, w=weight)[1]) for turned, weight in pairs]
    return float(abs(1200 / np.log(2) * np.mean(slopes) / (2 * np.pi * freq)))


def _decay(t: Floats, energy: Floats) -> float:
    """Rate of a partial's energy (n_looks), nepers in the time there is: see `compare`."""
    span = (t - t[0]) / (t[-1] - t[0])
    rates, slopes = _slopes_of_exponentials(span.tobytes())
    return float(np.interp(-_slope(span, energy[None])[0], np.negative(slopes), rates))


@lru_cache(maxsize=8)
def _slopes_of_exponentials(span: bytes) -> tuple[Floats, Floats]:
    """Rates, and the slopes that exponentials of these rates have, for times (float64, 0 to 1)."""
    t = np.frombuffer(span)
    rates = np.concatenate([np.linspace(-10, 20, 121), np.geomspace(20, 500, 60)[1:]])
    return rates, _slope(t, np.exp(-rates[:, None] * t))


def _slope(t: Floats, energy: Floats) -> Floats:
    """Slopes of the levels of the energy still to come (n, n_looks), dB per unit of t, weighted by its root."""
    left = np.maximum(np.cumsum(energy[:, ::-1], axis=1)[:, ::-1], 1e-300)
    left /= left[:, :1]
    weight = np.sqrt(left)
    level = 10 * np.log10(left)
    total = weight.sum(axis=1)
    mean = (weight @ t) / total
    off = t - mean[:, None]
    return np.asarray((weight * off * level).sum(axis=1) / (weight * off**2).sum(axis=1))
