"""One checked quantity, which a validation prints and a test asserts.

A row is a *validation* where the system under test was given and the reference came from elsewhere. Where the system
was made so as to give the reference (a reconstruction's figures, a stand-in's level), the row shows only that this
still holds: a *regression*.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Row:
    """A value held against a reference that the code under test did not produce, or, as a regression, was made to give.

    Attributes
    ----------
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
