"""Plates from drawings: modes of braced wooden plates of any outline, their air and their sound; arrays only.

`body.body_modes` makes the modes of a `body.BodyDrawing`; every other module has one step of it.
"""

from tonewood.plate.air import SOUND_SPEED
from tonewood.plate.beams import Beam
from tonewood.plate.body import BodyDrawing, BodyModes, PlateDrawing, body_modes, first_modes
from tonewood.plate.microphones import microphone
from tonewood.plate.outline import area, circle, crossing, guitar_outline, inside, refined, smooth_ring
from tonewood.plate.plate import Edge
from tonewood.plate.radiation import Sources
from tonewood.plate.two_oscillators import displaced_volumes, pressure_shapes
from tonewood.plate.wood import SPECIES, Wood

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
