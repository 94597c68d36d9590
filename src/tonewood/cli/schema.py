"""``tonewood schema``: the bundle format for editors."""

from __future__ import annotations

import json


def schema() -> None:
    """Print the JSON schema of instrument.yaml, keys of every installed plugin included."""
    from tonewood.instrument.bundle.json_schema import bundle_schema

    print(json.dumps(bundle_schema(), indent=2))
