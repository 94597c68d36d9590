"""``tonewood schema``: the formats of files that people write, for editors."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from tonewood.errors import TonewoodError

_KINDS = ("instrument", "test", "dataset")


def schema(
    kind: Annotated[
        str, typer.Argument(help="instrument (instrument.yaml), test or dataset (manifests of `tonewood batch`)")
    ] = "instrument",
) -> None:
    """Print the JSON schema of instrument.yaml, keys of every installed plugin included, or that of a manifest."""
    if kind == "test":
        from tonewood.workshop.batch.manifest import manifest_schema as made
    elif kind == "dataset":
        from tonewood.workshop.dataset.manifest import dataset_schema as made
    elif kind == "instrument":
        from tonewood.instrument.bundle.json_schema import bundle_schema as made
    else:
        raise TonewoodError(f"is {kind!r}; {', '.join(_KINDS)} are allowed", key="schema")
    print(json.dumps(made(), indent=2))
