"""One line for a failed validation: the dotted key, and the fault of its value."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from tonewood.support.units import as_float

#: kinds of pydantic's errors for a number beyond a bound -> its name there, and words
_BOUNDS = {
    "less_than_equal": ("le", "at most"),
    "less_than": ("lt", "less than"),
    "greater_than_equal": ("ge", "at least"),
    "greater_than": ("gt", "more than"),
}
#: units in which people measure -> in SI
_SCALES = {
    "m": {"mm": 1e-3, "cm": 1e-2},
    "s": {"ms": 1e-3},
    "kg": {"g": 1e-3},
    "kg/m": {"g/m": 1e-3},
    "Hz": {"kHz": 1e3},
    "Pa": {"MPa": 1e6, "GPa": 1e9},
    "N": {"mN": 1e-3, "kN": 1e3},
    "N/m": {"N/mm": 1e3},
    "kg/m^3": {"g/cm^3": 1e3},
    "1": {"%": 1e-2},
}
_PLACE = re.compile(r"([\w.*-]+): ")
#: a number and its unit
_WITH_UNIT = re.compile(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*[a-zA-Zµ%][\w/^%]*\s*$")
_CONTAINERS = (dict, list, tuple, Mapping, Sequence)
#: prefix by pydantic of the text of a check's own error
_RAISED = re.compile(r"^(Value error|Assertion failed), ")


def first_message(error: ValidationError, model: type[BaseModel]) -> tuple[str, str]:
    """Dotted key and reason of the first fault of a validation against `model`.

    Parts of a location that are not keys of the file (the tags pydantic puts in for members of a union) are left
    out. An unknown key is answered with the keys allowed beside it, and comes before a missing one that it resembles; a
    key of earlier versions is answered by the model's mapping `removed`, a number beyond its bounds by these in units.
    """
    return _message(error.errors(include_url=False), model)


def all_messages(error: ValidationError, model: type[BaseModel]) -> list[tuple[str, str]]:
    """As `first_message`, of every fault; members of a union, and places inside a faulty value, are one fault."""
    faults = error.errors(include_url=False)
    answered = [f for f in faults if not _spelt_otherwise(f, faults)]
    places = {i: ".".join(_walk(f["loc"], model)[0]) for i, f in enumerate(answered)}
    groups: dict[str, list[Any]] = {}
    for path in sorted(set(places.values()), key=len):
        if not any(path.startswith(above + ".") for above in groups):
            groups[path] = []
    for i, fault in enumerate(answered):
        above = next(g for g in groups if places[i] == g or places[i].startswith(g + "."))
        groups[above].append(fault)
    order = sorted(groups, key=lambda g: next(i for i, f in enumerate(answered) if f in groups[g]))
    return [_message(groups[g], model) for g in order]


def _message(faults: Sequence[Any], model: type[BaseModel]) -> tuple[str, str]:
    fault = next((f for f in faults if _misspelt(f, faults)), _within(faults))
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
    if kind in _BOUNDS and (beyond := _beyond(fault, keys, owners)):
        return ".".join(keys), beyond
    named = None if keys else _PLACE.match(reason)  # a check over several keys that names its own place
    if named:
        return named[1], reason[named.end() :]
    same_place = [f["msg"] for f in faults if _walk(f["loc"], model)[0] == keys]  # members of a union
    if kind in _BOUNDS:  # of a number: it is no other member
        same_place = [fault["msg"]]
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
        elif containers := [a for a in here if _holds(a, part)]:
            here = [t for c in containers for t in _members(get_args(c)[-1])]
        elif named := [m for m in models if part == m.__name__ and len(here) > 1]:  # a member of a union
            owners = here = named
            continue
        elif models and len(models) == len(here):
            owners, here = models, []
        else:  # name of a union's member, e.g. "float" or "list[str]"
            continue
        keys.append(str(part))
    return keys, owners


def _holds(annotation: Any, part: int | str) -> bool:
    """Whether a list or mapping may have a member of that number or name."""
    origin = get_origin(annotation)
    return origin in _CONTAINERS and (isinstance(part, int) or origin in (dict, Mapping))


def _fields(model: type[BaseModel]) -> dict[int | str, Any]:
    return {f.alias or name: f.annotation for name, f in model.model_fields.items()}


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    fields = [f.annotation for f in model.model_fields.values()]
    return tuple(value for a in fields if get_origin(a) is Literal for value in get_args(a))


def _members(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [t for part in get_args(annotation) if part is not NoneType for t in _members(part)]
    return [annotation]


def _unknown(key: str, owners: list[type[BaseModel]]) -> str:
    for m in owners:
        if key in (removed := getattr(m, "removed", {})):
            return str(removed[key])
    allowed = list(dict.fromkeys(str(k) for m in owners for k in _fields(m)))
    return f"is not a known key; {did_you_mean(key, allowed)}allowed: {', '.join(allowed)}"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """``did you mean tension? `` for a name that resembles a known one in its last part, else nothing."""
    spelt = {word.lower().rpartition(".")[2]: word for word in names}
    close = difflib.get_close_matches(name.lower().rpartition(".")[2], spelt, n=1, cutoff=0.7)
    return f"did you mean {spelt[close[0]]}? " if close else ""


def _within(faults: Sequence[Any]) -> Any:
    """First fault, or the first one inside a mapping that is no number, where a union allows both."""
    first = faults[0]
    if isinstance(first["input"], Mapping) and first["type"].endswith("_type"):
        return next((f for f in faults if f["loc"][:-2] == first["loc"][:-1]), first)
    return first


def _misspelt(fault: Any, faults: Sequence[Any]) -> bool:
    """Whether a fault is an unknown key that resembles a missing one beside it."""
    missing = [f["loc"][-1] for f in faults if f["type"] == "missing" and f["loc"][:-1] == fault["loc"][:-1]]
    return fault["type"] == "extra_forbidden" and bool(did_you_mean(str(fault["loc"][-1]), map(str, missing)))


def _spelt_otherwise(fault: Any, faults: Sequence[Any]) -> bool:
    """Whether a fault is a missing key that an unknown one beside it resembles."""
    beside = [f for f in faults if f["type"] == "extra_forbidden" and f["loc"][:-1] == fault["loc"][:-1]]
    last = str(fault["loc"][-1]) if fault["loc"] else ""
    return fault["type"] == "missing" and any(did_you_mean(str(f["loc"][-1]), [last]) for f in beside)


def _beyond(fault: Any, keys: Sequence[str], owners: Sequence[type[BaseModel]]) -> str | None:
    """``is 650 m; at most 5 m: did you mean 650 mm (0.65)?``; None for a number without a declared unit."""
    fields = [f for m in owners for name, f in m.model_fields.items() if keys and keys[-1] in (name, f.alias)]
    unit = next((unit_of(f) for f in fields if unit_of(f)), None)
    value, (bound, words) = fault["input"], _BOUNDS[fault["type"]]
    if unit is None or not isinstance(value, (int, float)):
        return None
    value = as_float(value)
    scaled = [(name, value * factor) for name, factor in _SCALES.get(unit, {}).items()]
    ranges = [usual_values(f) for f in fields if unit_of(f)]
    likely = [(name, x) for name, x in scaled if all(low < x < high for low, high in ranges)]
    meant = " or ".join(f"{value:.12g} {name} ({x:.6g})" for name, x in likely)
    of = "" if unit == "1" else f" {unit}"
    hint = f": did you mean {meant}?" if meant else " is allowed"
    return f"is {value:.12g}{of}; {words} {fault['ctx'][bound]:.12g}{of}{hint}"


def usual_values(field: FieldInfo) -> tuple[float, float]:
    """Range in which a value is plausible, and another unit worth a hint.

    It is the field's own where that is declared. Else it is the range allowed less a sixth of its decades at either
    end, and where that begins at 0 or below, the three decades below its end; empty (inf, -inf) without an upper bound.
    """
    extra = field.json_schema_extra
    if isinstance(extra, dict) and isinstance(declared := extra.get("usual"), (list, tuple)):
        low, high = (float(str(x)) for x in declared)
        return low, high
    low, high = max(_limits(field, "ge", "gt"), default=-math.inf), min(_limits(field, "le", "lt"), default=math.inf)
    if not 0.0 < high < math.inf:
        return math.inf, -math.inf
    if low <= 0.0:
        return 1e-3 * high, high
    inset = (high / low) ** (1 / 6)
    return low * inset, high / inset


def unit_of(field: FieldInfo) -> str:
    """Unit of a number; empty for any other field."""
    extra = field.json_schema_extra
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def _limits(field: FieldInfo, *names: str) -> list[float]:
    return [float(getattr(m, name)) for m in field.metadata for name in names if hasattr(m, name)]


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


def _shown(fault: Any) -> str:
    value = fault["input"]
    plain = isinstance(value, (str, int, float)) or value is None
    unit = (
        ": numbers are in SI units and stand without them" if isinstance(value, str) and _WITH_UNIT.match(value) else ""
    )
    return f", not {value!r}{unit}" if plain and len(repr(value)) <= 60 else ""


def _discriminator(fault: Any) -> str:
    return str(fault["ctx"]["discriminator"]).strip("'")
