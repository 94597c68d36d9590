"""The three settings of ``--accuracy``: how many steps the engine makes per frame of the sound.

The error of a step grows with its length h: pitch as h^3 to h^4, laws of contact and tension as h^2. It also grows with
the number of modes stepped, all of which a force that is constant over the step drives alike; fewer modes at the same
rate are therefore no coarser setting (docs/accuracy.md). `draft` makes longer steps instead, which cost less. The
highest mode follows: 0.45 of the engine's rate.

``tonewood accuracy`` measures the cost of each and its error against `reference`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from tonewood.instrument.bundle.schema import Bundle
from tonewood.sound.render.options import AccuracyName


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One setting.

    name : of the setting.
    factor : ratio of the engine's rate to that at `standard`; None is the ratio that the bundle names for a draft.
    """

    name: AccuracyName
    factor: int | None = 1

    def oversampling(self, bundle: Bundle) -> Fraction:
        """Steps of the engine per frame, for an instrument."""
        return Fraction(bundle.draft_oversampling if self.factor is None else self.factor) * bundle.oversampling


#: for quick listening; for music; reference for the errors of the others
LEVELS: Mapping[AccuracyName, Accuracy] = {
    level.name: level for level in (Accuracy("draft", None), Accuracy("standard"), Accuracy("reference", 4))
}
