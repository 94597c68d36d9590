"""A potential given by samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.coupling.laws.base import CLOSE, LawArrays, LawKind, PotentialLaw
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class SampledPotential(PotentialLaw):
    """V(d) between samples, d = g - offset: f = -V'(d) (1 - loss d') - damping d', piecewise cubic and convex.

    Make one with `from_potential` or `from_force`. Outside the samples the force goes on in a straight line. Over a
    step f is the discrete gradient -[V(d+) - V(d)]/(d+ - d) (Greenspan 1984, Gonzalez 1996).

    Attributes
    ----------
    knots : (n + 1,) m, increasing.
    coefficients : (n, 4) of V = c0 + c1 u + c2 u^2 + c3 u^3, u = d - knots[i].
    loss : s/m, as in `Contact`; only for potentials that push one way, V' <= 0 at all samples.
    damping : N s/m, at all displacements.
    offset : gap at which the elongation d is zero, m.
    residual : as of `Contact`.
    """

    knots: Floats
    coefficients: Floats
    loss: float = 0.0
    damping: float = 0.0
    offset: float = 0.0
    residual: bool = True

    def __post_init__(self) -> None:
        x, c = self.knots, self.coefficients
        if x.ndim != 1 or len(x) < 2 or c.shape != (len(x) - 1, 4) or not np.all(np.diff(x) > 0):
            raise ValueError("a sampled potential needs two or more increasing displacements")
        u = np.diff(x)
        bends = np.stack([c[:, 2], c[:, 2] + 3 * c[:, 3] * u])
        slopes = np.stack([c[:, 1], c[:, 1] + u * (2 * c[:, 2] + 3 * c[:, 3] * u)])
        jumps = slopes[0, 1:] - slopes[1, :-1]
        if bends.min() < -1e-9 * np.abs(bends).max() or jumps.min(initial=0.0) < -1e-9 * np.abs(slopes).max():
            raise ValueError("a sampled potential must be convex: its force may not turn back")
        if not (self.loss >= 0.0 and self.damping >= 0.0):
            raise ValueError("loss and damping must not be negative")
        if self.loss > 0.0 and slopes.max() > 1e-9 * np.abs(slopes).max():
            raise ValueError("a loss that grows with the force is for potentials that push one way only")

    @classmethod
    def from_potential(cls, displacement: ArrayLike, potential: ArrayLike, **options: Any) -> SampledPotential:
        """Make one from samples of V, joined by the not-a-knot cubic spline.

        Parameters
        ----------
        displacement, potential : (n,) d, m, increasing; V, J.
        options : loss, damping, offset, residual.
        """
        from scipy.interpolate import CubicSpline

        x = np.asarray(displacement, dtype=np.float64)
        spline = CubicSpline(x, np.asarray(potential, dtype=np.float64))
        return cls(x, np.ascontiguousarray(spline.c[::-1].T), **options)

    @classmethod
    def from_force(cls, displacement: ArrayLike, force: ArrayLike, **options: Any) -> SampledPotential:
        """Make one from samples of the force -V'(d), joined by straight lines; V is 0 at the first.

        Parameters
        ----------
        displacement, force : (n,) d, m, increasing; -V', N, falling.
        options : loss, damping, offset, residual.
        """
        x, slope = np.asarray(displacement, dtype=np.float64), -np.asarray(force, dtype=np.float64)
        u, bend = np.diff(x), np.diff(slope) / np.diff(x)
        V = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * u)])
        return cls(x, np.stack([V[:-1], slope[:-1], bend / 2, np.zeros_like(bend)], axis=1), **options)

    def _at(self, d: float) -> tuple[float, float, float]:
        """V, V', V'' at d."""
        x, c = self.knots, self.coefficients
        i = int(np.clip(np.searchsorted(x, d, side="right") - 1, 0, len(c) - 1))
        inside = min(max(d, float(x[0])), float(x[-1]))
        u, out = inside - float(x[i]), d - inside
        c0, c1, c2, c3 = (float(v) for v in c[i])
        value, slope, bend = c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2 * c2 + 3 * c3 * u), 2 * c2 + 6 * c3 * u
        return value + out * (slope + 0.5 * bend * out), slope + bend * out, bend

    def energy(self, p: float) -> float:
        """See `PotentialLaw`."""
        return self._at(-p)[0]

    def _gained(self, a: float, b: float) -> float:
        """V(b) - V(a) without cancellation, for a <= b: cell by cell, by divided differences."""
        x, c = self.knots, self.coefficients
        total, first, last = 0.0, float(x[0]), float(x[-1])
        for low, high, edge in ((a, min(b, first), first), (max(a, last), b, last)):
            if low < high:
                _, slope, bend = self._at(edge)
                total += (high - low) * (slope + 0.5 * bend * ((low - edge) + (high - edge)))
        a, b = max(a, first), min(b, last)
        i = int(np.clip(np.searchsorted(x, a, side="right") - 1, 0, len(c) - 1))
        while a < b:
            end = min(b, float(x[i + 1]))
            u, v = a - float(x[i]), end - float(x[i])
            total += (end - a) * float(c[i, 1] + c[i, 2] * (u + v) + c[i, 3] * (u * u + u * v + v * v))
            a, i = end, i + 1
        return total

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """See `PotentialLaw`."""
        low, high = min(-new, -old), max(-new, -old)
        at_new = self._at(-new)[1]
        gradient = -(self._gained(low, high) / (high - low) if high > low else at_new)
        if high - low <= CLOSE * max(abs(low), abs(high)):
            slope = 0.5 * self._at(0.5 * (low + high))[2]
        else:
            slope = max((-at_new - gradient) / (new - old), 0.0)
        rate = (new - old) / dt
        f = gradient + (self.loss * abs(gradient) + self.damping) * rate
        return f, slope + (self.loss * abs(at_new) + self.damping) / dt

    def describe(self) -> LawArrays:
        """See `NonlinearLaw`."""
        samples = self.knots.tolist(), self.coefficients.reshape(-1).tolist()
        return LawArrays(LawKind.SAMPLED, loss=self.loss, damping=self.damping, samples=samples)
