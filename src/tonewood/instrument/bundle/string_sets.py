"""Named string sets, and strings by gauge and material: values that they give the strings of an instrument.

    mu = rho pi d^2 / 4  or  T / (2 L f)^2,    EI = E pi d_c^4 / 64,    EA = E pi d_c^2 / 4,    d_c = core d,

and on a length L' tuned to f' the tension T (L' f' / (L f))^2, or mu (2 L' f')^2 where the set has none. What an entry
leaves out follows from its `made_of`: `tonewood.instrument.bundle.string_materials`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tonewood.errors import BundleError, PluginError, ScoreError
from tonewood.instrument.bundle.schema import StringSet, StringSetEntry
from tonewood.instrument.bundle.string_materials import StringFigures, made_figures
from tonewood.instrument.bundle.string_schema import MadeOf
from tonewood.instrument.contract import registry
from tonewood.instrument.scales import note_number
from tonewood.support.params import validated
from tonewood.support.validation_messages import did_you_mean
from tonewood.support.yaml_io import load_yaml

_FILE = Path(__file__).with_name("string_sets.yaml")
#: key of a bundle that names a set
_KEY = "strings_from"
#: keys of a string that a set may give
_KEYS = ("tension", "linear_density", "bending_stiffness", "axial_stiffness", "loss")
#: keys of a set's strings that every string has, whatever its plugin; without them those of another set do not hold
_OWN = ("made_of", "fretting_stiffness")


@cache
def string_sets() -> Mapping[str, StringSet]:
    """Known sets, by name."""
    values = load_yaml(_FILE, error=BundleError)
    return {name: validated(StringSet, entry, key=name, file=_FILE) for name, entry in values.items()}


def string_set(name: str, *, file: Any = None) -> StringSet:
    """Find a set by its name. Raises BundleError : there is none; names those there are."""
    sets = string_sets()
    if name not in sets:
        reason = f"there is no string set {name!r}; {did_you_mean(name, sets)}there are {', '.join(sets)}"
        raise BundleError(reason, file=file, key=_KEY)
    return sets[name]


def with_set(values: Mapping[str, Any], name: str, *, over: bool, file: Any = None) -> dict[str, Any]:
    """Return values of a bundle with its strings from a set: the first of the bundle is the first of the set.

    values : of the bundle, `strings.defaults` merged.
    over : whether the set's values replace those of the bundle, or only fill in those that it leaves out.
    Raises BundleError : the set has another number of strings, a string does not say its length or note, or its plugin
        takes no such values or needs one that the set does not have.
    """
    chosen, strings = string_set(name, file=file), values.get("strings")
    if not isinstance(strings, Mapping) or not all(isinstance(part, Mapping) for part in strings.values()):
        return dict(values)  # the check of the schema says what is wrong
    if not _has_sources(values):
        return dict(values)
    if len(strings) != len(chosen.strings):
        notes = ", ".join(entry.note for entry in chosen.strings)
        raise BundleError(
            f"{name} has {len(chosen.strings)} strings ({notes}); this instrument has {len(strings)}",
            file=file,
            key=_KEY,
        )
    parts: dict[str, Any] = {}
    names: set[str] = set()
    for (key, part), entry in zip(strings.items(), chosen.strings, strict=True):
        part_values = _of_string(part, entry, chosen, f"strings.{key}", file)
        parts[key] = {**part, **dict.fromkeys(_OWN), **part_values} if over else {**part_values, **part}
        names |= {k for k in part_values if (over or k not in part) and k != "made_of"}
    out = {**values, "strings": parts, _KEY: name}
    if names:
        source = f"strings_{name}"
        out["sources"] = {**values.get("sources", {}), source: chosen.source.model_dump(exclude_none=True)}
        note = f"{chosen.maker} {chosen.product}"
        entries = {f"strings.*.{k}": {"kind": "published", "source": source, "note": note} for k in sorted(names)}
        before = values.get("provenance", {})
        out["provenance"] = {**before, **entries} if over else {**entries, **before}
    return out


def _of_string(
    part: Mapping[str, Any], entry: StringSetEntry, chosen: StringSet, key: str, file: Any
) -> dict[str, Any]:
    """Values of one string of the bundle, as its plugin takes them."""
    fields = _fields(part, key, file)
    data = figures(entry, chosen, _length(part, key, file), _freq(part, entry.note, key, file))
    if entry.made_of is not None:
        data["made_of"] = entry.made_of.model_dump(exclude_none=True)
    for name in _KEYS:
        # that of another set's strings does not hold
        rest = () if name == "axial_stiffness" else part
        if name in fields and fields[name].is_required() and name not in data and name not in rest:
            reason = f"the string set does not say it, and {part['plugin']} needs it"
            raise BundleError(reason, file=file, key=f"{key}.{name}")
    return {name: value for name, value in data.items() if name in fields or name in _OWN}


def _fields(part: Mapping[str, Any], key: str, file: Any) -> Mapping[str, Any]:
    try:
        return registry.plugin(str(part.get("plugin")), "resonator").Parameters.model_fields
    except PluginError as fault:
        raise BundleError(f"no string set can be put on it: {fault.reason}", file=file, key=f"{key}.plugin") from None


def _length(part: Mapping[str, Any], key: str, file: Any) -> float:
    """Length of a string of the bundle, m."""
    length = part.get("length")
    if isinstance(length, bool) or not isinstance(length, int | float) or length <= 0:
        raise BundleError("is needed for a string set", file=file, key=f"{key}.length")
    return float(length)


def with_materials(values: Mapping[str, Any], *, over: Collection[str] = (), file: Any = None) -> dict[str, Any]:
    """Return values of a bundle with mass, stiffness and loss of its strings from their `made_of`.

    values : of the bundle, `strings.defaults` merged.
    over : strings of which gauge and materials replace what the bundle states; of all others they fill in.
    Raises BundleError : names file, string, key, value and the values allowed.
    """
    strings, out = values.get("strings"), dict(values)
    parts = strings.items() if isinstance(strings, Mapping) else ()
    entries = {
        name: part for name, part in parts if isinstance(part, Mapping) and isinstance(part.get("made_of"), Mapping)
    }
    if not _has_sources(values):
        return out
    sources, provenance = dict(values.get("sources") or {}), dict(values.get("provenance") or {})
    for name, part in entries.items():
        key = f"strings.{name}"
        bought = validated(MadeOf, part["made_of"], key=f"{key}.made_of", file=file)
        length, freq = _length(part, key, file), _freq(part, None, key, file)
        data = made_figures(bought, length, freq, key=f"{key}.made_of", file=file)
        fields = _fields(part, key, file)
        keys = [k for k in data.kinds if k in fields or k in _OWN]
        chosen = [k for k in keys if name in over or part.get(k) is None]
        entries[name] = {**part, **{k: dict(data.loss) if k == "loss" else getattr(data, k) for k in chosen}}
        provenance, sources = _with_kinds(provenance, sources, name, chosen, data)
    if entries:
        out |= {"strings": {**dict(parts), **entries}, "provenance": provenance, "sources": sources}
    return out


def _has_sources(values: Mapping[str, Any]) -> bool:
    """Whether sources and provenance are mappings, or left out; the check of the schema says if they are not."""
    return all(isinstance(values.get(key, {}), Mapping) for key in ("sources", "provenance"))


def _with_kinds(
    provenance: Mapping[str, Any], sources: Mapping[str, Any], string: str, keys: Sequence[str], figures: StringFigures
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Provenance and sources of a bundle with those of the values that gauge and materials give a string."""
    texts = dict.fromkeys(figures.kinds[k][1] for k in keys)
    names = {text: f"made_of_{string}_{i}" for i, text in enumerate(texts, 1)}
    entries = {
        f"strings.{string}.{k}": {"kind": figures.kinds[k][0], "source": names[figures.kinds[k][1]]} for k in keys
    }
    return {**provenance, **entries}, {**sources, **{k: {"text": t, "licence": "facts"} for t, k in names.items()}}


