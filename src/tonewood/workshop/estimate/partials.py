"""Partials of one note: frequencies, inharmonicity, and how each one decays, in one or several modes.

Frequencies: peaks of the spectrum of 50 to 850 ms (longer for low notes), followed upwards along

    f_n = n f0 sqrt(1 + B n^2)

with f0 and B fitted again on the way. Decays: the band of each partial is cut out of the spectrum of the whole note,
brought to 0 Hz and decimated; ESPRIT finds its damped exponentials (R. Roy and T. Kailath, IEEE Trans. ASSP 37 (1989)
984) from 45 ms after the onset until it comes within 12 dB of the noise half-way to its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.estimate.recordings import FS
from tonewood.workshop.estimate.spectra import db, power_spectrum

#: Hz, highest partial that is looked for; most partials of a note that are analysed
HIGHEST, MOST = 9000.0, 45
#: s after the onset that are left out: pluck, knock, smear of the band filter; longest piece; lead before the onset
_SKIP, _LONGEST, _LEAD = 0.045, 3.0, 0.1
#: dB of fall over which the two slopes of a partial are taken
EARLY, LATE = 15.0, 30.0


@dataclass(frozen=True)
class Mode:
    """A damped exponential of a partial: Hz from the partial's frequency, 1/s, amplitude at the onset."""

    offset: float
    rate: float
    amplitude: float


@dataclass(frozen=True)
class NotePartial:
    """A partial.

    number, freq : n, and Hz.
    level : dB, highest after the first 45 ms.
    rate, early : 1/s, decay of the first 30 and 15 dB.
    fell : dB, from the highest level to the end of the analysis.
    modes : damped exponentials, the strongest first.
    misfit : dB, what these leave, re the partial.
    noise : dB, level half-way to the neighbours.
    """

    number: int
    freq: float
    level: float
    rate: float
    early: float
    fell: float
    modes: tuple[Mode, ...]
    misfit: float
    noise: float

    @property
    def clear(self) -> bool:
        """Whether it fell far enough, and is regular enough, for its decay to count."""
        return self.fell > 6.0 and self.misfit < -8.0


class Bands:
    """Bands of one note, all from one spectrum."""

    _SIZE = 1 << 18
    _STEP = FS / _SIZE

    def __init__(self, x: Floats, onset: int):
        piece = np.zeros(self._SIZE)
        first = onset - int(_LEAD * FS)
        part = x[max(first, 0) : first + int((_LONGEST + 2 * _LEAD) * FS)]
        begin = max(-first, 0)
        piece[begin : begin + len(part)] = part
        self.end = (begin + len(part)) / FS - _LEAD
        self._spectrum = np.fft.rfft(piece)

    @classmethod
    def rate(cls, half_width: float) -> float:
        """Samples per second of the envelope of a band."""
        return cls._width(half_width)[1] * cls._STEP

    @classmethod
    def _width(cls, half_width: float) -> tuple[int, int]:
        """Half of a band with its flanks, in lines of the spectrum, and samples of its envelope."""
        half = int(1.25 * half_width / cls._STEP)
        return half, 1 << int(np.ceil(np.log2(2 * half)))

    def envelope(self, freq: float, half_width: float) -> tuple[Complexes, Floats]:
        """Complex envelope of the band around `freq` (Hz), and its times from the onset (s)."""
        k, (half, size) = round(freq / self._STEP), self._width(half_width)
        j = np.arange(-half, half)
        flank = np.clip((1 - np.abs(j) / half) / 0.25, 0, 1)
        inside = (k + j >= 0) & (k + j < len(self._spectrum))
        z = np.zeros(size, dtype=np.complex128)
        z[j[inside] % size] = self._spectrum[k + j[inside]] * (0.5 - 0.5 * np.cos(np.pi * flank[inside]))
        y = 2 * np.fft.ifft(z) * size / self._SIZE
        t = np.arange(size) / (size * self._STEP) - _LEAD
        return y * np.exp(-2j * np.pi * (freq - k * self._STEP) * t), t


