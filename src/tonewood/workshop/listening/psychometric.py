"""Psychometric function: the share of right answers at a level.

    p(x) = g + (1 - g - l) F(b (u(x) - u(T)) + F^-1(q)),   F(v) = 1 / (1 + e^-v),   q = (P - g) / (1 - g - l)

with the share g of right guesses, the lapse rate l, u(x) = x (ln x where steps are ratios), the slope b, and the
threshold T, at which a share P of the answers is right. Source: F. A. Wichmann & N. J. Hill, Percept. Psychophys. 63
(2001) 1293-1313.
"""

from __future__ import annotations

from typing import Any

import numpy as np

#: lapse rate where nothing else is stated
LAPSES = 0.02


def psychometric(u: Any, threshold: Any, slope: Any, guess: float, share: float, lapses: Any = LAPSES) -> Any:
    """Share of right answers.

    u, threshold : transformed levels.
    slope : per unit of u.
    guess, lapses : share of right guesses, and lapse rate.
    share : of right answers at the threshold, less than 1 - lapses.
    """
    q = (share - guess) / (1 - guess - lapses)
    with np.errstate(over="ignore"):
        return guess + (1 - guess - lapses) / (1 + np.exp(-slope * (u - threshold)) * (1 - q) / q)
