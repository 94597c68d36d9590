"""Shared by all tests: fixed seeds, hypothesis profiles, slow tests (``--slow``), the long tier (``--validate``)."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# before NumPy is loaded: the tests themselves run side by side
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
#: modes of drawn bodies are kept between runs
os.environ.setdefault("TONEWOOD_CACHE", str(Path(__file__).parents[1] / "build" / "cache"))
# so is byte code: of the tests with their assertions, and of the many processes that they start
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

settings.register_profile(
    "ci", max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("long", max_examples=300, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run slow tests too, a second or more each")
    parser.addoption("--validate", action="store_true", help="run all: slow tests and the long tier")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--validate"):
        return
    long = pytest.mark.skip(reason="long tier: run with --validate")
    slow = pytest.mark.skip(reason="slow: run with --slow")
    for item in items:
        if "validate" in item.keywords:
            item.add_marker(long)
        elif "slow" in item.keywords and not config.getoption("--slow"):
            item.add_marker(slow)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240717)
