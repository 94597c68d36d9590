"""Table of keys: one row a note, expanded to strings, hammers and dampers.

A bundle names it as ``keys: {table: keys.csv, exciter: hammer}``. Its columns:

========================  ========================================================================================
note                      of the key, e.g. ``C#4``; the key's name is the same with ``s`` for the sharp: ``Cs4``
strings                   how many of them it has, 1 to 6; 1 without the column
cents_1, cents_2, ...     by which each of them is tuned above the note
una_corda                 how many of them the hammer meets while that pedal is down
damped                    ``yes`` or ``no``: whether a damper rests on them; yes without it if a damper is described
string.PARAMETER          any key of its strings, dotted: ``string.length``, ``string.loss.sigma0``, ``string.end``
string_2.PARAMETER, ...   of one of them, in place of that: ``string_2.note`` of an octave string
EXCITER.PARAMETER         any parameter of the exciter that `keys` names, e.g. ``hammer.mass``
damper.PARAMETER          of its damper
kind                      of the row's figures, as in `provenance`
========================  ========================================================================================

An empty cell leaves the value of ``strings.defaults``, of the exciter or of ``keys.damper``. The strings of the key
``C4`` are ``C4_1``, ``C4_2``, ...; a single one is ``C4``. One that says no ``end`` ends on ``body.C4``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tonewood.errors import BundleError, ScoreError, TonewoodError
from tonewood.instrument.bundle.key_schema import MOST_STRINGS
from tonewood.instrument.bundle.schema import Bundle, PluginPart
from tonewood.instrument.contract.files import Files
from tonewood.instrument.scales import note_name, note_number
from tonewood.support.units import number_in
from tonewood.support.validation_messages import did_you_mean

_PLAIN = ("note", "strings", "una_corda", "damped", "kind")
_YES_NO = {"yes": True, "no": False}
_MOST = 6
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")
#: signs in names of notes, and the letters for them in the names of keys
_SIGNS = str.maketrans({"#": "s", "\u266f": "s", "\u266d": "b", "-": "m"})


@dataclass(frozen=True)
class KeyRows:
    """Values of a bundle with its table of keys expanded, and the cells that they come from.

    values : of the bundle.
    file : of the table.
    places : dotted path in `values` -> (line, column, or the words before the dots of the columns below it); line 0 for
        values of the bundle itself, under that key.
    """

    values: Mapping[str, Any]
    file: str = ""
    places: Mapping[str, tuple[int, str]] = field(default_factory=dict)

    def located(self, fault: TonewoodError) -> TonewoodError:
        """Return a fault of an expanded value as one of the table's file, line and column; any other as it is."""
        path, below = fault.key or "", ""
        while path:
            if path in self.places:
                line, column = self.places[path]
                key = ".".join(part for part in (column, below) if part)
                if not line:
                    return type(fault)(fault.reason, file=fault.file, key=key)
                return type(fault)(fault.reason, file=self.file, line=line, key=key)
            path, _, last = path.rpartition(".")
            below = f"{last}.{below}" if below else last
        return fault


def with_keys(values: Mapping[str, Any], files: Files) -> KeyRows:
    """Expand the table of keys that a bundle names; its values as they are where it names none.

    Raises BundleError : names file, line, column, value and the values allowed.
    """
    keys = values.get("keys")
    if not isinstance(keys, Mapping) or not isinstance(keys.get("table"), str):
        return KeyRows(values)
    strings = values.get("strings", {})
    defaults = strings.get("defaults", {}) if isinstance(strings, Mapping) else {}
    header, rows, file = files.cells(keys["table"], "keys.table")
    exciter = keys.get("exciter")
    exciters = values.get("exciters")
    if isinstance(exciter, str) and isinstance(exciters, Mapping) and exciter not in exciters:
        raise BundleError(_no_exciter(exciter, exciters), file=files.manifest, key="keys.exciter")
    _check_columns(header, rows[0][0] - 1, exciter, file)
    damper = keys["damper"] if isinstance(keys.get("damper"), Mapping) else {}
    others = strings if isinstance(strings, Mapping) else {}
    beside = keys.get("entries", {})
    entries: dict[str, Any] = {**beside} if isinstance(beside, Mapping) else {}
    key_parts: dict[str, Any] = {}
    pitches = _pitches(entries)
    places: dict[str, tuple[int, str]] = {}
    for line, cells in rows:
        row = _Row(file, line, dict(zip(header, cells, strict=True)))
        name = row.text("note").translate(_SIGNS)
        if name in entries:
            has = "`keys.entries` has, too" if isinstance(beside, Mapping) and name in beside else "an earlier row has"
            raise row.fault("note", f"is {row.text('note')!r}, which {has}; one row a note is allowed")
        try:
            pitch = note_number(row.text("note"))
        except ScoreError as fault:
            raise row.fault("note", fault.reason) from None
        if (same := pitches.setdefault(pitch, name)) != name:
            raise row.fault("note", f"is {row.text('note')!r}, the pitch of key {same}; one key a pitch is allowed")
        count = row.whole("strings", 1)
        of = [name] if count == 1 else [f"{name}_{i + 1}" for i in range(count)]
        if len(key_parts) + count > MOST_STRINGS:
            raise row.fault("strings", f"makes more than the {MOST_STRINGS} strings allowed")
        for string in of:
            if string in others:
                raise row.fault("note", f"makes string {string}, which `strings` has, too; one of them is allowed")
        row.check_strings(count)
        entry: dict[str, Any] = {"note": row.text("note"), "strings": of}
        if row.cells.get("una_corda"):
            entry["una_corda"] = row.whole("una_corda", 1)
        if row.cells.get("kind"):
            entry["kind"] = row.text("kind")
        own_damper = row.below("damper")
        if row.answer("damped", bool(damper or own_damper)):
            entry["damper"] = merged(damper, own_damper)
        if exciter is not None:
            entry["exciter"] = row.below(exciter)
        entries[name] = entry
        columns = row.below("string")
        for i, string in enumerate(of):
            part = {"note": entry["note"], "cents": row.number(f"cents_{i + 1}", 0.0), **columns}
            part = merged(part, row.below(f"string_{i + 1}"))
            if "end" not in part and not (isinstance(defaults, Mapping) and "end" in defaults):
                part["end"] = f"body.{name}"
            key_parts[string] = part
        places |= _places(name, of, exciter, row, defaults, damper)
    exciters = entries if isinstance(beside, Mapping) else beside
    expanded = {**keys, "table": None, "damper": {}, "entries": exciters}
    if not isinstance(keys.get("damper", {}), Mapping):
        expanded["damper"] = keys["damper"]
    return KeyRows({**values, "keys": expanded, "strings": {**others, **key_parts}}, file, places)


