"""Strings by gauge and material: mass, stiffness and loss from what a maker prints on the packet.

    plain     mu = rho pi d^2 / 4
    wound     mu = rho_c pi d_c^2 / 4 + fill rho_w pi (d^2 - d_c^2) / 4
    both      T = mu (2 L f)^2,  sigma = 4 T / (pi d_c^2),  E = E_0 + e sigma,  EI = E pi d_c^4 / 64,
              EA = E pi d_c^2 / 4

d_c is the core's diameter, d for a plain string. The winding adds mass alone. Round wire of d_w = (d - d_c) / 2, wound
closely, fills pi/4 sqrt(1 + (d_w / (pi (d_c + d_w)))^2) of the ring. Polymers are stiffer the more they are stretched,
and in slow stretch, by fretting or tuning, softer than in vibration: `fretting_stiffness` is EA of the slow one.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict

from tonewood.errors import BundleError
from tonewood.instrument.bundle.string_schema import MadeOf
from tonewood.support.params import Parameters, described, quantity, validated
from tonewood.support.validation_messages import did_you_mean
from tonewood.support.yaml_io import load_yaml

_FILE = Path(__file__).with_name("string_materials.yaml")
WOUND = "wound"


class Figure(Parameters):
    """A figure of a material, with its source."""

    value: float = quantity("1", doc="SI")
    per_stress: float = quantity("1", default=0.0, doc="added for each Pa of stress")
    kind: Literal["published", "computed", "stand_in"] = described("as in the provenance of a bundle")
    source: str = described("author, place of publication")


class MaterialLoss(Parameters):
    """A loss law and its numbers, with their source."""

    model_config = ConfigDict(extra="allow")
    law: str = described("name of a loss law")
    kind: Literal["published", "computed", "stand_in"] = described("as in the provenance of a bundle")
    source: str = described("author, place of publication")


class StringMaterial(Parameters):
    """A material of strings; see ``string_materials.yaml``."""

    title: str = described("in words")
    density: Figure = described("kg/m^3")
    young: Figure | None = described("Pa, in vibration; none of materials for wraps", default=None)
    young_slow: Figure | None = described("Pa, in slow stretch, if another", default=None)
    core_share: Figure | None = described("of the diameter of a wound string", default=None)
    loss: MaterialLoss | None = described("of a string of it alone", default=None)
    loss_as_core: MaterialLoss | None = described("of a wound string on such a core", default=None)


@dataclass(frozen=True, slots=True)
class StringFigures:
    """A string at a length and pitch, from its gauge and materials.

    diameter, core_diameter : m, of the whole string and of what bends and stretches.
    linear_density : kg/m.
    tension : N.
    bending_stiffness : N m^2, of vibration.
    axial_stiffness, fretting_stiffness : N, EA of vibration and of slow stretch.
    loss : law and numbers.
    kinds : key of a bundle -> kind and source of its value, as in the provenance.
    """

    diameter: float
    core_diameter: float
    linear_density: float
    tension: float
    bending_stiffness: float
    axial_stiffness: float
    fretting_stiffness: float
    loss: Mapping[str, Any]
    kinds: Mapping[str, tuple[str, str]]

    @property
    def stress(self) -> float:
        """Stress of the core, Pa."""
        return self.tension / (math.pi * self.core_diameter**2 / 4)


@cache
def string_materials() -> Mapping[str, StringMaterial]:
    """Known materials, by name."""
    values = load_yaml(_FILE, error=BundleError)
    return {name: validated(StringMaterial, entry, key=name, file=_FILE) for name, entry in values.items()}


def made_figures(purchase: MadeOf, length: float, freq: float, *, key: str = "", file: Any = None) -> StringFigures:
    """Compute a string from its gauge and materials.

    purchase : gauge, material, core and wrap.
    length, freq : m and Hz, at which it is tuned.
    key, file : of the string, for errors.
    Raises BundleError : a material is unknown or none for its place, or the gauges make no string.
    """
    materials = string_materials()
    strings = [name for name, m in materials.items() if m.young]

    def material(name: str, at: str, allowed: Collection[str]) -> StringMaterial:
        if name not in allowed:
            hint = did_you_mean(name, list(allowed))
            reason = f"there is no material {name!r} for it; {hint}there are {', '.join(allowed)}"
            raise BundleError(reason, file=file, key=f"{key}.{at}".lstrip("."))
        return materials[name]

    if purchase.material == WOUND:
        assert purchase.wrap is not None
        core = material(purchase.core.material if purchase.core else "plain_steel", "core.material", strings)
        wrap = material(purchase.wrap.material, "wrap.material", materials)
        diameter, core_diameter, density = _wound(purchase, core, wrap, key, file)
        law, metal = core.loss_as_core, f"{core.title} under {wrap.title}"
        sources = f"core: {core.density.source}; wrap: {wrap.density.source}"
    else:
        core = material(purchase.material, "material", [*strings, WOUND])
        assert purchase.diameter is not None
        diameter = core_diameter = purchase.diameter
        density, law, metal = core.density.value * math.pi * diameter**2 / 4, core.loss, core.title
        sources = core.density.source
    assert core.young is not None
    assert law is not None
    linear_density = purchase.linear_density or density
    tension = linear_density * (2 * length * freq) ** 2
    area = math.pi * core_diameter**2 / 4
    slow = core.young_slow or core.young
    young, young_slow = (y.value + y.per_stress * tension / area for y in (core.young, slow))
    numbers = law.model_dump(exclude={"kind", "source"})
    if law.law == "valette":
        numbers["diameter"] = diameter
    mass = "mass per length as given in `made_of`" if purchase.linear_density else sources
    return StringFigures(
        diameter,
        core_diameter,
        linear_density,
        tension,
        young * area * core_diameter**2 / 16,
        young * area,
        young_slow * area,
        numbers,
        {
            "linear_density": ("computed", f"{metal}: {mass}"),
            "tension": ("computed", f"mu (2 L f)^2; {metal}: {mass}"),
            "bending_stiffness": ("computed", f"{metal}: {core.young.source}"),
            "axial_stiffness": ("computed", f"{metal}: {core.young.source}"),
            "fretting_stiffness": ("computed", f"{metal}: {slow.source}"),
            "loss": (law.kind, f"{metal}: {law.source}"),
        },
    )


def _wound(
    purchase: MadeOf, core: StringMaterial, wrap: StringMaterial, key: str, file: Any
) -> tuple[float, float, float]:
    """Diameter (m), core's diameter (m) and mass per length (kg/m) of a wound string.

    Of string, core and wrap two gauges make the third. Where the string's alone is known, a core of nylon follows from
    the mass, since the wrap is much denser; a core of steel is a usual share.
    """
    assert purchase.wrap is not None

    def fault(reason: str, at: str) -> BundleError:
        return BundleError(reason, file=file, key=f"{key}.{at}".lstrip("."))

    inner, wire, outer = purchase.core.diameter if purchase.core else None, purchase.wrap.diameter, purchase.diameter
    if outer is None:
        assert inner is not None
        assert wire is not None
        outer = inner + 2 * wire
    elif inner is None and wire is not None:
        inner = outer - 2 * wire
    elif inner is None:
        share = purchase.core.share if purchase.core else None
        if share is None and core.core_share is not None:
            share = core.core_share.value
        if share is None:
            if purchase.linear_density is None:
                raise fault("is missing; its gauge, its share or `linear_density` is wanted", "core.gauge")
            share = _share_of_mass(purchase.linear_density / (math.pi * outer**2 / 4), core, wrap, purchase.wrap.fill)
            if share is None:
                densest = f"{wrap.density.value:g} kg/m^3 about {core.density.value:g} kg/m^3"
                raise fault(f"no core gives {purchase.linear_density:g} kg/m with {densest}", "linear_density")
        inner = share * outer
    if not 0 < inner < outer:
        raise fault(f"leaves a core of {inner:.3g} m in a string of {outer:.3g} m", "gauge")
    ring = (purchase.wrap.fill or _fill(inner / outer)) * wrap.density.value * (outer**2 - inner**2)
    return outer, inner, math.pi / 4 * (core.density.value * inner**2 + ring)


def _fill(share: float) -> float:
    """Share of the ring about a core that closely wound round wire fills; `share` is that of the core's diameter."""
    wire = (1 - share) / 2
    return math.pi / 4 * math.hypot(1.0, wire / (math.pi * (share + wire)))


def _share_of_mass(density: float, core: StringMaterial, wrap: StringMaterial, fill: float | None) -> float | None:
    """Core's share of the diameter at a mean density (kg/m^3) of the whole string; None where none gives it."""
    low, high = 0.05, 0.95

    def mean(share: float) -> float:
        ring = (fill or _fill(share)) * wrap.density.value
        return core.density.value * share**2 + ring * (1 - share**2)

    if not mean(high) < density < mean(low):
        return None
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if mean(middle) > density else (low, middle)
    return low
