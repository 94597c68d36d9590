"""Without effects a bow and a plectrum still play: their contact with the string is no choice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import instrument

import tonewood as tw


@pytest.mark.parametrize("plugin", ["bow", "plectrum"])
def test_an_exciter_plays_without_effects(tmp_path: Path, plugin: str) -> None:
    played = instrument(
        tmp_path, exciters={"pluck": {"plugin": plugin, "from_bridge": 0.1, "direction": "z"}}, tuning={}, playing={}
    )
    note = tw.Note(0.0, 0.2, string="S", stop=0)
    options: dict[str, Any] = {"max_duration": 0.2, "tail_level_db": -299.0}
    plain = tw.render(tw.Score([note]), played, 24000, effects="none", **options)
    assert np.abs(plain.samples).max() > 0.0
