"""Potentials: energies V(y) of modal coordinates beside those of the modes, and what a system compiles them to.

A potential acts on the lowest modes of some components, whose mass-normalised coordinates y move by

    y'' + omega^2 y + losses = -dV/dy + forces.

It is stepped by a variable of its own, as in the scalar auxiliary variable methods (Shen, Xu, Yang, J. Comput. Phys.
353 (2018) 407; for mechanical systems Bilbao, Ducceschi, Zama, J. Comput. Phys. 472 (2023) 111697): with
psi = sqrt(2 (V + C)), over a step

    psi+ - psi = g . (y+ - y),      modal forces  -g psi_m,      psi_m = (psi+ + psi) / 2,

whose work is -[psi+^2 - psi^2] / 2 for any direction g that is known beforehand: so energy cannot rise whatever the
step and the amplitude, and a step is linear in one unknown for each potential (`potentials.solve`). Here g is the
gradient of psi in the middle of the step (`coordinates.middle_of_step`), under all forces but those of potentials and
of nonlinear connections: a scheme of second order.

psi and the root of its potential part by the error of the steps. Every 64 samples psi is put back where psi^2 / 2 has
parted from V + C by more than a thousandth, and the kinetic energy of its modes pays for it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

#: of an energy, by which two sums of it may differ
SAME = 1e-13


class Potential(ABC):
    """Declaration of a potential: immutable, without arrays.

    Attributes
    ----------
    name : unique among the potentials of a system.
    components : names of those whose coordinates it acts on; a component belongs to one potential at most.
    one_way : whether it is driven by its components and acts on another one, without an action on themselves.
    memory : numbers that it keeps in the state; of two-way ones the excess of psi^2 / 2 - C over V, J, C, J, and
        psi, sqrt(J).
    label : word for its stored energy in accounts, ``NAME.LABEL``.
    effect : name of the effect that may leave it out; empty: it is never left out.
    """

    name: str
    components: tuple[str, ...]
    one_way: ClassVar[bool] = False
    memory: ClassVar[int] = 3
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
class MiddleOfStep:
    """What the direction of one potential over one step may depend on.

    middle : (n,) coordinates in the middle of the step (`ModalCoordinates.middle`), under all forces but those of
        potentials and nonlinear connections.
    answered : (n,) the same under the forces on fast coordinates too (`JoinedPotential.fast`).
    compliance : (n,) displacement over the step per modal force held over it, s^2.
    shift, psi : C, J, and psi, sqrt(J), before the step.
    """

    middle: Floats
    answered: Floats
    compliance: Floats
    shift: float
    psi: float


class Kind:
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
    tolerance : of V + C: excess of psi^2 / 2 up to which psi is not put back. Where psi is put back, at which sample
        depends on the rate, and the error of a string is no longer of order two.
    """

    sizes: tuple[int, ...]
    tolerance: ClassVar[float] = 1e-3

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return sum(self.sizes)

    @abstractmethod
    def energy(self, y: Floats) -> float:
        """V, J, at coordinates (n,), m sqrt(kg)."""

    @abstractmethod
    def direction(self, step: MiddleOfStep) -> Floats:
        """G (n,), sqrt(J) / (m sqrt(kg)): the gradient of psi in the middle of the step."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what the kernel is loaded with: its ``kind``, and arrays by name."""

    def shift(self, kept: float, stored: float, modes: Callable[[], float]) -> float:
        """C, J: such that V + C is not negative.

        Parameters
        ----------
        kept : J, that of the steps before; 0 to choose it.
        stored : J, V as it is stepped.
        modes : returns the energy of its modes, J.
        """
        return 0.0

    def fast(self, middle: Floats) -> Floats | None:
        """Modal forces (n,) on coordinates that follow at once over a step; None without any."""
        return None

    def stored(self, y: Floats, row: Floats) -> float:
        """Energy psi^2 / 2 - C that it stores in a state, J: V but for the error of the steps.

        Parameters
        ----------
        y : (n,) coordinates.
        row : (MEMORY,) its numbers in the state.
        """
        return self.energy(y) + float(row[0])

    def begin(self, y: Floats, row: Floats, modes: Callable[[], float]) -> tuple[float, float]:
        """C, J, and psi, sqrt(J), of a state."""
        stored = self.stored(y, row)
        shift = self.shift(float(row[1]), stored, modes)
        if shift == row[1] and abs(0.5 * row[2] ** 2 - shift - stored) <= SAME * (abs(stored) + abs(row[0]) + shift):
            return shift, float(row[2])  # near zero the root would not be as exact
        psi = float(np.sqrt(2 * max(stored + shift, 0.0)))
        return shift, -psi if row[2] < 0.0 else psi

    def moved(self, y: Floats, row: Floats) -> Floats:
        """Numbers of a state whose coordinates (n,) were set from outside, as by another basis.

        The excess is the error of the steps before, and may be far beyond V where they are: it is cut to the tolerance.
        """
        most = self.tolerance * max(self.energy(y) + float(row[1]), 0.0)
        return np.array([min(max(float(row[0]), -most), most), row[1], row[2]])

    def end(
        self, y: Floats, shift: float, psi: float, modes: Callable[[], float], pay: Callable[[float], float] | None
    ) -> Floats:
        """Numbers of the state after a step.

        Parameters
        ----------
        y : (n,) coordinates.
        shift, psi : C and psi after the step.
        modes : returns the energy of its modes, J.
        pay : takes an energy from the kinetic energy of its modes, and returns the part that was paid, J; given at
            steps where psi is put back.
        """
        value = self.energy(y)
        excess = 0.5 * psi * psi - shift - value
        if pay is not None:
            if abs(excess) > self.tolerance * (value + shift):
                excess += pay(-excess)
            shift = self.shift(0.0, value + excess, modes)
            psi = float(np.sqrt(2 * max(value + excess + shift, 0.0)))
        return np.array([excess, shift, psi])
