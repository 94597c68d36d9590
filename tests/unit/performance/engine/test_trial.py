"""Every part is asked once before a render is."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.plugins.scene import PLUCK, instrument

from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.engine import trial
from tonewood.performance.engine.engine import Engine


def test_all_exciters_of_one_string_have_played_when_the_trial_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five exciters on one string take turns of 5 ms; the trial ends eight points of the grid after the last one."""
    engines: list[Engine] = []

    class Watched(Engine):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments)  # type: ignore[arg-type]
            engines.append(self)

    monkeypatch.setattr(trial, "Engine", Watched)
    names = ["pluck", "second", "third", "fourth", "fifth"]
    model = assemble(instrument(tmp_path, exciters=dict.fromkeys(names, PLUCK)), 48000)
    asked: list[str] = []
    for name, exciter in model.exciters.items():

        def gesture(*given: object, own: str = name, of: object = exciter) -> Gesture:
            asked.append(own)
            return type(of).gesture(of, *given)  # type: ignore[attr-defined, no-any-return]

        monkeypatch.setattr(exciter, "gesture", gesture, raising=False)
    trial.try_parts(model)
    assert sorted(set(asked)) == sorted(names)
    (engine,) = engines
    notes = sorted(play.time for play in engine.timeline.plays)
    assert notes == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02])
    assert engine.state.sample == 960 + 8 * 64