def figures(entry: StringSetEntry, chosen: StringSet, length: float, freq: float) -> dict[str, Any]:
    """Tension (N), linear density (kg/m), stiffnesses (N m^2, N) and loss of a string on a length (m) tuned to Hz."""
    own_freq = 440.0 * 2 ** ((note_number(entry.note) - 69) / 12)
    own_length = entry.length or chosen.length
    computed = None if entry.made_of is None else made_figures(entry.made_of, length, freq, key=entry.note)
    if entry.linear_density is not None:
        density = entry.linear_density
    elif entry.density is not None and entry.diameter is not None:
        density = entry.density * math.pi * entry.diameter**2 / 4
    elif computed is not None:
        density = computed.linear_density
    else:
        assert entry.tension is not None
        density = entry.tension / (2 * own_length * own_freq) ** 2
    if entry.tension is not None:
        tension = entry.tension * (length * freq / (own_length * own_freq)) ** 2
    else:
        tension = density * (2 * length * freq) ** 2
    out: dict[str, Any] = {"tension": tension, "linear_density": density}
    if computed is not None:
        out |= {k: getattr(computed, k) for k in ("bending_stiffness", "axial_stiffness", "fretting_stiffness")}
        out["loss"] = dict(computed.loss)
    if entry.fretting_stiffness is not None:
        out["fretting_stiffness"] = entry.fretting_stiffness
    if entry.bending_stiffness is not None:
        out["bending_stiffness"] = entry.bending_stiffness
    if entry.young is not None and entry.diameter is not None:
        core = entry.core * entry.diameter
        out["bending_stiffness"] = entry.young * math.pi * core**4 / 64
        out["axial_stiffness"] = entry.young * math.pi * core**2 / 4
    if entry.loss is not None:
        out["loss"] = dict(entry.loss)
    return out


def _freq(part: Mapping[str, Any], usual: str | None, key: str, file: Any) -> float:
    """Pitch of a string of the bundle, Hz, at 440 Hz and equal temperament: the tuner finds the tension exactly."""
    if isinstance(part.get("freq"), int | float):
        return float(part["freq"])
    note = part.get("note") if part.get("note") is not None else usual
    try:
        number = float(note_number(note)) if isinstance(note, str) else float(note or 0.0)
    except ScoreError as fault:
        raise BundleError(fault.reason, file=file, key=f"{key}.note") from None
    return float(440.0 * 2 ** ((number - 69) / 12))
