"""tonewood: plugin-based physical sound synthesis.

>>> import tonewood as tw
>>> guitar = tw.load_instrument("classical_guitar")
>>> audio = tw.render(tw.Score([tw.Note(0.0, 1.0, note=40, force=1.0)]), guitar, max_duration=0.1)
>>> audio.samples.shape
(4800, 2)

Every public name is imported when it is first used, so that ``import tonewood`` costs next to nothing. What a plugin
needs stands here too: see `Resonator`, `Body`, `Exciter`, `Attachment` and `Pickup`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tonewood.coupling.connections import Connection as Connection
    from tonewood.coupling.connections import SpringDashpot as SpringDashpot
    from tonewood.coupling.connections import Term as Term
    from tonewood.coupling.laws import CompiledPotential as CompiledPotential
    from tonewood.coupling.laws import Contact as Contact
    from tonewood.coupling.laws import Friction as Friction
    from tonewood.coupling.laws import HardeningSpring as HardeningSpring
    from tonewood.coupling.laws import SampledPotential as SampledPotential
    from tonewood.coupling.system import Drive as Drive
    from tonewood.coupling.system import Probe as Probe
    from tonewood.coupling.system import Readout as Readout
    from tonewood.engine.effect_usage import Bound as Bound
    from tonewood.engine.effects.base import EffectReport as EffectReport
    from tonewood.engine.effects.base import Moment as Moment
    from tonewood.engine.effects.base import RuntimeEffect as RuntimeEffect
    from tonewood.engine.effects.base import SwitchedEffect as SwitchedEffect
    from tonewood.engine.effects.base import Switching as Switching
    from tonewood.engine.effects.base import Watched as Watched
    from tonewood.engine.effects.base import next_multiple as next_multiple
    from tonewood.engine.effects.connections import SwitchedConnections as SwitchedConnections
    from tonewood.errors import BundleError as BundleError
    from tonewood.errors import DroppedNotesWarning as DroppedNotesWarning
    from tonewood.errors import NothingPlayedError as NothingPlayedError
    from tonewood.errors import NumericalError as NumericalError
    from tonewood.errors import OutputError as OutputError
    from tonewood.errors import PassivityError as PassivityError
    from tonewood.errors import PluginError as PluginError
    from tonewood.errors import ScoreError as ScoreError
    from tonewood.errors import TonewoodError as TonewoodError
    from tonewood.instrument.assembly import Model as Model
    from tonewood.instrument.assembly import assemble as assemble
    from tonewood.instrument.attached import Attached as Attached
    from tonewood.instrument.attached import Motion as Motion
    from tonewood.instrument.attached import Site as Site
    from tonewood.instrument.attached import loose_mass as loose_mass
    from tonewood.instrument.bundle import Instrument as Instrument
    from tonewood.instrument.bundle import load_instrument as load_instrument
    from tonewood.instrument.contract import Attachment as Attachment
    from tonewood.instrument.contract import Body as Body
    from tonewood.instrument.contract import BodyPoint as BodyPoint
    from tonewood.instrument.contract import BridgeForce as BridgeForce
    from tonewood.instrument.contract import Event as Event
    from tonewood.instrument.contract import Exciter as Exciter
    from tonewood.instrument.contract import Gesture as Gesture
    from tonewood.instrument.contract import Hold as Hold
    from tonewood.instrument.contract import Longitudinal as Longitudinal
    from tonewood.instrument.contract import Pickup as Pickup
    from tonewood.instrument.contract import PickupRows as PickupRows
    from tonewood.instrument.contract import Place as Place
    from tonewood.instrument.contract import Plugin as Plugin
    from tonewood.instrument.contract import Resonator as Resonator
    from tonewood.instrument.contract import Scene as Scene
    from tonewood.instrument.contract import dot as dot
    from tonewood.instrument.directions import Direction as Direction
    from tonewood.instrument.directions import unit_vector as unit_vector
    from tonewood.instrument.effects import DAMPERS as DAMPERS
    from tonewood.instrument.effects import LONGITUDINAL as LONGITUDINAL
    from tonewood.instrument.effects import TENSION_MODULATION as TENSION_MODULATION
    from tonewood.instrument.effects import Effect as Effect
    from tonewood.instrument.effects import Norms as Norms
    from tonewood.instrument.effects import contact_effect as contact_effect
    from tonewood.instrument.gestures import Fraction as Fraction
    from tonewood.instrument.gestures import StringPlace as StringPlace
    from tonewood.instrument.gestures import metres as metres
    from tonewood.instrument.gestures import smooth_step as smooth_step
    from tonewood.instrument.inspection import partials as partials
    from tonewood.instrument.inspection import pitch as pitch
    from tonewood.instrument.inspection import pitches as pitches
    from tonewood.instrument.losses import LossLaw as LossLaw
    from tonewood.instrument.registry import list_instruments as list_instruments
    from tonewood.instrument.registry import list_plugins as list_plugins
    from tonewood.modal.damping import with_damping_case as with_damping_case
    from tonewood.modal.modes import ModalBasis as ModalBasis
    from tonewood.modal.string_modes import string_basis as string_basis
    from tonewood.modal.string_modes import wavenumber as wavenumber
    from tonewood.modal.string_transfer import retuned as retuned
    from tonewood.modal.string_transfer import string_carry as string_carry
    from tonewood.modal.string_transfer import string_transfer as string_transfer
    from tonewood.output.audio import Audio as Audio
    from tonewood.output.plan import Plan as Plan
    from tonewood.output.plan import plan as plan
    from tonewood.output.play import Playback as Playback
    from tonewood.output.play import play as play
    from tonewood.output.render import Renderer as Renderer
    from tonewood.output.render import Summary as Summary
    from tonewood.output.render import Tail as Tail
    from tonewood.output.render import render as render
    from tonewood.params import Number as Number
    from tonewood.params import Parameters as Parameters
    from tonewood.params import Vector as Vector
    from tonewood.params import described as described
    from tonewood.params import quantity as quantity
    from tonewood.passivity.basis import check_basis as check_basis
    from tonewood.passivity.basis import repair_basis as repair_basis
    from tonewood.score.midi import read_midi as read_midi
    from tonewood.score.midi import write_midi as write_midi
    from tonewood.score.note import Control as Control
    from tonewood.score.note import Dropped as Dropped
    from tonewood.score.note import Note as Note
    from tonewood.score.note import Score as Score
    from tonewood.stepping.forcing import Segment as Segment

    #: version of the installed package
    __version__: str

_MODULES = {
    "engine.effect_usage": ("Bound",),
    "engine.effects.base": (
        "EffectReport", "Moment", "RuntimeEffect", "SwitchedEffect", "Switching", "Watched", "next_multiple",
    ),
    "engine.effects.connections": ("SwitchedConnections",),
    "errors": (
        "BundleError", "DroppedNotesWarning", "NothingPlayedError", "NumericalError", "OutputError", "PassivityError",
        "PluginError", "ScoreError", "TonewoodError",
    ),
    "instrument.assembly": ("Model", "assemble"),
    "instrument.attached": ("Attached", "Motion", "Site", "loose_mass"),
    "instrument.bundle": ("Instrument", "load_instrument"),
    "instrument.contract": (
        "Attachment", "Body", "BodyPoint", "BridgeForce", "Event", "Exciter", "Gesture", "Hold", "Longitudinal",
        "Pickup", "PickupRows", "Place", "Plugin", "Resonator", "Scene", "Segment", "dot",
    ),
    "instrument.directions": ("Direction", "unit_vector"),
    "instrument.effects": ("DAMPERS", "LONGITUDINAL", "TENSION_MODULATION", "Effect", "Norms", "contact_effect"),
    "instrument.gestures": ("Fraction", "StringPlace", "metres", "smooth_step"),
    "instrument.inspection": ("partials", "pitch", "pitches"),
    "instrument.losses": ("LossLaw",),
    "instrument.registry": ("list_instruments", "list_plugins"),
    "passivity.basis": ("check_basis", "repair_basis"),
    "coupling.connections": ("Connection", "SpringDashpot", "Term"),
    "modal.damping": ("with_damping_case",),
    "coupling.laws": ("CompiledPotential", "Contact", "Friction", "HardeningSpring", "SampledPotential"),
    "modal.modes": ("ModalBasis",),
    "modal.string_modes": ("string_basis", "wavenumber"),
    "modal.string_transfer": ("retuned", "string_carry", "string_transfer"),
    "coupling.system": ("Drive", "Probe", "Readout"),
    "output.audio": ("Audio",),
    "output.plan": ("Plan", "plan"),
    "output.play": ("Playback", "play"),
    "output.render": ("Renderer", "Summary", "Tail", "render"),
    "params": ("Number", "Parameters", "Vector", "described", "quantity"),
    "score.midi": ("read_midi", "write_midi"),
    "score.note": ("Control", "Dropped", "Note", "Score"),
}  # fmt: skip
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [*_HOME, "__version__"]  # strings, though computed


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("tonewood")
    elif name in _HOME:
        value = getattr(import_module(f"tonewood.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'tonewood' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
