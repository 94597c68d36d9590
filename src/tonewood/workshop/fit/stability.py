"""A stability chart: poles of models of rising order, by least squares in the frequency domain.

The common-denominator model (LSCF: Guillaume, Verboven, Vanlanduit 1998; Peeters et al. 2004)

    Y_p(z) = B_p(z) / A(z),   z = exp(-j pi f / f_max),

is linear in its coefficients after multiplication by A. Physical poles come back at every order, others move about.
The chart is for the eye; the modes come from `search`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.support.arrays import Complexes, Floats

#: orders of the chart, most bins used, and what counts as the same pole: relative in frequency and in damping
ORDERS, _MOST_BINS, _SAME_FREQ, _SAME_DAMPING = range(4, 61, 4), 2000, 0.01, 0.1


@dataclass(frozen=True, eq=False)
class Stability:
    """Poles within the band, order by order.

    order : (n,) of the model that each pole belongs to.
    freq, quality : (n,) Hz and Q.
    stable : (n,) whether the order before has it, too: within 1 % of the frequency and 10 % of the damping.
    """

    order: NDArray[np.intp]
    freq: Floats
    quality: Floats
    stable: NDArray[np.bool_]


def stability(freq: Floats, mobility: Complexes) -> Stability:
    """Compute the chart of some responses.

    Parameters
    ----------
    freq : (N,) Hz.
    mobility : (P, N) (m/s)/N.
    """
    every = max(1, freq.size // _MOST_BINS)
    freq, mobility = freq[::every], mobility[:, ::every]
    weighed = mobility / np.sqrt(np.mean(np.abs(mobility) ** 2, axis=1, keepdims=True))
    powers = np.exp(-1j * np.pi * freq / freq[-1])[:, None] ** np.arange(ORDERS[-1] + 1)
    inside = (powers.conj().T @ powers).real
    crossed = [-(powers.conj().T @ (row[:, None] * powers)).real for row in weighed]
    squared = [(powers.conj().T @ (np.abs(row[:, None]) ** 2 * powers)).real for row in weighed]
    rows: list[tuple[int, Floats, Floats, NDArray[np.bool_]]] = []
    before = np.zeros((2, 0))
    for n in ORDERS:
        factor = sla.cho_factor(inside[: n + 1, : n + 1] + 1e-9 * inside[0, 0] * np.eye(n + 1))
        normal = np.zeros((n + 1, n + 1))
        for s, t in zip(crossed, squared, strict=True):
            part = s[: n + 1, : n + 1]
            normal += t[: n + 1, : n + 1] - part.T @ sla.cho_solve(factor, part)
        ridge = 1e-12 * np.trace(normal) * np.eye(n)
        denominator = np.append(sla.solve(normal[:n, :n] + ridge, -normal[:n, n], assume_a="sym"), 1.0)
        roots = np.roots(denominator[::-1])
        s = -np.log(roots[roots != 0]) * 2 * freq[-1]
        s = s[(s.real < 0) & (s.imag > 0)]
        f, q = np.abs(s) / (2 * np.pi), np.abs(s) / (-2 * s.real)
        keep = (f >= freq[0]) & (f <= freq[-1])
        f, q = f[keep], q[keep]
        alike = (np.abs(f[:, None] / before[0] - 1) < _SAME_FREQ) & (np.abs(before[1] / q[:, None] - 1) < _SAME_DAMPING)
        rows.append((n, f, q, np.asarray(alike.any(axis=1))))
        before = np.array([f, q])
    return Stability(
        np.concatenate([np.full(f.size, n) for n, f, _, _ in rows]),
        np.concatenate([f for _, f, _, _ in rows]),
        np.concatenate([q for _, _, q, _ in rows]),
        np.concatenate([stable for *_, stable in rows]),
    )
