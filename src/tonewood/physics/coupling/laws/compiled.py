"""A potential given as C functions."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.physics.coupling.c_functions import CFunction
from tonewood.physics.coupling.laws.base import CLOSE, LawArrays, LawKind, PotentialLaw

#: nodes and weights of Gauss' rule on [-1, 1] that integrates user forces over small steps
GAUSS = tuple((float(x), float(w)) for x, w in zip(*np.polynomial.legendre.leggauss(5), strict=True))


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
class CompiledPotential(PotentialLaw):
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
            function = getattr(self, name)
            object.__setattr__(self, name, function if isinstance(function, Scalar) else Scalar(function))
        if not (self.loss >= 0.0 and self.damping >= 0.0):
            raise ValueError("loss and damping must not be negative")

    def energy(self, p: float) -> float:
        """See `PotentialLaw`."""
        return float(self.potential(-p))

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """See `PotentialLaw`."""
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

    def describe(self) -> LawArrays:
        """See `NonlinearLaw`."""
        scalars: tuple[Scalar, Scalar] = (self.potential, self.slope)
        functions = tuple((f.address, f.data, f.takes_data) for f in scalars)
        return LawArrays(LawKind.COMPILED, loss=self.loss, damping=self.damping, functions=functions)