@dataclass(frozen=True)
class _Row:
    file: str
    line: int
    cells: Mapping[str, str]

    def fault(self, column: str, reason: str) -> BundleError:
        return BundleError(reason, file=self.file, line=self.line, key=column)

    def text(self, column: str) -> str:
        """A cell that must not be empty."""
        if not self.cells.get(column):
            raise self.fault(column, "is empty; a value is wanted")
        return self.cells[column]

    def number(self, column: str, default: float) -> float:
        """A finite number."""
        if not (text := self.cells.get(column)):
            return default
        value = number_in(text)
        if not math.isfinite(value):
            raise self.fault(column, f"{text!r} is not a finite number")
        return value

    def whole(self, column: str, default: int) -> int:
        """A number of strings."""
        value = self.number(column, float(default))
        if not (value == int(value) and 1 <= value <= _MOST):
            raise self.fault(column, f"is {self.cells[column]}; whole numbers from 1 to {_MOST} are allowed")
        return int(value)

    def answer(self, column: str, default: bool) -> bool:
        """Yes or no."""
        if not (text := self.cells.get(column)):
            return default
        if text not in _YES_NO:
            raise self.fault(column, f"is {text!r}; yes and no are allowed")
        return _YES_NO[text]

    def below(self, prefix: str) -> dict[str, Any]:
        """Cells of the columns ``PREFIX.KEY``, nested where the key is dotted."""
        out: dict[str, Any] = {}
        for column, text in self.cells.items():
            head, _, path = column.partition(".")
            if head != prefix or not path or not text:
                continue
            *above, last = path.split(".")
            holder = out
            for key in above:
                holder = holder.setdefault(key, {})
                if not isinstance(holder, dict):
                    raise self.fault(column, f"has a value beside one of {key!r} itself; one of the two is allowed")
            if last in holder:
                raise self.fault(column, "has a value beside those of the columns below it; one of the two is allowed")
            holder[last] = _value(text)
        return out

    def check_strings(self, count: int) -> None:
        """Check that no cell is of a string that the key does not have."""
        for column, text in self.cells.items():
            number = column.partition(".")[0].rpartition("_")
            if text and number[0] in ("cents", "string") and int(number[2]) > count:
                raise self.fault(column, f"is of string {number[2]}; the row has {count}, by its column strings")


def groups(spec: Bundle) -> dict[str, tuple[str, ...]]:
    """String that gives the pitch -> the strings that a note on it plays: those of its key, or itself alone."""
    of_keys = [tuple(key.strings) for key in spec.keys.entries.values()] if spec.keys else []
    strings_of_keys = {string for strings in of_keys for string in strings}
    led = {strings[0]: strings for strings in of_keys}
    return {name: led.get(name, (name,)) for name in spec.strings if name in led or name not in strings_of_keys}


def key_exciters(spec: Bundle, file: Any) -> Iterator[tuple[str, str, PluginPart]]:
    """Yield key, name and part of the exciter of every key that gives parameters of its own.

    Raises BundleError : there is no exciter of the name that `keys` gives.
    """
    if spec.keys is None or (played := spec.keys.exciter) is None:
        return
    if played not in spec.exciters:
        raise BundleError(_no_exciter(played, spec.exciters), file=file, key="keys.exciter")
    part = spec.exciters[played]
    for name, key in spec.keys.entries.items():
        if key.exciter:
            yield name, played, PluginPart.model_validate({**part.model_dump(), **key.exciter})


