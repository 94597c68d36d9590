"""Override paths: dotted keys with ``*`` for one level, the same on the command line, in Python and in batches.

    strings.E2.note=D2     strings.*.bending_stiffness={scale: 2}     exciters.pluck.from_bridge={fraction: .4}

A member of a list is named by its ``name``, or by its number from 0.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

from tonewood.errors import BundleError
from tonewood.support.validation_messages import did_you_mean
from tonewood.support.yaml_io import parse_yaml

#: pairs of keys that exclude each other: an override of one removes the other
_INSTEAD = {"note": "freq", "freq": "note"}


def parse_assignment(text: str) -> tuple[str, Any]:
    """Read ``PATH=VALUE``; the value is a YAML value such as ``2e-3``, ``D2`` or ``{scale: 2}``.

    Raises BundleError : not of that form.
    """
    path, equals, value = text.partition("=")
    path = path.strip()
    if not equals or not path or not value.strip():
        raise BundleError(f"{text!r} is not PATH=VALUE, e.g. strings.E2.note=D2")
    try:
        return path, parse_yaml(f"value: {value}", error=BundleError)["value"]
    except BundleError as fault:
        raise BundleError(f"{value!r}: {fault.reason}", key=path) from None


def apply_overrides(values: Mapping[str, Any], overrides: Mapping[str, Any], *, file: Any = None) -> dict[str, Any]:
    """Return a copy of nested plain values with the overrides applied in their order.

    Raises BundleError : a path leads nowhere, or a value to be scaled is not a number.
    """
    out = copy.deepcopy(dict(values))
    for path, value in overrides.items():
        *above, last = path.split(".")
        if not last or "" in above:
            raise BundleError("is not a dotted path", file=file, key=path)
        for prefix, holder in _holders(out, above, [], path, file):
            for key in _keys(holder, last, path, prefix, file):
                _assign(holder, key, value, [*prefix, str(key)], file)
    return out


def _holders(
    at: Any, path: list[str], prefix: list[str], whole: str, file: Any
) -> Iterator[tuple[list[str], dict[str, Any] | list[Any]]]:
    if not isinstance(at, dict | list):
        raise BundleError(f"{'.'.join(prefix)} holds a value, nothing lies below it", file=file, key=whole)
    if not path:
        yield prefix, at
        return
    for key in _keys(at, path[0], whole, prefix, file):
        if isinstance(at, dict) and key not in at:
            allowed = f"{did_you_mean(key, map(str, at))}there is {', '.join(map(str, at)) or 'nothing'}"
            raise BundleError(f"there is no {key!r}; {allowed}", file=file, key=whole)
        below = at[key]
        yield from _holders(below, path[1:], [*prefix, str(key)], whole, file)


def _keys(holder: dict[str, Any] | list[Any], key: str, whole: str, prefix: list[str], file: Any) -> list[Any]:
    if isinstance(holder, dict):
        return list(holder) if key == "*" else [key]
    names = [member.get("name") if isinstance(member, dict) else None for member in holder]
    if key == "*":
        return list(range(len(holder)))
    if key in names:
        return [names.index(key)]
    if key.isascii() and key.isdigit() and int(key) < len(holder):
        return [int(key)]
    choices = ", ".join(str(n) for n in names if n) or f"0 to {len(holder) - 1}"
    hint = did_you_mean(key, [str(n) for n in names if n])
    raise BundleError(f"there is no {key!r} in {'.'.join(prefix)}; {hint}there is {choices}", file=file, key=whole)


def _assign(holder: dict[str, Any] | list[Any], key: Any, value: Any, prefix: list[str], file: Any) -> None:
    if isinstance(value, Mapping) and set(value) == {"scale"}:
        old = holder.get(key) if isinstance(holder, dict) else holder[key]
        factor = value["scale"]
        if not all(isinstance(x, int | float) and not isinstance(x, bool) for x in (old, factor)):
            reason = f"{old!r} cannot be scaled by {factor!r}: numbers are wanted"
            raise BundleError(reason, file=file, key=".".join(prefix))
        value = old * factor
    holder[key] = copy.deepcopy(value)
    other = _INSTEAD.get(str(key))
    if other and len(prefix) == 3 and prefix[0] == "strings" and isinstance(holder, dict) and value is not None:
        holder[other] = None
