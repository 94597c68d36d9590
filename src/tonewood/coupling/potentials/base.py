"""Potentials: energies V(y) of modal coordinates beside those of the modes, and what a system compiles them to.

A potential acts on the lowest modes of some components, whose mass-normalised coordinates y move by

    y'' + omega^2 y + losses = -dV/dy + forces.

It is stepped by a variable of its own, as in the scalar auxiliary variable methods (Shen, Xu, Yang, J. Comput. Phys.
353 (2018) 407; for mechanical systems Bilbao, Ducceschi, Zama, J. Comput. Phys. 472 (2023) 111697): with
psi = sqrt(2 (V + C)), over a step

    psi+ - psi = g . (y+ - y),      modal forces  -g psi_m,      psi_m = (psi+ + psi) / 2,

whose work is -[psi+^2 - psi^2] / 2 for any direction g that is known beforehand: so energy cannot rise whatever the
step and the amplitude, and a step is linear in one unknown for each potential (`potentials.solve`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tonewood.modal.modes import ModalBasis

Floats = NDArray[np.float64]


class Potential(ABC):
    """Declaration of a potential: immutable, without arrays.

    Attributes
    ----------
    name : unique among the potentials of a system.
    components : names of those whose coordinates it acts on; a component belongs to one potential at most.
    one_way : whether it is driven by its components and acts on another one, without an action on themselves.
    memory : numbers that it keeps in the state.
    label : word for its stored energy in accounts, ``NAME.LABEL``.
    effect : name of the effect that may leave it out; empty: it is never left out.
    """

    name: str
    components: tuple[str, ...]
    one_way: ClassVar[bool] = False
    memory: ClassVar[int]
    label: ClassVar[str] = "potential"
    effect: str = ""

    @property
    def targets(self) -> tuple[str, ...]:
        """Components on which a one-way potential acts."""
        return ()

    @abstractmethod
    def share(self, component: str, basis: ModalBasis, dt: float) -> Any:
        """Return the arrays of one component, which are kept with its compiled basis.

        Parameters
        ----------
        component : one of `components`.
        basis : its modes as they are stepped.
        dt : s, step.

        Raises
        ------
        ValueError : the basis does not have what the potential needs.
        """

    @abstractmethod
    def join(self, shares: Sequence[Any]) -> Any:
        """Return a `JoinedPotential` of the shares of all components, in their order; a one-way one another object."""


@dataclass(frozen=True, slots=True)
class Step:
    """Coordinates (n,) of one potential over one step, before its own force is known.

    Attributes
    ----------
    before : at the beginning.
    after : at the end under all forces but those of potentials and nonlinear connections.
    middle : after half the step under the same forces.
    answered : as `after`, under the forces on fast coordinates too (`JoinedPotential.fast`).
    compliance : displacement over the step per modal force held over it, s^2.
    gain : x / sin x, x = omega h / 2, by which a force held over the step acts as an impulse in its middle.
    row : numbers of the potential in the state.
    shift : C, J.
    """

    before: Floats
    after: Floats
    middle: Floats
    answered: Floats
    compliance: Floats
    gain: Floats
    row: Floats
    shift: float


class Kind(IntEnum):
    """Kinds of potentials in the kernel, in the order in which it steps them."""

    TENSION = 0
    LONGITUDINAL = 1
    PHANTOM = 2
    USER = 3


class JoinedPotential(ABC):
    """A potential as it is stepped, over n coordinates: those of its components one after another.

    Attributes
    ----------
    sizes : number of coordinates of each component, its lowest modes.
    """

    sizes: tuple[int, ...]

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return sum(self.sizes)

    @abstractmethod
    def energy(self, y: Floats) -> float:
        """V, J, at coordinates (n,), m sqrt(kg)."""

    @abstractmethod
    def stored(self, y: Floats, row: Floats) -> float:
        """Energy psi^2 / 2 - C that it stores in a state, J: V but for the error of the steps."""

    @abstractmethod
    def begin(self, y: Floats, row: Floats, energy: Callable[[], float]) -> tuple[float, float]:
        """C, J, and psi, sqrt(J), at coordinates; `energy` gives that of its modes, J."""

    def fast(self, before: Floats, after: Floats) -> Floats | None:
        """Modal forces (n,) on coordinates that follow at once over a step; None without any."""
        return None

    @abstractmethod
    def direction(self, step: Step) -> tuple[Floats, float]:
        """G (n,), and the mean tension that psi_m stands for, N / sqrt(J)."""

    @abstractmethod
    def end(
        self, y: Floats, row: Floats, shift: float, psi: float, tension: float, energy: Callable[[], float],
        pay: Callable[[float], float] | None,
    ) -> Floats:  # fmt: skip
        """Numbers of the state after a step.

        Parameters
        ----------
        y : (n,) coordinates.
        row : numbers before the step.
        shift, psi : C and psi after the step.
        tension : mean tension over the step, N.
        energy : gives the energy of its modes, J.
        pay : takes an energy from the kinetic energy of its modes, and returns the part that was paid, J; given at
            steps where psi is put back.
        """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what the kernel is loaded with: its ``kind``, and arrays by name."""
