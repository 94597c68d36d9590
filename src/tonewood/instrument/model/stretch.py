"""Stretched tuning: open strings tuned so that octaves beat least, by their own inharmonicity.

Partial m of a stiff string lies c_m = 600 lg2((1 + B m^2) / (1 + B)) cents above m times its pitch, with

    B = pi^2 EI / (T L^2).

Partial 2k of a note and partial k of the note an octave above do not beat if the octave is wider than 2:1 by
d_k = c_2k(low) - c_k(high). With partials whose amplitude falls as 1/m, k = 1 to 8 beat alike for the same error in
cents as far as they are heard: a pair at f = 2 k f_low counts by how near it is to the range from 0.4 to 2 kHz in which
partials decide on pitch, w_k = 1 / (1 + (f / 2 kHz)^4) / (1 + (0.4 kHz / f)^4). In the bass of a piano these are its
octaves 12:6 to 16:8, from C5 on 2:1. The cents s_i by which the notes i are raised are those that minimise

    sum_octaves (s_high - s_low - d)^2  +  0.01 sum_i (s_(i+1) - 2 s_i + s_(i-1))^2,    d = sum w_k d_k / sum w_k,

with s = 0 at A4.

The second sum joins the twelve chains of octaves; it moves an octave by less than 0.1 cent. The curve of s over a piano
is the one that Railsback measured.

Sources: O. L. Railsback, J. Acoust. Soc. Am. 9 (1938) 274; O. H. Schuck and R. W. Young, J. Acoust. Soc. Am. 15
(1943) 1, who derive the stretch from beats of octaves; H. Fletcher, J. Acoust. Soc. Am. 36 (1964) 203, for B;
R. Plomp, J. Acoust. Soc. Am. 41 (1967) 1526, for the partials that decide on pitch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tonewood.instrument.contract.base import Resonator

#: octaves 2k:k that are listened to, and Hz below and above which their partials count less
_OCTAVES, _HEARD = range(1, 9), (400.0, 2000.0)
_SMOOTHNESS = 0.01
#: MIDI number of the note that keeps its pitch
_REFERENCE = 69.0


def inharmonicity(resonator: Resonator[Any], freq: float) -> float:
    """B of a string tuned to `freq` (Hz); 0 where its mass is not uniform."""
    tension = resonator.linear_density * (2 * resonator.length * freq) ** 2
    stiffness = resonator.bending_stiffness
    return float(math.pi**2 * stiffness / (tension * resonator.length**2)) if tension > 0 else 0.0


def octave_stretch(notes: Mapping[str, float], freqs: Mapping[str, float], B: Mapping[str, float]) -> dict[str, float]:
    """Return by how many cents each note is raised.

    notes : name -> MIDI number, any order.
    freqs, B : name -> Hz without stretch, and inharmonicity.
    """
    order = sorted(notes, key=lambda name: notes[name])
    at = {round(notes[name], 6): i for i, name in enumerate(order)}
    rows: list[tuple[dict[int, float], float, float]] = []
    for low, name in enumerate(order):
        high = at.get(round(notes[name] + 12.0, 6))
        if high is not None:
            wide = [_above(B[name], 2 * k) - _above(B[order[high]], k) for k in _OCTAVES]
            weights = [_heard(2 * k * freqs[name]) for k in _OCTAVES]
            rows.append(({high: 1.0, low: -1.0}, float(np.average(wide, weights=weights)), 1.0))
    rows += [({i - 1: 1.0, i: -2.0, i + 1: 1.0}, 0.0, math.sqrt(_SMOOTHNESS)) for i in range(1, len(order) - 1)]
    reference = min(range(len(order)), key=lambda i: abs(notes[order[i]] - _REFERENCE))
    rows.append(({reference: 1.0}, 0.0, 1e3))
    matrix, target = np.zeros((len(rows), len(order))), np.zeros(len(rows))
    for row, (terms, value, weight) in enumerate(rows):
        target[row] = weight * value
        for column, factor in terms.items():
            matrix[row, column] = weight * factor
    corrections = np.linalg.lstsq(matrix, target, rcond=None)[0]
    return {name: float(corrections[i] - corrections[reference]) for i, name in enumerate(order)}


def _heard(freq: float) -> float:
    """Weight of a pair of partials at a frequency (Hz)."""
    low, high = _HEARD
    return 1.0 / (1.0 + (freq / high) ** 4) / (1.0 + (low / freq) ** 4)


def _above(B: float, m: int) -> float:
    """Cents of partial m above m times the pitch."""
    return 600.0 * math.log2((1 + B * m * m) / (1 + B))