def find_partials(x: Floats, onset: int, freq: float, guess: float, upper: float) -> tuple[float, float, Floats]:
    """f0 (Hz), B, and rows (n, Hz, dB, dB over the noise) of the partials.

    x, onset : sound and sample of its onset.
    freq : Hz, the note's pitch, within 60 cents.
    guess : B of the string that is expected.
    upper : Hz, end of the band.
    Returns B is nan, and there are no rows, where fewer than three partials are found.
    """
    start = onset + int(0.05 * FS)
    piece = x[start : start + int(max(0.8, 45.0 / freq) * FS)]
    freqs, power = power_spectrum(piece, np.blackman(len(piece)), 1 << 19)
    level, step = db(power), float(freqs[1])
    f = _fundamental(level, step, freq)
    trials = [_followed(level, step, f, b, min(upper, HIGHEST)) for b in guess * np.array([0.25, 0.5, 1.0, 2.0, 4.0])]
    best = max((trial for trial in trials if trial is not None), key=lambda trial: trial[0], default=None)
    return (f, np.nan, np.empty((0, 4))) if best is None else best[1:]


def _fundamental(level: Floats, step: float, freq: float) -> float:
    """Median of the strongest peaks near the first six multiples of a frequency, each over its number."""
    low = []
    for n in range(1, 7):
        a, b = (int(n * freq * 2 ** (cents / 1200) / step) for cents in (-60, 60))
        if b >= len(level) or b <= a:
            break
        k = a + int(np.argmax(level[a:b]))
        low.append((level[k], k * step / n))
    strongest = max(row[0] for row in low)
    return float(np.median([f for at, f in low if at > strongest - 35]))


def _followed(
    level: Floats, step: float, freq: float, guess: float, upper: float
) -> tuple[float, float, float, Floats] | None:
    """Score, f0, B and rows of the partials that are found from one guess of B on."""
    f, b, missed = freq, guess, 0
    rows: list[tuple[float, float, float, float]] = []
    for n in range(1, 3 * MOST):
        expected = n * f * np.sqrt(1 + b * n * n)
        if expected > upper - f or missed > 4:
            break
        reach = max((0.15 if n < 4 else 0.08) * f, 3.0)
        low, high = int((expected - reach) / step), int((expected + reach) / step)
        k = low + int(np.argmax(level[low:high]))
        noise = float(np.median(level[int((expected - f / 2) / step) : int((expected + f / 2) / step)]))
        if level[k] > noise + 14 and low < k < high - 1:
            rows.append((n, k * step, level[k], level[k] - noise))
            missed = 0
        else:
            missed += 1
        if len(rows) >= 6 and n >= 9:
            f, b = _inharmonicity(np.array(rows), f, b, guess)
    if len(rows) < 3:
        return None
    if len(rows) < 9:
        f, b = _inharmonicity(np.array(rows), f, b, guess)
    table = np.array(rows)
    off = 1200 * np.log2(table[:, 1] / (table[:, 0] * f * np.sqrt(1 + b * table[:, 0] ** 2)))
    score = float(np.sum(np.minimum(table[:, 3], 40) * (np.abs(off) < 12)))
    return score, f, b, table[np.abs(off) < 40]


def _inharmonicity(rows: Floats, f: float, b: float, guess: float) -> tuple[float, float]:
    """f0 and B by weighted least squares of (f_n / n)^2 over n^2, without outliers; B from 0 to 20 times `guess`."""
    n2, y = rows[:, 0] ** 2, (rows[:, 1] / rows[:, 0]) ** 2
    weight = rows[:, 0] * np.minimum(rows[:, 3], 30)
    keep, c = np.ones(len(rows), bool), np.array([f * f, b * f * f])
    for _ in range(4):
        if keep.sum() < 3:
            break
        design = np.stack([np.ones(keep.sum()), n2[keep]], 1)
        c = np.linalg.lstsq(design * weight[keep, None], y[keep] * weight[keep])[0]
        off = 1200 * np.log2(np.sqrt(np.maximum(c[0] + c[1] * n2, 1)) / np.sqrt(y))
        new = np.abs(off) < 3 * (1.5 * np.median(np.abs(off[keep])) + 0.7)
        if new.sum() < 5:
            break
        keep = new
    return (float(np.sqrt(c[0])), float(np.clip(c[1] / c[0], 0.0, 20 * guess))) if c[0] > 0 else (f, b)


