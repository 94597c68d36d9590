"""Calls of commands that end in one line."""

from __future__ import annotations

import pytest

from tonewood.errors import TonewoodError


def refused(said, call, *arguments, **options) -> None:
    with pytest.raises(TonewoodError, match=said):
        call(*arguments, **options)
