"""One checked quantity, which a validation prints and a test asserts, and errors that many of them state.

A row is a *validation* where the system under test was given and the reference came from elsewhere. Where the system
was made so as to give the reference (a reconstruction's figures, a stand-in's level), the row shows only that this
still holds: a *regression*.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tonewood.support.arrays import Complexes


@dataclass(frozen=True, slots=True)
class Row:
    """A value held against a reference that the code under test did not produce, or, as a regression, was made to give.

    system, quantity : the quantity computed, and its system.
    source : where the reference comes from (paper and equation or table, closed form, direct solution).
    reference, value : in the unit named by `quantity`.
    tolerance : largest error that passes.
    relative : whether the error is |value - reference| / |reference| rather than the plain difference.
    kind : ``validation``, or ``regression`` where the system was fitted to the reference.
    """

    system: str
    quantity: str
    source: str
    reference: float
    value: float
    tolerance: float
    relative: bool = False
    kind: Literal["validation", "regression"] = "validation"

    @property
    def error(self) -> float:
        """Absolute or relative error."""
        difference = abs(self.value - self.reference)
        return difference / abs(self.reference) if self.relative else difference

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the tolerance."""
        return bool(self.error <= self.tolerance)

    def to_dict(self) -> dict[str, object]:
        """Fields for JSON, with ``error`` and ``pass``."""
        return {**asdict(self), "error": self.error, "pass": self.passed}


def misfit(values: ArrayLike, expected: ArrayLike) -> float:
    """Largest difference, relative to the largest expected value."""
    reference = np.asarray(expected)
    return float(np.abs(np.asarray(values) - reference).max() / np.abs(reference).max())


def nearest(poles: Complexes, exact: complex) -> complex:
    """The pole that stands for an exact one."""
    return complex(poles[np.argmin(np.abs(poles - exact))])


def pole_error(poles: Complexes, exact: Complexes) -> float:
    """Largest relative distance from an exact pole to the nearest of `poles`."""
    return max(float(abs(nearest(poles, p) - p) / abs(p)) for p in exact)


def cents(value: complex, reference: complex) -> float:
    """Interval between the frequencies of two poles."""
    return float(1200 * np.log2(value.imag / reference.imag))


def halving_order(coarse: float, fine: float) -> float:
    """Order in the step of errors found with some step and with half of it."""
    return float(np.log2(coarse / fine))
