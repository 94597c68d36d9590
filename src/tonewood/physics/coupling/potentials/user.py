"""Potentials of one's own: V(y) and its gradient, in Python or as a C function, stepped like those of tonewood.

A `PotentialEnergy` gives V and dV/dy of the coordinates y of some components' lowest modes; `ModalPotential` names
these components. It is stepped by psi = sqrt(2 (V + C)) (`potentials.base`) with

    g = dV/dy / sqrt(2 (V + C)) at y*,

y* the coordinates in the middle of the step (`ModalCoordinates.middle`) under all forces but those of potentials and
nonlinear connections. The scheme is of second order. Every 64 steps psi is put back to sqrt(2 (V + C)), and the kinetic
energy of the modes pays for it.

The energy of the modes and psi^2 / 2 - C together do not rise, whatever V is. What else V has to fulfil:

====================  =================================================================================================
bounded from below    V >= `PotentialEnergy.least`. Where it falls below, psi^2 / 2 - C stays above and parts from V:
                      nothing grows, but the motion is no longer that of V. A render ends there: of V in Python at the
                      first coordinates where it is asked for, of a C function where V is below at the end of a run.
smooth                twice differentiable, and so is sqrt(V + C). A V with a quadratic minimum at `least` has a kink in
                      sqrt(V - least): give a `scale` (J), about the energies that matter; it makes C = scale - least. A
                      sum of squares of quadratic forms needs none. With a kink the energy still balances, but the order
                      falls to one.
slow against a step   no stiffer than the highest modes: the error grows with the square of h^2 V''. A stiff quadratic
                      part belongs to the modes.
psi near V            psi^2 / 2 - C and V part by the error of the steps, and are put back while a quarter of the
                      kinetic energy pays for it. Where it does not, the steps are too long for this V.
====================  =================================================================================================
"""

from __future__ import annotations

import ctypes
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError, words_of
from tonewood.physics.coupling.c_functions import CFunction
from tonewood.physics.coupling.potentials.base import SAME, JoinedPotential, Kind, MiddleOfStep, Potential
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

_DOUBLES = ctypes.POINTER(ctypes.c_double)
#: C type of a potential: data, number of coordinates, coordinates, gradient (NULL: energy alone), scratch
FUNCTION = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_int64, _DOUBLES, _DOUBLES, _DOUBLES)
_SIGNATURES = tuple(
    f"double(void*,{n},double*,double*,double*)" for n in ("long", "longlong", "int64_t", "longint", "int")
)
#: J, and share of the energies at hand, by which V may be below `least`: rounding
_ROUNDING, _SHARE = 1e-12, 1e-9


class PotentialFunction(CFunction):
    """A C function of a potential, by its address.

        double potential(const void* data, int64_t n, const double* y, double* gradient, double* scratch)

    returns V (J) of n coordinates and writes dV/dy unless `gradient` is NULL. It allocates nothing and keeps nothing.

    Parameters
    ----------
    function : argument of SciPy's `LowLevelCallable`, which may carry `data`; or a ctypes pointer of type `FUNCTION`.
    data : array that it reads, kept alive; in place of data of a `LowLevelCallable`.
    scratch : numbers that it may write to while it runs.

    Raises
    ------
    ValueError : another signature.
    """

    def __init__(self, function: Any, data: NDArray[Any] | None = None, scratch: int = 0):
        super().__init__(function, _SIGNATURES)
        self.scratch, self._kept = scratch, data
        if data is not None:
            self.data = data.ctypes.data


