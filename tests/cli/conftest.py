"""The command line in this process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tonewood.cli.main import run

#: arguments -> exit code, stdout, stderr
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def tonewood(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command; returns exit code, stdout and stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            run([str(a) for a in arguments])
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return call
