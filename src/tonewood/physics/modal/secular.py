"""Roots of a secular equation: eigenvalues of a diagonal matrix with one more row and column."""

from __future__ import annotations

import numpy as np

from tonewood.support.arrays import Floats


def secular_roots(
    pole: Floats, weight: Floats, low: Floats, high: Floats, start: Floats, *, slope: float = 0.0, constant: float = 0.0
) -> tuple[Floats, Floats]:
    """Find the one root in each interval of F(y) = slope y - constant - sum_n weight_n / (y - pole_n).

    F grows from -inf to inf between two neighbouring poles. Newton's method on F times the distances to the poles at
    both ends of the interval, which is nearly straight; bisection where it would leave the bracket. A root is kept as
    its distance from the nearer pole, so that no difference y - pole loses digits.

    pole, weight : (n,) distinct, and positive.
    low, high : (m,) ends of the intervals: poles, or numbers beyond all poles between which F changes sign.
    start : (m,) first guess.
    slope, constant : of the straight part; not negative.
    Returns root : (m,).
    distance : (m, n) root - pole, each to its own relative precision.
    """
    first, last = ~np.isin(high, pole), ~np.isin(low, pole)
    rising = slope * start - constant - (weight / (start[:, None] - pole)).sum(axis=1) < 0
    origin = np.where(~first & (last | rising), high, low)
    lower, upper, x = low - origin, high - origin, start - origin
    gap = origin[:, None] - pole
    for _ in range(80):
        inverse = 1 / (gap + x[:, None])
        value = slope * (origin + x) - constant - inverse @ weight
        steepness = slope + inverse**2 @ weight
        lower, upper = np.where(value < 0, x, lower), np.where(value < 0, upper, x)
        up, down = np.where(first, 1.0, high - origin - x), np.where(last, 1.0, x - (low - origin))
        turn = np.where(last, 0.0, up) - np.where(first, 0.0, down)
        new = x - value * up * down / (steepness * up * down + value * turn)
        new = np.where((new >= lower) & (new <= upper), new, 0.5 * (lower + upper))
        done = np.abs(new - x) <= 1e-9 * np.abs(new)  # convergence is quadratic
        x = new
        if done.all():
            break
    return origin + x, gap + x[:, None]
