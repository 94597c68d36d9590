"""The plugin contract: base classes of plugins, the types that they return, and the registry of those installed."""

from __future__ import annotations

from typing import Any

from tonewood.support.moved import attribute


def __getattr__(name: str) -> Any:
    return attribute(__name__, name, "tonewood.instrument.contract.base")
