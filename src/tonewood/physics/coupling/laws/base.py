"""Nonlinear laws of a connection: what they are, discrete so that over a step each can only store or lose energy.

A law acts on the compression p of a gap g: p = offset - g, and pushes the gap open with f = U'(p) + loss. Over a step

    f = [U(p+) - U(p)] / (p+ - p) + loss,        work on the gap: f (g+ - g) = -[U(p+) - U(p)] - loss >= 0,

the discrete gradient, written here without the cancellation of that quotient; so no law creates energy, whatever the
step, the stiffness or the force. Each law but friction is monotone in p+: with a positive semi-definite compliance Z
the equation p+ = p_u - Z f(p+) is the minimum of a convex function and has one solution, for all connections together.

Laws that are written for the elongation d = g - offset (`SampledPotential`, `CompiledPotential`) take V(d) = U(-d).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

#: closer than this, relative to the compressions, slopes of discrete gradients are taken at the middle
CLOSE = 1e-4


class LawKind:
    """Kinds of laws in the kernel, one file each in ``src/kernel/connect/laws``."""

    CONTACT = 0
    SPRING = 1
    SAMPLED = 2
    COMPILED = 3
    FRICTION = 4


@dataclass(frozen=True, slots=True)
class LawArrays:
    """What the kernel is loaded with for one law.

    kind : one of `LawKind`.
    numbers : four of its own.
    loss, damping : s/m, N s/m.
    samples : its knots (n + 1), and four coefficients for each of n intervals one after another.
    functions : address, data, and whether it takes them, of each C function.
    """

    kind: int
    numbers: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    loss: float = 0.0
    damping: float = 0.0
    samples: tuple[list[float], list[float]] | None = None
    functions: tuple[tuple[int, int, bool], ...] = ()


class NonlinearLaw(ABC):
    """A law whose force is no linear function of the gap and its motion; immutable.

    Attributes
    ----------
    one_sided : whether it pushes from a clearance on, and else does nothing: it is culled where it cannot touch.
    """

    __slots__ = ()
    one_sided: ClassVar[bool] = False

    @property
    @abstractmethod
    def offset(self) -> float:
        """Gap at which the compression is zero, m."""

    @property
    @abstractmethod
    def residual(self) -> bool:
        """Whether the residual compliance of the components acts in series with the law."""

    @property
    def velocity(self) -> float:
        """Velocity of the partner along the gap, m/s."""
        return 0.0

    @abstractmethod
    def describe(self) -> LawArrays:
        """Return what the kernel is loaded with."""


class PotentialLaw(NonlinearLaw):
    """A law with a potential."""

    __slots__ = ()

    @abstractmethod
    def energy(self, p: float) -> float:
        """Return U(p), J."""

    @abstractmethod
    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Return the force over a step, N, and its slope with `new`, N/m, not negative.

        Parameters
        ----------
        new, old : compressions p after and before the step, m.
        dt : s, length of the step.
        """
