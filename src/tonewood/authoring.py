"""Everything that the author of a plugin needs: one import for a package, or for a file inside of a bundle.

>>> import tonewood.authoring as ta
>>> class LumpParameters(ta.Parameters):
...     mass: float = ta.quantity("kg", low=1e-3, doc="of the lump")
>>> class Lump(ta.Body[LumpParameters]):
...     Parameters = LumpParameters
...     def points(self):
...         return {"top": ta.BodyPoint((0.0, 0.0, 1.0))}
...     def basis(self, freq_upper):
...         return ta.ModalBasis.real([100.0], [1.0], {"top": [1.0]}, modal_mass=self.parameters.mass)
>>> Lump.from_values({"mass": 0.5}).basis(1e3)
ModalBasis(1 real modes, 15.9155 to 15.9155 Hz, points top)

Kinds of plugins and the types that they return, declared parameters, modal bases, connections and their laws, effects,
errors; and functions that show the part at work in an instrument: `assemble`, `partials`, `pitches`.
"""

from typing import Any

from tonewood.errors import BundleError, PassivityError, PluginError, TonewoodError
from tonewood.instrument.contract.array_cache import cached_arrays
from tonewood.instrument.contract.attached import Attached, Motion, Site, loose_mass
from tonewood.instrument.contract.base import (
    Attachment,
    Body,
    BodyPoint,
    BridgeForce,
    Exciter,
    Longitudinal,
    Pickup,
    PickupRows,
    Plugin,
    Resonator,
    Scene,
    StringMotion,
    dot,
)
from tonewood.instrument.contract.conversion import Circuit, Conversion
from tonewood.instrument.contract.directions import Direction, unit_vector
from tonewood.instrument.contract.effects import (
    Effect,
    Norms,
    contact_effect,
)
from tonewood.instrument.contract.gestures import (
    Event,
    Fraction,
    Gesture,
    Hold,
    Place,
    StringPlace,
    metres,
    smooth_step,
)
from tonewood.instrument.contract.law_field import LossLaw
from tonewood.instrument.contract.losses import Loss, StringData
from tonewood.instrument.contract.microphones import Microphones
from tonewood.instrument.contract.moved_modes import MovedMode, with_moved_modes
from tonewood.instrument.contract.svg_path import svg_ring
from tonewood.instrument.inspection.frequencies import partials, pitch, pitches
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects.base import Moment, RuntimeEffect, SwitchedEffect, Switching, Watched, next_multiple
from tonewood.performance.effects.connections import ConnectionsInReach, SwitchedConnections
from tonewood.performance.effects.longitudinal import LONGITUDINAL
from tonewood.performance.effects.phantom_partials import PHANTOM_PARTIALS
from tonewood.performance.effects.tension import TENSION_MODULATION
from tonewood.performance.effects.unswitched import DAMPERS, FRETTING_NOISE, KEY_NOISE, SQUEAK, TOUCH_NOISE
from tonewood.performance.effects.usage import Bound
from tonewood.physics import plate as plate
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.potentials.user import ModalPotential, PotentialEnergy, PotentialFunction
from tonewood.physics.modal.damping import with_damping_case
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.partial_decays import string_detuned, with_partial_decays
from tonewood.physics.modal.string_modes import string_basis, wavenumber
from tonewood.physics.modal.string_transfer import retuned, string_carry, string_transfer
from tonewood.physics.passivity.basis import check_basis, repair_basis
from tonewood.physics.stepping.forcing import SampledForce, Segment
from tonewood.support import moved
from tonewood.support.params import Number, Parameters, Vector, described, quantity

__all__ = [
    "DAMPERS",
    "FRETTING_NOISE",
    "KEY_NOISE",
    "LONGITUDINAL",
    "PHANTOM_PARTIALS",
    "SQUEAK",
    "TENSION_MODULATION",
    "TOUCH_NOISE",
    "Attached",
    "Attachment",
    "Body",
    "BodyPoint",
    "Bound",
    "BridgeForce",
    "BundleError",
    "Circuit",
    "CompiledPotential",
    "Connection",
    "ConnectionsInReach",
    "Contact",
    "Conversion",
    "Direction",
    "Drive",
    "DrivenLongitudinal",
    "Effect",
    "Event",
    "Exciter",
    "Fraction",
    "Friction",
    "GeometricStretch",
    "Gesture",
    "HardeningSpring",
    "Hold",
    "Longitudinal",
    "Loss",
    "LossLaw",
    "Microphones",
    "ModalBasis",
    "ModalPotential",
    "Model",
    "Moment",
    "Motion",
    "MovedMode",
    "Norms",
    "Number",
    "Parameters",
    "PassivityError",
    "Pickup",
    "PickupRows",
    "Place",
    "Plugin",
    "PluginError",
    "Potential",
    "PotentialEnergy",
    "PotentialFunction",
    "Readout",
    "Resonator",
    "RuntimeEffect",
    "SampledForce",
    "SampledPotential",
    "Scene",
    "Segment",
    "Site",
    "SpringDashpot",
    "StringData",
    "StringMotion",
    "StringPlace",
    "SwitchedConnections",
    "SwitchedEffect",
    "Switching",
    "TensionModulation",
    "Term",
    "TonewoodError",
    "Vector",
    "Watched",
    "assemble",
    "cached_arrays",
    "check_basis",
    "contact_effect",
    "described",
    "dot",
    "loose_mass",
    "metres",
    "next_multiple",
    "partials",
    "pitch",
    "pitches",
    "plate",
    "quantity",
    "repair_basis",
    "retuned",
    "smooth_step",
    "string_basis",
    "string_carry",
    "string_detuned",
    "string_transfer",
    "svg_ring",
    "unit_vector",
    "wavenumber",
    "with_damping_case",
    "with_moved_modes",
    "with_partial_decays",
]


def __getattr__(name: str) -> Any:
    return moved.renamed(__name__, name, {"Probe": Term})
