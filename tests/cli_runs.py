"""Checks that tests of the command line share."""

from __future__ import annotations


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
