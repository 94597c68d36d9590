"""Shared by all tests: fixed seeds, hypothesis profiles, the long tier behind ``--validate``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

#: modes of drawn bodies are kept between runs
os.environ.setdefault("TONEWOOD_CACHE", str(Path(__file__).parents[1] / "build" / "cache"))

settings.register_profile(
    "ci", max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("long", max_examples=300, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--validate", action="store_true", help="run the long tier too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--validate"):
        return
    skip = pytest.mark.skip(reason="long tier: run with --validate")
    for item in items:
        if "validate" in item.keywords:
            item.add_marker(skip)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240717)
