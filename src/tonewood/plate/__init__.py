"""Plates from drawings: modes of braced wooden plates of any outline, their air and their sound; arrays only.

`body.body_modes` makes the modes of a `body.BodyDrawing`; every other module has one step of it.
"""

from tonewood.plate.air import SOUND_SPEED as SOUND_SPEED
from tonewood.plate.beams import Beam as Beam
from tonewood.plate.body import BodyDrawing as BodyDrawing
from tonewood.plate.body import BodyModes as BodyModes
from tonewood.plate.body import PlateDrawing as PlateDrawing
from tonewood.plate.body import body_modes as body_modes
from tonewood.plate.body import first_modes as first_modes
from tonewood.plate.microphones import microphone as microphone
from tonewood.plate.outline import area as area
from tonewood.plate.outline import circle as circle
from tonewood.plate.outline import crossing as crossing
from tonewood.plate.outline import guitar_outline as guitar_outline
from tonewood.plate.outline import inside as inside
from tonewood.plate.outline import refined as refined
from tonewood.plate.outline import smooth_ring as smooth_ring
from tonewood.plate.plate import Edge as Edge
from tonewood.plate.radiation import Sources as Sources
from tonewood.plate.wood import SPECIES as SPECIES
from tonewood.plate.wood import Wood as Wood
