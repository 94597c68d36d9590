"""Parameters declared once: type, unit, range and meaning; validation, JSON schema and tables all follow from that.

>>> class Spring(Parameters):
...     stiffness: float = quantity("N/m", low=0.0, doc="restoring force per displacement")
>>> Spring(stiffness=2.0).stiffness
2.0
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tonewood.errors import BundleError
from tonewood.support.validation_messages import first_message

#: a number as it stands in a file: no text, no true/false
Number = Annotated[float, Field(strict=True)]
#: three numbers: x from nut to bridge, y from bass to treble, z out of the soundboard
Vector = tuple[Number, Number, Number]

_MISSING: Any = object()
_P = TypeVar("_P", bound="Parameters")


class Parameters(BaseModel):
    """Base of every set of parameters: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=False)


def quantity(
    unit: str,
    *,
    low: float | None = None,
    high: float | None = None,
    usual: tuple[float, float] | None = None,
    default: Any = _MISSING,
    doc: str,
) -> Any:
    """Declare a number with its unit.

    Parameters
    ----------
    unit : SI, ``"1"`` for a pure number; another unit only where the key's name ends in it (``_deg``, ``_cents``).
    low, high : smallest and largest value allowed, both included.
    usual : smallest and largest value that users mean, for hints at another unit; from `low` and `high` where left
        out (`validation_messages.usual_values`).
    default : value where the key is left out; without it the key is required.
    doc : its meaning, in a few words.
    """
    extra = {"unit": unit} if usual is None else {"unit": unit, "usual": list(usual)}
    options: dict[str, Any] = {"description": doc, "json_schema_extra": extra, "strict": True}
    if low is not None:
        options["ge"] = low
    if high is not None:
        options["le"] = high
    return Field(**options) if default is _MISSING else Field(default, **options)


def described(doc: str, *, default: Any = _MISSING, **options: Any) -> Any:
    """Declare anything that is not a number with a unit: a name, a choice, a list.

    Parameters
    ----------
    doc : its meaning, in a few words.
    default : value where the key is left out; without it the key is required.
    options : further ones of pydantic's ``Field``.
    """
    return Field(description=doc, **options) if default is _MISSING else Field(default, description=doc, **options)


def validated(
    model: type[_P],
    values: Mapping[str, Any],
    *,
    key: str,
    file: Any = None,
    context: Mapping[str, Any] | None = None,
) -> _P:
    """Check `values` against a model; fields that read files look into `context`.

    Raises BundleError : one line for the first fault: file, dotted key (below `key`), fault and the values allowed.
    """
    try:
        return model.model_validate(dict(values), context=context)
    except ValidationError as fault:
        where, reason = first_message(fault, model)
        raise BundleError(reason, file=file, key=".".join(part for part in (key, where) if part)) from None
