"""Edits that make bundles of earlier schemas bundles of this one.

===========================  ============  =====================================================================
schema                       tonewood      to the next one
===========================  ============  =====================================================================
``tonewood-instrument/1``    0.1           the number alone: every key keeps its name and its meaning
``tonewood-instrument/2``    0.2           this one
===========================  ============  =====================================================================
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.schema import SCHEMA
from tonewood.support.yaml_edit import Edit

_VERSION = re.compile(r"^tonewood-instrument/([0-9]{1,9})$")


def bundle_edits(values: Mapping[str, Any], file: str | os.PathLike[str] | None = None) -> list[Edit]:
    """Return the edits that bring a bundle's values to `SCHEMA`: none for one that is there already.

    A value of `schema` that is no version of the format is left to the check against the schema.

    Raises BundleError : the bundle was written for a later version.
    """
    version = values.get("schema")
    match = _VERSION.match(version) if isinstance(version, str) else None
    if match is None or version == SCHEMA:
        return []
    if int(match[1]) > int(SCHEMA.rpartition("/")[2]):
        reason = f"{version} is of a later version of tonewood; this one reads {SCHEMA}: upgrade tonewood"
        raise BundleError(reason, file=file, key="schema")
    return [Edit("schema", SCHEMA, f"schema: {version} becomes {SCHEMA}")]
