"""Frequency responses from hammer hits: one window on both channels, H1 and H2, coherence, double hits rejected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.fit.drift import Drift, brought_together, level_zero

#: a second pulse above this share of the first one's peak, and above so many medians of the rest, is a second hit
_SHARE, _MEDIANS = 0.03, 8.0
#: s around the pulse that belong to it at least
_CLEAR = 2e-3


@dataclass(frozen=True, eq=False)
class HitResponses:
    """Responses to several hits at one point.

    freq : (N,) Hz.
    response : (P, N) response over force.
    coherence : (P, N).
    alpha : 1/s, real part of s: 1/tau of the exponential window.
    kept : (n_hits,) which were single.
    drift : of zeros and frequencies.
    """

    freq: Floats
    response: Complexes
    coherence: Floats
    alpha: float
    kept: NDArray[np.bool_]
    drift: Drift


def is_double(force: Floats, fs: float) -> bool:
    """Whether the hammer came back: a second pulse outside the first one and its own width around it."""
    x = np.abs(force - np.median(force))
    peak = int(np.argmax(x))
    below = np.flatnonzero(x <= 0.05 * x[peak])
    before, after = below[below < peak], below[below > peak]
    first = int(before[-1]) if before.size else 0
    last = int(after[0]) if after.size else x.size - 1
    gap = max(round(_CLEAR * fs), last - first)
    rest = np.concatenate([x[: max(0, first - gap)], x[last + gap :]])
    if not rest.size:
        return False
    noise = 1.4826 * float(np.median(rest))
    return bool(rest.max() > max(_SHARE * x[peak], _MEDIANS * noise))


def responses_of_hits(
    force: Floats, motion: Floats, fs: float, *, window_tau: float | None = None, estimator: str = "H1"
) -> HitResponses:
    """Average hits to a response.

    The window exp(-t/tau) multiplies *both* channels. The transform of x(t) exp(-a t) is X(s + a), so the quotient is
    the response itself on the line Re s = a = 1/tau, and nothing has to be corrected afterwards. Before, zeros that
    drift are levelled; frequencies that drift from hit to hit are brought to their mean (`drift`).

    force : (n_hits, n) N.
    motion : (n_hits, P, n).
    fs : Hz.
    window_tau : s; no window if None.
    estimator : "H1" (noise in the response) or "H2" (noise in the force).
    Raises ValueError : of several hits fewer than two are single; of one hit, it is not.
    """
    kept = np.array([not is_double(hit, fs) for hit in force], dtype=bool)
    if np.count_nonzero(kept) < min(len(force), 2):
        raise ValueError(
            f"{np.count_nonzero(kept)} of {len(force)} hits are single; {min(len(force), 2)} or more are needed"
        )
    n = force.shape[-1]
    alpha = 0.0 if window_tau is None else 1.0 / window_tau
    window = np.exp(-alpha * np.arange(n) / fs)
    level, moving, zero = level_zero(force[kept], motion[kept])
    spectra, stretch, peaks = brought_together(level * window, moving * window, fs)
    F, X = spectra.force, spectra.motion
    of_force = np.mean(np.abs(F) ** 2, axis=0)
    of_motion = np.mean(np.abs(X) ** 2, axis=0)
    crossed = np.mean(X * F.conj()[:, None], axis=0)
    coherence = np.abs(crossed) ** 2 / np.maximum(of_force * of_motion, 1e-300)
    # bins that the hammer did not reach tell nothing
    over, under = (crossed, of_force + 0j * crossed) if estimator == "H1" else (of_motion + 0j, crossed.conj())
    response = np.divide(over, under, out=np.zeros_like(over), where=under != 0)
    drift = Drift(tuple(zero.tolist()), tuple(stretch.tolist()), tuple(peaks))
    return HitResponses(spectra.freq, response, coherence, alpha, kept, drift)
