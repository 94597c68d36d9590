"""tonewood: plugin-based physical sound synthesis.

>>> import tonewood as tw
>>> guitar = tw.load_instrument("classical_guitar")
>>> audio = tw.render(tw.Score([tw.Note(0.0, 1.0, note=40, force=1.0)]), guitar, max_duration=0.1)
>>> audio.samples.shape
(4800, 2)

This module plays scores; `tonewood.authoring` has all that the author of a plugin needs, and `tonewood.errors` every
error. Each name is imported when it is first used, so that ``import tonewood`` costs next to nothing.
"""

from __future__ import annotations

from tonewood.support import moved

# no imports that take time: until the command line has begun, Ctrl-C is Python's
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from tonewood.errors import DroppedNotesWarning as DroppedNotesWarning
    from tonewood.errors import TonewoodError as TonewoodError
    from tonewood.instrument.bundle.loading import Instrument as Instrument
    from tonewood.instrument.bundle.loading import load_instrument as load_instrument
    from tonewood.instrument.contract.registry import list_instruments as list_instruments
    from tonewood.instrument.contract.registry import list_plugins as list_plugins
    from tonewood.performance.score.midi import read_midi as read_midi
    from tonewood.performance.score.midi import write_midi as write_midi
    from tonewood.performance.score.note import Control as Control
    from tonewood.performance.score.note import Note as Note
    from tonewood.performance.score.note import Score as Score
    from tonewood.performance.score.reading import read_score as read_score
    from tonewood.sound.files.audio import Audio as Audio
    from tonewood.sound.live.instrument import Live as Live
    from tonewood.sound.live.play import play as play
    from tonewood.sound.live.stream import AudioStream as AudioStream
    from tonewood.sound.render.options import RenderOptions as RenderOptions
    from tonewood.sound.render.plan import plan as plan
    from tonewood.sound.render.renderer import Renderer as Renderer
    from tonewood.sound.render.renderer import render as render

    #: version of the installed package
    __version__: str

_HOME = {
    "Audio": "sound.files.audio",
    "AudioStream": "sound.live.stream",
    "Control": "performance.score.note",
    "DroppedNotesWarning": "errors",
    "Instrument": "instrument.bundle.loading",
    "Live": "sound.live.instrument",
    "Note": "performance.score.note",
    "RenderOptions": "sound.render.options",
    "Renderer": "sound.render.renderer",
    "Score": "performance.score.note",
    "TonewoodError": "errors",
    "list_instruments": "instrument.contract.registry",
    "list_plugins": "instrument.contract.registry",
    "load_instrument": "instrument.bundle.loading",
    "plan": "sound.render.plan",
    "play": "sound.live.play",
    "read_midi": "performance.score.midi",
    "read_score": "performance.score.reading",
    "render": "sound.render.renderer",
    "write_midi": "performance.score.midi",
}
#: names of version 0.1 that have moved: they still work, with a warning that says where they are; until version 0.4
_MOVED = {
    "tonewood.authoring": (
        "DAMPERS", "LONGITUDINAL", "TENSION_MODULATION", "Attached", "Attachment", "Body", "BodyPoint", "BridgeForce",
        "CompiledPotential", "Connection", "Contact", "Direction", "Drive", "Effect", "Event", "Exciter", "Fraction",
        "Friction", "Gesture", "HardeningSpring", "Hold", "Longitudinal", "LossLaw", "ModalBasis", "Model", "Motion",
        "Norms", "Number", "Parameters", "Pickup", "PickupRows", "Place", "Plugin", "Probe", "Readout", "Resonator",
        "SampledPotential", "Scene", "Segment", "Site", "SpringDashpot", "StringPlace", "Term", "Vector", "assemble",
        "check_basis", "contact_effect", "described", "dot", "loose_mass", "metres", "partials", "pitch", "pitches",
        "quantity", "repair_basis", "retuned", "smooth_step", "string_basis", "string_carry", "string_transfer",
        "unit_vector", "wavenumber", "with_damping_case",
    ),
    "tonewood.errors": (
        "BundleError", "NothingPlayedError", "NumericalError", "OutputError", "PassivityError", "PluginError",
        "ScoreError",
    ),
    "tonewood.performance.effects.base": ("EffectReport",),
    "tonewood.sound.render.options": ("Tail",),
    "tonewood.sound.render.plan": ("Plan",),
    "tonewood.sound.live.stream": ("Playback",),
    "tonewood.sound.render.renderer": ("Summary",),
    "tonewood.performance.score.note": ("Dropped",),
}  # fmt: skip
_NEW_HOME = {name: module for module, names in _MOVED.items() for name in names}

__all__ = [*_HOME, "__version__"]  # strings, though computed

moved.install()


def __getattr__(name: str) -> Any:
    import warnings
    from importlib import import_module

    from tonewood.support.garbage import without_collecting

    if name in _NEW_HOME:
        module = _NEW_HOME[name]
        text = f"tonewood.{name} is deprecated since 0.2 and will be removed in 0.4: it is {module}.{name}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return getattr(import_module(module), name)
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("tonewood")
    elif name in _HOME:
        value = getattr(without_collecting(import_module)(f"tonewood.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'tonewood' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
