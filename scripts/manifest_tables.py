"""Print the page of all keys of manifests: python scripts/manifest_tables.py > docs/reference/manifest.md."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel

from tonewood.instrument.bundle.schema_table import parameter_table
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import AnyPage
from tonewood.workshop.dataset.manifest import Dataset

_INTRODUCTION = """# Keys of manifests

Which keys may a manifest of `tonewood batch` have, and which values? [Listening tests](../listening_tests.md) and
[data sets](../datasets.md) explain them. `tonewood schema test` and `tonewood schema dataset` print the same as JSON
Schema, for editors. All faults of a manifest are named at once, each with its line.
"""


def page() -> str:
    """The page: a table for a manifest, for each type of page, and for each mapping inside them."""
    pages = get_args(get_args(AnyPage)[0])
    parts = [_INTRODUCTION, "## A listening test\n", parameter_table(Manifest), "## Pages\n"]
    for model in pages:
        parts += [f"### {type_of(model)}\n", parameter_table(model)]
    parts += ["## A data set\n", parameter_table(Dataset), "## Mappings inside them\n"]
    for model in inner_models([Manifest, *pages, Dataset]):
        parts += [f"### {model.__name__}\n", parameter_table(model)]
    return "\n".join(parts)


def type_of(model: type[BaseModel]) -> str:
    """Name of a type of page in a manifest."""
    return str(get_args(model.model_fields["type"].annotation)[0])


def inner_models(models: list[type[BaseModel]]) -> list[type[BaseModel]]:
    """Models that stand in fields of others, each once, those of `models` left out."""
    found = list(models)
    for model in found:
        for field in model.model_fields.values():
            found += [m for m in dict.fromkeys(_named(field.annotation)) if m not in found]
    return found[len(models) :]


def _named(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for a in get_args(annotation) for m in _named(a)]


if __name__ == "__main__":
    print(page(), end="")
