"""The bundle format as JSON Schema, for editors: `tonewood-instrument/2` with the keys of every installed plugin."""

from __future__ import annotations

import copy
from typing import Any

from pydantic.json_schema import models_json_schema

from tonewood.instrument.bundle.schema import (
    SCHEMA,
    BodyPart,
    Bundle,
    ConnectionPart,
    OutputPart,
    PluginPart,
    StringPart,
)
from tonewood.instrument.contract import registry
from tonewood.instrument.contract.bundle_code import CODE_PATTERN

_PARTS: dict[str, tuple[str, type[PluginPart]]] = {
    "BodyPart": ("body", BodyPart),
    "ConnectionPart": ("connection", ConnectionPart),
    "ExciterPart": ("exciter", PluginPart),
    "StringPart": ("resonator", StringPart),
    "OutputPart": ("pickup", OutputPart),
}


def bundle_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of ``instrument.yaml``.

    A part may be any installed plugin of its kind, or one in the bundle's folder, whose own keys are not known here.
    Keys of a string may come from `defaults`, so that none is required here; the loader checks them.
    """
    schema = Bundle.model_json_schema(by_alias=True, mode="validation")
    definitions = schema.setdefault("$defs", {})
    for name, (kind, common) in _PARTS.items():
        definitions[name] = {"anyOf": _branches(kind, common, definitions, required=name != "StringPart")}
    properties = schema["properties"]
    properties["body"] = {**_described(properties["body"]), "$ref": "#/$defs/BodyPart"}
    properties["exciters"]["additionalProperties"] = {"$ref": "#/$defs/ExciterPart"}
    for keyed in ("connections", "exciters", "strings", "sources"):
        # names are checked by the loader; patternProperties would hide the entries from editors
        entry = properties[keyed].pop("patternProperties", None)
        if entry:
            properties[keyed]["additionalProperties"] = next(iter(entry.values()))
        properties[keyed].pop("propertyNames", None)
    properties["connections"]["additionalProperties"] = {"$ref": "#/$defs/ConnectionPart"}
    properties["exciters"]["additionalProperties"] = {"$ref": "#/$defs/ExciterPart"}
    properties["strings"]["additionalProperties"] = {"$ref": "#/$defs/StringPart"}
    definitions.pop("PluginPart", None)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{SCHEMA.replace('/', ':')}",
        **schema,
    }


def _described(entry: dict[str, Any]) -> dict[str, Any]:
    return {key: entry[key] for key in ("description", "title") if key in entry}


def _branches(
    kind: str, common: type[PluginPart], definitions: dict[str, Any], *, required: bool
) -> list[dict[str, Any]]:
    """One schema per installed plugin of a kind: the common keys and its own."""
    out = []
    for name, plugin in registry.list_plugins().items():
        if plugin.kind != kind:
            continue
        _, schema = models_json_schema([(plugin.Parameters, "validation")], by_alias=True)
        schema = _prefixed(schema["$defs"], name)
        definitions.update(
            {key: value for key, value in schema.items() if key != f"{name}.{plugin.Parameters.__name__}"}
        )
        parameters = schema[f"{name}.{plugin.Parameters.__name__}"]
        _, base = models_json_schema([(common, "validation")], by_alias=True)
        shared = copy.deepcopy(base["$defs"][common.__name__])
        definitions.update({key: value for key, value in base["$defs"].items() if key != common.__name__})
        properties = {**shared["properties"], **parameters["properties"], "plugin": {"const": name}}
        branch = {
            "type": "object",
            "title": name,
            "description": parameters.get("description", ""),
            "properties": properties,
            "additionalProperties": False,
        }
        if required:
            branch["required"] = sorted({*shared.get("required", []), *parameters.get("required", [])})
        out.append(branch)
    out.append(_code_branch(kind, common))
    return out


def _code_branch(kind: str, common: type[PluginPart]) -> dict[str, Any]:
    """Schema of a part whose plugin lies in the bundle's folder: its own keys are not known here."""
    _, base = models_json_schema([(common, "validation")], by_alias=True)
    shared = copy.deepcopy(base["$defs"][common.__name__])
    plugin = {"type": "string", "pattern": rf"^{CODE_PATTERN}$", "description": "FILE.py:CLASS"}
    return {
        "type": "object",
        "title": f"{kind} in the bundle's folder",
        "properties": {**shared["properties"], "plugin": plugin},
        "required": ["plugin"],
        "additionalProperties": True,
    }


def _prefixed(definitions: dict[str, Any], prefix: str) -> dict[str, Any]:
    """Give one plugin's definitions names of its own."""

    def turned(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                k: f"#/$defs/{prefix}.{v.removeprefix('#/$defs/')}" if k == "$ref" else turned(v)
                for k, v in value.items()
            }
        return [turned(v) for v in value] if isinstance(value, list) else value

    out = {f"{prefix}.{key}": turned(value) for key, value in definitions.items()}
    for value in out.values():
        # "mapping" of a discriminator is not JSON Schema, and its references would need renaming too
        _drop_discriminators(value)
    return out


def _drop_discriminators(value: Any) -> None:
    if isinstance(value, dict):
        value.pop("discriminator", None)
        for inner in value.values():
            _drop_discriminators(inner)
    elif isinstance(value, list):
        for inner in value:
            _drop_discriminators(inner)
