"""A spring that hardens, with dashpots."""

from __future__ import annotations

from dataclasses import dataclass

from tonewood.physics.coupling.laws.base import LawArrays, LawKind, PotentialLaw


@dataclass(frozen=True, slots=True)
class HardeningSpring(PotentialLaw):
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
        """See `PotentialLaw`."""
        return p * p * (0.5 * self.stiffness + 0.25 * self.cubic * p * p)

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """See `PotentialLaw`."""
        total, squares, rate = new + old, new * new + old * old, (new - old) / dt
        f = total * (0.5 * self.stiffness + 0.25 * self.cubic * squares)
        f += (self.damping + self.quadratic_damping * abs(rate)) * rate
        slope = 0.5 * self.stiffness + 0.25 * self.cubic * (squares + 2 * new * total)
        return f, slope + (self.damping + 2 * self.quadratic_damping * abs(rate)) / dt

    def describe(self) -> LawArrays:
        """See `NonlinearLaw`."""
        numbers = (self.stiffness, self.cubic, self.quadratic_damping, 0.0)
        return LawArrays(LawKind.SPRING, numbers, damping=self.damping)
