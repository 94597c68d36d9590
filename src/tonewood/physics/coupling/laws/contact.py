"""Contact that pushes one way: a power law with the loss of Hunt and Crossley."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from tonewood.physics.coupling.laws.base import CLOSE, LawArrays, LawKind, PotentialLaw


@dataclass(frozen=True, slots=True)
class Contact(PotentialLaw):
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
    one_sided: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not (self.stiffness >= 0.0 and self.exponent >= 1.0 and self.loss >= 0.0):
            raise ValueError("a contact needs stiffness and loss that are not negative and an exponent of 1 or more")

    def energy(self, p: float) -> float:
        """See `PotentialLaw`."""
        return float(self.stiffness / (self.exponent + 1) * max(p, 0.0) ** (self.exponent + 1))

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """See `PotentialLaw`."""
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

    def describe(self) -> LawArrays:
        """See `NonlinearLaw`."""
        return LawArrays(LawKind.CONTACT, (self.stiffness, self.exponent, 0.0, 0.0), self.loss)
