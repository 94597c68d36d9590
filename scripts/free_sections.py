"""Griffe extension: docstring sections whose items state units and shapes where numpydoc expects a type.

The types stand in the signatures. ``omega : (n,) rad/s`` becomes an item without a type, described by ``(n,) rad/s``.
"""

from __future__ import annotations

import re
from itertools import takewhile
from textwrap import indent
from typing import Any

from griffe import Attribute, Docstring, Extension, Object, Visitor

import tonewood
from tonewood import authoring, errors

_HEADING = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}\n", re.MULTILINE)
_ITEM = re.compile(r"^(\S[^:\n]*?) : ", re.MULTILINE)
_NAME = re.compile(r"(?<![`\[])`(?:t[wa]\.(\w+)|([A-Z]\w+))`(?!`)")


def standard(text: str) -> str:
    """Return a docstring with descriptions below the items' names, and links from public names."""
    text = _NAME.sub(_link, text)
    before, *sections = _HEADING.split(text)
    parts = [before]
    for heading, body in zip(sections[::2], sections[1::2], strict=True):
        if heading in ("Returns", "Yields"):
            body = ":\n" + indent(_ITEM.sub(r"`\1`: ", body.strip()), "    ") + "\n"
        elif heading in ("Parameters", "Attributes", "Raises"):
            body = _ITEM.sub(r"\1\n    ", body)
        parts.append(f"{heading}\n{'-' * len(heading)}\n{body}")
    return "".join(parts)


def _link(found: re.Match[str]) -> str:
    name = found[1] or found[2]
    for module in (tonewood, errors, authoring):
        if name in getattr(module, "__all__", vars(module)):
            return f"[`{name}`][{module.__name__}.{name}]"
    return found[0]


class FreeSections(Extension):
    """Applies `standard` to every docstring."""

    def on_instance(self, *, obj: Object, **kwargs: Any) -> None:
        """Rewrite the docstring before it is parsed."""
        if obj.docstring is not None:
            obj.docstring.value = standard(obj.docstring.value)

    def on_attribute_instance(self, *, attr: Attribute, agent: Visitor, **kwargs: Any) -> None:
        """Take the comment ``#: ...`` above an attribute as its docstring."""
        if attr.docstring is None and attr.lineno is not None:
            above = reversed(agent.code.splitlines()[: attr.lineno - 1])
            comment = [line.strip()[2:].strip() for line in takewhile(lambda s: s.strip().startswith("#:"), above)]
            if comment:
                attr.docstring = Docstring(standard(" ".join(reversed(comment))), parent=attr)
