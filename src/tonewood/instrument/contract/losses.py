"""Loss laws of strings, plugins of a kind of their own; `law_field` is the type of a parameter that is one."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

from tonewood.instrument.contract.plugin import P, Plugin
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class StringData:
    """A uniform string under tension, as a loss law is told of it.

    Attributes
    ----------
    tension : T, N.
    linear_density : mu, kg/m.
    bending_stiffness : EI, N m^2.
    """

    tension: float
    linear_density: float
    bending_stiffness: float = 0.0


class Loss(Plugin[P]):
    """A law of loss: the loss factor of a string's partials, as measurements of strings give it.

    A bundle names it by the key ``law`` of a string's ``loss``, with the law's own parameters beside it; a string takes
    one by a parameter of the type `ta.LossLaw`.

    Attributes
    ----------
    law : its name in the bundle; empty where it was made in Python.
    """

    kind = "loss"
    law: str = ""

    def __eq__(self, other: object) -> bool:
        """Whether it is the same law with the same numbers: parameters of strings that hold it are then equal."""
        return isinstance(other, Loss) and type(self) is type(other) and self.parameters == other.parameters

    def __hash__(self) -> int:
        return hash((type(self), self.parameters))

    @abstractmethod
    def eta(self, omega: Floats, k: Floats, string: StringData) -> Floats:
        """Return the loss factor of partials between fixed ends.

            eta = 1 / Q = 2 sigma / omega,      T60 = ln(1000) / sigma

        Parameters
        ----------
        omega : (n,) rad/s, above 0, of the partials without loss.
        k : (n,) 1/m, their wavenumbers.
        string : its tension, mass and stiffness.

        Returns
        -------
        (n,) or a single number, 0 or more.
        """
