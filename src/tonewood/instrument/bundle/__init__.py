"""A bundle: its schema and how it is read, made, changed and migrated."""

from __future__ import annotations

from typing import Any

from tonewood.support.moved import attribute


def __getattr__(name: str) -> Any:
    return attribute(__name__, name, "tonewood.instrument.bundle.loading")
