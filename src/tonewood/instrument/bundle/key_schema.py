"""Keys of the bundle format: strings that one note plays together, their dampers and pedals."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from tonewood.instrument.contract.gestures import StringPlace
from tonewood.support.params import Number, Parameters, described, quantity

#: strings that an instrument may have; a piano has 243, with duplex segments some 400
MOST_STRINGS = 1024

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class Damper(Parameters):
    """A felt that rests on the strings of a key while the key is up, and is lifted with it."""

    from_bridge: StringPlace = described("its middle: m, or {fraction: of the open speaking length}")
    width: float = quantity("m", low=0.0, high=1.0, default=0.0, doc="over which it is spread")
    resistance: float = quantity("N s/m", low=0.0, high=100.0, doc="of all of it, on each string")


class KeyEntry(Parameters):
    """A key, or a course: strings that one note plays together."""

    note: str | Number = described("note name or MIDI number")
    strings: list[Name] = described("its strings, the one that gives the pitch first", min_length=1, max_length=6)
    una_corda: int | None = described(
        "strings that its hammer meets while the una corda pedal is down; all where left out", default=None, ge=1, le=6
    )
    damper: Damper | None = described("felt that rests on them; none where left out", default=None)
    exciter: dict[str, Any] = described("parameters of the exciter at this key, in place of its own", default={})
    kind: Literal["measured", "estimated", "published", "computed", "authored", "stand_in", "unknown"] | None = (
        described("of the row's figures, as in `provenance`", default=None)
    )


class Pedals(Parameters):
    """Pedals of an instrument whose keys have dampers: sustain CC64, sostenuto CC66, una corda CC67."""

    rises: float = quantity("1", low=0.0, high=1.0, default=0.3, doc="position of CC64 where dampers begin to rise")
    free: float = quantity("1", low=0.0, high=1.0, default=0.7, doc="position of CC64 from which strings are free")
    una_corda_stiffness: float = quantity(
        "1", low=0.0, high=1.0, default=0.5, doc="factor on the felt's force while the una corda pedal is down"
    )

    @model_validator(mode="after")
    def _order(self) -> Pedals:
        if not self.rises < self.free:
            raise ValueError("rises must be below free")
        return self

    def share(self, position: float) -> float:
        """Share of the dampers' loss that is left at a position 0 .. 1 of the pedal: a square law, in 8 steps."""
        way = min(max((position - self.rises) / (self.free - self.rises), 0.0), 1.0)
        return (1.0 - round(8.0 * way) / 8.0) ** 2


class Keys(Parameters):
    """Keys of a piano, courses of a lute: from a table with one row a note, or one by one in `entries`."""

    table: str | None = described("CSV file in the bundle; see Table of keys", default=None)
    exciter: Name | None = described("exciter whose parameters the table gives", default=None)
    damper: dict[str, Any] = described("values of dampers that the rows leave out", default={})
    pedals: Pedals = described("where keys have dampers", default=Pedals())
    entries: dict[Name, KeyEntry] = described(
        "name -> key, beside those of the table", default={}, max_length=MOST_STRINGS
    )

    @property
    def has_pedals(self) -> bool:
        """Whether there is something that pedals move: a damper, or a hammer that una corda shifts."""
        return any(key.damper is not None or key.una_corda is not None for key in self.entries.values())
