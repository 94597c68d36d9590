"""One line for a failed validation: the dotted key, and what is wrong with its value."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

_PLACE = re.compile(r"([\w.*-]+): ")
_CONTAINERS = (dict, list, tuple, Mapping, Sequence)
#: what pydantic puts before the text of a check's own error
_RAISED = re.compile(r"^(Value error|Assertion failed), ")


def first_message(error: ValidationError, model: type[BaseModel]) -> tuple[str, str]:
    """Dotted key and reason of the first fault of a validation against `model`.

    Parts of a location that are not keys of the file (the tags pydantic puts in for members of a union) are left
    out. An unknown key is answered with the keys allowed beside it; a key of earlier versions with what the model's
    mapping `removed` says of it.
    """
    faults = error.errors(include_url=False)
    fault = faults[0]
    keys, owners = _walk(fault["loc"], model)
    kind, reason = fault["type"], _RAISED.sub("", fault["msg"])
    if kind == "extra_forbidden":
        return ".".join(keys), _unknown(str(fault["loc"][-1]), owners)
    if kind == "missing":
        return ".".join(keys), "is missing"
    if kind == "union_tag_not_found":
        return ".".join([*keys, _discriminator(fault)]), "is missing"
    if kind == "union_tag_invalid":
        context = fault["ctx"]
        return ".".join([*keys, _discriminator(fault)]), f"{context['tag']} is not one of {context['expected_tags']}"
    named = None if keys else _PLACE.match(reason)  # a check over several keys that names its own place
    if named:
        return named[1], reason[named.end() :]
    same_place = [f["msg"] for f in faults if _walk(f["loc"], model)[0] == keys]  # members of a union
    first, *others = dict.fromkeys(_RAISED.sub("", text) for text in same_place)
    return ".".join(keys), "; or ".join([first, *map(_lower_first, others)]) + _shown(fault)


def _walk(loc: Sequence[int | str], model: type[BaseModel]) -> tuple[list[str], list[type[BaseModel]]]:
    """Keys of the file along `loc`, and the models the last key may belong to."""
    keys: list[str] = []
    here: list[Any] = [model]
    owners: list[type[BaseModel]] = [model]
    for part in loc:
        models = [m for m in here if isinstance(m, type) and issubclass(m, BaseModel)]
        inside = [_fields(m)[part] for m in models if part in _fields(m)]
        if inside:
            owners, here = models, [t for annotation in inside for t in _members(annotation)]
        elif tagged := [m for m in models if part in _tags(m)]:
            owners = here = tagged
            continue
        elif containers := [a for a in here if get_origin(a) in _CONTAINERS]:
            here = [t for c in containers for t in _members(get_args(c)[-1])]
        elif models:
            owners, here = models, []
        else:  # name of a union's member, e.g. "float" or "list[str]"
            continue
        keys.append(str(part))
    return keys, owners


def _fields(model: type[BaseModel]) -> dict[int | str, Any]:
    return {f.alias or name: f.annotation for name, f in model.model_fields.items()}


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    fields = [f.annotation for f in model.model_fields.values()]
    return tuple(value for a in fields if get_origin(a) is Literal for value in get_args(a))


def _members(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [t for part in get_args(annotation) for t in _members(part)]
    return [annotation]


def _unknown(key: str, owners: list[type[BaseModel]]) -> str:
    for m in owners:
        if key in (removed := getattr(m, "removed", {})):
            return str(removed[key])
    allowed = list(dict.fromkeys(str(k) for m in owners for k in _fields(m)))
    close = difflib.get_close_matches(key, allowed, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"is not a known key; {hint}allowed: {', '.join(allowed)}"


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


def _shown(fault: Any) -> str:
    value = fault["input"]
    plain = isinstance(value, (str, int, float)) or value is None
    return f", not {value!r}" if plain and len(repr(value)) <= 60 else ""


def _discriminator(fault: Any) -> str:
    return str(fault["ctx"]["discriminator"]).strip("'")
