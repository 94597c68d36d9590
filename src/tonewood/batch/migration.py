"""Edits to batch manifests written for earlier versions: the schema is the same, one key is gone."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from tonewood.batch.manifest import ManifestError
from tonewood.yaml_edit import Edit


def manifest_edits(values: Mapping[str, Any], file: str | os.PathLike[str] | None = None) -> list[Edit]:
    """Return the edits that take single precision (0.1) out of a manifest's values.

    Raises
    ------
    ManifestError : a factor varies the precision; which conditions then stay is the author's choice.
    """
    factors = values.get("factors")
    for name, factor in factors.items() if isinstance(factors, dict) else ():
        if isinstance(factor, dict) and factor.get("path") == "render.precision":
            reason = "varies render.precision, which was removed in 0.2: take this factor out by hand"
            raise ManifestError(reason, file=file, key=f"factors.{name}")
    render = values.get("render")
    if not isinstance(render, dict) or "precision" not in render:
        return []
    return [Edit("render.precision", None, f"render.precision ({render['precision']}) is removed: always double")]
