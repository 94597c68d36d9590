"""Fixtures of scenes in which tensions are switched."""

from __future__ import annotations

import pytest
from effect_scenes import FS, duet

from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects import tension


@pytest.fixture(autouse=True)
def _whatever_it_saves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch wherever the budgets allow it, also where so short a time, or so little of it, saves nothing."""
    monkeypatch.setattr(tension, "SHORTEST", 0.0)
    monkeypatch.setattr(tension, "LEAST_IDLE_SHARE", 0.0)


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(duet(mode="auto"), FS)
