"""The type of a parameter that is a loss law: ``loss: {law: NAME, ...}`` in a bundle becomes the plugin of that name.

>>> from tonewood.plugins.stiff_string import StiffString
>>> values = {"length": 0.65, "tension": 70.0, "linear_density": 4e-3, "loss": {"law": "sigma", "sigma0": 0.5}}
>>> StiffString.from_values(values).parameters.loss.parameters.sigma0
0.5
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, core_schema

from tonewood.errors import BundleError, PluginError, kind_of
from tonewood.instrument.contract.base import Loss
from tonewood.instrument.contract.bundle_code import CODE_PATTERN, plugin_named
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.registry import list_plugins


class _LawField:
    """Tells pydantic how a loss law is read, written and described."""

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(_written)
        name = handler.field_name  # before pydantic 2.12 `info` does not know it here

        def read(value: Any, info: ValidationInfo) -> Loss[Any]:
            return _read(value, info, info.field_name or name or "")

        return core_schema.with_info_plain_validator_function(read, serialization=written)

    @staticmethod
    def __get_pydantic_json_schema__(schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        laws = {name: law for name, law in list_plugins().items() if law.kind == Loss.kind}
        return {"anyOf": [*(_branch(name, law.Parameters, handler) for name, law in laws.items()), _CODE_BRANCH]}


#: a loss law in a bundle's folder, whose own keys are not known here
_CODE_BRANCH = {
    "type": "object",
    "title": "loss law in the bundle's folder",
    "properties": {"law": {"type": "string", "pattern": rf"^{CODE_PATTERN}$", "description": "FILE.py:CLASS"}},
    "required": ["law"],
    "additionalProperties": True,
}


def _branch(name: str, parameters: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
    """Schema of one law: its name, and its own keys."""
    schema = handler.resolve_ref_schema(handler(parameters.__pydantic_core_schema__))
    law = {"const": name, "description": "chooses this law"}
    required = ["law", *schema.get("required", [])]
    return {**schema, "title": name, "properties": {"law": law, **schema.get("properties", {})}, "required": required}


def _read(value: Any, info: ValidationInfo, field: str) -> Loss[Any]:
    """Make the plugin of a law from its name and its parameters."""
    if isinstance(value, Loss):
        return value
    context = info.context or {}
    files = context.get("files") or Files(None)
    key = ".".join(part for part in (context.get("key", ""), field) if part)
    if not isinstance(value, Mapping):
        reason = f"is {kind_of(value)}; a mapping with the key law, the name of a loss law, is wanted"
        raise BundleError(reason, file=files.manifest, key=key)
    values = dict(value)
    name = values.pop("law", None)
    if not isinstance(name, str):
        names = ", ".join(name for name, law in list_plugins().items() if law.kind == Loss.kind)
        reason = "is missing" if name is None else f"is {kind_of(name)}; the name of a loss law is wanted: {names}"
        raise BundleError(reason, file=files.manifest, key=f"{key}.law")
    try:
        kind: Any = plugin_named(name, Loss.kind, files)
    except PluginError as fault:
        raise BundleError(fault.reason, file=files.manifest, key=f"{key}.law") from None
    law: Loss[Any] = kind.from_values(values, files, key)
    law.law = name
    return law


def _written(law: Loss[Any]) -> dict[str, Any]:
    return {"law": law.law, **law.parameters.model_dump(mode="json", by_alias=True)}


#: type of a parameter: a loss law, by its name and its own parameters
LossLaw = Annotated[Loss[Any], _LawField]
