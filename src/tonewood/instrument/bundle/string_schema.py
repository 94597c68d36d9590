"""Keys of strings as they are bought, of their scatter, and of the fretboard under them."""

from __future__ import annotations

import math
import zlib
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from tonewood.support.params import Number, Parameters, described, quantity

#: metres of an inch
INCH = 0.0254
_FRET = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,2}$")]


class Scatter(Parameters):
    """How far real strings are from the same ideal one: normal scatter, drawn from a seed."""

    seed: int = described("of the draws; the string's name and stop are part of it", default=1, ge=0)
    tilt_deg: float = quantity("deg", low=0.0, high=45.0, default=0.0, doc="standard deviation, one draw per string")
    split_cents: float = quantity("cents", low=0.0, high=20.0, default=0.0, doc="standard deviation, one draw per stop")

    def tilt(self, string: str) -> float:
        """Add to a string's `tilt_deg`, deg."""
        return self.tilt_deg * self._draw(f"tilt {string}")

    def split(self, string: str, stop: float) -> float:
        """Add to a string's `split_cents` at a stop, cents; between whole stops on a straight line."""
        low = math.floor(stop)
        parts = ((low, low + 1 - stop), (low + 1, stop - low))
        return self.split_cents * sum(w * self._draw(f"split {string} {i}") for i, w in parts if w > 0)

    def _draw(self, what: str) -> float:
        return float(np.random.default_rng([self.seed, zlib.crc32(what.encode())]).standard_normal())


class Wire(Parameters):
    """A wire or a filament; its gauge in metres or in inches."""

    material: str = described("name of a material; `tonewood strings` lists them")
    gauge: float | None = quantity("m", low=5e-5, high=0.01, default=None, doc="diameter")
    gauge_inch: float | None = quantity("inch", low=0.002, high=0.4, default=None, doc="diameter in inches")

    @property
    def diameter(self) -> float | None:
        """Diameter, m; None where it is left out."""
        return self.gauge if self.gauge_inch is None else self.gauge_inch * INCH

    @model_validator(mode="after")
    def _one_gauge(self) -> Wire:
        if self.gauge is not None and self.gauge_inch is not None:
            raise ValueError("gauge_inch: stands beside `gauge`; one of the two is allowed")
        return self


class Core(Wire):
    """Core of a wound string: it alone bends and stretches."""

    material: str = described("of the core", default="plain_steel")
    share: float | None = quantity(
        "1", low=0.05, high=0.95, default=None, doc="of the string's diameter, in place of a gauge"
    )


class Wrap(Wire):
    """Winding of a wound string: it adds mass alone."""

    fill: float | None = quantity(
        "1", low=0.3, high=1.0, default=None, doc="share of the ring about the core that is metal; round wire left out"
    )


class MadeOf(Wire):
    """A string as it is bought: gauge and material, of a wound one its core and wrap."""

    material: str = described("plain_steel, nylon, fluorocarbon, or wound: `tonewood strings` lists them")
    core: Core | None = described("of a wound string; plain steel where left out", default=None)
    wrap: Wrap | None = described("of a wound string", default=None)
    linear_density: float | None = quantity(
        "kg/m", low=1e-5, high=0.3, default=None, doc="printed by the maker, in place of that of gauge and material"
    )

    @model_validator(mode="after")
    def _parts(self) -> MadeOf:
        gauges = [x for x in (self.diameter, self.core and (self.core.diameter or self.core.share)) if x]
        if self.material != "wound":
            if self.core or self.wrap:
                raise ValueError("core: is for material wound, with `wrap`")
            if self.diameter is None:
                raise ValueError("gauge: is missing; `gauge` in metres or `gauge_inch` is wanted")
            return self
        if self.wrap is None:
            raise ValueError("wrap: is missing; a wound string has a wrap with its material")
        if self.core and self.core.share and (self.core.diameter or self.diameter is None):
            raise ValueError("core.share: is of the string's gauge, and in place of the core's")
        if len(gauges) == 2 and self.wrap.diameter:
            raise ValueError("wrap.gauge: follows from the gauges of string and core; leave one of the three out")
        if self.diameter is None and not (self.wrap.diameter and self.core and self.core.diameter):
            raise ValueError("gauge: is missing; the string's, or those of core and wrap are wanted")
        return self


class Fretboard(Parameters):
    """Nut, frets and saddle under a string; what a string's own leaves out is that of `stops.fretboard`.

    Heights are those of the string over the plane of the frets' crowns without relief. What both leave out comes from
    the part of `connections` that has it (`frets`).
    """

    nut_height: float | None = quantity("m", low=-0.005, high=0.02, default=None, doc="of the string at the nut")
    action_first: float | None = quantity(
        "m", low=0.0, high=0.05, default=None, doc="clearance at the first fret, in place of `nut_height`"
    )
    saddle_height: float | None = quantity("m", low=-0.005, high=0.05, default=None, doc="of the string at the saddle")
    action_twelfth: float | None = quantity(
        "m", low=0.0, high=0.05, default=None, doc="clearance at half the length, in place of `saddle_height`"
    )
    relief: float | None = quantity(
        "m", low=0.0, high=0.01, default=None, doc="hollow of the neck, deepest midway from nut to last fret"
    )
    heights: dict[_FRET, Number] | None = described("number of a fret -> m by which it stands out", default=None)
    places: list[Number] | None = described(
        "m from the nut's end of the scale, of the frets from the first on; where left out, each lies where the ideal "
        "string sounds its note",
        default=None,
    )
    rule: float | None = quantity(
        "1", low=5.0, high=100.0, default=None,
        doc="each fret takes this part of the length left: 18 of old, 17.817 in equal temperament; instead of `places`",
    )  # fmt: skip
    nut_setback: float | None = quantity(
        "m", low=-0.05, high=0.05, default=None,
        doc="by which the nut lies farther from the saddle than the end of the scale; less than 0 is nearer",
    )  # fmt: skip
    saddle_setback: float | None = quantity(
        "m", low=-0.05, high=0.05, default=None, doc="by which the saddle lies farther from the nut than `length`"
    )
    finger: float | None = quantity(
        "m", low=0.0, high=0.1, default=None, doc="place of the finger behind its fret, at most halfway to the next"
    )
    press_depth: float | None = quantity(
        "m", low=0.0, high=0.01, default=None,
        doc="to which the finger presses the string below the crown of the first fret; less in shorter gaps",
    )  # fmt: skip
    behind: float | None = quantity(
        "m", low=0.0, high=1.0, default=None, doc="length of the string behind nut and saddle that shares the stretch"
    )

    @model_validator(mode="after")
    def _rising(self) -> Fretboard:
        for one, other in ALTERNATIVES:
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise ValueError(f"{other}: stands beside `{one}`; one of the two is allowed")
        places = self.places or []
        if any(b <= a for a, b in pairwise([0.0, *places])):
            raise ValueError("places: do not rise; metres from the nut, each larger than the one before, are allowed")
        return self

    def over(self, common: Fretboard) -> Fretboard:
        """Return this fretboard with what it leaves out from another one."""
        fields = self.model_dump(exclude_none=True)
        instead = {x: y for pair in ALTERNATIVES for x, y in (pair, pair[::-1])}
        rest = {k: v for k, v in common.model_dump(exclude_none=True).items() if instead.get(k) not in fields}
        return Fretboard(**{**rest, **fields})


#: keys of a fretboard that exclude each other
ALTERNATIVES = (("nut_height", "action_first"), ("saddle_height", "action_twelfth"), ("places", "rule"))