def poles(signals: Sequence[Complexes], orders: Sequence[int]) -> dict[int, Complexes]:
    """Poles, per sample, of so many damped exponentials, for each of `orders` that the samples suffice for.

    signals : of one length, which share the poles.
    """
    from scipy.linalg import hankel, lstsq, svd

    n = len(signals[0])
    rows = n // 3
    u = svd(np.hstack([hankel(y[:rows], y[rows - 1 :]) for y in signals]), full_matrices=False)[0]
    return {
        k: np.asarray(np.linalg.eigvals(lstsq(u[:-1, :k], u[1:, :k])[0]), np.complex128)
        for k in orders
        if n > 6 * k + 6
    }


def _modes(y: Complexes, t: Floats) -> tuple[float, tuple[Mode, ...]] | None:
    """Misfit (dB) and one to three damped exponentials; another one has to take 5 dB off the misfit."""
    from scipy.linalg import lstsq

    step, best = t[1] - t[0], None
    for z in poles([y], (1, 2, 3)).values():
        s = np.log(z) / step
        if (-s.real < 0.05).any() or (-s.real > 60).any():
            continue
        basis = np.exp(np.outer(t, s))
        a = lstsq(basis, y)[0]
        misfit = float(db(np.mean(np.abs(y - basis @ a) ** 2) / np.mean(np.abs(y) ** 2)))
        if best is None or misfit < best[0] - 5:
            modes = [Mode(float(p.imag / 2 / np.pi), float(-p.real), float(abs(q))) for p, q in zip(s, a, strict=True)]
            best = (misfit, tuple(sorted(modes, key=lambda m: -m.amplitude)))
    return best


def measure_partial(bands: Bands, number: int, freq: float, f0: float) -> NotePartial | None:
    """Decay of one partial; None if it does not stand out of the noise for long enough."""
    width = min(0.35 * f0, 30.0)
    y, t = bands.envelope(freq, width)
    use = (t > _SKIP) & (t < min(_LONGEST, bands.end - 0.03))
    if use.sum() < 16:
        return None
    beside = [np.median(np.abs(bands.envelope(freq + s * f0 / 2, width)[0])[use]) for s in (-1, 1)]
    noise = float(db(np.median(beside) ** 2))
    y, t = y[use], t[use]
    level = db(np.abs(y) ** 2)
    low = np.flatnonzero(level < max(noise + 12, level[: len(y) // 4].max() - 45))
    low = low[low > 3]
    end = int(low[0]) if len(low) else len(y)
    if end < 12:
        return None
    y, t, level = y[:end], t[:end], level[:end]
    top = int(np.argmax(level[: max(3, end // 4)]))
    late, early = (_rate(t, level, top, fall) for fall in (LATE, EARLY))
    modes = _modes(y, t)
    if modes is None or not np.isfinite(late):
        return None
    fell = float(level[top] - level[-1])
    return NotePartial(number, float(freq), float(level[top]), late, early, fell, modes[1], modes[0], noise)


def _rate(t: Floats, level: Floats, top: int, fall: float) -> float:
    """1/s, by a line through the level from its top until it has fallen so many dB; nan if it does not fall."""
    below = np.flatnonzero(level[top:] < level[top] - fall)
    stop = top + (int(below[0]) if len(below) else len(level) - top)
    if stop - top <= 5:
        return np.nan
    slope = float(np.polyfit(t[top:stop], level[top:stop], 1)[0])
    return -slope / 20 * np.log(10) if slope < -0.5 else np.nan