class PotentialEnergy(JoinedPotential):
    """V(y) of the lowest modes of some components; see the module for what it has to fulfil.

    Attributes
    ----------
    sizes : number of coordinates of each component, its lowest modes.
    least : J, V is nowhere below it.
    scale : J, added to V - least under the root of psi; 0 where sqrt(V - least) is smooth.
    """

    #: with 1e-3 a plate at 96 kHz is no nearer to its motion than at 48
    tolerance: ClassVar[float] = 1e-7
    least: float = 0.0
    scale: float = 0.0

    #: what `gradient` or `energy` raised while C++ called it, which lets no exception through
    fault: BaseException | None = None

    @abstractmethod
    def gradient(self, y: Floats) -> tuple[float, Floats]:
        """V, J, and dV/dy (n,), N / sqrt(kg), at coordinates (n,), m sqrt(kg)."""

    def energy(self, y: Floats) -> float:
        """V, J; override it where it is quicker than the gradient."""
        return self.checked(y)[0]

    def checked(self, y: Floats) -> tuple[float, Floats]:
        """Return `gradient` at coordinates (n,), m sqrt(kg).

        Raises
        ------
        TonewoodError : it raises, returns anything but a number and n numbers, or V is below `least`; one line.
        """
        value, slope = self.called(y)
        self.check_bound(value, float(np.abs(slope @ y)))
        return value, slope

    def called(self, y: Floats) -> tuple[float, Floats]:
        """As `checked`, for any V.

        Raises
        ------
        TonewoodError : `gradient` raises, or returns anything but a number and n numbers; one line.
        """
        name = f"{type(self).__name__}.gradient"
        try:
            value, slope = self.gradient(np.array(y))
            value, slope = float(value), np.asarray(slope).astype(np.float64, casting="same_kind")
        except TonewoodError:
            raise
        except (Exception, SystemExit) as error:
            raise TonewoodError(f"{name} raises {words_of(error)}") from error
        if slope.shape != (self.n,):
            raise TonewoodError(f"{name}: dV/dy has shape {slope.shape}, not ({self.n},)")
        return value, slope

    def check_bound(self, value: float, scale: float = 0.0) -> None:
        """Refuse a V below `least` by more than rounding.

        Parameters
        ----------
        value : V, J.
        scale : J, of which 1e-9 count as rounding, beside that of `least` and `scale`.

        Raises
        ------
        TonewoodError : it is below; one line.
        """
        if value < self.least - _ROUNDING - _SHARE * (abs(self.least) + self.scale + scale):
            raise TonewoodError(
                f"{type(self).__name__}: V = {value:.6g} J is below `least` = {self.least:g} J in the motion: V must "
                "be bounded from below"
            )

    def check_state(self, row: Floats) -> None:
        """As `check_bound`, of V at the end of a run: `row` are its numbers in the state."""
        excess, shift, psi = row
        self.check_bound(float(0.5 * psi * psi - shift - excess), float(psi * psi + abs(shift)))

    def function(self) -> PotentialFunction | None:
        """The same as a C function, at whose speed the kernel steps it; None: the kernel calls `gradient`, slowly."""
        return None

    def shift(self, kept: float, stored: float, modes: Callable[[], float]) -> float:
        """C, J."""
        return self.scale - self.least

    def direction(self, step: MiddleOfStep) -> Floats:
        """See `JoinedPotential`."""
        value, gradient = self.checked(step.middle)
        size = np.sqrt(2 * max(value + step.shift, 0.0))
        return gradient / size if size > 0.0 else np.zeros(len(gradient))

    @cached_property
    def c_function(self) -> PotentialFunction:
        """`function`, or `gradient` behind a pointer."""
        return self.function() or PotentialFunction(FUNCTION(self._called))

    def _called(self, data: Any, n: int, y: Any, gradient: Any, scratch: Any) -> float:
        at = np.ctypeslib.as_array(y, (n,)).copy()
        try:
            if not gradient:
                value = float(self.energy(at))
                self.check_bound(value)
                return value
            value, np.ctypeslib.as_array(gradient, (n,))[:] = self.checked(at)
        except BaseException as error:  # raised again by `raise_fault`; what is not finite ends the kernel's run
            vars(self)["fault"] = self.fault or error
            if gradient:
                np.ctypeslib.as_array(gradient, (n,))[:] = np.nan
            return float("nan")
        return value

    def stepped(self, y: Floats) -> tuple[float, Floats]:
        """Return V, J, and dV/dy as the kernel gets them: V by a call without a gradient, both of `c_function`.

        Raises
        ------
        TonewoodError : as `checked`.
        """
        f, at, slope, scratch = (
            self.c_function,
            np.array(y),
            np.zeros(len(y)),
            np.zeros(max(self.c_function.scratch, 1)),
        )
        pointers = [array.ctypes.data_as(_DOUBLES) for array in (at, slope, scratch)]
        call = FUNCTION(f.address)
        call(f.data or None, len(y), *pointers)
        value = call(f.data or None, len(y), pointers[0], None, pointers[2])
        self.raise_fault()
        return float(value), slope

    def raise_fault(self) -> None:
        """Raise what a call from C++ could not."""
        if (fault := vars(self).pop("fault", None)) is not None:
            raise fault

    def describe(self) -> dict[str, Any]:
        """See `JoinedPotential`."""
        f = self.c_function
        calls = {"function": f.address, "data": f.data, "scratch": f.scratch}
        return {"kind": Kind.USER, "scale": self.scale - self.least, "sizes": list(self.sizes), **calls}


@dataclass(frozen=True, eq=False)
class ModalPotential(Potential):
    """A potential of one's own on some components.

    Attributes
    ----------
    name : unique among the potentials of a system.
    components : of real modes; each belongs to one potential at most.
    energy : returns V of the components' modes as they are stepped; called anew when one is exchanged.
    effect : name of the effect that may leave it out; empty: it is never left out.
    """

    name: str
    components: tuple[str, ...]
    energy: Callable[[Sequence[ModalBasis]], PotentialEnergy]
    effect: str = ""

    def share(self, component: str, basis: ModalBasis, dt: float) -> ModalBasis:
        """Return the modes themselves."""
        return basis

    def join(self, shares: Sequence[ModalBasis]) -> PotentialEnergy:
        """Return V of all components.

        Raises
        ------
        TonewoodError : V has more coordinates than a component has modes, or is not finite at rest or below `least`.
        """
        energies = self.energy(shares)
        for component, size, basis in zip(self.components, energies.sizes, shares, strict=True):
            if not 0 <= size <= basis.n_modes:
                raise TonewoodError(
                    f"potential {self.name}: {component} has {basis.n_modes} modes, not {size} coordinates"
                )
        value, slope = energies.called(np.zeros(energies.n))
        if not (np.isfinite(value) and np.all(np.isfinite(slope))):
            raise TonewoodError(f"potential {self.name}: V or dV/dy is not finite at rest")
        if value < energies.least - SAME * abs(energies.least):
            raise TonewoodError(
                f"potential {self.name}: V = {value:g} J at rest is below `least` = {energies.least:g} J"
            )
        return energies
