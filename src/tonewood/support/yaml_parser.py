"""Parses YAML that people write: plain data only, and every fault in one line with its place.

The dialect is YAML 1.2 (``2e11`` is a number, ``no`` a word) cut down to the needs of a description: one
mapping of named keys, finite numbers, words, true/false/null, lists. Anchors, aliases, merge keys and tags
are refused (each value should stand where it is read, and nothing may expand), so are duplicate keys,
dates, and files that are too long or too deep.
"""

from __future__ import annotations

import math
import os
import re
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from tonewood.errors import TonewoodError

MAX_DEPTH = 24

_STRING = "tag:yaml.org,2002:str"
_MERGE = "tag:yaml.org,2002:merge"
_TIMESTAMP = "tag:yaml.org,2002:timestamp"
#: all but tabs and breaks of lines
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ufffe\uffff]")


def parse(
    text: str, *, file: str | os.PathLike[str] | None = None, error: type[TonewoodError] = TonewoodError
) -> dict[str, Any]:
    """Read a text into a dict of dicts, lists, str, int, float, bool and None; `file` is only named in errors.

    Raises TonewoodError
        Not one mapping; anchors, aliases, merge keys, tags, dates, directives, duplicate keys, keys that are
        not words, half a surrogate pair, control characters, numbers that are not finite, nesting deeper than
        `MAX_DEPTH`.
    """
    yaml = YAML(typ="safe", pure=True)  # the C scanner speaks YAML 1.1
    yaml.Composer = _StrictComposer
    try:
        data = yaml.load(text)
    except MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        line = None if mark is None else mark.line + 1
        raise error(fault.problem or "not YAML", file=file, line=line) from None
    except (YAMLError, ValueError) as fault:  # ValueError: an integer of thousands of digits
        raise error(f"not YAML: {' '.join(str(fault).split())[:200]}", file=file) from None
    if not isinstance(data, dict):
        raise error(f"holds {_kind(data)}; a mapping of keys is wanted", file=file)
    _check_finite(data, "", file, error)
    return data


def line_of(text: str, key: str) -> int | None:
    """Line of a dotted key, or of the nearest key above it; None where even the first part is not there.

    A key of `strings.NAME` that stands under `strings.defaults` instead is found there.

    Raises ValueError : the text is not YAML.
    """
    try:
        node = YAML(typ="safe", pure=True).compose(text)
    except YAMLError as fault:
        raise ValueError(str(fault)) from None
    line, parent = None, None
    for part in key.split("."):
        defaults = _entry(parent, "defaults")
        entry = _entry(node, part) or (_entry(defaults[1], part) if defaults else None)
        if entry is None:
            break
        parent, (key_node, node) = node, entry
        line = key_node.start_mark.line + 1
    return line


def _entry(node: Any, key: str) -> tuple[Any, Any] | None:
    """Node where an entry of a mapping, or of a list (by number or `name`), begins, and its value's node."""
    if isinstance(node, MappingNode):
        return next(((name, value) for name, value in node.value if name.value == key), None)
    if isinstance(node, SequenceNode):
        members = enumerate(node.value)
        named = ((m, m) for i, m in members if key == str(i) or ((_entry(m, "name") or (m, m))[1].value == key))
        return next(named, None)
    return None


class _StrictComposer(Composer):
    """Builds the node tree, and stops at the first thing the dialect leaves out."""

    _levels = 0  # nodes that are being composed; ruamel.yaml counts them from 0.19 on

    def compose_document(self) -> Any:
        event = self.parser.peek_event()
        if event.version not in (None, (1, 2)) or event.tags:
            raise _refused("%-directives are not allowed (the file is read as YAML 1.2)", event)
        return super().compose_document()

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        if isinstance(event, AliasEvent):
            raise _refused(f"alias *{event.anchor} is not allowed: write the value out", event)
        if event.anchor is not None:
            raise _refused(f"anchor &{event.anchor} is not allowed: write the value out", event)
        if event.ctag is not None:
            raise _refused(f"tag {event.ctag} is not allowed: plain values only", event)
        if self._levels >= MAX_DEPTH:
            raise _refused(f"nested deeper than the {MAX_DEPTH} levels allowed", event)
        self._levels += 1
        node = super().compose_node(parent, index)
        self._levels -= 1
        if isinstance(node, ScalarNode):
            node.value = _joined(node)
        if str(node.ctag) == _TIMESTAMP:
            raise _refused(f"{node.value} would be read as a date: quote it", node)
        if isinstance(node, MappingNode):
            _check_keys(node)
        return node


def _check_keys(node: MappingNode) -> None:
    seen: set[str] = set()
    for key, _ in node.value:
        if str(key.ctag) == _MERGE:
            raise _refused("merge key << is not allowed: write the values out", key)
        if str(key.ctag) != _STRING:
            shown = key.value if isinstance(key.value, str) else "a list or mapping"
            raise _refused(f"key {shown} is not a word: quote it if it is a name", key)
        if key.value in seen:
            raise _refused(f"key {key.value} stands twice in one mapping", key)
        seen.add(key.value)


def _joined(node: ScalarNode) -> str:
    r"""Return the text of a scalar with escapes like ``\ud83c\udfb8``, which JSON writes, made one character."""
    if control := _CONTROL.search(node.value):  # terminals follow them
        raise _refused(f"control character U+{ord(control[0]):04X} is not allowed", node)
    try:
        node.value.encode()
        return str(node.value)
    except UnicodeEncodeError:
        try:
            return str(node.value.encode("utf-16", "surrogatepass").decode("utf-16"))
        except UnicodeDecodeError:  # it could not be printed, nor written to any file
            raise _refused("half a surrogate pair is no character", node) from None


def _refused(problem: str, node: Any) -> MarkedYAMLError:
    return MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


def _check_finite(value: Any, key: str, file: str | os.PathLike[str] | None, error: type[TonewoodError]) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise error(f"{value} is not a finite number", file=file, key=key)
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, item in items:
        _check_finite(item, f"{key}.{name}" if key else str(name), file, error)


def _kind(value: object) -> str:
    return "nothing" if value is None else "a list" if isinstance(value, list) else f"only {value!r}"
