"""Parameters declared once: type, unit, range and meaning; validation, JSON schema and tables all follow from that.

>>> class Spring(Parameters):
...     stiffness: float = quantity("N/m", low=0.0, doc="restoring force per displacement")
>>> Spring(stiffness=2.0).stiffness
2.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tonewood.errors import BundleError

#: a number as it stands in a file: no text, no true/false
Number = Annotated[float, Field(strict=True)]
Vector = tuple[Number, Number, Number]

_MISSING: Any = object()
_P = TypeVar("_P", bound="Parameters")


class Parameters(BaseModel):
    """Base of every set of parameters: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=False)


def quantity(
    unit: str, *, low: float | None = None, high: float | None = None, default: Any = _MISSING, doc: str
) -> Any:
    """Declare a number with its unit.

    Parameters
    ----------
    unit : SI, ``"1"`` for a pure number; another unit only where the key's name ends in it (``_deg``, ``_cents``).
    low, high : smallest and largest value allowed, both included.
    default : value where the key is left out; without it the key is required.
    doc : what it is, in a few words.
    """
    options: dict[str, Any] = {"description": doc, "json_schema_extra": {"unit": unit}, "strict": True}
    if low is not None:
        options["ge"] = low
    if high is not None:
        options["le"] = high
    return Field(**options) if default is _MISSING else Field(default, **options)


def described(doc: str, *, default: Any = _MISSING, **options: Any) -> Any:
    """Declare anything that is not a number with a unit: a name, a choice, a list."""
    return Field(description=doc, **options) if default is _MISSING else Field(default, description=doc, **options)


def validated(
    model: type[_P], values: Mapping[str, Any], *, key: str, error: type[BundleError] = BundleError, file: Any = None
) -> _P:
    """Check `values` against a model.

    Raises
    ------
    BundleError : one line for the first fault: file, dotted key (below `key`), what is wrong and what is allowed.
    """
    try:
        return model.model_validate(dict(values))
    except ValidationError as fault:
        where, reason = first_fault(fault, model, values)
        raise error(reason, file=file, key=".".join(part for part in (key, where) if part)) from None


def first_fault(fault: ValidationError, model: type[BaseModel], values: object) -> tuple[str, str]:
    """Dotted key and one-line reason of the first fault pydantic found in `values`."""
    item = fault.errors(include_url=False)[0]
    place = _place(item["loc"], values)
    kind, value = item["type"], item.get("input")
    if kind == "missing":
        return ".".join(place), "is missing"
    if kind == "extra_forbidden":
        allowed = _allowed(model, place[:-1])
        return ".".join(place), "is not a known key" + (f"; allowed: {', '.join(allowed)}" if allowed else "")
    message = item["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    shown = repr(value)
    if isinstance(value, Mapping) or len(shown) > 60:
        return ".".join(place), message
    return ".".join(place), f"{message}, not {shown}"


def _place(loc: tuple[int | str, ...], values: object) -> list[str]:
    """Keys as they stand in the file: pydantic's place less the branches of unions it names between them."""
    place: list[str] = []
    at = values
    for i, part in enumerate(loc):
        member = isinstance(at, Sequence) and isinstance(part, int) and part < len(at)
        if member or (isinstance(at, Mapping) and part in at):
            at = cast(Any, at)[part]
        elif not (i == len(loc) - 1 and isinstance(at, Mapping)):
            continue
        place.append(str(part))
    return place


def _allowed(model: type[BaseModel], place: list[str]) -> list[str]:
    """Keys of the model found by following `place`; empty where it cannot be followed."""
    current: Any = model
    for part in place:
        inner = _model_in(current)
        if inner is not None:
            by_key = {field.alias or name: field for name, field in inner.model_fields.items()}
            current = by_key[part].annotation if part in by_key else None
        else:
            current = (get_args(current) or (None,))[-1]  # a member of a list or mapping
    found = _model_in(current)
    return [field.alias or name for name, field in found.model_fields.items()] if found else []


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The one model an annotation names, not counting those inside its lists and mappings."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (list, dict, tuple):
        return None
    found = [m for m in map(_model_in, get_args(annotation)) if m is not None]
    return found[0] if len(found) == 1 else None
