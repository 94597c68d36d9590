"""The exported JSON Schema agrees with the loader on sound bundles and on the commonest faults."""

from __future__ import annotations

from typing import Any

import pytest

from tonewood.instrument.bundle.json_schema import bundle_schema
from tonewood.instrument.contract.registry import list_instruments
from tonewood.support.yaml_io import load_yaml

jsonschema = pytest.importorskip("jsonschema")


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = bundle_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", list_instruments())
def test_built_in_bundles_pass(validator: Any, name: str) -> None:
    assert list(validator.iter_errors(load_yaml(list_instruments()[name] / "instrument.yaml"))) == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("strings", "A2", "tension"), "tight"),
        (("strings", "A2", "tensoin"), 3.0),
        (("body", "shapes"), "round"),
        (("exciters", "pluck", "plugin"), "no_such"),
        (("exciters", "pluck", "force"), -1.0),
        (("schema",), "tonewood-instrument/3"),
        (("licence",), None),
    ],
)
def test_faults_are_seen(validator: Any, path: tuple[str, ...], value: Any) -> None:
    bundle = load_yaml(list_instruments()["monochord"] / "instrument.yaml")
    at = bundle
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    assert list(validator.iter_errors(bundle))


def test_every_key_is_explained() -> None:
    schema = bundle_schema()

    def unsaid(value: Any, place: str) -> list[str]:
        if not isinstance(value, dict):
            return (
                [x for i, v in enumerate(value) for x in unsaid(v, f"{place}.{i}")] if isinstance(value, list) else []
            )
        found = []
        for key, entry in value.get("properties", {}).items():
            if not isinstance(entry, dict) or not ({"description", "const"} & set(entry)):
                found.append(f"{place}.{key}")
        return found + [x for k, v in value.items() for x in unsaid(v, f"{place}.{k}")]

    assert unsaid(schema, "") == []
