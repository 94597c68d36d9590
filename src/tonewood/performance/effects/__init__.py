"""Effects of a model while it is stepped: which there are, when they run, when they are left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from tonewood.errors import PluginError, TonewoodError, kind_of, words_of
from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import RuntimeEffect, SwitchedEffect
from tonewood.performance.effects.unswitched import ContactEffect, PickupEffect

#: makes the runtime effect of a declared one, see `RuntimeEffect`
Maker = Callable[[Model, Effect, Mapping[str, Plugin[Any]]], RuntimeEffect]

#: kind of plugin -> class of its effects if nothing else is said; those of strings and bodies always run
_BY_KIND: Mapping[str, Maker] = {"connection": ContactEffect, "exciter": ContactEffect, "pickup": PickupEffect}


def runtime_effects(model: Model) -> tuple[RuntimeEffect, ...]:
    """Make the runtime effects of everything that a model's plugins declare, one per effect and kind of plugin."""
    plugins: dict[tuple[str, str], dict[str, Plugin[Any]]] = {}
    effects: dict[tuple[str, str], Effect] = {}
    for component, plugin in _plugins(model):
        for effect in plugin.effects:
            key = effect.name, plugin.kind
            effects.setdefault(key, effect)
            plugins.setdefault(key, {})[component] = plugin
    effects_of = [
        _checked(effect.runtime or _BY_KIND.get(kind, RuntimeEffect), model, effect, plugins[name, kind])
        for (name, kind), effect in effects.items()
    ]
    watched = [runtime for runtime in effects_of if isinstance(runtime, SwitchedEffect) and runtime.watched]
    for one in watched:
        one.share = 1.0 / len(watched)
    return tuple(effects_of)


def _checked(maker: Maker, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]) -> RuntimeEffect:
    first = next(iter(plugins.values()))
    try:
        running = maker(model, effect, plugins)
    except (TonewoodError, MemoryError):
        raise
    except Exception as fault:  # of somebody's class: told with the effect's name and key
        name = getattr(maker, "__name__", repr(maker))
        reason = f"effect {effect.name!r}: {name} raises {words_of(fault)}"
        raise PluginError(reason, file=first.files.manifest, key=first.key) from fault
    if not isinstance(running, RuntimeEffect):
        reason = f"effect {effect.name!r}: runtime makes {kind_of(running)}; a ta.RuntimeEffect is wanted"
        raise PluginError(reason, file=first.files.manifest, key=first.key)
    return running


def _plugins(model: Model) -> Iterator[tuple[str, Plugin[Any]]]:
    """(string, part, ``body`` or output group, its plugin)."""
    yield from ((name, string.resonator) for name, string in model.strings.items())
    yield from model.instrument.attachments.items()
    yield from model.exciters.items()
    yield "body", model.instrument.body
    yield from model.instrument.pickups.items()
