"""Standard deviation of a frequency response's error, bin by bin: from coherence, from neighbours, from a misfit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import nnls

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: bins of the smoothing of a coherence, of fourth differences, and of the misfit of a fit
_COHERENCE, _DIFFERENCES, _MISFIT = 31, 151, 201
#: fourth difference, of unit variance
_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70.0)
#: groups of bins of like size, bins in one at least, rounds of weighting, deviation from which a group counts less
_GROUPS, _IN_GROUP, _ROUNDS, _AGREE = 16, 24, 12, 0.3


def of_coherence(response: Complexes, coherence: Floats, n_hits: int) -> Floats:
    """Standard deviation of H1 from its coherence over n hits (Bendat and Piersol 2010, 9.2).

        sigma^2 = n/(n - 1) (1 - g^2) / (n g^2) |H|^2,

    smoothed over 31 bins in its logarithm: of few hits a coherence is rough.

    Parameters
    ----------
    response, coherence : (P, N); coherence is g^2.
    """
    g = np.clip(coherence, 1e-4, 1 - 1e-9)
    bias = n_hits / (n_hits - 1) if n_hits > 2 else 1.0
    variance = bias * (1 - g) / (n_hits * g) * np.abs(response) ** 2
    return np.asarray(np.exp(0.5 * uniform_filter1d(np.log(variance + 1e-300), _COHERENCE, axis=-1, mode="mirror")))


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

    Parameters
    ----------
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
            found, _ = nnls(columns * weight[:, None], level * weight)
            fitted = np.maximum(columns @ found, 1e-12 * level.max() + 1e-300)
            weight = 1 / (fitted * np.maximum(1.0, np.abs(level / fitted - 1) / _AGREE))
        out[p] = np.maximum(found[0] + found[1] * square / max(at.max(), 1e-300), 1e-12 * level.max() + 1e-300)
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
