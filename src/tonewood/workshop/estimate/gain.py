"""Smooth gain of an output: curve in dB from differences of levels, and the bands of an equalizer that make it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.sound.equalizer import Band, response_db
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.analysis import NoteAnalysis
from tonewood.workshop.estimate.spectra import THIRD_OCTAVES

#: Hz, knots of the curve
KNOTS = np.geomspace(80.0, 10000.0, 15)
#: dB, difference above which an outlier counts less; weight of the curve's second differences
_ROBUST, _SMOOTH = 4.0, 3.0
#: dB below the loudest band of a note at which a band no longer counts
_BAND_RANGE = 50.0
#: weight of a third octave of the first 50 ms and of later ones, re that of a partial
_BAND_WEIGHTS = (0.7, 0.5, 0.35, 0.25)
#: quality of bells half an octave apart
_BELL = 1.6


@dataclass(frozen=True, eq=False)
class Differences:
    """Levels recorded less levels rendered: number of the note, Hz, dB, weight of each."""

    note: NDArray[np.intp]
    freq: Floats
    db: Floats
    weight: Floats

    def drawn(self, picked: Sequence[int]) -> Differences:
        """Those of some notes, each as a note of its own."""
        parts = [np.flatnonzero(self.note == i) for i in picked]
        at = np.concatenate(parts)
        note = np.concatenate([np.full(len(part), i, dtype=np.intp) for i, part in enumerate(parts)])
        return Differences(note, self.freq[at], self.db[at], self.weight[at])


def differences(recorded: Sequence[NoteAnalysis], rendered: Sequence[NoteAnalysis]) -> Differences:
    """Differences of partials that both have, and of third octaves over time."""
    rows = []
    for i, (rec, syn) in enumerate(zip(recorded, rendered, strict=True)):
        both = [n for n in rec.partials if n in syn.partials]
        rows += [(i, rec.partials[n].freq, rec.partials[n].level - syn.partials[n].level, 1.0) for n in both]
        use = np.isfinite(rec.bands) & np.isfinite(syn.bands) & (rec.bands > np.nanmax(rec.bands) - _BAND_RANGE)
        use &= syn.bands > -200
        off = np.median((rec.bands - syn.bands)[use]) if use.any() else 0.0
        for part, band in np.argwhere(use):
            difference = np.clip(rec.bands[part, band] - syn.bands[part, band] - off, -25, 25) + off
            rows.append((i, THIRD_OCTAVES[band], difference, _BAND_WEIGHTS[part]))
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return Differences(table[:, 0].astype(np.intp), table[:, 1], table[:, 2], table[:, 3])


def curve(rows: Differences) -> Floats:
    """(15,) dB at `KNOTS`, of mean 0, with a gain of its own for each note; robust.

    Files are often normalised one by one, so levels between notes mean nothing. Huber weights beyond 4 dB.
    """
    notes = np.unique(rows.note)
    x = np.clip(np.log(rows.freq), np.log(KNOTS[0]), np.log(KNOTS[-1]))
    hats = np.stack([np.interp(x, np.log(KNOTS), e) for e in np.eye(len(KNOTS))], 1)
    each = (rows.note[:, None] == notes).astype(float)
    smooth = np.diff(np.eye(len(KNOTS)), 2, axis=0) * _SMOOTH
    a = np.hstack([hats, each])
    fixed = np.vstack([
        np.hstack([smooth, np.zeros((len(smooth), len(notes)))]),
        np.append(np.ones(len(KNOTS)), np.zeros(len(notes)))[None],
    ])  # fmt: skip
    w, q = rows.weight, np.zeros(a.shape[1])
    for _ in range(8):
        lhs, rhs = np.vstack([a * w[:, None], fixed]), np.append(rows.db * w, np.zeros(len(fixed)))
        q = np.linalg.lstsq(lhs, rhs)[0]
        w = rows.weight / np.sqrt(np.maximum(np.abs(rows.db - a @ q) / _ROBUST, 1))
    return np.asarray(q[: len(KNOTS)])


def curve_interval(rows: Differences, rng: np.random.Generator, draws: int = 60) -> Floats:
    """(2, 15) dB, 90 % interval of the curve by bootstrap over notes."""
    ids = np.unique(rows.note)
    curves = [curve(rows.drawn(rng.choice(ids, len(ids)).tolist())) for _ in range(draws)]
    return np.asarray(np.percentile(curves, [5, 95], axis=0))


def at(gain: Floats, freq: Floats) -> Floats:
    """Level (dB) of a curve at frequencies, straight between knots over the logarithm, constant beyond them."""
    return np.asarray(np.interp(np.log(freq), np.log(KNOTS), gain))


def bands_of(gain: Floats) -> tuple[Band, ...]:
    """Bands of an equalizer whose response is nearest to a curve, up to a constant: bells at the knots, two shelves.

    Least squares of the response in dB, which is nearly linear in the gains; these are kept within 40 dB, and small.
    """
    from scipy.optimize import least_squares

    kinds = [(float(KNOTS[1]), None), *((float(f), _BELL) for f in KNOTS[1:-1]), (float(KNOTS[-2]), None)]
    grid = np.geomspace(KNOTS[0], KNOTS[-1], 60)
    target = at(gain, grid)

    def bands_at(q: Floats) -> list[Band]:
        return [(freq, float(db), quality) for (freq, quality), db in zip(kinds, q, strict=True)]

    def off(q: Floats) -> Floats:
        return np.concatenate([response_db(bands_at(q[:-1]), grid) + q[-1] - target, 0.03 * q[:-1]])

    most = np.append(np.full(len(kinds), 40.0), 300.0)
    q = least_squares(off, np.zeros(len(kinds) + 1), bounds=(-most, most)).x
    return tuple((round(freq, 2), round(db, 3), quality) for freq, db, quality in bands_at(q[:-1]))
