"""Module names of version 0.2: imported, they warn and give the module that stands elsewhere now; until version 0.4."""

from __future__ import annotations

import sys

# no imports that take time: this module is imported before the command line can answer Ctrl-C
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any

#: packages, old -> new
_PACKAGES = {
    "modal": "physics.modal",
    "plate": "physics.plate",
    "coupling": "physics.coupling",
    "stepping": "physics.stepping",
    "passivity": "physics.passivity",
    "energy": "physics.energy",
    "score": "performance.score",
    "engine": "performance.engine",
    "engine.effects": "performance.effects",
    "output": "sound",
    "live": "sound.live",
    "fit": "workshop.fit",
    "report": "workshop.report",
    "batch": "workshop.batch",
    "listening": "workshop.listening",
}
#: modules that left the rest of their package: (old package, new one) -> names, `old=new` where the name changed, too
_MODULES = {
    (
        "",
        "support",
    ): "blas cache_folder garbage params plotting scipy_linalg tables units validation_messages whole_files "
    "yaml_edit yaml_io yaml_parser",
    ("coupling", "physics.coupling.potentials"): "tension geometric=longitudinal phantoms=phantom tension_solve=solve",
    ("coupling", "physics.coupling.laws"): "law_solve=solve",
    ("instrument", "instrument.contract"): "attached directions effects files gestures losses microphones svg_path "
    "registry array_cache bundle_code",
    ("instrument", "instrument.bundle"): "added json_schema keys migration new_bundle overrides schema "
    "schema_table string_sets key_schema",
    ("instrument", "instrument.model"): "assembly choice finger kept_tunings output_assembly stretch string_assembly "
    "string_setup string_stems strings tuning",
    ("instrument", "instrument.inspection"): "wolf modal_export mounted",
    ("score", "instrument"): "scales",
    ("score", "performance.score"): "causal=assignment performance=channel_reader",
    (
        "engine",
        "performance.player",
    ): "playing live_state=voices live_dampers=dampers pedals=dampers techniques hands variation "
    "note_events=strokes timeline fretting gestures live=player",
    ("engine", "performance.effects"): "costs effect_usage=usage gesture_connections",
    ("output", "sound.render"): "options render=renderer plan accuracy routing resampling energy level model_file",
    ("output", "sound.live"): "live=instrument stream play",
    ("output", "sound.files"): "audio inputs",
    ("output", "sound.level"): "loudness limiter spectrum",
}


def _new_names() -> dict[str, str]:
    names = dict(_PACKAGES)
    for (old, new), listed in _MODULES.items():
        for before, _, after in (word.partition("=") for word in listed.split()):
            names[f"{old}.{before}".lstrip(".")] = f"{new}.{after or before}"
    return {f"tonewood.{old}": f"tonewood.{new}" for old, new in names.items()}


_NEW_NAMES = _new_names()


def new_name(module: str) -> str | None:
    """Return the present name of a module of version 0.2; None if it had none such."""
    if module in _NEW_NAMES:
        return _NEW_NAMES[module]
    package, _, name = module.rpartition(".")
    return f"{_NEW_NAMES[package]}.{name}" if package in _NEW_NAMES else None


def attribute(package: str, name: str, home: str) -> Any:
    """Return `name` of the module `home`, for a package that was a module of its own name in version 0.2.

    Raises AttributeError : there is none.
    """
    from importlib import import_module

    if name.startswith("__") or not hasattr(module := import_module(home), name):
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    _warn(f"{package}.{name}", f"{home}.{name}", 2)
    return getattr(module, name)


def renamed(module: str, name: str, present: dict[str, Any]) -> Any:
    """Return the class that an old name of a module stands for, for its ``__getattr__``; until version 0.4.

    Raises AttributeError : it is no such name.
    """
    if name not in present:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    _warn(f"{module}.{name}", f"{module}.{present[name].__name__}", 2)
    return present[name]


def _warn(old: str, new: str, frames: int) -> None:
    """Warn at the import: so many frames above the caller, those of the import system not counted."""
    import warnings

    text = f"{old} is deprecated since 0.3 and will be removed in 0.4: it is {new}"
    warnings.warn(text, DeprecationWarning, stacklevel=2 + frames)


class _Alias:
    """Gives the module of another name."""

    def __init__(self, module: ModuleType):
        self.module, self.spec = module, module.__spec__

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return self.module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.spec  # the import system has put that of the old name there


class _OldNames:
    """Finds modules by their names of version 0.2; asked first, or an old package would load its modules once more."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith("tonewood.") or (new := new_name(fullname)) is None:
            return None
        from importlib import import_module
        from importlib.machinery import ModuleSpec

        try:
            module = import_module(new)
        except ModuleNotFoundError:
            return None
        _warn(fullname, new, 1)
        loader: Any = _Alias(module)  # all that the import system asks of one
        return ModuleSpec(fullname, loader, is_package=hasattr(module, "__path__"))


def install() -> None:
    """Answer imports of old names from now on."""
    if not any(isinstance(finder, _OldNames) for finder in sys.meta_path):
        sys.meta_path.insert(0, _OldNames())
