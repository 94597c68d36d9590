"""Knobs from declared parameters: every value of a bundle with its range, unit and meaning, of any plugin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import Bundle
from tonewood.instrument.contract.base import Exciter, Plugin
from tonewood.workshop.report.parameters import alternatives, field_at, flattened, plugins_of

#: keys of a bundle that change the sound, in the order of the page
SECTIONS = ("exciters", "playing", "strings", "body", "connections", "stops", "tuning", "outputs", "effects")
#: the group of factors on all strings
ALL = "strings.*"
#: largest ratio of a knob's ends; a number field takes all that is allowed
_WIDE, _REACH = 100.0, 4.0


@dataclass(frozen=True, slots=True)
class Knob:
    """A value that may be changed.

    path : dotted key, as ``--set`` takes it.
    kind : number, factor (on the values of all strings), choice, switch or value (JSON).
    low, high : allowed; None where there is no limit.
    at_once : whether it needs no new model.
    """

    path: str
    label: str
    kind: Literal["number", "factor", "choice", "switch", "value"]
    value: Any
    low: float | None
    high: float | None
    start: float
    stop: float
    log: bool
    whole: bool
    unit: str
    doc: str
    choices: tuple[Any, ...]
    at_once: bool


def groups(instrument: Instrument) -> list[str]:
    """Names of the groups of knobs: a part of the instrument each."""
    out = []
    for section in SECTIONS:
        value = instrument.resolved.get(section)
        if section in ("exciters", "strings", "connections") and isinstance(value, Mapping):
            out += [ALL] if section == "strings" and len(value) > 1 else []
            out += [f"{section}.{name}" for name in value]
        elif section == "outputs" and isinstance(value, list):
            out += [f"outputs.{part['name']}" for part in value]
        elif section == "body" and isinstance(value, Mapping):
            out += ["body", *(f"body.{key}" for key, part in value.items() if _many(part))]
        elif value:
            out.append(section)
    return out


def _many(part: Any) -> bool:
    """Whether values of a body are a group of their own: braces, points."""
    return isinstance(part, Mapping) and any(isinstance(inner, Mapping) for inner in part.values())


def knobs(instrument: Instrument, group: str, about: Instrument | None = None) -> list[Knob]:
    """Knobs of one group of an instrument; none where there is no such group.

    group : one of `groups`.
    about : in the middle of whose values the knobs stand; the instrument itself where left out.
    """
    middle = dict(flattened(_under((about or instrument).resolved, group), group))
    named = groups(instrument)
    if group not in named:
        return []
    if group == ALL:
        return list(_factors(instrument))
    taken = [other for other in named if other.startswith(f"{group}.")]
    return [
        knob
        for path, value in flattened(_under(instrument.resolved, group), group)
        if not any(path.startswith(f"{other}.") for other in taken)
        and (knob := _knob(instrument, path, group, value, middle.get(path, value)))
    ]


def shown(design: Instrument, start: Instrument, changes: Mapping[str, Any], group: str) -> list[dict[str, Any]]:
    """Return the knobs of a group as plain data, with the values of the design and of the start."""
    before = {knob.path: knob.value for knob in knobs(start, group)}
    out = []
    for knob in knobs(design, group, start):
        values = asdict(knob) | {"start_value": before.get(knob.path)}
        if knob.kind == "factor" and isinstance(changed := changes.get(knob.path), Mapping):
            values["value"] = changed.get("scale", 1.0)
        out.append(values)
    return out


def _under(values: Any, group: str) -> Any:
    for key in group.split("."):
        if isinstance(values, list):
            values = next((v for v in values if v.get("name") == key), None)
        else:
            values = values.get(key) if isinstance(values, Mapping) else None
    return {} if values is None else values


def _factors(instrument: Instrument) -> Iterator[Knob]:
    """Factors on the numbers that all strings have."""
    strings = list(instrument.resolved["strings"].values())
    first = next(iter(instrument.resolved["strings"]))
    for path, _ in flattened(strings[0]):
        key = path.split(".")
        same = [_under(part, path) for part in strings]
        declared = declared_field(instrument, f"strings.{first}.{path}")
        if all(_is_number(x) and x != 0 for x in same) and not _is_whole(declared):
            doc = "" if declared is None else declared.description or ""
            yield Knob(
                path=f"{ALL}.{path}", label=" ".join(key), kind="factor", value=1.0, low=None, high=None, start=0.5,
                stop=2.0, log=True, whole=False, unit="times", doc=f"all strings: {doc}", choices=(), at_once=False,
            )  # fmt: skip


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(field: FieldInfo | None) -> bool:
    return field is not None and int in alternatives(field.annotation)


def _knob(instrument: Instrument, path: str, group: str, value: Any, middle: Any) -> Knob | None:
    label = path.removeprefix(f"{group}.").replace(".", " ")
    if label in ("plugin", "name") or path == "schema":
        return None
    field = declared_field(instrument, path)
    extra = field.json_schema_extra if field is not None and isinstance(field.json_schema_extra, dict) else {}
    words = _words(field)
    kind: Literal["number", "choice", "switch", "value"] = "value"
    if isinstance(value, bool):
        kind = "switch"
    elif _is_number(value):
        kind = "number"
    elif words and (value in words or value is None):
        kind = "choice"
    low, high = _limits(field)
    start, stop, log = 0.0, 0.0, False
    if kind == "number":
        start, stop, log = span(float(middle if _is_number(middle) else value), low, high)
    unit = str(extra.get("unit", ""))
    return Knob(
        path=path, label=label, kind=kind, value=value, low=low, high=high, start=start, stop=stop, log=log,
        whole=_is_whole(field), unit="" if unit == "1" else unit,
        doc="" if field is None else field.description or "", choices=words,
        at_once=acts_at_once(instrument, path),
    )  # fmt: skip


def span(value: float, low: float | None, high: float | None) -> tuple[float, float, bool]:
    """Ends of a knob, and whether it is logarithmic: all that is allowed, or where that is wide about the value.

    value : in the middle, where the range is wide.
    """
    bounded = low is not None and high is not None and (low <= 0 <= high or high <= _WIDE * low)
    if bounded and low is not None and high is not None and (value == 0 or high - low <= _WIDE * abs(value)):
        return low, high, False
    if value == 0:
        return (-1.0 if low is None else low), (1.0 if high is None else high), False
    a, b = sorted((value / _REACH, value * _REACH))
    return (a if low is None else max(a, low)), (b if high is None else min(b, high)), value > 0


def acts_at_once(instrument: Instrument, path: str) -> bool:
    """Whether a value is of the hands alone, so that strings and body stay: no new model is needed.

    instrument : with the plugins of its exciters; one that puts a part on the string (a hammer) needs a new model.
    """
    kind, _, rest = path.partition(".")
    if kind == "playing":
        return True
    exciter = instrument.exciters.get(rest.partition(".")[0])
    return kind == "exciters" and exciter is not None and type(exciter).attach is Exciter.attach


def same_strings_and_body(a: Instrument, b: Instrument) -> bool:
    """Whether two instruments differ in their hands alone."""
    if a.folder != b.folder:
        return False
    changed = [key for key in a.resolved.keys() | b.resolved.keys() if a.resolved.get(key) != b.resolved.get(key)]
    if not set(changed) <= {"exciters", "playing"}:
        return False
    one, other = dict(flattened(a.resolved["exciters"])), dict(flattened(b.resolved["exciters"]))
    differ = [path for path in one.keys() | other.keys() if one.get(path) != other.get(path)]
    return all(acts_at_once(b, f"exciters.{path}") for path in differ)


def declared_field(instrument: Instrument, path: str) -> FieldInfo | None:
    """Return the declaration of a value, of the bundle or of the plugin that takes it; None where there is none."""
    kind, *rest = path.split(".")
    if field := field_at(Bundle, [kind, *rest]):
        return field
    plugin = plugins_of(instrument).get(kind, {}).get("" if kind == "body" else rest[0]) if rest else None
    inner = rest if kind == "body" else rest[1:]
    if plugin is None or not inner:
        return None
    part = getattr(plugin.parameters, inner[0], None)
    if isinstance(part, Plugin) and inner[1:]:
        return field_at(type(part).Parameters, inner[1:])
    return field_at(type(plugin).Parameters, inner)


def _words(field: FieldInfo | None) -> tuple[Any, ...]:
    """Words that a value may be; none where it may be something else, too."""
    if field is None:
        return ()
    kinds = [kind for kind in alternatives(field.annotation) if kind is not type(None)]
    if not kinds or not all(get_origin(kind) is Literal for kind in kinds):
        return ()
    return tuple(word for kind in kinds for word in get_args(kind))


def _limits(field: FieldInfo | None) -> tuple[float | None, float | None]:
    def limit(name: str) -> float | None:
        limits = [getattr(m, name) for m in (field.metadata if field is not None else ()) if hasattr(m, name)]
        return float(limits[0]) if limits else None

    return limit("ge"), limit("le")
