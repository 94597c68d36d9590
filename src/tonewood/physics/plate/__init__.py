"""Plates from drawings: modes of braced wooden plates of any outline, their air and their sound; arrays only.

`body.body_modes` makes the modes of a `body.BodyDrawing`; every other module has one step of it. Modules are imported
when a name of theirs is first used: most instruments have no drawn body.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tonewood.physics.plate.air import SOUND_SPEED
    from tonewood.physics.plate.beams import Beam
    from tonewood.physics.plate.body import BodyDrawing, BodyModes, PlateDrawing, body_modes, first_modes
    from tonewood.physics.plate.microphones import microphone
    from tonewood.physics.plate.outline import area, circle, crossing, guitar_outline, inside, refined, smooth_ring
    from tonewood.physics.plate.plate_parts import Edge
    from tonewood.physics.plate.radiation import Sources
    from tonewood.physics.plate.two_oscillators import displaced_volumes, pressure_shapes
    from tonewood.physics.plate.wood import SPECIES, Wood

_MODULES = {
    "air": ("SOUND_SPEED",),
    "beams": ("Beam",),
    "body": ("BodyDrawing", "BodyModes", "PlateDrawing", "body_modes", "first_modes"),
    "microphones": ("microphone",),
    "outline": ("area", "circle", "crossing", "guitar_outline", "inside", "refined", "smooth_ring"),
    "plate_parts": ("Edge",),
    "radiation": ("Sources",),
    "two_oscillators": ("displaced_volumes", "pressure_shapes"),
    "wood": ("SPECIES", "Wood"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "SOUND_SPEED",
    "SPECIES",
    "Beam",
    "BodyDrawing",
    "BodyModes",
    "Edge",
    "PlateDrawing",
    "Sources",
    "Wood",
    "area",
    "body_modes",
    "circle",
    "crossing",
    "displaced_volumes",
    "first_modes",
    "guitar_outline",
    "inside",
    "microphone",
    "pressure_shapes",
    "refined",
    "smooth_ring",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value
