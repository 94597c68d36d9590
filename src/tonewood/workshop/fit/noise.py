"""Standard deviation of a frequency response's error, bin by bin: from coherence, from neighbours, from a misfit."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import nnls

from tonewood.support.arrays import Complexes, Floats

#: bins of the smoothing of a coherence, of fourth differences, and of the misfit of a fit
_COHERENCE, _DIFFERENCES, _MISFIT = 31, 151, 201
#: fourth differences re their deviation that begin and bound a run of outliers
_SPIKE, _QUIET = 10.0, 4.5
#: fourth differences in a row, most in which every choice of spikes is tried
_LONGEST_RUN = 14
#: fourth difference, of unit variance
_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70.0)
#: groups of bins of like size, bins in one at least, rounds of weighting, deviation from which a group counts less
_GROUPS, _IN_GROUP, _ROUNDS, _AGREE = 16, 24, 12, 0.3


def of_coherence(response: Complexes, coherence: Floats, n_hits: int) -> Floats:
    """Standard deviation of H1 from its coherence over n hits (Bendat and Piersol 2010, 9.2).

        sigma^2 = n/(n - 1) (1 - g^2) / (n g^2) |H|^2,

    smoothed over 31 bins in its logarithm: of few hits a coherence is rough.

    response, coherence : (P, N); coherence is g^2.
    """
    g = np.clip(coherence, 1e-4, 1 - 1e-9)
    bias = n_hits / (n_hits - 1) if n_hits > 2 else 1.0
    variance = bias * (1 - g) / (n_hits * g) * np.abs(response) ** 2
    shape = _two_parts(variance, np.abs(response) ** 2)
    left = uniform_filter1d(np.log(variance / shape + 1e-300), _COHERENCE, axis=-1, mode="mirror")
    return np.asarray(np.sqrt(shape) * np.exp(0.5 * left))


def of_neighbours(response: Complexes) -> Floats:
    """Return the noise from fourth differences of bins, to which resonances wider than a few bins hardly add."""
    if response.shape[-1] < 2 * len(_FOURTH):
        raise ValueError(f"{response.shape[-1]} bins tell no noise; {2 * len(_FOURTH)} or more do")
    fourth = np.array([np.convolve(row, _FOURTH, mode="valid") for row in response])
    return of_misfit(np.pad(fourth, ((0, 0), (2, 2)), "edge"), response, _DIFFERENCES)


def of_misfit(misfit: Complexes, response: Complexes | None = None, width: int = _MISFIT) -> Floats:
    """Return the noise that a misfit shows: an additive part, and one relative to the response.

        sigma^2(f) = g(f) (a^2 + r^2 |Y|^2),

    a and r from medians of |misfit|^2 over groups of bins of like |Y| (the median of |.|^2 of complex Gaussian noise is
    sigma^2 ln 2), g the running median of what these leave: a hammer that fades towards high frequencies.

    misfit : (P, N) data less a model, or differences of neighbours with the same variance.
    response : (P, N) |Y| that the relative part follows; None: no relative part is sought.
    width : bins of the running median.
    """
    power = np.abs(misfit) ** 2
    shape = np.ones_like(power) if response is None else _two_parts(power, np.abs(response) ** 2)
    width = min(width, power.shape[-1] // 2 * 2 - 1)
    left = median_filter(power / shape, size=(1, width), mode="mirror")
    return np.asarray(np.sqrt(np.maximum(left, 1e-6 * left.mean(axis=1, keepdims=True)) * shape / np.log(2)) + 1e-300)


def _two_parts(power: Floats, size: Floats) -> Floats:
    """(P, N) of a^2 + r^2 |Y|^2 fitted to the medians of groups of bins, each to its own share."""
    out = np.empty_like(power)
    for p, (row, square) in enumerate(zip(power, size, strict=True)):
        groups = np.array_split(np.argsort(square), max(4, min(_GROUPS, row.size // _IN_GROUP)))
        level = np.array([np.median(row[group]) for group in groups]) + 1e-300
        at = np.array([np.median(square[group]) for group in groups])
        # most groups agree on two numbers; the one of sharp peaks may be far above them
        columns, weight = np.stack([np.ones(at.size), at / max(at.max(), 1e-300)], axis=1), 1 / level
        for _ in range(_ROUNDS):
            shares, _ = nnls(columns * weight[:, None], level * weight)
            fitted = np.maximum(columns @ shares, 1e-12 * level.max() + 1e-300)
            weight = 1 / (fitted * np.maximum(1.0, np.abs(level / fitted - 1) / _AGREE))
        out[p] = np.maximum(shares[0] + shares[1] * square / max(at.max(), 1e-300), 1e-12 * level.max() + 1e-300)
    return out


def tied(alpha: float, step: float) -> float:
    """Bound on the factor by which an exponential window raises the error of a fit over that of independent bins.

    The window ties neighbouring bins to one another. In time, noise of a level sigma in all bins has the power
    sigma^2 w^2(t) / <w^2>, w = exp(-alpha t) over T = 1 / step, and a response that has decayed before the window has
    is met by that of the beginning, w = 1:

        1 / sqrt(<w^2>) = sqrt(2 x / (1 - exp(-2 x))),   x = alpha T.
    """
    x = alpha / step
    return float(np.sqrt(2 * x / -np.expm1(-2 * x))) if x > 1e-6 else 1.0


def outliers(response: Complexes) -> NDArray[np.bool_]:
    """(P, N) bins that disagree with their neighbours on both sides: a drop-out, a bin of the mains.

    A spike in one bin leaves five fourth differences, proportional to 1, -4, 6, -4, 1, and none beside them. A run of
    differences above ten times the noise is taken for spikes if as few as a third of its length explain it down to the
    noise. A resonance, however narrow, is none: its flanks reach further.

    response : (P, N) at even steps.
    """
    spikes = np.zeros(response.shape, dtype=bool)
    if response.shape[-1] < 2 * len(_FOURTH):
        return spikes
    level = median_filter(of_neighbours(response), size=(1, 9), mode="mirror")  # a spike would raise its own
    for row, sigma, out in zip(response, level, spikes, strict=True):
        fourth, size = np.convolve(row, _FOURTH, mode="valid"), sigma[2:-2]
        loud = np.abs(fourth) > _SPIKE * size
        for first, stop in _runs(np.convolve(np.abs(fourth) > _QUIET * size, np.ones(3), "same") > 0):
            if loud[first:stop].any():
                out[_spikes(fourth[first:stop] / np.median(size[first:stop]), first)] = True
    return spikes


def _runs(inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(n, 2) where runs of true begin and end."""
    return np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8))).reshape(-1, 2)


def _spikes(fourth: Complexes, first: int) -> list[int]:
    """Bins whose spikes explain a run of fourth differences; none if a third of its length do not suffice."""
    n = fourth.size
    if n > _LONGEST_RUN:
        return []
    bins = np.arange(-2, n + 2)
    columns = np.array([[_FOURTH[i - b + 2] if abs(i - b) <= 2 else 0.0 for b in bins] for i in range(n)])
    for number in range(1, n // 3 + 1):
        best, some = min((_left(columns[:, some], fourth), some) for some in combinations(range(2, n + 2), number))
        if best < _QUIET:
            return [int(first + 2 + bins[i]) for i in some]
    return []


def _left(part: Floats, fourth: Complexes) -> float:
    """Largest fourth difference that spikes do not explain."""
    return float(np.abs(fourth - part @ np.linalg.lstsq(part, fourth, rcond=None)[0]).max())
