"""Data sheet of sounds for a paper's supplement: versions, hashes, licences of instruments and data, citation."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole

FILE = "datasheet.md"
#: papers of the method, as in CITATION.cff
METHODS = (
    "F. Fabre, J.-L. Le Carrou, B. Chomette, J. Sound Vib. 590 (2024) 118593, doi:10.1016/j.jsv.2024.118593",
    "J. Antunes, V. Debut, J. Acoust. Soc. Am. 141 (2017), doi:10.1121/1.4973534",
)
_NOT_STATED = "not stated"


@dataclass(frozen=True)
class Subject:
    """What a data sheet is of.

    manifest : as plain data; its hash is that of its JSON with sorted keys.
    facts : name -> value, of the sounds.
    digests : of the samples of each sound, by name.
    """

    name: str
    title: str
    licence: str
    manifest: Mapping[str, Any]
    facts: Mapping[str, str]
    digests: Mapping[str, str]


def write_data_sheet(folder: Path, subject: Subject, identities: Iterable[Mapping[str, Any]]) -> None:
    """Write the data sheet into a folder; raises as `whole_file`.

    identities : everything that decided the samples of each sound (`StimulusRenderer.identity`).
    """
    write_whole(folder / FILE, data_sheet(subject, list(identities)), make_folder=True)


def data_sheet(subject: Subject, identities: Sequence[Mapping[str, Any]]) -> str:
    """The data sheet as Markdown; nothing in it depends on time or place."""
    instruments = {str(i.get("bundle")): i.get("parameters", {}) for i in identities}
    plugins = {(name, digest) for i in identities for name, digest in i.get("plugins", {}).items()}
    whole = hashlib.sha256(json.dumps(sorted(subject.digests.items())).encode()).hexdigest()
    manifest = hashlib.sha256(json.dumps(subject.manifest, sort_keys=True).encode()).hexdigest()
    facts = {
        "title": subject.title or subject.name,
        "licence of the sounds": subject.licence or _NOT_STATED,
        **subject.facts,
        "sounds": str(len(subject.digests)),
        "SHA-256 of all samples": f"`{whole}`",
        "SHA-256 of the manifest": f"`{manifest}`",
        "seed": str(subject.manifest.get("seed", "")),
    }
    parts = [
        f"# Data sheet: {subject.name}\n",
        _table(("item", "value"), facts.items()),
        "## Software\n",
        _table(("part", "version"), _software(identities)),
        "## Instruments\n",
        _table(
            ("instrument", "licence", "SHA-256"),
            sorted((_name(p), p.get("licence", _NOT_STATED), f"`{digest}`") for digest, p in instruments.items()),
        ),
        "Sources of their figures:\n",
        _table(("source", "licence", "changes"), sorted(_sources(instruments.values()))),
        "## Plugins\n",
        _table(("plugin", "SHA-256"), sorted((name, f"`{digest}`") for name, digest in plugins)),
        "## How to cite\n",
        "\n".join([f"- tonewood {version('tonewood')}, The tonewood authors, MIT", *(f"- {one}" for one in METHODS)]),
        "- the sources of the instruments above\n",
    ]
    return "\n".join(parts)


def _software(identities: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Rows of everything that computes; several values where sounds differ."""
    versions: dict[str, set[str]] = {}
    for identity in identities:
        versions.setdefault("tonewood", set()).add(str(identity.get("version", _NOT_STATED)))
        versions.setdefault("instruction set", set()).add(str(identity.get("isa", _NOT_STATED)))
        for name, value in identity.get("computed_with", {}).items():
            text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
            versions.setdefault(name, set()).add(text)
    return [(name, "; ".join(sorted(values))) for name, values in versions.items()]


def _name(parameters: Mapping[str, Any]) -> str:
    return str(parameters.get("title") or parameters.get("name") or _NOT_STATED)


def _sources(instruments: Iterable[Mapping[str, Any]]) -> set[tuple[str, str, str]]:
    sources = set()
    for parameters in instruments:
        for source in (parameters.get("sources") or {}).values():
            address = (
                f", doi:{source['doi']}" if source.get("doi") else f", {source['url']}" if source.get("url") else ""
            )
            sources.add((source["text"] + address, source["licence"], source.get("changes") or ""))
    return sources


def _table(head: tuple[str, ...], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + " --- |" * len(head)]
    lines += [f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return "\n".join(lines) + "\n"
