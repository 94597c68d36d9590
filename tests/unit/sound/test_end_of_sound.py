"""Where a sound ends: spans that are stepped beyond its end leave no trace in it."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.sound.render import renderer as module


def _samples(instrument: str, block_size: int, **options: object) -> tuple[np.ndarray, str]:
    """Samples of one short note, and why they end."""
    string = tw.load_instrument(instrument).string_names[0]
    score = tw.Score([tw.Note(0.0, 0.1, string=string, stop=0)])
    renderer = tw.Renderer(score, instrument, **options)  # type: ignore[arg-type]  # options by name
    return np.concatenate(list(renderer.blocks(block_size))), renderer.summary().end


@pytest.mark.parametrize(
    "options",
    [
        {"tail_level_db": -12.0},
        {"tail_level_db": -12.0, "fs": 44100},
        {"tail_level_db": -12.0, "lead_in": "auto"},
        {"tail_level_db": -12.0, "oversampling": 2, "fs": 22050},
        {"tail": 0.4},
        {"max_duration": 0.31},
        {"max_duration": 0.3, "lead_in": 0.5},
        {"max_duration": 0.01},
    ],
    ids=str,
)
def test_sound_ends_at_the_same_frame_however_many_spans_are_stepped_at_once(
    options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    many, reason = _samples("monochord", 4096, **options)
    monkeypatch.setattr(module, "_TAIL_SPANS", 1)
    single, same = _samples("monochord", 100, **options)
    np.testing.assert_array_equal(many, single)
    assert reason == same
    if "max_duration" in options:
        heard = (float(str(options.get(name, 0.0))) for name in ("max_duration", "lead_in"))
        assert len(many) == round(sum(heard) * 48000)


def test_account_of_energy_has_no_entry_beyond_the_end_of_the_sound() -> None:
    score = tw.Score([tw.Note(0.0, 0.05, string="A2", stop=0)])
    renderer = tw.Renderer(score, "monochord", energy=True, tail=0.3, tail_level_db=-200.0)
    frames = sum(len(block) for block in renderer.blocks(4096))
    assert renderer.energy is not None
    assert abs(renderer.energy.time[-1] - frames / renderer.fs) <= 512 / renderer.fs
