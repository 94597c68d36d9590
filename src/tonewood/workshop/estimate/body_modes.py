"""Body modes from single notes: they ring below the fundamental of high notes.

Below 0.8 f0 a note has no partials of its own. What rings there after the pluck are modes of the body, and partials of
open strings that move with it. All notes that are high enough share these modes, so that the Hankel matrices of their
envelopes, side by side, have one signal subspace, from which ESPRIT takes the poles (R. Roy and T. Kailath, IEEE Trans.
ASSP 37 (1989) 984). A mode counts where most of the bootstrap draws over notes and orders have it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.estimate.partials import Bands, poles

#: Hz, lower end of the bands, and their upper ends; s after the onset that are used
_LOW, LIMITS = 70.0, (250.0, 350.0)
_SPAN = (0.01, 0.25)
#: notes that a band needs; orders of the search; draws over notes; share of these that a mode is found in
FEWEST, _ORDERS, _DRAWS, _SHARE = 6, (5, 6, 7, 8), 12, 0.7
#: largest ratio of frequency and of Q between draws of one mode
_SAME_FREQ, _SAME_Q = 1.03, 2.0
#: cents from a partial of an open string, and Q, within and above which a pole is taken for that partial
_STRING_CENTS, _STRING_Q = 15.0, 40.0
#: least Q of a mode: poles that die sooner are noise and the pluck itself
_LEAST_Q = 3.0


@dataclass(frozen=True)
class HeardMode:
    """A mode of the body: Hz and Q, medians of the draws, with 90 % intervals, and the share of draws that have it."""

    freq: float
    q: float
    freq_interval: tuple[float, float]
    q_interval: tuple[float, float]
    share: float


def envelopes(bands: Bands, f0: float) -> tuple[Complexes | None, ...]:
    """Complex envelope of what lies below each of `LIMITS`, of rms 1; None where a partial of the note lies there."""
    out: list[Complexes | None] = []
    for limit in LIMITS:
        out.append(None)
        if np.isfinite(f0) and 0.8 * f0 > limit and bands.end > _SPAN[1]:
            y, t = bands.envelope((_LOW + limit) / 2, (limit - _LOW) / 2)
            y = y[(t > _SPAN[0]) & (t < _SPAN[1])]
            rms = float(np.sqrt(np.mean(np.abs(y) ** 2)))
            out[-1] = y / rms if rms > 0 else None
    return tuple(out)


def body_modes(notes: Iterable[Sequence[Complexes | None]], open_strings: Sequence[float]) -> tuple[HeardMode, ...]:
    """Modes that the notes share, from low to high; none with fewer than six notes that are high enough.

    notes : `envelopes` of each.
    open_strings : Hz, whose partials ring along and are no modes.
    """
    rows, rng = list(notes), np.random.default_rng(1)
    draws: list[Floats] = []
    for i, limit in enumerate(LIMITS):
        present = [y for y in (row[i] for row in rows) if y is not None]
        if len(present) < FEWEST:
            continue
        for k in range(_DRAWS):
            picked = range(len(present)) if k == 0 else rng.integers(0, len(present), len(present))
            draws += [_kept(sample, open_strings) for sample in _found([present[j] for j in picked], limit)]
    pool = np.array([(i, *pole) for i, draw in enumerate(draws) for pole in draw]).reshape(-1, 3)
    modes: list[HeardMode] = []
    while len(pool):
        alike = [_alike(pool, pole) for pole in pool]
        best = max(alike, key=lambda rows: len(np.unique(pool[rows, 0])))
        freq, q = pool[best, 1], pool[best, 2]
        share = len(np.unique(pool[best, 0])) / len(draws)
        if share < _SHARE:
            break
        modes.append(HeardMode(float(np.median(freq)), float(np.median(q)), _interval(freq), _interval(q), share))
        pool = pool[np.abs(np.log(pool[:, 1] / np.median(freq))) > np.log(_SAME_FREQ)]
    return tuple(sorted(modes, key=lambda mode: mode.freq))


def _interval(values: Floats) -> tuple[float, float]:
    """90 % of the values."""
    low, high = np.percentile(values, [5, 95])
    return float(low), float(high)


def _found(signals: Sequence[Complexes], limit: float) -> list[Floats]:
    """(n, 2) Hz and Q of the poles between 0 and the limit, for each of the orders."""
    out = []
    for z in poles(signals, _ORDERS).values():
        s = np.log(z) * Bands.rate((limit - _LOW) / 2)
        freq, rate = (_LOW + limit) / 2 + s.imag / (2 * np.pi), -s.real
        mode = (rate > 0) & (freq > _LOW) & (freq < limit)
        out.append(np.stack([freq, np.pi * freq / np.where(mode, rate, 1.0)], 1)[mode])
    return out


def _kept(poles: Floats, open_strings: Sequence[float]) -> Floats:
    """Poles that are neither partials of open strings nor die within a period."""
    freq, q = poles.T
    strings = np.array(open_strings)
    n = np.maximum(np.round(freq[:, None] / strings), 1)
    cents = np.abs(1200 * np.log2(freq[:, None] / (n * strings)))
    rings = (cents < _STRING_CENTS).any(axis=1) & (q > _STRING_Q)
    return np.asarray(poles[~rings & (q > _LEAST_Q)])


def _alike(pool: Floats, pole: Floats) -> NDArray[np.bool_]:
    """Which poles of other draws are the same mode."""
    near = np.abs(np.log(pool[:, 1] / pole[1])) < np.log(_SAME_FREQ)
    return np.asarray(near & (np.abs(np.log(pool[:, 2] / pole[2])) < np.log(_SAME_Q)))
