"""Keys of the bundle format: lumps fixed to the body."""

from __future__ import annotations

from pydantic import model_validator

from tonewood.instrument.contract.directions import Direction
from tonewood.support.params import Parameters, described, quantity

#: kg, N/m, N s/m: smaller values change no body, and their squares underflow
_LEAST = 1e-9


class Added(Parameters):
    """A mass, a spring to the ground or a dashpot to the ground, fixed to the body; those of one entry move as one.

    With `frequency` and `q` the mass hangs on the body by a spring and a dashpot: a tuned damper, as a wolf eliminator.
    """

    at: str = described("point of the body")
    direction: Direction | None = described("in which it acts; the point's own where left out", default=None)
    mass: float = quantity("kg", low=0.0, high=5.0, default=0.0, doc="that moves with the point")
    stiffness: float = quantity("N/m", low=0.0, high=1e9, default=0.0, doc="of a spring to the ground")
    damping: float = quantity("N s/m", low=0.0, high=1e6, default=0.0, doc="of a dashpot to the ground")
    frequency: float | None = quantity(
        "Hz", low=1.0, high=20000.0, default=None, doc="of the mass on its own spring: a tuned damper"
    )
    q: float | None = quantity("1", low=0.1, high=1e4, default=None, doc="Q of a tuned damper, the body at rest")

    @model_validator(mode="after")
    def _something(self) -> Added:
        for name in ("mass", "stiffness", "damping"):
            if 0.0 < (size := getattr(self, name)) < _LEAST:
                raise ValueError(f"{name} is {size:g}; 0, or {_LEAST:g} and more, is allowed")
        if self.frequency is not None or self.q is not None:
            if self.frequency is None or self.q is None or not self.mass or self.stiffness or self.damping:
                raise ValueError("a tuned damper has mass, frequency and q, and no stiffness or damping to the ground")
            return self
        if not (self.mass or self.stiffness or self.damping):
            raise ValueError("a mass, a stiffness or a damping above 0 is needed")
        return self