def _no_exciter(name: str, names: Collection[str]) -> str:
    return f"there is no exciter {name!r}; {did_you_mean(name, names)}there are {', '.join(names)}"


def _pitches(entries: Mapping[str, Any]) -> dict[float, str]:
    """Pitch -> key, of the entries beside a table with valid notes; the check of the schema refuses the others."""
    out: dict[float, str] = {}
    for name, entry in entries.items():
        note = entry.get("note") if isinstance(entry, Mapping) else None
        try:
            pitch = note_number(note) if isinstance(note, str) else note
        except ScoreError:
            continue
        if isinstance(pitch, int | float):
            out[float(pitch)] = name
    return out


def check_keys(spec: Bundle, file: Any, open_note: Callable[[str], float]) -> None:
    """Check that keys name strings of the instrument, each once.

    open_note : string -> its note number.
    Raises BundleError : one does not, or two share a string, or the una corda pedal leaves more strings than there are;
        a key's note is none, or not that of its first string; or there is no table whose dampers `keys.damper` would
        describe.
    """
    if spec.keys and spec.keys.damper and spec.keys.table is None:
        reason = "is for the rows of a table, which gave them to its keys; keys.entries.NAME.damper is allowed"
        raise BundleError(reason, file=file, key="keys.damper")
    owners: dict[str, str] = {}
    for name, key in (spec.keys.entries if spec.keys else {}).items():
        at = f"keys.entries.{name}"
        try:
            note = note_number(key.note) if isinstance(key.note, str) else key.note
        except ScoreError as fault:
            raise BundleError(fault.reason, file=file, key=f"{at}.note") from None
        for string in key.strings:
            if string not in spec.strings:
                names = f"{did_you_mean(string, spec.strings)}there are {', '.join(spec.strings)}"
                raise BundleError(f"there is no string {string!r}; {names}", file=file, key=f"{at}.strings")
            if string in owners:
                reason = f"string {string!r} is one of key {owners[string]}; a string has one key"
                raise BundleError(reason, file=file, key=f"{at}.strings")
            owners[string] = name
        if abs(open_note(first := key.strings[0]) - note) >= 0.5:
            reason = (
                f"is {key.note}, and its string {first} sounds {note_name(open_note(first))}; the same note is allowed"
            )
            raise BundleError(reason, file=file, key=f"{at}.note")
        if key.una_corda is not None and key.una_corda > len(key.strings):
            reason = f"is {key.una_corda}; 1 to {len(key.strings)}, the number of its strings, are allowed"
            raise BundleError(reason, file=file, key=f"{at}.una_corda")


def _value(text: str) -> Any:
    """A number where the cell is one, whole where it is written so, else the text."""
    if _WHOLE.fullmatch(text):
        return int(text)
    return text if math.isnan(number := number_in(text)) else number


def _check_columns(header: list[str], line: int, exciter: Any, file: str) -> None:
    columns = [*_PLAIN, *(f"cents_{i + 1}" for i in range(_MOST))]
    heads = [head for head in ("string", exciter, "damper") if isinstance(head, str)]
    heads += [f"string_{i + 1}" for i in range(_MOST)]
    for column in header:
        head, _, path = column.partition(".")
        if column not in columns and not (path and head in heads):
            owners = ", ".join(f"{head}.PARAMETER" for head in heads[:-_MOST])
            allowed = f"{', '.join(_PLAIN)}, cents_1 to cents_{_MOST}, {owners}"
            hint = did_you_mean(column, columns)
            raise BundleError(f"is no column of a table of keys; {hint}allowed: {allowed}", file=file, key=column)
    if "note" not in header:
        raise BundleError("is missing among the columns", file=file, line=max(line, 1), key="note")


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Values of `under` with those of `over` in their place, mapping by mapping."""
    out = dict(under)
    for key, value in over.items():
        below = out.get(key)
        out[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return out


def _places(
    name: str, strings: list[str], exciter: Any, row: _Row, defaults: Any, damper: Mapping[str, Any]
) -> dict[str, tuple[int, str]]:
    """Dotted path of a row's values -> its line, and the words in the header that stand for the path."""
    line, entry = row.line, f"keys.entries.{name}"
    out = {entry: (line, ""), f"keys.{name}.{exciter}": (line, str(exciter))}
    out |= {f"{entry}.damper.{key}": (0, f"keys.damper.{key}") for key in damper}
    columns = [column.partition(".") for column, text in row.cells.items() if text]
    out |= {f"{entry}.damper.{path}": (line, f"damper.{path}") for head, _, path in columns if head == "damper"}
    for i, string in enumerate(strings):
        at = f"strings.{string}"
        out[at] = line, "string"
        if isinstance(defaults, Mapping):
            out |= {f"{at}.{key}": (0, f"strings.defaults.{key}") for key in defaults}
        out |= {f"{at}.note": (line, "note"), f"{at}.cents": (line, f"cents_{i + 1}")}
        for stem in ("string", f"string_{i + 1}"):
            out |= {f"{at}.{path}": (line, f"{stem}.{path}") for head, _, path in columns if head == stem and path}
    return out
