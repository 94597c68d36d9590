"""Weighted least squares for poles; residues, which are linear, are eliminated (Golub, Pereyra 1973; Kaufman 1975).

The mobility at point i under a force at j, on the line s = alpha + j w (alpha = 1/tau of an exponential window or 0):

    Y_ij(s) = sum_k (A_ijk s + B_ijk w_k) / (s^2 + 2 zeta_k w_k s + w_k^2) + E_ij w_0 / s + C_ij s / w_0

with viscous damping, and with s^2 + w_k^2 (1 + 2 j zeta_k) below the fraction where damping is structural (hysteretic):
its loss does not rise with frequency. A real mode has B = 0. B is allowed while modes are sought: damping that couples
modes turns residues by some degrees, and with B = 0 a search answers that by modes that are not there. E stands for
modes below the band (a mass), C for those above it (a compliance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: relative ridge of normal equations whose columns have unit length
_RIDGE = 1e-12
#: steps around a line of the mains within which bins are muted
_MUTED = 1.6


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of modes, sorted by frequency.

    Attributes
    ----------
    log_freq : (K,) ln w, w in rad/s.
    log_zeta : (K,) ln of the damping ratio.
    """

    log_freq: Floats
    log_zeta: Floats

    @classmethod
    def none(cls) -> Poles:
        """No pole."""
        return cls(np.zeros(0), np.zeros(0))

    @classmethod
    def at(cls, freq: Sequence[float] | Floats, quality: Sequence[float] | Floats) -> Poles:
        """Poles at frequencies (Hz) with quality factors Q = 1 / (2 zeta)."""
        return cls(np.log(2 * np.pi * np.asarray(freq, float)), np.log(0.5 / np.asarray(quality, float))).sorted()

    def __len__(self) -> int:
        return len(self.log_freq)

    def __getitem__(self, which: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Poles:
        return Poles(self.log_freq[which], self.log_zeta[which])

    def sorted(self) -> Poles:
        """Return the poles sorted by frequency."""
        return self[np.argsort(self.log_freq)]

    def joined(self, other: Poles) -> Poles:
        """Return these poles and others, sorted by frequency."""
        return Poles(np.append(self.log_freq, other.log_freq), np.append(self.log_zeta, other.log_zeta)).sorted()

    def without(self, which: Sequence[int]) -> Poles:
        """All but some."""
        return Poles(np.delete(self.log_freq, which), np.delete(self.log_zeta, which))

    def damped_beyond(self, low: float, high: float) -> Poles:
        """Return the poles with those beyond a band (Hz) damped so that none rings for more periods than any in it.

        Poles beyond the band stand for the modes there. Data of the band tell next to nothing of their damping, and a
        body that is played would ring with it.
        """
        inside = (self.freq >= low) & (self.freq <= high)
        least = self.log_zeta[inside].min() if inside.any() else -np.inf
        return Poles(self.log_freq, np.where(inside, self.log_zeta, np.maximum(self.log_zeta, least)))

    @property
    def freq(self) -> Floats:
        """(K,) undamped natural frequency, Hz."""
        return np.exp(self.log_freq) / (2 * np.pi)

    @property
    def quality(self) -> Floats:
        """(K,) Q = 1 / (2 zeta)."""
        return 0.5 / np.exp(self.log_zeta)


@dataclass(frozen=True, eq=False)
class FitData:
    """Bins of the band, and the data measured in them.

    Attributes
    ----------
    freq : (N,) Hz.
    mobility : (P, N) (m/s)/N, a response a row.
    sigma : (P, N) standard deviation of the complex error, E|e|^2 = sigma^2.
    alpha : 1/s, real part of s.
    half_width : (N,) Hz, r.m.s. half width of bins that stand for several; two Gauss points stand for such a bin.
    """

    freq: Floats
    mobility: Complexes
    sigma: Floats
    alpha: float = 0.0
    half_width: Floats | None = None

    @property
    def s(self) -> Complexes:
        """(N,) 1/s."""
        return np.asarray(self.alpha + 2j * np.pi * self.freq)

    def cut(self, first: int, stop: int, without: Complexes) -> FitData:
        """Some bins, less the response of the model's other modes there, (P, stop - first)."""
        half = None if self.half_width is None else self.half_width[first:stop]
        part = slice(first, stop)
        return FitData(self.freq[part], self.mobility[:, part] - without, self.sigma[:, part], self.alpha, half)

    @property
    def step(self) -> float:
        """Distance of bins, Hz; the median where it varies."""
        return float(np.median(np.diff(self.freq)))

    def without(self, freq: Sequence[float] | Floats) -> FitData:
        """Return the data with those bins muted that lie within a step of some frequencies, Hz."""
        near = np.any(np.abs(self.freq[:, None] - np.asarray(freq)) <= _MUTED * self.step, axis=1)
        return replace(self, sigma=np.where(near, 1e4, 1.0) * self.sigma)

    def thinned(self, resolution: float = 400.0) -> FitData:
        """Weighted means of neighbouring bins, as many as lie within freq / resolution: modes up high are wide."""
        step = np.gradient(self.freq)
        first, edges = 0, []
        while first < self.freq.size:
            edges.append(first)
            first += max(1, int(self.freq[first] / (resolution * step[first])))
        count, weight = np.diff(np.append(edges, self.freq.size)), 1 / self.sigma**2
        total = np.add.reduceat(weight, edges, axis=1)
        mean = np.add.reduceat(self.mobility * weight, edges, axis=1) / total
        centre = np.add.reduceat(self.freq, edges) / count
        apart = (self.freq - np.repeat(centre, count)) ** 2
        half = np.sqrt(np.add.reduceat(apart, edges) / count)
        return FitData(centre, np.asarray(mean, dtype=np.complex128), total**-0.5, self.alpha, half)


@dataclass(frozen=True)
class Shape:
    """Points and forms of the residues sought.

    Attributes
    ----------
    driving : rows of the mobility measured where they were driven: their residues A are positive.
    free : independent entries of a mode's shape: as many as there are points, whatever the number of references.
    complex : whether B is allowed.
    lower, upper : whether E and C are.
    structural : whether damping is structural, else viscous.
    """

    driving: tuple[int, ...]
    free: int
    complex: bool = True
    lower: bool = True
    upper: bool = True
    structural: bool = False


@dataclass(eq=False)
class LinearFit:
    """Residues for given poles.

    Attributes
    ----------
    cost : chi-squared, the sum of |misfit|^2 2 / sigma^2; its expectation is twice the number of numbers measured.
    residues : (P, n) of columns: A of all modes, B of all modes where complex, E, C.
    chi2 : (P, n) increase of the cost if one is set to zero and the others adapt.
    normal, gradient : (2K, 2K) and (2K,) of ln w then ln zeta, residues eliminated; where asked for.
    """

    cost: float
    residues: Floats
    chi2: Floats
    normal: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    gradient: Floats = field(default_factory=lambda: np.zeros(0))
    #: per response: (n, 2K) how residues follow poles, (n,) their variances at fixed poles
    follows: list[tuple[Floats, Floats]] = field(default_factory=list)


def _columns(s: Complexes, poles: Poles, structural: bool) -> tuple[Complexes, Complexes, Complexes]:
    """(K, N) of h = s / (s^2 + loss + w^2), dh/dln w, dh/dln zeta; the loss is 2 zeta w s or 2j zeta w^2."""
    w, zeta = np.exp(poles.log_freq)[:, None], np.exp(poles.log_zeta)[:, None]
    loss = 2j * zeta * w * w + 0 * s if structural else 2 * zeta * w * s
    per = 1 / (s * s + loss + w * w)
    h = s * per
    turned = h * per
    return h, -turned * ((1 + structural) * loss + 2 * w * w), -turned * loss


@dataclass(frozen=True, eq=False)
class Projection:
    """The least-squares problem of one band.

    Attributes
    ----------
    data : measured responses.
    shape : which residues there are.
    """

    data: FitData
    shape: Shape

    @cached_property
    def _weight(self) -> Floats:
        return np.asarray(np.sqrt(2) / self.data.sigma)

    @cached_property
    def scale(self) -> float:
        """w_0, rad/s: in the middle of the band."""
        return float(2 * np.pi * np.sqrt(self.data.freq[0] * self.data.freq[-1]))

    @cached_property
    def _edges(self) -> Complexes:
        s = self.data.s
        return np.array([self.scale / s] * self.shape.lower + [s / self.scale] * self.shape.upper).reshape(-1, s.size)

    @property
    def size(self) -> int:
        """Numbers measured: two a bin and response."""
        return 2 * self.data.mobility.size

    @property
    def price(self) -> float:
        """Chi-squared that a mode has to gain to be kept: its parameters times ln of the size (BIC, Schwarz 1978)."""
        return float((2 + (1 + self.shape.complex) * self.shape.free) * np.log(self.size))

    def columns(self, poles: Poles) -> tuple[Complexes, list[tuple[Complexes, Complexes]]]:
        """Columns of the residues, (K or 2K, N), and their slopes in ln w and ln zeta."""
        s, half = self.data.s, self.data.half_width
        if half is None or not half.any():
            h, by_freq, by_zeta = _columns(s, poles, self.shape.structural)
        else:
            off = 2j * np.pi * half
            structural = self.shape.structural
            pair = zip(_columns(s + off, poles, structural), _columns(s - off, poles, structural), strict=True)
            h, by_freq, by_zeta = (0.5 * (a + b) for a, b in pair)
        if not self.shape.complex:
            return h, [(by_freq, by_zeta)]
        turn = np.exp(poles.log_freq)[:, None] / s
        return np.vstack([h, turn * h]), [(by_freq, by_zeta), (turn * (h + by_freq), turn * by_zeta)]

    def solve(self, poles: Poles, slopes: bool = False) -> LinearFit:
        """Residues, and with `slopes` the normal equations of the poles."""
        k, n_responses = len(poles), len(self.data.mobility)
        h, by = self.columns(poles)
        n = len(h) + len(self._edges)
        rows = [h, self._edges, *(x for pair in by for x in pair)] if slopes else [h, self._edges]
        stack = np.vstack(rows)
        out = LinearFit(0.0, np.zeros((n_responses, n)), np.zeros((n_responses, n)))
        if slopes:
            out.normal, out.gradient = np.zeros((2 * k, 2 * k)), np.zeros(2 * k)
        for p, (y, weight) in enumerate(zip(self.data.mobility, self._weight, strict=True)):
            flat = np.ascontiguousarray(stack * weight).view(np.float64)
            target = np.ascontiguousarray(y * weight).view(np.float64)
            length = np.maximum(np.sqrt(np.einsum("ij,ij->i", flat[:n], flat[:n])), 1e-150)
            # an orthogonal basis: normal equations of modes that overlap leave rounding of what the slopes add
            columns = np.vstack([flat[:n].T / length, np.sqrt(_RIDGE) * np.eye(n)])
            basis, triangle = sla.qr(columns, mode="economic", overwrite_a=True, check_finite=False)
            inverse = sla.solve_triangular(triangle, np.eye(n), check_finite=False)
            target = np.append(target, np.zeros(n))
            seen = basis.T @ target
            c, variance = inverse @ seen, np.einsum("ij,ij->i", inverse, inverse)
            left = target - basis @ seen
            out.cost += float(left @ left)
            out.residues[p], out.chi2[p] = c / length, c**2 / variance
            if not slopes:
                continue
            # slopes of the model in ln w, ln zeta: slopes of columns times residues
            pieces = flat[n:].reshape(len(by), 2, k, -1)
            slope = np.einsum("mk,mtkb->tkb", out.residues[p, : k * len(by)].reshape(-1, k), pieces).reshape(2 * k, -1)
            slope = np.pad(slope, ((0, 0), (0, n)))
            within = slope @ basis
            beside = slope - within @ basis.T
            out.normal += beside @ beside.T
            out.gradient += beside @ left
            out.follows.append(((inverse @ within.T) / length[:, None], variance / length**2))
        return out

    def model(self, poles: Poles, residues: Floats) -> Complexes:
        """(P, N) mobility of poles with residues."""
        return np.asarray(residues @ np.vstack([self.columns(poles)[0], self._edges]))

    def misfit(self, poles: Poles, residues: Floats) -> Complexes:
        """(P, N) data less the model."""
        return np.asarray(self.data.mobility - self.model(poles, residues))

    def deviations(self, poles: Poles) -> tuple[Floats, Floats, Floats]:
        """Standard deviations of ln w, ln zeta, (K,), and residues, (P, n), from the information matrix."""
        solution = self.solve(poles, slopes=True)
        covariance = sla.pinvh(solution.normal, rtol=1e-12)
        variances = [variance + np.einsum("ij,jk,ik->i", f, covariance, f) for f, variance in solution.follows]
        deviation, k = np.sqrt(np.maximum(np.diag(covariance), 0.0)), len(poles)
        return deviation[:k], deviation[k:], np.sqrt(np.maximum(variances, 0.0))
