"""Nonlinear laws of a connection, each made discrete so that over a step it can only store energy or lose it.

A law acts on the compression p of a gap g: p = offset - g, and pushes the gap open with f = U'(p) + loss. Over a step

    f = [U(p+) - U(p)] / (p+ - p) + loss,        work on the gap: f (g+ - g) = -[U(p+) - U(p)] - loss >= 0,

the discrete gradient, written here without the cancellation of that quotient; so no law creates energy, whatever the
step, the stiffness or the force. Each law but friction is monotone in p+: with a positive semi-definite compliance Z
the equation p+ = p_u - Z f(p+) is the minimum of a convex function and has one solution, for all connections together.

`force(new, old, dt)` returns f and its slope df/dp+ >= 0. Laws that are written for the elongation d = g - offset
(`SampledPotential`, `CompiledPotential`) take V(d) = U(-d).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.coupling.c_functions import CFunction

Floats = NDArray[np.float64]

#: closer than this, relative to the compressions, slopes of discrete gradients are taken at the middle
CLOSE = 1e-4
#: nodes and weights of Gauss' rule on [-1, 1] that integrates user forces over small steps
GAUSS = tuple((float(x), float(w)) for x, w in zip(*np.polynomial.legendre.leggauss(5), strict=True))


class PotentialLaw(Protocol):
    """Interface of a law with a potential."""

    @property
    def offset(self) -> float:
        """Gap at which the compression is zero, m."""

    @property
    def residual(self) -> bool:
        """Whether the residual compliance of the components acts in series with the law."""

    def energy(self, p: float) -> float:
        """Return U(p), J."""

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Return the force over a step, N, and its slope with `new`, N/m.

        Parameters
        ----------
        new, old : compressions p after and before the step, m.
        dt : s, length of the step.
        """


@dataclass(frozen=True, slots=True)
class Contact:
    """One-sided power law with the loss of Hunt and Crossley (1975): f = K p^alpha (1 + loss p') where p > 0.

    U = K <p>^(alpha + 1) / (alpha + 1). The loss is taken as ``loss`` f_U p', with f_U the discrete gradient; that is
    loss [U(p+) - U(p)] / h, as monotone as U itself.

    Attributes
    ----------
    stiffness : K, N / m^alpha.
    exponent : alpha >= 1.
    loss : s/m.
    offset : gap below which it pushes, m.
    residual : whether the components' residual compliance yields too; see `connections`.
    """

    stiffness: float
    exponent: float = 1.0
    loss: float = 0.0
    offset: float = 0.0
    residual: bool = True

    def __post_init__(self) -> None:
        if not (self.stiffness >= 0.0 and self.exponent >= 1.0 and self.loss >= 0.0):
            raise ValueError("a contact needs stiffness and loss that are not negative and an exponent of 1 or more")

    def energy(self, p: float) -> float:
        """Return U(p), J."""
        return float(self.stiffness / (self.exponent + 1) * max(p, 0.0) ** (self.exponent + 1))

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Return force (N) and slope (N/m) over a step of `dt` s from compression `old` to `new`, m."""
        high, low = (new, old) if new > old else (old, new)
        if high <= 0.0:
            return 0.0, 0.0
        K, n = self.stiffness, self.exponent
        at_high, step = K * high**n, high - low
        if low <= 0.0:
            gradient = at_high * high / ((n + 1) * step)
        elif step > high * 0.999:
            gradient = (at_high * high - K * low ** (n + 1)) / ((n + 1) * step)
        elif step > 0.0:
            ratio = step / low
            gradient = K / (n + 1) * low**n * math.expm1((n + 1) * math.log1p(ratio)) / ratio
        else:
            gradient = at_high
        at_new = K * max(new, 0.0) ** n
        if step < CLOSE * high:
            slope = 0.5 * K * n * max(0.5 * (high + low), 0.0) ** (n - 1)
        else:
            slope = max((at_new - gradient) / (new - old), 0.0)
        rate = self.loss * (new - old) / dt
        return gradient * (1 + rate), slope + self.loss * at_new / dt


@dataclass(frozen=True, slots=True)
class HardeningSpring:
    """Two-sided spring and dashpots: f = k p + k3 p^3 + c p' + d p' |p'|.

    Discrete gradient k (p+ + p)/2 + k3 (p+ + p)(p+^2 + p^2)/4 (Greenspan 1984, Gonzalez 1996); the dashpots see the
    mean rate.

    Attributes
    ----------
    stiffness : k, N/m.
    cubic : k3, N/m^3.
    damping : c, N s/m.
    quadratic_damping : d, N s^2/m^2.
    offset : gap at which the compression p is zero, m.
    residual : whether the components' residual compliance yields too; see `connections`.
    """

    stiffness: float = 0.0
    cubic: float = 0.0
    damping: float = 0.0
    quadratic_damping: float = 0.0
    offset: float = 0.0
    residual: bool = True

    def __post_init__(self) -> None:
        if not min(self.stiffness, self.cubic, self.damping, self.quadratic_damping) >= 0.0:
            raise ValueError("stiffness and damping of a spring must not be negative")

    def energy(self, p: float) -> float:
        """Return U(p), J."""
        return p * p * (0.5 * self.stiffness + 0.25 * self.cubic * p * p)

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Return force (N) and slope (N/m) over a step of `dt` s from compression `old` to `new`, m."""
        total, squares, rate = new + old, new * new + old * old, (new - old) / dt
        f = total * (0.5 * self.stiffness + 0.25 * self.cubic * squares)
        f += (self.damping + self.quadratic_damping * abs(rate)) * rate
        slope = 0.5 * self.stiffness + 0.25 * self.cubic * (squares + 2 * new * total)
        return f, slope + (self.damping + 2 * self.quadratic_damping * abs(rate)) / dt


