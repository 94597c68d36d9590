"""Origins of a bundle's figures: their kinds and sources, and tables that may be others than those declared."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tonewood.instrument.bundle.schema import Provenance
from tonewood.instrument.contract.files import Files


@dataclass(frozen=True, slots=True)
class Origins:
    """Where the figures of an instrument come from.

    entries : path, with ``*`` for any word -> provenance.
    resolved : all keys of the bundle as plain values.
    files : its folder.
    """

    entries: Mapping[str, Provenance]
    resolved: Mapping[str, Any]
    files: Files

    def of(self, path: str) -> Provenance | None:
        """Return the provenance of the value at a dotted path: the most specific entry that matches."""
        best: tuple[tuple[int, int], Provenance] | None = None
        parts = path.split(".")
        for pattern, entry in self.entries.items():
            keys = pattern.split(".")
            if len(keys) <= len(parts) and all(w in ("*", p) for w, p in zip(keys, parts, strict=False)):
                rank = (len(keys), -keys.count("*"))
                if best is None or rank > best[0]:
                    best = (rank, entry)
        return best[1] if best else None

    def stand_ins(self) -> list[str]:
        """Return the paths of values that the bundle declares to be stand-ins."""
        return [path for path, entry in self.entries.items() if entry.kind == "stand_in"]

    def of_unknown_origin(self) -> list[str]:
        """Return the paths of values without a source."""
        return [path for path, entry in self.entries.items() if entry.kind == "unknown"]

    def table_doubts(self) -> list[str]:
        """List tables whose provenance may be that of another table, one line each.

        A table is a file of the bundle that a part's key ``table`` names. Its entry of `provenance` may carry the
        SHA-256 of the file's bytes; one that says `measured` should.
        """
        doubts = []
        parts = {
            "body": self.resolved["body"],
            **{f"outputs.{part['name']}": part for part in self.resolved["outputs"]},
        }
        for kind in ("strings", "exciters", "connections"):
            parts |= {f"{kind}.{name}": part for name, part in self.resolved[kind].items()}
        for path, part in parts.items():
            entry, name = self.of(f"{path}.table"), part.get("table")
            if not isinstance(name, str) or entry is None:
                continue
            digest = hashlib.sha256(self.files.path(name, f"{path}.table").read_bytes()).hexdigest()
            says = f"{entry.kind}{f' ({entry.source})' if entry.source else ''}"
            if entry.sha256 is not None and entry.sha256 != digest:
                doubts.append(
                    f"{path}: {name} is not the table that its provenance calls {says}: its SHA-256 is {digest}, not "
                    f"{entry.sha256}; say where this one comes from"
                )
            elif entry.sha256 is None and entry.kind == "measured":
                doubts.append(
                    f"{path}: its provenance says {says} without the SHA-256 of {name}, so that nothing tells this "
                    f"table from another one; if it is the one, add sha256: {digest}"
                )
        return doubts
