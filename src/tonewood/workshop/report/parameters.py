"""Every parameter of an instrument by its dotted key, with its unit: the keys that `replace` and ``--set`` take."""

from __future__ import annotations

import hashlib
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import Bundle
from tonewood.instrument.contract.base import Plugin


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """Value of one key: JSON, or for a table its name and SHA-256; its unit, empty where it has none."""

    value: Any
    unit: str


def parameters(instrument: Instrument) -> dict[str, ParameterValue]:
    """Every value of a bundle, defaults included: dotted key -> value and unit; without empty lists and groups.

    A key ``table`` is given with the SHA-256 of the file's bytes, so that tables of one name differ by their contents.
    """
    plugins = plugins_of(instrument)
    out: dict[str, ParameterValue] = {}
    for key, value in flattened(instrument.resolved):
        if isinstance(value, dict | list) and not value:
            continue
        kind, *rest = key.split(".")
        plugin = None
        if kind in plugins and rest:
            plugin = plugins[kind].get("" if kind == "body" else rest[0])
        inner = rest if kind == "body" else rest[1:]
        unit = _unit(Bundle, key.split("."))
        if plugin is not None and not unit:
            # a plugin among its parameters: a loss law
            part = getattr(plugin.parameters, inner[0], None) if inner else None
            owner, below = (part, inner[1:]) if isinstance(part, Plugin) else (plugin, inner)
            unit = _unit(type(owner).Parameters, below)
        if plugin is not None and inner == ["table"] and isinstance(value, str):
            digest = hashlib.sha256(plugin.files.path(value, key).read_bytes()).hexdigest()
            value = f"{value} (SHA-256 {digest[:12]})"
        out[key] = ParameterValue(value, "" if unit == "1" else unit)
    return out


def plugins_of(instrument: Instrument) -> dict[str, Mapping[str, Plugin[Any]]]:
    """Plugins of an instrument by key of the bundle and name; the body has the empty one."""
    return {
        "body": {"": instrument.body},
        "strings": instrument.resonators,
        "exciters": instrument.exciters,
        "connections": instrument.attachments,
        "outputs": instrument.pickups,
    }


def flattened(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted key and value of every leaf; a member of a list goes by its ``name``, a list of plain values is a leaf."""
    if isinstance(value, Mapping) and value:
        for name, below in value.items():
            yield from flattened(below, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple) and any(isinstance(member, Mapping | list | tuple) for member in value):
        for i, member in enumerate(value):
            name = member.get("name", i) if isinstance(member, Mapping) else i
            yield from flattened(member, f"{key}.{name}")
    else:
        yield key, value


def _unit(annotation: Any, path: list[str]) -> str:
    """Unit of the field that a path leads to from a type; empty where it leads to none."""
    field = field_at(annotation, path)
    extra = None if field is None else field.json_schema_extra
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def field_at(annotation: Any, path: list[str]) -> FieldInfo | None:
    """Field that a path leads to from a type; None where it leads to none."""
    for kind in alternatives(annotation):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            field = next((f for name, f in kind.model_fields.items() if path and (f.alias or name) == path[0]), None)
            if field is None:
                continue
            if len(path) == 1:
                return field
            if inner := field_at(field.annotation, path[1:]):
                return inner
        elif get_origin(kind) in (dict, list, tuple) and (field := field_at(get_args(kind)[-1], path[1:])):
            return field
    return None


def alternatives(annotation: Any) -> list[Any]:
    """Members of a union, annotations taken off."""
    origin = get_origin(annotation)
    if origin in (Union, types.UnionType):
        return [kind for member in get_args(annotation) for kind in alternatives(member)]
    if hasattr(annotation, "__metadata__"):
        return alternatives(get_args(annotation)[0])
    return [annotation]
