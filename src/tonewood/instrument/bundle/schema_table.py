"""The bundle format and the plugins' parameters as Markdown tables.

``python -m tonewood.instrument.bundle.schema_table docs/make_an_instrument.md`` puts them into the documentation.
"""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from tonewood.instrument.bundle.schema import BodyPart, Bundle, ConnectionPart, OutputPart, PluginPart, StringPart
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.base import Loss
from tonewood.instrument.contract.gestures import Fraction

_HEAD = "| key | value | default | meaning |\n|---|---|---|---|\n"


def bundle_tables() -> str:
    """Every key of the format, one table per mapping."""
    parts: list[tuple[str, type[BaseModel]]] = [
        ("instrument.yaml", Bundle),
        ("body, exciters.NAME (any part a plugin makes)", PluginPart),
        ("body, beside the plugin's own keys", BodyPart),
        ("strings.NAME and strings.defaults, beside the plugin's own keys", StringPart),
        ("connections.NAME, beside the plugin's own keys", ConnectionPart),
        ("outputs, each entry, beside the plugin's own keys", OutputPart),
    ]
    done: list[type[BaseModel]] = [model for _, model in parts]
    text = [f"**{title}**\n\n{parameter_table(model)}" for title, model in parts]
    for model in done:
        for field in model.model_fields.values():
            for inner in _models(field.annotation):
                if inner not in done:
                    done.append(inner)
                    text.append(f"**{inner.__name__}**: {_first_line(inner)}\n\n{parameter_table(inner)}")
    return "\n".join(text)


def plugin_tables() -> str:
    """Parameters of every built-in plugin."""
    text = []
    done: list[type[BaseModel]] = [Fraction]
    for name, plugin in registry.list_plugins().items():
        if registry.entries(registry.PLUGINS)[name].distribution != "tonewood":
            continue
        text.append(f"**{name}** ({plugin.kind})\n\n{parameter_table(plugin.Parameters)}")
        inner = [m for field in plugin.Parameters.model_fields.values() for m in _models(field.annotation)]
        for model in dict.fromkeys(inner):
            if model not in done:
                done.append(model)
                text.append(f"*{name}*, {model.__name__}: {_first_line(model)}\n\n{parameter_table(model)}")
    return "\n".join(text)


def parameter_table(model: type[BaseModel]) -> str:
    """Table of the fields of one model: key, value, default and meaning."""
    rows = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else _default(field)
        rows.append(f"| `{field.alias or name}` | {_value(field)} | {default} | {field.description} |")
    return _HEAD + "\n".join(rows) + "\n"


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().splitlines()[0]


def _default(field: FieldInfo) -> str:
    value = field.default
    if value is None or value is PydanticUndefined:
        return "none"
    if isinstance(value, BaseModel):
        return "see below"
    return f"`{value}`" if value not in ({}, []) else "empty"


def _value(field: FieldInfo) -> str:
    """Type, unit and range in a few words."""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    limits = {type(m).__name__: m for m in field.metadata}
    low, high = getattr(limits.get("Ge"), "ge", None), getattr(limits.get("Le"), "le", None)
    unit = str(extra.get("unit", ""))
    kind = _type(field.annotation)
    if unit:
        kind = "number" if unit == "1" else f"number ({unit})"
    if low is not None and high is not None:
        return f"{kind}, {low:g} to {high:g}"
    return kind + (f", from {low:g}" if low is not None else f", to {high:g}" if high is not None else "")


def _type(annotation: Any) -> str:
    origin, args = get_origin(annotation), get_args(annotation)
    if (origin or annotation) is Loss:
        return "loss law: `law`, the name of one, and its keys"
    if origin is Literal:
        return ", ".join(f"`{a}`" for a in args)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(a) for a in args if a is not type(None)))
    if origin is list:
        return f"list of {_type(args[0])}"
    if origin is tuple:
        return f"list of {_type(args[0])}" if args[-1] is Ellipsis else f"{len(args)} numbers"
    if origin is dict:
        return f"NAME: {_type(args[1])}"
    if hasattr(annotation, "__metadata__"):
        return _type(args[0])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation.__name__
    return {str: "text", float: "number", int: "whole number", bool: "true, false"}.get(annotation, "value")


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return list(dict.fromkeys(m for a in get_args(annotation) for m in _models(a)))


def inserted(page: str) -> str:
    """Return a page with the tables between its marks ``<!-- NAME -->`` and ``<!-- end of NAME -->``."""
    for name, tables in (("bundle tables", bundle_tables()), ("plugin tables", plugin_tables())):
        between = re.compile(f"(<!-- {name} -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        plain = tables.replace("\\", r"\\")  # nothing in a table stands for a group
        page = between.sub(rf"\g<1>\n{plain}\n\g<2>", page)
    return page


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        path.write_text(inserted(path.read_text(encoding="utf-8")), encoding="utf-8")
