"""Benchmarks over the project's life: `python -m pytest benchmarks/suite`, kept with `--benchmark-autosave`.

Later runs are held against earlier ones with `--benchmark-compare`. The table below pytest-benchmark's own tells what
does not depend on the size of a problem: nanoseconds per mode and sample, and the share of the machine's multiply-adds.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

REPORTED = pytest.StashKey[list[tuple[str, str]]]()


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Add a line to the summary."""
    return lambda text: request.config.stash.setdefault(REPORTED, []).append((request.node.name, text))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    lines = config.stash.get(REPORTED, [])
    if lines:
        terminalreporter.section("per mode and sample")
        width = max(len(name) for name, _ in lines)
        for name, text in lines:
            terminalreporter.write_line(f"{name.ljust(width)}  {text}")
