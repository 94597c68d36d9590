"""Standard deviation of a frequency response's error, bin by bin: from coherence, from neighbours, from a misfit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: bins of the smoothing of a coherence, of second differences, and of the misfit of a fit
_COHERENCE, _DIFFERENCES, _MISFIT = 31, 81, 201


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
    """Return the noise from second differences of bins, to which resonances wider than a few bins hardly add."""
    second = (response[:, :-2] - 2 * response[:, 1:-1] + response[:, 2:]) / np.sqrt(6)
    return of_misfit(np.pad(second, ((0, 0), (1, 1)), "edge"), _DIFFERENCES)


def of_misfit(misfit: Complexes, width: int = _MISFIT) -> Floats:
    """Return the noise from the misfit of a model: the median of |.|^2 of complex Gaussian noise is sigma^2 ln 2."""
    power = median_filter(np.abs(misfit) ** 2, size=(1, width), mode="mirror")
    return np.asarray(np.sqrt(power / np.log(2)) + 1e-300)


def tied(alpha: float, step: float) -> float:
    """Bound on the factor by which an exponential window raises the error of a fit over that of independent bins.

    The window ties neighbouring bins to one another. In time, noise of a level sigma in all bins has the power
    sigma^2 w^2(t) / <w^2>, w = exp(-alpha t) over T = 1 / step, and a response that has decayed before the window has
    is met by that of the beginning, w = 1:

        1 / sqrt(<w^2>) = sqrt(2 x / (1 - exp(-2 x))),   x = alpha T.
    """
    x = alpha / step
    return float(np.sqrt(2 * x / -np.expm1(-2 * x))) if x > 1e-6 else 1.0
