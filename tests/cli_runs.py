"""Checks that tests of the command line share."""

from __future__ import annotations

import json
from typing import Any

import pytest


def refused(result: tuple[int, str, str], *said: str) -> None:
    """Exit code 2 and one line on stderr that says all of `said`."""
    code, out, err = result
    assert code == 2
    assert out == ""
    assert err.startswith("tonewood: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    for word in said:
        assert word in err


class Asked:
    """A function that returns `result` and keeps the arguments of its last call."""

    def __init__(self, result: Any = None):
        self.result, self.words, self.options = result, (), dict[str, Any]()

    def __call__(self, *words: Any, **options: Any) -> Any:
        self.words, self.options = words, options
        return self.result


def told(result: tuple[int, str, str], code: int = 0) -> dict[str, Any]:
    """JSON of a command that says nothing else."""
    assert (result[0], result[2]) == (code, ""), result[2]
    return json.loads(result[1], parse_constant=pytest.fail)
