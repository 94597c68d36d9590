"""Edits to batch manifests written for earlier versions: same schema, keys are gone, pages change their type."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from tonewood.support.yaml_edit import Edit
from tonewood.workshop.batch.manifest import ManifestError


def manifest_edits(values: Mapping[str, Any], file: str | os.PathLike[str] | None = None) -> list[Edit]:
    """Return the edits that take single precision and webMUSHRA's options (0.1) out of a manifest's values.

    A page `paired_comparison` of 0.1 asked which of two is the reference: it becomes `abx`. It differs from the one of
    today by its lack of a question.

    Raises ManifestError : a factor varies the precision; which conditions then stay is the author's choice.
    """
    factors = values.get("factors")
    for name, factor in factors.items() if isinstance(factors, dict) else ():
        if isinstance(factor, dict) and factor.get("path") == "render.precision":
            reason = "varies render.precision, which was removed in 0.2: take this factor out by hand"
            raise ManifestError(reason, file=file, key=f"factors.{name}")
    edits = []
    render = values.get("render")
    if isinstance(render, dict) and "precision" in render:
        text = f"render.precision ({render['precision']}) is removed: always double"
        edits.append(Edit("render.precision", None, text))
    pages = values.get("pages")
    for i, page in enumerate(pages if isinstance(pages, list) else ()):
        if isinstance(page, dict):
            edits += _page_edits(f"pages.{i}", page)
    return edits


def _page_edits(path: str, page: Mapping[str, Any]) -> list[Edit]:
    old_pair = page.get("type") == "paired_comparison" and "question" not in page
    edits = [Edit(f"{path}.type", "abx", f"{path}.type: paired_comparison is now abx")] if old_pair else []
    for key in ("show_waveform", "looping", "switch_back", *(("both_orders",) if old_pair else ())):
        if key in page:
            edits.append(Edit(f"{path}.{key}", None, f"{path}.{key} is removed: an option of webMUSHRA"))
    if old_pair and isinstance(page.get("unforced"), str):
        edits.append(Edit(f"{path}.unforced", "true", f"{path}.unforced: its words are those of the page's language"))
    return edits
