"""Replace values or remove keys in a YAML file that people write; every other byte stays."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.support.yaml_io import parse_yaml


@dataclass(frozen=True, slots=True)
class Edit:
    """One change.

    path : dotted path of a key that is there.
    value : plain word that replaces its value; None removes the key.
    reason : the change in words.
    """

    path: str
    value: str | None
    reason: str


def apply_edits(data: Mapping[str, Any], edits: Sequence[Edit]) -> dict[str, Any]:
    """Return a copy of a file's values with the edits made."""
    out = copy.deepcopy(dict(data))
    for edit in edits:
        *above, last = edit.path.split(".")
        node = out
        for key in above:
            node = node[key]
        if edit.value is None:
            del node[last]
        else:
            node[last] = edit.value
    return out


def edit_text(text: str, edits: Sequence[Edit], *, file: str | os.PathLike[str] | None = None) -> str:
    """Return a file's text with the edits made; comments, order, quotes and line ends stay.

    Raises TonewoodError : the edited text would not hold exactly the values of `apply_edits`; names the first edit.
    """
    edited = apply_edits(parse_yaml(text, file=file), edits)
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    new = text.removeprefix(mark)
    for edit in edits:
        new = _edited(new, edit)
    try:
        same = parse_yaml(new) == edited
    except TonewoodError:
        same = False
    if not same:
        raise TonewoodError(f"cannot be rewritten automatically; {edits[0].reason} by hand", file=file)
    return mark + new


def _edited(text: str, edit: Edit) -> str:
    parent, i, node = _entry(text, edit.path)
    pairs, start, end = parent.value, parent.value[i][0].start_mark.index, node.end_mark.index
    if edit.value is not None:
        return text[: node.start_mark.index] + edit.value + text[end:]
    if len(pairs) == 1:
        empty = "" if parent.flow_style else "{}"  # a block that is left empty would be null
        end = end if parent.flow_style else len(text[:end].rstrip())
        return text[:start] + empty + text[end:]
    if parent.flow_style:
        if i + 1 < len(pairs):
            return text[:start] + text[pairs[i + 1][0].start_mark.index :]
        return text[: pairs[i - 1][1].end_mark.index] + text[end:]
    line_end = text.find("\n", len(text[:end].rstrip()) - 1)
    return text[: text.rfind("\n", 0, start) + 1] + (text[line_end + 1 :] if line_end >= 0 else "")


def _entry(text: str, path: str) -> tuple[Any, int, Any]:
    """Mapping that holds the last key of `path`, the key's place in it, and its value's node."""
    from ruamel.yaml import YAML

    node: Any = YAML(typ="rt", pure=True).compose(text)
    parent, at = node, 0
    for key in path.split("."):
        parent = node
        at, node = next((i, value) for i, (name, value) in enumerate(parent.value) if name.value == key)
    return parent, at, node