@dataclass(frozen=True, eq=False)
class SampledPotential:
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
        """Return U(p), J."""
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
        """Return force (N) and slope (N/m) over a step of `dt` s from compression `old` to `new`, m."""
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


class Scalar(CFunction):
    """A C function double(double) or double(double, void *)."""

    def __init__(self, function: Any):
        super().__init__(function, ("double(double)", "double(double,void*)"))
        self.takes_data = "void" in self.signature
        arguments = (ctypes.c_double, ctypes.c_void_p)[: 2 if self.takes_data else 1]
        self._call: Callable[..., float] = ctypes.CFUNCTYPE(ctypes.c_double, *arguments)(self.address)

    def __call__(self, x: float) -> float:
        """Value at x."""
        return float(self._call(x, self.data) if self.takes_data else self._call(x))


@dataclass(frozen=True, eq=False)
class CompiledPotential:
    """A potential given as C functions of the elongation d = g - offset: f = -V'(d) (1 - loss d') - damping d'.

    The discrete gradient is the quotient of V where that is accurate, and Gauss' rule over V' where the quotient
    cancels: the two differ by the rounding of the quotient, so that they agree to it where they meet.
    V should be convex; otherwise a step may have several solutions, and the one found is the nearest to the last.

    Attributes
    ----------
    potential, slope : V (J) and V' (N), each an argument of `Scalar`.
    loss : s/m, f loses `loss` |V'| d'; monotone for potentials that push one way.
    damping : N s/m.
    offset : gap at which the elongation d is zero, m.
    residual : as of `Contact`.
    """

    potential: Any
    slope: Any
    loss: float = 0.0
    damping: float = 0.0
    offset: float = 0.0
    residual: bool = True

    def __post_init__(self) -> None:
        for name in ("potential", "slope"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if isinstance(given, Scalar) else Scalar(given))
        if not (self.loss >= 0.0 and self.damping >= 0.0):
            raise ValueError("loss and damping must not be negative")

    def energy(self, p: float) -> float:
        """Return U(p), J."""
        return float(self.potential(-p))

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Return force (N) and slope (N/m) over a step of `dt` s from compression `old` to `new`, m."""
        step, middle = new - old, 0.5 * (new + old)
        gradient = 0.5 * sum(weight * -self.slope(-(middle + 0.5 * step * node)) for node, weight in GAUSS)
        if step != 0.0:
            V_new, V_old = self.potential(-new), self.potential(-old)
            quotient = (V_new - V_old) / step
            if abs(quotient - gradient) > 2e-15 * (abs(V_new) + abs(V_old)) / abs(step):
                gradient = quotient
        at_new, size = -self.slope(-new), max(abs(new), abs(old))
        if abs(step) < CLOSE * size or step == 0.0:
            reach = CLOSE * size if size > 0.0 else 1e-12
            slope = (self.slope(-(middle - reach)) - self.slope(-(middle + reach))) / (4 * reach)
        else:
            slope = (at_new - gradient) / step
        rate = step / dt
        f = gradient + (self.loss * abs(gradient) + self.damping) * rate
        return f, max(slope, 0.0) + (self.loss * abs(at_new) + self.damping) / dt


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry friction against a moving partner, as of a bow: |f| <= static N at rest, mu(v) N sliding.

    mu(v) = dynamic + (static - dynamic) / (1 + |v| / speed) for the velocity v = g' - velocity, f against v
    (Smith & Woodhouse 2000, J. Mech. Phys. Solids 48, their hyperbola). At rest v is exactly 0 over the step.

    The curve falls, so a step may have three solutions. As McIntyre, Schumacher & Woodhouse (1983) take it from
    Friedlander: a gap that stuck goes on sticking while it can; one that slid goes on sliding that way while it can, on
    the outermost (stable) solution; otherwise it sticks if it can. The work f (g+ - g) is f velocity h from the partner
    minus |f v| h of heat.

    Attributes
    ----------
    normal_force : N, pressing the two together.
    static, dynamic : friction coefficients, static >= dynamic >= 0.
    speed : m/s, at which half of their difference is gone.
    velocity : m/s, of the partner along the gap.
    residual : whether the components' residual compliance yields too; unstable with friction on short steps.
    """

    normal_force: float
    static: float = 0.8
    dynamic: float = 0.3
    speed: float = 0.1
    velocity: float = 0.0
    residual: bool = False

    def __post_init__(self) -> None:
        if not (self.normal_force >= 0.0 and self.static >= self.dynamic >= 0.0 and self.speed > 0.0):
            raise ValueError("friction needs static >= dynamic >= 0, a normal force not negative and a speed above 0")

    @property
    def offset(self) -> float:
        """Friction has no place of its own."""
        return 0.0

    def slide(self, free: float, load: float) -> float | None:
        """Return the largest v > 0 with v + load mu(v) = free, m/s; None if there is none.

        Parameters
        ----------
        free : m/s, velocity without friction.
        load : m/s, velocity that a friction coefficient of 1 takes away.

        Returns
        -------
        The larger root of a quadratic, on the stable branch of the curve.
        """
        a = self.speed
        linear = a + load * self.dynamic - free
        constant = a * (load * self.static - free)
        root = linear * linear - 4 * constant
        if root < 0.0:
            return None
        root = math.sqrt(root)
        v = 0.5 * (root - linear) if linear <= 0.0 else -2 * constant / (linear + root)
        return v if v > 0.0 else None

    def slide_on(self, free: float, load: float) -> float:
        """Return `slide`, or its continuation where there is no such v: continuous in `free` and `load`."""
        v = self.slide(free, load)
        if v is not None:
            return v
        return max(math.sqrt(load * (self.static - self.dynamic) * self.speed) - self.speed, 0.0)

    def velocity_after(self, free: float, load: float, before: float) -> float:
        """Return the relative velocity over the step, m/s, 0 for sticking; see the class for the choice of the branch.

        Parameters
        ----------
        free, load : as for `slide`.
        before : m/s, relative velocity in the last step.
        """
        if before != 0.0:
            side = math.copysign(1.0, before)
            v = self.slide(side * free, load)
            if v is not None:
                return side * v
        if abs(free) <= load * self.static:
            return 0.0
        side = math.copysign(1.0, free)
        v = self.slide(side * free, load)
        return side * v if v is not None else 0.0


NonlinearLaw = Contact | HardeningSpring | SampledPotential | CompiledPotential | Friction
