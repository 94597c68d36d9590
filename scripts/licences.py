"""List the licences of every package that tonewood installs, and fail where one is not allowed.

Run it in an environment that has tonewood with the extras to check. The packages that tonewood itself needs, and
theirs, must be permissive (MIT, BSD, Apache, MPL and the like); those that only a named extra brings may be LGPL. GPL
is allowed nowhere: such programs are references that tests run beside, never dependencies.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

_PERMISSIVE = re.compile(
    r"MIT|BSD|Apache|ISC|PSF|Python-2|Python Software|MPL|Mozilla|Zlib|HPND|CC0|Unlicense|Public Domain|0BSD|PIL"
    "|Permission is hereby granted, free of charge",
    re.I,
)
_LESSER = re.compile(r"\bLGPL|Lesser General Public", re.I)
_GENERAL = re.compile(r"\bA?GPL|(?<!Lesser )General Public", re.I)


def licence(package: Distribution) -> str:
    """Return the licence that a package states: an expression, classifiers, a field, or the start of its file."""
    metadata = package.metadata
    classifiers = [c.rpartition(" :: ")[2] for c in metadata.get_all("Classifier") or () if c.startswith("License ::")]
    text = str(metadata.get("License-Expression") or " / ".join(classifiers) or metadata.get("License") or "")
    if text.strip() in ("", "UNKNOWN", "OSI Approved"):
        files = (path for path in package.files or () if "licen" in path.name.lower())
        text = next((path.read_text(encoding="utf-8") for path in files), text)
    return " ".join(text.split())[:80]


def closure(name: str, extras: frozenset[str]) -> dict[str, Distribution]:
    """Return the installed packages that a package needs under some extras, itself left out."""
    packages: dict[str, Distribution] = {}
    todo: list[tuple[str, frozenset[str]]] = [(name, extras)]
    seen: set[tuple[str, frozenset[str]]] = set()
    while todo:
        key = todo.pop()
        if key in seen:
            continue
        seen.add(key)
        try:
            package = distribution(key[0])
        except PackageNotFoundError:
            continue
        packages[package.name.lower()] = package
        for text in package.requires or ():
            requirement = Requirement(text)
            environments = [{"extra": extra} for extra in key[1]] or [{"extra": ""}]
            if requirement.marker is None or any(requirement.marker.evaluate(e) for e in environments):
                todo.append((requirement.name, frozenset(requirement.extras)))
    packages.pop(name, None)
    return packages


def main() -> int:
    """Print a line a package; return 1 if one is not allowed."""
    extras = frozenset(distribution("tonewood").metadata.get_all("Provides-Extra") or ())
    core = closure("tonewood", frozenset())
    users = closure("tonewood", extras - {"test", "dev", "docs"})
    refused = 0
    for name, package in sorted(users.items()):
        text = licence(package)
        lesser = bool(_LESSER.search(text))
        allowed = bool(_PERMISSIVE.search(text)) or (lesser and name not in core)
        if _GENERAL.search(_LESSER.sub("", text)) and not _PERMISSIVE.search(text):
            allowed = False
        refused += not allowed
        print(f"{'' if allowed else 'NOT ALLOWED '}{name} {package.version}: {text or 'no licence stated'}"
              f"{'' if name in core else ' (extra)'}")  # fmt: skip
    return min(refused, 1)


if __name__ == "__main__":
    sys.exit(main())
