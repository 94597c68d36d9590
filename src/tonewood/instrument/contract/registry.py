"""Installed plugins and instruments, found by entry points alone, those of third parties like the built-in ones.

A distribution announces a plugin by ``NAME = "package.module:Class"`` in the group ``tonewood.plugins`` and an
instrument by ``NAME = "package"`` in ``tonewood.instruments``, where the package's folder NAME holds the bundle.
"""

from __future__ import annotations

import hashlib
import inspect
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module, metadata
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError, PluginError, kind_of, words_of
from tonewood.instrument.contract.base import API, KINDS, Plugin
from tonewood.instrument.contract.contract_checks import CHECKS, WrongResultError
from tonewood.instrument.contract.effects import Effect
from tonewood.support.params import Parameters
from tonewood.support.validation_messages import did_you_mean

PLUGINS = "tonewood.plugins"
INSTRUMENTS = "tonewood.instruments"
MANIFEST = "instrument.yaml"
#: types of class attributes in place of properties
_PLAIN = (type(None), bool, int, float, complex, str, bytes, tuple, list, dict, set)


@dataclass(frozen=True, slots=True)
class Entry:
    """One announced name.

    name : the word used in bundles or on the command line.
    value : of the entry point.
    distribution, version : that announce it.
    fault : why it cannot be used: another distribution announces the same name; empty where none does.
    """

    name: str
    value: str
    distribution: str
    version: str
    fault: str = ""


@cache
def entries(group: str) -> dict[str, Entry]:
    """Announced names of a group, sorted; one that two distributions announce carries a `fault`."""
    by_name: dict[str, Entry] = {}
    owners: dict[int, tuple[str, str]] = {}  # each name and version is read from a file
    for point in sorted(metadata.entry_points(group=group), key=lambda p: p.name):
        if (owner := point.dist) is None:
            entry = Entry(point.name, point.value, "?", "?")
        else:
            if id(owner) not in owners:
                about = owner.metadata
                owners[id(owner)] = about["Name"], about["Version"]
            entry = Entry(point.name, point.value, *owners[id(owner)])
        before = by_name.get(point.name)
        # one distribution may be seen twice, through two entries of the path
        if before is not None and (before.value, before.distribution) != (entry.value, entry.distribution):
            entry = replace(
                before,
                fault=f"the name {point.name!r} is announced twice in {group}: by {before.distribution} "
                f"({before.value}) and by {entry.distribution} ({entry.value}); one of them must go",
            )
        by_name[point.name] = entry
    return by_name


def list_plugins() -> dict[str, type[Plugin[Any]]]:
    """List installed plugins that can be used: name -> class; `broken_plugins` has the others."""
    return {name: plugin(name) for name in entries(PLUGINS) if name not in broken_plugins()}


def broken_plugins() -> dict[str, str]:
    """List installed plugins that cannot be used: name -> reason, one line."""
    faults = {}
    for name in entries(PLUGINS):
        try:
            plugin(name)
        except PluginError as fault:
            faults[name] = str(fault)
    return faults


def list_instruments() -> dict[str, Path]:
    """List installed instruments: name -> folder."""
    return {name: instrument_folder(name) for name, entry in entries(INSTRUMENTS).items() if not entry.fault}


@cache
def plugin(name: str, kind: str | None = None) -> type[Plugin[Any]]:
    """Class of an installed plugin.

    name : its entry point's name.
    kind : one of `KINDS`, if only that will do.
    Raises PluginError : there is none of that name or kind, it cannot be imported, or it breaks the contract.
    """
    plugins = entries(PLUGINS)
    if name not in plugins:
        fitting = [n for n, p in list_plugins().items() if p.kind == kind] if kind else list(plugins)
        installed = f"{did_you_mean(name, fitting)}installed: {', '.join(fitting) or 'none'}"
        raise PluginError(f"there is no plugin {name!r}{f' of kind {kind}' if kind else ''}; {installed}")
    entry = plugins[name]
    if entry.fault:
        raise PluginError(entry.fault)
    module, _, attribute = entry.value.partition(":")
    try:
        imported = getattr(import_module(module), attribute)
        check_plugin(imported, f"plugin {name!r} of {entry.distribution}")
    except PluginError:
        raise
    except (Exception, SystemExit) as fault:  # code of a third party may raise anything
        reason = f"cannot be imported: {words_of(fault)}"
        raise PluginError(f"plugin {name!r} of {entry.distribution} {reason}") from None
    checked: type[Plugin[Any]] = imported
    if kind is not None:
        check_kind(checked, name, kind)
    return checked


def check_kind(cls: type[Plugin[Any]], name: str, kind: str) -> None:
    """Check that a plugin is of the kind that is wanted.

    Raises PluginError : it is of another kind; names the installed ones of that kind.
    """
    if cls.kind != kind:
        fitting = [other for other, p in list_plugins().items() if p.kind == kind]
        raise PluginError(f"plugin {name!r} is of kind {cls.kind}; one of kind {kind} is wanted: {', '.join(fitting)}")


