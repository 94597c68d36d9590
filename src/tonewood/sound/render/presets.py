"""Presets: options of a render under one name, of every instrument or of a bundle."""

from __future__ import annotations

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.schema import Bundle, Preset
from tonewood.sound.render.options import RenderOptions

#: of every instrument; a bundle may have others by these names
BUILT_IN = {
    "dry": Preset(),
    "studio": Preset(room="studio", humanize=1, noises=True),
    "stage": Preset(room="hall", humanize=1, noises=True),
}


def with_preset(options: RenderOptions, spec: Bundle) -> RenderOptions:
    """Return the options with the values of their preset for those that are not given.

    Raises TonewoodError : the instrument has no preset of this name.
    """
    if options.preset is None:
        return options
    presets = BUILT_IN | spec.presets
    if options.preset not in presets:
        raise TonewoodError(f"is {options.preset!r}; {', '.join(presets)} are allowed", key="preset")
    chosen = presets[options.preset].model_dump()
    chosen["outputs"] = None if chosen["outputs"] is None else tuple(chosen["outputs"])
    chosen["noises"] = chosen["noises"] or None
    return options.at(preset=None, **{k: v for k, v in chosen.items() if k not in options.model_fields_set})