def check_plugin(cls: object, who: str) -> None:
    """Check a class against the contract. Raises PluginError : one line that begins with `who`."""
    if not (inspect.isclass(cls) and issubclass(cls, Plugin)):
        raise PluginError(f"{who} is not a class derived from {', '.join(k.__name__ for k in KINDS.values())}")
    kinds = [kind for kind, base in KINDS.items() if issubclass(cls, base)]
    if len(kinds) != 1 or cls.kind != kinds[0]:
        raise PluginError(f"{who} must derive from exactly one of {', '.join(k.__name__ for k in KINDS.values())}")
    if cls.api != API:
        raise PluginError(f"{who} was written for version {cls.api!r} of the contract; this is version {API}")
    parameters = getattr(cls, "Parameters", None)
    if not (inspect.isclass(parameters) and issubclass(parameters, Parameters) and parameters is not Parameters):
        raise PluginError(f"{who} has no `Parameters` derived from tonewood.Parameters")
    unsaid = [key for key, field in parameters.model_fields.items() if not field.description]
    if unsaid:
        raise PluginError(f"{who}: parameter {unsaid[0]!r} does not say what it is (doc)")
    if missing := cls.left_out():
        raise PluginError(f"{who} leaves out {', '.join(missing)}")
    for name in CHECKS[cls.kind]:
        member, first = inspect.getattr_static(cls, name), inspect.getattr_static(KINDS[cls.kind], name)
        if isinstance(first, property) and inspect.isroutine(member):
            raise PluginError(f"{who}: {name} is a method; a property is wanted (@property)")
        if not isinstance(first, property) and not callable(member):
            raise PluginError(f"{who}: {name} is {kind_of(member)}; a method is wanted")
        if isinstance(first, property) and isinstance(member, _PLAIN):
            try:
                CHECKS[cls.kind][name](cls, member, {})
            except WrongResultError as wrong:
                raise PluginError(f"{who}: {name} is {wrong}") from None
    _check_effects(cls, who)


def _check_effects(cls: type[Plugin[Any]], who: str) -> None:
    """Check the effects that a class declares, and the classes that run them."""
    effects = cls.effects
    if not isinstance(effects, tuple) or not all(isinstance(effect, Effect) for effect in effects):
        raise PluginError(f"{who}: effects is {kind_of(effects)}; a tuple of ta.Effect is wanted")
    for effect in effects:
        runtime, named = effect.runtime, f"{who}: its effect {effect.name!r}"
        if effect.kind not in ("additive", "detuning"):
            raise PluginError(f"{named} is of kind {effect.kind!r}; additive or detuning is wanted")
        for key in ("bound", "cost"):
            if not callable(getattr(effect, key)):
                raise PluginError(f"{named}: {key} is {kind_of(getattr(effect, key))}; a function is wanted")
        if runtime is None:
            continue
        name = getattr(runtime, "__name__", repr(runtime))
        if not callable(runtime):
            raise PluginError(f"{named}: runtime is {kind_of(runtime)}; a ta.RuntimeEffect class is wanted")
        if inspect.isclass(runtime) and not all(hasattr(runtime, method) for method in ("report", "plan", "running")):
            raise PluginError(f"{named}: runtime {name} is not derived from ta.RuntimeEffect or ta.SwitchedEffect")
        if inspect.isabstract(runtime):
            missing = ", ".join(sorted(getattr(runtime, "__abstractmethods__", ())))
            raise PluginError(f"{named}: {name} leaves out {missing}")


def instrument_folder(name_or_path: str | os.PathLike[str]) -> Path:
    """Folder of a bundle: of an installed instrument by name, or any folder that holds an ``instrument.yaml``.

    A path that is no text is a folder, also one that has the name of an installed instrument.
    Raises BundleError : there is neither.
    """
    text = os.fspath(name_or_path)
    instruments = entries(INSTRUMENTS)
    if isinstance(name_or_path, str) and text in instruments:
        if instruments[text].fault:
            raise BundleError(instruments[text].fault)
        try:
            folder = Path(str(package_files(instruments[text].value))) / text
        except ModuleNotFoundError as fault:
            raise BundleError(
                f"instrument {text!r} of {instruments[text].distribution} is not there: {fault}"
            ) from None
    else:
        path = Path(text)
        folder = path.parent if path.name == MANIFEST else path
        try:
            there, exists = (folder / MANIFEST).is_file(), path.exists()
        except (OSError, RuntimeError, ValueError):  # a name too long or with a zero byte, links in a circle
            raise BundleError(f"instrument {text!r} cannot be followed to a folder") from None
        if not there:
            looks_like_path = os.sep in text or "/" in text or exists
            reason = f"there is no {MANIFEST} in it" if looks_like_path else "is neither installed nor a folder"
            installed = f"{did_you_mean(text, instruments)}installed: {', '.join(instruments) or 'none'}"
            raise BundleError(f"instrument {text!r}: {reason}; {installed}")
    return folder


@cache
def plugin_hash(name: str) -> str:
    """SHA-256 of the source files of a plugin's class and its bases, with its distribution's version."""
    cls, entry = plugin(name), entries(PLUGINS)[name]
    digest = hashlib.sha256(f"{entry.distribution} {entry.version}".encode())
    # of a class without a file only the distribution's version counts
    for base in cls.__mro__:
        with suppress(OSError, TypeError):
            digest.update(Path(inspect.getfile(base)).read_bytes())
    return digest.hexdigest()
